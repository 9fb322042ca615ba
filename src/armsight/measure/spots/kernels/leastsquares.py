"""One damped least-squares fit for all models of a light, and what the centre's covariance is made of.

That is the noise's constant and shot parts, and the background's slope.
"""

from __future__ import annotations

import numpy as np

from armsight._numba import inner_kernel, lean_kernel
from armsight.fitting.kernels import invert_spd, solve_damped
from armsight.measure.spots.kernels.area import add_prior, prior_square, prior_weight
from armsight.measure.spots.kernels.columns import copy_to
from armsight.measure.spots.kernels.light_models import (
    CLIPPED_PIXEL,
    ELLIPSE,
    JOINT,
    grid_of,
    is_feasible,
    light,
    slopes,
)
from armsight.measure.spots.kernels.pixel_sums import dot, gram, normal_equations, products, subtract_model, sums_of

STEPS = 40
CLOSE = 3e-3
"""Stop where a step lowers chi-square by less than this share of the noise variance."""
LEAST_LEFT = 0.9
"""Share of its height that a light may lose before its fit."""
LOOK = 4
"""Steps after which a fit is looked at anew: whether it can still fall as far as it has to."""


@inner_kernel
def unused(use):
    """Return the positions of the pixels of a patch (ny, nx) that are not used for what they are."""
    nx = use.shape[1]
    count = 0
    for j in range(use.shape[0]):
        for i in range(nx):
            count += use[j, i] != 1
    out = np.empty(count, np.int64)
    k = 0
    for j in range(use.shape[0]):
        for i in range(nx):
            if use[j, i] != 1:
                out[k] = j * nx + i
                k += 1
    return out


@inner_kernel
def patch_grid(patch):
    """Return the Grid of a Patch."""
    return grid_of(patch.box[0], patch.box[2], patch.values.shape[1], patch.values.shape[0])


@lean_kernel
def evaluate(kind, p, n, patch, special, grid, J, m, r):
    """Fill light m and residuals r of a patch (values less model); return the sum of their squares.

    Both are zero where use is 0, and where it is CLIPPED_PIXEL and the model is brighter than the value: the light is
    at least as bright there, and a model that is brighter costs nothing.
    """
    light(kind, p, n, grid, J, m)
    return compare(p[0], patch, special, m, r)


@lean_kernel
def compare(background, patch, special, m, r):
    """Fill residuals r of a patch and its light m, of which evaluate tells; return the sum of their squares."""
    subtract_model(patch.values.reshape(-1), background, m, r)
    marks = patch.use.reshape(-1)
    for k in special:
        if marks[k] == 0 or (marks[k] == CLIPPED_PIXEL and r[k] < 0.0):
            r[k] = 0.0
            m[k] = 0.0
    return dot(r, r)


@lean_kernel
def level(kind, p, patch, special, m, r):
    """Give p the background and height that fit best with all else as it is, m and r with them; return the squares.

    Both are linear: what a step of the fit would find, and overshoot for what is not.
    """
    marks = patch.use.reshape(-1)
    count = m.shape[0] - special.shape[0]
    for k in special:
        count += m[k] != 0.0 or r[k] != 0.0
        if marks[k] == CLIPPED_PIXEL and kind != JOINT:  # the rim alone does not tell how high a flat light is
            return dot(r, r)
    of_m, of_mm, of_r, of_rm = sums_of(m, r)
    det = count * of_mm - of_m * of_m
    more = (count * of_rm - of_m * of_r) / det if det > 0.0 else -1.0
    if more > -LEAST_LEFT:
        p[0] += (of_r - more * of_m) / count
        p[4 if kind == JOINT else 3] *= 1.0 + more
        for i in range(m.shape[0]):
            m[i] *= 1.0 + more
    return compare(p[0], patch, special, m, r)


@lean_kernel
def differentiate(kind, p, n, special, grid, J, m, r):
    """Fill derivatives J (n, pixels) of a patch that was evaluated last; zero where light and residual are."""
    slopes(kind, p, n, grid, J)
    for k in special:
        if m[k] == 0.0 and r[k] == 0.0:
            for a in range(n):
                J[a, k] = 0.0


@inner_kernel
def fit_model(kind, p, n, patch, count, residuals, most):
    """Fit p (n,) in place by Levenberg-Marquardt; return the sum of squares, or -1 where it does not converge.

    residuals (ny, nx): values less model, 0 where unused; filled where it converges. most: a sum that is of no use
    above it; the fit ends, as one that does not converge, where falling on as it does brings it no lower.
    """
    g = np.empty(n)
    step = np.empty(n)
    trial = np.empty(n)
    H = np.empty((n, n))
    start = np.empty(n)
    if not is_feasible(kind, p, n):
        return -1.0
    grid = patch_grid(patch)
    special = unused(patch.use)
    pixels = patch.values.size
    J = np.empty((n, pixels))
    m = np.empty(pixels)
    r = np.empty(pixels)
    best = residuals.reshape(-1)
    # the priors, which are about the start, add nothing to the squares there
    extra = 0.0
    rss = evaluate(kind, p, n, patch, special, grid, J, m, best)
    if kind == ELLIPSE or n == 5:  # of several lights, and of streaks, many starts end elsewhere
        rss = level(kind, p, patch, special, m, best)
    copy_to(p[:n], start)
    better, damping = True, 1e-3
    looked_at, steps = rss, 0
    for k in range(STEPS):
        if better:
            differentiate(kind, p, n, special, grid, J, m, best)
            normal_equations(J, best, n, H, g)
            add_prior(kind, p, start, n, H, g)
        if not solve_damped(H, g, damping, step):
            return -1.0
        for i in range(n):
            trial[i] = p[i] + step[i]
        # what is not feasible counts as worse
        new = rss + 1.0
        new_extra = 0.0
        if is_feasible(kind, trial, n):
            new_extra = prior_square(kind, trial, start, n)
            new = evaluate(kind, trial, n, patch, special, grid, J, m, r) + new_extra
        # written so that NaN is no improvement
        better = new <= rss
        if not better:
            damping *= 10.0
            if damping > 1e6:
                return -1.0
            continue
        gain = rss - new
        rss = new
        extra = new_extra
        copy_to(trial, p)
        copy_to(r, best)
        # the small gain of a damped step says nothing of the minimum
        if gain < CLOSE * rss / count and damping <= 1e-3:
            return rss - extra
        damping = max(0.1 * damping, 1e-9)
        steps += 1
        if steps % LOOK == 0:
            if rss - (looked_at - rss) * (STEPS - 1 - k) / LOOK > most:
                return -1.0
            looked_at = rss
    return rss - extra if kind == ELLIPSE else -1.0  # its centre is settled long before what clipping hides


@inner_kernel
def evaluate_patch(kind, p, n, patch):
    """Return a model at a patch: its Grid, J (n, pixels), light m, residuals (ny, nx), special pixels (see evaluate),
    and H (n, n) with the priors."""
    grid, special, pixels = patch_grid(patch), unused(patch.use), patch.values.size
    J, m, residuals, H = np.empty((n, pixels)), np.empty(pixels), np.empty(patch.values.shape), np.empty((n, n))
    r = residuals.reshape(-1)
    evaluate(kind, p, n, patch, special, grid, J, m, r)
    differentiate(kind, p, n, special, grid, J, m, r)
    gram(J, n, H)
    for i in range(n):
        H[i, i] += prior_weight(kind, i, p[4] if kind == JOINT else p[3])
    return grid, J, m, residuals, special, H


@lean_kernel
def weighted_information(there, n, u, v, G, tilt, out3):
    """Fill G (n, n) = sum of m J'J, and out3 = sums of m, r^2 m, m^2, of what evaluate_patch returned.

    tilt (n + 3, 2): see leastsquares.uncertainty, about (u, v).
    """
    grid, J, m, residuals, _, _ = there
    work = grid.work[0]
    for a in range(n):
        products(J[a], m, work)
        for b in range(a + 1):
            G[a, b] = dot(work, J[b])
            G[b, a] = G[a, b]
    r = residuals.reshape(-1)
    products(r, r, work)
    out3[0] = dot(J[0], m)
    out3[1] = dot(work, m)
    out3[2] = dot(m, m)
    # J[0], by the background, is 1 in pixels that count and 0 in others
    dx = grid.work[1]
    dy = grid.work[2]
    for i in range(m.shape[0]):
        dx[i] = (grid.x[i] - u) * J[0, i]
        dy[i] = (grid.y[i] - v) * J[0, i]
    for a in range(n):
        tilt[a, 0] = dot(J[a], dx)
        tilt[a, 1] = dot(J[a], dy)
    tilt[n, 0] = dot(dx, dx)
    tilt[n, 1] = dot(dx, dy)
    tilt[n + 1, 0] = 0.0
    tilt[n + 1, 1] = dot(dy, dy)
    tilt[n + 2, 0] = dot(r, dx)
    tilt[n + 2, 1] = dot(r, dy)


@inner_kernel
def add_light_to_patch(kind, p, n, patch, sign):
    """Add sign times the model's light to the patch's values; return the sum of its squares."""
    m = np.empty(patch.values.size)
    light(kind, p, n, patch_grid(patch), np.empty((n, patch.values.size)), m)
    flat = patch.values.reshape(-1)
    for i in range(flat.size):
        flat[i] += sign * m[i]
    return dot(m, m)


MISFIT = 4.0
"""Neighbouring residuals correlated by more than this many standard deviations say that the model is wrong."""
MOST_CORRELATED = 0.9
LEVERAGE = 1.3
"""What a round fit takes of the sum of m^2, over what it takes of the sum of m; 1.295-1.30 for sigma 1.5-4 px."""


@lean_kernel
def variance_inflation(run, products, squares):
    """Return the factor of the covariance for residuals that hang together: wrong model, or noise that is not white.

    For residuals whose neighbours correlate by rho along both axes, as of first order, the information of a smooth
    light falls by (1 - rho) / (1 + rho) along each. products: sum of r times its left and upper neighbour.
    """
    if run < MISFIT or squares <= 0.0:
        return 1.0
    rho = min(0.5 * products / squares, MOST_CORRELATED)
    return ((1.0 + rho) / (1.0 - rho)) ** 2


@lean_kernel
def remaining_square(square, signal, left):
    """Return the sum of m^2 less the fit's take, from that of the sum of m (signal, of which `left` is left)."""
    return square * max(1.0 - LEVERAGE * (1.0 - left / signal), 0.1) if signal > 0.0 else 0.0


@inner_kernel
def uncertainty(H, G, tilt, prior, noise, signal, out):
    """Write C_H, C_G into out (6,), correct the centre for the background's slope; return signal less the fit's take.

    With noise variance a + g m at a pixel of model height m, the covariance of the centre is a C_H + g C_G (C_G =
    H^-1 G H^-1), and the residuals' expectation is (1 - leverage) (a + g m). The background's slope (per px along x
    and y) is one linear step of a fit with prior (4,): mean x, y, standard deviation x, y. tilt (n + 3, 2): the sums of
    J dx, J dy (n rows), of (dx, dy)'(dx, dy) (2 rows) and of r dx, r dy. The centre's shift goes to out[6:8].
    NaN where H cannot be inverted.
    """
    n = H.shape[0]
    C = np.empty((n, n))
    if not invert_spd(H, C):
        return np.nan
    # trace of H^-1 G, the light of each pixel times its leverage: what the fit takes of the signal
    trace = 0.0
    for i in range(n):
        for j in range(n):
            trace += C[i, j] * G[i, j]
    CG = np.zeros((2, n))
    CB = np.zeros((n, 2))
    for j in range(n):
        for i in range(n):
            CG[0, j] += C[0, i] * G[i, j]
            CG[1, j] += C[1, i] * G[i, j]
            CB[j, 0] += C[j, i] * tilt[i, 0]
            CB[j, 1] += C[j, i] * tilt[i, 1]
    # the slope's two parameters beside the others: the Schur complement of H in the larger matrix, and their prior
    kx = noise / (prior[2] * prior[2])
    ky = noise / (prior[3] * prior[3])
    xx = tilt[n, 0] + kx
    xy = tilt[n, 1]
    yy = tilt[n + 1, 1] + ky
    for i in range(n):
        xx -= tilt[i, 0] * CB[i, 0]
        xy -= tilt[i, 0] * CB[i, 1]
        yy -= tilt[i, 1] * CB[i, 1]
    det = xx * yy - xy * xy
    if not det > 0.0:
        return np.nan
    hx = tilt[n + 2, 0] + kx * prior[0]
    hy = tilt[n + 2, 1] + ky * prior[1]
    slope_x = (yy * hx - xy * hy) / det
    slope_y = (xx * hy - xy * hx) / det
    k = 0
    for a in range(2):
        out[6 + a] = -(CB[a, 0] * slope_x + CB[a, 1] * slope_y)
        for b in range(a, 2):
            # the centre with the slope unknown: C + CB S^-1 CB', S the complement (xx, xy, yy)
            out[k] = C[a, b]
            out[k] += (CB[a, 0] * CB[b, 0] * yy - (CB[a, 0] * CB[b, 1] + CB[a, 1] * CB[b, 0]) * xy) / det
            out[k] += CB[a, 1] * CB[b, 1] * xx / det
            t = 0.0
            for j in range(n):
                t += CG[a, j] * C[j, b]
            out[k + 3] = t
            k += 1
    return signal - trace
