"""Which light is it? Fits the models that its shape suggests and lets the data choose (Bayesian information
criterion)."""

from __future__ import annotations

from math import erf, exp, log, sqrt

import numpy as np

from armsight._numba import inner_kernel, lean_kernel
from armsight.measure.spots.kernels import columns as col
from armsight.measure.spots.kernels.area import (
    AS_ELLIPSE,
    AS_GAUSSIAN,
    AS_JOINT,
    AS_STREAK,
    ONLY_ELLIPSE,
    ONLY_GAUSSIAN,
)
from armsight.measure.spots.kernels.columns import copy_to
from armsight.measure.spots.kernels.gaussian_axes import PIXEL_VARIANCE
from armsight.measure.spots.kernels.leastsquares import (
    MISFIT,
    evaluate,
    fit_model,
    patch_grid,
    remaining_square,
    uncertainty,
    unused,
    variance_inflation,
    weighted_information,
)
from armsight.measure.spots.kernels.light_models import ELLIPSE, JOINT, ROOT_2, ROOT_2PI, STREAK
from armsight.measure.spots.kernels.patch import (
    antisymmetric_part,
    find_peaks,
    principal,
    residual_autocorrelation,
    shape_of,
    start_model,
    used,
)

FLAT = 0.58
"""Mean over peak above the threshold: a Gaussian has 0.3-0.5, a streak up to 0.55, a disc wider than its blur more."""
ELONGATED = 1.12
"""Ratio of second moments from which a streak or two lights are tried at once."""
LONG = 3.5
"""Length in blurs from which two lights of one width cannot pass for a streak."""
SURE = 10.0
"""Fall of the Bayesian information criterion that a further light must bring: odds of 150 to 1."""
PLAIN = 0.035
"""Residual as a share of the height up to which one ellipse of one peak is believed without other models being tried:
what a camera's processing leaves of a flat light (transfer curve, sharpening, compression) is below it."""
WIDE_PATCH = 3000
"""Pixels of a patch before a room beyond which one flat light is tried and no crowd: it would take tens of ms, and what
is that large and no disc is a lamp."""
FLAT_CLIPPED = 3.0
"""Clipped pixels of a light before a room from which a flat one is tried even where a round one fits."""
LEAST_DISC = 40.0
"""Pixels above the threshold from which a light may be told for a disc by a round fit's residuals: of fewer, a single
one may hold DOMINANT of what a round light leaves."""
PLAINLY = 2.0
"""By how much the limits must be exceeded for that: in run, share of one pixel, squares."""
ANY, LARGEST_LOG = np.inf, 700.0
"""A fit of use whatever it leaves; and the largest number whose exponential is one."""
DOMINANT = 0.2
"""Share of all squares in one pixel that marks it as hot; no wrong model puts so much into a single one."""


@lean_kernel
def drop_worst(residuals, use, rss, noise):
    """Set use to 0 at the pixel that holds a dominant share of all squares; tell whether there was one."""
    worst = 0.0
    a = 0
    b = 0
    for j in range(residuals.shape[0]):
        for i in range(residuals.shape[1]):
            if residuals[j, i] ** 2 > worst:
                worst = residuals[j, i] ** 2
                a = j
                b = i
    # or less than six standard deviations: noise has a largest pixel, too
    if worst < DOMINANT * rss or worst < 36.0 * max(noise, PIXEL_VARIANCE):
        return False
    use[a, b] = 0
    return True


@lean_kernel
def dominated(r, most):
    """Tell whether a residual's square is more than most: a hot pixel may be what is wrong."""
    over = 0
    for i in range(r.shape[0]):
        over += r[i] * r[i] > most
    return over > 0


@lean_kernel
def add_light(residuals, x0, y0, p, n):
    """Extend a joint model by a light where the residuals, summed over 3 x 3 pixels, are largest; return the new n."""
    best = -1.0
    for j in range(1, residuals.shape[0] - 1):
        for i in range(1, residuals.shape[1] - 1):
            t = 0.0
            for a in range(-1, 2):
                for b in range(-1, 2):
                    t += residuals[j + a, i + b]
            if t > best:
                best = t
                p[n] = x0 + i
                p[n + 1] = y0 + j
                p[n + 2] = max(t / 9.0, 1.0)
    return n + 3


@lean_kernel
def bic(rss, count, n):
    """Return the Bayesian information criterion (Schwarz 1978) for n parameters."""
    return count * log(max(rss / count, PIXEL_VARIANCE)) + n * log(float(count))


@lean_kernel
def useful(score, count, n):
    """Return the sum of squares above which the bic of n parameters is above a score."""
    return count * exp(min((score - n * log(float(count))) / count, LARGEST_LOG))


@lean_kernel
def order_of_trial(comp, shape, n_peaks, only, order):
    """Fill order with the kinds to try after the round Gaussian, likeliest first; return how many."""
    if only == ONLY_GAUSSIAN:
        return 0
    if only == ONLY_ELLIPSE:
        order[0] = ELLIPSE
        return 1
    large, small, _ = principal(shape[2], shape[3], shape[4])
    height = max(comp[col.PEAK] - comp[col.LEVEL], 1.0)
    flat = comp[col.WEIGHT] / (comp[col.AREA] * height) > FLAT
    elongated = large > ELONGATED * small
    if flat or not elongated:
        order[0] = ELLIPSE
        order[1] = STREAK
        order[2] = JOINT
        return 3 if elongated or n_peaks > 1 else 1
    order[0] = STREAK if n_peaks < 3 else JOINT
    order[1] = JOINT if n_peaks < 3 else STREAK
    order[2] = ELLIPSE
    return 3


@lean_kernel
def refit(kind, n, patch, count, p, residuals, most):
    """Fit one model from p in place; return sum of squares (-1: failed, see fit_model) and run of the residuals."""
    rss = fit_model(kind, p, n, patch, count, residuals, most)
    if rss < 0.0:
        return rss, 0.0
    return rss, residual_autocorrelation(residuals)[1]


@inner_kernel
def fit_disc(comp, background, shape, patch, count, only, best):
    """Fit an ellipse to what a round light, in best, plainly is not; fill best; return squares (-1: not sure) and run.

    The round light was fitted to a window of its own. Fitted to this patch it would leave hardly less than it does
    there: where that is beyond all limits by far, and the ellipse fits, no other model is tried.
    """
    order = np.empty(3, np.int64)
    first = order_of_trial(comp, shape, np.int64(1), only, order) > 0 and order[0] == ELLIPSE
    if comp[col.AREA] < LEAST_DISC or comp[col.CLIPPED] > 0.0 or not first:
        return -1.0, 0.0
    p = np.zeros(col.MOST_PARAMETERS)
    peaks = np.empty((col.MOST_LIGHTS, 3))
    residuals = np.empty(patch.values.shape)
    J = np.empty((5, patch.values.size))
    m = np.empty(patch.values.size)
    r = residuals.reshape(-1)
    rss_round = evaluate(np.int64(JOINT), best, np.int64(5), patch, unused(patch.use), patch_grid(patch), J, m, r)
    if not residual_autocorrelation(residuals)[1] > PLAINLY * MISFIT or dominated(r, DOMINANT / PLAINLY * rss_round):
        return -1.0, 0.0
    n = start_model(np.int64(ELLIPSE), np.int64(1), comp, shape, background, peaks, p)
    rss, run = refit(np.int64(ELLIPSE), n, patch, count, p, residuals, ANY)
    likelier = rss >= 0.0 and bic(rss, count, n) < bic(rss_round / PLAINLY, count, 5)
    if not (likelier and run < MISFIT) or dominated(r, DOMINANT * rss):
        return -1.0, 0.0
    copy_to(p, best)
    return rss, run


@inner_kernel
def select_model(comp, background, patch, noise, only, refused, best):
    """Fit the models that the shape suggests; fill best; return kind, n (0: none), squares, run.

    refused: a round light is in best whose residuals hang together.
    """
    count = used(patch.use)
    shape = np.empty(10)
    shape_of(patch, comp, comp[col.LEVEL], background, shape)
    if refused:
        rss, run = fit_disc(comp, background, shape, patch, count, only, best)
        if rss >= 0.0:
            return ELLIPSE, 8, rss, run
    p = np.zeros(col.MOST_PARAMETERS)
    more = np.zeros(col.MOST_PARAMETERS)
    residuals = np.zeros(patch.values.shape)
    kind, n_best, rss_best, score, run_best = JOINT, 0, -1.0, 1e300, 0.0
    peaks, n_peaks = np.empty((col.MOST_LIGHTS, 3)), np.int64(0)
    if only != ONLY_ELLIPSE:
        n = start_model(np.int64(JOINT), np.int64(1), comp, shape, background, peaks, p)
        rss, run = refit(np.int64(JOINT), n, patch, count, p, residuals, ANY)
        # hot pixels within the light, one after the other: every model would follow them
        for _ in range(3):
            if rss > 0.0 and drop_worst(residuals, patch.use, rss, noise):
                count -= 1
                rss, run = refit(np.int64(JOINT), n, patch, count, p, residuals, ANY)
        if rss >= 0.0:
            n_best, rss_best, score, run_best = n, rss, bic(rss, count, n), run
            copy_to(p, best)
            if run < MISFIT and not (comp[col.SLOPE] >= 0.0 and comp[col.CLIPPED] > FLAT_CLIPPED):
                return kind, n_best, rss_best, run_best
    n_peaks = find_peaks(patch, comp[col.LEVEL], noise, peaks)
    order = np.empty(3, np.int64)
    trials = order_of_trial(comp, shape, n_peaks, only, order)
    room = comp[col.SLOPE] >= 0.0
    crowd = not (room and count > WIDE_PATCH)
    for k in range(trials):
        trial = order[k]
        if trial != ELLIPSE and not crowd:
            continue
        lights = max(n_peaks, 2) if trial == JOINT else 1
        # the last one is of use only where it is the likeliest
        most = useful(score, count, 8) if trial == ELLIPSE and k == trials - 1 else ANY
        n = start_model(trial, lights, comp, shape, background, peaks, p)
        rss, run = refit(trial, n, patch, count, p, residuals, most)
        if rss < 0.0:
            continue
        new = bic(rss, count, n)
        while trial == JOINT and run > MISFIT and n + 3 <= 2 + 3 * col.MOST_LIGHTS:
            copy_to(p, more)
            n_more = add_light(residuals, patch.box[0], patch.box[2], more, n)
            most = useful(new - SURE, count, n_more)
            rss_more, run_more = refit(np.int64(JOINT), n_more, patch, count, more, residuals, most)
            if rss_more < 0.0 or bic(rss_more, count, n_more) > new - SURE:
                break
            copy_to(more, p)
            n, rss, run = n_more, rss_more, run_more
            new = bic(rss, count, n)
        if new < score:
            kind, n_best, rss_best, score, run_best = trial, n, rss, new, run
            copy_to(p, best)
        settled = trial == ELLIPSE or (trial == STREAK and 2.0 * p[6] > LONG * p[4])
        if settled and (run < MISFIT or (room and n_peaks < 2 and rss < count * (PLAIN * p[3]) ** 2)):
            break
    return kind, n_best, rss_best, run_best


@inner_kernel
def write_spots(kind, n, p, patch, there, rss, rows, source):
    """Write the lights of a fitted model into rows (.., SPOT); return how many (0: no covariance).

    there: as evaluate_patch returns it.
    """
    _, _, _, residuals, _, H = there
    G = np.empty((n, n))
    sums = np.empty(3)
    tilt = np.empty((n + 3, 2))
    count = used(patch.use)
    lights = (n - 2) // 3 if kind == JOINT else 1
    first = 2 if kind == JOINT else 1
    weighted_information(there, n, p[first], p[first + 1], G, tilt, sums)
    wider, rss, noise = residual_noise(residuals, patch, p[first], p[first + 1], n, count, rss, lights)
    order = np.empty(n, np.int64)
    H2 = np.empty((n, n))
    G2 = np.empty((n, n))
    tilt2 = np.empty((n + 3, 2))
    for i in range(n, n + 3):
        copy_to(tilt[i], tilt2[i])
    for k in range(lights):
        first = 2 + 3 * k if kind == JOINT else 1
        centre_first(first, n, order)
        for i in range(n):
            for j in range(n):
                H2[i, j] = H[order[i], order[j]]
                G2[i, j] = G[order[i], order[j]]
            copy_to(tilt[order[i]], tilt2[i])
        row = rows[k]
        work = np.zeros(8)
        left = uncertainty(H2, G2, tilt2, p[col.MOST_PARAMETERS :], noise, sums[0], work)
        if left != left:
            return 0
        row[col.S_U] = p[first] + work[6]
        row[col.S_V] = p[first + 1] + work[7]
        for i in range(6):
            row[col.S_CH + i] = wider * work[i]
        row[col.S_DOF] = count - n
        row[col.S_RSS] = rss
        row[col.S_SIGNAL] = left
        row[col.S_FOURTH] = sums[1]
        # the lights of one patch share its pixels: one of them is enough to tell the gain (measure_areas.shot_gain)
        row[col.S_SQUARE] = remaining_square(sums[2], sums[0], left) if k == 0 else 0.0
        row[col.S_B] = p[0]
        row[col.S_OF] = source
        row[col.S_FLOOR] = 0.0
        write_look(kind, p, first, lights, row)
    return lights


@inner_kernel
def residual_noise(residuals, patch, u, v, n, count, rss, lights):
    """Return the covariance's factor for residuals that hang together, and the sum of squares and noise to go by.

    u, v: centre of the first light; n: parameters; count: pixels used.
    """
    noise = max(rss / max(count - n, 1), PIXEL_VARIANCE)
    products, run = residual_autocorrelation(residuals)
    wider = variance_inflation(run, products, rss)
    if wider > 1.0 and lights == 1:
        antisymmetric = np.empty(residuals.shape)
        squares, pixels = antisymmetric_part(residuals, patch.use, u - patch.box[0], v - patch.box[2], antisymmetric)
        if pixels > n:
            products, run = residual_autocorrelation(antisymmetric)
            # each product stands in the sum twice, once mirrored: the run is root 2 times what it is worth
            wider = variance_inflation(run / ROOT_2, products, squares)
            rss = squares / pixels * (count - n)
            noise = max(squares / pixels, PIXEL_VARIANCE)
    return wider, rss, noise


@lean_kernel
def centre_first(first, n, order):
    """Fill order (n,) with the parameters' numbers, those of a light's centre first, as uncertainty wants them."""
    at = 2
    order[0] = first
    order[1] = first + 1
    for i in range(n):
        if i != first and i != first + 1:
            order[at] = i
            at += 1


@lean_kernel
def write_look(kind, p, first, lights, row):
    """Write height, size and model of a light, whose centre is p[first:], into its row."""
    if kind == JOINT:
        row[col.S_PEAK] = p[first + 2]
        row[col.S_SIZE] = sqrt(max(1.0 / p[1] - PIXEL_VARIANCE, 0.01))
        row[col.S_MODEL] = AS_GAUSSIAN if lights == 1 else AS_JOINT
    elif kind == STREAK:
        # the light in its middle, half a length from both ends: Phi(h / s) - Phi(-h / s) = erf(h / (s sqrt 2))
        row[col.S_PEAK] = p[3] * erf(p[6] / (ROOT_2 * p[4])) * ROOT_2PI * p[4] / (2.0 * p[6])
        row[col.S_SIZE] = sqrt(max(p[4] * p[4] - PIXEL_VARIANCE, 0.01))
        row[col.S_MODEL] = AS_STREAK
    else:
        row[col.S_PEAK] = p[3]
        row[col.S_SIZE] = (p[5] * p[7] - p[6] * p[6]) ** -0.25  # root of the axes' product: det M = 1 / (a b)^2
        row[col.S_MODEL] = AS_ELLIPSE
