"""Compiled normal equations of boards seen by one camera or two: no Jacobian is ever stored."""

from __future__ import annotations

from math import atan, sqrt

import numpy as np

from armsight._numba import inner_kernel, inner_sum_kernel, sum_kernel
from armsight.geometry.kernels import rotation_from_rotvec
from armsight.optics.kernels.camera import NEAR_AXIS, distort_pinhole, is_fisheye, see_fisheye

N_INTRINSICS = 10
N_POSE = 6
RESIDUAL = N_INTRINSICS + N_POSE
N_COLUMNS = RESIDUAL + 1 + N_POSE
"""Columns of one view: intrinsics, pose of the board, residual, and for the right camera its pose."""


@inner_sum_kernel
def _inner(columns, m, n, H):
    """Fill the lower half of H[:m, :m] with the inner products of columns[:m, :n]."""
    for a in range(m):
        u = columns[a]
        for b in range(a + 1):
            v = columns[b]
            total = 0.0
            for i in range(n):
                total += u[i] * v[i]
            H[a, b] = total


@sum_kernel
def view_normal_equations(k, side, poses, X, radius, uv, weight, r, A, b, C, c_local, W):
    """Fill whitened residuals and the normal equations of their squares; False where a point lies
    behind a camera or beside a fisheye.

    k (C, 12): packed intrinsics of C = 1 or 2 cameras, without a plate. side (6,): T_left_right as (t m, rotation
    vector rad), not looked at for one camera. poses (G, 6): T_left_board alike. X (n, 3) board points; radius of
    printed circles in m, 0 for points. uv (G, C, n, 2) px. weight (G, C, n): 1 / sigma, 0 where not seen.
    r (G, C 2n). A (S, S), b (S,): shared parameters, S = 10 C + 6 (C - 1), intrinsics and then the step (dt, dw) of
    T_left_right. C (G, 6, 6), c_local (G, 6): the step of each board's pose. W (G, S, 6): mixed.

    A printed circle's outline has its centre at the pole of the line at infinity by the dual conic
    radius^2 (I - n n') - p p' of the board's normal n; the point is moved there. That shift is left out of
    the derivatives (it changes them by the square of radius over distance).
    """
    n_views, n_cameras, n = weight.shape
    R, S = np.empty((3, 3)), np.empty((3, 3))
    cols, H = np.empty((N_COLUMNS, 2 * n)), np.empty((N_COLUMNS, N_COLUMNS))
    rotation_from_rotvec(side[3:], S)
    r[:] = 0.0
    A[:] = 0.0
    b[:] = 0.0
    C[:] = 0.0
    c_local[:] = 0.0
    W[:] = 0.0
    for g in range(n_views):
        rotation_from_rotvec(poses[g, 3:], R)
        t0, t1, t2 = poses[g, 0], poses[g, 1], poses[g, 2]
        for c in range(n_cameras):
            kc = k[c]
            fx, fy, cx, cy, skew = kc[0], kc[1], kc[2], kc[3], kc[4]
            used = 0
            for i in range(n):
                w = weight[g, c, i]
                if w == 0.0:
                    continue
                a0 = R[0, 0] * X[i, 0] + R[0, 1] * X[i, 1] + R[0, 2] * X[i, 2]
                a1 = R[1, 0] * X[i, 0] + R[1, 1] * X[i, 1] + R[1, 2] * X[i, 2]
                a2 = R[2, 0] * X[i, 0] + R[2, 1] * X[i, 1] + R[2, 2] * X[i, 2]
                q0, q1, q2 = a0 + t0, a1 + t1, a2 + t2
                if radius != 0.0:
                    s = radius * radius / q2
                    q0 += s * R[0, 2] * R[2, 2]
                    q1 += s * R[1, 2] * R[2, 2]
                    q2 -= s * (1.0 - R[2, 2] * R[2, 2])
                b0, b1, b2 = q0 - side[0], q1 - side[1], q2 - side[2]
                if c == 1:
                    q0 = S[0, 0] * b0 + S[1, 0] * b1 + S[2, 0] * b2
                    q1 = S[0, 1] * b0 + S[1, 1] * b1 + S[2, 1] * b2
                    q2 = S[0, 2] * b0 + S[1, 2] * b1 + S[2, 2] * b2
                if not q2 > 0.0:
                    return False
                iz = 1.0 / q2
                x, y = q0 * iz, q1 * iz
                fisheye = is_fisheye(kc)
                if fisheye:
                    seen, xd, yd, dxx, dxy, dyy = see_fisheye(kc[5], kc[6], kc[7], kc[8], kc[11], x, y)
                    if not seen:
                        return False
                else:
                    xd, yd, dxx, dxy, dyy = distort_pinhole(kc[5], kc[6], kc[7], kc[8], kc[9], x, y)
                r2 = x * x + y * y
                r4 = r2 * r2
                for h in range(2):
                    o = used + h
                    if h == 0:
                        e = fx * xd + skew * yd + cx - uv[g, c, i, 0]
                        jx, jy = fx * dxx + skew * dxy, fx * dxy + skew * dyy
                        s, v = w * fx, w * skew
                        cols[0, o], cols[1, o], cols[2, o], cols[3, o], cols[4, o] = w * xd, 0.0, w, 0.0, w * yd
                    else:
                        e = fy * yd + cy - uv[g, c, i, 1]
                        jx, jy = fy * dxy, fy * dyy
                        s, v = 0.0, w * fy
                        cols[0, o], cols[1, o], cols[2, o], cols[3, o], cols[4, o] = 0.0, w * yd, 0.0, w, 0.0
                    along = s * x + v * y  # radial terms move the point along its own direction
                    if fisheye:
                        q = atan(sqrt(r2)) ** 2
                        along *= q * sqrt(q / r2) if r2 > NEAR_AXIS else r2
                        cols[5, o], cols[6, o] = along, along * q
                        cols[7, o], cols[8, o], cols[9, o] = along * q * q, along * q * q * q, 0.0
                    else:
                        cols[5, o], cols[6, o], cols[9, o] = along * r2, along * r4, along * r4 * r2
                        cols[7, o] = 2.0 * s * x * y + v * (r2 + 2.0 * y * y)
                        cols[8, o] = s * (r2 + 2.0 * x * x) + 2.0 * v * x * y
                    j0, j1 = w * jx * iz, w * jy * iz
                    j2 = -(j0 * x + j1 * y)
                    if c == 1:
                        d0 = S[0, 0] * j0 + S[0, 1] * j1 + S[0, 2] * j2
                        d1 = S[1, 0] * j0 + S[1, 1] * j1 + S[1, 2] * j2
                        d2 = S[2, 0] * j0 + S[2, 1] * j1 + S[2, 2] * j2
                        j0, j1, j2 = d0, d1, d2
                        cols[17, o], cols[18, o], cols[19, o] = -j0, -j1, -j2
                        cols[20, o], cols[21, o], cols[22, o] = j1 * b2 - j2 * b1, j2 * b0 - j0 * b2, j0 * b1 - j1 * b0
                    cols[10, o], cols[11, o], cols[12, o] = j0, j1, j2
                    cols[13, o], cols[14, o], cols[15, o] = a1 * j2 - a2 * j1, a2 * j0 - a0 * j2, a0 * j1 - a1 * j0
                    cols[RESIDUAL, o] = w * e
                    r[g, 2 * (c * n + i) + h] = w * e
                used += 2
            _inner(cols, N_COLUMNS if c == 1 else RESIDUAL + 1, used, H)
            _scatter(H, c, g, A, b, C, c_local, W)
    for m in range(A.shape[0]):
        for o in range(m):
            A[o, m] = A[m, o]
    return True


@inner_kernel
def _scatter(H, c, g, A, b, C, c_local, W):
    """Add the lower half of one view's H (23, 23) where its parameters belong; A gets its lower half only."""
    k0, pose, side = c * N_INTRINSICS, N_INTRINSICS, RESIDUAL + 1
    for m in range(N_INTRINSICS):
        b[k0 + m] += H[RESIDUAL, m]
        for o in range(m + 1):
            A[k0 + m, k0 + o] += H[m, o]
        for o in range(N_POSE):
            W[g, k0 + m, o] += H[pose + o, m]
    for m in range(N_POSE):
        c_local[g, m] += H[RESIDUAL, pose + m]
        for o in range(m + 1):
            C[g, m, o] += H[pose + m, pose + o]
            if o < m:
                C[g, o, m] += H[pose + m, pose + o]
    if c == 0:
        return
    at = 2 * N_INTRINSICS
    for m in range(N_POSE):
        b[at + m] += H[side + m, RESIDUAL]
        for o in range(N_INTRINSICS):
            A[at + m, k0 + o] += H[side + m, o]
        for o in range(m + 1):
            A[at + m, at + o] += H[side + m, side + o]
        for o in range(N_POSE):
            W[g, at + m, o] += H[side + m, pose + o]
