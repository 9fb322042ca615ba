"""Compiled: a rig's pixels of many points; a chain's beacon; how well axes of all directions fit a sweep."""

from __future__ import annotations

import numpy as np

from armsight._numba import inner_kernel, kernel
from armsight.fitting.kernels import invert_spd
from armsight.geometry.kernels import copy_1
from armsight.optics.kernels.camera import see_point


@kernel
def see_many(k, R, t, X, uv, D):
    """Fill uv (m, v, 2) and D (m, v, 2, 3) as [point, view] for X (m, 3) in rig axes; NaN behind a camera."""
    for i in range(X.shape[0]):
        for s in range(k.shape[0]):
            if not see_point(k[s], R[s], t[s], X[i], uv[i, s], D[i, s]):
                uv[i, s, :] = np.nan
                D[i, s, :, :] = np.nan


@inner_kernel
def tilted(B, u, v, d, dd):
    """Fill d (3,) = normalise(B (u, v, 1)) and dd (3, 2) = d d / d (u, v)."""
    size = 0.0
    for r in range(3):
        d[r] = B[r, 0] * u + B[r, 1] * v + B[r, 2]
        size += d[r] * d[r]
    size = np.sqrt(size)
    for r in range(3):
        d[r] /= size
    for c in range(2):
        along = d[0] * B[0, c] + d[1] * B[1, c] + d[2] * B[2, c]
        for r in range(3):
            dd[r, c] = (B[r, c] - along * d[r]) / size


@kernel
def arc_positions(B, middle, p, s, X, J, Js):
    """Fill X (N, 3), J (N, 3, 6), Js (N, 3): positions at arc lengths s of the arc p, derivatives by p and by s.

    p: shift (2) of the arc's point along B's first columns, tilt (2) of the tangent from its third, and the curvature
    vector (2) along the first columns, of which the part c across the tangent t counts. With k = |c| and w = k s:
    X = P + t sin(w) / k + c (1 - cos w) / k^2, smooth through k = 0, where it is a line.
    """
    t, dt = np.empty(3), np.empty((3, 2))
    tilted(B, p[2], p[3], t, dt)
    g = B[:, 0] * p[4] + B[:, 1] * p[5]
    along = g[0] * t[0] + g[1] * t[1] + g[2] * t[2]
    c = g - along * t
    dc = np.empty((3, 4))  # by both tilts, by both parts of the curvature
    for k in range(2):
        turned = g[0] * dt[0, k] + g[1] * dt[1, k] + g[2] * dt[2, k]
        across = B[0, k] * t[0] + B[1, k] * t[1] + B[2, k] * t[2]
        for r in range(3):
            dc[r, k] = -turned * t[r] - along * dt[r, k]
            dc[r, 2 + k] = B[r, k] - across * t[r]
    bend2 = c[0] * c[0] + c[1] * c[1] + c[2] * c[2]
    for i in range(s.shape[0]):
        z = bend2 * s[i] * s[i]
        # f1 = sin(w) / w, f2 = (1 - cos w) / w^2 with their derivatives by z = w^2; near zero by series, as they are
        # differences of nearly equal numbers there
        if z > 1e-2:
            root = np.sqrt(z)
            cosine, f1 = np.cos(root), np.sin(root) / root
            f2 = (1.0 - cosine) / z
            df1, df2 = (cosine - f1) / (2.0 * z), (f1 - 2.0 * f2) / (2.0 * z)
        else:
            cosine = 1.0 - z / 2.0 + z * z / 24.0 - z**3 / 720.0
            f1 = 1.0 - z / 6.0 + z * z / 120.0 - z**3 / 5040.0
            f2 = 0.5 - z / 24.0 + z * z / 720.0 - z**3 / 40320.0
            df1 = -1.0 / 6.0 + z / 60.0 - z * z / 1680.0
            df2 = -1.0 / 24.0 + z / 360.0 - z * z / 13440.0
        S, C = s[i] * f1, s[i] * s[i] * f2
        for r in range(3):
            X[i, r] = middle[r] + B[r, 0] * p[0] + B[r, 1] * p[1] + t[r] * S + c[r] * C
            Js[i, r] = t[r] * cosine + c[r] * S
            J[i, r, 0], J[i, r, 1] = B[r, 0], B[r, 1]
        for k in range(4):
            # z = |c|^2 s^2 grows by 2 c . dc s^2
            grown = 2.0 * (c[0] * dc[0, k] + c[1] * dc[1, k] + c[2] * dc[2, k]) * s[i] ** 3
            for r in range(3):
                J[i, r, 2 + k] = dc[r, k] * C + grown * (t[r] * df1 + c[r] * s[i] * df2)
                if k < 2:
                    J[i, r, 2 + k] += dt[r, k] * S


@inner_kernel
def turn(d, angle, x, out):
    """Fill out (3,) with x turned about the unit direction d."""
    # Rodrigues: cos x + sin d x x + (1 - cos) (d . x) d
    s, c = np.sin(angle), np.cos(angle)
    along = (1.0 - c) * (d[0] * x[0] + d[1] * x[1] + d[2] * x[2])
    a = c * x[0] + s * (d[1] * x[2] - d[2] * x[1]) + along * d[0]
    b = c * x[1] + s * (d[2] * x[0] - d[0] * x[2]) + along * d[1]
    out[2] = c * x[2] + s * (d[0] * x[1] - d[1] * x[0]) + along * d[2]
    out[0], out[1] = a, b


@kernel
def chain_beacon(revolute, B, points, beacon, p, q, X, J):
    """Fill X (m, 3) and J (m, 3, P): the beacon at joint values q (m, n) and its derivative by p.

    B (n, 3, 3): basis of every joint's first direction; points (n, 3) on the axes; p: tilt (2) of every joint and, of
    turning ones, the shift (2) along B's first columns; then the beacon's shift (3).
    """
    m, n = q.shape
    P = p.shape[0]
    d, dd, at = np.empty((n, 3)), np.empty((n, 3, 2)), np.empty((n, 3))
    first = np.empty(n, dtype=np.int64)
    k = 0
    for j in range(n):
        first[j] = k
        tilted(B[j], p[k], p[k + 1], d[j], dd[j])
        k += 2
        copy_1(points[j], at[j])
        if revolute[j]:
            for r in range(3):
                at[j, r] += B[j, r, 0] * p[k] + B[j, r, 1] * p[k + 1]
            k += 2
    r0, column = np.empty(3), np.empty(3)
    for i in range(m):
        x, G = X[i], J[i]
        G[:, :] = 0.0
        for r in range(3):
            x[r] = beacon[r] + p[P - 3 + r]
            G[r, P - 3 + r] = 1.0
        # from the last joint to the first: each moves the beacon and, with it, the derivatives by all joints behind it
        for j in range(n - 1, -1, -1):
            value, k = q[i, j], first[j]
            if not revolute[j]:
                for r in range(3):
                    x[r] += value * d[j, r]
                    G[r, k] = value * dd[j, r, 0]
                    G[r, k + 1] = value * dd[j, r, 1]
                continue
            s, c = np.sin(value), 1.0 - np.cos(value)
            for r in range(3):
                r0[r] = x[r] - at[j, r]
            for col in range(k + 4, P):
                for r in range(3):
                    column[r] = G[r, col]
                turn(d[j], value, column, column)
                for r in range(3):
                    G[r, col] = column[r]
            on = r0[0] * d[j, 0] + r0[1] * d[j, 1] + r0[2] * d[j, 2]
            # By the tilts, e = d d: Rodrigues' formula differentiated by its axis, sin e x r + (1 - cos) ((d . r) e +
            # (e . r) d), where d . e = 0. By a shift e of the axis: (1 - R) e
            for t in range(2):
                e0, e1, e2 = dd[j, 0, t], dd[j, 1, t], dd[j, 2, t]
                off = r0[0] * e0 + r0[1] * e1 + r0[2] * e2
                G[0, k + t] = s * (e1 * r0[2] - e2 * r0[1]) + c * (on * e0 + off * d[j, 0])
                G[1, k + t] = s * (e2 * r0[0] - e0 * r0[2]) + c * (on * e1 + off * d[j, 1])
                G[2, k + t] = s * (e0 * r0[1] - e1 * r0[0]) + c * (on * e2 + off * d[j, 2])
                turn(d[j], value, B[j, :, t], column)
                for r in range(3):
                    G[r, k + 2 + t] = B[j, r, t] - column[r]
            turn(d[j], value, r0, x)
            for r in range(3):
                x[r] += at[j, r]


@inner_kernel
def axis_cost(revolute, direction, xyz, W, q, p):
    """Return the misfit of a sweep for an axis of given direction, all else eliminated (or infinity); fill p.

    xyz (m, 3), W (m, 3, 3) their information, q (m,) the joint's values. Turning: the position is
    a + cos q b + sin q n x b with b square to n: p = a (3), b (3). Sliding: a + q n: p = a.
    """
    m = len(q)
    size = 5 if revolute else 3
    e1, e2 = np.empty(3), np.empty(3)
    i = 0
    for r in range(1, 3):
        if abs(direction[r]) < abs(direction[i]):
            i = r
    for r in range(3):
        e1[r] = (1.0 if r == i else 0.0) - direction[i] * direction[r]
    norm = np.sqrt(e1[0] ** 2 + e1[1] ** 2 + e1[2] ** 2)
    for r in range(3):
        e1[r] /= norm
    e2[0] = direction[1] * e1[2] - direction[2] * e1[1]
    e2[1] = direction[2] * e1[0] - direction[0] * e1[2]
    e2[2] = direction[0] * e1[1] - direction[1] * e1[0]
    # For a given direction the rest is linear, and is eliminated by its normal equations (variable projection: Golub,
    # Pereyra 1973): the direction's cost is what they leave
    H, g, ik = np.zeros((size, size)), np.zeros(size), np.empty((size, size))
    A, WA = np.zeros((3, size)), np.empty((3, size))
    y, total = np.empty(3), 0.0
    for r in range(3):
        A[r, r] = 1.0
    for k in range(m):
        if revolute:
            s, c = np.sin(q[k]), np.cos(q[k])
            for r in range(3):
                A[r, 3] = c * e1[r] + s * e2[r]
                A[r, 4] = c * e2[r] - s * e1[r]
        for r in range(3):
            y[r] = xyz[k, r] - (0.0 if revolute else q[k] * direction[r])
        for r in range(3):
            Wy = W[k, r, 0] * y[0] + W[k, r, 1] * y[1] + W[k, r, 2] * y[2]
            total += y[r] * Wy
            for a in range(size):
                g[a] += A[r, a] * Wy
                WA[r, a] = W[k, r, 0] * A[0, a] + W[k, r, 1] * A[1, a] + W[k, r, 2] * A[2, a]
        for a in range(size):
            for b in range(a + 1):
                H[a, b] += A[0, a] * WA[0, b] + A[1, a] * WA[1, b] + A[2, a] * WA[2, b]
                H[b, a] = H[a, b]
    if not invert_spd(H, ik):
        return np.inf
    for a in range(size):
        p[a] = 0.0
        for b in range(size):
            p[a] += ik[a, b] * g[b]
        total -= p[a] * g[a]
    if revolute:  # from the parts of b to a point's offset from the axis
        b1, b2 = p[3], p[4]
        for r in range(3):
            p[3 + r] = b1 * e1[r] + b2 * e2[r]
    return total


@kernel
def axis_costs(revolute, directions, xyz, W, q, costs):
    """Fill costs (k,) of directions (k, 3); see axis_cost."""
    p = np.empty(6)
    for i in range(len(directions)):
        costs[i] = axis_cost(revolute, directions[i], xyz, W, q, p)


@kernel
def settle_axis(revolute, direction, step, xyz, W, q, p):
    """Move direction (3,) to the nearest minimum of axis_cost by eight-way steps that shrink; return cost; fill p."""
    best = axis_cost(revolute, direction, xyz, W, q, p)
    d, B, trial = np.empty(3), np.empty((3, 3)), np.empty(6)
    # a compass search in the tangent plane (Kolda, Lewis, Torczon 2003), which needs no derivative by the direction
    while step > 2e-4:
        i = 0
        for r in range(1, 3):
            if abs(direction[r]) < abs(direction[i]):
                i = r
        for r in range(3):
            B[r, 2] = direction[r]
            B[r, 0] = (1.0 if r == i else 0.0) - direction[i] * direction[r]
        norm = np.sqrt(B[0, 0] ** 2 + B[1, 0] ** 2 + B[2, 0] ** 2)
        for r in range(3):
            B[r, 0] /= norm
        B[0, 1] = B[1, 2] * B[2, 0] - B[2, 2] * B[1, 0]
        B[1, 1] = B[2, 2] * B[0, 0] - B[0, 2] * B[2, 0]
        B[2, 1] = B[0, 2] * B[1, 0] - B[1, 2] * B[0, 0]
        moved = False
        for k in range(8):
            u, v = step * np.cos(0.25 * np.pi * k), step * np.sin(0.25 * np.pi * k)
            norm = np.sqrt(1.0 + step * step)
            for r in range(3):
                d[r] = (B[r, 0] * u + B[r, 1] * v + B[r, 2]) / norm
            cost = axis_cost(revolute, d, xyz, W, q, trial)
            if cost < best:
                best, moved = cost, True
                copy_1(d, direction)
                copy_1(trial, p)
                break
        if not moved:
            step *= 0.5
    return best
