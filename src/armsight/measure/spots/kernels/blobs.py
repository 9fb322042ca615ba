"""Blobs brighter than the annulus about them, whatever the level: each grown from a peak down to half its height."""

from __future__ import annotations

from math import pi, sqrt
from typing import Any, NamedTuple

import numpy as np

from armsight._numba import inner_kernel, kernel, lean_kernel
from armsight.measure.spots.kernels import columns as col
from armsight.measure.spots.kernels.columns import Picture, copy_to, insertion_sort
from armsight.measure.spots.kernels.peaks import MOST_PEAKS, nearest_peaks

RING = 4.5
"""Radius of the ring that tells a blob's background, in pixels of the pyramid's level on which its peak stands."""
TINY = 0.25
"""Share of its height at which a blob of fewer pixels than wanted is cut instead."""
REACH = 1.25
"""How far from its peak a blob may go, in radii of the ring."""
RING_SAMPLES = 24
RING_X = np.cos(2.0 * pi * np.arange(RING_SAMPLES) / RING_SAMPLES)
RING_Y = np.sin(2.0 * pi * np.arange(RING_SAMPLES) / RING_SAMPLES)
SHIFT, COLUMN = 20, (1 << 20) - 1
"""A pixel on the stack is its row, shifted, and its column: to part them takes no division."""
FEWEST_SAMPLES = 12
"""Ring samples within the image without which nothing is known of the background."""
BACKGROUND_SHARE = 0.75
"""Share of the ring that the background level lies above: a bright region may cover a quarter of it and more."""
MOST_ABOVE = RING_SAMPLES - int(BACKGROUND_SHARE * RING_SAMPLES)
"""Samples brighter than that from which on the level is brighter, however many of the ring are in the image."""
LEAST_FILL = 0.7
"""Area over that of the ellipse with the same second moments (1 for a filled ellipse): ragged blobs lie below."""
LEAST_AXES = 0.2
"""Ratio of the axes: below it is a line. A light that moves five of its widths within the exposure is still kept."""


class BlobLimits(NamedTuple):
    """Which blobs count: by contrast, least height above the ring (grey levels), min_pixels, max_radius (px)."""

    contrast: Any
    min_pixels: Any
    max_radius: Any


class Labels(NamedTuple):
    """Where blobs were grown: marks (rows, columns), the number of the last blob that took the pixel.

    left, top: column and row of the image that the first mark is of. stack: room for the pixels yet to be looked at.
    """

    marks: Any
    left: Any
    top: Any
    stack: Any


@lean_kernel
def ring_level(image, flip, x0, y0, radius, ring):
    """Fill ring with the sorted grey levels on a circle about (x0, y0); return how many lie within the image."""
    h, w = image.shape
    n = np.int64(0)
    for i in range(RING_SAMPLES):
        x = int(x0 + radius * RING_X[i] + 0.5)
        y = int(y0 + radius * RING_Y[i] + 0.5)
        if 0 <= x < w and 0 <= y < h:
            ring[n] = np.uint8(image[y, x] ^ flip)
            n += 1
    insertion_sort(ring, n)
    return n


@lean_kernel
def has_contrast(image, flip, x0, y0, radius, top, contrast):
    """Tell whether a peak of level top is `contrast` above the background that ring_level's samples tell (see blob_at).

    Most peaks do not, and need no sorted ring.
    """
    h, w = image.shape
    most = top - contrast
    n = 0
    above = 0
    if most < 0:
        return False
    for i in range(RING_SAMPLES):
        x = int(x0 + radius * RING_X[i] + 0.5)
        y = int(y0 + radius * RING_Y[i] + 0.5)
        if 0 <= x < w and 0 <= y < h:
            n += 1
            above += np.uint8(image[y, x] ^ flip) > most
            if above >= MOST_ABOVE:
                return False
    # the entry of the sorted ring that blob_at takes is below most if and only if more samples than its number are
    return n >= FEWEST_SAMPLES and n - above > min(int(BACKGROUND_SHARE * n), n - 1)


@lean_kernel
def grow_region(picture, x0, y0, level, reach, stamp, labels, row):
    """Fill row (COLUMNS,) with the sums of the pixels above level that hang together with (x0, y0) by their sides.

    Returns 0, or 1 where the blob reaches further than reach from (x0, y0), 2 where it meets the image's border.
    labels.marks gets stamp at every pixel that was looked at and belongs to it. Sums are weighted above level.
    """
    image, flip, saturation, mask = picture
    marks, left, top_row, stack = labels
    h, w = image.shape
    area = weight = sum_x = sum_y = peak = clipped = np.int64(0)  # whole numbers: their sums are exact
    x_min = x_max = x0
    y_min = y_max = y0
    stack[0] = (y0 << SHIFT) | x0
    marks[y0 - top_row, x0 - left] = stamp
    top = 1
    code = 0
    reach2 = reach * reach
    while top > 0:
        top -= 1
        y = stack[top] >> SHIFT
        x = stack[top] & COLUMN
        # beyond it the neighbours below would be read outside of the image
        if x < 1 or y < 1 or x > w - 2 or y > h - 2:
            code = 2
            break
        if (x - x0) ** 2 + (y - y0) ** 2 > reach2:
            code = 1
            break
        # unsigned: numbers that cannot be negative need no test for it
        i, j = np.uint64(y), np.uint64(x)
        grey = np.int64(np.uint8(image[i, j] ^ flip))
        v = grey - level
        area += 1
        weight += v
        sum_x += v * (x - x0)
        sum_y += v * (y - y0)
        peak = max(peak, grey)
        clipped += grey >= saturation
        x_min = min(x_min, x)
        x_max = max(x_max, x)
        y_min = min(y_min, y)
        y_max = max(y_max, y)
        for d in range(4):
            a = x + (1 if d == 0 else -1 if d == 1 else 0)
            b = y + (1 if d == 2 else -1 if d == 3 else 0)
            i, j = np.uint64(b), np.uint64(a)
            if np.uint8(image[i, j] ^ flip) <= level or marks[np.uint64(b - top_row), np.uint64(a - left)] == stamp:
                continue
            if mask.size == 0 or mask[i, j] != 0:
                marks[np.uint64(b - top_row), np.uint64(a - left)] = stamp
                stack[top] = (b << SHIFT) | a
                top += 1
    row[col.AREA], row[col.WEIGHT], row[col.PEAK], row[col.CLIPPED] = area, weight, peak, clipped
    row[col.SUM_X], row[col.SUM_Y] = sum_x + weight * x0, sum_y + weight * y0
    row[col.X_MIN], row[col.X_MAX], row[col.Y_MIN], row[col.Y_MAX] = x_min, x_max, y_min, y_max
    row[col.LEVEL], row[col.BACKGROUND], row[col.SLOPE] = level, 0.0, 0.0
    return code


@lean_kernel
def roundness(labels, stamp, row):
    """Return fill times ratio of the axes of a blob (1 for a filled circle), 0 where it is a line or ragged."""
    marks, left, top, _ = labels
    count = sum_x = sum_y = sum_xx = sum_xy = sum_yy = np.int64(0)
    first, last = np.int64(row[col.X_MIN]) - left, np.int64(row[col.X_MAX]) - left
    for y in range(np.int64(row[col.Y_MAX]) - np.int64(row[col.Y_MIN]) + 1):
        line = np.uint64(np.int64(row[col.Y_MIN]) - top + y)
        for x in range(last - first + 1):
            if marks[line, np.uint64(first + x)] == stamp:
                count += 1
                sum_x += x
                sum_y += y
                sum_xx += x * x
                sum_xy += x * y
                sum_yy += y * y
    n = float(count)
    sx = sum_x / n
    sy = sum_y / n
    # a pixel has a second moment of its own: one row of pixels is not without width
    xx = sum_xx / n - sx * sx + 1.0 / 12.0
    xy = sum_xy / n - sx * sy
    yy = sum_yy / n - sy * sy + 1.0 / 12.0
    mean = 0.5 * (xx + yy)
    root = sqrt(0.25 * (xx - yy) ** 2 + xy * xy)
    low = max(mean - root, 1e-3)
    # an ellipse of half axes a, b has second moments a^2 / 4, b^2 / 4 and the area pi a b = 4 pi sqrt(det)
    fill = n / (4.0 * pi * sqrt(low * (mean + root)))
    axes = sqrt(low / (mean + root))
    return fill * axes if axes > LEAST_AXES and fill > LEAST_FILL else 0.0


@lean_kernel
def brightest_near(image, flip, x0, y0, r):
    """Return place and level of the brightest pixel within r of (x0, y0) along each axis, the nearest of equals."""
    h, w = image.shape
    left = np.uint64(max(x0 - r, 0))
    wide = min(x0 + r + 1, w) - max(x0 - r, 0)
    best = -1
    least = 0
    bx = x0
    by = y0
    for y in range(max(y0 - r, 0), min(y0 + r + 1, h)):
        # a first pass in vector code: most rows hold nothing as bright as what was found
        top = np.uint8(0)
        row = np.uint64(y)
        for i in range(wide):
            top = max(top, np.uint8(image[row, left + np.uint64(i)] ^ flip))
        if int(top) < best:
            continue
        for i in range(wide):
            if np.uint8(image[row, left + np.uint64(i)] ^ flip) != top:
                continue
            x = int(left) + i
            away = (x - x0) ** 2 + (y - y0) ** 2
            if int(top) > best or away < least:
                best = int(top)
                least = away
                bx = x
                by = y
    return bx, by, best


@lean_kernel
def find_duplicate(table, n, row):
    """Return which of the n blobs has its centre within half the larger one's radius of row's; -1 for none."""
    x = row[col.SUM_X] / row[col.WEIGHT]
    y = row[col.SUM_Y] / row[col.WEIGHT]
    for k in range(n):
        dx = table[k, col.SUM_X] / table[k, col.WEIGHT] - x
        dy = table[k, col.SUM_Y] / table[k, col.WEIGHT] - y
        # half of the radius, squared, of a disc of the larger one's area
        if dx * dx + dy * dy < max(table[k, col.AREA], row[col.AREA]) * (0.25 / pi):
            return k
    return -1


@lean_kernel
def blob_at(picture, x, y, top, radius, limits, stamp, labels, ring, row):
    """Fill row (COLUMNS,) with the blob of the peak at (x, y); return its roundness, 0 where it is none.

    It is cut at half its height above the ring of the given radius; one of a pixel or two, lower.
    """
    if not has_contrast(picture.grey, picture.flip, x, y, radius, top, limits.contrast):
        return 0.0
    count = ring_level(picture.grey, picture.flip, x, y, radius, ring)
    background = ring[min(int(BACKGROUND_SHARE * count), count - 1)]
    level = int(0.5 * (top + background))
    reach = min(REACH * radius, 2.0 * limits.max_radius)
    code = grow_region(picture, x, y, level, reach, stamp, labels, row)
    if code == 0 and row[col.AREA] < limits.min_pixels:
        level = int(TINY * top + (1.0 - TINY) * background)
        # the first cut's marks stay: with a stamp of its own the second one does not take them for its pixels
        code = grow_region(picture, x, y, level, reach, -stamp, labels, row)
        stamp = -stamp
    if code != 0 or row[col.AREA] < limits.min_pixels:
        return 0.0
    row[col.BACKGROUND] = background
    row[col.SLOPE] = (ring[(3 * count) // 4] - ring[count // 4]) / radius
    return roundness(labels, stamp, row)


@kernel
def grow_blobs(picture, peaks, limits, table, work):
    """Fill table (.., COLUMNS) with the blobs of peaks (n, 3: x, y, scale), strongest first.

    picture, limits: as Picture, BlobLimits. Returns how many blobs, how many peaks were looked at, and how many pixels
    were grown over. work: pixels to grow over at most.
    """
    picture, limits = Picture(*picture), BlobLimits(*limits)
    image, flip, _, mask = picture
    max_radius = limits.max_radius
    marks = np.zeros(image.shape, np.int32)
    taken = np.zeros(peaks.shape[0] + 1, np.uint8)
    score = np.zeros(table.shape[0] + 1)
    widest = 1.0
    for k in range(peaks.shape[0]):
        widest = max(widest, REACH * RING * peaks[k, 2])
    labels = Labels(marks, np.int64(0), np.int64(0), np.empty(int((2.0 * widest + 4.0) ** 2), np.int64))
    ring = np.empty(RING_SAMPLES)
    row = np.empty(col.COLUMNS)
    n = np.int64(0)
    spent = np.int64(0)
    looked = np.int64(0)
    for k in range(peaks.shape[0]):
        if n == table.shape[0] or spent > work:
            break
        looked += 1
        x, y, top = brightest_near(image, flip, peaks[k, 0], peaks[k, 1], peaks[k, 2])
        # a pixel of a blob that was kept: the same light, found on another level
        if taken[abs(marks[y, x])] or (mask.size > 0 and mask[y, x] == 0):
            continue
        row[col.AREA] = 0.0
        fine = blob_at(picture, x, y, top, RING * peaks[k, 2], limits, k + 1, labels, ring, row)
        spent += int(row[col.AREA])
        if fine == 0.0 or max(row[col.X_MAX] - row[col.X_MIN], row[col.Y_MAX] - row[col.Y_MIN]) > 2.0 * max_radius:
            continue
        taken[k + 1] = 1
        same = find_duplicate(table, n, row)
        at = n if same < 0 else same
        if fine > score[at]:
            copy_to(row, table[at])
            score[at] = fine
        if same < 0:
            n += 1
    return n, looked, spent


@inner_kernel
def blob_near(picture, u, v, box, limits, row):
    """Fill row (COLUMNS,) with the blob nearest to (u, v) whose peak lies in box (x0, x1, y0, y1); False for none."""
    ring = np.empty(RING_SAMPLES)
    at = np.empty((MOST_PEAKS, 2), np.int64)
    n = nearest_peaks(picture, u, v, box, limits.contrast, at)
    reach = np.int64(0)
    marks = np.zeros((0, 0), np.int32)
    stack = np.empty(0, np.int64)
    stamp = np.int64(0)
    for k in range(n):
        x = at[k, 0]
        y = at[k, 1]
        top = int(np.uint8(picture.grey[y, x] ^ picture.flip))
        scale = np.int64(2)
        # from small to large: the light before what it stands in
        while scale <= max(0.5 * limits.max_radius, 2.0):
            stamp += 1
            if reach < REACH * RING * scale:  # marks of what such a blob may cover about its peak
                reach = np.int64(REACH * RING * scale) + 1
                marks = np.zeros((2 * reach + 3, 2 * reach + 3), np.int32)
                stack = np.empty(marks.size, np.int64)
            labels = Labels(marks, x - reach - 1, y - reach - 1, stack)
            if blob_at(picture, x, y, top, RING * scale, limits, stamp, labels, ring, row) > 0.0:
                return True
            scale *= 2
    return False
