"""Compiled parts of the calibration from boards: rotations of many views, and the normal equations of all of them.

No Jacobian is ever stored: a view's columns are filled, multiplied with each other, and added where they belong.
"""

from __future__ import annotations

from math import atan, atan2, sqrt
from typing import Any, NamedTuple

import numpy as np

from armsight._numba import inline_sum_kernel, inner_kernel, inner_sum_kernel, kernel, sum_kernel
from armsight.geometry.kernels import Pose, rotation_from_rotvec, rotvec_of
from armsight.optics.kernels.camera import distort_pinhole
from armsight.optics.kernels.wide import NEAR_AXIS, RATIONAL, n_intrinsics, rational_radial, see_wide, wide_of

N_INTRINSICS = 10
N_POSE = 6
RESIDUAL = N_INTRINSICS + N_POSE
N_COLUMNS = RESIDUAL + 1 + N_POSE
"""Columns of one view: intrinsics, pose of the board, residual, and for every camera but the first its pose."""
N_DENOMINATOR = 3
N_WIDE = N_COLUMNS + N_DENOMINATOR
"""... and of a rational lens k4, k5, k6."""


class View(NamedTuple):
    """What one camera saw of one board: its packed intrinsics k (15,), uv (n, 2) px and weight (n,)."""

    k: Any
    uv: Any
    weight: Any


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
def view_normal_equations(state, board, seen, r, normal):
    """Fill whitened residuals and the normal equations of their squares; False where a point lies behind a camera or
    where a fisheye or rational lens has no image.

    state: k (C, 15), packed intrinsics of C cameras, without a plate; sides (C - 1, 6), T_first_camera of the others as
    (t m, rotation vector rad); poses (G, 6), T_first_board alike. board: X (n, 3), its points, and the radius of
    printed circles in m, 0 for points. seen: uv (G, C, n, 2) px; weight (G, C, n), 1 / sigma, 0 where not seen.
    r (G, C 2n). normal: A (S, S), b (S,) of the shared parameters, S = 10 C + 6 (C - 1), or 13 C +
    6 (C - 1) where a lens is rational, intrinsics and then the steps
    (dt, dw) of T_first_camera; C (G, 6, 6), c (G, 6) of the step of each board's pose; W (G, S, 6), mixed.
    """
    k, sides, poses = state
    uv, weight = seen
    n_views, n_cameras, n = weight.shape
    own = n_intrinsics(k)
    R, S, first = np.empty((3, 3)), np.empty((n_cameras, 3, 3)), np.zeros(6)
    cols, H = np.empty((N_WIDE, 2 * n)), np.empty((N_WIDE, N_WIDE))
    cols[:] = 0.0
    for c in range(1, n_cameras):
        rotation_from_rotvec(sides[c - 1, 3:], S[c])
    r[:] = 0.0
    A, b, C, c_local, W = normal
    A[:] = 0.0
    b[:] = 0.0
    C[:] = 0.0
    c_local[:] = 0.0
    W[:] = 0.0
    for g in range(n_views):
        rotation_from_rotvec(poses[g, 3:], R)
        for c in range(n_cameras):
            other = c > 0
            view, side = View(k[c], uv[g, c], weight[g, c]), Pose(S[c], sides[c - 1] if other else first)
            used = _fill_columns(view, Pose(R, poses[g]), side, other, board, cols, r[g, 2 * c * n :])
            if used < 0:
                return False
            if used > 0:
                rational = k[c, 10] == RATIONAL
                _inner(cols, N_WIDE if rational else (N_COLUMNS if other else RESIDUAL + 1), used, H)
                _scatter(H, c, n_cameras, own, g, normal)
                if rational:
                    _scatter_denominator(H, c, n_cameras, g, normal)
    for m in range(A.shape[0]):
        for o in range(m):
            A[o, m] = A[m, o]
    return True


@inline_sum_kernel
def _fill_columns(view, pose, side, other, board, cols, r):
    """Fill cols (26, 2n) with derivatives and residuals of the points that are seen, and r (2n,) with the residuals.

    Returns how many columns there are, -1 where a point is impossible. other: whether the view is of a camera that has
    a pose of its own, not of the first.
    Functions of one point take scalars: of an array numba would count the references, which doubles the time.

    A printed circle's image is an ellipse, whose middle is not the image of the circle's. It is that of the pole of the
    line at infinity by the dual conic radius^2 (I - n n') - p p' of the board's normal n (Hartley, Zisserman 2004,
    section 2.2.3): the point p is moved there. That shift is left out of the derivatives, which it changes by the
    square of radius over distance.
    """
    kc, uv, weight = view
    (R, t), (S, ts), (X, radius) = pose, side, board
    fx, fy, cx, cy, skew = kc[0], kc[1], kc[2], kc[3], kc[4]
    lens, used = wide_of(kc), 0
    for i in range(weight.shape[0]):
        w = weight[i]
        if w == 0.0:
            continue
        a0 = R[0, 0] * X[i, 0] + R[0, 1] * X[i, 1] + R[0, 2] * X[i, 2]
        a1 = R[1, 0] * X[i, 0] + R[1, 1] * X[i, 1] + R[1, 2] * X[i, 2]
        a2 = R[2, 0] * X[i, 0] + R[2, 1] * X[i, 1] + R[2, 2] * X[i, 2]
        q0, q1, q2 = a0 + t[0], a1 + t[1], a2 + t[2]
        if radius != 0.0:
            s = radius * radius / q2
            q0 += s * R[0, 2] * R[2, 2]
            q1 += s * R[1, 2] * R[2, 2]
            q2 -= s * (1.0 - R[2, 2] * R[2, 2])
        b0, b1, b2 = q0 - ts[0], q1 - ts[1], q2 - ts[2]
        if other:
            q0 = S[0, 0] * b0 + S[1, 0] * b1 + S[2, 0] * b2
            q1 = S[0, 1] * b0 + S[1, 1] * b1 + S[2, 1] * b2
            q2 = S[0, 2] * b0 + S[1, 2] * b1 + S[2, 2] * b2
        if not q2 > 0.0:
            return -1
        iz = 1.0 / q2
        x, y = q0 * iz, q1 * iz
        seen, xd, yd, dxx, dxy, dyy = _through_lens(lens, x, y)
        if not seen:
            return -1
        for h in range(2):
            o = used + h
            if h == 0:  # u = fx x + skew y + cx
                e, jx, jy = fx * xd + skew * yd + cx - uv[i, h], fx * dxx + skew * dxy, fx * dxy + skew * dyy
                s, v = w * fx, w * skew
                cols[0, o], cols[1, o], cols[2, o], cols[3, o], cols[4, o] = w * xd, 0.0, w, 0.0, w * yd
            else:  # v = fy y + cy
                e, jx, jy = fy * yd + cy - uv[i, h], fy * dxy, fy * dyy
                s, v = 0.0, w * fy
                cols[0, o], cols[1, o], cols[2, o], cols[3, o], cols[4, o] = 0.0, w * yd, 0.0, w, 0.0
            cols[5, o], cols[6, o], cols[7, o], cols[8, o], cols[9, o] = _by_coefficients(lens, s, v, x, y)
            if lens.kind == RATIONAL:
                _by_denominator(lens, x, y, cols, o)
            j0, j1 = w * jx * iz, w * jy * iz  # x = q0 / q2, y = q1 / q2
            j2 = -(j0 * x + j1 * y)
            if other:
                d0 = S[0, 0] * j0 + S[0, 1] * j1 + S[0, 2] * j2
                d1 = S[1, 0] * j0 + S[1, 1] * j1 + S[1, 2] * j2
                d2 = S[2, 0] * j0 + S[2, 1] * j1 + S[2, 2] * j2
                j0, j1, j2 = d0, d1, d2
                # q = S' b, b = p - ts: T_first_camera moves against the point, j . (-dw x b) = dw . (j x b)
                cols[17, o], cols[18, o], cols[19, o] = -j0, -j1, -j2
                cols[20, o], cols[21, o], cols[22, o] = j1 * b2 - j2 * b1, j2 * b0 - j0 * b2, j0 * b1 - j1 * b0
            # the board turns about its own middle: j . (dw x a) = dw . (a x j)
            cols[10, o], cols[11, o], cols[12, o] = j0, j1, j2
            cols[13, o], cols[14, o], cols[15, o] = a1 * j2 - a2 * j1, a2 * j0 - a0 * j2, a0 * j1 - a1 * j0
            cols[RESIDUAL, o] = r[2 * i + h] = w * e
        used += 2
    return used


@inline_sum_kernel
def _through_lens(lens, x, y):
    """Return whether a lens sees a normalised point, where it puts it, and the derivatives of that."""
    if lens.kind < 0.0:
        return see_wide(lens, x, y)
    xd, yd, dxx, dxy, dyy = distort_pinhole(lens.k1, lens.k2, lens.p1, lens.p2, lens.k3, x, y)
    return True, xd, yd, dxx, dxy, dyy


@inline_sum_kernel
def _by_coefficients(lens, s, v, x, y):
    """Return the derivatives of a residual by the first five coefficients, given those by the distorted point; of a
    rational lens those of its numerator alone."""
    r2 = x * x + y * y
    r4 = r2 * r2
    along = s * x + v * y  # radial terms move the point along its own direction
    if lens.kind < 0.0 and lens.kind != RATIONAL:
        # (x, y) theta (1 + k1 theta^2 + ..) / r (Kannala, Brandt 2006, equation 6); theta^3 / r is r^2 at the axis
        q = atan(sqrt(r2)) ** 2
        along *= q * sqrt(q / r2) if r2 > NEAR_AXIS else r2
        return along, along * q, along * q * q, along * q * q * q, 0.0
    # Brown 1971: x (k1 r^2 + k2 r^4 + k3 r^6) + 2 p1 x y + p2 (r^2 + 2 x^2), and y likewise with p1, p2 exchanged
    p1 = 2.0 * s * x * y + v * (r2 + 2.0 * y * y)
    p2 = s * (r2 + 2.0 * x * x) + 2.0 * v * x * y
    return along * r2, along * r4, p1, p2, along * r4 * r2


@inner_kernel
def _by_denominator(lens, x, y, cols, o):
    """Divide the derivatives by k1, k2, k3 in column o of cols by a rational lens's denominator; fill k4, k5, k6's."""
    radial, _, over = rational_radial(lens, x * x + y * y)
    for top, bottom in ((5, N_COLUMNS), (6, N_COLUMNS + 1), (9, N_COLUMNS + 2)):
        cols[top, o] *= over
        cols[bottom, o] = -radial * cols[top, o]


@inner_kernel
def _scatter_denominator(H, c, n_cameras, g, normal):
    """Add what a view's H (26, 26) says of a rational lens's k4, k5, k6, as _scatter, which they come after."""
    A, b, _, _, W = normal
    own = N_INTRINSICS + N_DENOMINATOR
    at, side = n_cameras * own + (c - 1) * N_POSE, RESIDUAL + 1
    for m in range(N_DENOMINATOR):
        row, column = c * own + N_INTRINSICS + m, N_COLUMNS + m
        b[row] += H[column, RESIDUAL]
        for o in range(N_INTRINSICS):
            A[row, c * own + o] += H[column, o]
        for o in range(m + 1):
            A[row, c * own + N_INTRINSICS + o] += H[column, N_COLUMNS + o]
        for o in range(N_POSE):
            W[g, row, o] += H[column, N_INTRINSICS + o]
            if c > 0:
                A[at + o, row] += H[column, side + o]


@inner_kernel
def _scatter(H, c, n_cameras, own, g, normal):
    """Add the lower half of one view's H (23, 23) where its parameters belong; A gets its lower half only."""
    A, b, C, c_local, W = normal
    k0, pose, side = c * own, N_INTRINSICS, RESIDUAL + 1
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
    at = n_cameras * own + (c - 1) * N_POSE
    for m in range(N_POSE):
        b[at + m] += H[side + m, RESIDUAL]
        for o in range(N_INTRINSICS):
            A[at + m, k0 + o] += H[side + m, o]
        for o in range(m + 1):
            A[at + m, at + o] += H[side + m, side + o]
        for o in range(N_POSE):
            W[g, at + m, o] += H[side + m, pose + o]
