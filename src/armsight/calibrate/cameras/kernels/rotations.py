"""Compiled parts of the closed-form start: many small rotations at once."""

from __future__ import annotations

from math import atan2, sqrt

import numpy as np

from armsight._numba import kernel
from armsight.geometry.kernels import rotation_from_rotvec


@kernel
def matrices_of(rotvecs, R):
    """Fill R (n, 3, 3) with Exp of the rotation vectors (n, 3)."""
    for i in range(rotvecs.shape[0]):
        rotation_from_rotvec(rotvecs[i], R[i])


@kernel
def rotvec_of(R, w):
    """Fill w (3,) with the rotation vector of R (3, 3), by the largest entry of the quaternion (Shepperd 1978)."""
    trace = R[0, 0] + R[1, 1] + R[2, 2]
    best, index = trace, 3
    for i in range(3):
        if R[i, i] > best:
            best, index = R[i, i], i
    q = np.empty(4)
    if index == 3:
        q[0], q[1], q[2] = R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]
        q[3] = 1.0 + trace
    else:
        i, j, k = index, (index + 1) % 3, (index + 2) % 3
        q[i] = 1.0 + 2.0 * R[i, i] - trace
        q[j] = R[j, i] + R[i, j]
        q[k] = R[k, i] + R[i, k]
        q[3] = R[k, j] - R[j, k]
    s = sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2])
    angle = 2.0 * atan2(s, abs(q[3]))
    f = (angle / s if s > 0.0 else 0.0) * (1.0 if q[3] >= 0.0 else -1.0)
    for m in range(3):
        w[m] = f * q[m]


@kernel
def poses_of(H, fx, fy, poses):
    """Fill poses (G, 6), T_camera_board as (t m, rotation vector), from homographies H (G, 3, 3) and focal lengths.

    The homographies' pixels count from the principal point in the same unit as fx, fy. The first two columns of the
    rotation are turned apart, or together, by equal shares until they stand upright on each other.
    """
    R = np.empty((3, 3))
    for g in range(H.shape[0]):
        n1 = 0.0
        n2 = 0.0
        for m in range(3):
            f = fx if m == 0 else (fy if m == 1 else 1.0)
            R[m, 0], R[m, 1], R[m, 2] = H[g, m, 0] / f, H[g, m, 1] / f, H[g, m, 2] / f
            n1 += R[m, 0] ** 2
            n2 += R[m, 1] ** 2
        n1, n2 = sqrt(n1), sqrt(n2)
        scale = 2.0 / (n1 + n2)
        if R[2, 2] < 0.0:
            scale = -scale
        plus = 0.0
        minus = 0.0
        for m in range(3):
            poses[g, m] = scale * R[m, 2]
            a, b = R[m, 0] / n1, R[m, 1] / n2
            R[m, 0], R[m, 1] = a + b, a - b  # upright on each other whatever a and b
            plus += (a + b) ** 2
            minus += (a - b) ** 2
        plus, minus = sqrt(0.5) / sqrt(plus), sqrt(0.5) / sqrt(minus)
        sign = 1.0 if scale > 0.0 else -1.0
        for m in range(3):
            c, d = plus * R[m, 0], minus * R[m, 1]
            R[m, 0], R[m, 1] = sign * (c + d), sign * (c - d)
        R[0, 2] = R[1, 0] * R[2, 1] - R[2, 0] * R[1, 1]
        R[1, 2] = R[2, 0] * R[0, 1] - R[0, 0] * R[2, 1]
        R[2, 2] = R[0, 0] * R[1, 1] - R[1, 0] * R[0, 1]
        rotvec_of(R, poses[g, 3:])
