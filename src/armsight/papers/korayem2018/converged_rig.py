"""Places from two parallel cameras in the paper's own terms, sensor coordinates and a lens in front: eq. (10)."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from armsight.errors import Degenerate

Array = NDArray[np.float64]


def triangulate_parallel(focal_m: float, baseline_m: float, uv1_m: ArrayLike, uv2_m: ArrayLike) -> Array:
    """Return the points (n, 3) for parallel axes, sensors at x = -B/2 (first) and +B/2: eq. (10) with MATH A17.

    Z counts from the sensor plane, so that Z - F = B F / (u2 - u1) (the sensor is inverted, u1 - u2 < 0).
    Raises Degenerate where the disparity is zero.
    """
    (u1, v1), (u2, v2) = np.atleast_2d(uv1_m).astype(float).T, np.atleast_2d(uv2_m).astype(float).T
    disparity = u1 - u2
    if (disparity == 0.0).any():
        raise Degenerate("the rays of a pair are parallel", consequence="Their point is at infinity")
    Z = focal_m - baseline_m * focal_m / disparity
    scale = (focal_m - Z) / focal_m
    return np.stack([scale * u1 - 0.5 * baseline_m, scale * 0.5 * (v1 + v2), Z], axis=-1)
