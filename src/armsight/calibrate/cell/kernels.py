"""Compiled: pixels of many points through one camera, with their derivatives by the point and by the intrinsics."""

from __future__ import annotations

import numpy as np

from armsight._numba import kernel
from armsight.optics.kernels.camera import intrinsics_jacobian, project_point


@kernel
def see_points(k, R, t, X, uv, J, D):
    """Fill uv (m, 2), J (m, 2, 3) by X and D (m, 2, 10) by the intrinsics of points X (m, 3); p_camera = R X + t.

    NaN where a point has no image; its derivatives are zero.
    """
    by_camera = np.empty((2, 3))
    for i in range(X.shape[0]):
        x = R[0, 0] * X[i, 0] + R[0, 1] * X[i, 1] + R[0, 2] * X[i, 2] + t[0]
        y = R[1, 0] * X[i, 0] + R[1, 1] * X[i, 1] + R[1, 2] * X[i, 2] + t[1]
        z = R[2, 0] * X[i, 0] + R[2, 1] * X[i, 1] + R[2, 2] * X[i, 2] + t[2]
        if not project_point(k, x, y, z, uv[i], by_camera):
            uv[i] = np.nan
            J[i] = 0.0
            D[i] = 0.0
            continue
        # d uv / d X = d uv / d p_camera R
        for a in range(2):
            for b in range(3):
                J[i, a, b] = by_camera[a, 0] * R[0, b] + by_camera[a, 1] * R[1, b] + by_camera[a, 2] * R[2, b]
        intrinsics_jacobian(k, x, y, z, D[i])
