"""Compiled rotation kernels shared by every hot path."""

from __future__ import annotations

from math import cos, sin, sqrt

import numpy as np

from armsight._numba import inner_kernel


@inner_kernel
def rotation_from_rotvec(w, R):
    """Fill R (3, 3) with Exp of the rotation vector w (3,) in radians (Rodrigues)."""
    t2 = w[0] * w[0] + w[1] * w[1] + w[2] * w[2]
    t = sqrt(t2)
    if t < 1e-6:
        a = 1.0 - t2 / 6.0
        b = 0.5 - t2 / 24.0
    else:
        a = sin(t) / t
        b = (1.0 - cos(t)) / t2
    x, y, z = w[0], w[1], w[2]
    R[0, 0] = 1.0 - b * (y * y + z * z)
    R[0, 1] = b * x * y - a * z
    R[0, 2] = b * x * z + a * y
    R[1, 0] = b * x * y + a * z
    R[1, 1] = 1.0 - b * (x * x + z * z)
    R[1, 2] = b * y * z - a * x
    R[2, 0] = b * x * z - a * y
    R[2, 1] = b * y * z + a * x
    R[2, 2] = 1.0 - b * (x * x + y * y)


@inner_kernel
def rotate_left(dw, R, out):
    """Fill out (3, 3) with Exp(dw) R: the rotation part of the project's pose perturbation."""
    E = np.empty((3, 3))
    rotation_from_rotvec(dw, E)
    for i in range(3):
        for j in range(3):
            out[i, j] = E[i, 0] * R[0, j] + E[i, 1] * R[1, j] + E[i, 2] * R[2, j]
