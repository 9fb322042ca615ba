"""Compiled sub-pixel fits of a checkerboard's corner and of a printed dot: Gauss-Newton on the grey levels.

Both fit a window of the image by a model of what the lens makes of the print: edges blurred by a Gaussian, a
linear run of the illumination, free grey levels. With equal noise in every pixel that is maximum likelihood, and
the normal equations give the centre's covariance.
"""

from __future__ import annotations

from math import atan2, cos, erf, exp, sin, sqrt

import numpy as np

from armsight._numba import inner_kernel, kernel
from armsight.fitting.kernels import invert_spd, solve_damped
from armsight.geometry.kernels import copy_1, copy_2

N_CORNER = 10
"""x, y, direction of the two edges (rad), their blur (px), level, its slope along x and y, half contrast."""
N_DOT = 10
"""x, y, inverse shape matrix (m11, m12, m22 in 1/px^2), blur (px), level, slope along x and y, contrast."""
ITERATIONS = 25
SMALL_STEP_PX = 5e-4
"""A step this short is a tenth of the noise of the sharpest corner."""
SETTLED = 1e-6
"""Relative fall of the squares at which the fit ends."""
BLUR_MIN_PX = 0.25
BLUR_MAX_PX = 12.0
SQRT_HALF = 0.7071067811865476
PEAK = 0.7978845608028654
"""sqrt(2 / pi): slope of erf(d / (sqrt(2) s)) at d = 0, times s."""
FLAT = 5.0
"""Beyond this many standard deviations an edge is taken as flat: it lacks 6e-7 of its height."""
QUANTISATION = 1.0 / 12.0
"""Variance that rounding to whole grey levels leaves; the noise is never believed to be below it."""


@inner_kernel
def _edge(d, s):
    """Return erf(d / (sqrt(2) s)) and its slope by d; beyond FLAT standard deviations exactly flat."""
    z = d / s
    if z > FLAT:
        return 1.0, 0.0
    if z < -FLAT:
        return -1.0, 0.0
    return erf(z * SQRT_HALF), PEAK / s * exp(-0.5 * z * z)


@inner_kernel
def corner_model(p, x, y, j):
    """Return the grey level of a corner at (x, y) relative to the window's centre; fill j (10,) with its derivative.

    Each edge is a normal n_i = (-sin, cos) of its direction, p[10:14], which prepare() keeps in step with p[2:4].
    """
    dx = x - p[0]
    dy = y - p[1]
    c1, s1, c2, s2 = p[10], p[11], p[12], p[13]
    d1 = -s1 * dx + c1 * dy
    d2 = -s2 * dx + c2 * dy
    e1, g1 = _edge(d1, p[4])
    e2, g2 = _edge(d2, p[5])
    a = p[9]
    w1 = a * e2 * g1
    w2 = a * e1 * g2
    j[0] = w1 * s1 + w2 * s2
    j[1] = -w1 * c1 - w2 * c2
    j[2] = -w1 * (c1 * dx + s1 * dy)
    j[3] = -w2 * (c2 * dx + s2 * dy)
    j[4] = -w1 * d1 / p[4]
    j[5] = -w2 * d2 / p[5]
    j[6] = 1.0
    j[7] = x
    j[8] = y
    j[9] = e1 * e2
    return p[6] + p[7] * x + p[8] * y + a * e1 * e2


@inner_kernel
def prepare(p):
    """Fill p[10:14] with cosine and sine of the two edges' directions p[2], p[3]."""
    p[10], p[11] = cos(p[2]), sin(p[2])
    p[12], p[13] = cos(p[3]), sin(p[3])


@inner_kernel
def dot_model(p, x, y, j):
    """Return the grey level of a dot at (x, y) relative to the window's centre; fill j (10,) with its derivative.

    The distance from the ellipse q = d' M d = 1 is (1 - 1/sqrt(q)) |d|, along the ray from the centre, tilted to
    the normal: to first order (q - 1) / (2 |M d|).
    """
    dx = x - p[0]
    dy = y - p[1]
    mx = p[2] * dx + p[3] * dy
    my = p[3] * dx + p[4] * dy
    q = dx * mx + dy * my
    n = sqrt(mx * mx + my * my) + 1e-12
    root = sqrt(q) + 1e-12
    d = (q - root) / n  # zero on the edge, exact for a circle
    s = p[5]
    a = p[9]
    rise, slope = _edge(d, s)
    e = 0.5 * (1.0 - rise)
    g = -0.5 * a * slope  # d level / d d
    dq = (1.0 - 0.5 / root) / n  # d d / d q
    dn = -d / n  # d d / d n
    j[0] = -g * (dq * 2.0 * mx + dn * (p[2] * mx + p[3] * my) / n)
    j[1] = -g * (dq * 2.0 * my + dn * (p[3] * mx + p[4] * my) / n)
    j[2] = g * (dq * dx * dx + dn * mx * dx / n)
    j[3] = g * (dq * 2.0 * dx * dy + dn * (mx * dy + my * dx) / n)
    j[4] = g * (dq * dy * dy + dn * my * dy / n)
    j[5] = -g * d / s
    j[6] = 1.0
    j[7] = x
    j[8] = y
    j[9] = e
    return p[6] + p[7] * x + p[8] * y + a * e


@inner_kernel
def _accumulate(kind, x, y, v, n, p, j, H, g):
    """Fill H = J'J (lower half) and g = J'r of the model in the window; return the sum of squares."""
    m = g.shape[0]
    if kind == 0:
        prepare(p)
    H[:] = 0.0
    g[:] = 0.0
    total = 0.0
    for i in range(n):
        r = (corner_model(p, x[i], y[i], j) if kind == 0 else dot_model(p, x[i], y[i], j)) - v[i]
        total += r * r
        for a in range(m):
            g[a] += j[a] * r
            for b in range(a + 1):
                H[a, b] += j[a] * j[b]
    return total


@inner_kernel
def _possible(kind, p, reach):
    """Tell whether the parameters describe anything: blur in range, centre in the window, a true ellipse."""
    if not (abs(p[0]) < reach and abs(p[1]) < reach):
        return False
    if kind == 0:
        return BLUR_MIN_PX <= p[4] <= BLUR_MAX_PX and BLUR_MIN_PX <= p[5] <= BLUR_MAX_PX
    return BLUR_MIN_PX <= p[5] <= BLUR_MAX_PX and p[2] > 0.0 and p[2] * p[4] - p[3] * p[3] > 0.0


@inner_kernel
def _descend(kind, x, y, v, n, p, reach, H):
    """Improve p (10,) by Levenberg-Marquardt on n samples; H receives J'J (lower half); return the sum of squares."""
    m = H.shape[0]
    g = np.empty(m)
    j = np.empty(m)
    step = np.empty(m)
    trial = np.zeros(p.shape[0])
    H_trial = np.empty((m, m))
    g_trial = np.empty(m)
    damping = 1e-3
    cost = _accumulate(kind, x, y, v, n, p, j, H, g)
    for _ in range(ITERATIONS):
        moved = False
        new = cost
        while damping < 1e6 and not moved:
            if solve_damped(H, g, damping, step):
                for a in range(m):
                    trial[a] = p[a] + step[a]
                if _possible(kind, trial, reach):
                    new = _accumulate(kind, x, y, v, n, trial, j, H_trial, g_trial)
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
def _sample(image, u, v, E, Q, reach_s, reach_t, hole, X, Y, V):
    """Collect the pixels of a window in the board's own axes; return how many.

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
            if n == X.shape[0]:
                return n
            X[n] = dx - 0.5 * (Q[0, 0] * s * s + 2.0 * Q[0, 1] * s * t + Q[0, 2] * t * t)
            Y[n] = dy - 0.5 * (Q[1, 0] * s * s + 2.0 * Q[1, 1] * s * t + Q[1, 2] * t * t)
            V[n] = image[row, col]
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
    X = np.empty(16384)
    Y = np.empty(16384)
    V = np.empty(16384)
    p = np.empty(N_CORNER + 4)
    H = np.empty((N_CORNER, N_CORNER))
    C = np.empty((N_CORNER, N_CORNER))
    for i in range(guess.shape[0]):
        uv[i] = guess[i]
        quality[i] = 0.0
        cov[i] = 0.0
        E = basis[i]
        n = _sample(image, guess[i, 0], guess[i, 1], E, bend[i], reach[i], reach[i], -1.0, X, Y, V)
        if n < 3 * N_CORNER:
            continue
        mean, spread = _levels(V, n)
        if spread < 1.0:
            continue
        size = min(sqrt(E[0, 0] ** 2 + E[1, 0] ** 2), sqrt(E[0, 1] ** 2 + E[1, 1] ** 2))
        p[0] = p[1] = 0.0
        p[2] = atan2(E[1, 0], E[0, 0])
        p[3] = atan2(E[1, 1], E[0, 1])
        p[4] = p[5] = max(0.6, 0.08 * size)
        p[6], p[7], p[8] = mean, 0.0, 0.0
        # left of the edge along the columns is +y, left of the one along the rows is -x
        p[9] = -sign[i] * spread
        cost = _descend(0, X, Y, V, n, p, 0.6 * size, H)
        noise2 = cost / (n - N_CORNER)
        quality[i, 1] = -p[9] * sign[i]
        quality[i, 2] = max(p[4], p[5])
        quality[i, 3] = sqrt(noise2)
        if invert_spd(H, C):
            quality[i, 0] = 1.0 - cost / (n * spread * spread)
            uv[i, 0] = guess[i, 0] + p[0]
            uv[i, 1] = guess[i, 1] + p[1]
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
    X = np.empty(16384)
    Y = np.empty(16384)
    V = np.empty(16384)
    flat = np.zeros((2, 3))
    p = np.empty(N_DOT)
    H = np.empty((N_DOT, N_DOT))
    C = np.empty((N_DOT, N_DOT))
    for i in range(guess.shape[0]):
        uv[i] = guess[i]
        quality[i] = 0.0
        cov[i] = 0.0
        E = shape[i]
        n = _sample(image, guess[i, 0], guess[i, 1], E, flat, reach[i], reach[i], hole, X, Y, V)
        det = E[0, 0] * E[1, 1] - E[0, 1] * E[1, 0]
        if n < 2 * N_DOT or not abs(det) > 0.0:
            continue
        _, spread = _levels(V, n)
        if spread < 1.0:
            continue
        if not _start_dot(X, Y, V, n, E, p):
            continue
        cost = _descend(1, X, Y, V, n, p, 0.6 * sqrt(abs(det)), H)
        noise2 = cost / (n - N_DOT)
        quality[i, 1] = -p[9]
        quality[i, 2] = p[5]
        quality[i, 3] = (p[2] * p[4] - p[3] * p[3]) ** -0.25
        if invert_spd(H, C):
            quality[i, 0] = 1.0 - cost / (n * spread * spread)
            uv[i, 0] = guess[i, 0] + p[0]
            uv[i, 1] = guess[i, 1] + p[1]
            cov[i] = C[:2, :2] * max(noise2, QUANTISATION)
