"""Compiled sub-pixel fits of a checkerboard's corner and of a printed dot: Gauss-Newton on the grey levels.

Both fit a window of the image by a model of what the lens makes of the print: edges blurred by a Gaussian, a
linear run of the illumination, free grey levels. With equal noise in every pixel that is maximum likelihood, and
the normal equations give the centre's covariance.
"""

from __future__ import annotations

from math import atan2, copysign, cos, sin, sqrt

import numpy as np

from armsight._numba import inline_kernel, inner_kernel, inner_sum_kernel, kernel
from armsight.fitting.kernels import invert_spd, solve_damped
from armsight.geometry.kernels import copy_1, copy_2

N_CORNER = 10
"""x, y, direction of the two edges (rad), their blur (px), level, its slope along x and y, half contrast."""
N_DOT = 10
"""x, y, inverse shape matrix (m11, m12, m22 in 1/px^2), blur (px), level, slope along x and y, contrast."""
X, Y, V, REST, FREE, ROWS = 7, 8, 10, 11, 12, 16
"""Rows of a window's table, see _accumulate."""
LARGEST = 16384
"""Pixels of a window that are looked at, at most."""
ITERATIONS = 25
SMALL_STEP_PX = 5e-4
"""A step this short is a tenth of the noise of the sharpest corner."""
SETTLED = 1e-6
"""Relative fall of the squares at which the fit ends."""
BLUR_MIN_PX = 0.25
BLUR_MAX_PX = 12.0
RATIONAL = 0.3275911 * 0.7071067811865476
ERF_1, ERF_2, ERF_3, ERF_4, ERF_5 = 0.254829592, -0.284496736, 1.421413741, -1.453152027, 1.061405429
"""Of the rational approximation of erf(z / sqrt(2)) in _edge."""
PEAK = 0.7978845608028654
"""sqrt(2 / pi): slope of erf(d / (sqrt(2) s)) at d = 0, times s."""
QUANTISATION = 1.0 / 12.0
"""Variance that rounding to whole grey levels leaves; the noise is never believed to be below it."""


@inline_kernel
def _edge(z):
    """Return erf(z / sqrt(2)) to 1.5e-7 and exp(-z^2 / 2), without a branch or a call.

    Abramowitz and Stegun 7.1.26. The exponential is the 64th power of its series for a 64th of the exponent.
    """
    w = max(-0.5 * z * z, -40.0) / 64.0
    bell = 1.0 + w * (1.0 + w / 2.0 * (1.0 + w / 3.0 * (1.0 + w / 4.0 * (1.0 + w / 5.0 * (1.0 + w / 6.0)))))
    bell *= bell
    bell *= bell
    bell *= bell
    bell *= bell
    bell *= bell
    bell *= bell
    t = 1.0 / (1.0 + RATIONAL * abs(z))
    rest = 1.0 - bell * t * (ERF_1 + t * (ERF_2 + t * (ERF_3 + t * (ERF_4 + t * ERF_5))))
    return copysign(rest, z), bell


@inner_sum_kernel
def _edges(x, y, n, p, k, e, bell):
    """Fill e (n,) and bell (n,) with _edge at the distances from edge k (0, 1) of a corner."""
    c, s, by = cos(p[2 + k]), sin(p[2 + k]), 1.0 / p[4 + k]
    x0, y0 = p[0], p[1]
    for i in range(n):
        e[i], bell[i] = _edge((c * (y[i] - y0) - s * (x[i] - x0)) * by)


@inner_sum_kernel
def _turned(x, y, n, p, k, e, bell, turn, blur):
    """Turn bell (n,) into the slope across edge k of a corner, and fill the derivatives by its direction and blur."""
    c, s, by = cos(p[2 + k]), sin(p[2 + k]), 1.0 / p[4 + k]
    x0, y0, slope = p[0], p[1], p[9] * PEAK / p[4 + k]
    for i in range(n):
        bell[i] *= slope * e[i]
    for i in range(n):
        turn[i] = -bell[i] * (c * (x[i] - x0) + s * (y[i] - y0))
    for i in range(n):
        blur[i] = -bell[i] * (c * (y[i] - y0) - s * (x[i] - x0)) * by


@inner_sum_kernel
def corner_rows(n, p, W):
    """Fill derivatives and residuals of a corner, rows of W as _accumulate says.

    Each edge's normal is (-sin, cos) of its direction. Each loop fills a row or two without a branch or a call, so that
    the compiler makes vector instructions of it.
    """
    x, y, e1, bell_1, e2, bell_2 = W[X], W[Y], W[FREE], W[FREE + 1], W[FREE + 2], W[FREE + 3]
    _edges(x, y, n, p, 0, e1, bell_1)
    _edges(x, y, n, p, 1, e2, bell_2)
    product, r, v = W[9], W[REST], W[V]
    for i in range(n):
        product[i] = e1[i] * e2[i]
    _turned(x, y, n, p, 0, e2, bell_1, W[2], W[4])
    _turned(x, y, n, p, 1, e1, bell_2, W[3], W[5])
    c1, s1, c2, s2 = cos(p[2]), sin(p[2]), cos(p[3]), sin(p[3])
    by_x, by_y = W[0], W[1]
    for i in range(n):
        by_x[i] = bell_1[i] * s1 + bell_2[i] * s2
    for i in range(n):
        by_y[i] = -bell_1[i] * c1 - bell_2[i] * c2
    level, along_x, along_y, contrast = p[6], p[7], p[8], p[9]
    for i in range(n):
        r[i] = level + along_x * x[i] + along_y * y[i] + contrast * product[i] - v[i]


@inner_sum_kernel
def dot_rows(n, p, W):
    """Fill derivatives and residuals of a dot, rows of W as _accumulate says.

    The distance from the ellipse q = d' M d = 1 is (1 - 1/sqrt(q)) |d|, along the ray from the centre, tilted to
    the normal: to first order (q - 1) / (2 |M d|).
    """
    x, y, r, v = W[X], W[Y], W[REST], W[V]
    s, a = p[5], p[9]
    for i in range(n):
        dx = x[i] - p[0]
        dy = y[i] - p[1]
        mx = p[2] * dx + p[3] * dy
        my = p[3] * dx + p[4] * dy
        q = dx * mx + dy * my
        length = sqrt(mx * mx + my * my) + 1e-12
        root = sqrt(q) + 1e-12
        d = (q - root) / length  # zero on the edge, exact for a circle
        rise, bell = _edge(d / s)
        e = 0.5 * (1.0 - rise)
        g = -0.5 * a * PEAK / s * bell  # d level / d d
        dq = (1.0 - 0.5 / root) / length  # d d / d q
        dn = -d / length  # d d / d length
        W[0, i] = -g * (dq * 2.0 * mx + dn * (p[2] * mx + p[3] * my) / length)
        W[1, i] = -g * (dq * 2.0 * my + dn * (p[3] * mx + p[4] * my) / length)
        W[2, i] = g * (dq * dx * dx + dn * mx * dx / length)
        W[3, i] = g * (dq * 2.0 * dx * dy + dn * (mx * dy + my * dx) / length)
        W[4, i] = g * (dq * dy * dy + dn * my * dy / length)
        W[5, i] = -g * d / s
        W[9, i] = e
        r[i] = p[6] + p[7] * x[i] + p[8] * y[i] + a * e - v[i]


@inner_sum_kernel
def _squares(J, r, n, H, g):
    """Fill H = J'J (lower half) and g = J'r of derivatives J (m, N), row by row; return the sum of squares of r.

    By columns of the window, which the compiler turns into vector instructions, and not pixel by pixel.
    """
    for a in range(g.shape[0]):
        s = 0.0
        for i in range(n):
            s += J[a, i] * r[i]
        g[a] = s
        for b in range(a + 1):
            s = 0.0
            for i in range(n):
                s += J[a, i] * J[b, i]
            H[a, b] = s
    total = 0.0
    for i in range(n):
        total += r[i] * r[i]
    return total


@inner_kernel
def _accumulate(kind, n, p, W, H, g):
    """Fill H = J'J (lower half) and g = J'r of the model in the window; return the sum of squares.

    Rows of W (16, N): ten derivatives, of which those of the level and its slopes are ones and the pixels' places X
    and Y from the window's centre; their grey levels V, residuals REST, and four that are free.
    """
    if kind == 0:
        corner_rows(n, p, W)
    else:
        dot_rows(n, p, W)
    return _squares(W, W[REST], n, H, g)


@inner_kernel
def _possible(kind, p, reach):
    """Tell whether the parameters describe anything: blur in range, centre in the window, a true ellipse."""
    if not (abs(p[0]) < reach and abs(p[1]) < reach):
        return False
    if kind == 0:
        return BLUR_MIN_PX <= p[4] <= BLUR_MAX_PX and BLUR_MIN_PX <= p[5] <= BLUR_MAX_PX
    return BLUR_MIN_PX <= p[5] <= BLUR_MAX_PX and p[2] > 0.0 and p[2] * p[4] - p[3] * p[3] > 0.0


@inner_kernel
def _descend(kind, n, p, reach, H, W):
    """Improve p (10,) by Levenberg-Marquardt on n samples; H receives J'J (lower half); return the sum of squares.

    W (16, N): see _accumulate.
    """
    m = H.shape[0]
    g = np.empty(m)
    step = np.empty(m)
    trial = np.zeros(p.shape[0])
    H_trial = np.empty((m, m))
    g_trial = np.empty(m)
    damping = 1e-3
    cost = _accumulate(kind, n, p, W, H, g)
    for _ in range(ITERATIONS):
        moved = False
        new = cost
        while damping < 1e6 and not moved:
            if solve_damped(H, g, damping, step):
                for a in range(m):
                    trial[a] = p[a] + step[a]
                if _possible(kind, trial, reach):
                    new = _accumulate(kind, n, trial, W, H_trial, g_trial)
                    moved = new <= cost
            if not moved:
                damping *= 10.0
        if not moved:
            return cost
        settled = cost - new <= SETTLED * cost
        cost = new
        copy_1(trial, p)
        copy_1(g_trial, g)
        copy_2(H_trial, H)
        damping = max(damping * 0.1, 1e-9)
        # not while it is damped: a short step is then of the damping, not of the minimum
        if (settled or abs(step[0]) + abs(step[1]) < SMALL_STEP_PX) and damping < 1.0:
            return cost
    return cost


@inner_kernel
def _levels(v, n):
    """Return the mean and standard deviation of n samples."""
    mean = 0.0
    for i in range(n):
        mean += v[i]
    mean /= n
    var = 0.0
    for i in range(n):
        var += (v[i] - mean) ** 2
    return mean, sqrt(var / n)


@inner_kernel
def _sample(image, u, v, E, Q, reach_s, reach_t, hole, W):
    """Collect the pixels of a window in the board's own axes, in rows of W (16, N); return how many.

    E (2, 2): columns are the image steps of one unit along the board's x and y. Q (2, 3): second derivatives
    by ss, st, tt, taken off so that curved edges become straight. hole: pixels with s^2 + t^2 below it are left out,
    and those beyond reach_s^2, so that the window is a ring; negative: all of the window.
    """
    h, w = image.shape
    det = E[0, 0] * E[1, 1] - E[0, 1] * E[1, 0]
    bx = abs(E[0, 0]) * reach_s + abs(E[0, 1]) * reach_t
    by = abs(E[1, 0]) * reach_s + abs(E[1, 1]) * reach_t
    n = 0
    for row in range(max(0, int(v - by)), min(h, int(v + by) + 2)):
        for col in range(max(0, int(u - bx)), min(w, int(u + bx) + 2)):
            dx = col - u
            dy = row - v
            s = (E[1, 1] * dx - E[0, 1] * dy) / det
            t = (E[0, 0] * dy - E[1, 0] * dx) / det
            if abs(s) > reach_s or abs(t) > reach_t:
                continue
            if hole >= 0.0 and not hole <= s * s + t * t <= reach_s * reach_s:
                continue
            if n == W.shape[1]:
                return n
            W[X, n] = dx - 0.5 * (Q[0, 0] * s * s + 2.0 * Q[0, 1] * s * t + Q[0, 2] * t * t)
            W[Y, n] = dy - 0.5 * (Q[1, 0] * s * s + 2.0 * Q[1, 1] * s * t + Q[1, 2] * t * t)
            W[V, n] = image[row, col]
            W[6, n] = 1.0
            n += 1
    return n


@kernel
def fit_corners(image, guess, basis, bend, reach, sign, uv, cov, quality):
    """Fit each corner of a checkerboard.

    image (h, w) uint8. guess (n, 2) px. basis (n, 2, 2): image step of one square along the board's columns and rows.
    bend (n, 2, 3): second derivatives of that map. reach (n,): half window in squares. sign (n,): +1 where
    the squares at (+,+) and (-,-) are white, -1 where black. Fills uv (n, 2), cov (n, 2, 2) px^2 and
    quality (n, 4): share of the grey levels' variance explained, contrast with the expected sign, blur px,
    noise in grey levels; explained is 0 where the fit is impossible.
    """
    W = np.empty((ROWS, LARGEST))
    p = np.empty(N_CORNER)
    H = np.empty((N_CORNER, N_CORNER))
    C = np.empty((N_CORNER, N_CORNER))
    for i in range(guess.shape[0]):
        uv[i] = guess[i]
        quality[i] = 0.0
        cov[i] = 0.0
        E = basis[i]
        n = _sample(image, guess[i, 0], guess[i, 1], E, bend[i], reach[i], reach[i], -1.0, W)
        if n < 3 * N_CORNER:
            continue
        mean, spread = _levels(W[V], n)
        if spread < 1.0:
            continue
        size = min(sqrt(E[0, 0] ** 2 + E[1, 0] ** 2), sqrt(E[0, 1] ** 2 + E[1, 1] ** 2))
        p[0] = p[1] = 0.0
        p[2] = atan2(E[1, 0], E[0, 0])
        p[3] = atan2(E[1, 1], E[0, 1])
        # rather too blurred than too sharp: an edge without slope where the picture's lies cannot find it
        p[4] = p[5] = max(0.6, 0.08 * size)
        p[6], p[7], p[8] = mean, 0.0, 0.0
        # left of the edge along the columns is +y, left of the one along the rows is -x
        p[9] = -sign[i] * spread
        cost = _descend(0, n, p, 0.6 * size, H, W)
        noise2 = cost / (n - N_CORNER)
        quality[i, 1] = -p[9] * sign[i]
        quality[i, 2] = max(p[4], p[5])
        quality[i, 3] = sqrt(noise2)
        if invert_spd(H, C):
            quality[i, 0] = 1.0 - cost / (n * spread * spread)
            uv[i, 0] = guess[i, 0] + p[0]
            uv[i, 1] = guess[i, 1] + p[1]
            # H is of noise of one grey level; what the residuals show is never less than rounding leaves
            cov[i] = C[:2, :2] * max(noise2, QUANTISATION)


@inner_kernel
def _start_dot(x, y, v, n, E, p):
    """Fill p with the ellipse of half axes E and the grey levels met inside and outside; False where one is empty."""
    inside = 0.0
    n_inside = 0
    outside = 0.0
    n_outside = 0
    det = E[0, 0] * E[1, 1] - E[0, 1] * E[1, 0]
    M = np.empty((2, 2))  # (E E')^-1
    M[0, 0] = (E[1, 0] ** 2 + E[1, 1] ** 2) / det**2
    M[1, 1] = (E[0, 0] ** 2 + E[0, 1] ** 2) / det**2
    M[0, 1] = -(E[0, 0] * E[1, 0] + E[0, 1] * E[1, 1]) / det**2
    for k in range(n):
        q = M[0, 0] * x[k] * x[k] + 2.0 * M[0, 1] * x[k] * y[k] + M[1, 1] * y[k] * y[k]
        if q < 0.7:
            inside += v[k]
            n_inside += 1
        elif q > 1.5:
            outside += v[k]
            n_outside += 1
    if n_inside == 0 or n_outside == 0:
        return False
    p[0] = p[1] = 0.0
    p[2], p[3], p[4] = M[0, 0], M[0, 1], M[1, 1]
    p[5] = 0.8
    p[6], p[7], p[8] = outside / n_outside, 0.0, 0.0
    p[9] = inside / n_inside - p[6]
    return True


@kernel
def fit_dots(image, guess, shape, reach, hole, uv, cov, quality):
    """Fit each printed dot as a blurred ellipse.

    guess (n, 2) px. shape (n, 2, 2): columns are the half axes of the ellipse in px. reach (n,): half window in
    half axes. hole: pixels nearer the centre than sqrt(hole) half axes are left out (glare sits there). Fills uv,
    cov and quality (n, 4) as fit_corners does; contrast is positive for dark dots, and the last is the mean
    radius in px.
    """
    W = np.empty((ROWS, LARGEST))
    flat = np.zeros((2, 3))
    p = np.empty(N_DOT)
    H = np.empty((N_DOT, N_DOT))
    C = np.empty((N_DOT, N_DOT))
    for i in range(guess.shape[0]):
        uv[i] = guess[i]
        quality[i] = 0.0
        cov[i] = 0.0
        E = shape[i]
        n = _sample(image, guess[i, 0], guess[i, 1], E, flat, reach[i], reach[i], hole, W)
        det = E[0, 0] * E[1, 1] - E[0, 1] * E[1, 0]
        if n < 2 * N_DOT or not abs(det) > 0.0:
            continue
        _, spread = _levels(W[V], n)
        if spread < 1.0:
            continue
        if not _start_dot(W[X], W[Y], W[V], n, E, p):
            continue
        cost = _descend(1, n, p, 0.6 * sqrt(abs(det)), H, W)
        noise2 = cost / (n - N_DOT)
        quality[i, 1] = -p[9]
        quality[i, 2] = p[5]
        quality[i, 3] = (p[2] * p[4] - p[3] * p[3]) ** -0.25
        if invert_spd(H, C):
            quality[i, 0] = 1.0 - cost / (n * spread * spread)
            uv[i, 0] = guess[i, 0] + p[0]
            uv[i, 1] = guess[i, 1] + p[1]
            cov[i] = C[:2, :2] * max(noise2, QUANTISATION)
