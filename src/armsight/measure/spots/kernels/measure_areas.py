"""Measures the bright areas: round lights at once, the others by a choice of models, crowded ones together."""

from __future__ import annotations

from math import pi, sqrt

import numpy as np

from armsight._numba import inner_kernel, kernel
from armsight.measure.spots.kernels.area import (
    ACCEPTED,
    AS_CENTROID,
    AS_GAUSSIAN,
    CROWDED,
    FAILED,
    FIT,
    HOT,
    KIND,
    LIGHTS,
    MOST_LIGHTS,
    MOST_PARAMETERS,
    O_FLIP,
    O_GAIN,
    O_MODEL,
    O_SATURATION,
    ONLY_ELLIPSE,
    ONLY_GAUSSIAN,
    OWNER,
    S_B,
    S_CG,
    S_CH,
    S_DOF,
    S_FLOOR,
    S_FOURTH,
    S_MODEL,
    S_OF,
    S_PEAK,
    S_RSS,
    S_SIGNAL,
    S_SIZE,
    S_SQUARE,
    S_U,
    S_V,
    SATURATED,
    SIZE,
    SMALL,
    SPOT,
    STATUS,
    UNRESOLVED,
    boxes_overlap,
    check_fit,
    fit_margin,
    hot_pixels,
    round_start,
)
from armsight.measure.spots.kernels.gaussian_axes import PIXEL_VARIANCE
from armsight.measure.spots.kernels.leastsquares import MISFIT, add_light_to_patch, ring_prior, slope_prior
from armsight.measure.spots.kernels.locate import NOISE
from armsight.measure.spots.kernels.model_selection import refit, select_model, write_spots
from armsight.measure.spots.kernels.patch import make_patch, new_patch, shape_of
from armsight.measure.spots.kernels.picture import Picture, copy_to
from armsight.measure.spots.kernels.processed import is_off_centroid, robust_covariance
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
from armsight.measure.spots.kernels.scan import (
    AREA,
    BACKGROUND,
    CLIPPED,
    GRID,
    LEVEL,
    PEAK,
    SLOPE,
    SUM_X,
    SUM_Y,
    WEIGHT,
    X_MAX,
    X_MIN,
    Y_MAX,
    Y_MIN,
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


@inner_kernel
def write_round(result, source, row):
    """Write the result of a round fit into a spot's row."""
    row[S_U] = result[U]
    row[S_V] = result[V]
    for k in range(6):
        row[S_CH + k] = result[COV + k]
    row[S_PEAK] = result[A]
    row[S_SIZE] = sqrt(max(result[Q] - PIXEL_VARIANCE, 0.01))
    row[S_MODEL] = AS_GAUSSIAN
    row[S_DOF] = result[DOF]
    row[S_RSS] = result[RSS]
    row[S_SIGNAL] = result[SIGNAL]
    row[S_FOURTH] = result[FOURTH]
    row[S_SQUARE] = result[SQUARE]
    row[S_B] = result[B]
    row[S_OF] = source
    row[S_FLOOR] = 0.0


@inner_kernel
def store_fit(result, p):
    """Write the result of a round fit into p as a joint model of one light."""
    p[0] = result[B]
    p[1] = 1.0 / result[Q]
    p[2] = result[U]
    p[3] = result[V]
    p[4] = result[A]


@inner_kernel
def background_of(comp, survey, w, h):
    """Return the background level beside a component: its ring's where it has one, else that of its tile."""
    # its own ring is nearer than what the survey sampled of the tile
    if comp[SLOPE] >= 0.0:
        return comp[BACKGROUND]
    i = int(comp[SUM_Y] / comp[WEIGHT]) * GRID // h
    j = int(comp[SUM_X] / comp[WEIGHT]) * GRID // w
    # an area lies above its background; below a threshold given by hand the survey's may be higher
    return min(survey[GRID + i, j], comp[LEVEL])


@inner_kernel
def is_hot_near(comp, hot):
    """Tell whether a hot pixel may lie in the component's window."""
    # the fit moves and widens its window while it runs
    reach = 1.5 * fit_margin(comp)
    for k in range(hot.shape[0]):
        x = hot[k, 0]
        y = hot[k, 1]
        if comp[X_MIN] - reach < x < comp[X_MAX] + reach and comp[Y_MIN] - reach < y < comp[Y_MAX] + reach:
            return True
    return False


@inner_kernel
def mark_crowded(comps, state):
    """Set CROWDED where another area's bounds meet the window of a component's fit."""
    n = comps.shape[0]
    relevant = np.empty(n, np.int64)
    count = 0
    for i in range(n):
        state[i, CROWDED] = 0
        if state[i, STATUS] != HOT and state[i, STATUS] != SMALL:
            relevant[count] = i
            count += 1
    for a in range(count):
        i = relevant[a]
        if state[i, STATUS] != ACCEPTED:
            continue
        reach = fit_margin(comps[i])
        for b in range(count):
            if b != a and boxes_overlap(comps[i], comps[relevant[b]], reach):
                state[i, CROWDED] = 1
                break


@kernel
def measure_round(image, mask, options, comps, state, survey, fits, rows):
    """Fit a round Gaussian to each accepted area that stands alone; return how many areas are left PENDING.

    fits (n, FIT) takes the fits, rows (n, MOST_LIGHTS, SPOT) the measured lights, state what became of the area.
    """
    h, w = image.shape
    picture = Picture(image, np.uint8(options[O_FLIP]), int(options[O_SATURATION]), mask)
    only = int(options[O_MODEL])
    n = comps.shape[0]
    hot = np.empty((2 * n, 2), np.int64)
    hot = hot[: hot_pixels(comps, state, hot)]
    mark_crowded(comps, state)
    start = np.empty(5)
    prior = np.empty(4)
    result = np.empty(RESULT)
    work = new_work()
    noise = survey[2 * GRID, NOISE]
    pending = 0
    for i in range(n):
        if state[i, STATUS] != ACCEPTED:
            continue
        comp = comps[i]
        if comp[SLOPE] >= 0.0:
            ring_prior(comp[SLOPE], prior)
        else:
            slope_prior(survey, int(comp[SUM_Y] / comp[WEIGHT]), int(comp[SUM_X] / comp[WEIGHT]), w, h, noise, prior)
        for k in range(4):
            fits[i, MOST_PARAMETERS + k] = prior[k]
        # lights before a room are all left to measure_others, whose covariance is of the residuals as they are
        # (processed)
        if state[i, CROWDED] == 0 and only != ONLY_ELLIPSE and comp[SLOPE] < 0.0:
            round_start(comp, background_of(comp, survey, w, h), picture.saturation, start)
            # mostly false, which spares looking for such pixels
            clipped = comp[CLIPPED] > 0.0 or mask.size > 0 or is_hot_near(comp, hot)
            fine = fit_round(picture, hot, clipped, start, prior, work, result)
            if fine and (result[RUN] < MISFIT or only == ONLY_GAUSSIAN):
                write_round(result, i, rows[i, 0])
                store_fit(result, fits[i])
                state[i, SIZE] = 5
                state[i, KIND] = 0
                state[i, LIGHTS] = 1
                if check_fit(comp, rows[i], state[i, LIGHTS], comp[CLIPPED] > 0.0, noise) == ACCEPTED:
                    continue
        state[i, STATUS] = PENDING
        state[i, SIZE] = 0
        pending += 1
    return pending


@kernel
def measure_others(image, mask, options, comps, state, survey, fits, rows):
    """Fit the areas left PENDING with the models that their shape suggests, and refine the crowded ones."""
    h, w = image.shape
    picture = Picture(image, np.uint8(options[O_FLIP]), int(options[O_SATURATION]), mask)
    only = int(options[O_MODEL])
    n = comps.shape[0]
    hot = np.empty((2 * n, 2), np.int64)
    hot = hot[: hot_pixels(comps, state, hot)]
    noise = survey[2 * GRID, NOISE]
    outline = np.empty(9)
    for i in range(n):
        if state[i, STATUS] != PENDING:
            continue
        comp = comps[i]
        patch = new_patch(comp, h, w)
        make_patch(picture, comps, state, i, hot, np.int64(0), patch)
        background = background_of(comp, survey, w, h)
        kind, size, rss, run = select_model(comp, background, patch, noise, only, fits[i])
        state[i, KIND] = kind
        state[i, SIZE] = size
        # why it is refused if no model fits
        state[i, STATUS] = SATURATED if comp[CLIPPED] > 0.5 * comp[AREA] else FAILED
        if size > 0:
            lights = write_spots(kind, size, fits[i], patch, rss, rows[i], i)
            state[i, LIGHTS] = lights
            if lights > 0:
                state[i, STATUS] = check_fit(comp, rows[i], lights, comp[CLIPPED] > 0.0, noise)
            # residuals still hang together: more lights than were told apart, and each centre is pulled by the rest
            if lights > 1 and run > 2.0 * MISFIT:
                state[i, STATUS] = UNRESOLVED
        single = state[i, STATUS] == ACCEPTED and state[i, LIGHTS] == 1 and comp[SLOPE] >= 0.0
        if single and (
            is_off_centroid(comp, rows[i, 0])
            or not robust_covariance(kind, size, fits[i], patch, comp, noise, rows[i, 0])
        ):
            state[i, STATUS] = FAILED
        if state[i, STATUS] != ACCEPTED and comp[SLOPE] >= 0.0:
            shape_of(patch, comp, comp[LEVEL], background, outline)
            write_centroid(comp, outline, rows[i, 0], i)
            state[i, SIZE] = 0
            state[i, LIGHTS] = 1
            state[i, STATUS] = ACCEPTED
    # as Gauss and Seidel: each with its neighbours' latest light taken off
    for _ in range(CROWD_SWEEPS):
        for i in range(n):
            if state[i, STATUS] == ACCEPTED and state[i, CROWDED] == 1 and state[i, SIZE] > 0:
                refine(picture, comps, state, i, hot, noise, fits, rows)


@inner_kernel
def write_centroid(comp, outline, row, source):
    """Write into a spot's row the centroid of a blob that no model fits: its pixels above half height, weighted.

    An ellipse has the least second moments of all shapes of its area: what is above them is of something beside it.
    """
    radius = sqrt(comp[AREA] / pi)
    for k in range(row.shape[0]):
        row[k] = 0.0
    row[S_U] = comp[SUM_X] / comp[WEIGHT]
    row[S_V] = comp[SUM_Y] / comp[WEIGHT]
    change = comp[SLOPE] / max(comp[PEAK] - comp[BACKGROUND], 1.0) * radius
    variance = (CENTROID_PX + CENTROID_SHARE * radius) ** 2 + (CENTROID_CHANGE * radius * change) ** 2
    # an ellipse's area is 4 pi sqrt(det) of its second moments: how much larger it is than the pixels', squared
    moments2 = 16.0 * pi * pi * (outline[5] * outline[7] - outline[6] ** 2) / max(outline[8], 1.0) ** 2
    variance += (CENTROID_SHAPE * radius) ** 2 * max(moments2 - 1.0, 0.0)
    row[S_CH] = variance
    row[S_CH + 2] = variance
    row[S_PEAK] = comp[PEAK] - comp[BACKGROUND]
    row[S_SIZE] = radius
    row[S_MODEL] = AS_CENTROID
    row[S_DOF] = 1.0
    row[S_RSS] = 1.0
    row[S_OF] = source


@inner_kernel
def refine(picture, comps, state, i, hot, noise, fits, rows):
    """Refit a crowded component with its neighbours' light subtracted, in place."""
    patch = new_patch(comps[i], picture.grey.shape[0], picture.grey.shape[1])
    make_patch(picture, comps, state, i, hot, np.int64(1), patch)
    for j in range(comps.shape[0]):
        known = j != i and state[j, STATUS] == ACCEPTED and state[j, SIZE] > 0
        if known and boxes_overlap(comps[i], comps[j], fit_margin(comps[i]) + fit_margin(comps[j])):
            add_light_to_patch(state[j, KIND], fits[j], state[j, SIZE], patch, -1.0)
    p = np.empty(FIT)
    copy_to(fits[i], p)
    kind = state[i, KIND]
    size = state[i, SIZE]
    rss, _ = refit(kind, size, patch, patch.use.size, p, np.empty(patch.use.shape))
    if rss < 0.0:
        return
    trial = np.empty((MOST_LIGHTS, SPOT))
    lights = write_spots(kind, size, p, patch, rss, trial, i)
    # else the fit that there is stays
    if lights == state[i, LIGHTS] and check_fit(comps[i], trial, lights, comps[i, CLIPPED] > 0.0, noise) == ACCEPTED:
        copy_to(p, fits[i])
        for k in range(lights):
            copy_to(trial[k], rows[i, k])


@inner_kernel
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
        dof = row[S_DOF]
        signal = row[S_SIGNAL]
        if row[S_SQUARE] <= 0.0 or dof < 1.0:
            continue
        # slope of r^2 over m about the means of both; r^2 of normal noise varies by 2 a^2
        square = row[S_SQUARE] - signal * signal / dof
        a = row[S_RSS] / dof
        top += row[S_FOURTH] - a * signal
        bottom += square
        spread += 2.0 * a * a * square
    if bottom <= 0.0:
        return 0.0
    return max((top - GAIN_DOUBT * sqrt(spread)) / bottom, 0.0)


@inner_kernel
def noise_of(row, g):
    """Return the constant part of a spot's noise variance, given the shot noise's gain g.

    Where the background lies within the noise of black, half of its pixels are clipped and tell too little; there the
    residuals are weighted with the light.
    """
    a = (row[S_RSS] - g * row[S_SIGNAL]) / max(row[S_DOF], 1.0)
    if row[S_SIGNAL] > 0.0 and row[S_SQUARE] > 0.0:
        # residuals squared, weighted by the light: what lies where nothing is clipped at black
        lit = row[S_FOURTH] / row[S_SIGNAL]
        if row[S_B] < 2.0 * sqrt(lit):
            a = max(a, lit - g * row[S_SQUARE] / row[S_SIGNAL])
    return max(a, PIXEL_VARIANCE)


@kernel
def pack_results(options, comps, state, rows):
    """Return uv (n, 2), covariance (n, 2, 2), peak, size, model and owner (n,) of the spots, and refused (m, 3).

    A spot's owner is that of its area; refused are u, v and the number of the reason.
    """
    spots = np.empty((comps.shape[0] * MOST_LIGHTS, SPOT))
    refused = np.empty((comps.shape[0], 3))
    n = np.int64(0)
    m = 0
    for i in range(comps.shape[0]):
        if state[i, STATUS] == ACCEPTED:
            for k in range(state[i, LIGHTS]):
                copy_to(rows[i, k], spots[n])
                n += 1
        elif state[i, OWNER] >= 0:
            refused[m, 0] = comps[i, SUM_X] / comps[i, WEIGHT]
            refused[m, 1] = comps[i, SUM_Y] / comps[i, WEIGHT]
            refused[m, 2] = state[i, STATUS]
            m += 1
    g = options[O_GAIN] if options[O_GAIN] >= 0.0 else shot_gain(spots, n)
    uv = np.empty((n, 2))
    covariance = np.empty((n, 2, 2))
    peak = np.empty(n)
    size = np.empty(n)
    model = np.empty(n, np.int64)
    owner = np.empty(n, np.int64)
    for k in range(n):
        row = spots[k]
        a = noise_of(row, g)
        uv[k, 0] = row[S_U]
        uv[k, 1] = row[S_V]
        covariance[k, 0, 0] = a * row[S_CH] + g * row[S_CG] + row[S_FLOOR]
        covariance[k, 0, 1] = a * row[S_CH + 1] + g * row[S_CG + 1]
        covariance[k, 1, 0] = covariance[k, 0, 1]
        covariance[k, 1, 1] = a * row[S_CH + 2] + g * row[S_CG + 2] + row[S_FLOOR]
        peak[k] = row[S_PEAK]
        size[k] = row[S_SIZE]
        model[k] = int(row[S_MODEL])
        owner[k] = state[int(row[S_OF]), OWNER]
    return uv, covariance, peak, size, model, owner, refused[:m].copy()
