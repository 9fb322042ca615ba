"""The beacon before the eyes of a rig: what a joint sweep is told by."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from armsight.arrays import Array, Image
from armsight.clock import Clock
from armsight.control.joint_sweep import Observation
from armsight.drivers import Views
from armsight.errors import DeviceLost, NotEnoughData, UsageError
from armsight.measure.poses.moments import measure_moment
from armsight.measure.poses.pipeline import Measured, Setup
from armsight.measure.settings import SpotSettings
from armsight.records import PoseStatus, Target

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


def reach_m(target: Target) -> float:
    """Return how far the target's other lights are from the beacon: only while all stay in view is it told by name."""
    return float(np.linalg.norm(target.xyz_m - target.xyz_m[0], axis=1).max())


class SeenBeacon(NamedTuple):
    """One light: its place (3,) in the rig's axes, its pixels (v, 2) by camera, NaN where it is not seen, and their
    standard deviation, that of the worst direction."""

    xyz_m: Array
    uv_px: Array
    std_px: float


def beacon_of(found: Measured, name: str, target: Target) -> SeenBeacon | None:
    """Return the light of this name of the target; None where it is not seen.

    Which of several lights it is only a whole pose says. One camera alone shows it in a direction; where it is there,
    the pose says.
    """
    if name not in found.names or not (len(target.names) == 1 or found.pose.status is PoseStatus.OK):
        return None
    uv, worst = np.full((len(found.spots), 2), np.nan), 0.0
    for s, view in enumerate(found.spots):
        if name in (names := found.names_in(s)):
            i = names.index(name)
            uv[s], worst = view.uv_px[i], max(worst, float(np.linalg.eigvalsh(view.covariance_px2[i])[1]))
    if name in found.points.names:
        xyz_m = found.points.xyz_m[found.points.names.index(name)]
    else:
        T = np.asarray(found.pose.T_parent_target)
        xyz_m = T[:3, :3] @ target.xyz_m[target.names.index(name)] + T[:3, 3]
    return SeenBeacon(xyz_m, uv, float(np.sqrt(worst)))


def beacon_note(name: str, n_lights: int) -> tuple[str, ...]:
    """Return, in words, which of several lights the arm is identified by."""
    if n_lights == 1:
        return ()
    return (f"of the target's {n_lights} lights {name} is the beacon: the arm's tool is that light, not the target",)


class CameraBeaconObserver:
    """Observations at the beacon through moments of live frames, whose stamps count from a moment of their own."""

    def __init__(self, setup: Setup, moments: Iterator[Views], clock: Clock) -> None:
        """The beacon is the target's first light."""
        self._setup = setup
        self._moments = moments
        self._clock = clock
        self._ahead_s = np.inf
        self._lost = 0

    def observe(self, while_: str) -> Observation:
        """Return what the next moment shows. Raises NotEnoughData after LOST_FRAMES without the beacon, DeviceLost."""
        frames = next(self._moments, None)
        if frames is None:
            raise DeviceLost(f"the cameras ended {while_}", consequence="The robot was stopped", cure="Check them")
        t_s = max(frame.t_s for frame in frames if frame is not None)
        self._ahead_s = min(self._ahead_s, self._clock.now_s() - t_s)  # a frame may wait, none comes before it is taken
        found = measure_moment(self._setup, frames)
        beacon = beacon_of(found, self._setup.target.names[0], self._setup.target)
        if beacon is not None:
            self._lost = 0
            return Observation(taken_s=t_s + self._ahead_s, **beacon._asdict())
        self._lost += 1
        why = found.pose.why or "it is not in the images of two cameras"
        if self._lost >= LOST_FRAMES:
            raise NotEnoughData(
                f"the beacon is lost {while_}: {why}",
                consequence="The robot was stopped",
                cure="Free the view of it, or narrow the limits to where two cameras see it",
            )
        return Observation(taken_s=t_s + self._ahead_s, why=why)
