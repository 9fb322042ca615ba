"""The beacon before the eyes of a rig: what a joint sweep is told by."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from armsight.clock import Clock
from armsight.control.joint_sweep import Observation
from armsight.drivers import read_image
from armsight.errors import DeviceLost, NotEnoughData
from armsight.measure.poses.pipeline import Measured, Setup, measure_pair
from armsight.measure.settings import SpotSettings
from armsight.records import Frame, Target

LOST_FRAMES = 3
"""Frames in a row without the beacon that mean it is lost: single ones are lost to flicker."""


def beacon_settings(target: Target, mask: Path | None) -> SpotSettings:
    """Return how the beacon is looked for; mask: an image that is black where no light may be. Raises BadFile."""
    return SpotSettings(colour=target.colour, mask=None if mask is None else read_image(mask) > 0)


def beacon_std_px(found: Measured) -> float:
    """Return the standard deviation of a pixel coordinate of a beacon that was found: that of its worse direction."""
    worst = (np.linalg.eigvalsh(view.covariance_px2[0])[1] for view in (found.left, found.right))
    return float(np.sqrt(max(worst)))


class StereoBeaconObserver:
    """Observations at the beacon through pairs of live frames, whose stamps count from a moment of their own."""

    def __init__(self, setup: Setup, pairs: Iterator[tuple[Frame, Frame]], clock: Clock) -> None:
        self._setup = setup
        self._pairs = pairs
        self._clock = clock
        self._ahead_s = np.inf
        self._lost = 0

    def observe(self, while_: str) -> Observation:
        """Return what the next pair shows. Raises NotEnoughData after LOST_FRAMES without the beacon, DeviceLost."""
        pair = next(self._pairs, None)
        if pair is None:
            raise DeviceLost(f"the cameras ended {while_}", consequence="The robot was stopped", cure="Check them")
        t_s = max(pair[0].t_s, pair[1].t_s)
        self._ahead_s = min(self._ahead_s, self._clock.now_s() - t_s)  # a frame may wait, none comes before it is taken
        found = measure_pair(self._setup, *pair)
        if len(found.points):
            self._lost = 0
            uv = np.stack([found.left.uv_px[0], found.right.uv_px[0]])
            std_px = beacon_std_px(found)
            return Observation(taken_s=t_s + self._ahead_s, uv_px=uv, xyz_m=found.points.xyz_m[0], std_px=std_px)
        self._lost += 1
        why = found.pose.why or "it is not in both images"
        if self._lost >= LOST_FRAMES:
            raise NotEnoughData(
                f"the beacon is lost {while_}: {why}",
                consequence="The robot was stopped",
                cure="Free the view of it, or narrow the limits to where both cameras see it",
            )
        return Observation(taken_s=t_s + self._ahead_s, why=why)
