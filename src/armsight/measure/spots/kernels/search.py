"""From an image to spots: the whole search in one compiled call, and the tracking of predicted spots."""

from __future__ import annotations

from math import sqrt

import numpy as np

from armsight.measure.spots.kernels.choose import (
    ACCEPTED,
    AS_GAUSSIAN,
    BEYOND,
    BORDER,
    FAILED,
    HOT,
    LARGE,
    MANY,
    MISFIT,
    ONLY_ELLIPSE,
    ONLY_GAUSSIAN,
    OTHER,
    S_CG,
    S_CH,
    S_DOF,
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
    SMALL,
    SPOT,
    choose,
    describe,
    fill_patch,
    leave_to,
    patch_box,
    refit,
    round_start,
    verdict,
)
from armsight.measure.spots.kernels.compiled import copy_to, insertion_sort, kernel
from armsight.measure.spots.kernels.models import MOST_LIGHTS, MOST_PARAMETERS, light_of
from armsight.measure.spots.kernels.round import (
    COV,
    DOF,
    FOURTH,
    MOST,
    PIXEL_VARIANCE,
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
)
from armsight.measure.spots.kernels.scan import (
    AREA,
    BLOCK,
    CLIPPED,
    COLUMNS,
    GRID,
    LEVEL,
    PEAK,
    SUM_X,
    SUM_Y,
    WEIGHT,
    X_MAX,
    X_MIN,
    Y_MAX,
    Y_MIN,
    bright_blocks,
    bright_blocks_mapped,
    components,
    sense,
    threshold_map,
    window_components,
)

# order of the numbers in `options` (see settings.SpotSettings)
O_THRESHOLD, O_FLIP, O_SATURATION, O_MIN_PIXELS, O_MAX_RADIUS, O_MAX_SPOTS, O_MODEL, O_GAIN = range(8)
OPTIONS = 8

SIGNIFICANT = 5.0
"""Threshold above the background in deviations of the noise: one false pixel in three frames of 1280 x 720."""
LEAST_MARGIN = 6.0
"""Least threshold above the background in grey levels, where the noise is below one level."""
LEVEL_FRAME = 2.0
"""Range of the thresholds in grey levels within which one is used for the whole frame."""
FEW_RUNS = 1024
MOST_RUNS = 65536
MOST_SEEN = 32
"""Components looked at in one window."""
CROWD_SWEEPS = 2
"""Times that crowded spots are refitted with their neighbours' light subtracted."""
FULL, NOTHING_ABOVE, TOO_BRIGHT = range(3)


@kernel
def slope_prior(levels, i, j, w, h, noise, prior):
    """Fill prior (4,): slope of the background per px along x and y at tile (i, j), and how well it is known.

    The middle one of three rows' (columns') central differences; its deviation is their spread plus the step's
    unevenness plus the sample's own noise.
    """
    three = np.empty(3)
    for axis in range(2):
        size = (w if axis == 0 else h) / GRID
        c = j if axis == 0 else i
        o = i if axis == 0 else j
        lo = max(c - 1, 0)
        hi = min(c + 1, GRID - 1)
        known = 0
        bend = 0.0
        for k in range(max(o - 1, 0), min(o + 2, GRID)):
            a = levels[k, lo] if axis == 0 else levels[lo, k]
            b = levels[k, c] if axis == 0 else levels[c, k]
            d = levels[k, hi] if axis == 0 else levels[hi, k]
            if a < 0.0 or b < 0.0 or d < 0.0:
                continue
            three[known] = (d - a) / ((hi - lo) * size)
            if k == o and hi - lo == 2:
                bend = abs(d - 2.0 * b + a) / size
            known += 1
        prior[axis] = 0.0
        prior[2 + axis] = 1.0
        if known > 1:
            low = min(three[0], three[1]) if known == 2 else min(three[0], three[1], three[2])
            high = max(three[0], three[1]) if known == 2 else max(three[0], three[1], three[2])
            middle = 0.5 * (low + high)
            if known == 3:
                middle = three[0] + three[1] + three[2] - low - high
            prior[axis] = middle
            prior[2 + axis] = high - low + bend + 0.25 * sqrt(noise) / size + 1e-4


@kernel
def classify(comp, w, h, window, min_pixels, max_radius, margin):
    """Return ACCEPTED or why a component is refused before any fit. window (4,): x0, x1, y0, y1 that were searched."""
    if comp[AREA] < min_pixels:
        lone = comp[AREA] <= 2.0 and comp[PEAK] - comp[LEVEL] > margin
        return HOT if lone else SMALL
    if comp[X_MIN] < 1.0 or comp[Y_MIN] < 1.0 or comp[X_MAX] > w - 2.0 or comp[Y_MAX] > h - 2.0:
        return BORDER
    if max(comp[X_MAX] - comp[X_MIN], comp[Y_MAX] - comp[Y_MIN]) > 2.0 * max_radius:
        return LARGE
    inside = comp[X_MIN] > window[0] and comp[X_MAX] < window[1] - 1
    if not (inside and comp[Y_MIN] > window[2] and comp[Y_MAX] < window[3] - 1):
        return BEYOND
    return ACCEPTED


@kernel
def keep_strongest(comps, n, status, most):
    """Set status to MANY for all but the `most` accepted components of greatest light; return how many are left."""
    weights = np.empty(n)
    count = 0
    for i in range(n):
        if status[i] == ACCEPTED:
            weights[count] = comps[i, WEIGHT]
            count += 1
    if count <= most:
        return count
    insertion_sort(weights, count)
    least = weights[count - most]
    left = 0
    for i in range(n):
        if status[i] == ACCEPTED:
            if comps[i, WEIGHT] < least or left >= most:
                status[i] = MANY
            else:
                left += 1
    return left


@kernel
def near(a, b, reach):
    """Tell whether the bounds of component b, widened by reach, meet those of a."""
    return (
        b[X_MIN] - reach <= a[X_MAX]
        and b[X_MAX] + reach >= a[X_MIN]
        and b[Y_MIN] - reach <= a[Y_MAX]
        and b[Y_MAX] + reach >= a[Y_MIN]
    )


@kernel
def skirt(comp):
    """Return how far beyond a component's bounds its fit looks, in px."""
    return 0.9 * max(comp[X_MAX] - comp[X_MIN], comp[Y_MAX] - comp[Y_MIN]) / 2.0 + 4.0


@kernel
def copy_round(result, source, row):
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
    row[S_OF] = source


@kernel
def keep_fit(result, p):
    """Write the result of a round fit into p as a joint model of one light."""
    p[0] = result[B]
    p[1] = 1.0 / result[Q]
    p[2] = result[U]
    p[3] = result[V]
    p[4] = result[A]


@kernel
def make_patch(image, flip, saturation, mask, comps, n, status, i, hot, n_hot, subtract, box, values, use):
    """Fill the patch of component i: pixels of hot pixels and of neighbours left out (all, or those not subtracted)."""
    fill_patch(image, flip, saturation, mask, box, values, use)
    for k in range(n_hot):
        x = hot[k, 0] - box[0]
        y = hot[k, 1] - box[2]
        if 0 <= x < use.shape[1] and 0 <= y < use.shape[0]:
            use[y, x] = 0
    for j in range(n):
        if j == i or status[j] == HOT or status[j] == SMALL or (subtract > 0 and status[j] == ACCEPTED):
            continue
        if near(comps[i], comps[j], skirt(comps[i]) + 2.0):
            leave_to(comps[i], comps[j], box, use)


@kernel
def refine_crowd(
    image, flip, saturation, mask, comps, n, status, crowded, hot, n_hot, kinds, sizes, fits, priors, rows
):
    """Refit crowded components with their neighbours' light subtracted, in place."""
    box = np.empty(4, np.int64)
    p = np.empty(MOST_PARAMETERS)
    for _ in range(CROWD_SWEEPS):
        for i in range(n):
            if status[i] != ACCEPTED or not crowded[i] or sizes[i] == 0:
                continue
            patch_box(comps[i], image.shape[0], image.shape[1], box)
            shape = (box[3] - box[2], box[1] - box[0])
            values = np.empty(shape)
            use = np.empty(shape, np.uint8)
            make_patch(image, flip, saturation, mask, comps, n, status, i, hot, n_hot, np.int64(1), box, values, use)
            for j in range(n):
                if j != i and sizes[j] > 0 and near(comps[i], comps[j], skirt(comps[i]) + skirt(comps[j])):
                    light_of(kinds[j], fits[j], sizes[j], box[0], box[2], values, -1.0)
            copy_to(fits[i], p)
            rss, _ = refit(kinds[i], sizes[i], values, use, box[0], box[2], use.size, p, np.empty(shape))
            if rss >= 0.0:
                copy_to(p, fits[i])
                describe(kinds[i], sizes[i], p, values, use, box, rss, priors[i], rows[i], i)


@kernel
def measure(image, flip, mask, options, comps, owner, n, window, backgrounds, levels, noise, spots, refused):
    """Fit the components; fill spots (.., SPOT) and refused (.., 3: u, v, why); return how many of each.

    owner (n,): components of a negative owner are seen as neighbours but neither measured nor refused.
    """
    h, w = image.shape
    saturation = int(options[O_SATURATION])
    only = int(options[O_MODEL])
    margin = max(SIGNIFICANT * sqrt(noise), LEAST_MARGIN)
    status = np.empty(n, np.int64)
    hot = np.empty((2 * n, 2), np.int64)
    n_hot = np.int64(0)
    for i in range(n):
        status[i] = classify(comps[i], w, h, window, options[O_MIN_PIXELS], options[O_MAX_RADIUS], margin)
        if owner[i] < 0 and status[i] != HOT and status[i] != SMALL:
            status[i] = OTHER
        if status[i] == HOT:
            hot[n_hot, 0] = int(comps[i, X_MIN])
            hot[n_hot, 1] = int(comps[i, Y_MIN])
            n_hot += 1
            if comps[i, AREA] == 2.0:
                hot[n_hot, 0] = int(comps[i, X_MAX])
                hot[n_hot, 1] = int(comps[i, Y_MAX])
                n_hot += 1
    keep_strongest(comps, n, status, int(options[O_MAX_SPOTS]))
    relevant = np.empty(n, np.int64)
    n_relevant = 0
    for i in range(n):
        if status[i] != HOT and status[i] != SMALL:
            relevant[n_relevant] = i
            n_relevant += 1
    rows = np.empty((n, MOST_LIGHTS, SPOT))
    lights = np.zeros(n, np.int64)
    kinds = np.zeros(n, np.int64)
    sizes = np.zeros(n, np.int64)
    fits = np.zeros((n, MOST_PARAMETERS))
    priors = np.empty((n, 4))
    crowded = np.zeros(n, np.bool_)
    any_crowd = False
    start = np.empty(5)
    result = np.empty(RESULT)
    dropped = np.empty((2048, 2), np.int64)
    fx = np.empty((3, MOST))
    fy = np.empty((3, MOST))
    box = np.empty(4, np.int64)
    for r in range(n_relevant):
        i = relevant[r]
        if status[i] != ACCEPTED:
            continue
        comp = comps[i]
        ti = int(comp[SUM_Y] / comp[WEIGHT]) * GRID // h
        tj = int(comp[SUM_X] / comp[WEIGHT]) * GRID // w
        background = min(backgrounds[ti, tj], comp[LEVEL])
        slope_prior(levels, ti, tj, w, h, noise, priors[i])
        reach = skirt(comp)
        for q in range(n_relevant):
            if q != r and near(comp, comps[relevant[q]], reach):
                crowded[i] = True
        close_hot = False
        for k in range(n_hot):
            if abs(hot[k, 0] - 0.5 * (comp[X_MIN] + comp[X_MAX])) < 64.0:
                close_hot = close_hot or abs(hot[k, 1] - 0.5 * (comp[Y_MIN] + comp[Y_MAX])) < 64.0
        if not crowded[i] and only != ONLY_ELLIPSE:
            round_start(comp, background, saturation, start)
            clipped = comp[CLIPPED] > 0.0 or close_hot or mask.size > 0
            fine = fit_round(
                image, flip, saturation, mask, hot, n_hot, clipped, start, priors[i], dropped, fx, fy, result
            )
            if fine and (result[RUN] < MISFIT or only == ONLY_GAUSSIAN):
                copy_round(result, i, rows[i, 0])
                keep_fit(result, fits[i])
                sizes[i] = 5
                lights[i] = 1
                status[i] = verdict(comp, rows[i], lights[i], comp[CLIPPED] > 0.0, noise)
                if status[i] == ACCEPTED:
                    continue
        patch_box(comp, h, w, box)
        shape = (box[3] - box[2], box[1] - box[0])
        values = np.empty(shape)
        use = np.empty(shape, np.uint8)
        make_patch(image, flip, saturation, mask, comps, n, status, i, hot, n_hot, np.int64(0), box, values, use)
        kinds[i], sizes[i], rss = choose(comp, background, box, values, use, noise, only, fits[i])
        status[i] = FAILED
        if sizes[i] > 0:
            lights[i] = describe(kinds[i], sizes[i], fits[i], values, use, box, rss, priors[i], rows[i], i)
            if lights[i] > 0:
                status[i] = verdict(comp, rows[i], lights[i], comp[CLIPPED] > 0.0, noise)
        elif comp[CLIPPED] > 0.5 * comp[AREA]:
            status[i] = SATURATED
        any_crowd = any_crowd or crowded[i]
    if any_crowd:
        refine_crowd(
            image, flip, saturation, mask, comps, n, status, crowded, hot, n_hot, kinds, sizes, fits, priors, rows
        )
    n_spots = np.int64(0)
    n_refused = np.int64(0)
    for i in range(n):
        if status[i] == ACCEPTED:
            for k in range(lights[i]):
                if n_spots < spots.shape[0]:
                    copy_to(rows[i, k], spots[n_spots])
                    n_spots += 1
        elif owner[i] >= 0 and n_refused < refused.shape[0]:
            refused[n_refused, 0] = comps[i, SUM_X] / comps[i, WEIGHT]
            refused[n_refused, 1] = comps[i, SUM_Y] / comps[i, WEIGHT]
            refused[n_refused, 2] = status[i]
            n_refused += 1
    return n_spots, n_refused


@kernel
def shot_gain(spots, n):
    """Return the gain (grey levels of variance per grey level of light) that the residuals of all spots prove.

    Regression of the squared residuals on the model, each spot with its own constant part; less one deviation,
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
        square = row[S_SQUARE] - signal * signal / dof
        a = row[S_RSS] / dof
        top += row[S_FOURTH] - a * signal
        bottom += square
        spread += 2.0 * a * a * square
    if bottom <= 0.0:
        return 0.0
    return max((top - sqrt(spread)) / bottom, 0.0)


@kernel
def deliver(spots, n, gain):
    """Return uv (n, 2), covariance (n, 2, 2), peak, size (n,), model (n,) and the component (n,) of each spot."""
    g = gain if gain >= 0.0 else shot_gain(spots, n)
    uv = np.empty((n, 2))
    covariance = np.empty((n, 2, 2))
    peak = np.empty(n)
    size = np.empty(n)
    model = np.empty(n, np.int64)
    of = np.empty(n, np.int64)
    for k in range(n):
        row = spots[k]
        a = max((row[S_RSS] - g * row[S_SIGNAL]) / max(row[S_DOF], 1.0), PIXEL_VARIANCE)
        uv[k, 0] = row[S_U]
        uv[k, 1] = row[S_V]
        covariance[k, 0, 0] = a * row[S_CH] + g * row[S_CG]
        covariance[k, 0, 1] = a * row[S_CH + 1] + g * row[S_CG + 1]
        covariance[k, 1, 0] = covariance[k, 0, 1]
        covariance[k, 1, 1] = a * row[S_CH + 2] + g * row[S_CG + 2]
        peak[k] = row[S_PEAK]
        size[k] = row[S_SIZE]
        model[k] = int(row[S_MODEL])
        of[k] = int(row[S_OF])
    return uv, covariance, peak, size, model, of


@kernel
def survey(image, flip, mask, levels, thresholds, backgrounds):
    """Fill the tiles' levels, thresholds and backgrounds; return noise variance, lowest and highest threshold."""
    noise = sense(image, flip, mask, levels)
    margin = max(SIGNIFICANT * sqrt(noise), LEAST_MARGIN)
    low, high = threshold_map(levels, margin, thresholds)
    for i in range(GRID):
        for j in range(GRID):
            backgrounds[i, j] = thresholds[i, j] - margin
    return noise, low, high


@kernel
def label(image, flip, mask, saturation, thresholds, mapped, blocks, n_blocks):
    """Return the components' table and how many there are (-1: too many runs)."""
    runs_most = FEW_RUNS
    while True:
        table = np.empty((runs_most, COLUMNS))
        runs = np.empty((runs_most, 3), np.int32)
        parent = np.empty(runs_most, np.int32)
        n = components(image, flip, mask, saturation, thresholds, mapped, blocks, n_blocks, runs, parent, table)
        if n >= 0 or runs_most >= MOST_RUNS:
            return table, n
        runs_most *= 8


@kernel
def search(image, mask, options):
    """Search a whole image (h, w), contiguous; return deliver's columns, refused (m, 3), outcome, what the outcome is of.

    outcome: FULL (searched), NOTHING_ABOVE (background too bright for any spot; the number is its level),
    TOO_BRIGHT (too much lies above the threshold; the number is the share of blocks).
    """
    h, w = image.shape
    flip = np.uint8(options[O_FLIP])
    saturation = int(options[O_SATURATION])
    levels = np.empty((GRID, GRID))
    thresholds = np.empty((GRID, GRID))
    backgrounds = np.empty((GRID, GRID))
    noise, low, high = survey(image, flip, mask, levels, thresholds, backgrounds)
    mapped = options[O_THRESHOLD] < 0.0 and high - low > LEVEL_FRAME
    if not mapped:
        level = high if options[O_THRESHOLD] < 0.0 else options[O_THRESHOLD]
        for i in range(GRID):
            for j in range(GRID):
                thresholds[i, j] = level
    refused = np.empty((0, 3))
    spots = np.empty((0, SPOT))
    if (low if mapped else thresholds[0, 0]) >= min(saturation, 255):
        return deliver(spots, np.int64(0), 0.0), refused, NOTHING_ABOVE, levels[GRID // 2, GRID // 2]
    for i in range(GRID):
        for j in range(GRID):
            thresholds[i, j] = min(thresholds[i, j], 255.0)
    flat = image.reshape(-1)
    n_all = (flat.size + BLOCK - 1) // BLOCK
    blocks = np.empty(n_all, np.int32)
    if mapped:
        n_blocks = bright_blocks_mapped(flat, flip, h, w, thresholds, blocks)
    else:
        n_blocks = bright_blocks(flat, flip, thresholds[0, 0], blocks)
    comps, n = label(image, flip, mask, saturation, thresholds, mapped, blocks, n_blocks)
    if n < 0:
        return deliver(spots, np.int64(0), 0.0), refused, TOO_BRIGHT, n_blocks / n_all
    window = np.empty(4, np.int64)
    window[0] = window[2] = -1
    window[1] = w + 1
    window[3] = h + 1
    spots = np.empty((MOST_LIGHTS * min(n, int(options[O_MAX_SPOTS])), SPOT))
    refused = np.empty((n, 3))
    n_spots, n_refused = measure(
        image, flip, mask, options, comps, np.zeros(n, np.int64), n, window, backgrounds, levels, noise, spots, refused
    )
    return deliver(spots, n_spots, options[O_GAIN]), refused[:n_refused].copy(), FULL, 0.0


@kernel
def nearest(comps, n, u, v, window, options, w, h, margin):
    """Return the component whose centre is nearest to (u, v), fit for measuring if there is one; -1 where none is."""
    best = -1
    least = 1e300
    for i in range(n):
        what = classify(comps[i], w, h, window, options[O_MIN_PIXELS], options[O_MAX_RADIUS], margin)
        if what == HOT or what == SMALL:
            continue
        dx = comps[i, SUM_X] / comps[i, WEIGHT] - u
        dy = comps[i, SUM_Y] / comps[i, WEIGHT] - v
        away = dx * dx + dy * dy + (0.0 if what == ACCEPTED else 1e6)
        if away < least:
            least = away
            best = i
    return best


@kernel
def track(image, mask, options, predicted, half):
    """Search windows of half width half around predicted (n, 2); return deliver's columns, their predictions, refused.

    One bright area is measured per prediction, the nearest; one that is nearest to two predictions belongs to
    the nearer one.
    """
    h, w = image.shape
    flip = np.uint8(options[O_FLIP])
    saturation = int(options[O_SATURATION])
    levels = np.empty((GRID, GRID))
    thresholds = np.empty((GRID, GRID))
    backgrounds = np.empty((GRID, GRID))
    noise, _, _ = survey(image, flip, mask, levels, thresholds, backgrounds)
    margin = max(SIGNIFICANT * sqrt(noise), LEAST_MARGIN)
    most = predicted.shape[0]
    seen = np.empty((MOST_SEEN * most, COLUMNS))
    owner = np.empty(MOST_SEEN * most, np.int64)
    n = np.int64(0)
    table = np.empty((FEW_RUNS, COLUMNS))
    runs = np.empty((FEW_RUNS, 3), np.int32)
    parent = np.empty(FEW_RUNS, np.int32)
    box = np.empty(4, np.int64)
    refused = np.empty((0, 3))
    cut = np.empty((most, 3))
    n_cut = 0
    for k in range(most):
        u = predicted[k, 0]
        v = predicted[k, 1]
        if not (-0.5 <= u < w - 0.5 and -0.5 <= v < h - 0.5):
            continue
        box[0] = max(int(u + 0.5) - half, 0)
        box[1] = min(int(u + 0.5) + half + 1, w)
        box[2] = max(int(v + 0.5) - half, 0)
        box[3] = min(int(v + 0.5) + half + 1, h)
        level = options[O_THRESHOLD]
        if level < 0.0:
            level = thresholds[int(v + 0.5) * GRID // h, int(u + 0.5) * GRID // w]
        if level >= min(saturation, 255):
            continue
        count = window_components(image, flip, mask, saturation, int(level), box, runs, parent, table)
        i = nearest(table, count, u, v, box, options, w, h, margin)
        for j in range(min(count, MOST_SEEN)):
            what = classify(table[j], w, h, box, options[O_MIN_PIXELS], options[O_MAX_RADIUS], margin)
            if what == BEYOND and j == i:
                cut[n_cut, 0] = table[i, SUM_X] / table[i, WEIGHT]
                cut[n_cut, 1] = table[i, SUM_Y] / table[i, WEIGHT]
                cut[n_cut, 2] = BEYOND
                n_cut += 1
            copy_to(table[j], seen[n])
            owner[n] = k if j == i and what != BEYOND else -1
            n += 1
    n = settle(seen, owner, n, predicted)
    window = np.empty(4, np.int64)
    window[0] = window[2] = -1
    window[1] = w + 1
    window[3] = h + 1
    spots = np.empty((MOST_LIGHTS * most, SPOT))
    refused = np.empty((n + n_cut, 3))
    n_spots, n_refused = measure(
        image, flip, mask, options, seen, owner, n, window, backgrounds, levels, noise, spots, refused
    )
    for k in range(n_cut):
        copy_to(cut[k], refused[n_refused])
        n_refused += 1
    return deliver(spots, n_spots, options[O_GAIN]), owner[:n].copy(), refused[:n_refused].copy()


@kernel
def settle(seen, owner, n, predicted):
    """Leave each component to the nearest of the predictions that chose it, once; return how many are left."""
    left = 0
    for k in range(n):
        same = -1
        for j in range(left):
            if near(seen[k], seen[j], 0.0):
                same = j
        if same < 0:
            copy_to(seen[k], seen[left])
            owner[left] = owner[k]
            left += 1
        elif owner[same] < 0 and owner[k] >= 0:
            copy_to(seen[k], seen[same])
            owner[same] = owner[k]
        elif owner[k] >= 0 and distance(seen[k], predicted[owner[k]]) < distance(seen[same], predicted[owner[same]]):
            owner[same] = owner[k]
    return left


@kernel
def distance(comp, uv):
    """Return the squared distance in px^2 of a component's centre from uv (2,)."""
    dx = comp[SUM_X] / comp[WEIGHT] - uv[0]
    dy = comp[SUM_Y] / comp[WEIGHT] - uv[1]
    return dx * dx + dy * dy
