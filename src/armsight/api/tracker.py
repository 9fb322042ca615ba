"""The target's track over many moments, as they come."""

from __future__ import annotations

import numpy as np

from armsight.api.pose import Cameras, PoseEstimate, estimate_of, frames_of, require_setup, setup_of, views_of
from armsight.errors import Inconsistent
from armsight.measure.consistency.check import RunCheck, finalise
from armsight.measure.consistency.findings import Consistency, LeftOut
from armsight.measure.consistency.run_of_cameras import CamerasCheck
from armsight.measure.poses.moments import TargetTracker, measure_moment
from armsight.measure.poses.outcome import Track
from armsight.measure.poses.setup import Setup
from armsight.measure.settings import DEFAULTS, SpotSettings
from armsight.measure.track import PoseTrack
from armsight.ops.arrays import ImageLike
from armsight.optics import Rig
from armsight.records import Target, TargetPose, require_count, require_number


class PoseTracker:
    """Follows a target over moments in order, faster than each by itself, and checks that they agree.

    The lights are looked for where they must be by now, and in the whole image where they are not. Over the run the
    residuals are asked whether rig and target can be right; poses that follow are widened where they cannot. Of more
    cameras than two one that contradicts the others is left out: `left_out` says why. The spots of all their moments
    are kept.
    """

    def __init__(self, rig: Rig, target: Target, *, settings: SpotSettings = DEFAULTS, bits: int | None = None) -> None:
        require_setup(rig, target, settings)
        if bits is not None:
            require_count("bits", bits, least=1)
        self._rig, self._target, self._settings, self._bits = rig, target, settings, bits
        self.reset()

    def reset(self) -> None:
        """Forget all that was seen."""
        self._setup: Setup | None = None
        self._track: Track | None = None
        self._check: RunCheck | CamerasCheck | None = None
        self._poses: list[TargetPose] = []

    def update(
        self,
        left: ImageLike | None = None,
        right: ImageLike | None = None,
        t_s: float = np.nan,
        *,
        cameras: Cameras | None = None,
    ) -> PoseEstimate:
        """Return the pose at t_s.

        Parameters
        ----------
        left, right, cameras
            As estimate_pose takes them.
        t_s
            Time of the exposure in s, growing from call to call.

        Raises
        ------
        Inconsistent
            Time does not grow; else as estimate_pose.
        """
        require_number("t_s", t_s)
        if self._poses and not t_s > self._poses[-1].t_s:
            raise Inconsistent(
                f"the time {t_s:g} s does not come after the one before",
                consequence="The moment cannot be tracked",
                cure="Give the times of the exposures in seconds, in order; reset() for another recording",
            )
        one_image = right is None and cameras is None
        if self._setup is None or self._check is None or (self._rig.is_pair and self._setup.overlaid != one_image):
            self._setup = setup_of(self._rig, self._target, self._settings, one_image=one_image)
            self._check = RunCheck(self._setup) if self._rig.is_pair else CamerasCheck(self._setup)
            self._tracker = TargetTracker(self._setup)
        frames = frames_of(self._setup, views_of(self._setup, left, right, cameras), t_s, self._bits)
        if isinstance(self._check, CamerasCheck) and any(frame is not None for frame in frames):
            self._tracker.without, self._tracker.track = self._check.without, self._track
            measured = self._tracker.take(*frames)
        else:
            measured = measure_moment(self._setup, frames, self._track)
        measured = self._check.add(measured)
        self._track = measured.track
        self._poses.append(measured.pose)
        return estimate_of(measured)

    @property
    def left_out(self) -> tuple[LeftOut, ...]:
        """What was found of cameras of three and more that are not looked at any more."""
        return tuple(self._check.left_out) if isinstance(self._check, CamerasCheck) else ()

    @property
    def track(self) -> PoseTrack:
        """The poses so far; all are doubtful once the run is found inconsistent."""
        doubted = self._check is not None and self._check.inconsistent
        return PoseTrack(poses=tuple(finalise(pose, inconsistent=doubted) for pose in self._poses))

    @property
    def consistency(self) -> Consistency | None:
        """Whether the residuals so far fit the rig and the target, and what is likely wrong; None before any moment."""
        return None if self._check is None else self._check.finish()
