"""The consistency check as a run goes: what it has seen, and poses widened by what it has found."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from armsight.errors import Unseen
from armsight.measure.consistency.causes import causes_of
from armsight.measure.consistency.diagnosis import Consistency, judge
from armsight.measure.consistency.evidence import WINDOW, Evidence, frame_of
from armsight.measure.consistency.refit import refit
from armsight.measure.poses.outcome import Measured
from armsight.measure.poses.setup import Setup
from armsight.records import PoseStatus, TargetPose

NEXT_LOOK = 1.5
"""... and each next time after so many times more."""


MOST_REFITTED = 200
"""Refused frames that are looked at again (some milliseconds each): a run that is refused throughout says no more."""


DOUBT = "the residuals of the run say that rig or target are wrong"


def settled(pose: TargetPose, *, inconsistent: bool) -> TargetPose:
    """Return a pose with the status that the verdict on its run gives it; doubt about the frame itself stays."""
    if inconsistent and pose.status is PoseStatus.OK:
        return replace(pose, status=PoseStatus.DOUBTFUL, why=DOUBT)
    if not inconsistent and pose.status is PoseStatus.DOUBTFUL and pose.why == DOUBT:
        return replace(pose, status=PoseStatus.OK, why="")
    return pose


class RunCheck:
    """Sees every moment of a run in order; widens what comes once the residuals prove that rig or target are wrong."""

    def __init__(self, setup: Setup) -> None:
        self._evidence = Evidence.of(setup)
        self._refitted = self._refused = self._whole = 0
        self._causes = causes_of(setup, self._evidence.basis)
        self._next = float(WINDOW)
        self._known: Consistency | None = None

    def add(self, measured: Measured) -> Measured:
        """Take one moment; return it with the pose's covariance widened by what is known to be wrong by now.

        Noise above the claimed one multiplies the part of the covariance that the spots make; a fault of rig or
        target adds its expected effect on this pose to the part that repeats.
        """
        self._evidence.add(self._telling(measured))
        if self._evidence.frames >= self._next:
            self._known = self._judge(changes=False)
            self._next = NEXT_LOOK * self._evidence.frames
        if self._known is None:
            return measured
        wider = self._widened(measured, self._known)
        pose = settled(wider.pose, inconsistent=self.inconsistent)
        return wider if pose is wider.pose else replace(wider, pose=pose, cause=Unseen.INCONSISTENT)

    @property
    def inconsistent(self) -> bool:
        """Whether the run was inconsistent when it was judged last."""
        return self._known is not None and self._known.verdict == "inconsistent"

    def finish(self) -> Consistency:
        """Return the verdict over the whole run."""
        self._evidence.finish()
        return self._judge(changes=True)

    def _judge(self, *, changes: bool) -> Consistency:
        share = self._refused / max(self._refused + self._whole, 1)
        return judge(self._evidence, self._causes, share, changes=changes)

    def _telling(self, measured: Measured) -> Measured:
        """Return the moment with all its lights, where it was refused or some were left out."""
        ok = measured.pose.status in (PoseStatus.OK, PoseStatus.DOUBTFUL)
        self._whole += ok
        if (ok and not measured.notes) or self._refitted >= MOST_REFITTED:
            return measured
        found = refit(self._evidence.setup, measured)
        if found is None:
            return measured
        self._refitted += 1
        self._refused += not ok
        return found

    def _widened(self, measured: Measured, known: Consistency) -> Measured:
        fault, factor = known.second_moment, known.noise_factor
        if fault is None and factor <= 1.0:
            return measured
        frame, pose = frame_of(self._evidence.setup, measured), measured.pose
        found = None if frame is None else self._evidence.slopes(frame, self._evidence.backward(frame))
        if found is None or pose.covariance is None:
            return measured
        _, _, _, S, C = found
        systematic = np.zeros((6, 6)) if pose.systematic_covariance is None else np.array(pose.systematic_covariance)
        own = pose.covariance - systematic  # the spots' part, widened already where this frame's residuals are large
        own = own * max(1.0, factor * float(np.trace(C[:3, :3]) / np.trace(own[:3, :3])))
        if fault is not None:
            systematic += S @ fault @ S.T
        wider = replace(
            pose,
            covariance=own + systematic,
            systematic_covariance=systematic if fault is not None else pose.systematic_covariance,
        )
        return replace(measured, pose=wider)
