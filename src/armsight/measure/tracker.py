"""A target followed over pairs of frames: each pair tells the next where to look, and what shows nothing is lost."""

from __future__ import annotations

import numpy as np

from armsight.errors import Inconsistent, Unseen
from armsight.measure.poses.outcome import Measured, Track
from armsight.measure.poses.pipeline import check_sizes, measure_pair
from armsight.measure.poses.setup import Setup
from armsight.records import Frame, Points, PoseStatus, Spots, TargetPose


class TargetTracker:
    """Measures pair after pair. track: where the lights are looked for next; swapped: of the latest pair, where its
    views look exchanged, which one pair cannot decide."""

    def __init__(self, setup: Setup) -> None:
        self._setup = setup
        self.track: Track | None = None
        self.swapped: Inconsistent | None = None

    def take(self, left: Frame, right: Frame) -> Measured:
        """Return what is measured; a pose that is lost, with the reason, where a frame cannot be read or the views look
        exchanged. Raises Inconsistent where a frame is not of the size of the rig's camera."""
        check_sizes(self._setup.rig, left, right)
        self.swapped = None
        unreadable = [f"{frame.source}: {frame.unreadable}" for frame in (left, right) if frame.unreadable]
        if unreadable:
            measured = lost_pair((left, right), unreadable[0], Unseen.UNREADABLE)
        else:
            try:
                measured = measure_pair(self._setup, left, right, self.track)
            except Inconsistent as error:
                self.swapped = error
                measured = lost_pair((left, right), error.cause, Unseen.SWAPPED)
        self.track = measured.track
        return measured


def lost_pair(pair: tuple[Frame, Frame], why: str, cause: Unseen = Unseen.OTHER) -> Measured:
    """Return the record of a pair that gave nothing."""
    none = Spots.none()
    return Measured(
        pose=TargetPose(t_s=0.5 * (pair[0].t_s + pair[1].t_s), status=PoseStatus.LOST, parent="rig", why=why),
        points=Points(names=(), xyz_m=np.empty((0, 3)), covariance_m2=np.empty((0, 3, 3))),
        left=none,
        right=none,
        names=(),
        left_seen=none,
        right_seen=none,
        cause=cause,
    )
