"""A smooth motion of the joints through given places, as quick as joints and tool may be, or slower."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicHermiteSpline
from scipy.ndimage import uniform_filter1d
from scipy.spatial.transform import Rotation

from armsight.arrays import Array
from armsight.kinematics import Arm, fk
from armsight.records import Motion

PARTS = 3
"""Pieces of a straight way between two places; the curve leaves it by a sixth of what its ends' pieces are apart."""
GRID = 12
"""Points of a piece at which the way is looked at."""
SHARE = 0.9
"""Of the limits of speed and acceleration that is used: the guard keeps a reserve of its own."""
NORM = 8
"""Power in which the joints' and the tool's shares of their limits add up: nearly the largest, without its corners."""
SOFTENED_S = 0.1
"""Time over which accelerations begin, twice after one another."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MotionBounds:
    """What a motion keeps: lower, upper, speed, acceleration (n,) of the joints' readings, and those of the tool."""

    lower: Array
    upper: Array
    speed: Array
    acceleration: Array
    speed_m_s: float
    turn_rad_s: float
    acceleration_m_s2: float
    turn_acceleration_rad_s2: float

    def within(self, q: Array) -> NDArray[np.bool_]:
        """Return which readings (m, n) are between the limits."""
        return np.asarray(((q >= self.lower) & (q <= self.upper)).all(axis=-1))

    def apart_s(self, a: Array, b: Array) -> Array:
        """Return how long the joints take from a (..., n) to b (..., n) at full speed."""
        return np.asarray((np.abs(b - a) / self.speed).max(axis=-1))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Way:
    """A smooth way of the joints: control points (k, n), and how far along it (m,) of them it is at times t_s (m,).

    rate (m,): how fast that grows. It takes t_s[-1] and begins and ends at rest.
    """

    control: Array
    t_s: Array
    u: Array
    rate: Array

    @property
    def least_s(self) -> float:
        """The time it takes at the limits, with the moments at rest before and after."""
        return float(self.t_s[-1]) + 4.0 * SOFTENED_S

    def motion(self, duration_s: float, rate_hz: float) -> Motion:
        """Return it as a motion of a duration, no less than least_s, in steps of a controller's rate."""
        t = np.arange(int(duration_s * rate_hz) + 1) / rate_hz
        along = CubicHermiteSpline(self.t_s, self.u, self.rate)
        # it rests for as long at both ends as softening spreads a motion
        moving = np.clip((t - 2.0 * SOFTENED_S) / (t[-1] - 4.0 * SOFTENED_S), 0.0, 1.0)
        u = np.clip(along(moving * self.t_s[-1]), 0.0, self.u[-1])
        q = _curve(self.control, u)
        width = 1 + 2 * int(0.5 * SOFTENED_S * rate_hz)
        for _ in range(2):
            q = uniform_filter1d(q, width, axis=0, mode="nearest")
        return Motion(t_s=t, q=q)


def way_through(arm: Arm, places: Array, bounds: MotionBounds, *, parts: int = PARTS) -> Way:
    """Return the quickest smooth way through places (k, n), k > 1; the more parts, the nearer to straight ways.

    Where it turns it does not quite reach them.
    """
    share = np.arange(parts)[:, None] / parts
    control = np.concatenate([a + share * (b - a) for a, b in pairwise(places)])
    # ends three times over: the curve begins and ends in them
    control = np.concatenate([control[:1], control[:1], control, *[places[-1:]] * 3])
    last = len(control) - 3.0
    # a first walk along it tells how long each stretch is, by the limits of speed
    u = np.linspace(0.0, last, int(GRID * last) + 1)
    s = np.concatenate([[0.0], np.cumsum(_lengths(arm, _curve(control, u), bounds))])
    s_even = np.linspace(0.0, s[-1], len(u))
    u = np.interp(s_even, s, u)
    t, v = _timed(arm, _curve(control, u), s_even[1], bounds)
    keep = np.concatenate([[True], np.diff(t) > 1e-9])
    slope = np.gradient(u, s_even)
    return Way(control=control, t_s=t[keep], u=u[keep], rate=(slope * v)[keep])


def _curve(control: Array, u: Array) -> Array:
    """Return the uniform cubic B-spline of control points (k, n) at u (m,) from 0 to k - 3."""
    i = np.minimum(u.astype(np.intp), len(control) - 4)
    f = (u - i)[:, None]
    P = [control[i + k] for k in range(4)]
    weights = (
        (1.0 - f) ** 3,
        3.0 * f**3 - 6.0 * f**2 + 4.0,
        -3.0 * f**3 + 3.0 * f**2 + 3.0 * f + 1.0,
        f**3,
    )
    return np.asarray(sum(w * p for w, p in zip(weights, P, strict=True)) / 6.0)


def _steps(arm: Arm, q: Array) -> tuple[Array, Array]:
    """Return by how much the tool moves (m - 1, 3) and turns (m - 1, 3) between rows."""
    T = fk(arm, arm.values(q))
    R = Rotation.from_matrix(T[:, :3, :3])
    return np.diff(T[:, :3, 3], axis=0), (R[1:] * R[:-1].inv()).as_rotvec()


def _lengths(arm: Arm, q: Array, bounds: MotionBounds) -> Array:
    """Return the time (m - 1,) from row to row at the limits of speed."""
    moved, turned = _steps(arm, q)
    shares = [
        np.abs(np.diff(q, axis=0)) / bounds.speed,
        np.linalg.norm(moved, axis=1, keepdims=True) / bounds.speed_m_s,
        np.linalg.norm(turned, axis=1, keepdims=True) / bounds.turn_rad_s,
    ]
    return np.asarray((np.concatenate(shares, axis=1) ** NORM).sum(axis=1) ** (1.0 / NORM) / SHARE)


def _timed(arm: Arm, q: Array, ds: float, bounds: MotionBounds) -> tuple[Array, Array]:
    """Return times (m,) and speeds (m,) along the way at rows ds apart, by the limits of acceleration.

    q'' = slope s'' + bend s'^2: each of the two may take half of what is allowed (Bobrow, Dubowsky, Gibson 1985).
    """
    moved, turned = _steps(arm, q)
    most = 0.5 * SHARE * np.array([*bounds.acceleration, bounds.acceleration_m_s2, bounds.turn_acceleration_rad_s2])
    slope = [np.diff(q, axis=0) / ds, moved / ds, turned / ds]
    bend = [np.diff(part, axis=0) / ds for part in slope]
    sizes = [_sizes(*part) / most for part in (slope, bend)]
    m = len(q)
    gain = 1.0 / np.maximum(sizes[0].max(axis=1), 1e-9)
    square = np.ones(m)
    square[1:-1] = np.minimum(1.0, 1.0 / np.maximum(sizes[1].max(axis=1), 1e-9))
    # a step of the grid is no sharper than its neighbours let it be
    square[1:-1] = np.minimum(square[1:-1], np.minimum(square[:-2], square[2:]))
    square[0] = square[-1] = 0.0
    # forth and back: what is reached by speeding up, and what still stops in time
    z = square.tolist()
    for i in range(m - 1):
        z[i + 1] = min(z[i + 1], z[i] + 2.0 * gain[i] * ds)
    for i in range(m - 1, 0, -1):
        z[i - 1] = min(z[i - 1], z[i] + 2.0 * gain[i - 1] * ds)
    v = np.sqrt(np.array(z))
    return np.concatenate([[0.0], np.cumsum(2.0 * ds / np.maximum(v[1:] + v[:-1], 1e-9))]), v


def _sizes(joints: Array, moved: Array, turned: Array) -> Array:
    return np.column_stack([np.abs(joints), np.linalg.norm(moved, axis=1), np.linalg.norm(turned, axis=1)])
