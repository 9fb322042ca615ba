"""Compiled sub-pixel fits of a checkerboard's corner and of a printed dot: Gauss-Newton on the grey levels.

Both fit a window of the image by a model of what the lens makes of the print: edges blurred by a Gaussian, a
linear run of the illumination, free grey levels. With equal noise in every pixel that is maximum likelihood, and
the normal equations give the centre's covariance.
"""

from __future__ import annotations

from math import atan2, ceil, floor, pi, sqrt

import numpy as np

from armsight._numba import inner_kernel, inner_sum_kernel, kernel
from armsight.fitting.kernels import invert_spd, solve_damped
from armsight.geometry.kernels import copy_1, copy_2
from armsight.measure.boards.kernels.edge_models import CHUNK, LARGEST, N_CORNER, N_DOT, ROWS, accumulate, set_aside

ALONE = np.empty((0, N_CORNER))
"""No earlier fit to start from."""
EVERYTHING = np.inf
"""Share of a white square to look at where no marker stands in it."""
TRIALS = 40
"""Evaluations of the model after which a fit ends where it is; a true corner takes two to eight."""
LAST_STEP_PX = 3e-3
"""A step this short is within the noise of the sharpest corner; it is taken, and the model is not evaluated again: what
is left then is a tenth of it at most."""
NEAR_PX, NEAR = 0.1, 0.04
"""After a step so short, whose blur changes by no more than this share, the normal matrix is the one before."""
SETTLED = 1e-6
"""Relative fall of the squares at which the fit ends."""
BLUR_MIN_PX = 0.25
BLUR_MAX_PX = 12.0
FIRST_BLUR_PX = 8.0
EDGE_SHARE = 1.02
"""A window has no more pixels than so many times its area: those that its edge cuts count too."""
QUANTISATION = 1.0 / 12.0
"""Variance that rounding to whole grey levels leaves; the noise is never believed to be below it."""


@inner_kernel
def _possible(kind, p, reach):
    """Tell whether the parameters describe anything: blur in range, centre in the window, a true ellipse."""
    if not (abs(p[0]) < reach and abs(p[1]) < reach):
        return False
    if kind == 0:
        return BLUR_MIN_PX <= p[4] <= BLUR_MAX_PX and BLUR_MIN_PX <= p[5] <= BLUR_MAX_PX
    return BLUR_MIN_PX <= p[5] <= BLUR_MAX_PX and p[2] > 0.0 and p[2] * p[4] - p[3] * p[3] > 0.0


@inner_kernel
def _descend(kind, n, p, reach, last_px, most, H, window, flat, W):
    """Improve p (10,) by Levenberg-Marquardt on n samples; H receives J'J (lower half); return the sum of squares.

    last_px: a step so short is the last. most: how often the model may be evaluated. window, flat, W: see
    accumulate.
    """
    m = H.shape[0]
    g, step, trial = np.empty(m), np.empty(m), np.zeros(p.shape[0])
    H_trial, g_trial = np.empty((m, m)), np.empty(m)
    damping = 1e-3
    cost = accumulate(kind, n, p, window, flat, W, True, H, g)
    evaluated = 1
    settled = False
    while evaluated < most and damping < 1e6:
        moved = False
        if solve_damped(H, g, damping, step):
            for a in range(m):
                trial[a] = p[a] + step[a]
            moved = _possible(kind, trial, reach)
        short = abs(step[0]) + abs(step[1])
        # not while it is damped: a short step is then of the damping, not of the minimum
        if moved and evaluated > 1 and damping < 1.0 and (settled or short < last_px):
            for a in range(m):
                cost += g[a] * step[a]  # by as much the squares fall to the minimum of the parabola
            copy_1(trial, p)
            return cost
        if moved:
            near = kind == 0 and short < NEAR_PX and max(abs(step[4]) / p[4], abs(step[5]) / p[5]) < NEAR
            new = accumulate(kind, n, trial, window, flat, W, not near, H_trial, g_trial)
            evaluated += 1
            moved = new <= cost
        if not moved:
            damping *= 10.0
            continue
        settled = cost - new <= SETTLED * cost
        cost = new
        copy_1(trial, p)
        copy_1(g_trial, g)
        if not near:
            copy_2(H_trial, H)
        damping = max(damping * 0.1, 1e-9)
    return cost


@inner_sum_kernel
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
def _ring(window, n, count, turn, hole, reach):
    """Keep those of a row's pixels, count from the n-th on, on a ring; return how many. turn: px to the ring's axes."""
    sx, sy, tx, ty = turn
    kept = 0
    for k in range(n, n + count):
        x, y = window[k], window[LARGEST + k]
        s, t = sx * x + sy * y, tx * x + ty * y
        if hole <= s * s + t * t <= reach * reach:
            for row in range(3):
                window[row * LARGEST + n + kept] = window[row * LARGEST + k]
            kept += 1
    return kept


@inner_kernel
def _sample(image, u, v, E, Q, reach, hole, window):
    """Collect the pixels of a window in the board's own axes, in window; return how many.

    E (2, 2): columns are the image steps of one unit along the board's x and y. Q (2, 3): second derivatives
    by ss, st, tt, taken off so that curved edges become straight. hole: pixels with s^2 + t^2 below it are left out,
    and those beyond reach^2, so that the window is a ring; negative: all of the window. Of one with more than LARGEST
    pixels every second row is taken, or every third: cut off where the table is full it would lean to one side.
    """
    h, w = image.shape
    det = E[0, 0] * E[1, 1] - E[0, 1] * E[1, 0]
    by_det = 1.0 / det
    size = abs(det) * (4.0 * reach * reach if hole < 0.0 else pi * (reach * reach - hole))
    step = 1 + int(EDGE_SHARE * size / LARGEST)
    sx, sy, tx, ty = E[1, 1] * by_det, -E[0, 1] * by_det, -E[1, 0] * by_det, E[0, 0] * by_det
    bx = abs(E[0, 0]) * reach + abs(E[0, 1]) * reach
    by = abs(E[1, 0]) * reach + abs(E[1, 1]) * reach
    # by names of their own: an array's entries are read anew for each pixel, since what is filled might be they
    single = np.float32
    u_ss, u_st, u_tt = single(0.5 * Q[0, 0]), single(Q[0, 1]), single(0.5 * Q[0, 2])
    v_ss, v_st, v_tt = single(0.5 * Q[1, 0]), single(Q[1, 1]), single(0.5 * Q[1, 2])
    n = 0
    for row in range(max(0, int(v - by)), min(h, int(v + by) + 2), step):
        dy = row - v
        low, high = max(u - bx, 0.0), min(u + bx, w - 1.0)
        for along, beside in ((sx, sy * dy), (tx, ty * dy)):  # |along dx + beside| <= reach
            if abs(along) * w > reach:
                middle, half = u - beside / along, reach / abs(along)
                low, high = max(low, middle - half), min(high, middle + half)
            elif abs(beside) > reach:
                high = low - 1.0
        first = ceil(low)
        count = max(0, min(floor(high) + 1 - first, LARGEST - n))
        here = image[row, first : first + count]
        x, y = window[n : n + count], window[LARGEST + n : LARGEST + n + count]
        level = window[2 * LARGEST + n : 2 * LARGEST + n + count]
        begin, down = single(first - u), single(dy)
        s_x, s_y, t_x, t_y = single(sx), single(sy * dy), single(tx), single(ty * dy)
        for k in range(count):
            dx = begin + single(k)
            s = s_x * dx + s_y
            t = t_x * dx + t_y
            x[k] = dx - (u_ss * s * s + u_st * s * t + u_tt * t * t)
            y[k] = down - (v_ss * s * s + v_st * s * t + v_tt * t * t)
            level[k] = here[k]
        n += count if hole < 0.0 else _ring(window, n, count, (sx, sy, tx, ty), hole, reach)
    return n


@inner_kernel
def _unmarked(window, n, E, sign, clear):
    """Keep those of n pixels that are not in a marker, further than clear from both edges of a white field."""
    by_det = 1.0 / (E[0, 0] * E[1, 1] - E[0, 1] * E[1, 0])
    sx, sy, tx, ty = E[1, 1] * by_det, -E[0, 1] * by_det, -E[1, 0] * by_det, E[0, 0] * by_det
    kept = 0
    for k in range(n):
        x, y = window[k], window[LARGEST + k]
        s, t = sx * x + sy * y, tx * x + ty * y
        if sign * s * t < 0.0 or abs(s) < clear or abs(t) < clear:
            for row in range(3):
                window[row * LARGEST + kept] = window[row * LARGEST + k]
            kept += 1
    return kept


@inner_kernel
def _start_corner(E, sign, mean, spread, p):
    """Fill p with a corner in the middle of a window whose edges run along the grid."""
    size = min(sqrt(E[0, 0] ** 2 + E[1, 0] ** 2), sqrt(E[0, 1] ** 2 + E[1, 1] ** 2))
    p[2] = atan2(E[1, 0], E[0, 0])
    p[3] = atan2(E[1, 1], E[0, 1])
    # rather too blurred than too sharp: an edge without slope where the picture's lies cannot find it; but no more than
    # there can be, which squares of 150 px would have
    p[4] = p[5] = max(0.6, min(0.08 * size, FIRST_BLUR_PX))
    p[6], p[7], p[8] = mean, 0.0, 0.0
    # left of the edge along the columns is +y, left of the one along the rows is -x
    p[9] = -sign * spread
    return size


@kernel
def fit_corners(image, guess, basis, bend, reach, sign, like, last_px, most, clear):
    """Fit each corner of a checkerboard; return uv (n, 2), covariance (n, 2, 2) px^2, quality and parameters (n, 10).

    image (h, w) uint8. guess (n, 2) px. basis (n, 2, 2): image step of one square along the board's columns and rows.
    bend (n, 2, 3): second derivatives of that map. reach (n,): half window in squares. sign (n,): +1 where
    the squares at (+,+) and (-,-) are white, -1 where black. like (n, 10): an earlier fit's parameters to start
    from, NaN for none, or (0, 10). last_px: a step so short is a fit's last. most: how often the model is evaluated for
    a corner. clear: what of a white square is further than this from both edges, in squares, is not looked at: a marker
    is there. quality (n, 4): share of the grey levels' variance explained, contrast with the expected sign, blur px,
    noise in grey levels; explained is 0 where the fit is impossible.
    """
    N = guess.shape[0]
    uv, cov, quality = guess.copy(), np.zeros((N, 2, 2)), np.zeros((N, 4))
    window, W = np.zeros(3 * LARGEST + CHUNK, np.float32), np.empty(ROWS * CHUNK, np.float32)
    found, flat = np.full((N, N_CORNER), np.nan), np.zeros((5, 5))
    H, C = np.empty((N_CORNER, N_CORNER)), np.empty((N_CORNER, N_CORNER))
    for i in range(N):
        n = _sample(image, guess[i, 0], guess[i, 1], basis[i], bend[i], reach[i], -1.0, window)
        if clear < reach[i]:
            n = _unmarked(window, n, basis[i], sign[i], clear)
        if n < 3 * N_CORNER:
            continue
        mean, spread = _levels(window[2 * LARGEST :], n)
        if spread < 1.0:
            continue
        p = found[i]
        size = _start_corner(basis[i], sign[i], mean, spread, p)
        near, flat[:] = n, 0.0
        if len(like) > 0 and not np.isnan(like[i, 0]):
            copy_1(like[i], p)
            near = set_aside(n, p, window, flat)
        p[0] = p[1] = 0.0
        cost = _descend(0, near, p, 0.6 * size, last_px, most, H, window, flat, W)
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
    return uv, cov, quality, found


@inner_kernel
def _start_dot(x, y, v, n, E, p):
    """Fill p with the ellipse of half axes E and the grey levels met inside and outside; False where one is empty."""
    inside = outside = 0.0
    n_inside = n_outside = 0
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
def fit_dots(image, guess, shape, reach, hole, most):
    """Fit each printed dot as a blurred ellipse; return uv (n, 2), covariance (n, 2, 2) px^2 and quality (n, 4).

    guess (n, 2) px. shape (n, 2, 2): columns are the half axes of the ellipse in px. reach (n,): half window in
    half axes. hole: pixels nearer the centre than sqrt(hole) half axes are left out (glare sits there). most: how often
    the model is evaluated for a dot. quality is as fit_corners gives it; contrast is positive for dark dots, and the
    last is the mean radius in px.
    """
    N = guess.shape[0]
    uv, cov, quality = guess.copy(), np.zeros((N, 2, 2)), np.zeros((N, 4))
    window, W = np.zeros(3 * LARGEST + CHUNK, np.float32), np.empty(ROWS * CHUNK, np.float32)
    straight, flat = np.zeros((2, 3)), np.zeros((5, 5))
    p, H, C = np.empty(N_DOT), np.empty((N_DOT, N_DOT)), np.empty((N_DOT, N_DOT))
    for i in range(N):
        E = shape[i]
        n = _sample(image, guess[i, 0], guess[i, 1], E, straight, reach[i], hole, window)
        det = E[0, 0] * E[1, 1] - E[0, 1] * E[1, 0]
        if n < 2 * N_DOT or not abs(det) > 0.0:
            continue
        _, spread = _levels(window[2 * LARGEST :], n)
        if spread < 1.0:
            continue
        if not _start_dot(window[:LARGEST], window[LARGEST:], window[2 * LARGEST :], n, E, p):
            continue
        cost = _descend(1, n, p, 0.6 * sqrt(abs(det)), LAST_STEP_PX, most, H, window, flat, W)
        noise2 = cost / (n - N_DOT)
        quality[i, 1] = -p[9]
        quality[i, 2] = p[5]
        quality[i, 3] = (p[2] * p[4] - p[3] * p[3]) ** -0.25
        if invert_spd(H, C):
            quality[i, 0] = 1.0 - cost / (n * spread * spread)
            uv[i, 0] = guess[i, 0] + p[0]
            uv[i, 1] = guess[i, 1] + p[1]
            cov[i] = C[:2, :2] * max(noise2, QUANTISATION)
    return uv, cov, quality


# Search for a square's corners with the X-shaped templates of Pachidis et al. 2005, appendix.

RINGS = 5
"""The legs of the 11 x 11 template are five pixels long."""


@inner_kernel
def _matches(labels, own, u, v, legs, rings):
    """Return how many of the legs' pixels have the right colour: the first leg the square's, the other three not."""
    h, w = labels.shape
    right = 0
    for leg in range(4):
        for k in range(1, rings + 1):
            col = u + int(np.rint(k * legs[leg, 0]))
            row = v + int(np.rint(k * legs[leg, 1]))
            inside = 0 <= col < w and 0 <= row < h and labels[row, col] == own
            if inside == (leg == 0):
                right += 1
    return right


@inner_kernel
def _aim(quad, corner, legs):
    """Fill legs (4, 2): from the corner into the square, then through the three sectors outside; largest entry 1.

    For a square that stands upright they are the diagonals of the paper's template in one of its four orientations.
    """
    e1 = quad[(corner + 1) % 4] - quad[corner]
    e2 = quad[(corner + 3) % 4] - quad[corner]
    e1 = e1 / (np.hypot(e1[0], e1[1]) + 1e-12)
    e2 = e2 / (np.hypot(e2[0], e2[1]) + 1e-12)
    for axis in range(2):
        legs[0, axis] = e1[axis] + e2[axis]
        legs[1, axis] = e1[axis] - e2[axis]
    for leg in range(2):
        longest = max(abs(legs[leg, 0]), abs(legs[leg, 1])) + 1e-12
        for axis in range(2):
            legs[leg, axis] /= longest
            legs[leg + 2, axis] = -legs[leg, axis]


@kernel
def place_corners(labels, own, quads, radius, rings, corners, score):
    """Place the four corners of each square at the mean of their inner and outer peaks.

    labels (h, w) int32: which square each pixel belongs to. own (n,): the squares' labels. quads (n, 4, 2): rough
    corners, px, in order round the square. radius (n,), rings (n,): how far to search and how long the legs are,
    px. Fills corners (n, 4, 2) and score (n, 4), the share of the legs' pixels that fit at the two peaks.

    The template whose centre is the square's colour peaks at the corner's inner pixel, the one whose centre is
    the substrate's at its outer pixel; several pixels with the same response count with their mean.
    """
    h, w = labels.shape
    legs = np.empty((4, 2))
    for i in range(len(own)):
        for c in range(4):
            _aim(quads[i], c, legs)
            best = np.full(2, -1)
            total = np.zeros((2, 3))
            u0, v0 = int(np.rint(quads[i, c, 0])), int(np.rint(quads[i, c, 1]))
            for v in range(max(0, v0 - radius[i]), min(h, v0 + radius[i] + 1)):
                for u in range(max(0, u0 - radius[i]), min(w, u0 + radius[i] + 1)):
                    # in the square and beyond it the template is centred on different colours: two peaks, the corner
                    # between them
                    kind = 0 if labels[v, u] == own[i] else 1
                    response = _matches(labels, own[i], u, v, legs, rings[i])
                    if response > best[kind]:
                        best[kind] = response
                        total[kind] = 0.0
                    if response == best[kind]:
                        total[kind, 0] += u
                        total[kind, 1] += v
                        total[kind, 2] += 1.0
            corners[i, c] = quads[i, c]
            score[i, c] = 0.0
            if best[0] >= 0 and best[1] >= 0:
                for axis in range(2):
                    corners[i, c, axis] = 0.5 * (total[0, axis] / total[0, 2] + total[1, axis] / total[1, 2])
                # four legs of that many pixels at each of the two peaks
                score[i, c] = (best[0] + best[1]) / (8.0 * rings[i])
