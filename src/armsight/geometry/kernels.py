"""Compiled rotation and small-matrix kernels shared by every hot path.

numba's own `a[:] = b`, np.dot and @ bring an error text, BLAS and copies into each caller: a loop compiles in a tenth
of the time and runs faster on matrices this small.
"""

from __future__ import annotations

from math import atan2, cos, sin, sqrt
from typing import Any, NamedTuple

import numpy as np

from armsight._numba import inner_kernel, kernel, lean_kernel


class Pose(NamedTuple):
    """A rotation R (3, 3) and a translation t (3,), for kernels; made inside another kernel it costs nothing."""

    R: Any
    t: Any


@lean_kernel
def rotation_from_rotvec(w, R):
    """Fill R (3, 3) with Exp of the rotation vector w (3,) in radians (Rodrigues)."""
    t2 = w[0] * w[0] + w[1] * w[1] + w[2] * w[2]
    t = sqrt(t2)
    # series of sin t / t and (1 - cos t) / t^2, whose closed forms cancel there; what follows is below 1e-26
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


@kernel
def rotvec(R):
    """Return the rotation vector (3,) of R (3, 3)."""
    # for Python alone: kernels call rotvec_of, which then is compiled into them and kept nowhere else
    w = np.empty(3)
    rotvec_of(R, w)
    return w


@inner_kernel
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
    # by both parts: the arc cosine of the real one alone loses half of the digits at small angles
    angle = 2.0 * atan2(s, abs(q[3]))
    # q and -q are one rotation: that with a real part of 0 and more has the shorter rotation vector
    f = (angle / s if s > 0.0 else 0.0) * (1.0 if q[3] >= 0.0 else -1.0)
    for m in range(3):
        w[m] = f * q[m]


@inner_kernel
def rotate_left(dw, R, out):
    """Fill out (3, 3) with Exp(dw) R: the rotation part of the project's pose perturbation."""
    E = np.empty((3, 3))
    rotation_from_rotvec(dw, E)
    for i in range(3):
        for j in range(3):
            out[i, j] = E[i, 0] * R[0, j] + E[i, 1] * R[1, j] + E[i, 2] * R[2, j]


@lean_kernel
def copy_1(a, out):
    """Copy a vector."""
    for i in range(a.shape[0]):
        out[i] = a[i]


@lean_kernel
def copy_2(a, out):
    """Copy a matrix."""
    for i in range(a.shape[0]):
        for j in range(a.shape[1]):
            out[i, j] = a[i, j]


@lean_kernel
def copy_3(a, out):
    """Copy an array of three axes."""
    for i in range(a.shape[0]):
        copy_2(a[i], out[i])


@lean_kernel
def dot(a, b):
    """Return the inner product of two vectors."""
    total = 0.0
    for i in range(a.shape[0]):
        total += a[i] * b[i]
    return total


@lean_kernel
def cross(a, b, out):
    """Fill out (3,) with a x b."""
    out[0] = a[1] * b[2] - a[2] * b[1]
    out[1] = a[2] * b[0] - a[0] * b[2]
    out[2] = a[0] * b[1] - a[1] * b[0]


@lean_kernel
def multiply(A, B, out):
    """Fill out (n, m) with A (n, k) B (k, m)."""
    for i in range(A.shape[0]):
        for j in range(B.shape[1]):
            total = 0.0
            for k in range(A.shape[1]):
                total += A[i, k] * B[k, j]
            out[i, j] = total


@lean_kernel
def sandwich(A, S, out):
    """Fill out (n, n) with A S A' for A (n, k), S (k, k)."""
    for i in range(A.shape[0]):
        for j in range(A.shape[0]):
            out[i, j] = 0.0
        for k in range(A.shape[1]):
            row = 0.0
            for m in range(A.shape[1]):
                row += A[i, m] * S[m, k]
            for j in range(A.shape[0]):
                out[i, j] += row * A[j, k]
