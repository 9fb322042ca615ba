"""Korayem et al. 2018: a LED's place by thresholding, places from parallel cameras, the arm's inverse kinematics."""

from __future__ import annotations

from math import atan2, cos, hypot, pi, sin, sqrt

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import ndimage

from armsight.arrays import Array
from armsight.errors import Degenerate, NotEnoughData

HALF_PX = 14
"""Half of the window about the LED."""

FAINTEST = 30.0
"""Levels by which the window's brightest pixel must exceed its median to be a LED's; the paper names none."""


def led_centroid(image: NDArray[np.uint8], near_px: ArrayLike) -> Array:
    """Return the mean place (2,) in px, u then v, of the bright area about near_px (2,) in a grey image.

    The area holds the window's brightest pixel, and its pixels are above the middle between that and the median. Raises
    NotEnoughData where nothing is bright.
    """
    u, v = np.rint(np.asarray(near_px, float)).astype(int)
    top, left = max(v - HALF_PX, 0), max(u - HALF_PX, 0)
    window = image[top : v + HALF_PX + 1, left : u + HALF_PX + 1].astype(float)
    ground = float(np.median(window)) if window.size else 0.0
    peak = float(window.max(initial=0.0))
    if peak - ground < FAINTEST:
        raise NotEnoughData(
            f"no pixel about ({u}, {v}) is {FAINTEST:g} levels above its surroundings",
            consequence="The LED has no place",
        )
    labels, _ = ndimage.label(window > 0.5 * (peak + ground), structure=np.ones((3, 3)))
    rows, columns = np.nonzero(labels == labels[np.unravel_index(int(window.argmax()), window.shape)])
    return np.array([left + columns.mean(), top + rows.mean()])


def triangulate_parallel(focal_m: float, baseline_m: float, uv1_m: ArrayLike, uv2_m: ArrayLike) -> Array:
    """Return the points (n, 3) for parallel axes, sensors at x = -B/2 (first) and +B/2: eq. (10) with MATH A17.

    Z counts from the sensor plane, so that Z - F = B F / (u2 - u1) (the sensor is inverted, u1 - u2 < 0).
    Raises Degenerate where the disparity is zero.
    """
    (u1, v1), (u2, v2) = np.atleast_2d(uv1_m).astype(float).T, np.atleast_2d(uv2_m).astype(float).T
    disparity = u1 - u2
    if (disparity == 0.0).any():
        raise Degenerate("the rays of a pair are parallel", consequence="Their point is at infinity")
    Z = focal_m - baseline_m * focal_m / disparity
    scale = (focal_m - Z) / focal_m
    return np.stack([scale * u1 - 0.5 * baseline_m, scale * 0.5 * (v1 + v2), Z], axis=-1)


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
