"""A position's uncertainty as a 3-D scene shows it: an ellipsoid large enough to be seen, and a track's colours."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from armsight.arrays import Array

SCALES = (5000.0, 2000.0, 1000.0, 500.0, 200.0, 100.0, 50.0, 20.0, 10.0, 5.0, 2.0)
LARGEST_M = 0.06
"""Longest semi-axis that an ellipsoid is drawn with: it must not hide the target."""
USELESS_M = 1.0
"""Standard deviation of a position that says nothing of it: its ellipsoid would hold the whole scene."""
THINNEST = 0.02
"""Share of the longest semi-axis that the others are drawn with at least: a flat one is not seen from its side."""
BEST, WORST = np.array([0.0, 0.447, 0.698]), np.array([0.835, 0.369, 0.0])
"""Okabe and Ito's blue and vermillion, as (r, g, b) in 0 to 1."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class DrawnEllipsoid:
    """semi_axes_m (3,) as drawn, along the columns of R (3, 3); scale: how many times as large as 1 sigma."""

    semi_axes_m: Array
    R: Array
    scale: float


def drawn_ellipsoid(covariance_m2: ArrayLike) -> DrawnEllipsoid | None:
    """Return the 1 sigma ellipsoid of a position's covariance (3, 3) m^2, enlarged by a round figure to be seen.

    R is a rotation. None for a covariance that is not finite or that is zero, and for one beyond USELESS_M.
    """
    covariance = np.asarray(covariance_m2, dtype=float)
    if not np.isfinite(covariance).all():
        return None
    values, vectors = np.linalg.eigh(covariance)
    sigma = np.sqrt(np.maximum(values, 0.0))
    longest = float(sigma.max())
    if not 0.0 < longest <= USELESS_M:
        return None
    scale = next((one for one in SCALES if one * longest <= LARGEST_M), 1.0)
    if np.linalg.det(vectors) < 0.0:
        vectors = vectors * [1.0, 1.0, -1.0]
    return DrawnEllipsoid(semi_axes_m=np.maximum(scale * sigma, THINNEST * scale * longest), R=vectors, scale=scale)


def track_colours(std_m: ArrayLike) -> Array:
    """Return (n, 3): r, g, b in 0 to 1 of a track's points by their standard deviations (n,), in m.

    From blue at the least to vermillion at the greatest; a point whose standard deviation is not known (NaN) is blue.
    """
    std = np.asarray(std_m, dtype=float)
    known = std[np.isfinite(std)]
    if not len(known):
        return np.tile(BEST, (len(std), 1))
    span = float(np.ptp(known))
    share = np.zeros(len(std)) if span <= 0.0 else np.nan_to_num((std - known.min()) / span)
    return np.asarray(BEST + share[:, None] * (WORST - BEST))
