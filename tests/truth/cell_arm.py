"""Arms of six joints with true lengths and zeros of their own, and their motion, made with numpy alone.

A row of a table is (theta, d, a, alpha, beta): Rz(q + theta) Tz(d) Tx(a) Rx(alpha) Ry(beta).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
DEG = np.pi / 180.0
UR_ALPHA = (90.0, 0.0, 0.0, 90.0, -90.0, 0.0)


def _table(d_mm: tuple[float, ...], a_mm: tuple[float, ...], alpha_deg: tuple[float, ...], theta2_deg: float) -> Array:
    theta = np.array([0.0, theta2_deg, 0.0, 0.0, 0.0, 0.0]) * DEG
    rows = [theta, np.array(d_mm) / 1e3, np.array(a_mm) / 1e3, np.array(alpha_deg) * DEG, np.zeros(6)]
    return np.stack(rows, axis=1)


TABLES = {
    "ur5": _table((89.159, 0, 0, 109.15, 94.65, 82.3), (0, -425, -392.25, 0, 0, 0), UR_ALPHA, 0.0),
    "ur10e": _table((180.7, 0, 0, 174.15, 119.85, 116.55), (0, -612.7, -571.55, 0, 0, 0), UR_ALPHA, 0.0),
    "irb1200": _table((399.1, 0, 0, 351, 0, 82), (0, 350, 42, 0, 0, 0), (-90, 0, -90, 90, -90, 0), -90.0),
}
"""Nominal tables of three arms of three makes, by the makers' data sheets."""
HOMES_DEG = {
    "ur5": ((0, 180), (-90, 35), (90, 35), (-90, 60), (-90, 40), (0, 120)),
    "ur10e": ((0, 180), (-90, 35), (90, 35), (-90, 60), (-90, 40), (0, 120)),
    "irb1200": ((0, 120), (10, 35), (0, 40), (0, 50), (50, 30), (0, 120)),
}
"""Middle and half width of each joint's angle where the work goes on."""
SPREAD_DEG = np.array([14.0, 12.0, 14.0, 30.0, 28.0, 60.0])
"""How far from there the joints go, standard deviation."""
ZERO_DEG, LENGTH_M, ANGLE_DEG = 0.3, 3e-4, 0.03
"""How far arms are off their tables, standard deviations."""
PEAK_OF_REACH = 1.875
"""Peak over mean speed of a reach of least jerk."""


@dataclass(frozen=True, kw_only=True)
class TrueArm:
    """The arm as it is: rows (6, 5); soft_rad: how far joints 2 and 3 give way at full reach."""

    name: str
    rows: Array
    soft_rad: tuple[float, float] = (0.0, 0.0)

    @property
    def reach_m(self) -> float:
        """How far the wrist reaches from joint 2."""
        return float(np.abs(self.rows[1:3, 2]).sum() + abs(self.rows[3, 1]) + abs(self.rows[4, 1]))

    def carry(self, q: Array, points: Array, joints: int = 6) -> Array:
        """Return points (m, 3) of the frame behind so many joints in base axes, at the joints' true angles (m, 6)."""
        out = points
        for (theta, d, a, alpha, beta), value in zip(self.rows[:joints][::-1], q.T[:joints][::-1], strict=True):
            c, s, ca, sa, cb, sb = (f(v) for v in (value + theta, alpha, beta) for f in (np.cos, np.sin))
            x, y, z = out.T
            x, z = cb * x + sb * z, cb * z - sb * x
            x, y, z = x + a, ca * y - sa * z, sa * y + ca * z + d
            out = np.stack([c * x - s * y, s * x + c * y, z], axis=1)
        return out

    def bent(self, q: Array) -> Array:
        """Return the joints' true angles (m, 6) where they are driven to q: joints 2 and 3 give way to the weight."""
        if not any(self.soft_rad):
            return q
        out = q.copy()
        origin, z = np.zeros((len(q), 3)), np.tile([0.0, 0.0, 1.0], (len(q), 1))
        load = self.carry(q, origin)
        for joint, soft in zip((1, 2), self.soft_rad, strict=True):
            at = self.carry(q, origin, joint)
            arm = np.cross(load - at, [0.0, 0.0, -1.0]) / self.reach_m
            out[:, joint] += soft * np.einsum("mi,mi->m", self.carry(q, z, joint) - at, arm)
        return out

    def points(self, q: Array, points: Array) -> Array:
        """Return points (m, 3) of the flange in base axes at readings q (m, 6)."""
        return self.carry(self.bent(q), points)

    def flange(self, q: Array) -> Array:
        """Return T_base_flange (m, 4, 4) at readings q (m, 6)."""
        q = self.bent(np.atleast_2d(q))
        T = np.tile(np.eye(4), (len(q), 1, 1))
        T[:, :3, 3] = self.carry(q, np.zeros((len(q), 3)))
        for i, axis in enumerate(np.eye(3)):
            T[:, :3, i] = self.carry(q, np.tile(axis, (len(q), 1))) - T[:, :3, 3]
        return T


def true_arm(rng: np.random.Generator, name: str) -> TrueArm:
    """Return an arm off its table, but for what base and target stand for: joint 1's zero and d, the last row."""
    rows = TABLES[name].copy()
    size = np.array([ZERO_DEG * DEG, LENGTH_M, LENGTH_M, ANGLE_DEG * DEG, ANGLE_DEG * DEG])
    off = rng.normal(size=(6, 5)) * size
    off[np.abs(np.sin(rows[:, 3])) > 0.1, 4] = 0.0  # beta of nearly parallel axes alone
    off[0, :2] = off[5] = 0.0
    return TrueArm(name=name, rows=rows + off)


def nominal_mapping(name: str) -> dict[str, object]:
    """Return the maker's table as arm.yaml has it."""
    joints = [
        {"name": f"j{i}", "type": "revolute", "a_m": a, "alpha_rad": alpha, "d_m": d, "theta_rad": theta}
        for i, (theta, d, a, alpha, _) in enumerate(TABLES[name].tolist(), 1)
    ]
    limits = {"lower": -2.0 * np.pi, "upper": 2.0 * np.pi}
    joints = [joint | limits for joint in joints]
    return {"format": "armsight/arm", "version": 1, "name": name, "convention": "standard", "joints": joints}


def home(rng: np.random.Generator, arm: TrueArm) -> Array:
    """Return joints (6,) with the flange before the arm, off the floor, and looking away from the base."""
    middle, half = np.array(HOMES_DEG[arm.name], dtype=float).T * DEG
    while True:
        q = middle + rng.uniform(-1.0, 1.0, (200, 6)) * half
        T = arm.flange(q)
        p, z = T[:, :3, 3], T[:, :3, 2]
        outward = np.hypot(p[:, 0], p[:, 1])
        away = (z[:, :2] * p[:, :2]).sum(axis=1) / outward
        fits = (outward > 0.4 * arm.reach_m) & (outward < 0.85 * arm.reach_m) & (p[:, 2] > 0.1) & (away > 0.2)
        fits &= (p[:, 2] < 0.9 * arm.reach_m) & (z[:, 2] > -0.6)
        if fits.any():
            return q[np.flatnonzero(fits)[0]]


@dataclass(frozen=True, kw_only=True)
class Motion:
    """Reaches of least jerk from place to place, some of which overlap: joints (6,) at first, then steps (n, 6)."""

    first: Array
    begin_s: Array
    took_s: Array
    steps: Array

    def __call__(self, t_s: Array) -> Array:
        """Return the joints' angles (m, 6)."""
        s = np.clip((t_s[:, None] - self.begin_s) / self.took_s, 0.0, 1.0)
        return np.asarray(self.first + (s**3 * (10.0 - 15.0 * s + 6.0 * s**2)) @ self.steps)

    def rests(self, least_s: float) -> Array:
        """Return the middles (k,) of rests of at least so long."""
        end = np.maximum.accumulate(self.begin_s + self.took_s)[:-1]
        long = self.begin_s[1:] - end >= least_s
        return np.asarray(0.5 * (self.begin_s[1:] + end)[long])

    def without(self, joint: int) -> Motion:
        """Return it with one joint still."""
        steps = self.steps.copy()
        steps[:, joint] = 0.0
        return replace(self, steps=steps)


def around(rng: np.random.Generator, middle: Array, seen: Callable[[Array], NDArray[np.bool_]], n: int = 4000) -> Array:
    """Return joints (k, 6) about the middle where the target is seen."""
    q = middle + rng.normal(size=(n, 6)) * SPREAD_DEG * DEG
    return np.asarray(q[seen(q)])


def motion(
    rng: np.random.Generator,
    places: Array,
    seen: Callable[[Array], NDArray[np.bool_]],
    begin_s: float,
    end_s: float,
    *,
    rest_s: tuple[float, float] = (0.2, 1.0),
    resting: float = 0.4,
) -> Motion:
    """Return a motion through places (k, 6); of the ways between them at least a half is seen where that can be."""
    first = here = places[0]
    begin, took, steps = [], [], []
    t = begin_s
    between = np.linspace(0.0, 1.0, 7)[1:-1, None, None]
    while t < end_s:
        goals = places[rng.choice(len(places), min(24, len(places)), replace=False)]
        inside = seen((here + between * (goals - here)).reshape(-1, 6)).reshape(len(between), -1).mean(axis=0)
        goal = goals[np.argmax(np.minimum(inside, 0.5) + 0.1 * rng.random(len(goals)) * (goals != here).any(axis=1))]
        step = goal - here
        T = max(PEAK_OF_REACH * float(np.abs(step).max()) / rng.uniform(0.35, 0.9), 0.8)
        begin.append(t)
        took.append(T)
        steps.append(step)
        t += T + (rng.uniform(*rest_s) if rng.random() < resting else -0.15 * T)
        here = goal
    return Motion(first=first, begin_s=np.array(begin), took_s=np.array(took), steps=np.array(steps))


@dataclass(frozen=True, kw_only=True)
class JointDrift:
    """How the arm strays from its encoders: slow sines of each joint, rad; added to the motion."""

    size: Array
    period_s: Array
    phase: Array

    def __call__(self, t_s: Array) -> Array:
        """Return what is to be added to the joints (m, 6)."""
        return np.asarray(
            (self.size * np.sin(2.0 * np.pi * t_s[:, None, None] / self.period_s + self.phase)).sum(axis=1)
        )


def wander(rng: np.random.Generator, arm: TrueArm) -> JointDrift:
    """Return a straying of about 0.03 mm at the tool."""
    size = np.abs(rng.normal(0.0, 1.5e-5 / max(arm.reach_m, 0.5), (4, 6)))
    return JointDrift(size=size, period_s=rng.uniform(3.0, 30.0, (4, 6)), phase=rng.uniform(0.0, 2.0 * np.pi, (4, 6)))
