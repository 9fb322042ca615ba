"""How far off the centre of one light may be in a picture that a camera has processed, before a room.

Demosaicing, sharpening, a curve and compression make residuals that are neither white nor of one variance, and a room
behind the light adds some of its own. What is symmetric about the centre moves no centre; of the rest every pixel's
own square is taken (White 1980, "A heteroskedasticity-consistent covariance matrix estimator"), with the influence
of that pixel on the centre.

And how uneven the background round a light is, and how far that may shift its centre. Light is added to what is behind
it, where nobody sees that; what is seen round it tells how much may change under it: an edge, a label, the mottle of a
wall.
"""

from __future__ import annotations

from math import pi, sqrt

import numpy as np

from armsight._numba import inner_kernel, lean_kernel
from armsight.fitting.kernels import invert_spd
from armsight.measure.spots.kernels import columns as col
from armsight.measure.spots.kernels.area import ACCEPTED
from armsight.measure.spots.kernels.blobs import RING_SAMPLES, RING_X, RING_Y
from armsight.measure.spots.kernels.columns import insertion_sort
from armsight.measure.spots.kernels.light_models import JOINT, add_scaled
from armsight.measure.spots.kernels.patch import antisymmetric_part, used

OFF_CENTROID_PX = 0.3
OFF_CENTROID_SHARE = 0.35
"""Distance in px, and share of the radius, from the centroid of the pixels above half height beyond which a fit has
followed something else: of 2,900 composites' lights four lay further, and were 1.5 to 3 px off."""
SPREAD_SHARE = 0.14
"""Share of the squared distance between the fit and that centroid that is added to a centre's variance: two ways to
the centre that disagree are both in doubt."""
EDGE_VARIANCE = 1.9e-4
EDGE_VARIANCE_CLIPPED = 2.6e-3
"""Variance per px of radius (px^3) of what no residual shows, because all of a light's edge is sampled and processed in
the same way: of any light, and of one all of whose pixels are clipped (times the clipped share squared)."""
TINY_PX = 1.2
"""Radius at which these are twice as large: an edge of a few pixels is not averaged over."""


@inner_kernel
def centre_influence(kind, n, there, influence):
    """Fill influence (2, ny, nx) with the shift of the centre in px per grey level at each pixel; False for none."""
    _, J, _, _, special, H = there
    C = np.empty((n, n))
    if not invert_spd(H, C):
        return False
    # d parameters = C J d values, one step of Gauss and Newton from the minimum; the centre's rows of it
    first = 2 if kind == JOINT else 1
    for a in range(2):
        of_pixel = influence[a].reshape(-1)
        for i in range(of_pixel.shape[0]):
            of_pixel[i] = 0.0
        for k in range(n):
            add_scaled(J[k], of_pixel, C[first + a, k])
        for k in special:
            of_pixel[k] = 0.0
    return True


@lean_kernel
def sandwich(antisymmetric, influence, out):
    """Write into out (3,) the sums over the pixels of influence influence' antisymmetric^2: uu, uv, vv."""
    for k in range(3):
        out[k] = 0.0
    for j in range(antisymmetric.shape[0]):
        for i in range(antisymmetric.shape[1]):
            a = influence[0, j, i] * antisymmetric[j, i]
            b = influence[1, j, i] * antisymmetric[j, i]
            out[0] += a * a
            out[1] += a * b
            out[2] += b * b


@lean_kernel
def centroid_distance2(comp, row):
    """Return the squared distance (px^2) of a spot's centre from the centroid of its area."""
    dx = row[col.S_U] - comp[col.SUM_X] / comp[col.WEIGHT]
    dy = row[col.S_V] - comp[col.SUM_Y] / comp[col.WEIGHT]
    return dx * dx + dy * dy


@lean_kernel
def is_off_centroid(comp, row):
    """Tell whether a fit has followed something else than its area."""
    return not centroid_distance2(comp, row) < (OFF_CENTROID_PX + OFF_CENTROID_SHARE * sqrt(comp[col.AREA] / pi)) ** 2


@inner_kernel
def robust_covariance(kind, n, patch, there, comp, noise, row):
    """Replace the covariance of a spot's row by the sandwich of its antisymmetric residuals; False where these are too
    few. there: as evaluate_patch returns it."""
    box, values, use = patch
    residuals = there[3]
    radius = sqrt(comp[col.AREA] / pi)
    away2 = centroid_distance2(comp, row)
    antisymmetric = np.empty(values.shape)
    influence = np.empty((2, values.shape[0], values.shape[1]))
    out = np.empty(3)
    _, pixels = antisymmetric_part(residuals, use, row[col.S_U] - box[0], row[col.S_V] - box[2], antisymmetric)
    count = used(use)
    if not pixels > n + 4 or not centre_influence(kind, n, there, influence):
        return False
    sandwich(antisymmetric, influence, out)
    clipped = comp[col.CLIPPED] / comp[col.AREA]
    background = background_variance(residuals, use, row[col.S_U] - box[0], row[col.S_V] - box[2], radius, noise)
    background_influence = BACKGROUND_INFLUENCE * radius / max(comp[col.PEAK] - comp[col.BACKGROUND], 1.0)
    edge = (EDGE_VARIANCE + EDGE_VARIANCE_CLIPPED * clipped * clipped) * (1.0 + (TINY_PX / radius) ** 2) / radius
    floor = SPREAD_SHARE * away2 + edge + background_influence * background_influence * background
    for k in range(3):
        # freedom that the fit took is given back (HC1 of MacKinnon and White 1985)
        row[col.S_CH + k] = out[k] * count / (count - n) + (0.0 if k == 1 else floor)
        row[col.S_CG + k] = 0.0
    row[col.S_FOURTH] = 0.0
    row[col.S_SQUARE] = 0.0
    row[col.S_SIGNAL] = 0.0
    # the covariance is complete: what it is multiplied with later, RSS / DOF, is 1
    row[col.S_DOF] = 1.0
    row[col.S_RSS] = 1.0
    return True


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


@lean_kernel
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
    half = 0.5 * max(comp[col.X_MAX] - comp[col.X_MIN], comp[col.Y_MAX] - comp[col.Y_MIN])
    boxes = np.empty(RING_SAMPLES)
    n = np.int64(0)
    for k in range(RING_SAMPLES):
        x = int(row[col.S_U] + (BACKGROUND_SHARE * half + BACKGROUND_GAP) * RING_X[k] + 0.5)
        y = int(row[col.S_V] + (BACKGROUND_SHARE * half + BACKGROUND_GAP) * RING_Y[k] + 0.5)
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
    return background * (BACKGROUND_INFLUENCE * radius / max(row[col.S_PEAK], 1.0)) ** 2


@lean_kernel
def add_background_variance(picture, comps, state, survey, rows):
    """Fill S_FLOOR of the lights that stand alone above a threshold: for a background that is not even round them."""
    for i in range(comps.shape[0]):
        alone = state[i, col.STATUS] == ACCEPTED and state[i, col.CROWDED] == 0 and state[i, col.LIGHTS] == 1
        if alone and comps[i, col.SLOPE] < 0.0:
            rows[i, 0, col.S_FLOOR] = background_centre_variance(
                picture.grey, picture.flip, comps[i], rows[i, 0], survey[2 * col.GRID, col.NOISE]
            )
