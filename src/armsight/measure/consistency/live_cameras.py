"""Moments of a run that does not end: in every stretch of them each camera is held against the others."""

from __future__ import annotations

import math
from dataclasses import replace

from armsight.errors import Inconsistent, Unseen
from armsight.measure.consistency.all_sights import shown_beside
from armsight.measure.consistency.check import advice, finalise, sentence
from armsight.measure.consistency.findings import LeftOut
from armsight.measure.consistency.run_of_cameras import CamerasCheck
from armsight.measure.poses.moments import TargetTracker
from armsight.measure.poses.outcome import Measured
from armsight.measure.poses.setup import Setup
from armsight.records import Frame, PoseStatus

STRETCH, MOST = 32, 128
"""Poses, or moments, after which the check begins anew: a second of a webcam. One that grew would look at its sums ever
more seldom, and take a knock for a small part of a long run."""
BESIDE = "a camera shows the lights beside where the others have them"
SOON = 9
"""Doubtful poses in a row after which it is judged at once."""


class WatchedTracker:
    """A TargetTracker that judges its rig as it goes, where that is no pair.

    left_out: what was found of cameras that are not looked at any more. wrong: what does not fit though no camera could
    be left out for it; its poses are doubtful. trusted_s: the time of the last moment of the newest stretch that fits.
    """

    def __init__(self, setup: Setup) -> None:
        self._setup, self._tracker = setup, TargetTracker(setup)
        self._check = None if setup.rig.is_pair else CamerasCheck(setup, early=False)
        self._posed = self._doubts = self._taken = 0
        self.left_out: tuple[LeftOut, ...] = ()
        self.wrong: LeftOut | None = None
        self.trusted_s = self._last_s = -math.inf

    @property
    def contradictions(self) -> tuple[LeftOut, ...]:
        """What is wrong with the rig, for whoever must not move on it."""
        return self.left_out if self.wrong is None else (*self.left_out, self.wrong)

    def take(self, *frames: Frame | None) -> Measured:
        """Return what is measured by the cameras that agree, as TargetTracker does."""
        measured = self._tracker.take(*frames)
        if self._check is None:
            return measured
        measured = self._contradicted(self._check.add(measured))
        self._taken, self._last_s = self._taken + 1, measured.pose.t_s
        self._doubts = self._doubts + 1 if measured.pose.status is PoseStatus.DOUBTFUL else 0
        self._posed += measured.pose.status in (PoseStatus.OK, PoseStatus.DOUBTFUL)
        doubted = self.wrong is not None
        if self._posed >= STRETCH or self._taken >= MOST or self._doubts >= SOON:
            doubted |= self._judged(self._check)
        self._tracker.without, self._tracker.track = self._check.without, measured.track
        pose = finalise(measured.pose, inconsistent=True) if doubted else measured.pose
        return measured if pose is measured.pose else replace(measured, pose=pose, cause=Unseen.INCONSISTENT)

    def _contradicted(self, measured: Measured) -> Measured:
        """Return the moment, doubtful where a camera shows lights beside their places.

        A pose takes what fits: of three cameras two, of which one was knocked, may outvote the third.
        """
        pose = measured.pose
        if pose.status is not PoseStatus.OK or not shown_beside(self._setup, measured):
            return measured
        return replace(measured, pose=replace(pose, status=PoseStatus.DOUBTFUL, why=BESIDE), cause=Unseen.INCONSISTENT)

    def finish(self, consequence: str) -> None:
        """Judge what is left of a run that ended. Raises Inconsistent where anything is wrong with the rig."""
        if self._check is not None and self._posed and not self.contradictions:
            self._judged(self._check)
        if self.contradictions:
            raise Inconsistent(
                ". ".join(one.words for one in self.contradictions),
                consequence=consequence,
                cure=". ".join(one.cure for one in self.contradictions),
            )

    def _judged(self, check: CamerasCheck) -> bool:
        """Judge the stretch and begin another; tell whether its last pose may be of a camera that is wrong."""
        found, before = check.finish(), len(self.left_out)
        self.left_out = found.left_out
        rest = replace(found, left_out=())
        self.wrong = None
        if found.verdict == "inconsistent" or (found.findings and self._doubts >= SOON):
            self.wrong = LeftOut(names=(), words=sentence(rest).rstrip("."), cure=advice(rest).rstrip("."))
        elif found.verdict in ("ok", "doubtful") and len(self.left_out) == before:
            self.trusted_s = self._last_s
        self._check = CamerasCheck(self._setup, self.left_out, early=False)
        self._posed = self._doubts = self._taken = 0
        return self.wrong is not None or len(self.left_out) > before
