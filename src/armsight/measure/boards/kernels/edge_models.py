"""Compiled models of a checkerboard's corner and of a printed dot: grey levels, derivatives, normal equations."""

from __future__ import annotations

from math import copysign, cos, sin, sqrt

import numpy as np

from armsight._numba import inline_kernel, inner_kernel, inner_sum_kernel

N_CORNER = 10
"""x, y, direction of the two edges (rad), their blur (px), level, its slope along x and y, half contrast."""
N_DOT = 10
"""x, y, inverse shape matrix (m11, m12, m22 in 1/px^2), blur (px), level, slope along x and y, contrast."""
X, Y, V, REST, ROWS = 7, 8, 10, 11, 12
"""Rows of a window's table, see _accumulate."""
LARGEST = 16384
"""Pixels of a window that are looked at, at most."""
CHUNK, LANES = 320, 32
"""Pixels that are worked on at a time: a table of so many stays in the nearest cache, and its rows, no power of two
apart, do not push each other out of it. They are filled up with zeros to a number that vector instructions divide."""
FLAT, FLAT_PX = 3.5, 0.5
"""A pixel so many blurs, and so many px more, from both edges has its quarter's own level to 5e-4 of the contrast."""
RATIONAL = np.float32(0.3275911 * 0.7071067811865476)
ERF_1, ERF_2, ERF_3, ERF_4, ERF_5 = map(np.float32, (0.254829592, -0.284496736, 1.421413741, -1.453152027, 1.061405429))
"""Of the rational approximation of erf(z / sqrt(2)) in _edge."""
TERM_2, TERM_3, TERM_4, TERM_5, TERM_6 = map(np.float32, (1.0 / 2.0, 1.0 / 6.0, 1.0 / 24.0, 1.0 / 120.0, 1.0 / 720.0))
"""Of the exponential's series. Divisions take half of a fit's time if they are left in: they are made ahead."""
# in single precision, as windows are: one number of double precision makes a loop one, at twice the time
NIL, ONE, HALF, LEAST, BY_64, TINY = map(np.float32, (0.0, 1.0, 0.5, -40.0, 1.0 / 64.0, 1e-12))
PEAK = np.float32(0.7978845608028654)
"""sqrt(2 / pi): slope of erf(d / (sqrt(2) s)) at d = 0, times s."""


@inline_kernel
def _edge(z):
    """Return erf(z / sqrt(2)) to 2e-6 and exp(-z^2 / 2), without a branch or a call, with one division.

    Abramowitz and Stegun 7.1.26. The exponential is the 64th power of its series for a 64th of the exponent.
    """
    w = max(-HALF * z * z, LEAST) * BY_64
    bell = ONE + w * (ONE + w * (TERM_2 + w * (TERM_3 + w * (TERM_4 + w * (TERM_5 + w * TERM_6)))))
    # six times: a loop would not become vector instructions
    bell *= bell
    bell *= bell
    bell *= bell
    bell *= bell
    bell *= bell
    bell *= bell
    t = ONE / (ONE + RATIONAL * abs(z))
    rest = ONE - bell * t * (ERF_1 + t * (ERF_2 + t * (ERF_3 + t * (ERF_4 + t * ERF_5))))
    return copysign(rest, z), bell


@inner_sum_kernel
def corner_rows(n, p, W):
    """Fill derivatives and residuals of a corner, rows of W as accumulate says.

    Each edge's normal is (-sin, cos) of its direction.
    """
    q = p.astype(np.float32)
    c1, s1, c2, s2 = cos(q[2]), sin(q[2]), cos(q[3]), sin(q[3])
    x0, y0, by_1, by_2 = q[0], q[1], ONE / q[4], ONE / q[5]
    level, along_x, along_y, contrast = q[6], q[7], q[8], q[9]
    slope_1, slope_2 = contrast * PEAK * by_1, contrast * PEAK * by_2
    for i in range(n):
        x, y = W[X * CHUNK + i], W[Y * CHUNK + i]
        dx, dy = x - x0, y - y0
        across_1, across_2 = (c1 * dy - s1 * dx) * by_1, (c2 * dy - s2 * dx) * by_2
        e1, bell_1 = _edge(across_1)
        e2, bell_2 = _edge(across_2)
        g1, g2 = slope_1 * bell_1 * e2, slope_2 * bell_2 * e1  # d level / d distance from each edge
        W[i] = g1 * s1 + g2 * s2
        W[CHUNK + i] = -g1 * c1 - g2 * c2
        W[2 * CHUNK + i] = -g1 * (c1 * dx + s1 * dy)
        W[3 * CHUNK + i] = -g2 * (c2 * dx + s2 * dy)
        W[4 * CHUNK + i] = -g1 * across_1
        W[5 * CHUNK + i] = -g2 * across_2
        W[9 * CHUNK + i] = e1 * e2
        W[REST * CHUNK + i] = level + along_x * x + along_y * y + contrast * e1 * e2 - W[V * CHUNK + i]


@inner_sum_kernel
def dot_rows(n, p, W):
    """Fill derivatives and residuals of a dot, rows of W as accumulate says.

    The distance from the ellipse q = d' M d = 1 is (1 - 1/sqrt(q)) |d|, along the ray from the centre, tilted to
    the normal: to first order (q - 1) / (2 |M d|).
    """
    p = p.astype(np.float32)
    by_s, a = ONE / p[5], p[9]
    for i in range(n):
        x, y = W[X * CHUNK + i], W[Y * CHUNK + i]
        dx, dy = x - p[0], y - p[1]
        mx = p[2] * dx + p[3] * dy
        my = p[3] * dx + p[4] * dy
        q = dx * mx + dy * my
        by_length = ONE / (sqrt(mx * mx + my * my) + TINY)
        root = sqrt(q) + TINY
        d = (q - root) * by_length  # zero on the edge, exact for a circle
        rise, bell = _edge(d * by_s)
        e = HALF * (ONE - rise)
        g = -HALF * a * PEAK * by_s * bell  # d level / d d
        dq = (ONE - HALF / root) * by_length  # d d / d q
        dn = -d * by_length * by_length  # d d / d length, over the length
        W[i] = -g * ((dq + dq) * mx + dn * (p[2] * mx + p[3] * my))
        W[CHUNK + i] = -g * ((dq + dq) * my + dn * (p[3] * mx + p[4] * my))
        W[2 * CHUNK + i] = g * (dq * dx * dx + dn * mx * dx)
        W[3 * CHUNK + i] = g * ((dq + dq) * dx * dy + dn * (mx * dy + my * dx))
        W[4 * CHUNK + i] = g * (dq * dy * dy + dn * my * dy)
        W[5 * CHUNK + i] = -g * d * by_s
        W[9 * CHUNK + i] = e
        W[REST * CHUNK + i] = p[6] + p[7] * x + p[8] * y + a * e - W[V * CHUNK + i]


@inner_sum_kernel
def _squares(W, n, full, H, g):
    """Add J'J to H (lower half) and J'r to g, of n columns of W; return the sum of squares of r. Rows: see accumulate.

    Two rows by two, so that a number that was fetched is used twice; by columns, which become vector instructions.
    """
    r = W[REST * CHUNK : REST * CHUNK + n]
    total = NIL
    for i in range(n):
        total += r[i] * r[i]
    for a in range(0, g.shape[0], 2):
        j, k = W[a * CHUNK : a * CHUNK + n], W[(a + 1) * CHUNK : (a + 1) * CHUNK + n]
        s_j = s_k = NIL
        for i in range(n):
            s_j += j[i] * r[i]
            s_k += k[i] * r[i]
        g[a] += s_j
        g[a + 1] += s_k
        for b in range(0, a + 1 if full else 0, 2):
            x, y = W[b * CHUNK : b * CHUNK + n], W[(b + 1) * CHUNK : (b + 1) * CHUNK + n]
            jx = jy = kx = ky = NIL
            for i in range(n):
                jx += j[i] * x[i]
                jy += j[i] * y[i]
                kx += k[i] * x[i]
                ky += k[i] * y[i]
            H[a, b] += jx
            H[a + 1, b] += kx
            H[a + 1, b + 1] += ky
            if b < a:
                H[a, b + 1] += jy
    return total


@inner_sum_kernel
def set_aside(n, p, window, flat):
    """Keep the first of n pixels of a corner's window where an edge is near; fill flat (5, 5); return how many.

    Elsewhere the model is level + slopes + or - contrast, linear in what is left: its normal equations are the sums
    flat of products of one, x, y, sign and grey level, and need not be made anew at every step.
    """
    c1, s1, c2, s2 = cos(p[2]), sin(p[2]), cos(p[3]), sin(p[3])
    near_1, near_2 = FLAT * p[4] + FLAT_PX, FLAT * p[5] + FLAT_PX
    n_x = n_y = n_s = n_v = xx = xy = xs = xv = yy = ys = yv = sv = vv = 0.0
    # sums first, without a branch: of vector instructions
    for i in range(n):
        x, y, v = window[i], window[LARGEST + i], window[2 * LARGEST + i]
        across_1, across_2 = c1 * y - s1 * x, c2 * y - s2 * x
        far = 1.0 if abs(across_1) > near_1 and abs(across_2) > near_2 else 0.0
        s = copysign(far, across_1 * across_2)
        x_far, y_far, v_far = far * x, far * y, far * v
        n_x, n_y, n_s, n_v = n_x + x_far, n_y + y_far, n_s + s, n_v + v_far
        xx, xy, xs, xv = xx + x_far * x, xy + x_far * y, xs + x * s, xv + x_far * v
        yy, ys, yv, sv, vv = yy + y_far * y, ys + y * s, yv + y_far * v, sv + s * v, vv + v_far * v
    kept = 0
    for i in range(n):
        x, y = window[i], window[LARGEST + i]
        window[kept], window[LARGEST + kept] = x, y
        window[2 * LARGEST + kept] = window[2 * LARGEST + i]
        kept += 0 if abs(c1 * y - s1 * x) > near_1 and abs(c2 * y - s2 * x) > near_2 else 1
    one = 1.0 * (n - kept)
    for a, row in enumerate(
        (
            (one, n_x, n_y, n_s, n_v),
            (n_x, xx, xy, xs, xv),
            (n_y, xy, yy, ys, yv),
            (n_s, xs, ys, one, sv),
            (n_v, xv, yv, sv, vv),
        )
    ):
        for b in range(5):
            flat[a, b] = row[b]
    return kept


@inner_kernel
def accumulate(kind, n, p, window, flat, W, full, H, g):
    """Fill H = J'J (lower half) and g = J'r of the model in the window; return the sum of squares.

    window: rows of LARGEST, the pixels' places from the window's centre and grey levels. W: rows of CHUNK, the same for
    some of them at a time: ten derivatives, of which those of the level and its slopes are ones and the places X and Y;
    grey levels V and residuals REST. Both are flat, and their rows a constant apart, so that the compiler knows that
    they do not overlap, and makes vector instructions of a loop that fills them all. flat: of pixels set aside.
    """
    if full:
        H[:] = 0.0
    g[:] = 0.0
    cost = flat[4, 4]
    for a in range(4):
        for b in range(4):
            g[6 + a] += flat[a, b] * p[6 + b]
            if full and b <= a:
                H[6 + a, 6 + b] = flat[a, b]
        g[6 + a] -= flat[a, 4]
        cost += p[6 + a] * (g[6 + a] - flat[a, 4])
    for begin in range(0, n, CHUNK):
        left = min(CHUNK, n - begin)
        m = (left + LANES - 1) // LANES * LANES
        for i in range(m):
            W[6 * CHUNK + i] = ONE
            W[X * CHUNK + i] = window[begin + i]
            W[Y * CHUNK + i] = window[LARGEST + begin + i]
            W[V * CHUNK + i] = window[2 * LARGEST + begin + i]
        if kind == 0:
            corner_rows(m, p, W)
        else:
            dot_rows(m, p, W)
        for row in range(ROWS):
            for i in range(left, m):
                W[row * CHUNK + i] = NIL
        cost += _squares(W, m, full, H, g)
    return cost
