"""The outline of one light as it is in the image, whatever model measured it: its area and second moments.

Lights of one target are compared by it (poses/kernels/hidden.py): an edge before one takes from it in one direction.
"""

from __future__ import annotations

from math import pi

import numpy as np

from armsight._numba import inner_kernel

AREA, XX, XY, YY = range(4)
OUTLINE = 4
LOW, HIGH = 0.45, 0.8
"""Shares of a light's height between which a pixel's weight rises from none to all. Lower ones take in what is bright
behind a light before a room, higher ones hang on fewer pixels."""
RING = 16
COS = np.cos(2.0 * pi * np.arange(RING) / RING)
SIN = np.sin(2.0 * pi * np.arange(RING) / RING)
RING_SIZES = 2.0
RING_PX = 4.0
"""Radius of the ring that tells the background: in sizes of the light, and a part of its own."""
FEWEST = 8
LEAST_HEIGHT = 3.0
"""Grey levels above its ring below which a light has no outline to speak of."""
LEAST_MOMENT = 0.05


@inner_kernel
def level_at(image, flip, y, x):
    """Return the sum of a pixel's channels."""
    total = 0.0
    for c in range(image.shape[2]):
        total += float(image[y, x, c] ^ flip)
    return total


@inner_kernel
def ring_median(image, flip, u, v, radius, ring):
    """Return the median level on a circle about (u, v); negative where too little of it is within the image."""
    n = 0
    for k in range(RING):
        x = int(u + radius * COS[k] + 0.5)
        y = int(v + radius * SIN[k] + 0.5)
        if 0 <= x < image.shape[1] and 0 <= y < image.shape[0]:
            level = level_at(image, flip, y, x)
            i = n
            while i > 0 and ring[i - 1] > level:
                ring[i] = ring[i - 1]
                i -= 1
            ring[i] = level
            n += 1
    return ring[n // 2] if n >= FEWEST else -1.0


@inner_kernel
def add_row(image, flip, y, u, v, first, last, low, scale, sums):
    """Add the pixels first..last of a row to sums (6,): weight, and times x, y, xx, xy, yy about (u, v).

    scale: weight per level above low.
    """
    dy = y - v
    for x in range(first, last + 1):
        w = min((level_at(image, flip, y, x) - low) * scale, 1.0)
        if w > 0.0:
            dx = x - u
            sums[0] += w
            sums[1] += w * dx
            sums[2] += w * dy
            sums[3] += w * dx * dx
            sums[4] += w * dx * dy
            sums[5] += w * dy * dy


@inner_kernel
def outline(image, flip, u, v, size, work, out):
    """Fill out (OUTLINE,) for the light at (u, v) in image (h, w, c): its rows of pixels that hang together.

    size: its radius or sigma, for the ring and as a bound. work (2, RING). AREA is 0 where it cannot be told,
    negative where there is no light in its middle.
    """
    out[AREA] = 0.0
    h = image.shape[0]
    w = image.shape[1]
    x0 = int(u + 0.5)
    y0 = int(v + 0.5)
    if x0 < 1 or y0 < 1 or x0 > w - 2 or y0 > h - 2:
        return
    top = 0.0
    for y in range(y0 - 1, y0 + 2):
        for x in range(x0 - 1, x0 + 2):
            top = max(top, level_at(image, flip, y, x))
    background = ring_median(image, flip, u, v, RING_SIZES * size + RING_PX, work[0])
    if background < 0.0 or top - background < LEAST_HEIGHT * image.shape[2]:
        return
    low = background + LOW * (top - background)
    scale = 1.0 / ((HIGH - LOW) * (top - background))
    far = int(3.0 * size + 8.0)
    sums = work[1]
    sums[:6] = 0.0
    middle_first = x0
    middle_last = x0
    for way in range(2):  # down from the centre's row, then up from the one above it
        first = middle_first
        last = middle_last
        y = y0 - way
        while 0 <= y < h and abs(y - y0) <= far:
            while first <= last and level_at(image, flip, y, first) <= low:
                first += 1
            if first > last:
                break
            while level_at(image, flip, y, last) <= low:
                last -= 1
            while first > 0 and x0 - first < far and level_at(image, flip, y, first - 1) > low:
                first -= 1
            while last < w - 1 and last - x0 < far and level_at(image, flip, y, last + 1) > low:
                last += 1
            if y == y0:
                middle_first = first
                middle_last = last
            add_row(image, flip, y, u, v, first, last, low, scale, sums)
            y += 1 - 2 * way
    total = sums[0]
    if not total > 0.0:
        out[AREA] = -1.0
        return
    x = sums[1] / total
    y_ = sums[2] / total
    out[AREA] = total
    out[XX] = max(sums[3] / total - x * x, LEAST_MOMENT)
    out[XY] = sums[4] / total - x * y_
    out[YY] = max(sums[5] / total - y_ * y_, LEAST_MOMENT)
