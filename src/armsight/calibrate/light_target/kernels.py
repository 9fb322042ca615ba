"""Compiled projection of many lights into both views of a rig."""

from __future__ import annotations

import numpy as np

from armsight._numba import kernel
from armsight.optics.kernels.camera import see_point


@kernel
def see_both(k, R, t, X, uv, J):
    """Fill uv (n, 2, 2) [light, side] and J (n, 2, 2, 3) = d uv / d X for X (n, 3) in rig axes; NaN behind a camera."""
    for i in range(X.shape[0]):
        for s in range(2):
            if not see_point(k[s], R[s], t[s], X[i], uv[i, s], J[i, s]):
                # not zero: that would be a residual like any other, and pull the light behind the camera
                uv[i, s] = np.nan
                J[i, s] = np.nan
