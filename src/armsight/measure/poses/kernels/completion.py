"""Compiled: the spots of all views that are the lights' by a pose which others gave."""

from __future__ import annotations

import numpy as np

from armsight._numba import inner_kernel, kernel
from armsight.measure.poses.kernels.rig_covariance import light_slopes, n_parameters
from armsight.optics.kernels.camera import RigK
from armsight.optics.kernels.triangulation import invert_2

NONE, TWO = -1, -2
"""Of a light in a view: no spot lies within its gate, or more than one."""


@inner_kernel
def add_image(rig, T, X, p, s, covariance, C, uv, S, work):
    """Fill uv (2,) with the image of a light in view s, and add to S (2, 2) what pose and calibration leave in it.

    T (4, 4), C (6, 6): the pose; covariance (q + m, q + m), or of size 0: the rig's parameters' part of it is used, as
    if pose and view were independent. False behind the camera.
    """
    J, D, G = work
    if not light_slopes(rig, T, X, p, s, uv, J, D, G):
        return False
    for i in range(2):
        for j in range(2):
            for a in range(6):
                S[i, j] += G[i, a] * (
                    C[a, 0] * G[j, 0]
                    + C[a, 1] * G[j, 1]
                    + C[a, 2] * G[j, 2]
                    + C[a, 3] * G[j, 3]
                    + C[a, 4] * G[j, 4]
                    + C[a, 5] * G[j, 5]
                )
    if covariance.size == 0:
        return True
    for a in range(D.shape[1]):
        if D[0, a] == 0.0 and D[1, a] == 0.0:
            continue
        for b in range(D.shape[1]):
            both = covariance[a, b]
            for i in range(2):
                for j in range(2):
                    S[i, j] += D[i, a] * both * D[j, b]
    return True


@kernel
def gather(rows, spots, first, uv, cov, radius):
    """Fill uv (n, v, 2), cov (n, v, 2, 2), radius (n, v) of the sights rows (n, v): NaN, infinite, 0 where it is -1.

    spots: of all views one after the other, uv (k, 2), cov (k, 2, 2), radius (k,); first (v + 1,): where each begins.
    """
    for n in range(rows.shape[0]):
        for s in range(rows.shape[1]):
            there, at = rows[n, s] >= 0, rows[n, s] + first[s]
            radius[n, s] = spots[2][at] if there else 0.0
            for i in range(2):
                uv[n, s, i] = spots[0][at, i] if there else np.nan
                for j in range(2):
                    cov[n, s, i, j] = spots[1][at, i, j] if there else np.inf


@kernel
def complete(rig, X, T, C, covariance, spots, near, rows):
    """Add to rows (n, v), -1 for none, each view's one spot near a light X (n, 3) under the pose T, C; tell if any was.

    spots: of all views one after the other, uv (k, 2) px, cov (k, 2, 2), and where each view's begin (v + 1,). near:
    slack (px^2), and squared standard deviations of the pose, the calibration, the spot and slack together. A spot that
    two lights would take is of neither, and one that has a name keeps it.
    """
    rig = RigK(*rig)
    uv, cov, first = spots
    added, take = False, np.empty(X.shape[0], np.int64)
    for s in range(rows.shape[1]):
        a, b = first[s], first[s + 1]
        if a == b:
            continue
        spots_near(rig, s, X, (T, C, covariance), uv[a:b], cov[a:b], near, take)
        for n in range(X.shape[0]):
            if rows[n, s] >= 0 or take[n] < 0:
                continue
            free = True
            for other in range(X.shape[0]):
                free = free and rows[other, s] != take[n]
            if free:
                rows[n, s] = take[n]
                added = True
    return added


@inner_kernel
def spots_near(rig, s, X, pose, uv, cov, near, take):
    """Fill take (n,): the one spot of view s within the gate of each light, NONE or TWO; see complete."""
    T, C, covariance = pose
    slack2, gate = near
    at, p = np.empty(2), np.empty(3)
    work = np.empty((2, 3)), np.empty((2, n_parameters(rig))), np.empty((2, 6))
    S, wide, W = np.empty((2, 2)), np.empty((2, 2)), np.empty((2, 2))
    for n in range(X.shape[0]):
        take[n] = NONE
        S[:] = 0.0
        S[0, 0] = slack2
        S[1, 1] = slack2
        if not add_image(rig, T, X[n], p, s, covariance, C, at, S, work):
            continue
        for k in range(uv.shape[0]):
            for i in range(2):
                for j in range(2):
                    wide[i, j] = S[i, j] + cov[k, i, j]
            if not invert_2(wide, W):
                continue
            x, y = uv[k, 0] - at[0], uv[k, 1] - at[1]
            if x * (W[0, 0] * x + W[0, 1] * y) + y * (W[1, 0] * x + W[1, 1] * y) <= gate:
                take[n] = k if take[n] == NONE else TWO
    for n in range(X.shape[0]):
        for other in range(n):
            if take[n] >= 0 and take[n] == take[other]:
                take[n] = TWO
                take[other] = TWO
