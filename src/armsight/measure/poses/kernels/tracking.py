"""Compiled prediction: where a track's lights are by now, and how far from there they are seen."""

from __future__ import annotations

import numpy as np

from armsight._numba import kernel
from armsight.optics.kernels.camera import see_point


@kernel
def transform_lights(T, X, positions):
    """Fill positions (n, 3) with the model's lights X (n, 3) under the pose T (4, 4)."""
    for n in range(X.shape[0]):
        for i in range(3):
            positions[n, i] = T[i, 0] * X[n, 0] + T[i, 1] * X[n, 1] + T[i, 2] * X[n, 2] + T[i, 3]


@kernel
def predict_views(rig, positions, velocity, dt, predicted, uv):
    """Fill predicted (n, 3) with positions + dt velocity, uv (v, n, 2) with its images, NaN behind a camera; return
    whether none is."""
    k, R, t = rig
    J = np.empty((2, 3))
    whole = True
    for n in range(positions.shape[0]):
        for i in range(3):
            predicted[n, i] = positions[n, i] + dt * velocity[n, i]
        for s in range(uv.shape[0]):
            if not see_point(k[s], R[s], t[s], predicted[n], uv[s, n], J):
                uv[s, n] = np.nan
                whole = False
    return whole


@kernel
def largest_innovation(uv, expected):
    """Return the largest distance along one axis between seen and expected pixels (n, 2) of a view."""
    innovation = 0.0
    for n in range(uv.shape[0]):
        for i in range(2):
            innovation = max(innovation, abs(uv[n, i] - expected[n, i]))
    return innovation
