"""What a recording of a cell holds: the arm's joints over time, and the spots of its cameras by their own clocks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import RigidTransform

from armsight.arrays import Array, Index
from armsight.calibrate.timing.stamps import SteadyStamps, camera_clock
from armsight.errors import Inconsistent, NotEnoughData
from armsight.fitting.groups import whitener
from armsight.kinematics import Arm
from armsight.optics import SIDES
from armsight.records import Motion, SpotTrack
from armsight.records.camera import PPM

LOG_GAP_S = 0.2
"""Readings further apart than this leave open where the arm was between them."""
BLOCK_S = 0.5
"""Length of the stretches of motion that are held against each other; an arm strays for longer than that. By stretches
of 1 s deviations come out 5 % too small."""
FEWEST_READINGS = 100
LEAST_S = 20.0
"""Of motion: less is no calibration of a cell."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class JointLog:
    """The joints' readings as a smooth function of the robot's time; t_s (k,), q (k, n)."""

    t_s: Array
    q: Array
    spline: CubicSpline
    speed: CubicSpline

    @classmethod
    def of(cls, motion: Motion) -> JointLog:
        """Return a log of a motion."""
        spline = CubicSpline(motion.t_s, motion.q)
        return cls(t_s=motion.t_s, q=motion.q, spline=spline, speed=spline.derivative())

    def covers(self, t_s: Array) -> NDArray[np.bool_]:
        """Return which times (m,) lie between two readings that are near to each other."""
        k = np.clip(np.searchsorted(self.t_s, t_s), 1, len(self.t_s) - 1)
        inside = (t_s >= self.t_s[0]) & (t_s <= self.t_s[-1])
        return np.asarray(inside & (self.t_s[k] - self.t_s[k - 1] <= LOG_GAP_S))

    def at(self, t_s: Array) -> tuple[Array, Array]:
        """Return the joints (m, n) and their speeds (m, n) at times (m,)."""
        return np.asarray(self.spline(t_s)), np.asarray(self.speed(t_s))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Spots:
    """Spots (m,) of all cameras, each taken for one light.

    side: the camera's place in their order; light: its number, -1 where it is none; frame: of its camera; stamp_s: the
    steady time of that frame by the camera's clock; line from -0.5 to 0.5; uv_px (m, 2); covariance_px2 (m, 2, 2).
    """

    side: Index
    light: Index
    frame: Index
    stamp_s: Array
    line: Array
    uv_px: Array
    covariance_px2: Array

    def __len__(self) -> int:
        return len(self.side)

    def take(self, rows: Index | NDArray[np.bool_]) -> Spots:
        """Return some of them."""
        return Spots(**{name: getattr(self, name)[rows] for name in self.__slots__})

    def of_lights(self, light: Index) -> Spots:
        """Return those (m,) that are of a light, light (m,) being their numbers."""
        return replace(self, light=light).take(light >= 0)

    @property
    def spread_px(self) -> Array:
        """The standard deviation (m,) of each spot's coordinate, as it says itself."""
        return np.asarray(np.sqrt(np.trace(self.covariance_px2, axis1=1, axis2=2) / 2.0))

    def whitening(self, scale: Sequence[float] = (1.0, 1.0)) -> Array:
        """Return W (m, 2, 2) by which a residual becomes one of unit variance; scale: of each camera's deviations."""
        return np.asarray(whitener(self.covariance_px2) / np.asarray(scale)[self.side][:, None, None])


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CellRecording:
    """One recording: the arm's nominal model, its log; its cameras' spots, clocks, image sizes (w, h) and names."""

    arm: Arm
    log: JointLog
    spots: Spots
    clocks: tuple[SteadyStamps, ...]
    sizes: tuple[tuple[int, int], ...]
    names: tuple[str, ...] = SIDES

    @property
    def middle_s(self) -> tuple[float, ...]:
        """The stamps of each camera at which its delay is taken."""
        return tuple(float(clock.t_s[0] + clock.t_s[-1]) / 2.0 for clock in self.clocks)

    @property
    def is_pair(self) -> bool:
        """Whether its cameras are left and right, by which a light must be seen twice."""
        return self.names == SIDES


def recording_of(
    arm: Arm,
    motion: Motion,
    tracks: Sequence[SpotTrack],
    sizes: Sequence[tuple[int, int]],
    names: Sequence[str] = SIDES,
) -> CellRecording:
    """Return what was recorded by the cameras of these names, checked.

    Raises NotEnoughData, Inconsistent (another arm's log, degrees).
    """
    _check_log(arm, motion)
    clocks = tuple(camera_clock(track.t_s, name) for track, name in zip(tracks, names, strict=True))
    parts = []
    for side, (track, clock, (_, height)) in enumerate(zip(tracks, clocks, sizes, strict=True)):
        m = len(track.names)
        parts.append(
            Spots(
                side=np.full(m, side),
                light=np.full(m, -1),
                frame=track.frame,
                stamp_s=clock.t_s[track.frame],
                line=track.uv_px[:, 1] / (height - 1) - 0.5,
                uv_px=track.uv_px,
                covariance_px2=track.covariance_px2,
            )
        )
    spots = Spots(**{name: np.concatenate([getattr(part, name) for part in parts]) for name in Spots.__slots__})
    # what is seen is placed on the flange: a tool that the arm's file has stands between it and the lights
    bare = replace(arm.based(), T_flange_tool=RigidTransform.identity())
    driven = Motion(t_s=motion.t_s, q=motion.q @ arm.gearing.T)
    log, every = JointLog.of(driven), tuple(sizes)
    return CellRecording(arm=bare, log=log, spots=spots, names=tuple(names), clocks=clocks, sizes=every)


def robot_time(stamp_s: Array, line: Array, clock: Array, middle_s: float) -> Array:
    """Return when lines were exposed by the robot's clock; clock: delay_s at middle_s, drift_ppm, readout_s."""
    return np.asarray(stamp_s + clock[0] + PPM * clock[1] * (stamp_s - middle_s) + clock[2] * line)


def _check_log(arm: Arm, motion: Motion) -> None:
    if motion.q.shape[1] != arm.n:
        raise Inconsistent(
            f"the robot's log has {motion.q.shape[1]} joints, {arm.name} has {arm.n}",
            consequence="It cannot be of this arm",
            cure="Give the log and the model of one arm, with q1 .. qn in the order of its joints",
        )
    arm.checked(motion.q)
    if len(motion.t_s) < FEWEST_READINGS or float(np.ptp(motion.t_s)) < LEAST_S:
        raise NotEnoughData(
            f"the robot's log holds {len(motion.t_s)} readings of {np.ptp(motion.t_s):.1f} s",
            consequence="A cell is not calibrated from so little",
            cure="Record one to two minutes of motion",
        )
