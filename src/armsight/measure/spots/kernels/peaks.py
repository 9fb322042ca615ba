"""Peaks from which blobs are grown: of a pyramid's levels, in the order of their strength, and of a window."""

from __future__ import annotations

from math import ceil

import numpy as np

from armsight._numba import inner_kernel, kernel, lean_kernel

STRETCH = 64
"""Pixels that are passed over together where none of them is a peak."""


@lean_kernel
def count_peaks(step, highest, least, at, n):
    """Return how many of n pixels from `at` (unsigned, for vector code) are peaks: see add_peaks."""
    count = np.uint8(0)
    for i in range(n):
        height = step[at + np.uint64(i)]
        count += np.uint8(height >= least) & np.uint8(height >= highest[at + np.uint64(i)])
    return count


@kernel
def add_peaks(step, highest, least, scale, shape, found):
    """Return found (n, 4: x, y, scale, height), followed by the peaks of step (h, w) in the order of reading.

    step: heights of a level's pixels above what is round them, each pixel of `scale` px of an image of that shape;
    highest (h, w): of a pixel and its neighbours. A peak is at least `least` (a byte) high, and no neighbour higher.
    """
    h, w = step.shape
    flat, around = step.reshape(-1), highest.reshape(-1)
    n = found.shape[0]
    room = np.empty((n + h * w, 4), np.int64)
    room[:n] = found
    for first in range(0, h * w, STRETCH):
        left = count_peaks(flat, around, least, np.uint64(first), min(STRETCH, h * w - first))
        i = first
        while left:
            if flat[i] >= least and flat[i] >= around[i]:
                y = i // w
                room[n, 0] = min((i - y * w) * scale + scale // 2, shape[1] - 1)
                room[n, 1] = min(y * scale + scale // 2, shape[0] - 1)
                room[n, 2] = scale
                room[n, 3] = flat[i]
                n += 1
                left -= 1
            i += 1
    return room[:n].copy()


@kernel
def strongest_first(found):
    """Return found (n, 4: x, y, scale, height) without the heights, highest first, equal ones in their order."""
    start = np.zeros(257, np.int64)
    for k in range(found.shape[0]):
        start[256 - found[k, 3]] += 1  # counted behind the place of its height
    for height in range(1, 257):
        start[height] += start[height - 1]
    out = np.empty((found.shape[0], 3), np.int64)
    for k in range(found.shape[0]):
        place = start[255 - found[k, 3]]
        start[255 - found[k, 3]] += 1
        for c in range(3):
            out[place, c] = found[k, c]
    return out


PEAK_PX = 2
MOST_PEAKS = 24
"""Peaks looked at in a window, the nearest to the prediction first."""


@lean_kernel
def is_peak(image, flip, x, y, grey):
    """Tell whether no pixel within two of (x, y) is brighter, nor as bright and earlier in reading order."""
    h, w = image.shape
    for b in range(max(y - PEAK_PX, 0), min(y + PEAK_PX + 1, h)):
        for a in range(max(x - PEAK_PX, 0), min(x + PEAK_PX + 1, w)):
            other = np.uint8(image[b, a] ^ flip)
            # of equal ones the first in reading order alone is a peak
            if other > grey or (other == grey and (b < y or (b == y and a < x))):
                return False
    return True


@lean_kernel
def darkest_of_every_other(image, flip, box):
    """Return the lowest grey level of every other row and column of box: enough where no light lifts it everywhere."""
    left = np.uint64(box[0])
    least = np.uint8(255)
    for y in range(box[2], box[3], 2):
        row = np.uint64(y)
        for i in range((box[1] - box[0] + 1) // 2):
            least = min(least, np.uint8(image[row, left + np.uint64(2 * i)] ^ flip))
    return int(least)


@lean_kernel
def mark_tops(image, flip, y, first, least, marks):
    """Fill marks (n,) with 1 where a pixel of row y, from column first on, may be a peak of `least` or more (is_peak).

    Its neighbours along the row and the column are looked at, in vector code; at the image's edge nothing is told.
    """
    h, w = image.shape
    n = marks.shape[0]
    row, above, below = np.uint64(y), np.uint64(max(y - 1, 0)), np.uint64(min(y + 1, h - 1))
    inner = np.int64(first == 0)
    last = n - np.int64(first + n == w)
    marks[0] = marks[n - 1] = 1
    at = np.uint64(first)
    for i in range(inner, last):
        x = at + np.uint64(i)
        grey = np.uint8(image[row, x] ^ flip)
        up = np.uint8(image[above, x] ^ flip)
        down = np.uint8(image[below, x] ^ flip)
        before = np.uint8(image[row, x - np.uint64(1)] ^ flip)
        after = np.uint8(image[row, x + np.uint64(1)] ^ flip)
        marks[i] = (grey >= least) & (grey >= up) & (grey >= down) & (grey > before) & (grey >= after)


@inner_kernel
def nearest_peaks(picture, u, v, box, contrast, at):
    """Fill at (MOST_PEAKS, 2) with the peaks x, y in box (x0, x1, y0, y1), nearest to (u, v) first; return how many."""
    image, flip = picture.grey, picture.flip
    away = np.empty(MOST_PEAKS)
    marks = np.empty(box[1] - box[0], np.uint8)
    n = np.int64(0)
    least = ceil(darkest_of_every_other(image, flip, box) + contrast)
    if least > 255:
        return n
    for y in range(box[2], box[3]):
        mark_tops(image, flip, y, box[0], np.uint8(least), marks)
        for i in range(marks.shape[0]):
            if marks[i] == 0:
                continue
            x = box[0] + i
            grey = np.uint8(image[y, x] ^ flip)
            if grey < least or not is_peak(image, flip, x, y, grey):
                continue
            d = (x - u) ** 2 + (y - v) ** 2
            k = int(n) if n < MOST_PEAKS else MOST_PEAKS - 1
            if n == MOST_PEAKS and d >= away[k]:
                continue
            while k > 0 and away[k - 1] > d:
                away[k] = away[k - 1]
                at[k, 0] = at[k - 1, 0]
                at[k, 1] = at[k - 1, 1]
                k -= 1
            away[k] = d
            at[k, 0] = x
            at[k, 1] = y
            n = n + 1 if n < MOST_PEAKS else n
    return n


# Seeds found by a cross in a binary image and propagated over their shapes (Pachidis 2005, figure 6).

COLUMNS = 7  # of a shape: pixels, sum of u, sum of v, sum of u^2 + v^2, brightest, cut by the border, too large


@lean_kernel
def is_light(image, mask, threshold, inverted, r, c):
    """Whether a pixel belongs to a shape: brighter than the threshold, inverted where asked, inside the mask."""
    grey = 255 - image[r, c] if inverted else image[r, c]
    return grey > threshold and (mask.size == 0 or mask[r, c] != 0)


@lean_kernel
def is_seed(image, mask, threshold, inverted, r, c, arm):
    """Whether all pixels of the cross about (r, c) are light, arm to either side; the cross lies inside the image."""
    for k in range(-arm, arm + 1):
        if not is_light(image, mask, threshold, inverted, r + k, c):
            return False
        if not is_light(image, mask, threshold, inverted, r, c + k):
            return False
    return True


@lean_kernel
def propagate(image, mask, threshold, inverted, r, c, taken, stack, most, out):
    """Fill out (COLUMNS,) with the sums of the shape that (r, c) belongs to; mark its pixels as taken."""
    h, w = image.shape
    out[:] = 0.0
    stack[0, 0], stack[0, 1] = r, c
    taken[r, c] = 1
    top = 1
    while top > 0:
        top -= 1
        y, x = stack[top, 0], stack[top, 1]
        grey = 255 - image[y, x] if inverted else image[y, x]
        out[0] += 1.0
        out[1] += x
        out[2] += y
        out[3] += x * x + y * y
        out[4] = max(out[4], grey)
        if y == 0 or x == 0 or y == h - 1 or x == w - 1:
            out[5] = 1.0
        for dy in range(-1, 2):
            for dx in range(-1, 2):
                v, u = y + dy, x + dx
                if v < 0 or u < 0 or v >= h or u >= w or taken[v, u]:
                    continue
                if is_light(image, mask, threshold, inverted, v, u):
                    taken[v, u] = 1
                    if top < stack.shape[0]:
                        stack[top, 0], stack[top, 1] = v, u
                        top += 1
    out[6] = 1.0 if out[0] > most else 0.0


@kernel
def shapes(image, mask, threshold, inverted, arm, most, room):
    """Return the shapes (n, COLUMNS) in which a cross fits, its arms so many pixels long."""
    h, w = image.shape
    taken = np.zeros((h, w), np.uint8)
    stack = np.empty((h * w // 4 + 64, 2), np.int32)
    found = np.empty((room, COLUMNS))
    n = 0
    for r in range(arm, h - arm):
        for c in range(arm, w - arm):
            grey = 255 - image[r, c] if inverted else image[r, c]
            if grey <= threshold or taken[r, c] or n == room:
                continue
            if is_seed(image, mask, threshold, inverted, r, c, arm):
                propagate(image, mask, threshold, inverted, r, c, taken, stack, most, found[n])
                n += 1
    return found[:n]
