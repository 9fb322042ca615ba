"""Compiled parts of the closed-form start: many small rotations at once."""

from __future__ import annotations

from math import sqrt

import numpy as np

from armsight._numba import kernel
from armsight.geometry.kernels import rotation_from_rotvec, rotvec_of


@kernel
def matrices_of(rotvecs, R):
    """Fill R (n, 3, 3) with Exp of the rotation vectors (n, 3)."""
    for i in range(rotvecs.shape[0]):
        rotation_from_rotvec(rotvecs[i], R[i])


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
