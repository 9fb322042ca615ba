"""From the joints' axes in space to Denavit-Hartenberg parameters (MATH 4.5, Hartenberg and Denavit, Hayati 1983)."""

from __future__ import annotations

from dataclasses import dataclass
from math import atan2, cos, hypot, pi, sin

import numpy as np
from numpy.typing import ArrayLike

from armsight.arrays import Array
from armsight.errors import Inconsistent

PARALLEL_SINE = 1e-12
"""Axes that differ by less are parallel to rounding: their common normal would be noise, and 1e-12 rad is nothing."""

HAYATI_SINE = 0.02
"""Below this angle (about one degree) d of the common normal runs away, so a turn beta about y takes its place."""

SAME_LINE_M = 1e-12
"""Lines closer than this coincide: the direction of their normal is free."""

UNIT_TOLERANCE = 1e-6
"""An axis whose length differs from one by more is not a direction."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Link:
    """Rz(theta) Tz(d) Tx(a) Rx(alpha) Ry(beta) from one axis to the next; case says which formulas gave it."""

    theta_rad: float
    d_m: float
    a_m: float
    alpha_rad: float
    beta_rad: float
    case: str

    def matrix(self) -> Array:
        """Return the step as a (4, 4) matrix."""
        c, s = cos(self.theta_rad), sin(self.theta_rad)
        ca, sa, cb, sb = cos(self.alpha_rad), sin(self.alpha_rad), cos(self.beta_rad), sin(self.beta_rad)
        turn = np.array([[c, -s, 0, 0], [s, c, 0, 0], [0, 0, 1, self.d_m], [0, 0, 0, 1.0]])
        link = np.array([[cb, 0, sb, self.a_m], [sa * sb, ca, -sa * cb, 0], [-ca * sb, sa, ca * cb, 0], [0, 0, 0, 1.0]])
        return np.asarray(turn @ link)


def link_to_line(
    T: ArrayLike, point_m: ArrayLike, direction: ArrayLike, *, x_hint: ArrayLike | None = None, prismatic: bool = False
) -> Link:
    """Return the link whose far z axis is the line (point, direction), seen from the frame T (4, 4) at its near axis.

    point_m (3,), direction (3,) of unit length and T are in the same axes. x_hint (3,): the side to which the far x
    axis should point (its sign is free) and its direction where the lines coincide; default the x axis of T.
    prismatic: the far joint is, whose place is free; the line is then put through the origin of T (a = d = 0).
    For parallel axes d is free and taken as that of the point. Raises Inconsistent for a direction not of unit length.
    MATH 4.5 and C7.
    """
    frame = np.asarray(T, float)
    R, o = frame[:3, :3], frame[:3, 3]
    v = R.T @ unit_direction(direction)  # (3,) in the near frame
    p = np.zeros(3) if prismatic else R.T @ (np.asarray(point_m, float) - o)
    hint = np.array([1.0, 0.0, 0.0]) if x_hint is None else R.T @ np.asarray(x_hint, float)
    sine = hypot(v[0], v[1])
    if sine <= PARALLEL_SINE:
        return _parallel(p, v, hint)
    if sine < HAYATI_SINE and not prismatic:
        return _hayati(p, v, hint)
    n = np.array([-v[1], v[0], 0.0]) / sine  # z x v
    if n @ hint < 0.0:
        n = -n
    cz = v[2]
    d = (p[2] - (p @ v) * cz) / sine**2
    t = (p[2] * cz - p @ v) / sine**2
    a = float((p + t * v - np.array([0.0, 0.0, d])) @ n)
    alpha = atan2(v[0] * n[1] - v[1] * n[0], cz)  # (z x v) . x, z . v
    case = "prismatic" if prismatic else ("intersecting" if abs(a) < SAME_LINE_M else "skew")
    return Link(theta_rad=atan2(n[1], n[0]), d_m=float(d), a_m=a, alpha_rad=alpha, beta_rad=0.0, case=case)


def _parallel(p: Array, v: Array, hint: Array) -> Link:
    """Return the link to a parallel line: x along the common normal, d that of the point given."""
    a = hypot(p[0], p[1])
    if a > SAME_LINE_M:
        n, case = np.array([p[0], p[1]]) / a, "parallel"
        if n @ hint[:2] < 0.0:
            n, a = -n, -a
    else:
        side = hint[:2] if hypot(hint[0], hint[1]) > PARALLEL_SINE else np.array([1.0, 0.0])
        n, a, case = side / hypot(side[0], side[1]), 0.0, "coincident"
    alpha = 0.0 if v[2] > 0.0 else pi
    return Link(theta_rad=atan2(n[1], n[0]), d_m=float(p[2]), a_m=a, alpha_rad=alpha, beta_rad=0.0, case=case)


def _hayati(p: Array, v: Array, hint: Array) -> Link:
    """Return the link to a nearly parallel line with d = 0 and a turn beta."""
    foot = p - (p[2] / v[2]) * v  # where the line meets the near frame's x-y plane
    a = hypot(foot[0], foot[1])
    theta = atan2(foot[1], foot[0]) if a > SAME_LINE_M else atan2(hint[1], hint[0])
    a = a if a > SAME_LINE_M else 0.0
    if cos(theta) * hint[0] + sin(theta) * hint[1] < 0.0:
        theta, a = theta + pi if theta <= 0.0 else theta - pi, -a
    c, s = cos(theta), sin(theta)
    wx, wy = c * v[0] + s * v[1], -s * v[0] + c * v[1]
    # z of Rx(alpha) Ry(beta) is (sin beta, -sin alpha cos beta, cos alpha cos beta)
    alpha = atan2(-wy, v[2])
    beta = atan2(wx, hypot(wy, v[2]))
    return Link(theta_rad=theta, d_m=0.0, a_m=a, alpha_rad=alpha, beta_rad=beta, case="nearly parallel")


def unit_direction(direction: ArrayLike, what: str = "the axis") -> Array:
    """Return the direction (3,) at exactly unit length; Inconsistent where it is far from that."""
    v = np.asarray(direction, float)
    length = float(np.linalg.norm(v)) if v.shape == (3,) else float("nan")
    if not abs(length - 1.0) <= UNIT_TOLERANCE:
        raise Inconsistent(
            f"{what}, {v.tolist()}, has length {length:.6g}, not 1",
            consequence="Its direction, and the scale of what moves along it, cannot be trusted",
            cure="Give a unit vector",
        )
    return np.asarray(v / length)
