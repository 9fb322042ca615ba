"""Compiled: seeds found by a cross in a binary image and propagated over their shapes (Pachidis 2005, figure 6)."""

from __future__ import annotations

import numpy as np

from armsight._numba import kernel, lean_kernel

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
