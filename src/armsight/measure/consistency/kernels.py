"""Compiled evidence of one frame on what rig, target and clocks may have wrong.

With the pose fitted, residuals r (predicted minus seen) know of a parameter's error only what the pose cannot take
over: b = D'Wr and N = D'WD - B'H^-1 B with D the pixels' derivatives by the parameters, G by the pose, W the inverse of
the spots' covariances, H = G'WG, B = G'WD. Summed over frames they are all that a fit of the parameters to every
residual, each frame's pose free, would need. The parameters are the rig's 26, the target's m (by its basis), and the
time by which the right camera exposes later.
"""

from __future__ import annotations

import numpy as np

from armsight._numba import kernel
from armsight.fitting.kernels import invert_spd
from armsight.geometry.kernels import copy_2, multiply
from armsight.measure.poses.kernels.rig_covariance import PARAMETERS, add_information, light_slopes, place_slopes
from armsight.optics.kernels.triangulation import invert_2

DELAY = -1  # the delay's column, the last one


@kernel
def frame_evidence(k, R, t, cov, X, T, basis, velocity, residual, N, b, S, C):
    """Fill N (q, q), b (q,), S (6, q) = d pose / d parameters, C (6, 6) = H^-1; return chi-square, -1 where singular.

    X (n, 3) under T (4, 4), seen with cov (n, 2, 2, 2), residual (n, 2, 2). basis (n, 3, m): how each light's place in
    target axes follows the target's parameters. velocity (n, 3) of the lights in rig axes, m/s; 0 where not known.
    """
    n, m = X.shape[0], basis.shape[2]
    q = PARAMETERS + m + 1
    B = np.zeros((6, q))
    H = np.zeros((6, 6))
    g = np.zeros(6)
    uv = np.empty(2)
    p = np.empty(3)
    J = np.empty((2, 3))
    E = np.empty((2, 3))
    D = np.empty((2, PARAMETERS))
    W = np.empty((2, 2))
    G = np.empty((2, 6))
    row = np.zeros((2, q))
    N[:] = 0.0
    b[:] = 0.0
    chi2 = 0.0
    for light in range(n):
        for s in range(2):
            if not (light_slopes(k, R, t, T, X[light], p, s, uv, J, D, G) and invert_2(cov[light, s], W)):
                return -1.0
            place_slopes(J, T, E)
            copy_2(D, row)
            for i in range(2):
                for j in range(m):
                    row[i, PARAMETERS + j] = 0.0
                    for a in range(3):
                        row[i, PARAMETERS + j] += E[i, a] * basis[light, a, j]
                v = velocity[light]
                row[i, DELAY] = J[i, 0] * v[0] + J[i, 1] * v[1] + J[i, 2] * v[2] if s == 1 else 0.0
            r = residual[light, s]
            x = W[0, 0] * r[0] + W[0, 1] * r[1]
            y = W[1, 0] * r[0] + W[1, 1] * r[1]
            chi2 += x * r[0] + y * r[1]
            for i in range(6):
                g[i] += G[0, i] * x + G[1, i] * y
                u = W[0, 0] * G[0, i] + W[0, 1] * G[1, i]
                w = W[1, 0] * G[0, i] + W[1, 1] * G[1, i]
                for j in range(6):
                    H[i, j] += u * G[0, j] + w * G[1, j]
            add_information(row, W, G, r, B, N, b)
    if not invert_spd(H, C):
        return -1.0
    multiply(C, B, S)
    for i in range(6):
        for j in range(q):
            S[i, j] = -S[i, j]
    for j in range(q):
        for i in range(6):
            b[j] += S[i, j] * g[i]  # nothing at the minimum
            for a in range(q):
                N[j, a] += B[i, j] * S[i, a]
    return chi2
