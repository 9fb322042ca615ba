"""Compiled residuals and Jacobians of boards seen by one camera or two, and the step of their poses."""

from __future__ import annotations

from math import atan2, sqrt

import numpy as np

from armsight._numba import inner_kernel, kernel
from armsight.geometry.kernels import copy_1, rotation_from_rotvec
from armsight.optics.kernels.camera import intrinsics_jacobian, project_point

N_INTRINSICS = 10
N_POSE = 6


@inner_kernel
def _turn(R, X, i, a):
    """Fill a (3,) with R X[i]."""
    for m in range(3):
        a[m] = R[m, 0] * X[i, 0] + R[m, 1] * X[i, 1] + R[m, 2] * X[i, 2]


@inner_kernel
def _outline_centre(p, R, radius):
    """Move p (3,) from a circle's centre to the space point seen at the centre of its image's outline.

    The dual conic of the circle's image is radius^2 (I - n n') - p p' with the board's normal n; its pole of the
    line at infinity is that centre. In place; radius 0 leaves p as it is.
    """
    if radius == 0.0:
        return
    n0, n1, n2 = R[0, 2], R[1, 2], R[2, 2]
    s = radius * radius
    x = p[0] * p[2] + s * n0 * n2
    y = p[1] * p[2] + s * n1 * n2
    z = p[2] * p[2] - s * (1.0 - n2 * n2)
    p[0] = x / p[2]
    p[1] = y / p[2]
    p[2] = z / p[2]


@inner_kernel
def _lever(a, j, out, at):
    """Fill out[at : at + 3] with a x j: the derivative by a rotation dw of j . (dw x a)."""
    out[at] = a[1] * j[2] - a[2] * j[1]
    out[at + 1] = a[2] * j[0] - a[0] * j[2]
    out[at + 2] = a[0] * j[1] - a[1] * j[0]


@inner_kernel
def evaluate_views(k, side_pose, poses, X, radius, uv, weight, r, Js, Jl):
    """Fill whitened residuals and their derivatives for all views; False where a point lies behind a camera.

    k (C, 10): intrinsics of C = 1 or 2 cameras. side_pose (6,): T_left_right as (t m, rotation vector rad), not
    looked at for one camera. poses (G, 6): T_left_board alike. X (n, 3) board points; radius of printed
    circles in m, 0 for points. uv (G, C, n, 2) px. weight (G, C, n): 1 / sigma, 0 where not seen.
    r (G, C 2n). Js (G, C 2n, 10 C + 6 (C - 1)): by intrinsics and by the step (dt, dw) of T_left_right.
    Jl (G, C 2n, 6): by the step of the view's pose. Js and Jl must come as zeros where they are not filled: rows of
    unseen points and the other camera's columns. The circles' shift is left out of the derivatives (it changes
    them by the square of radius over distance).
    """
    n_views, n_cameras, n = weight.shape
    R = np.empty((3, 3))
    S = np.empty((3, 3))
    rotation_from_rotvec(side_pose[3:], S)
    a = np.empty(3)
    p = np.empty(3)
    b = np.empty(3)
    q = np.empty(3)
    j = np.empty(3)
    px = np.empty(2)
    J = np.empty((2, 3))
    D = np.empty((2, N_INTRINSICS))
    for g in range(n_views):
        rotation_from_rotvec(poses[g, 3:], R)
        for i in range(n):
            _turn(R, X, i, a)
            for c in range(n_cameras):
                w = weight[g, c, i]
                row = 2 * (c * n + i)
                if w == 0.0:
                    r[g, row] = 0.0
                    r[g, row + 1] = 0.0
                    continue
                for m in range(3):
                    p[m] = a[m] + poses[g, m]
                _outline_centre(p, R, radius)
                if c == 1:
                    for m in range(3):
                        b[m] = p[m] - side_pose[m]
                    for m in range(3):
                        q[m] = S[0, m] * b[0] + S[1, m] * b[1] + S[2, m] * b[2]
                else:
                    copy_1(p, q)
                if not project_point(k[c], q[0], q[1], q[2], px, J):
                    return False
                intrinsics_jacobian(k[c], q[0], q[1], q[2], D)
                for h in range(2):
                    r[g, row + h] = w * (px[h] - uv[g, c, i, h])
                    for m in range(N_INTRINSICS):
                        Js[g, row + h, c * N_INTRINSICS + m] = w * D[h, m]
                    for m in range(3):
                        if c == 1:
                            j[m] = w * (J[h, 0] * S[m, 0] + J[h, 1] * S[m, 1] + J[h, 2] * S[m, 2])
                        else:
                            j[m] = w * J[h, m]
                    Jl[g, row + h, 0] = j[0]
                    Jl[g, row + h, 1] = j[1]
                    Jl[g, row + h, 2] = j[2]
                    _lever(a, j, Jl[g, row + h], 3)
                    if c == 1:
                        at = 2 * N_INTRINSICS
                        Js[g, row + h, at] = -j[0]
                        Js[g, row + h, at + 1] = -j[1]
                        Js[g, row + h, at + 2] = -j[2]
                        _lever(j, b, Js[g, row + h], at + 3)
    return True


@kernel
def move_poses(poses, steps, out):
    """Fill out (G, 6) with poses (t, rotation vector) moved by steps (dt, dw): t + dt, log(Exp(dw) Exp(w))."""
    q1 = np.empty(4)
    q2 = np.empty(4)
    for g in range(poses.shape[0]):
        for m in range(3):
            out[g, m] = poses[g, m] + steps[g, m]
        _quaternion(steps[g, 3:], q1)
        _quaternion(poses[g, 3:], q2)
        w = q1[3] * q2[3] - q1[0] * q2[0] - q1[1] * q2[1] - q1[2] * q2[2]
        x = q1[3] * q2[0] + q1[0] * q2[3] + q1[1] * q2[2] - q1[2] * q2[1]
        y = q1[3] * q2[1] - q1[0] * q2[2] + q1[1] * q2[3] + q1[2] * q2[0]
        z = q1[3] * q2[2] + q1[0] * q2[1] - q1[1] * q2[0] + q1[2] * q2[3]
        if w < 0.0:
            w, x, y, z = -w, -x, -y, -z
        s = sqrt(x * x + y * y + z * z)
        f = 2.0 if s < 1e-12 else 2.0 * atan2(s, w) / s
        out[g, 3] = f * x
        out[g, 4] = f * y
        out[g, 5] = f * z


@inner_kernel
def _quaternion(w, q):
    """Fill q (4,), scalar last, with the quaternion of the rotation vector w (3,)."""
    t = sqrt(w[0] * w[0] + w[1] * w[1] + w[2] * w[2])
    f = 0.5 - t * t / 48.0 if t < 1e-4 else np.sin(0.5 * t) / t
    q[0], q[1], q[2], q[3] = f * w[0], f * w[1], f * w[2], np.cos(0.5 * t)
