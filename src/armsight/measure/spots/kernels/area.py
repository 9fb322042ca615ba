"""Bright areas before and after the fit: which are worth one, where it starts, and whether its answer is believed."""

from __future__ import annotations

from math import exp, log, pi, sqrt

import numpy as np

from armsight._numba import inner_kernel, lean_kernel
from armsight.measure.spots.kernels import columns as col
from armsight.measure.spots.kernels.gaussian_axes import PIXEL_VARIANCE
from armsight.measure.spots.kernels.light_models import JOINT

# what became of a bright area
ACCEPTED, HOT, SMALL, BORDER, LARGE, FAILED, SATURATED, MANY, UNRESOLVED, UNLIKE, BEYOND, OTHER, UNUSED = range(13)
# how an accepted spot was measured
AS_GAUSSIAN, AS_ELLIPSE, AS_JOINT, AS_STREAK, AS_CENTROID = range(5)
# what may be tried
AUTO, ONLY_GAUSSIAN, ONLY_ELLIPSE = range(3)

UNLIKE_SHARE = 0.15
"""Residual, as a share of the height, above which it is no light that we know."""
WORST_SIGMA_PX = 0.5
"""A centre worse than this is no measurement."""
CROWDED_SIGMA = 0.35
"""A touching spot's centre must be known to this share of the width, or it is not told apart."""


@lean_kernel
def classify(comp, w, h, window, min_pixels, max_radius, margin):
    """Return ACCEPTED or why a component is refused before any fit. window (4,): x0, x1, y0, y1 that were searched."""
    if comp[col.AREA] < min_pixels:
        lone = comp[col.AREA] <= 2.0 and comp[col.PEAK] - comp[col.LEVEL] > margin
        return HOT if lone else SMALL
    if comp[col.X_MIN] < 1.0 or comp[col.Y_MIN] < 1.0 or comp[col.X_MAX] > w - 2.0 or comp[col.Y_MAX] > h - 2.0:
        return BORDER
    if max(comp[col.X_MAX] - comp[col.X_MIN], comp[col.Y_MAX] - comp[col.Y_MIN]) > 2.0 * max_radius:
        return LARGE
    inside = comp[col.X_MIN] > window[0] and comp[col.X_MAX] < window[1] - 1
    if not (inside and comp[col.Y_MIN] > window[2] and comp[col.Y_MAX] < window[3] - 1):
        return BEYOND
    return ACCEPTED


@lean_kernel
def boxes_overlap(a, b, reach):
    """Tell whether the bounds of component b, widened by reach, meet those of a."""
    return (
        b[col.X_MIN] - reach <= a[col.X_MAX]
        and b[col.X_MAX] + reach >= a[col.X_MIN]
        and b[col.Y_MIN] - reach <= a[col.Y_MAX]
        and b[col.Y_MAX] + reach >= a[col.Y_MIN]
    )


@lean_kernel
def fit_margin(comp):
    """Return how far beyond a component's bounds its fit looks, in px."""
    return 0.9 * max(comp[col.X_MAX] - comp[col.X_MIN], comp[col.Y_MAX] - comp[col.Y_MIN]) / 2.0 + 4.0


@lean_kernel
def round_start(comp, background, saturation, start):
    """Fill start (u, v, A, q, b) for a round Gaussian from a component's sums.

    The area above a grey level L is 2 pi q ln(A / L); with clipped pixels the areas above the threshold and
    above the clipping level together give A and q.
    """
    start[0] = comp[col.SUM_X] / comp[col.WEIGHT]
    start[1] = comp[col.SUM_Y] / comp[col.WEIGHT]
    low = max(comp[col.LEVEL] + 0.5 - background, 0.5)
    if comp[col.CLIPPED] > 3.0:
        high = saturation - background
        q = (comp[col.AREA] - comp[col.CLIPPED]) / (2.0 * pi * log(max(high / low, 1.05)))
        q = max(q, 0.2)
        start[2] = high * exp(min(comp[col.CLIPPED] / (2.0 * pi * q), 4.0))
    else:
        start[2] = max(comp[col.PEAK] - background, 1.1 * low)
        q = comp[col.AREA] / (2.0 * pi * log(start[2] / low))
    start[3] = min(max(q, 0.2), 200.0)
    start[4] = background


@lean_kernel
def check_fit(comp, rows, lights, saturated, noise):
    """Return ACCEPTED, or why these lights of one component are refused."""
    for k in range(lights):
        row = rows[k]
        a = max(row[col.S_RSS] / max(row[col.S_DOF], 1.0), PIXEL_VARIANCE)
        worst = sqrt(a * max(row[col.S_CH], row[col.S_CH + 2]))
        inside = (
            comp[col.X_MIN] - 2.0 <= row[col.S_U] <= comp[col.X_MAX] + 2.0
            and comp[col.Y_MIN] - 2.0 <= row[col.S_V] <= comp[col.Y_MAX] + 2.0
        )
        if lights > 1 and not (inside and worst < CROWDED_SIGMA * row[col.S_SIZE] and row[col.S_PEAK] > 4.0 * sqrt(a)):
            return UNRESOLVED
        if not worst < WORST_SIGMA_PX:
            return SATURATED if saturated else FAILED
        if not (inside and row[col.S_PEAK] > 0.0):
            return FAILED
        if sqrt(a) > UNLIKE_SHARE * row[col.S_PEAK] and a > 9.0 * noise:
            return UNLIKE
    return ACCEPTED


@lean_kernel
def is_hot_near(comp, hot):
    """Tell whether a hot pixel may lie in the component's window."""
    # the fit moves and widens its window while it runs
    reach = 1.5 * fit_margin(comp)
    for k in range(hot.shape[0]):
        x = hot[k, 0]
        y = hot[k, 1]
        if (
            comp[col.X_MIN] - reach < x < comp[col.X_MAX] + reach
            and comp[col.Y_MIN] - reach < y < comp[col.Y_MAX] + reach
        ):
            return True
    return False


@inner_kernel
def mark_crowded(comps, state):
    """Set CROWDED where another area's bounds meet the window of a component's fit."""
    n = comps.shape[0]
    relevant = np.empty(n, np.int64)
    count = 0
    for i in range(n):
        state[i, col.CROWDED] = 0
        if state[i, col.STATUS] != HOT and state[i, col.STATUS] != SMALL:
            relevant[count] = i
            count += 1
    for a in range(count):
        i = relevant[a]
        if state[i, col.STATUS] != ACCEPTED:
            continue
        reach = fit_margin(comps[i])
        for b in range(count):
            if b != a and boxes_overlap(comps[i], comps[relevant[b]], reach):
                state[i, col.CROWDED] = 1
                break


@lean_kernel
def hot_pixels(comps, state, hot):
    """Fill hot (2 n, 2) with the pixels x, y of the areas that are hot pixels; return how many."""
    n = np.int64(0)
    for i in range(comps.shape[0]):
        if state[i, col.STATUS] == HOT:
            hot[n, 0] = int(comps[i, col.X_MIN])
            hot[n, 1] = int(comps[i, col.Y_MIN])
            n += 1
            if comps[i, col.AREA] == 2.0:
                hot[n, 0] = int(comps[i, col.X_MAX])
                hot[n, 1] = int(comps[i, col.Y_MAX])
                n += 1
    return n


# What is known of a light before it is fitted: weak priors of what clipping hides, and the background's slope.

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
