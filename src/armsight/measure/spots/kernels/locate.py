"""Where is it bright? Surveys the background and labels bright areas, in a whole image or around predictions."""

from __future__ import annotations

from math import sqrt

import numpy as np

from armsight._numba import inner_kernel, kernel, lean_kernel
from armsight.measure.spots.kernels import columns as col
from armsight.measure.spots.kernels.area import ACCEPTED, BEYOND, HOT, OTHER, SMALL, boxes_overlap, classify
from armsight.measure.spots.kernels.blobs import RING_SAMPLES, BlobLimits, blob_near, ring_level
from armsight.measure.spots.kernels.columns import Picture, copy_to
from armsight.measure.spots.kernels.scan import (
    BLOCK,
    block_threshold,
    bright_blocks,
    bright_blocks_mapped,
    connected_components,
    connected_components_in_window,
    estimate_background,
    threshold_map,
)

SIGNIFICANT = 5.0
"""Threshold above the background in standard deviations of the noise: one false pixel in three frames of 1280 x 720."""
LEAST_MARGIN = 6.0
"""Least threshold above the background in grey levels, where the noise is below one level."""
LEVEL_FRAME = 2.0
"""Range of the thresholds in grey levels within which one is used for the whole frame."""
FEW_RUNS = 512
MOST_RUNS = 65536
WINDOW_CONTRAST = 24.0
"""Least height of a light above its ring in a window in which more than lights is bright."""
WIDE_SHARE = 0.1
"""Share of a window that an area at its edge covers from which it is no other light but a part of the room."""
RING_GAP = 4.0
"""Distance in px of the ring that shows how much the background changes from an area above a threshold."""
RING_NOISE = 1.35
"""Standard deviations of the noise that the quartiles of a ring may be apart where the background does not change."""
MOST_SEEN = 32
"""Areas looked at in one window."""
FULL, NOTHING_ABOVE, TOO_BRIGHT, BUSY = range(4)
BUSY_SHARE = 0.5
"""Share of the blocks above an automatic threshold from which the background is no even surface but a picture."""
BUSY_RUNS = 4096
"""Bright runs from which it is one; counted as rises above the threshold first, of which nearly each begins a run."""


@lean_kernel
def survey_image(image, flip, mask, survey, thresholds):
    """Fill the survey and the tiles' thresholds; return the margin above the background, lowest, highest threshold."""
    noise, processed = estimate_background(image, flip, mask, survey)
    # noise that a camera has taken away is no measure of what else it does to the levels
    margin = max(SIGNIFICANT * sqrt(noise), LEAST_MARGIN)
    low, high = threshold_map(survey, margin, thresholds)
    for i in range(col.GRID):
        for j in range(col.GRID):
            survey[col.GRID + i, j] = thresholds[i, j] - margin
    survey[2 * col.GRID, col.NOISE] = noise
    survey[2 * col.GRID, col.PROCESSED] = 1.0 if processed else 0.0
    return margin, low, high


@lean_kernel
def count_rising_edges(flat, flip, w, h, thresholds, mapped, blocks, n_blocks, most):
    """Return how often the grey rises above the threshold within the blocks; stops counting beyond most."""
    level = np.uint8(thresholds[0, 0])
    count = np.int64(0)
    for k in range(n_blocks):
        first = blocks[k] * BLOCK
        if mapped:
            level = np.uint8(block_threshold(thresholds, first, h, w))
        at = np.uint64(first)
        rises = np.int64(0)
        for i in range(min(BLOCK, flat.size - first) - 1):
            here = np.uint8(flat[at + np.uint64(i)] ^ flip) > level
            after = np.uint8(flat[at + np.uint64(i + 1)] ^ flip) > level
            # nearly each rise begins a run: counted in vector code before anything is labelled
            rises += after and not here
        count += rises
        if count > most:
            return count
    return count


@inner_kernel
def label_components(picture, thresholds, mapped, blocks, n_blocks, likely, most):
    """Return the components' table and how many there are (-1: more than `most` runs; likely: about how many runs)."""
    runs_most = FEW_RUNS if likely < FEW_RUNS else min(8 * FEW_RUNS, most)
    while True:
        table = np.empty((runs_most, col.COLUMNS))
        runs = np.empty((runs_most, 3), np.int32)
        parent = np.empty(runs_most, np.int32)
        n = connected_components(picture, thresholds, mapped, blocks, n_blocks, runs, parent, table)
        if n >= 0 or runs_most >= most:
            return table, n
        # labelled once more, with room for eight times as many
        runs_most *= 8


@lean_kernel
def classify_areas(comps, state, options, w, h, window, margin):
    """Fill STATUS of all areas: what is refused before any fit."""
    for i in range(comps.shape[0]):
        what = classify(comps[i], w, h, window, options[col.O_MIN_PIXELS], options[col.O_MAX_RADIUS], margin)
        # a neighbour that nobody asked for: known, so that fits leave out its pixels, but not measured
        if state[i, col.OWNER] < 0 and what != HOT and what != SMALL:
            what = OTHER
        state[i, col.STATUS] = what


@inner_kernel
def ring_background(image, flip, comps, survey, w, h):
    """Fill BACKGROUND and SLOPE of areas of a processed picture, whose lights are then judged as those before a
    room."""
    if survey[2 * col.GRID, col.PROCESSED] == 0.0:
        return
    ring = np.empty(RING_SAMPLES)
    for k in range(comps.shape[0]):
        if comps[k, col.SLOPE] >= 0.0:
            continue
        i = int(comps[k, col.SUM_Y] / comps[k, col.WEIGHT]) * col.GRID // h
        j = int(comps[k, col.SUM_X] / comps[k, col.WEIGHT]) * col.GRID // w
        comps[k, col.BACKGROUND] = min(survey[col.GRID + i, j], comps[k, col.LEVEL])
        half = 0.5 * max(comps[k, col.X_MAX] - comps[k, col.X_MIN], comps[k, col.Y_MAX] - comps[k, col.Y_MIN])
        x = int(0.5 * (comps[k, col.X_MIN] + comps[k, col.X_MAX]))
        y = int(0.5 * (comps[k, col.Y_MIN] + comps[k, col.Y_MAX]))
        n = ring_level(image, flip, x, y, half + RING_GAP, ring)
        # quartiles on an even background are apart by noise alone, which is taken off
        step = ring[(3 * n) // 4] - ring[n // 4] - RING_NOISE * sqrt(survey[2 * col.GRID, col.NOISE]) if n > 4 else 0.0
        comps[k, col.SLOPE] = max(step, 0.0) / (half + RING_GAP)


@lean_kernel
def unbounded_window(w, h, window):
    """Fill window (x0, x1, y0, y1) so that nothing reaches beyond it."""
    window[0] = -1
    window[1] = w + 1
    window[2] = -1
    window[3] = h + 1


@kernel
def locate(image, mask, options):
    """Search a whole image (h, w), contiguous; return its areas (n, COLUMNS), their state, the survey, and outcome.

    outcome: FULL (searched), NOTHING_ABOVE (background too bright for any spot; the survey's NUMBER is its level),
    TOO_BRIGHT (too much lies above the threshold given; NUMBER is the share of blocks), BUSY (the same for an
    automatic threshold, found without labelling all of it).
    """
    h, w = image.shape
    flip = np.uint8(options[col.O_FLIP])
    saturation = int(options[col.O_SATURATION])
    survey = np.empty((col.SURVEY, col.GRID))
    thresholds = np.empty((col.GRID, col.GRID))
    margin, low, high = survey_image(image, flip, mask, survey, thresholds)
    mapped = options[col.O_THRESHOLD] < 0.0 and high - low > LEVEL_FRAME
    if not mapped:
        low = high if options[col.O_THRESHOLD] < 0.0 else options[col.O_THRESHOLD]
    for i in range(col.GRID):
        for j in range(col.GRID):
            # they are compared as bytes
            thresholds[i, j] = min(thresholds[i, j], 255.0) if mapped else low
    # no level exceeds a threshold at the clipping level: everything would be missed in silence
    if low >= min(saturation, 255):
        survey[2 * col.GRID, col.NUMBER] = survey[col.GRID // 2, col.GRID // 2]
        return np.empty((0, col.COLUMNS)), np.empty((0, col.STATE), np.int64), survey, NOTHING_ABOVE
    n_all = (image.size + BLOCK - 1) // BLOCK
    blocks = np.empty(n_all, np.int32)
    if mapped:
        n_blocks = bright_blocks_mapped(image.reshape(-1), flip, h, w, thresholds, blocks)
    else:
        n_blocks = bright_blocks(image.reshape(-1), flip, thresholds[0, 0], blocks)
    survey[2 * col.GRID, col.NUMBER] = n_blocks / n_all
    automatic = options[col.O_THRESHOLD] < 0.0
    if automatic and n_blocks > BUSY_SHARE * n_all:
        return np.empty((0, col.COLUMNS)), np.empty((0, col.STATE), np.int64), survey, BUSY
    rises = np.int64(0)
    if automatic and mask.size == 0:
        rises = count_rising_edges(
            image.reshape(-1), flip, w, h, thresholds, mapped, blocks, n_blocks, np.int64(BUSY_RUNS)
        )
        if rises > BUSY_RUNS:
            return np.empty((0, col.COLUMNS)), np.empty((0, col.STATE), np.int64), survey, BUSY
    most = BUSY_RUNS if automatic else MOST_RUNS
    picture = Picture(image, flip, saturation, mask)
    table, n = label_components(picture, thresholds, mapped, blocks, n_blocks, rises, most)
    if n < 0:
        return np.empty((0, col.COLUMNS)), np.empty((0, col.STATE), np.int64), survey, BUSY if automatic else TOO_BRIGHT
    comps = np.empty((n, col.COLUMNS))
    for i in range(n):
        for c in range(col.COLUMNS):
            comps[i, c] = table[i, c]
    state = np.zeros((n, col.STATE), np.int64)
    window = np.empty(4, np.int64)
    unbounded_window(w, h, window)
    classify_areas(comps, state, options, w, h, window, margin)
    ring_background(image, flip, comps, survey, w, h)
    return comps, state, survey, FULL


@lean_kernel
def nearest(comps, n, u, v, window, options, w, h, margin):
    """Return the component whose centre is nearest to (u, v), fit for measuring if there is one; -1 where none is."""
    best = -1
    least = 1e300
    for i in range(n):
        what = classify(comps[i], w, h, window, options[col.O_MIN_PIXELS], options[col.O_MAX_RADIUS], margin)
        if what in (HOT, SMALL):
            continue
        dx = comps[i, col.SUM_X] / comps[i, col.WEIGHT] - u
        dy = comps[i, col.SUM_Y] / comps[i, col.WEIGHT] - v
        # px^2, further than anything in a window: what can be measured comes before what cannot
        away = dx * dx + dy * dy + (0.0 if what == ACCEPTED else 1e6)
        if away < least:
            least = away
            best = i
    return best


@lean_kernel
def remove_duplicates(seen, owner, n, predicted):
    """Leave each component to the nearest of the predictions that chose it, once; return how many are left."""
    left = 0
    for k in range(n):
        same = -1
        for j in range(left):
            if boxes_overlap(seen[k], seen[j], 0.0):
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


@lean_kernel
def distance(comp, uv):
    """Return the squared distance in px^2 of a component's centre from uv (2,)."""
    dx = comp[col.SUM_X] / comp[col.WEIGHT] - uv[0]
    dy = comp[col.SUM_Y] / comp[col.WEIGHT] - uv[1]
    return dx * dx + dy * dy


@lean_kernel
def crowded_window(table, count, box):
    """Tell whether what is bright in a window (x0, x1, y0, y1) is more than a light and some specks."""
    if count < 0 or count > MOST_SEEN:
        return True
    for j in range(count):
        # from edge to edge, or large and cut off: a wall or a lamp, no light of a target
        wide = table[j, col.X_MAX] - table[j, col.X_MIN] + 1.0 >= box[1] - box[0]
        high = table[j, col.Y_MAX] - table[j, col.Y_MIN] + 1.0 >= box[3] - box[2]
        edge = table[j, col.X_MIN] <= box[0] or table[j, col.X_MAX] >= box[1] - 1
        edge = edge or table[j, col.Y_MIN] <= box[2] or table[j, col.Y_MAX] >= box[3] - 1
        if wide or high or (edge and table[j, col.AREA] > WIDE_SHARE * (box[1] - box[0]) * (box[3] - box[2])):
            return True
    return count == 0


@lean_kernel
def set_window(u, v, half, w, h, box):
    """Fill box (x0, x1, y0, y1; ends excluded) with the window about (u, v), cut at the image."""
    box[0] = max(int(u + 0.5) - half, 0)
    box[1] = min(int(u + 0.5) + half + 1, w)
    box[2] = max(int(v + 0.5) - half, 0)
    box[3] = min(int(v + 0.5) + half + 1, h)


@lean_kernel
def write_cut(comp, row):
    """Fill row (3,) with the centre of an area that reaches beyond its window, and why it is refused."""
    row[0] = comp[col.SUM_X] / comp[col.WEIGHT]
    row[1] = comp[col.SUM_Y] / comp[col.WEIGHT]
    row[2] = BEYOND


@kernel
def locate_near(image, mask, options, predicted, half):
    """Search windows of half width half around predicted (n, 2); return areas, state, survey, and (m, 3) those cut.

    OWNER is the prediction whose nearest area this is, or -1: a neighbour, seen but not asked for. An area that is
    nearest to two predictions belongs to the nearer one. Cut: nearest, but reaching beyond its window.
    """
    h, w = image.shape
    flip = np.uint8(options[col.O_FLIP])
    picture = Picture(image, flip, int(options[col.O_SATURATION]), mask)
    limits = BlobLimits(WINDOW_CONTRAST, options[col.O_MIN_PIXELS], options[col.O_MAX_RADIUS])
    survey = np.empty((col.SURVEY, col.GRID))
    thresholds = np.empty((col.GRID, col.GRID))
    margin, _, _ = survey_image(image, flip, mask, survey, thresholds)
    most = predicted.shape[0]
    seen, owner = np.empty((MOST_SEEN * most, col.COLUMNS)), np.empty(MOST_SEEN * most, np.int64)
    n = np.int64(0)
    table = np.empty((FEW_RUNS, col.COLUMNS))
    runs = np.empty((FEW_RUNS, 3), np.int32)
    parent = np.empty(FEW_RUNS, np.int32)
    marks = np.empty(2 * half + 1, np.uint8)
    automatic = options[col.O_THRESHOLD] < 0.0
    box = np.empty(4, np.int64)
    cut = np.empty((most, 3))
    n_cut = 0
    for k in range(most):
        u = predicted[k, 0]
        v = predicted[k, 1]
        if not (-0.5 <= u < w - 0.5 and -0.5 <= v < h - 0.5):
            continue
        set_window(u, v, half, w, h, box)
        level = options[col.O_THRESHOLD]
        if level < 0.0:
            level = thresholds[int(v + 0.5) * col.GRID // h, int(u + 0.5) * col.GRID // w]
        count = 0
        if level < min(picture.saturation, 255):
            count = connected_components_in_window(picture, int(level), box, automatic, runs, parent, table, marks)
        i = nearest(table, count, u, v, box, options, w, h, margin)
        # a threshold tells a light from its background, not from a bright room: there it is grown from its peak
        if automatic and crowded_window(table, count, box):
            if blob_near(picture, u, v, box, limits, seen[n]):
                if classify(seen[n], w, h, box, limits.min_pixels, limits.max_radius, margin) == BEYOND:
                    write_cut(seen[n], cut[n_cut])
                    n_cut += 1
                else:
                    owner[n] = k
                    n += 1
            continue
        for j in range(min(count, MOST_SEEN)):
            what = classify(table[j], w, h, box, limits.min_pixels, limits.max_radius, margin)
            if what == BEYOND and j == i:
                write_cut(table[i], cut[n_cut])
                n_cut += 1
            copy_to(table[j], seen[n])
            owner[n] = k if j == i and what != BEYOND else -1
            n += 1
    n = remove_duplicates(seen, owner, n, predicted)
    comps = np.empty((n, col.COLUMNS))
    state = np.zeros((n, col.STATE), np.int64)
    for i in range(n):
        copy_to(seen[i], comps[i])
        state[i, col.OWNER] = owner[i]
    unbounded_window(w, h, box)
    classify_areas(comps, state, options, w, h, box, margin)
    ring_background(image, flip, comps, survey, w, h)
    return comps, state, survey, cut[:n_cut].copy()


@kernel
def grow_near(image, mask, options, predicted, missed, half):
    """Return areas and state of the blobs nearest to those of predicted (n, 2) that missed (m,) numbers.

    As locate_near finds them in a crowded window: what is above the threshold there is a light and what it stands
    before, and the light alone is grown from its peak.
    """
    h, w = image.shape
    picture = Picture(image, np.uint8(options[col.O_FLIP]), int(options[col.O_SATURATION]), mask)
    limits = BlobLimits(WINDOW_CONTRAST, options[col.O_MIN_PIXELS], options[col.O_MAX_RADIUS])
    comps, state = np.empty((missed.size, col.COLUMNS)), np.zeros((missed.size, col.STATE), np.int64)
    box = np.empty(4, np.int64)
    n = np.int64(0)
    for k in missed:
        u = predicted[k, 0]
        v = predicted[k, 1]
        if not (-0.5 <= u < w - 0.5 and -0.5 <= v < h - 0.5):
            continue
        set_window(u, v, half, w, h, box)
        if blob_near(picture, u, v, box, limits, comps[n]):
            state[n, col.OWNER] = k
            state[n, col.STATUS] = classify(comps[n], w, h, box, limits.min_pixels, limits.max_radius, 0.0)
            n += 1
    return comps[:n].copy(), state[:n].copy()
