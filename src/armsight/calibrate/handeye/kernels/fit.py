"""Compiled core of the hand-eye fit: F_i X B_i = Z for many pose pairs, with the noises estimated.

F is the robot's pose (T_base_flange where the camera is in the hand, its inverse where the camera stands beside),
X the unknown place of the camera, B the camera's T_camera_target, Z the unknown place of the target. Everything is
seen where it is measured: the residual is B against its prediction X^-1 F^-1 Z, in the camera's axes, translation
then rotation vector. X and Z move as t + dt, Exp(dw) R in their parents' axes: parameters (12,) dtX, dwX, dtZ, dwZ,
and a thirteenth, gamma, that scales the predicted distances (1 / gamma is the true over the assumed target's size).
"""

from __future__ import annotations

from math import sqrt

import numpy as np

from armsight._numba import inner_kernel, kernel
from armsight.calibrate.handeye.kernels.closed_forms import multiply, multiply_t
from armsight.calibrate.handeye.kernels.noise import (
    factor_invert,
    lever_frame,
    scoring_step,
    to_lever,
    variance_step,
    whitener,
)
from armsight.fitting.kernels import solve_damped
from armsight.geometry.kernels import copy_1, rotate_left, rotvec_of, sandwich

LINEAR = 30.0
"""Within so many standard deviations of the answer the residuals follow the parameters linearly, to a share of the
noise that is far below its own uncertainty; the noises are judged only there."""


@kernel
def residual(Rx, tx, Rz, tz, gamma, Rf, tf, Rb, tb, e, P, t_hat, work):
    """Fill e (6,), P (3, 3) = Rx' Rf' and t_hat (3,), the predicted translation before gamma, of one pair.

    work: (2, 3, 3).
    """
    for i in range(3):
        for j in range(3):
            P[i, j] = Rx[0, i] * Rf[j, 0] + Rx[1, i] * Rf[j, 1] + Rx[2, i] * Rf[j, 2]
    d0, d1, d2 = tz[0] - tf[0], tz[1] - tf[1], tz[2] - tf[2]
    for i in range(3):
        t_hat[i] = P[i, 0] * d0 + P[i, 1] * d1 + P[i, 2] * d2
        t_hat[i] -= Rx[0, i] * tx[0] + Rx[1, i] * tx[1] + Rx[2, i] * tx[2]
        e[i] = tb[i] - gamma * t_hat[i]
    multiply(P, Rz, work[0])
    multiply_t(Rb, work[0], work[1])
    rotvec_of(work[1], e[3:])


@kernel
def jacobian(Rx, gamma, e, P, t_hat, J):
    """Fill J (6, 13) = d e / d parameters of one pair, given what `residual` left."""
    J[:] = 0.0
    x, y, z = t_hat[0], t_hat[1], t_hat[2]
    for j in range(3):
        a, b, c = Rx[j, 0], Rx[j, 1], Rx[j, 2]  # column j of Rx'
        J[0, j], J[1, j], J[2, j] = gamma * a, gamma * b, gamma * c
        J[0, 3 + j] = -gamma * (y * c - z * b)  # -gamma [t_hat]x Rx'
        J[1, 3 + j] = -gamma * (z * a - x * c)
        J[2, 3 + j] = -gamma * (x * b - y * a)
        for i in range(3):
            J[i, 6 + j] = -gamma * P[i, j]
    for i in range(3):
        J[i, 12] = -t_hat[i]
    # d e_r = Jr^-1(e_r) (Rx' dwX - P dwZ)
    wx, wy, wz = e[3], e[4], e[5]
    t2 = wx * wx + wy * wy + wz * wz
    if t2 < 1e-6:
        k = 1.0 / 12.0 + t2 / 720.0
    else:
        t = sqrt(t2)
        k = 1.0 / t2 - (1.0 + np.cos(t)) / (2.0 * t * max(np.sin(t), 1e-9))
    for j in range(6):
        if j < 3:
            a, b, c = Rx[j, 0], Rx[j, 1], Rx[j, 2]
        else:
            a, b, c = -P[0, j - 3], -P[1, j - 3], -P[2, j - 3]
        ca, cb, cc = wy * c - wz * b, wz * a - wx * c, wx * b - wy * a  # w x v
        column = 3 + j if j < 3 else 6 + j
        J[3, column] = a + 0.5 * ca + k * (wy * cc - wz * cb)
        J[4, column] = b + 0.5 * cb + k * (wz * ca - wx * cc)
        J[5, column] = c + 0.5 * cc + k * (wx * cb - wy * ca)


@kernel
def weigh(X, Z, gamma, pairs, theta, to_hand, keep, e, J, lever):
    """Fill whitened e (n, 6), J (n, 6, m) and lever (n,); return sum log det of the noise.

    X, Z: (R, t). pairs: (Rf, tf, Rb, tb), arrays over n. theta (3,): variances. Pairs not kept are left zero.
    """
    Rx, tx = X
    Rz, tz = Z
    Rf, tf, Rb, tb = pairs
    P = np.empty((3, 3))
    E = np.empty((3, 3))
    work = np.empty((2, 3, 3))
    t_hat = np.empty(3)
    plain = np.empty(6)
    raw = np.empty((6, 1))
    one = np.empty((6, 1))
    full = np.empty((6, 13))
    w = np.empty(5)
    total = 0.0
    for i in range(Rf.shape[0]):
        if not keep[i]:
            e[i] = 0.0
            J[i] = 0.0
            lever[i] = 0.0
            continue
        residual(Rx, tx, Rz, tz, gamma, Rf[i], tf[i], Rb[i], tb[i], plain, P, t_hat, work)
        jacobian(Rx, gamma, plain, P, t_hat, full)
        for a in range(6):
            raw[a, 0] = plain[a]
        lever[i] = lever_frame(Rx, tx, gamma, Rf[i], tf[i], t_hat, to_hand, E)
        total += whitener(lever[i], theta, w)
        to_lever(E, w, raw, one)
        for a in range(6):
            e[i, a] = one[a, 0]
        to_lever(E, w, full, J[i])
    return total


@kernel
def linearise(X, Z, gamma, pairs, to_hand, e, J, reach):
    """Fill e (n, 6), J (n, 6, 13) and reach (n, 3), the lever from flange to target, in camera axes: not whitened."""
    Rf, tf, Rb, tb = pairs
    P = np.empty((3, 3))
    E = np.empty((3, 3))
    work = np.empty((2, 3, 3))
    t_hat = np.empty(3)
    for i in range(Rf.shape[0]):
        residual(X[0], X[1], Z[0], Z[1], gamma, Rf[i], tf[i], Rb[i], tb[i], e[i], P, t_hat, work)
        jacobian(X[0], gamma, e[i], P, t_hat, J[i])
        length = lever_frame(X[0], X[1], gamma, Rf[i], tf[i], t_hat, to_hand, E)
        for a in range(3):
            reach[i, a] = length * E[2, a]


@inner_kernel
def normal_equations(e, J, H, g):
    """Fill H (m, m) = sum J'J and g (m,) = sum J'e; return sum e'e."""
    n, _, m = J.shape
    H[:] = 0.0
    g[:] = 0.0
    cost = 0.0
    for i in range(n):
        for a in range(6):
            r = e[i, a]
            cost += r * r
            for b in range(m):
                v = J[i, a, b]
                g[b] += v * r
                for c in range(m):
                    H[b, c] += v * J[i, a, c]
    return cost


@inner_kernel
def move(X, Z, gamma, step, n_free):
    """Return X, Z, gamma moved by the step (n_free,)."""
    Rx, tx = X
    Rz, tz = Z
    Rx2, Rz2 = np.empty((3, 3)), np.empty((3, 3))
    rotate_left(step[3:6], Rx, Rx2)
    rotate_left(step[9:12], Rz, Rz2)
    if n_free > 12:
        gamma = gamma + step[12]
    tx2, tz2 = np.empty(3), np.empty(3)
    for i in range(3):
        tx2[i] = tx[i] + step[i]
        tz2[i] = tz[i] + step[6 + i]
    return (Rx2, tx2), (Rz2, tz2), gamma


@kernel
def fit_pairs(X, Z, gamma, pairs, theta, estimate, floor, to_hand, keep, m, tolerance, limit):
    """Alternate Gauss-Newton on X, Z (and gamma where m is 13) with scoring on the variances theta (3,).

    Returns ok, X, Z, gamma, theta, C (m, m), e (n, 6) whitened, J (n, 6, m), lever (n,), restricted log-likelihood,
    iterations. estimate: whether theta is fitted. tolerance: largest step in standard deviations, and largest change
    of a variance in parts of its total, that count as an answer.
    """
    n = pairs[0].shape[0]
    e = np.empty((n, 6))
    J = np.empty((n, 6, m))
    lever = np.empty(n)
    H = np.empty((m, m))
    L = np.zeros((m, m))
    C = np.zeros((m, m))
    g = np.empty(m)
    step = np.empty(m)
    score = np.empty(3)
    information = np.empty((3, 3))
    theta = theta.copy()
    new = theta.copy()
    best = theta.copy()
    last = np.zeros(3)
    relax = 1.0
    best_likelihood = -np.inf
    likelihood = np.nan
    near = False
    for iteration in range(limit):
        logdet = weigh(X, Z, gamma, pairs, theta, to_hand, keep, e, J, lever)
        cost = normal_equations(e, J, H, g)
        determinant = factor_invert(H, L, C)
        if not np.isfinite(cost + logdet + determinant):
            return False, X, Z, gamma, theta, C, e, J, lever, likelihood, iteration
        size = 0.0
        for a in range(m):
            step[a] = 0.0
            for b in range(m):
                step[a] -= C[a, b] * g[b]
            size = max(size, abs(step[a]) / sqrt(C[a, a]))
        for a in range(m):
            cost += g[a] * step[a]
        for i in range(n):  # residuals as they will be after the step
            for a in range(6):
                for b in range(m):
                    e[i, a] += J[i, a, b] * step[b]
        likelihood = -0.5 * (logdet + cost + determinant)
        change = 0.0
        if estimate and size < LINEAR:
            if near and likelihood < best_likelihood - 1e-7:
                for k in range(3):
                    new[k] = 0.5 * (theta[k] + best[k])
            else:
                copy_1(theta, best)
                best_likelihood = likelihood
                variance_step(e, J, C, lever, theta, keep, score, information)
                scoring_step(theta, score, information, floor, new)
                turned = 0.0  # steps that go to and fro overshoot: shorten them until they do not
                for k in range(3):
                    turned += (new[k] - theta[k]) * last[k] / (theta[min(k, 1)] + theta[2 * min(k, 1)]) ** 2
                relax = max(0.5 * relax, 0.1) if turned < 0.0 else min(1.5 * relax, 1.0)
                for k in range(3):
                    last[k] = new[k] - theta[k]
                    new[k] = theta[k] + relax * last[k]
            near = True
            change = abs(new[0] - theta[0]) / theta[0]
            for k in range(1, 3):
                change = max(change, abs(new[k] - theta[k]) / (theta[1] + theta[2]))
        elif estimate:  # far away the residuals' size is the noise
            used = 0
            for i in range(n):
                used += 6 if keep[i] else 0
            factor = max(cost / max(used - m, 1), 1e-3)
            for k in range(3):
                new[k] = max(theta[k] * factor, floor[k])
            change = 1.0
            near = False
        X, Z, gamma = move(X, Z, gamma, step, m)
        copy_1(new, theta)
        if size < tolerance and change < tolerance:
            return True, X, Z, gamma, theta, C, e, J, lever, likelihood, iteration + 1
    return False, X, Z, gamma, theta, C, e, J, lever, likelihood, limit


@kernel
def first_variances(X, Z, gamma, pairs, keep, floor):
    """Return theta (3,) from the residuals of a start: translation, and orientation shared out evenly."""
    P = np.empty((3, 3))
    work = np.empty((2, 3, 3))
    t_hat = np.empty(3)
    e = np.empty(6)
    sums = np.zeros(2)
    used = 0
    for i in range(pairs[0].shape[0]):
        if keep[i]:
            residual(
                X[0], X[1], Z[0], Z[1], gamma, pairs[0][i], pairs[1][i], pairs[2][i], pairs[3][i], e, P, t_hat, work
            )
            used += 1
            for a in range(3):
                sums[0] += e[a] ** 2
                sums[1] += e[3 + a] ** 2
    for a in range(2):
        sums[a] /= max(3 * used - 6, 1)
    theta = np.empty(3)
    theta[0] = max(sums[0], floor[0])
    theta[1] = max(0.7 * sums[1], floor[1])
    theta[2] = max(0.3 * sums[1], floor[2])
    return theta


@kernel
def left_out(X, Z, gamma, pairs, theta, to_hand, keep, C, out):
    """Fill out (n, 6): each pair against its prediction from the other kept ones, camera axes, m and rad.

    A kept pair is taken out of the fit by the exact downdate of the linearised equations; a pair that was not kept
    is simply predicted. Returns q (n,), the squared length of that error against its own noise and the parameters'.
    """
    n = pairs[0].shape[0]
    m = C.shape[0]
    e = np.empty((n, 6))
    J = np.empty((n, 6, m))
    lever = np.empty(n)
    everything = np.ones(n, np.bool_)
    weigh(X, Z, gamma, pairs, theta, to_hand, everything, e, J, lever)
    q = np.empty(n)
    S = np.empty((6, 6))
    M = np.empty((6, 6))
    rhs = np.empty(6)
    y = np.empty(6)
    step = np.zeros(13)
    P = np.empty((3, 3))
    t_hat = np.empty(3)
    work = np.empty((2, 3, 3))
    for i in range(n):
        sandwich(J[i], C, M)
        for a in range(6):
            rhs[a] = -e[i, a]
            for b in range(6):
                S[a, b] = (1.0 if a == b else 0.0) + (-M[a, b] if keep[i] else M[a, b])
        if not solve_damped(S, rhs, 0.0, y):  # the pair alone fixes some parameter
            out[i] = np.nan
            q[i] = np.nan
            continue
        q[i] = 0.0
        for a in range(6):
            q[i] += e[i, a] * y[a]
        step[:] = 0.0
        if keep[i]:
            for b in range(m):
                for c in range(m):
                    for a in range(6):
                        step[b] += C[b, c] * J[i, a, c] * y[a]
        X1, Z1, gamma1 = move(X, Z, gamma, step, m)
        residual(
            X1[0],
            X1[1],
            Z1[0],
            Z1[1],
            gamma1,
            pairs[0][i],
            pairs[1][i],
            pairs[2][i],
            pairs[3][i],
            out[i],
            P,
            t_hat,
            work,
        )
    return q
