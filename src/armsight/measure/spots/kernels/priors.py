"""What is known of a light before it is fitted: weak priors of what clipping hides, and the background's slope."""

from __future__ import annotations

from math import sqrt

import numpy as np

from armsight._numba import inner_kernel, lean_kernel
from armsight.measure.spots.kernels import columns as col
from armsight.measure.spots.kernels.gaussian_axes import PIXEL_VARIANCE
from armsight.measure.spots.kernels.light_models import JOINT

PRIOR_NOISE = 0.01
PRIOR_HEIGHT = 4.0
PRIOR_BLUR = 1.0
"""Standard deviations of the priors: of the height in heights of the start, of the blur in px, for a noise of this
share of the height. Unclipped lights tell both a hundred times better."""


@lean_kernel
def prior_weight(kind, i, height):
    """Return the weight of parameter i's prior: weak, only there for what clipping hides (the height, the blur)."""
    # weights are beside squares in grey levels, of pixels of this noise
    variance = max(PIXEL_VARIANCE, (PRIOR_NOISE * height) ** 2)
    if kind == JOINT:
        return variance / (PRIOR_HEIGHT * height) ** 2 if i > 1 and (i - 2) % 3 == 2 else 0.0
    if i == 3:
        return variance / (PRIOR_HEIGHT * height) ** 2
    return variance / (PRIOR_BLUR * PRIOR_BLUR) if i == 4 else 0.0


@lean_kernel
def prior_square(kind, p, start, n):
    """Return what the priors about start (n,) add to the sum of squares."""
    total = 0.0
    for i in range(n):
        total += prior_weight(kind, i, start[4] if kind == JOINT else start[3]) * (p[i] - start[i]) ** 2
    return total


@lean_kernel
def add_prior(kind, p, start, n, H, g):
    """Add the priors about start (n,) to H (n, n) and g (n,)."""
    for i in range(n):
        w = prior_weight(kind, i, start[4] if kind == JOINT else start[3])
        H[i, i] += w
        g[i] += w * (p[i] - start[i])


@inner_kernel
def slope_prior(levels, y, x, w, h, noise, prior):
    """Fill prior (4,): slope of the background per px along x and y at pixel (x, y), and how well it is known.

    The middle one of three rows' (columns') central differences; its standard deviation is their spread plus the step's
    unevenness plus the sample's own noise.
    """
    i = y * col.GRID // h
    j = x * col.GRID // w
    three = np.empty(3)
    for axis in range(2):
        size = (w if axis == 0 else h) / col.GRID
        c = j if axis == 0 else i
        o = i if axis == 0 else j
        lo = max(c - 1, 0)
        hi = min(c + 1, col.GRID - 1)
        known = 0
        bend = 0.0
        for k in range(max(o - 1, 0), min(o + 2, col.GRID)):
            a = levels[k, lo] if axis == 0 else levels[lo, k]
            b = levels[k, c] if axis == 0 else levels[c, k]
            d = levels[k, hi] if axis == 0 else levels[hi, k]
            if a < 0.0 or b < 0.0 or d < 0.0:
                continue
            three[known] = (d - a) / ((hi - lo) * size)
            # the second difference: how far the slope changes from tile to tile
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


LEAST_SLOPE = 0.05
"""Slope (grey levels per px) that a background before which nothing is seen to change may still have."""


@lean_kernel
def ring_prior(slope, prior):
    """Fill prior (4,) as slope_prior does where a ring about the light tells how much the background changes."""
    prior[0] = 0.0
    prior[1] = 0.0
    prior[2] = slope + LEAST_SLOPE
    prior[3] = slope + LEAST_SLOPE
