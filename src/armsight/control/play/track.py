"""Ways of the tip by time: sampled tracks with the law they are gone along by, and the leg back to one."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from scipy.interpolate import BSpline, CubicSpline
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.arrays import Array
from armsight.geometry import pose_difference

ARM_M = 0.1
"""Turning by a radian counts as so much of a leg, so that one that only turns has a length: 20 mm/s are 0.2 rad/s."""
LEG_ACCELERATION_M_S2, LEG_JERK_M_S3 = 0.2, 20.0
"""Of the leg back to a path, which is planned within a cycle, without the joints: a tenth of the guard's limits."""
LEG_RATE = (4.0, 40.0)
"""How quickly a leg back gathers and gives up its speed: 1/s and 1/s^2."""


class Way(Protocol):
    """A way of the tip in base axes, from rest to rest in duration_s.

    rates: how fast the rate of its time may change, in 1/s and 1/s^2, so that the limits are kept.
    """

    duration_s: float
    rates: tuple[float, float]

    def pose(self, t_s: float) -> RigidTransform:
        """Return T_base_tip at a time."""
        ...

    def along(self, t_s: float) -> tuple[float, float]:
        """Return the length in m, and the speed along it in m/s, at a time."""
        ...


class Leg:
    """A straight way from one pose to another, turning evenly, at up to speed_m_s; its length counts the turning too.

    The share of it that is gone is a polynomial of the fifth degree of time: speed and acceleration are 0 at both ends.
    """

    rates = LEG_RATE

    def __init__(self, start: RigidTransform, end: RigidTransform, speed_m_s: float) -> None:
        difference = pose_difference(end, start)
        self._start, self._xyz_m, self._turn_rad = start, difference[:3], difference[3:]
        length_m = max(float(np.linalg.norm(self._xyz_m)), ARM_M * float(np.linalg.norm(self._turn_rad)))
        self.length_m = length_m
        # the largest derivatives of x^3 (10 - 15 x + 6 x^2): 15 / 8, 10 / sqrt(3), 60
        self.duration_s = max(
            1.875 * length_m / speed_m_s,
            float(np.sqrt(5.7735 * length_m / LEG_ACCELERATION_M_S2)),
            float(np.cbrt(60.0 * length_m / LEG_JERK_M_S3)),
        )

    def pose(self, t_s: float) -> RigidTransform:
        """Return T_base_tip at a time."""
        share = self._share(t_s)
        return RigidTransform.from_components(
            self._start.translation + share * self._xyz_m,
            Rotation.from_rotvec(share * self._turn_rad) * self._start.rotation,
        )

    def along(self, t_s: float) -> tuple[float, float]:
        """Return the length in m, and the speed along it in m/s, at a time."""
        x = self._part(t_s)
        speed = 0.0 if self.duration_s <= 0.0 else 30.0 * (x * (1.0 - x)) ** 2 * self.length_m / self.duration_s
        return self._share(t_s) * self.length_m, speed

    def _part(self, t_s: float) -> float:
        return 1.0 if self.duration_s <= 0.0 else min(max(t_s / self.duration_s, 0.0), 1.0)

    def _share(self, t_s: float) -> float:
        x = self._part(t_s)
        return x**3 * (10.0 - 15.0 * x + 6.0 * x * x)


class TimeLaw:
    """How far a way is gone at a time: a cubic B-spline with control points u (k,) each step_s, at rest at both ends.

    Of a spline whose first three points are alike, and its last three, speed and acceleration are 0 at its ends.
    """

    def __init__(self, step_s: float, points: Array) -> None:
        self.step_s, self.points = step_s, points
        self.duration_s = step_s * (len(points) - 3)
        self.u = BSpline(step_s * (np.arange(len(points) + 4) - 3.0), points, 3)
        self.speed = self.u.derivative()

    def slowed(self, times: float) -> TimeLaw:
        """Return the same way gone along in so many times the time."""
        return TimeLaw(times * self.step_s, self.points)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Samples:
    """A way's poses T (n, 4, 4) at a parameter u (n,) with even steps from 0, m.

    s_m (n,): length along the path as given. wanted_m_s (n,): speed asked for, of paced_m (n, k): the position without
    its weave, or a length. q (n, joints): readings that put the tip there.
    """

    u: Array
    T: Array
    s_m: Array
    paced_m: Array
    wanted_m_s: Array
    q: Array = field(default_factory=lambda: np.empty((0, 0)))


class Track:
    """A way through samples, smooth between them, by a law of time."""

    def __init__(self, samples: Samples, law: TimeLaw, rates: tuple[float, float]) -> None:
        self.samples, self.law, self.rates = samples, law, rates
        self.duration_s = law.duration_s
        T = samples.T
        self._poses = CubicSpline(samples.u, np.concatenate([T[:, :3, 3], quats(T[:, :3, :3])], axis=1))
        self._s_m = CubicSpline(samples.u, samples.s_m)
        self._per_u = self._s_m.derivative()

    @property
    def length_m(self) -> float:
        """Length along the seam."""
        return float(self.samples.s_m[-1])

    @property
    def speeds(self) -> Array:
        """Speed of the parameter at each sample (n,), m/s."""
        at_s = np.linspace(0.0, self.duration_s, 8 * len(self.law.points))
        return np.asarray(np.interp(self.samples.u, self.law.u(at_s), self.law.speed(at_s)))

    def pose(self, t_s: float) -> RigidTransform:
        """Return T_base_tip at a time."""
        values = self._poses(self._u(t_s))
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = _matrix(*(values[3:] / math.sqrt(values[3:] @ values[3:])).tolist()), values[:3]
        return RigidTransform(T, normalize=False, copy=False)

    def along(self, t_s: float) -> tuple[float, float]:
        """Return the length in m, and the speed along it in m/s, at a time."""
        u = self._u(t_s)
        rate = float(self.law.speed(t_s)) if 0.0 < t_s < self.duration_s else 0.0
        return min(max(float(self._s_m(u)), 0.0), self.length_m), max(float(self._per_u(u)) * rate, 0.0)

    def _u(self, t_s: float) -> float:
        return float(self.law.u(min(max(t_s, 0.0), self.duration_s)))


def _matrix(x: float, y: float, z: float, w: float) -> list[list[float]]:
    """Return the rotation of a unit quaternion: by hand, as scipy's takes a tenth of a cycle of 2 ms."""
    return [
        [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - z * w), 2.0 * (x * z + y * w)],
        [2.0 * (x * y + z * w), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - x * w)],
        [2.0 * (x * z - y * w), 2.0 * (y * z + x * w), 1.0 - 2.0 * (x * x + y * y)],
    ]


def quats(R: Array) -> Array:
    """Return the quaternions (n, 4) of rotations (n, 3, 3), each on the side of the one before."""
    out = Rotation.from_matrix(R).as_quat()
    flips = np.where(np.sum(out[1:] * out[:-1], axis=1) < 0.0, -1.0, 1.0)
    out[1:] *= np.cumprod(flips)[:, None]
    return np.asarray(out)
