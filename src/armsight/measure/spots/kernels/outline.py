"""The outline of one light as it is in the image, whatever model measured it: its area and second moments.

Lights of one target are compared by it (poses/kernels/hidden.py): an edge before one takes from it in one direction.
Between the pixels' centres the image is taken as bilinear: pixels counted whole sample an outline by chance, and of
whole lights of composites made radii differ by twice as much (median of 0.06 px in place of 0.023).
"""

from __future__ import annotations

from math import pi

import numpy as np

from armsight._numba import lean_kernel

AREA, XX, XY, YY, EDGE_X, EDGE_Y = range(6)
MOMENTS, OUTLINE = 4, 6
"""Area and second moments (px^2), then which way and by which share of the light's height what is behind it changes:
0.64 of its step where an edge runs through the light's middle."""
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


@lean_kernel
def level_at(image, flip, y, x):
    """Return the sum of a pixel's channels."""
    total = 0.0
    for c in range(image.shape[2]):
        total += float(image[y, x, c] ^ flip)
    return total


@lean_kernel
def look_around(image, flip, u, v, radius, ring, out):
    """Return the median level on a circle about (u, v), negative where too little of it is within the image.

    Fills out[EDGE_X], out[EDGE_Y] with the levels' change across the circle, 0 where not all of it is within.
    """
    n = 0
    out[EDGE_X] = 0.0
    out[EDGE_Y] = 0.0
    for k in range(RING):
        x = int(u + radius * COS[k] + 0.5)
        y = int(v + radius * SIN[k] + 0.5)
        if 0 <= x < image.shape[1] and 0 <= y < image.shape[0]:
            level = level_at(image, flip, y, x)
            # first Fourier coefficient: a step across the middle gives 2 / pi of its height
            out[EDGE_X] += level * COS[k] * (2.0 / RING)
            out[EDGE_Y] += level * SIN[k] * (2.0 / RING)
            i = n
            while i > 0 and ring[i - 1] > level:
                ring[i] = ring[i - 1]
                i -= 1
            ring[i] = level
            n += 1
    if n < RING:
        out[EDGE_X] = 0.0
        out[EDGE_Y] = 0.0
    return ring[n // 2] if n >= FEWEST else -1.0


@lean_kernel
def share_of(weight):
    """Return a weight between 0 and 1."""
    if weight < 0.0:
        return 0.0
    return 1.0 if weight > 1.0 else weight


@lean_kernel
def add_row(image, flip, y, u, v, first, last, low, scale, sums):
    """Add the pixels first..last of a row, by quarters, to sums (6,): weight, and times x, y, xx, xy, yy about (u, v).

    scale: weight per level above low, of levels that are bilinear between the pixels' centres. All has to be a pixel
    or more within the image.
    """
    per = scale / 16.0
    zero = low * scale
    before = level_at(image, flip, y, first - 1)
    left_up = 3.0 * before + level_at(image, flip, y - 1, first - 1)
    left_down = 3.0 * before + level_at(image, flip, y + 1, first - 1)
    here = level_at(image, flip, y, first)
    up = 3.0 * here + level_at(image, flip, y - 1, first)
    down = 3.0 * here + level_at(image, flip, y + 1, first)
    all_ = 0.0  # sums of the row in quarters, y about its middle in quarters of a pixel
    sum_x = 0.0
    sum_y = 0.0
    sum_xx = 0.0
    sum_xy = 0.0
    for x in range(first, last + 1):
        after = level_at(image, flip, y, x + 1)
        right_up = 3.0 * after + level_at(image, flip, y - 1, x + 1)
        right_down = 3.0 * after + level_at(image, flip, y + 1, x + 1)
        # bilinear in the middle of each quarter: weights 9, 3, 3, 1 of the four pixels about it, of 16
        a = share_of((3.0 * up + left_up) * per - zero)
        b = share_of((3.0 * up + right_up) * per - zero)
        c = share_of((3.0 * down + left_down) * per - zero)
        d = share_of((3.0 * down + right_down) * per - zero)
        dx = x - u
        w = a + b + c + d
        wx = 0.25 * (b + d - a - c)
        wy = c + d - a - b
        all_ += w
        sum_x += w * dx + wx
        sum_y += wy
        sum_xx += (w * dx + 2.0 * wx) * dx
        sum_xy += wy * dx + 0.25 * (a + d - b - c)
        left_up = up
        left_down = down
        up = right_up
        down = right_down
    dy = y - v
    sums[0] += 0.25 * all_
    sums[1] += 0.25 * sum_x
    sums[2] += 0.25 * (all_ * dy + 0.25 * sum_y)
    sums[3] += 0.25 * (sum_xx + 0.0625 * all_)
    sums[4] += 0.25 * (sum_x * dy + 0.25 * sum_xy)
    sums[5] += 0.25 * (all_ * dy * dy + 0.5 * sum_y * dy + 0.0625 * all_)


@lean_kernel
def add_light(image, flip, u, v, low, scale, far, sums):
    """Add the pixels above low that hang together with the one at (u, v), and 1 px all round, to sums (6,)."""
    h = image.shape[0] - 1
    w = image.shape[1] - 1
    x0 = int(u + 0.5)
    y0 = int(v + 0.5)
    middle_first = x0
    middle_last = x0
    for way in range(2):  # down from the centre's row, then up from the one above it
        first = middle_first
        last = middle_last
        y = y0 - way
        while 0 < y < h and abs(y - y0) <= far:
            before = max(first - 1, 1)
            after = min(last + 1, w - 1)
            while first <= last and level_at(image, flip, y, first) <= low:
                first += 1
            if first > last:
                add_row(image, flip, y, u, v, before, after, low, scale, sums)
                break
            while level_at(image, flip, y, last) <= low:
                last -= 1
            while first > 1 and x0 - first < far and level_at(image, flip, y, first - 1) > low:
                first -= 1
            while last < w - 1 and last - x0 < far and level_at(image, flip, y, last + 1) > low:
                last += 1
            if y == y0:
                middle_first = first
                middle_last = last
            add_row(image, flip, y, u, v, max(first - 1, 1), min(last + 1, w - 1), low, scale, sums)
            y += 1 - 2 * way


@lean_kernel
def outline(image, flip, u, v, size, work, out):
    """Fill out (OUTLINE,) for the light at (u, v) in image (h, w, c): its rows of pixels that hang together.

    size: its radius or sigma, for the ring and as a bound. work (2, RING). AREA is 0 where it cannot be told,
    negative where there is no light in its middle.
    """
    out[AREA] = 0.0
    x0 = int(u + 0.5)
    y0 = int(v + 0.5)
    if x0 < 2 or y0 < 2 or x0 > image.shape[1] - 3 or y0 > image.shape[0] - 3:
        return
    # of nine pixels: the centre lies between them, and the nearest one may be clipped or darker by chance
    top = 0.0
    for y in range(y0 - 1, y0 + 2):
        for x in range(x0 - 1, x0 + 2):
            top = max(top, level_at(image, flip, y, x))
    background = look_around(image, flip, u, v, RING_SIZES * size + RING_PX, work[0], out)
    if background < 0.0 or top - background < LEAST_HEIGHT * image.shape[2]:
        return
    out[EDGE_X] /= top - background
    out[EDGE_Y] /= top - background
    low = background + LOW * (top - background)
    sums = work[1]
    sums[:6] = 0.0
    if level_at(image, flip, y0, x0) > low or level_at(image, flip, y0 - 1, x0) > low:
        add_light(image, flip, u, v, low, 1.0 / ((HIGH - LOW) * (top - background)), int(3.0 * size + 8.0), sums)
    total = sums[0]
    # something is bright there, but does not hang together with the middle
    if not total > 0.0:
        out[AREA] = -1.0
        return
    x = sums[1] / total
    y_ = sums[2] / total
    out[AREA] = total
    out[XX] = max(sums[3] / total - x * x, LEAST_MOMENT)
    out[XY] = sums[4] / total - x * y_
    out[YY] = max(sums[5] / total - y_ * y_, LEAST_MOMENT)
