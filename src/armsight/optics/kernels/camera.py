"""Compiled projection with Brown-Conrady distortion, by OpenCV's rational model or through a fisheye, and derivatives.

A camera's intrinsics travel as one vector k (10,): fx, fy, cx, cy, skew, k1, k2, p1, p2, k3; of a view through a glass
plate with the plate's thickness (m) and refractive index behind them; as Camera.packed, k (15,), with three zeros more.
Of a fisheye or rational lens see wide.py.
"""

from __future__ import annotations

from math import atan, sqrt
from typing import Any, NamedTuple

import numpy as np

from armsight._numba import inline_kernel, kernel, lean_kernel
from armsight.optics.kernels.wide import (
    NEAR_AXIS,
    RATIONAL,
    UNDISTORT_STEPS,
    UNDISTORT_TOLERANCE,
    decentre,
    distort_wide,
    is_wide,
    rational_radial,
    see_wide,
    undistort_wide,
    wide_of,
)


class CameraK(NamedTuple):
    """A camera as kernels take it: k its vector of intrinsics, R (3, 3) and t (3,) m with p_camera = R p_rig + t."""

    k: Any
    R: Any
    t: Any


class RigK(NamedTuple):
    """Both cameras of a rig, left one first: k (2, 15), R (2, 3, 3), t (2, 3) m; see CameraK and PackedRig.

    Kernels that Python calls take a plain tuple, in the same order, and make this of it: that costs nothing there.
    """

    k: Any
    R: Any
    t: Any


@inline_kernel
def distort_pinhole(k1, k2, p1, p2, k3, x, y):
    """As distort, of a pinhole; within its caller, as a call takes longer than it does."""
    r2 = x * x + y * y
    radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
    slope = k1 + r2 * (2.0 * k2 + 3.0 * r2 * k3)  # d radial / d r2
    return decentre(radial, slope, p1, p2, x, y, r2)


@lean_kernel
def distort(k, x, y):
    """Return the distorted normalised point and its derivative (xx, xy, yy) by (x, y); xy is symmetric."""
    if is_wide(k):
        return distort_wide(wide_of(k), x, y)
    return distort_pinhole(k[5], k[6], k[7], k[8], k[9], x, y)


PLATE_ROUNDS = 4
"""Steps to the ray that meets a point through the plate; each gains a factor of a thousand (shift over depth)."""


@kernel
def plate_shift(thickness, index, U, V):
    """Return mu (m) of MATH 3.1: the ray (U, V, 1) through a plate at 45 degrees seems to start at (-mu, 0, +mu)."""
    c = (1.0 - U) / np.sqrt(2.0 * (1.0 + U * U + V * V))
    return thickness * np.sqrt(0.5) * (1.0 - c / np.sqrt(index * index - 1.0 + c * c))


@lean_kernel
def behind_plate(thickness, index, x, y, z):
    """Return x and z of a point as a pinhole without the plate would have it, whose centre the chief ray points to."""
    chief = plate_shift(thickness, index, 0.0, 0.0)
    shift = 0.0
    for _ in range(PLATE_ROUNDS):
        depth = z - shift
        shift = plate_shift(thickness, index, (x + shift) / depth, y / depth) - chief
    return x + shift, z - shift


@lean_kernel
def project_point(k, x, y, z, uv, J):
    """Fill uv (2,) and J (2, 3) = d uv / d (x, y, z) for a point in camera axes; False where z <= 0.

    False also beyond the angle that a fisheye or rational lens is known to. Through a plate J leaves out how the shift
    changes with the point: a thousandth of J.
    """
    if not z > 0.0:
        return False
    if k.shape[0] > 10 and k[10] > 0.0:
        x, z = behind_plate(k[10], k[11], x, y, z)
    iz = 1.0 / z
    a = x * iz
    b = y * iz
    if is_wide(k):
        seen, xd, yd, dxx, dxy, dyy = see_wide(wide_of(k), a, b)
        if not seen:
            return False
    else:
        xd, yd, dxx, dxy, dyy = distort_pinhole(k[5], k[6], k[7], k[8], k[9], a, b)
    fx, fy, skew = k[0], k[1], k[4]
    uv[0] = fx * xd + skew * yd + k[2]
    uv[1] = fy * yd + k[3]
    ua = fx * dxx + skew * dxy
    ub = fx * dxy + skew * dyy
    va = fy * dxy
    vb = fy * dyy
    # a = x / z, b = y / z: by z they change by -a / z, -b / z
    J[0, 0] = ua * iz
    J[0, 1] = ub * iz
    J[0, 2] = -(ua * a + ub * b) * iz
    J[1, 0] = va * iz
    J[1, 1] = vb * iz
    J[1, 2] = -(va * a + vb * b) * iz
    return True


@lean_kernel
def intrinsics_jacobian(k, x, y, z, D):
    """Fill D (2, 10) = d uv / d intrinsics for a point in camera axes with z > 0; of a rational lens D (2, 13)."""
    a = x / z
    b = y / z
    xd, yd, _, _, _ = distort(k, a, b)
    fx, fy, skew = k[0], k[1], k[4]
    r2 = a * a + b * b
    D[:] = 0.0
    D[0, 0] = xd
    D[1, 1] = yd
    D[0, 2] = 1.0
    D[1, 3] = 1.0
    D[0, 4] = yd
    power = r2
    if is_wide(k) and k[10] == RATIONAL:
        radial, _, over = rational_radial(wide_of(k), r2)
        power *= over
        for j in range(10, 13):  # k4, k5, k6
            D[0, j] = -radial * power * (fx * a + skew * b)
            D[1, j] = -radial * power * fy * b
            power *= r2
        power = over * r2
    elif is_wide(k):
        theta = atan(sqrt(r2))
        power = theta**3 / sqrt(r2) if r2 > NEAR_AXIS else r2
        for j in range(5, 9):
            D[0, j] = fx * a * power + skew * b * power
            D[1, j] = fy * b * power
            power *= theta * theta
        return
    # k1, k2, k3 go with r^2, r^4, r^6; k3 stands behind p1 and p2 (OpenCV's order)
    for j in (5, 6, 9):
        D[0, j] = fx * a * power + skew * b * power
        D[1, j] = fy * b * power
        power *= r2
    px, py = 2.0 * a * b, r2 + 2.0 * b * b  # by p1
    D[0, 7] = fx * px + skew * py
    D[1, 7] = fy * py
    px, py = r2 + 2.0 * a * a, 2.0 * a * b  # by p2
    D[0, 8] = fx * px + skew * py
    D[1, 8] = fy * py


@lean_kernel
def undistort_pinhole(k1, k2, p1, p2, k3, xd, yd):
    """Return whether a distorted normalised point has a ray, found by Newton's iteration, the ray (x, y) and the
    derivative (xx, xy, yy) of the distortion there.
    """
    x = xd
    y = yd
    for _ in range(UNDISTORT_STEPS):
        fx, fy, dxx, dxy, dyy = distort_pinhole(k1, k2, p1, p2, k3, x, y)
        det = dxx * dyy - dxy * dxy
        # the distortion folds over here: beyond, two rays have one pixel
        if not det > 0.0:
            break
        ex = fx - xd
        ey = fy - yd
        x -= (dyy * ex - dxy * ey) / det
        y -= (dxx * ey - dxy * ex) / det
        if abs(ex) + abs(ey) < UNDISTORT_TOLERANCE:
            return True, x, y, dxx, dxy, dyy  # the step was too short to change them
    return False, x, y, 0.0, 0.0, 0.0


@lean_kernel
def ray_of(k, u, v):
    """Return whether a pixel has a ray under this model, the ray (x/z, y/z) and the distortion's derivative there.

    It has none where Newton's iteration does not converge, where the distortion folds over, and beyond the angle that a
    fisheye or rational lens is known to.
    """
    yd = (v - k[3]) / k[1]
    xd = (u - k[2] - k[4] * yd) / k[0]
    if is_wide(k):
        found, x, y, dxx, dxy, dyy = undistort_wide(wide_of(k), xd, yd)
    else:
        found, x, y, dxx, dxy, dyy = undistort_pinhole(k[5], k[6], k[7], k[8], k[9], xd, yd)
    return found and dxx * dyy - dxy * dxy > 0.0 and dxx > 0.0, x, y, dxx, dxy, dyy


@lean_kernel
def undistort_point(k, u, v, xy, J):
    """Fill xy (2,) with the ray (x/z, y/z) of a pixel, J (2, 2) = d xy / d (u, v); False where it has none (ray_of)."""
    found, x, y, dxx, dxy, dyy = ray_of(k, u, v)
    if not found:
        return False
    det = dxx * dyy - dxy * dxy
    xy[0] = x
    xy[1] = y
    # d(xd, yd)/d(u, v) = [[1/fx, -skew/(fx fy)], [0, 1/fy]]
    a = 1.0 / k[0]
    b = -k[4] / (k[0] * k[1])
    c = 1.0 / k[1]
    J[0, 0] = dyy * a / det
    J[0, 1] = (dyy * b - dxy * c) / det
    J[1, 0] = -dxy * a / det
    J[1, 1] = (-dxy * b + dxx * c) / det
    return True


@kernel
def project_many(k, R, t, X, uv):
    """Fill uv (n, 2) with the pixels of points X (n, 3) seen through p_camera = R X + t; NaN where there is none."""
    J = np.empty((2, 3))
    for i in range(X.shape[0]):
        x = R[0, 0] * X[i, 0] + R[0, 1] * X[i, 1] + R[0, 2] * X[i, 2] + t[0]
        y = R[1, 0] * X[i, 0] + R[1, 1] * X[i, 1] + R[1, 2] * X[i, 2] + t[1]
        z = R[2, 0] * X[i, 0] + R[2, 1] * X[i, 1] + R[2, 2] * X[i, 2] + t[2]
        if not project_point(k, x, y, z, uv[i], J):
            uv[i, 0] = np.nan
            uv[i, 1] = np.nan


@kernel
def undistort_many(k, uv, xy):
    """Fill xy (n, 2) with the normalised rays of pixels uv (n, 2); NaN where a pixel has no ray."""
    for i in range(uv.shape[0]):
        found, x, y, _, _, _ = ray_of(k, uv[i, 0], uv[i, 1])
        xy[i, 0] = x if found else np.nan
        xy[i, 1] = y if found else np.nan


@lean_kernel
def see_point(k, R, t, X, uv, J):
    """Fill uv (2,) and J (2, 3) = d uv / d X for a point X (3,) in rig axes, p_camera = R X + t; False behind it."""
    x = R[0, 0] * X[0] + R[0, 1] * X[1] + R[0, 2] * X[2] + t[0]
    y = R[1, 0] * X[0] + R[1, 1] * X[1] + R[1, 2] * X[2] + t[1]
    z = R[2, 0] * X[0] + R[2, 1] * X[1] + R[2, 2] * X[2] + t[2]
    if not project_point(k, x, y, z, uv, J):
        return False
    for i in range(2):
        a, b, c = J[i, 0], J[i, 1], J[i, 2]
        for j in range(3):
            J[i, j] = a * R[0, j] + b * R[1, j] + c * R[2, j]
    return True
