"""How uneven the background round a light is, and how far that may shift the light's centre.

Light is added to what is behind it, where nobody sees that. What is seen round it tells how much may change under it:
an edge, a label, the mottle of a wall.
"""

from __future__ import annotations

import numpy as np

from armsight._numba import inner_kernel, kernel
from armsight.measure.spots.kernels.area import (
    ACCEPTED,
    CROWDED,
    LIGHTS,
    O_FLIP,
    S_FLOOR,
    S_PEAK,
    S_U,
    S_V,
    STATUS,
)
from armsight.measure.spots.kernels.blobs import RING_SAMPLES, RING_X, RING_Y
from armsight.measure.spots.kernels.locate import NOISE
from armsight.measure.spots.kernels.picture import insertion_sort
from armsight.measure.spots.kernels.scan import GRID, SLOPE, X_MAX, X_MIN, Y_MAX, Y_MIN

BACKGROUND_INFLUENCE = 0.9
"""Shift of a centre in radii at half height, over the background's standard deviation round the light as a share of its
height.
A least-squares fit of a Gaussian is shifted by 2.7 by an edge through its middle, by 1.35 (root mean square) by one
anywhere in reach, and by 1.45 by mottle of its own width. The fit's residuals tell a part of it: in simulated rooms
0.6 held 87 % of Gaussian lights in their 95 % ellipses before plain walls, 0.9 held 94 % and 1.2 97 %."""
BACKGROUND_FROM = 1.9
"""Radii from the centre from which the residuals tell the background: a Gaussian is down to a twelfth there."""
BOX_NOISE = 0.15
"""Share of the noise's variance left in the mean of 3 x 3 pixels: a ninth of white noise, and some more of noise that
demosaicing has smoothed."""
FEWEST_BOXES = 12
BACKGROUND_SHARE, BACKGROUND_GAP = 1.4, 4.0
"""Radius of the ring in half widths of an area above a threshold, and px more: a light's tails have ended there."""
RING_NOISE = 0.22
"""Share of white noise's variance that the spread of a ring's boxes stays below: a ninth, and as much again for there
being two dozen of them."""
HALF_SHARE = 0.6
"""Radius at half height over that above the threshold, of round lights of ordinary height."""


@inner_kernel
def background_variance(residuals, use, u, v, radius, noise):
    """Return the variance of boxes of 3 x 3 round a light at (u, v) of the patch, noise taken off."""
    total = 0.0
    squares = 0.0
    count = 0
    for j in range(1, residuals.shape[0] - 1):
        for i in range(1, residuals.shape[1] - 1):
            if (j - v) ** 2 + (i - u) ** 2 < (BACKGROUND_FROM * radius) ** 2:
                continue
            # means of nine pixels: unevenness of a light's size moves a centre, that of single pixels averages out
            mean = 0.0
            whole = True
            for b in range(j - 1, j + 2):
                for a in range(i - 1, i + 2):
                    mean += residuals[b, a] / 9.0
                    whole = whole and use[b, a] == 1
            if whole:
                total += mean
                squares += mean * mean
                count += 1
    if count < FEWEST_BOXES:
        return 0.0
    return max(squares / count - (total / count) ** 2 - BOX_NOISE * noise, 0.0)


@inner_kernel
def background_centre_variance(image, flip, comp, row, noise):
    """Return the variance of a light's centre for what stands out of the noise on a ring outside of its tails.

    comp: an area above a threshold. The middle two thirds of the ring are taken, so that hot pixels do not count.
    """
    h, w = image.shape
    half = 0.5 * max(comp[X_MAX] - comp[X_MIN], comp[Y_MAX] - comp[Y_MIN])
    boxes = np.empty(RING_SAMPLES)
    n = np.int64(0)
    for k in range(RING_SAMPLES):
        x = int(row[S_U] + (BACKGROUND_SHARE * half + BACKGROUND_GAP) * RING_X[k] + 0.5)
        y = int(row[S_V] + (BACKGROUND_SHARE * half + BACKGROUND_GAP) * RING_Y[k] + 0.5)
        if 1 <= x < w - 1 and 1 <= y < h - 1:
            boxes[n] = 0.0
            for b in range(y - 1, y + 2):
                for a in range(x - 1, x + 2):
                    boxes[n] += float(np.uint8(image[b, a] ^ flip)) / 9.0
            n += 1
    if n < FEWEST_BOXES:
        return 0.0
    insertion_sort(boxes, n)
    # quantiles 1/6 and 5/6 of a normal distribution are 0.97 standard deviations from its mean
    spread = 0.5 * (boxes[(5 * n) // 6] - boxes[n // 6])
    background = max(spread * spread - RING_NOISE * noise, 0.0)
    radius = min(half, 1.0 + HALF_SHARE * half)
    return background * (BACKGROUND_INFLUENCE * radius / max(row[S_PEAK], 1.0)) ** 2


@kernel
def add_background_variance(image, options, comps, state, survey, rows):
    """Fill S_FLOOR of the lights that stand alone above a threshold: for a background that is not even round them."""
    flip = np.uint8(options[O_FLIP])
    for i in range(comps.shape[0]):
        alone = state[i, STATUS] == ACCEPTED and state[i, CROWDED] == 0 and state[i, LIGHTS] == 1
        if alone and comps[i, SLOPE] < 0.0:
            rows[i, 0, S_FLOOR] = background_centre_variance(image, flip, comps[i], rows[i, 0], survey[2 * GRID, NOISE])
