"""Compiled share of the rig's calibration and of the target's measures in the uncertainty of poses and points.

A calibration is wrong in the same way in every frame. Its parameters (the intrinsics of all v cameras, then
the pose in the rig of each but the first, as t + dt, Exp(dw) R) and the positions of the target's lights carry over to
whatever is fitted to the pixels:
d fit = -H^-1 G' W D d parameters, with G and D the derivatives of the pixels by the fit and by the parameters.
"""

from __future__ import annotations

from math import sqrt

import numpy as np

from armsight._numba import inline_kernel, inner_kernel, kernel, lean_kernel
from armsight.geometry.kernels import copy_2, dot, multiply, sandwich
from armsight.measure.poses.kernels.pose import SOLVED, solve_named
from armsight.measure.poses.kernels.pose_ambiguity import PLAIN, depth_chi2, fold, one_astray, scale
from armsight.optics.kernels.camera import RigK, intrinsics_jacobian, see_point
from armsight.optics.kernels.triangulation import centre_of, invert_2, missing, n_sights
from armsight.optics.kernels.wide import n_intrinsics

POSE = 6


@inline_kernel
def n_parameters(rig):
    """Return how many parameters the calibration of a rig has."""
    views = rig.k.shape[0]
    return n_intrinsics(rig.k) * views + POSE * (views - 1)


@inner_kernel
def pixel_slopes(rig, p, s, uv, J, D):
    """Fill J (2, 3) = d pixel / d point and D (2, q) = d pixel / d parameters of view s; False behind the camera."""
    k, R, t = rig
    if not see_point(k[s], R[s], t[s], p, uv, J):
        return False
    own = n_intrinsics(k)
    D[:] = 0.0
    x = R[s, 0, 0] * p[0] + R[s, 0, 1] * p[1] + R[s, 0, 2] * p[2] + t[s, 0]
    y = R[s, 1, 0] * p[0] + R[s, 1, 1] * p[1] + R[s, 1, 2] * p[2] + t[s, 1]
    z = R[s, 2, 0] * p[0] + R[s, 2, 1] * p[1] + R[s, 2, 2] * p[2] + t[s, 2]
    intrinsics_jacobian(k[s], x, y, z, D[:, own * s : own * (s + 1)])
    if s > 0:
        at = own * k.shape[0] + POSE * (s - 1)
        q = np.empty(3)
        centre_of(R[s], t[s], q)
        for i in range(3):
            q[i] = p[i] - q[i]
        for i in range(2):
            for j in range(3):
                D[i, at + j] = -J[i, j]
            # d p_camera = R' (q x dw)
            D[i, at + 3] = J[i, 1] * q[2] - J[i, 2] * q[1]
            D[i, at + 4] = J[i, 2] * q[0] - J[i, 0] * q[2]
            D[i, at + 5] = J[i, 0] * q[1] - J[i, 1] * q[0]
    return True


@inner_kernel
def light_slopes(rig, T, X, p, s, uv, J, D, G):
    """Fill D (2, q) as pixel_slopes and G (2, 6) = d pixel / d pose for the light X (3,) under T (4, 4); p (3,) too.

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
    """Carry the covariance of rig and target to the pose T (4, 4) of X (n, 3), seen with cov (n, v, 2, 2).

    covariance (q + m, q + m): of the rig's parameters and, m = 3 n or 0, of the positions X. C (6, 6): of the spots'
    noise alone. Fills systematic (6, 6) = A covariance A' with d pose = A d parameters, A = -C G' W D, and returns
    the chi-square of residual (n, v, 2) with these parameters free within their covariance (a Gaussian prior each).
    """
    rig = RigK(*rig)
    n, size, own = X.shape[0], covariance.shape[0], n_parameters(rig)
    B = np.zeros((6, size))  # G' W D
    N = np.zeros((size, size))  # D' W D
    b = np.zeros(size)  # D' W r
    uv = np.empty(2)
    p = np.empty(3)
    J = np.empty((2, 3))
    E = np.empty((2, 3))
    D = np.empty((2, own))
    W = np.empty((2, 2))
    G = np.empty((2, 6))
    row = np.zeros((2, size))
    chi2 = 0.0
    for light in range(n):
        for s in range(cov.shape[1]):
            if missing(cov[light, s]):
                continue
            if not (light_slopes(rig, T, X[light], p, s, uv, J, D, G) and invert_2(cov[light, s], W)):
                continue
            row[:] = 0.0
            copy_2(D, row)
            if size > own:
                place_slopes(J, T, E)
                copy_2(E, row[:, own + 3 * light :])
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
    """Fill A (n, 3, q): how points P (n, 3), fitted with cov (n, v, 2, 2) to S (n, 3, 3), follow the parameters."""
    rig = RigK(*rig)
    uv = np.empty(2)
    J = np.empty((2, 3))
    own = n_parameters(rig)
    D = np.empty((2, own))
    W = np.empty((2, 2))
    B = np.empty((3, own))
    for n in range(P.shape[0]):
        B[:] = 0.0
        for s in range(cov.shape[1]):
            if missing(cov[n, s]):
                continue
            if pixel_slopes(rig, P[n], s, uv, J, D) and invert_2(cov[n, s], W):
                for j in range(own):
                    x = W[0, 0] * D[0, j] + W[0, 1] * D[1, j]
                    y = W[1, 0] * D[0, j] + W[1, 1] * D[1, j]
                    for i in range(3):
                        B[i, j] -= J[0, i] * x + J[1, i] * y
        multiply(S[n], B, A[n])


# Pose of named spots with all that is in its covariance: noise, misfit, other tilts, rig and target. And whether it is
# known well enough to be one.

UNLIKE, UNCERTAIN = 6, 7
"""States beside those of solve_named: the spots do not fit the target, or leave the rotation open."""

NO_DOUBT, ONE_OFF, FOLDED = 0, 1, 2
"""What is in doubt: nothing, one of the spots, or to which side of the line of sight the target is tilted."""

MAX_ROTATION_SIGMA = 0.3
"""A rotation less certain than this (rad; 17 degrees) is none: its covariance, taken to first order, means nothing."""

MAX_DOUBTFUL_SIGMA = 0.07
"""The same (4 degrees) where another tilt fits as well, or a spot is of something else: the truth then lies in one of
several places, not about one."""

FOLDED_FROM = 1.05
"""Squared Mahalanobis distance of another tilt over what its residuals allow, from which that is the case."""

MISFIT_SIGMA = 2.326
"""Residuals further out than this normal deviation (1 %) widen the pose: cameras' noise models are off by up to a
factor of two in variance, so that a frame alone proves little."""


@inner_kernel
def misfit_factor(chi2, n_seen):
    """Return the factor on a pose's variance for residuals of n sights with this chi-square: 1 where they can be noise.

    From the point that one frame in a hundred passes by noise alone it grows with chi-square (2 n - 6 degrees of
    freedom; Wilson-Hilferty).
    """
    dof = max(2 * n_seen - 6, 1)
    spread = 2.0 / (9.0 * dof)
    usual = dof * (1.0 - spread + MISFIT_SIGMA * sqrt(spread)) ** 3
    return max(1.0, chi2 / usual)


@kernel
def solve_whole(rig, views, rules, lights, start, covariance, points, pose, residual):
    """Pose of a target from its n named spots; arguments and what is filled as of solve_named, and of carry_to_pose.

    rules: slack in px^2, and the largest chi-square, slack included, that is believed. covariance: of size 0 where rig
    and target are exact. Filled are points (P, S) and pose (T, C, systematic), of which C (6, 6) holds all, systematic
    (6, 6) the part of rig and target. Returns the state, the factor of misfit that is in C, and what is in doubt.
    """
    slack2, limit = rules
    P, S = points
    T, C, systematic = pose
    state, wide, chi2 = solve_named(rig, views, slack2, lights, start, P, S, T, C, residual)
    if state != SOLVED:
        return state, 1.0, NO_DOUBT
    if not wide <= limit:
        return UNLIKE, 1.0, NO_DOUBT
    X, radius, normal = lights
    if covariance.size > 0:
        chi2 = carry_to_pose(rig, views[1], X, T, covariance, C, residual, systematic)
    lights = (X.copy(), radius, normal)  # writable as in solve_named: one compilation serves both
    cov = views[1]
    sights = 0
    for i in range(cov.shape[0]):
        sights += n_sights(cov[i])
    factor = misfit_factor(chi2, sights)
    doubt = NO_DOUBT
    for i in range(6):
        scale(C[i], factor)
    if factor > 1.0:
        one_astray(rig, lights, views, T, chi2, C)
        doubt = ONE_OFF
    if not depth_chi2(rig, P, S) >= PLAIN * factor:  # NaN where a light has no point
        folded = fold(rig, lights, views, T, factor, C)
        if doubt == NO_DOUBT and folded > FOLDED_FROM:
            doubt = FOLDED
    if covariance.size > 0:
        for i in range(6):
            for j in range(6):
                C[i, j] += systematic[i, j]
    most = MAX_ROTATION_SIGMA if doubt == NO_DOUBT else MAX_DOUBTFUL_SIGMA
    certain = max(C[3, 3], C[4, 4], C[5, 5]) <= most * most
    return SOLVED if certain else UNCERTAIN, factor, doubt
