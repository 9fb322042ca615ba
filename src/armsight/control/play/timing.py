"""When a way is where: as fast as the limits of joints and tool allow, all along, from rest to rest.

In two steps. The law under limits of speed and acceleration comes from a reachability analysis (kernels); a cubic
B-spline takes it over as its control points, which bounds the jerk. The motion that comes of it is then held against
all limits as the guard does, by differences from moment to moment, and slowed where it exceeds one, until none is.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BSpline, CubicSpline
from scipy.ndimage import maximum_filter1d
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.arrays import Array
from armsight.control.guard.kernels import BELOW_ACCELERATION
from armsight.control.guard.limits import JointBounds, Limits
from armsight.control.play.kernels import reachable_speeds
from armsight.geometry import pose_difference
from armsight.kinematics import Arm, fk_jacobian

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

    def along(self, t_s: float) -> tuple[float, float]:
        """Return the length in m, and the speed along it in m/s, at a time."""


class StraightSegment:
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


SPEED_SHARE, ACCELERATION_SHARE, JERK_SHARE = 0.95, 0.7, 0.7
"""Of the limits, which a plan uses: the guard keeps 3 % of each back, and the rest is for pauses and overrides."""
RATE_SHARES = (0.2, 0.1, 0.1)
"""Of the limits of acceleration, and twice of jerk, for changes of the rate at which a plan's time passes."""
REMOVAL = 1.75
"""Times as long as at the guard's least jerk an acceleration is taken to last once the arm is to brake: joints that
brake together wait for the last one. Without it 1 path of 90 met a set point behind which no way to rest kept the
speed: a weave that gathered speed at 0.84 of the limit; at 1.5, with cycles of 20 ms, 1 of 190."""
MOST_RATES = (10.0, 500.0)
"""1/s and 1/s^2: a plan so slow that limits allow more comes to rest in a tenth of a second."""
SMOOTHING = 1.6
"""Control points are so many times acceleration / jerk apart: a swing from one limit to the other takes two spans."""
SAMPLES_A_SPAN = 8
ROUNDS = 15
"""Of slowing; what is left after so many slows the whole way."""
CLOSE = 1.005
"""An excess that is left to slowing the whole way: half a per cent of its time."""
LEAST_B = 1e-14
"""(0.1 um/s)^2: keeps times finite."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Ceilings:
    """What a plan may use of limits (m,): joints, the tip's position, its turning; starts (m,): first columns."""

    starts: NDArray[np.intp]
    speed: Array
    acceleration: Array
    jerk: Array

    @classmethod
    def of(cls, limits: Limits, bounds: JointBounds) -> Ceilings:
        """Return the shares of the limits."""
        n = len(bounds.speed)
        return cls(
            starts=np.array([*range(n), n, n + 3]),
            speed=SPEED_SHARE * np.array([*bounds.speed, limits.speed_m_s, limits.turn_rad_s]),
            acceleration=np.array([*bounds.acceleration, limits.acceleration_m_s2, limits.turn_acceleration_rad_s2]),
            jerk=np.array([*bounds.jerk, limits.jerk_m_s3, limits.turn_jerk_rad_s3]),
        )

    def dot(self, a: Array, b: Array) -> Array:
        """Return the products (k, m) of values' columns (k, columns)."""
        return np.asarray(np.add.reduceat(a * b, self.starts, axis=1))

    def sizes(self, a: Array) -> Array:
        """Return the sizes (k, m) of values' columns (k, columns)."""
        return np.asarray(np.sqrt(self.dot(a, a)))


def timed(samples: Samples, arm: Arm, limits: Limits, bounds: JointBounds) -> tuple[TimeLaw, tuple[float, float]]:
    """Return the law by which a way is gone along, and how fast the rate of its time may change."""
    ceilings, u = Ceilings.of(limits, bounds), samples.u
    values = CubicSpline(u, np.concatenate([samples.q, samples.T[:, :3, 3], turned(samples.T)], axis=1))
    seam = CubicSpline(u, samples.paced_m)
    first, second, third = (values(u, k) for k in (1, 2, 3))
    products = (ceilings.dot(first, first), ceilings.dot(first, second), ceilings.dot(second, second))
    fastest = _fastest(samples, seam, ceilings, products[0], ceilings.sizes(third))
    brake = CubicSpline(u, _brake_share(arm, samples.q, limits, bounds))
    span_s = _span_s(ceilings, float(samples.wanted_m_s.max()))
    stretch = np.ones(len(u))
    for _ in range(ROUNDS):
        b = np.empty(len(u))
        most = ACCELERATION_SHARE * ceilings.acceleration / stretch[:, None] ** 2
        reachable_speeds(*products, most, fastest / stretch**2, u[1] - u[0], b)
        law = _law(u, b, span_s)
        at_u, excess, used = _excess(law, (values, seam, brake), samples, ceilings)
        if excess.max() <= CLOSE:
            break
        # a moment's motion hangs on four control points: all that were gone along in their time go slower
        spread = maximum_filter1d(np.maximum(excess, 1.0), 4 * SAMPLES_A_SPAN + 1, mode="nearest")
        stretch *= np.interp(u, at_u, spread)
    law = law.slowed(max(1.0, float(excess.max())))
    return law, _rates(ceilings, used)


def turned(T: Array) -> Array:
    """Return the sums (n, 3) of the rotation vectors from each of poses (n, 4, 4) to the next, rad in base axes."""
    R = Rotation.from_matrix(T[:, :3, :3])
    return np.concatenate([np.zeros((1, 3)), np.cumsum((R[1:] * R[:-1].inv()).as_rotvec(), axis=0)])


def _fastest(samples: Samples, seam: CubicSpline, ceilings: Ceilings, first2: Array, third: Array) -> Array:
    """Return the largest u'^2 (n,) at each place by itself: speeds, and the jerk of what bends the more the faster."""
    with np.errstate(divide="ignore"):
        by_speed = (ceilings.speed**2 / first2).min(axis=1)
        by_jerk = (np.cbrt(JERK_SHARE * ceilings.jerk / third) ** 2).min(axis=1)
        asked = (samples.wanted_m_s / np.linalg.norm(seam(samples.u, 1), axis=1)) ** 2
    return np.asarray(np.minimum.reduce([by_speed, by_jerk, asked]))


def _span_s(ceilings: Ceilings, wanted_m_s: float) -> float:
    """Return the time between control points, in which the acceleration swings; never as far where speed is less."""
    speed = ceilings.speed.copy()
    speed[-2] = min(speed[-2], wanted_m_s)
    reached = np.minimum(ceilings.acceleration, np.sqrt(speed * ceilings.jerk))
    return float(SMOOTHING * (reached / ceilings.jerk).max())


def _law(u: Array, b: Array, span_s: float) -> TimeLaw:
    """Return the law whose control points are where u'^2 = b (n,), even u'' between places, has come to."""
    squares = np.maximum(b, LEAST_B)
    t = np.concatenate([[0.0], np.cumsum(2.0 * np.diff(u) / (np.sqrt(squares[1:]) + np.sqrt(squares[:-1])))])
    at = np.arange(0.0, t[-1], span_s)
    i = np.clip(np.searchsorted(t, at, side="right") - 1, 0, len(u) - 2)
    since = at - t[i]
    gone = u[i] + np.sqrt(squares[i]) * since + 0.25 * (squares[i + 1] - squares[i]) / (u[1] - u[0]) * since**2
    return TimeLaw(span_s, np.concatenate([[0.0, 0.0], np.clip(gone, 0.0, u[-1]), np.full(3, u[-1])]))


def _brake_share(arm: Arm, q: Array, limits: Limits, bounds: JointBounds) -> Array:
    """Return the share (n,) of their jerk with which the guard brakes joints at readings q (n, joints) at the least."""
    J = fk_jacobian(arm, arm.values(q))[1]
    J = J @ arm.gearing if arm.couplings else J
    apart = np.linalg.norm(J.reshape(len(q), 2, 3, -1), axis=2) @ bounds.jerk  # of tip and turning, all joints at once
    most = np.array([limits.jerk_m_s3, limits.turn_jerk_rad_s3])
    return np.asarray(np.minimum(1.0, BELOW_ACCELERATION / (apart / most).max(axis=1)))


def _excess(
    law: TimeLaw, by_u: tuple[CubicSpline, CubicSpline, CubicSpline], samples: Samples, ceilings: Ceilings
) -> tuple[Array, Array, list[Array]]:
    """Return the parameter at moments (k,), how much too fast the motion is there (k,), and the largest derivatives.

    By so much time has to pass more slowly: 1 where a limit is just kept. by_u: values, the seam, _brake_share.
    """
    u, (values, seam, brake) = samples.u, by_u
    at_s = np.linspace(0.0, law.duration_s, SAMPLES_A_SPAN * (len(law.points) - 3) + 1)
    at_u = np.concatenate([np.zeros(3), law.u(at_s), np.full(3, u[-1])])  # at rest before and behind
    dt = at_s[1]
    moved = values(np.clip(at_u, 0.0, u[-1]))
    excess = np.zeros(len(at_u))
    used = []
    limits = (ceilings.speed, ACCELERATION_SHARE * ceilings.acceleration, JERK_SHARE * ceilings.jerk)
    for order, most in enumerate(limits, 1):
        before, moved = moved, np.diff(moved, axis=0) / dt
        size = ceilings.sizes(moved)
        used.append(size.max(axis=0))
        times = (size / most).max(axis=1) ** (1.0 / order)
        if order == 2:
            lasts_s = REMOVAL * (size / ceilings.jerk)[:, :-2].max(axis=1) / brake(at_u[1:-1])
            times = np.maximum(times, _peaks(ceilings, before[1:], moved, lasts_s))
        here = slice(order // 2, order // 2 + len(times))
        excess[here] = np.maximum(excess[here], times)
    along = np.linalg.norm(np.diff(seam(np.clip(at_u, 0.0, u[-1])), axis=0), axis=1) / dt
    asked = np.interp(at_u, u, samples.wanted_m_s)
    excess[1:] = np.maximum(excess[1:], along / np.minimum(asked[1:], asked[:-1]))
    return at_u, excess, used


def _peaks(ceilings: Ceilings, velocity: Array, acceleration: Array, lasts_s: Array) -> Array:
    """Return the share (k,) of the limits of speed that is reached while accelerations (k, columns) are taken away.

    A way to rest that begins at a moment first has to do that, in lasts_s (k,), and speed grows meanwhile.
    """
    speed = ceilings.sizes(velocity)
    growing = np.maximum(ceilings.dot(velocity, acceleration), 0.0) / np.maximum(speed, 1e-12)
    return np.asarray(((speed + 0.5 * growing * lasts_s[:, None]) / ceilings.speed).max(axis=1))


def _rates(ceilings: Ceilings, used: list[Array]) -> tuple[float, float]:
    """Return how fast the rate r of time may change: q'' r^2 + q' r' and q''' r^3 + 3 q'' r r' + q' r'' keep limits."""
    speed, acceleration = (np.maximum(value, 1e-12) for value in used[:2])
    by_acceleration = RATE_SHARES[0] * ceilings.acceleration / speed
    by_jerk = RATE_SHARES[1] * ceilings.jerk / (3.0 * acceleration)
    change = RATE_SHARES[2] * ceilings.jerk / speed
    return (
        float(min(MOST_RATES[0], by_acceleration.min(), by_jerk.min())),
        float(min(MOST_RATES[1], change.min())),
    )
