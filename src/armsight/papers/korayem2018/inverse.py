"""The paper's inverse kinematics of its 6R arm, complete and corrected (MATH 2.2, A6 to A10)."""

from __future__ import annotations

from math import atan2, cos, hypot, pi, sin, sqrt

import numpy as np
from numpy.typing import ArrayLike, NDArray

from armsight.errors import NotEnoughData

Array = NDArray[np.float64]

A1_M, A2_M, A3_M, A4_M = 0.0365, 0.2515, 0.125, 0.092
D1_M, D6_M = 0.438, 0.1528
"""Table 2."""


def solutions(T_base_flange: ArrayLike) -> Array:
    """Return all joint values (n, 6) in rad, n up to 8, that bring the flange to the pose (4, 4).

    At the wrist's and the shoulder's singularity angles that are free come out as atan2 of rounding.
    """
    T = np.asarray(T_base_flange, float)
    W = T[:3, 3] - D6_M * T[:3, 2]
    first = atan2(W[1], W[0])
    found = [q for theta1 in (first, first + pi) for sign in (1.0, -1.0) for q in _branch(T, theta1, sign)]
    return np.array(found).reshape(-1, 6)


def nearest_solution(T_base_flange: ArrayLike, near: ArrayLike) -> Array:
    """Return the solution (6,) nearest to joint values near (6,), whole turns aside. NotEnoughData out of reach."""
    seed = np.asarray(near, float)
    found = solutions(T_base_flange)
    if not len(found):
        raise NotEnoughData("the pose is out of the arm's reach", consequence="It has no joint values")
    off = (found - seed + pi) % (2.0 * pi) - pi
    return np.asarray(seed + off[np.abs(off).max(axis=1).argmin()])


def _branch(T: Array, theta1: float, sign: float) -> list[list[float]]:
    """Return the solutions with this theta1 and this sign of sin theta5: elbow up and down."""
    n, o, a, p = T[:3, 0], T[:3, 1], T[:3, 2], T[:3, 3]
    c1, s1 = cos(theta1), sin(theta1)
    c5 = a[1] * c1 - a[0] * s1
    x6, y6 = n[1] * c1 - n[0] * s1, o[0] * s1 - o[1] * c1
    s5 = sign * hypot(x6, y6)
    theta6, theta234 = atan2(sign * y6, sign * x6), atan2(sign * a[2], -sign * (a[0] * c1 + a[1] * s1))
    wrist = A4_M - D6_M * s5
    t = c1 * p[0] + s1 * p[1] - A1_M - wrist * cos(theta234)
    u = D1_M - p[2] - wrist * sin(theta234)
    Q = t * t + u * u
    within = ((A2_M + A3_M) ** 2 - Q) * (Q - (A2_M - A3_M) ** 2)
    if within < 0.0:
        return []
    out = []
    for elbow in (1.0, -1.0):
        s3 = elbow * sqrt(within) / (2.0 * A2_M * A3_M)
        c3 = (Q - A2_M**2 - A3_M**2) / (2.0 * A2_M * A3_M)
        theta3 = atan2(s3, c3)
        theta2 = atan2(u, t) - atan2(A3_M * s3, A2_M + A3_M * c3)
        out.append([theta1, theta2, theta3, theta234 - theta2 - theta3, atan2(s5, c5), theta6])
    return out
