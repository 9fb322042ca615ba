"""Bright areas before and after the fit: which are worth one, where it starts, and whether its answer is believed."""

from __future__ import annotations

from math import exp, log, pi, sqrt

import numpy as np

from armsight._numba import inner_kernel
from armsight.measure.spots.kernels.gaussian_axes import PIXEL_VARIANCE
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

# order of the numbers in `options` (see settings.SpotSettings)
O_THRESHOLD, O_FLIP, O_SATURATION, O_MIN_PIXELS, O_MAX_RADIUS, O_MAX_SPOTS, O_MODEL, O_GAIN = range(8)

# columns of the areas' state (n, STATE), integers
STATUS, OWNER, CROWDED, KIND, SIZE, LIGHTS = range(6)
STATE = 6

# what became of a bright area
ACCEPTED, HOT, SMALL, BORDER, LARGE, FAILED, SATURATED, MANY, UNRESOLVED, UNLIKE, BEYOND, OTHER, UNUSED = range(13)
# how an accepted spot was measured
AS_GAUSSIAN, AS_ELLIPSE, AS_JOINT, AS_STREAK, AS_CENTROID = range(5)
# what may be tried
AUTO, ONLY_GAUSSIAN, ONLY_ELLIPSE = range(3)

# columns of a measured spot; 2..4 and 5..7 are C_H and C_G (see uncertainty.uncertainty); S_FLOOR: variance (px^2)
# added
S_U, S_V, S_CH, S_CG = 0, 1, 2, 5
S_PEAK, S_SIZE, S_MODEL, S_DOF, S_RSS, S_SIGNAL, S_FOURTH, S_SQUARE, S_B, S_OF, S_FLOOR = range(8, 19)
SPOT = 19
MOST_LIGHTS = 6
"""Lights that are told apart within one bright area."""
MOST_PARAMETERS = 2 + 3 * MOST_LIGHTS
FIT = MOST_PARAMETERS + 4
"""Columns of a fit: the model's parameters, and the prior of the background's slope."""


UNLIKE_SHARE = 0.15
"""Residual, as a share of the height, above which it is no light that we know."""
WORST_SIGMA_PX = 0.5
"""A centre worse than this is no measurement."""
CROWDED_SIGMA = 0.35
"""A touching spot's centre must be known to this share of the width, or it is not told apart."""


@inner_kernel
def classify(comp, w, h, window, min_pixels, max_radius, margin):
    """Return ACCEPTED or why a component is refused before any fit. window (4,): x0, x1, y0, y1 that were searched."""
    if comp[AREA] < min_pixels:
        lone = comp[AREA] <= 2.0 and comp[PEAK] - comp[LEVEL] > margin
        return HOT if lone else SMALL
    if comp[X_MIN] < 1.0 or comp[Y_MIN] < 1.0 or comp[X_MAX] > w - 2.0 or comp[Y_MAX] > h - 2.0:
        return BORDER
    if max(comp[X_MAX] - comp[X_MIN], comp[Y_MAX] - comp[Y_MIN]) > 2.0 * max_radius:
        return LARGE
    inside = comp[X_MIN] > window[0] and comp[X_MAX] < window[1] - 1
    if not (inside and comp[Y_MIN] > window[2] and comp[Y_MAX] < window[3] - 1):
        return BEYOND
    return ACCEPTED


@inner_kernel
def boxes_overlap(a, b, reach):
    """Tell whether the bounds of component b, widened by reach, meet those of a."""
    return (
        b[X_MIN] - reach <= a[X_MAX]
        and b[X_MAX] + reach >= a[X_MIN]
        and b[Y_MIN] - reach <= a[Y_MAX]
        and b[Y_MAX] + reach >= a[Y_MIN]
    )


@inner_kernel
def fit_margin(comp):
    """Return how far beyond a component's bounds its fit looks, in px."""
    return 0.9 * max(comp[X_MAX] - comp[X_MIN], comp[Y_MAX] - comp[Y_MIN]) / 2.0 + 4.0


@inner_kernel
def round_start(comp, background, saturation, start):
    """Fill start (u, v, A, q, b) for a round Gaussian from a component's sums.

    The area above a grey level L is 2 pi q ln(A / L); with clipped pixels the areas above the threshold and
    above the clipping level together give A and q.
    """
    start[0] = comp[SUM_X] / comp[WEIGHT]
    start[1] = comp[SUM_Y] / comp[WEIGHT]
    low = max(comp[LEVEL] + 0.5 - background, 0.5)
    if comp[CLIPPED] > 3.0:
        high = saturation - background
        q = (comp[AREA] - comp[CLIPPED]) / (2.0 * pi * log(max(high / low, 1.05)))
        q = max(q, 0.2)
        start[2] = high * exp(min(comp[CLIPPED] / (2.0 * pi * q), 4.0))
    else:
        start[2] = max(comp[PEAK] - background, 1.1 * low)
        q = comp[AREA] / (2.0 * pi * log(start[2] / low))
    start[3] = min(max(q, 0.2), 200.0)
    start[4] = background


@inner_kernel
def check_fit(comp, rows, lights, saturated, noise):
    """Return ACCEPTED, or why these lights of one component are refused."""
    for k in range(lights):
        row = rows[k]
        a = max(row[S_RSS] / max(row[S_DOF], 1.0), PIXEL_VARIANCE)
        worst = sqrt(a * max(row[S_CH], row[S_CH + 2]))
        inside = (
            comp[X_MIN] - 2.0 <= row[S_U] <= comp[X_MAX] + 2.0 and comp[Y_MIN] - 2.0 <= row[S_V] <= comp[Y_MAX] + 2.0
        )
        if lights > 1 and not (inside and worst < CROWDED_SIGMA * row[S_SIZE] and row[S_PEAK] > 4.0 * sqrt(a)):
            return UNRESOLVED
        if not worst < WORST_SIGMA_PX:
            return SATURATED if saturated else FAILED
        if not (inside and row[S_PEAK] > 0.0):
            return FAILED
        if sqrt(a) > UNLIKE_SHARE * row[S_PEAK] and a > 9.0 * noise:
            return UNLIKE
    return ACCEPTED


@inner_kernel
def hot_pixels(comps, state, hot):
    """Fill hot (2 n, 2) with the pixels x, y of the areas that are hot pixels; return how many."""
    n = np.int64(0)
    for i in range(comps.shape[0]):
        if state[i, STATUS] == HOT:
            hot[n, 0] = int(comps[i, X_MIN])
            hot[n, 1] = int(comps[i, Y_MIN])
            n += 1
            if comps[i, AREA] == 2.0:
                hot[n, 0] = int(comps[i, X_MAX])
                hot[n, 1] = int(comps[i, Y_MAX])
                n += 1
    return n
