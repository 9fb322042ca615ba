"""A beacon of a given colour: coarse-to-fine search over a BGR image, and the colour's centroid."""

from __future__ import annotations

import numpy as np

from armsight.measure.spots.kernels.compiled import kernel
from armsight.measure.spots.kernels.scan import (
    AREA,
    CLIPPED,
    LEVEL,
    PEAK,
    SUM_X,
    SUM_Y,
    WEIGHT,
    X_MAX,
    X_MIN,
    Y_MAX,
    Y_MIN,
)

COARSEST = 16
"""Step in px of the first grid; it is halved down to FINEST, and a region found on a coarse grid is not met again."""
FINEST = 2
MOST_PIXELS = 20000
"""Pixels after which a region is not followed any further: it is far too large for a beacon."""

# a colour as the kernels see it: hue from, to (degrees, wrapping), least saturation (0..1), least value (0..255)
HUE_FROM, HUE_TO, LEAST_SATURATION, LEAST_VALUE = range(4)


@kernel
def matches(b, g, r, colour):
    """Tell whether a pixel of integer channels lies within the colour (hue, saturation and value as usual in HSV)."""
    high = max(max(b, g), r)
    spread = high - min(min(b, g), r)
    if high < colour[LEAST_VALUE] or spread <= 0 or spread < colour[LEAST_SATURATION] * high:
        return False
    if high == r:
        hue = 60.0 * (g - b) / spread
    elif high == g:
        hue = 120.0 + 60.0 * (b - r) / spread
    else:
        hue = 240.0 + 60.0 * (r - g) / spread
    if hue < 0.0:
        hue += 360.0
    if colour[HUE_FROM] <= colour[HUE_TO]:
        return colour[HUE_FROM] <= hue <= colour[HUE_TO]
    return hue >= colour[HUE_FROM] or hue <= colour[HUE_TO]


@kernel
def is_coloured(image, mask, colour, y, x):
    """Tell whether the pixel lies within the colour and the mask."""
    if mask.size > 0 and mask[y, x] == 0:
        return False
    return matches(np.int64(image[y, x, 0]), np.int64(image[y, x, 1]), np.int64(image[y, x, 2]), colour)


@kernel
def grow(image, mask, colour, seen, y, x, queue, row):
    """Follow the region of the colour from (x, y); mark it in seen and write its area, sums and bounds into row."""
    h, w = seen.shape
    row[AREA] = 0.0
    row[SUM_X] = 0.0
    row[SUM_Y] = 0.0
    row[X_MIN] = x
    row[X_MAX] = x
    row[Y_MIN] = y
    row[Y_MAX] = y
    queue[0] = y * w + x
    seen[y, x] = 1
    head = 0
    tail = 1
    while head < tail:
        y = queue[head] // w
        x = queue[head] - y * w
        head += 1
        row[AREA] += 1.0
        row[SUM_X] += x
        row[SUM_Y] += y
        row[X_MIN] = min(row[X_MIN], x)
        row[X_MAX] = max(row[X_MAX], x)
        row[Y_MIN] = min(row[Y_MIN], y)
        row[Y_MAX] = max(row[Y_MAX], y)
        for b in range(max(y - 1, 0), min(y + 2, h)):
            for a in range(max(x - 1, 0), min(x + 2, w)):
                if seen[b, a] == 0 and tail < queue.shape[0] and is_coloured(image, mask, colour, b, a):
                    seen[b, a] = 1
                    queue[tail] = b * w + a
                    tail += 1
    row[WEIGHT] = row[AREA]
    row[PEAK] = 0.0
    row[CLIPPED] = 0.0
    row[LEVEL] = 0.0


@kernel
def coloured_regions(image, mask, colour, table):
    """Fill table (.., COLUMNS) with the regions of a colour in image (h, w, 3); return how many.

    Grids of 16, 8, 4 and 2 px are searched in turn, each at the points that the coarser ones left out, and every
    point of the colour is followed to its region.
    """
    h, w = image.shape[0], image.shape[1]
    seen = np.zeros((h, w), np.uint8)
    queue = np.empty(MOST_PIXELS, np.int64)
    n = np.int64(0)
    step = COARSEST
    while step >= FINEST:
        for y in range(0, h, step):
            known = step < COARSEST and y % (2 * step) == 0
            for x in range(step if known else 0, w, 2 * step if known else step):
                if seen[y, x] == 0 and is_coloured(image, mask, colour, y, x):
                    grow(image, mask, colour, seen, y, x, queue, table[n])
                    n += 1
                    if n == table.shape[0]:
                        return n
        step //= 2
    return n


@kernel
def colour_centroid(image, mask, colour, signal, floor, x0, y0, noise, out):
    """Write centre u, v, covariance uu, uv, vv and peak (6,) of the colour's pixels, weighted with signal above floor.

    signal (ny, nx) belongs to the image's pixels from (x0, y0). The covariance holds the signal's noise, and at the
    region's rim the doubt whether a pixel belongs to it (a variance of 1/4 of its weight squared).
    """
    ny, nx = signal.shape
    inside = np.zeros((ny + 2, nx + 2), np.uint8)
    total = 0.0
    out[0] = 0.0
    out[1] = 0.0
    out[5] = 0.0
    for j in range(ny):
        for i in range(nx):
            if is_coloured(image, mask, colour, y0 + j, x0 + i):
                inside[j + 1, i + 1] = 1
                s = max(float(signal[j, i]) - floor, 0.0)
                total += s
                out[0] += s * (x0 + i)
                out[1] += s * (y0 + j)
                out[5] = max(out[5], s)
    if total <= 0.0:
        return False
    out[0] /= total
    out[1] /= total
    out[2] = 0.0
    out[3] = 0.0
    out[4] = 0.0
    for j in range(ny):
        for i in range(nx):
            around = 0
            for b in range(3):
                for a in range(3):
                    around += inside[j + b, i + a]
            if around == 0 or (inside[j + 1, i + 1] == 0 and around < 3):
                continue
            variance = noise * inside[j + 1, i + 1]
            if around < 9:
                variance += 0.25 * (float(signal[j, i]) - floor) ** 2
            dx = x0 + i - out[0]
            dy = y0 + j - out[1]
            out[2] += variance * dx * dx
            out[3] += variance * dx * dy
            out[4] += variance * dy * dy
    for k in range(2, 5):
        out[k] /= total * total
    return True
