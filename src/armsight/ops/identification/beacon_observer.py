"""The beacon before the eyes of a rig: what a joint sweep is told by."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from armsight.arrays import Array, Image
from armsight.clock import Clock
from armsight.control.joint_sweep import Observation
from armsight.errors import DeviceLost, NotEnoughData, UsageError
from armsight.measure.poses.pipeline import Measured, Setup, measure_pair
from armsight.measure.settings import SpotSettings
from armsight.records import Frame, PoseStatus, Target

LOST_FRAMES = 3
"""Frames in a row without the beacon that mean it is lost: single ones are lost to flicker."""


def beacon_settings(target: Target, mask: Image | None) -> SpotSettings:
    """Return how the beacon is looked for; mask: an image that is black where no light may be.

    Raises UsageError for a target none of whose lights can be followed.
    """
    if target.is_board or (len(target.names) > 1 and not target.model_known):
        why = "it has no lights" if target.is_board else "its lights are named by how they stand in the image alone"
        raise UsageError(
            f"no light of this target can be followed while the arm rotates it: {why}",
            consequence="Nothing is moved, and no arm is identified",
            cure="Give a target of one light, or measure where the lights of this one are (armsight calibrate target)",
        )
    return SpotSettings(colour=target.colour, mask=None if mask is None else mask > 0)


class SeenBeacon(NamedTuple):
    """One light: its place (3,) in the rig's axes, its pixels (2, 2) left and right, and their standard deviation, that
    of the worse direction."""

    xyz_m: Array
    uv_px: Array
    std_px: float


def beacon_of(found: Measured, name: str, n_lights: int) -> SeenBeacon | None:
    """Return the light of this name; None where it is not seen. n_lights: of the target.

    Which of several lights it is only a whole pose says.
    """
    if name not in found.names or not (n_lights == 1 or found.pose.status is PoseStatus.OK):
        return None
    i, views = found.names.index(name), (found.left, found.right)
    worst = max(np.linalg.eigvalsh(view.covariance_px2[i])[1] for view in views)
    return SeenBeacon(found.points.xyz_m[i], np.stack([view.uv_px[i] for view in views]), float(np.sqrt(worst)))


def beacon_note(name: str, n_lights: int) -> tuple[str, ...]:
    """Return, in words, which of several lights the arm is identified by."""
    if n_lights == 1:
        return ()
    return (f"of the target's {n_lights} lights {name} is the beacon: the arm's tool is that light, not the target",)


class StereoBeaconObserver:
    """Observations at the beacon through pairs of live frames, whose stamps count from a moment of their own."""

    def __init__(self, setup: Setup, pairs: Iterator[tuple[Frame, Frame]], clock: Clock) -> None:
        """The beacon is the target's first light."""
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
        names = self._setup.target.names
        beacon = beacon_of(found, names[0], len(names))
        if beacon is not None:
            self._lost = 0
            return Observation(taken_s=t_s + self._ahead_s, **beacon._asdict())
        self._lost += 1
        why = found.pose.why or "it is not in both images"
        if self._lost >= LOST_FRAMES:
            raise NotEnoughData(
                f"the beacon is lost {while_}: {why}",
                consequence="The robot was stopped",
                cure="Free the view of it, or narrow the limits to where both cameras see it",
            )
        return Observation(taken_s=t_s + self._ahead_s, why=why)
