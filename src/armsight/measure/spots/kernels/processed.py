"""How far off the centre of one light may be in a picture that a camera has processed, before a room.

Demosaicing, sharpening, a curve and compression make residuals that are neither white nor of one variance, and a room
behind the light adds some of its own. What is symmetric about the centre moves no centre; of the rest every pixel's
own square is taken (White 1980, "A heteroskedasticity-consistent covariance matrix estimator"), with the influence
of that pixel on the centre.
"""

from __future__ import annotations

from math import pi, sqrt

import numpy as np

from armsight._numba import inner_kernel
from armsight.fitting.kernels import invert_spd
from armsight.measure.spots.kernels.area import (
    S_CG,
    S_CH,
    S_DOF,
    S_FOURTH,
    S_RSS,
    S_SIGNAL,
    S_SQUARE,
    S_U,
    S_V,
)
from armsight.measure.spots.kernels.background import BACKGROUND_INFLUENCE, background_variance
from armsight.measure.spots.kernels.leastsquares import evaluate_patch, gram, unused
from armsight.measure.spots.kernels.light_models import JOINT, add_scaled, prior_weight
from armsight.measure.spots.kernels.model_selection import antisymmetric_part
from armsight.measure.spots.kernels.patch import used
from armsight.measure.spots.kernels.scan import AREA, BACKGROUND, CLIPPED, PEAK, SUM_X, SUM_Y, WEIGHT

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
def centre_influence(kind, n, p, J, use, influence):
    """Fill influence (2, ny, nx) with the shift of the centre in px per grey level at each pixel; False for none."""
    H = np.empty((n, n))
    C = np.empty((n, n))
    gram(J, n, H)
    for i in range(n):
        H[i, i] += prior_weight(kind, i, p[4] if kind == JOINT else p[3])
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
        for k in unused(use):
            of_pixel[k] = 0.0
    return True


@inner_kernel
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


@inner_kernel
def centroid_distance2(comp, row):
    """Return the squared distance (px^2) of a spot's centre from the centroid of its area."""
    dx = row[S_U] - comp[SUM_X] / comp[WEIGHT]
    dy = row[S_V] - comp[SUM_Y] / comp[WEIGHT]
    return dx * dx + dy * dy


@inner_kernel
def is_off_centroid(comp, row):
    """Tell whether a fit has followed something else than its area."""
    return not centroid_distance2(comp, row) < (OFF_CENTROID_PX + OFF_CENTROID_SHARE * sqrt(comp[AREA] / pi)) ** 2


@inner_kernel
def robust_covariance(kind, n, p, patch, comp, noise, row):
    """Replace the covariance of a spot's row by the sandwich of its antisymmetric residuals; False where these are too
    few."""
    box, values, use = patch
    radius = sqrt(comp[AREA] / pi)
    away2 = centroid_distance2(comp, row)
    residuals = np.empty(values.shape)
    antisymmetric = np.empty(values.shape)
    influence = np.empty((2, values.shape[0], values.shape[1]))
    out = np.empty(3)
    J, _, _ = evaluate_patch(kind, p, n, patch, residuals)
    _, pixels = antisymmetric_part(residuals, use, row[S_U] - box[0], row[S_V] - box[2], antisymmetric)
    count = used(use)
    if not pixels > n + 4 or not centre_influence(kind, n, p, J, use, influence):
        return False
    sandwich(antisymmetric, influence, out)
    clipped = comp[CLIPPED] / comp[AREA]
    background = background_variance(residuals, use, row[S_U] - box[0], row[S_V] - box[2], radius, noise)
    background_influence = BACKGROUND_INFLUENCE * radius / max(comp[PEAK] - comp[BACKGROUND], 1.0)
    edge = (EDGE_VARIANCE + EDGE_VARIANCE_CLIPPED * clipped * clipped) * (1.0 + (TINY_PX / radius) ** 2) / radius
    floor = SPREAD_SHARE * away2 + edge + background_influence * background_influence * background
    for k in range(3):
        # freedom that the fit took is given back (HC1 of MacKinnon and White 1985)
        row[S_CH + k] = out[k] * count / (count - n) + (0.0 if k == 1 else floor)
        row[S_CG + k] = 0.0
    row[S_FOURTH] = 0.0
    row[S_SQUARE] = 0.0
    row[S_SIGNAL] = 0.0
    # the covariance is complete: what it is multiplied with later, RSS / DOF, is 1
    row[S_DOF] = 1.0
    row[S_RSS] = 1.0
    return True
