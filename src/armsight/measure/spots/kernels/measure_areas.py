"""Measures the bright areas: round lights at once, the others by a choice of models, crowded ones together."""

from __future__ import annotations

from math import pi, sqrt

import numpy as np

from armsight._numba import inner_kernel, kernel, lean_kernel
from armsight.measure.spots.kernels import columns as col
from armsight.measure.spots.kernels.area import (
    ACCEPTED,
    AS_CENTROID,
    AS_GAUSSIAN,
    FAILED,
    ONLY_ELLIPSE,
    ONLY_GAUSSIAN,
    SATURATED,
    UNRESOLVED,
    boxes_overlap,
    check_fit,
    fit_margin,
    hot_pixels,
    is_hot_near,
    mark_crowded,
    ring_prior,
    round_start,
    slope_prior,
)
from armsight.measure.spots.kernels.columns import Picture, copy_to
from armsight.measure.spots.kernels.gaussian_axes import PIXEL_VARIANCE
from armsight.measure.spots.kernels.leastsquares import MISFIT, add_light_to_patch, evaluate_patch
from armsight.measure.spots.kernels.model_selection import ANY, refit, select_model, write_spots
from armsight.measure.spots.kernels.patch import make_patch, new_patch, shape_of
from armsight.measure.spots.kernels.processed import add_background_variance, is_off_centroid, robust_covariance
from armsight.measure.spots.kernels.round_gaussian import (
    COV,
    DOF,
    FOURTH,
    RESULT,
    RSS,
    RUN,
    SIGNAL,
    SQUARE,
    A,
    B,
    Q,
    U,
    V,
    fit_round,
    new_work,
)

GAIN_DOUBT = 0.5
"""Standard deviations by which the estimated gain is lowered."""
PENDING = -1
"""Status of an area that the fit of a round light did not settle."""
CENTROID_PX = 0.1
CENTROID_SHARE = 0.02
"""Standard deviation of a blob's centroid per coordinate: a part of its own and a share of the radius."""
CENTROID_CHANGE = 1.2
"""The same where the background changes under the light, in radii for a change of its height over the radius."""
CENTROID_SHAPE = 0.5
"""The same for a shape that is no ellipse, in radii for the square root of its second moments over an ellipse's of
that area, squared, less one: a round lamp of any size at the edge of a round light moves the centroid by 0.4 to 0.5."""
CROWD_SWEEPS = 2
"""Times that crowded spots are refitted with their neighbours' light subtracted."""
ALONE = 2
"""CROWDED of an area that its neighbours' light does not reach: it is refitted once, to their pixels as well."""


@lean_kernel
def write_round(result, source, row):
    """Write the result of a round fit into a spot's row."""
    row[col.S_U] = result[U]
    row[col.S_V] = result[V]
    for k in range(6):
        row[col.S_CH + k] = result[COV + k]
    row[col.S_PEAK] = result[A]
    row[col.S_SIZE] = sqrt(max(result[Q] - PIXEL_VARIANCE, 0.01))
    row[col.S_MODEL] = AS_GAUSSIAN
    row[col.S_DOF] = result[DOF]
    row[col.S_RSS] = result[RSS]
    row[col.S_SIGNAL] = result[SIGNAL]
    row[col.S_FOURTH] = result[FOURTH]
    row[col.S_SQUARE] = result[SQUARE]
    row[col.S_B] = result[B]
    row[col.S_OF] = source
    row[col.S_FLOOR] = 0.0


@lean_kernel
def store_fit(result, p):
    """Write the result of a round fit into p as a joint model of one light."""
    p[0] = result[B]
    p[1] = 1.0 / result[Q]
    p[2] = result[U]
    p[3] = result[V]
    p[4] = result[A]


@lean_kernel
def background_of(comp, survey, w, h):
    """Return the background level beside a component: its ring's where it has one, else that of its tile."""
    # its own ring is nearer than what the survey sampled of the tile
    if comp[col.SLOPE] >= 0.0:
        return comp[col.BACKGROUND]
    i = int(comp[col.SUM_Y] / comp[col.WEIGHT]) * col.GRID // h
    j = int(comp[col.SUM_X] / comp[col.WEIGHT]) * col.GRID // w
    # an area lies above its background; below a threshold given by hand the survey's may be higher
    return min(survey[col.GRID + i, j], comp[col.LEVEL])


@kernel
def measure_areas(image, mask, options, comps, state, survey):
    """Measure the lights of all accepted areas; return the spots' columns and what was refused, as pack_results does.

    state: what becomes of each area is written into it.
    """
    picture = Picture(image, np.uint8(options[col.O_FLIP]), int(options[col.O_SATURATION]), mask)
    only = int(options[col.O_MODEL])
    n = comps.shape[0]
    fits = np.empty((n, col.FIT))
    rows = np.empty((n, col.MOST_LIGHTS, col.SPOT))
    hot = np.empty((2 * n, 2), np.int64)
    hot = hot[: hot_pixels(comps, state, hot)]
    mark_crowded(comps, state)
    if measure_round(picture, only, hot, comps, state, survey, fits, rows) > 0:
        measure_others(picture, only, hot, comps, state, survey, fits, rows)
    add_background_variance(picture, comps, state, survey, rows)
    return pack_results(options, comps, state, rows)


@inner_kernel
def measure_round(picture, only, hot, comps, state, survey, fits, rows):
    """Fit a round Gaussian to each accepted area that stands alone; return how many areas are left PENDING.

    Their SIZE is 5 where a round light was fitted, whose residuals hang together, and else 0.
    fits (n, FIT) takes the fits, rows (n, MOST_LIGHTS, SPOT) the measured lights, state what became of the area.
    """
    h, w = picture.grey.shape
    n = comps.shape[0]
    start = np.empty(5)
    prior = np.empty(4)
    result = np.empty(RESULT)
    work = new_work()
    noise = survey[2 * col.GRID, col.NOISE]
    pending = 0
    for i in range(n):
        if state[i, col.STATUS] != ACCEPTED:
            continue
        comp = comps[i]
        if comp[col.SLOPE] >= 0.0:
            ring_prior(comp[col.SLOPE], prior)
        else:
            slope_prior(
                survey,
                int(comp[col.SUM_Y] / comp[col.WEIGHT]),
                int(comp[col.SUM_X] / comp[col.WEIGHT]),
                w,
                h,
                noise,
                prior,
            )
        for k in range(4):
            fits[i, col.MOST_PARAMETERS + k] = prior[k]
        # lights before a room are all left to measure_others, whose covariance is of the residuals as they are
        # (processed)
        fine = False
        if state[i, col.CROWDED] == 0 and only != ONLY_ELLIPSE and comp[col.SLOPE] < 0.0:
            round_start(comp, background_of(comp, survey, w, h), picture.saturation, start)
            # mostly false, which spares looking for such pixels
            clipped = comp[col.CLIPPED] > 0.0 or picture.mask.size > 0 or is_hot_near(comp, hot)
            fine = fit_round(picture, hot, clipped, start, prior, work, result)
            if fine:
                store_fit(result, fits[i])
            if fine and (result[RUN] < MISFIT or only == ONLY_GAUSSIAN):
                write_round(result, i, rows[i, 0])
                state[i, col.SIZE] = 5
                state[i, col.KIND] = 0
                state[i, col.LIGHTS] = 1
                if check_fit(comp, rows[i], state[i, col.LIGHTS], comp[col.CLIPPED] > 0.0, noise) == ACCEPTED:
                    continue
                fine = False
        state[i, col.STATUS] = PENDING
        state[i, col.SIZE] = 5 if fine else 0
        pending += 1
    return pending


@inner_kernel
def measure_others(picture, only, hot, comps, state, survey, fits, rows):
    """Fit the areas left PENDING with the models that their shape suggests, and refine the crowded ones."""
    h, w = picture.grey.shape
    n = comps.shape[0]
    noise = survey[2 * col.GRID, col.NOISE]
    outline = np.empty(10)
    for i in range(n):
        if state[i, col.STATUS] != PENDING:
            continue
        comp = comps[i]
        patch = new_patch(comp, h, w)
        make_patch(picture, comps, state, i, hot, np.int64(0), patch)
        background = background_of(comp, survey, w, h)
        kind, size, rss, run = select_model(comp, background, patch, noise, only, state[i, col.SIZE] > 0, fits[i])
        state[i, col.KIND] = kind
        state[i, col.SIZE] = size
        # why it is refused if no model fits
        state[i, col.STATUS] = SATURATED if comp[col.CLIPPED] > 0.5 * comp[col.AREA] else FAILED
        if size > 0:
            there = evaluate_patch(kind, fits[i], size, patch)
            lights = write_spots(kind, size, fits[i], patch, there, rss, rows[i], i)
            state[i, col.LIGHTS] = lights
            if lights > 0:
                state[i, col.STATUS] = check_fit(comp, rows[i], lights, comp[col.CLIPPED] > 0.0, noise)
            # residuals still hang together: more lights than were told apart, and each centre is pulled by the rest
            if lights > 1 and run > 2.0 * MISFIT:
                state[i, col.STATUS] = UNRESOLVED
            single = state[i, col.STATUS] == ACCEPTED and lights == 1 and comp[col.SLOPE] >= 0.0
            if single and (
                is_off_centroid(comp, rows[i, 0])
                or not robust_covariance(kind, size, patch, there, comp, noise, rows[i, 0])
            ):
                state[i, col.STATUS] = FAILED
        if state[i, col.STATUS] != ACCEPTED and comp[col.SLOPE] >= 0.0:
            shape_of(patch, comp, comp[col.LEVEL], background, outline)
            write_centroid(comp, outline, rows[i, 0], i)
            state[i, col.SIZE] = 0
            state[i, col.LIGHTS] = 1
            state[i, col.STATUS] = ACCEPTED
    # as Gauss and Seidel: each with its neighbours' latest light taken off
    for _ in range(CROWD_SWEEPS):
        for i in range(n):
            if state[i, col.STATUS] == ACCEPTED and state[i, col.CROWDED] == 1 and state[i, col.SIZE] > 0:
                lit = refine(picture, comps, state, i, hot, noise, fits, rows)
                if lit < PIXEL_VARIANCE:  # whatever becomes of the neighbours: less than rounding a pixel makes of it
                    state[i, col.CROWDED] = ALONE


@lean_kernel
def write_centroid(comp, outline, row, source):
    """Write into a spot's row the centroid of a blob that no model fits: its pixels above half height, weighted.

    An ellipse has the least second moments of all shapes of its area: what is above them is of something beside it.
    """
    radius = sqrt(comp[col.AREA] / pi)
    for k in range(row.shape[0]):
        row[k] = 0.0
    row[col.S_U] = comp[col.SUM_X] / comp[col.WEIGHT]
    row[col.S_V] = comp[col.SUM_Y] / comp[col.WEIGHT]
    change = comp[col.SLOPE] / max(comp[col.PEAK] - comp[col.BACKGROUND], 1.0) * radius
    variance = (CENTROID_PX + CENTROID_SHARE * radius) ** 2 + (CENTROID_CHANGE * radius * change) ** 2
    # an ellipse's area is 4 pi sqrt(det) of its second moments: how much larger it is than the pixels', squared
    moments2 = 16.0 * pi * pi * (outline[5] * outline[7] - outline[6] ** 2) / max(outline[8], 1.0) ** 2
    variance += (CENTROID_SHAPE * radius) ** 2 * max(moments2 - 1.0, 0.0)
    row[col.S_CH] = variance
    row[col.S_CH + 2] = variance
    row[col.S_PEAK] = comp[col.PEAK] - comp[col.BACKGROUND]
    row[col.S_SIZE] = radius
    row[col.S_MODEL] = AS_CENTROID
    row[col.S_DOF] = 1.0
    row[col.S_RSS] = 1.0
    row[col.S_OF] = source


@inner_kernel
def refine(picture, comps, state, i, hot, noise, fits, rows):
    """Refit a crowded component with its neighbours' light subtracted, in place; return the squares of that light."""
    patch = new_patch(comps[i], picture.grey.shape[0], picture.grey.shape[1])
    make_patch(picture, comps, state, i, hot, np.int64(1), patch)
    lit = 0.0
    for j in range(comps.shape[0]):
        known = j != i and state[j, col.STATUS] == ACCEPTED and state[j, col.SIZE] > 0
        if known and boxes_overlap(comps[i], comps[j], fit_margin(comps[i]) + fit_margin(comps[j])):
            lit += add_light_to_patch(state[j, col.KIND], fits[j], state[j, col.SIZE], patch, -1.0)
    p = np.empty(col.FIT)
    copy_to(fits[i], p)
    kind = state[i, col.KIND]
    size = state[i, col.SIZE]
    rss, _ = refit(kind, size, patch, patch.use.size, p, np.empty(patch.use.shape), ANY)
    if rss < 0.0:
        return lit
    trial = np.empty((col.MOST_LIGHTS, col.SPOT))
    lights = write_spots(kind, size, p, patch, evaluate_patch(kind, p, size, patch), rss, trial, i)
    # else the fit that there is stays
    if (
        lights == state[i, col.LIGHTS]
        and check_fit(comps[i], trial, lights, comps[i, col.CLIPPED] > 0.0, noise) == ACCEPTED
    ):
        copy_to(p, fits[i])
        for k in range(lights):
            copy_to(trial[k], rows[i, k])
    return lit


@lean_kernel
def shot_gain(spots, n):
    """Return the gain (grey levels of variance per grey level of light) that the residuals of all spots prove.

    Regression of the squared residuals on the model, each spot with its own constant part; less GAIN_DOUBT standard
    deviations,
    because a gain that is only noise would widen every ellipse.
    """
    top = 0.0
    bottom = 0.0
    spread = 0.0
    for k in range(n):
        row = spots[k]
        dof = row[col.S_DOF]
        signal = row[col.S_SIGNAL]
        if row[col.S_SQUARE] <= 0.0 or dof < 1.0:
            continue
        # slope of r^2 over m about the means of both; r^2 of normal noise varies by 2 a^2
        square = row[col.S_SQUARE] - signal * signal / dof
        a = row[col.S_RSS] / dof
        top += row[col.S_FOURTH] - a * signal
        bottom += square
        spread += 2.0 * a * a * square
    if bottom <= 0.0:
        return 0.0
    return max((top - GAIN_DOUBT * sqrt(spread)) / bottom, 0.0)


@lean_kernel
def noise_of(row, g):
    """Return the constant part of a spot's noise variance, given the shot noise's gain g.

    Where the background lies within the noise of black, half of its pixels are clipped and tell too little; there the
    residuals are weighted with the light.
    """
    a = (row[col.S_RSS] - g * row[col.S_SIGNAL]) / max(row[col.S_DOF], 1.0)
    if row[col.S_SIGNAL] > 0.0 and row[col.S_SQUARE] > 0.0:
        # residuals squared, weighted by the light: what lies where nothing is clipped at black
        lit = row[col.S_FOURTH] / row[col.S_SIGNAL]
        if row[col.S_B] < 2.0 * sqrt(lit):
            a = max(a, lit - g * row[col.S_SQUARE] / row[col.S_SIGNAL])
    return max(a, PIXEL_VARIANCE)


@inner_kernel
def pack_results(options, comps, state, rows):
    """Return uv (n, 2), covariance (n, 2, 2) and looks (4, n) of the spots, and refused (m, 3).

    looks: peak, size, model and owner, that of a spot's area; refused: u, v and the number of the reason. Few arrays:
    handing one to Python takes as long as filling it.
    """
    spots = np.empty((comps.shape[0] * col.MOST_LIGHTS, col.SPOT))
    refused = np.empty((comps.shape[0], 3))
    n = np.int64(0)
    m = 0
    for i in range(comps.shape[0]):
        if state[i, col.STATUS] == ACCEPTED:
            for k in range(state[i, col.LIGHTS]):
                copy_to(rows[i, k], spots[n])
                n += 1
        elif state[i, col.OWNER] >= 0:
            refused[m, 0] = comps[i, col.SUM_X] / comps[i, col.WEIGHT]
            refused[m, 1] = comps[i, col.SUM_Y] / comps[i, col.WEIGHT]
            refused[m, 2] = state[i, col.STATUS]
            m += 1
    g = options[col.O_GAIN] if options[col.O_GAIN] >= 0.0 else shot_gain(spots, n)
    uv = np.empty((n, 2))
    covariance = np.empty((n, 2, 2))
    looks = np.empty((4, n))
    for k in range(n):
        row = spots[k]
        a = noise_of(row, g)
        uv[k, 0] = row[col.S_U]
        uv[k, 1] = row[col.S_V]
        covariance[k, 0, 0] = a * row[col.S_CH] + g * row[col.S_CG] + row[col.S_FLOOR]
        covariance[k, 0, 1] = a * row[col.S_CH + 1] + g * row[col.S_CG + 1]
        covariance[k, 1, 0] = covariance[k, 0, 1]
        covariance[k, 1, 1] = a * row[col.S_CH + 2] + g * row[col.S_CG + 2] + row[col.S_FLOOR]
        looks[0, k] = row[col.S_PEAK]
        looks[1, k] = row[col.S_SIZE]
        looks[2, k] = row[col.S_MODEL]
        looks[3, k] = state[int(row[col.S_OF]), col.OWNER]
    return uv, covariance, looks, refused[:m].copy()
