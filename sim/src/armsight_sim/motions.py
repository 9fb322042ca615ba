"""Motions: what joints are told, and how a hand or a turning base leads a target that the robot does not carry."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike
from scipy.ndimage import gaussian_filter1d
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.arrays import Array
from armsight.errors import UsageError
from armsight.records import frozen_array
from armsight_sim.scene import Path, Rest

TREMOR_HZ = (0.7, 9.0)
"""Frequencies of a hand that tries to hold still: slow sway to physiological tremor (8 to 12 Hz at the fingers)."""

TREMOR_WAVES = 4
"""Sines per axis: enough that the sum has no visible period within a run."""

DRAWN_STEP_S = 0.005
"""Spacing of a drawn path's record; at 0.1 m/s half a millimetre, joined by straight lines."""


class JointMotion(Protocol):
    """What the joints are told to be at any time."""

    def __call__(self, t_s: Array) -> Array:
        """Return joint values (m, n) at times (m,)."""
        ...


def smooth_step(share: ArrayLike) -> Array:
    """Return the way (0..1) of a movement of least jerk after a share (0..1) of its time."""
    s = np.clip(np.asarray(share, dtype=float), 0.0, 1.0)
    return np.asarray(s**3 * (10.0 - 15.0 * s + 6.0 * s**2))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Waypoints:
    """Joints that go from one of q (k, n) to the next; leave_s, arrive_s (k - 1,): when each way begins and ends."""

    q: Array
    leave_s: Array
    arrive_s: Array

    def __call__(self, t_s: Array) -> Array:
        """Return joint values (m, n) at times (m,)."""
        share = smooth_step((np.asarray(t_s)[:, None] - self.leave_s) / (self.arrive_s - self.leave_s))  # (m, k - 1)
        return np.asarray(self.q[0] + share @ np.diff(self.q, axis=0))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Swing:
    """Joints that swing about home (n,) by amplitude (n,) with periods (n,) and phases (n,)."""

    home: Array
    amplitude: Array
    period_s: Array
    phase_rad: Array

    def __call__(self, t_s: Array) -> Array:
        """Return joint values (m, n) at times (m,)."""
        angle = 2.0 * np.pi * np.asarray(t_s)[:, None] / self.period_s + self.phase_rad
        return np.asarray(self.home + self.amplitude * np.sin(angle))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Turntable:
    """A target on a base that turns about world z: T_world_base, T_base_target at angle zero, the angles."""

    T_world_base: RigidTransform
    T_base_target: RigidTransform
    from_rad: float
    to_rad: float
    start_s: float
    lasts_s: float

    def __call__(self, t_s: Array) -> RigidTransform:
        """Return the poses T_world_target at times (m,)."""
        share = smooth_step((np.asarray(t_s) - self.start_s) / self.lasts_s)
        angle = self.from_rad + share * (self.to_rad - self.from_rad)
        turn = RigidTransform.from_rotation(Rotation.from_rotvec(angle[:, None] * np.array([0.0, 0.0, 1.0])))
        return self.T_world_base * turn * self.T_base_target


class Drawn:
    """A target led along corners (k, 3) in m at a speed, resting before and after, rounding corners as a hand does.

    smooth_s: standard deviation of the smoothing in time: at speed v a corner is cut by about 0.4 v smooth_s.
    """

    def __init__(
        self, corners_m: ArrayLike, R_world_target: Rotation, speed_m_s: float, smooth_s: float, start_s: float
    ) -> None:
        corners = np.asarray(corners_m, dtype=float)
        lengths = np.linalg.norm(np.diff(corners, axis=0), axis=1)
        at_s = start_s + np.concatenate([[0.0], np.cumsum(lengths)]) / speed_m_s
        self._t_s = np.arange(0.0, at_s[-1] + 5.0 * smooth_s + 1.0, DRAWN_STEP_S)
        sharp = np.column_stack([np.interp(self._t_s, at_s, axis) for axis in corners.T])
        self._xyz_m = gaussian_filter1d(sharp, smooth_s / DRAWN_STEP_S, axis=0, mode="nearest")
        self._R = R_world_target

    def __call__(self, t_s: Array) -> RigidTransform:
        """Return the poses T_world_target at times (m,)."""
        xyz = np.column_stack([np.interp(t_s, self._t_s, axis) for axis in self._xyz_m.T])
        quat = np.broadcast_to(self._R.as_quat(), (len(xyz), 4))
        return RigidTransform.from_components(xyz, Rotation.from_quat(quat))


class HandJitter:
    """A path in a hand that shakes a little: sines of TREMOR_HZ about it, of given RMS per axis."""

    def __init__(self, path: Path, rms_m: float, rms_rad: float, rng: np.random.Generator) -> None:
        self._path = path
        self._hz = rng.uniform(*TREMOR_HZ, (6, TREMOR_WAVES))
        self._phase = rng.uniform(0.0, 2.0 * np.pi, (6, TREMOR_WAVES))
        share = np.sqrt(2.0 / TREMOR_WAVES)
        self._size = frozen_array("tremor", share * np.repeat([rms_m, rms_rad], 3), (6,))

    def __call__(self, t_s: Array) -> RigidTransform:
        """Return the poses T_world_target at times (m,)."""
        waves = np.sin(2.0 * np.pi * self._hz * np.asarray(t_s)[:, None, None] + self._phase)  # (m, 6, waves)
        shake = self._size * waves.sum(axis=2)
        return self._path(t_s) * RigidTransform.from_components(shake[:, :3], Rotation.from_rotvec(shake[:, 3:]))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Vibration:
    """A flange that vibrates: amplitude_m (3,) along its axes at hz (3,) with phases (3,)."""

    amplitude_m: Array
    hz: Array
    phase_rad: Array

    def __call__(self, t_s: Array) -> Array:
        """Return displacements (m, 3) in flange axes at times (m,)."""
        return np.asarray(self.amplitude_m * np.sin(2.0 * np.pi * self.hz * np.asarray(t_s)[:, None] + self.phase_rad))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Jumping:
    """A path that is beside itself by by_m (3,), in target axes, from start_s to end_s."""

    path: Path
    by_m: Array
    start_s: float
    end_s: float

    def __call__(self, t_s: Array) -> RigidTransform:
        """Return the poses T_world_target at times (m,)."""
        t = np.asarray(t_s) + 1e-9  # frames at the very end, by rounding, are past it
        on = ((t >= self.start_s) & (t < self.end_s)).astype(float)
        return self.path(t) * RigidTransform.from_translation(on[:, None] * self.by_m)


RUN_UP_S = 1.0
"""A hand takes up its speed within so long."""
CIRCLE_M = 0.1
"""Radius of the circle."""
TRAPEZIUM_M = ((0.0, 0.0), (0.12, 0.0), (0.09, 0.06), (-0.09, 0.06), (-0.12, 0.0), (0.0, 0.0))
"""Corners of a trapezium, two thirds of Pachidis 2005's length, round from the middle of its long edge."""
CORNER_S = 0.15
"""Standard deviation of the smoothing in time with which a hand rounds a corner."""
WAVES = 4
WANDER_HZ = (0.05, 0.4)
"""Sines per axis of a hand that goes about, and their frequencies."""
TURN_RAD_S = 0.08
"""Fastest turning of a hand that goes about at 0.1 m/s: at 0.6 m it takes an arm another 50 mm/s to follow."""
LONGEST_S = 120.0
"""For so long a hand that goes about is known to keep within its speed."""
JITTER_M, JITTER_RAD = 1e-4, 3e-4
"""RMS per axis of the shake of a hand that is led by an edge or a turning base."""
HAND_STREAM = 40
"""Stream of random numbers of a hand, beside those of sim.cell."""


class Hand(StrEnum):
    """How a hand leads the target."""

    STILL = "still"
    CIRCLE = "circle"
    TRAPEZIUM = "trapezium"
    RANDOM = "random"


def hand_path(hand: Hand | str, T_world_start: RigidTransform, speed_m_s: float, seed: int) -> Path:
    """Return where a hand leads a target from T_world_start on: along horizontal lines, or about in space.

    speed_m_s: along the line; at random its fastest. Raises UsageError for an unknown hand or a speed below zero.
    """
    known = [kind.value for kind in Hand]
    if hand not in known:
        raise UsageError(f"there is no hand {hand!r}", cure=f"Known are: {', '.join(known)}")
    if not (np.isfinite(speed_m_s) and speed_m_s >= 0.0):
        raise UsageError(f"a speed of {speed_m_s:g} m/s cannot be", cure="Give m/s, zero or more")
    if hand == Hand.STILL or speed_m_s == 0.0:
        return Rest(T_world_target=T_world_start)
    rng = np.random.default_rng([seed, HAND_STREAM])
    path: Path
    if hand == Hand.CIRCLE:
        angle = np.linspace(0.0, 2.0 * np.pi, 721)
        ring = CIRCLE_M * np.column_stack([np.cos(angle), np.sin(angle)])
        path = RoundPath(ring, T_world_start, speed_m_s, 0.0)
    elif hand == Hand.TRAPEZIUM:
        path = RoundPath(TRAPEZIUM_M, T_world_start, speed_m_s, CORNER_S)
    else:
        path = WanderingPath.drawn(T_world_start, speed_m_s, rng)
    return HandJitter(path, JITTER_M, JITTER_RAD, rng)


def run_up(t_s: ArrayLike) -> Array:
    """Return how long (m,) a motion at full speed has taken at times (m,), where it is taken up within RUN_UP_S.

    The integral of a step of least jerk: speed and acceleration have no jump.
    """
    t = np.maximum(np.asarray(t_s, dtype=float), 0.0)
    s = np.minimum(t / RUN_UP_S, 1.0)
    return np.asarray(RUN_UP_S * s**4 * (2.5 - 3.0 * s + s**2) + np.maximum(t - RUN_UP_S, 0.0))


class RoundPath:
    """A target led round a closed horizontal line again and again, with its attitude kept.

    line_m (k, 2): from its first point to itself. smooth_s: standard deviation of the smoothing in time at corners.
    """

    def __init__(self, line_m: ArrayLike, T_world_start: RigidTransform, speed_m_s: float, smooth_s: float) -> None:
        line = np.asarray(line_m, dtype=float)
        at_m = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1))])
        self._period_s = float(at_m[-1]) / speed_m_s
        n = max(8, int(np.ceil(self._period_s / DRAWN_STEP_S)))
        self._t_s = np.linspace(0.0, self._period_s, n + 1)
        sharp = np.column_stack([np.interp(speed_m_s * self._t_s[:-1], at_m, axis) for axis in line.T])
        step_s = self._period_s / n
        soft = gaussian_filter1d(sharp, smooth_s / step_s, axis=0, mode="wrap") if smooth_s > 0.0 else sharp
        self._xy_m = np.concatenate([soft, soft[:1]]) - soft[0]
        self._T = T_world_start

    def __call__(self, t_s: Array) -> RigidTransform:
        """Return the poses T_world_target at times (m,)."""
        t = run_up(t_s) % self._period_s
        xyz = np.zeros((len(t), 3))
        xyz[:, :2] = np.column_stack([np.interp(t, self._t_s, axis) for axis in self._xy_m.T])
        return RigidTransform.from_translation(xyz) * self._T


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class WanderingPath:
    """A target led about at random: sines of hz (6, WAVES) for places (m) and a rotation vector (rad) about the start.

    size (6, WAVES): their amplitudes; phase_rad (6, WAVES). It begins at rest at T_world_start.
    """

    T_world_start: RigidTransform
    hz: Array
    size: Array
    phase_rad: Array

    @classmethod
    def drawn(cls, T_world_start: RigidTransform, speed_m_s: float, rng: np.random.Generator) -> WanderingPath:
        """Return a path whose fastest moment within LONGEST_S has a given speed."""
        hz = rng.uniform(*WANDER_HZ, (6, WAVES))
        phase = rng.uniform(0.0, 2.0 * np.pi, (6, WAVES))
        t = np.arange(0.0, LONGEST_S, 0.02)
        rate = np.cos(2.0 * np.pi * hz * t[:, None, None] + phase).sum(axis=2)  # (m, 6), each wave of unit speed
        fastest = [np.linalg.norm(rate[:, part], axis=1).max() for part in (slice(0, 3), slice(3, 6))]
        speeds = np.repeat([speed_m_s / fastest[0], TURN_RAD_S * speed_m_s / 0.1 / fastest[1]], 3)
        return cls(T_world_start=T_world_start, hz=hz, size=speeds[:, None] / (2.0 * np.pi * hz), phase_rad=phase)

    def __call__(self, t_s: Array) -> RigidTransform:
        """Return the poses T_world_target at times (m,)."""
        t = run_up(t_s)[:, None, None]
        swing = np.sin(2.0 * np.pi * self.hz * t + self.phase_rad) - np.sin(self.phase_rad)  # (m, 6, WAVES)
        way = (self.size * swing).sum(axis=2)
        turned = RigidTransform.from_rotation(Rotation.from_rotvec(way[:, 3:]))
        return RigidTransform.from_translation(way[:, :3]) * self.T_world_start * turned
