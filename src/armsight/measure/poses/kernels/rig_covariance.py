"""Compiled share of the rig's calibration and of the target's measures in the uncertainty of poses and points.

A calibration is wrong in the same way in every frame. Its 26 parameters (left and right intrinsics, then T_rig_right as
t + dt, Exp(dw) R) and the positions of the target's lights carry over to whatever is fitted to the pixels:
d fit = -H^-1 G' W D d parameters, with G and D the derivatives of the pixels by the fit and by the parameters.
"""

from __future__ import annotations

from math import sqrt

import numpy as np

from armsight._numba import inner_kernel, kernel, lean_kernel
from armsight.geometry.kernels import copy_2, dot, multiply, sandwich
from armsight.optics.kernels.camera import RigK, intrinsics_jacobian, see_point
from armsight.optics.kernels.triangulation import centre_of, invert_2

PARAMETERS = 26


@inner_kernel
def pixel_slopes(rig, p, s, uv, J, D):
    """Fill J (2, 3) = d pixel / d point and D (2, 26) = d pixel / d parameters of side s; False behind the camera."""
    k, R, t = rig
    if not see_point(k[s], R[s], t[s], p, uv, J):
        return False
    D[:] = 0.0
    x = R[s, 0, 0] * p[0] + R[s, 0, 1] * p[1] + R[s, 0, 2] * p[2] + t[s, 0]
    y = R[s, 1, 0] * p[0] + R[s, 1, 1] * p[1] + R[s, 1, 2] * p[2] + t[s, 1]
    z = R[s, 2, 0] * p[0] + R[s, 2, 1] * p[1] + R[s, 2, 2] * p[2] + t[s, 2]
    intrinsics_jacobian(k[s], x, y, z, D[:, 10 * s : 10 * s + 10])
    if s == 1:
        q = np.empty(3)
        centre_of(R[s], t[s], q)
        for i in range(3):
            q[i] = p[i] - q[i]
        for i in range(2):
            for j in range(3):
                D[i, 20 + j] = -J[i, j]
            # d p_camera = R' (q x dw)
            D[i, 23] = J[i, 1] * q[2] - J[i, 2] * q[1]
            D[i, 24] = J[i, 2] * q[0] - J[i, 0] * q[2]
            D[i, 25] = J[i, 0] * q[1] - J[i, 1] * q[0]
    return True


@inner_kernel
def light_slopes(rig, T, X, p, s, uv, J, D, G):
    """Fill D (2, 26) as pixel_slopes and G (2, 6) = d pixel / d pose for the light X (3,) under T (4, 4); p (3,) too.

    J (2, 3) = d pixel / d p, p the light in rig axes. False behind the camera.
    """
    q = np.empty(3)
    for i in range(3):
        q[i] = T[i, 0] * X[0] + T[i, 1] * X[1] + T[i, 2] * X[2]
        p[i] = q[i] + T[i, 3]
    if not pixel_slopes(rig, p, s, uv, J, D):
        return False
    for i in range(2):
        for j in range(3):
            G[i, j] = J[i, j]
        G[i, 3] = q[1] * J[i, 2] - q[2] * J[i, 1]
        G[i, 4] = q[2] * J[i, 0] - q[0] * J[i, 2]
        G[i, 5] = q[0] * J[i, 1] - q[1] * J[i, 0]
    return True


@lean_kernel
def place_slopes(J, T, E):
    """Fill E (2, 3) = d pixel / d the light's place in target axes, from J (2, 3) by its place in rig axes."""
    for i in range(2):
        for j in range(3):
            E[i, j] = J[i, 0] * T[0, j] + J[i, 1] * T[1, j] + J[i, 2] * T[2, j]


@kernel
def carry_to_pose(rig, cov, X, T, covariance, C, residual, systematic):
    """Carry the covariance of rig and target to the pose T (4, 4) of X (n, 3), seen with cov (n, 2, 2, 2).

    covariance (26 + m, 26 + m): of the rig's parameters and, m = 3 n or 0, of the positions X. C (6, 6): of the spots'
    noise alone. Fills systematic (6, 6) = A covariance A' with d pose = A d parameters, A = -C G' W D, and returns
    the chi-square of residual (n, 2, 2) with these parameters free within their covariance (a Gaussian prior each).
    """
    rig = RigK(*rig)
    n, size = X.shape[0], covariance.shape[0]
    B = np.zeros((6, size))  # G' W D
    N = np.zeros((size, size))  # D' W D
    b = np.zeros(size)  # D' W r
    uv = np.empty(2)
    p = np.empty(3)
    J = np.empty((2, 3))
    E = np.empty((2, 3))
    D = np.empty((2, PARAMETERS))
    W = np.empty((2, 2))
    G = np.empty((2, 6))
    row = np.zeros((2, size))
    chi2 = 0.0
    for light in range(n):
        for s in range(2):
            if not (light_slopes(rig, T, X[light], p, s, uv, J, D, G) and invert_2(cov[light, s], W)):
                continue
            row[:] = 0.0
            copy_2(D, row)
            if size > PARAMETERS:
                place_slopes(J, T, E)
                copy_2(E, row[:, PARAMETERS + 3 * light :])
            r = residual[light, s]
            chi2 += r[0] * (W[0, 0] * r[0] + W[0, 1] * r[1]) + r[1] * (W[1, 0] * r[0] + W[1, 1] * r[1])
            add_information(row, W, G, r, B, N, b)
    A = np.empty((6, size))
    multiply(C, B, A)
    sandwich(A, covariance, systematic)
    for i in range(size):  # N - B' A
        for j in range(size):
            for a in range(6):
                N[i, j] -= B[a, i] * A[a, j]
    return marginal_chi2(chi2, N, b, covariance)


@lean_kernel
def add_information(D, W, G, r, B, N, b):
    """Add one pixel's rows D (2, q), G (2, 6), residual r (2,), weight W (2, 2) to B = G'WD, N = D'WD, b = D'Wr."""
    for j in range(D.shape[1]):
        x = W[0, 0] * D[0, j] + W[0, 1] * D[1, j]
        y = W[1, 0] * D[0, j] + W[1, 1] * D[1, j]
        if x == 0.0 and y == 0.0:
            continue
        b[j] += x * r[0] + y * r[1]
        for i in range(6):
            B[i, j] += G[0, i] * x + G[1, i] * y
        for i in range(D.shape[1]):
            N[i, j] += D[0, i] * x + D[1, i] * y


@inner_kernel
def marginal_chi2(chi2, N, b, covariance):
    """Return chi-square with the parameters free within their covariance: chi2 - b' (covariance^-1 + N)^-1 b.

    Written as chi2 - b' C (I + N C)^-1 b, which a covariance of less than full rank allows as well.
    """
    size = b.shape[0]
    scale = np.empty(size)
    for i in range(size):  # parameters in units of their own standard deviation: px beside metres
        scale[i] = sqrt(max(covariance[i, i], 0.0))
    M = np.empty((size, size))
    Q = np.empty((size, size))
    K = np.empty((size, size))
    g = np.empty(size)
    for i in range(size):
        g[i] = scale[i] * b[i]
        for j in range(size):
            M[i, j] = scale[i] * N[i, j] * scale[j]
            product = scale[i] * scale[j]
            Q[i, j] = covariance[i, j] / product if product > 0.0 else 0.0
    multiply(M, Q, K)
    for i in range(size):
        K[i, i] += 1.0
    x = np.linalg.solve(K, g)
    for i in range(size):
        scale[i] = dot(Q[i], x)
    return max(chi2 - dot(g, scale), 0.0)


@kernel
def point_slopes(rig, cov, P, S, A):
    """Fill A (n, 3, 26): how points P (n, 3), fitted with cov (n, 2, 2, 2) to S (n, 3, 3), follow the parameters."""
    rig = RigK(*rig)
    uv = np.empty(2)
    J = np.empty((2, 3))
    D = np.empty((2, PARAMETERS))
    W = np.empty((2, 2))
    B = np.empty((3, PARAMETERS))
    for n in range(P.shape[0]):
        B[:] = 0.0
        for s in range(2):
            if pixel_slopes(rig, P[n], s, uv, J, D) and invert_2(cov[n, s], W):
                for j in range(PARAMETERS):
                    x = W[0, 0] * D[0, j] + W[0, 1] * D[1, j]
                    y = W[1, 0] * D[0, j] + W[1, 1] * D[1, j]
                    for i in range(3):
                        B[i, j] -= J[0, i] * x + J[1, i] * y
        multiply(S[n], B, A[n])
