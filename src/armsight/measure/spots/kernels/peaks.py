"""Peaks of a pyramid's levels, from which blobs are grown, in the order of their strength."""

from __future__ import annotations

import numpy as np

from armsight._numba import kernel, lean_kernel

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
