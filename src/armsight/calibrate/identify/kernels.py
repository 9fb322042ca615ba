"""Compiled: a rig's pixels of many points, with derivatives."""

from __future__ import annotations

import numpy as np
from numba import njit

from armsight.optics.kernels import see_point


@njit(cache=True)
def see_many(k, R, t, X, uv, D):
    """Fill uv (m, 2, 2) and D (m, 2, 2, 3) as [point, side] for X (m, 3) in rig axes; NaN behind a camera."""
    for i in range(X.shape[0]):
        for side in range(2):
            if not see_point(k[side], R[side], t[side], X[i], uv[i, side], D[i, side]):
                uv[i, side, :] = np.nan
                D[i, side, :, :] = np.nan
