"""Compiled core of the hand-eye fit: F_i X B_i = Z for many pose pairs, with the noises estimated.

F is the robot's pose (T_base_flange where the camera is in the hand, its inverse where the camera stands beside),
X the unknown pose of the camera, B the camera's T_camera_target, Z the unknown pose of the target. Everything is
seen where it is measured: the residual is B against its prediction X^-1 F^-1 Z, in the camera's axes, translation
then rotation vector. X and Z move as t + dt, Exp(dw) R in their parents' axes: parameters (12,) dtX, dwX, dtZ, dwZ,
and a thirteenth, gamma, that scales the predicted distances (1 / gamma is the true over the assumed target's size).

Python gives plain tuples, which cost it nothing to pass; the kernels that it calls name their parts first:
unknowns ((RX, tX), (RZ, tZ), gamma), pairs (RF, tF, RB, tB) over n, observed (pairs, keep (n,), to_hand).
"""

from __future__ import annotations

from math import sqrt
from typing import Any, NamedTuple

import numpy as np

from armsight._numba import inline_kernel, inner_kernel, kernel
from armsight.calibrate.handeye.kernels.closed_forms import multiply, multiply_t
from armsight.calibrate.handeye.kernels.noise import (
    Search,
    factor_invert,
    lever_frame,
    next_variances,
    scaled_variances,
    to_lever,
    whitener,
)
from armsight.geometry.kernels import Pose, copy_1, rotate_left, rotvec_of

LINEAR = 30.0
"""Within so many standard deviations of the answer the residuals follow the parameters linearly, to a share of the
noise that is far below its own uncertainty; the noises are judged only there."""


class Unknowns(NamedTuple):
    """What is fitted: X, Z and gamma of tB = gamma (X^-1 F^-1 Z)_t, RB = (X^-1 F^-1 Z)_R."""

    X: Any
    Z: Any
    gamma: Any


class Prediction(NamedTuple):
    """Of one pair: P (3, 3) = RX' RF', t_hat (3,) the predicted translation before gamma, and room for two products."""

    P: Any
    t_hat: Any
    work: Any


@inner_kernel
def named(unknowns):
    """Return the Unknowns of the plain tuples that Python gives."""
    X, Z, gamma = unknowns
    return Unknowns(Pose(X[0], X[1]), Pose(Z[0], Z[1]), gamma)


@inner_kernel
def prediction():
    """Return room for a Prediction."""
    return Prediction(np.empty((3, 3)), np.empty(3), np.empty((2, 3, 3)))


@inline_kernel
def residual(at, pairs, row, e, out):
    """Fill e (6,) and the Prediction out of the pair of this row at the Unknowns at."""
    X, Z, gamma = at
    Rf, tf, Rb, tb = pairs[0][row], pairs[1][row], pairs[2][row], pairs[3][row]
    Rx, tx, tz = X.R, X.t, Z.t
    P, t_hat, work = out
    # F X B = Z solved for B: rotation RX' RF' RZ, translation RX' (RF' (tZ - tF) - tX)
    for i in range(3):
        for j in range(3):
            P[i, j] = Rx[0, i] * Rf[j, 0] + Rx[1, i] * Rf[j, 1] + Rx[2, i] * Rf[j, 2]
    d0, d1, d2 = tz[0] - tf[0], tz[1] - tf[1], tz[2] - tf[2]
    for i in range(3):
        t_hat[i] = P[i, 0] * d0 + P[i, 1] * d1 + P[i, 2] * d2
        t_hat[i] -= Rx[0, i] * tx[0] + Rx[1, i] * tx[1] + Rx[2, i] * tx[2]
        e[i] = tb[i] - gamma * t_hat[i]
    # measured = Exp(e_r) predicted, so that e_r is in the camera's axes like the covariances of its poses
    multiply(P, Z.R, work[0])
    multiply_t(Rb, work[0], work[1])
    rotvec_of(work[1], e[3:])


@inline_kernel
def jacobian(at, e, predicted, J):
    """Fill J (6, 13) = d e / d parameters of one pair, given what `residual` left."""
    Rx, gamma = at.X.R, at.gamma
    P, t_hat, _ = predicted
    J[:] = 0.0
    x, y, z = t_hat[0], t_hat[1], t_hat[2]
    for j in range(3):
        a, b, c = Rx[j, 0], Rx[j, 1], Rx[j, 2]  # column j of Rx'
        # d t_hat = -RX' dtX + [t_hat]x RX' dwX + P dtZ, since RX' (1 - [dwX]x) u = RX' u + [RX' u]x RX' dwX
        J[0, j], J[1, j], J[2, j] = gamma * a, gamma * b, gamma * c
        J[0, 3 + j] = -gamma * (y * c - z * b)
        J[1, 3 + j] = -gamma * (z * a - x * c)
        J[2, 3 + j] = -gamma * (x * b - y * a)
        for i in range(3):
            J[i, 6 + j] = -gamma * P[i, j]
    for i in range(3):
        J[i, 12] = -t_hat[i]
    # d e_r = Jr^-1(e_r) (Rx' dwX - P dwZ): both turn the prediction from the left, so its inverse from the right.
    # Jr^-1(w) = 1 + [w]x / 2 + k [w]x^2, k = 1 / t^2 - (1 + cos t) / (2 t sin t), t = |w| (Sola, Deray, Atchuthan 2018,
    # appendix on SO(3)); near zero by its series, as the difference of two large terms would be rounding
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


@inner_kernel
def derivatives(unknowns, pairs, e, J):
    """Fill e (n, 6) and J (n, 6, 13), in the camera's axes."""
    at, predicted = named(unknowns), prediction()
    for i in range(e.shape[0]):
        residual(at, pairs, i, e[i], predicted)
        jacobian(at, e[i], predicted, J[i])


@kernel
def weigh(unknowns, observed, theta, e, J, lever):
    """Fill whitened e (n, 6), J (n, 6, m) and lever (n,); return sum log det of the noise.

    theta (3,): variances. Pairs not kept are left zero.
    """
    return _weighed(named(unknowns), observed, theta, e, J, lever)


@inner_kernel
def _weighed(at, observed, theta, e, J, lever):
    """As `weigh`, at Unknowns."""
    pairs, keep, to_hand = observed
    E = np.empty((3, 3))
    predicted = prediction()
    plain = np.empty(6)
    raw = np.empty((6, 1))
    one = np.empty((6, 1))
    full = np.empty((6, 13))
    w = np.empty(5)
    total = 0.0
    for i in range(e.shape[0]):
        if not keep[i]:
            e[i] = 0.0
            J[i] = 0.0
            lever[i] = 0.0
            continue
        residual(at, pairs, i, plain, predicted)
        jacobian(at, plain, predicted, full)
        for a in range(6):
            raw[a, 0] = plain[a]
        lever[i] = _lever(at, pairs, i, predicted, to_hand, E)
        # in the lever's axes the noise of every pair falls into two equal 2 x 2 blocks and two singles: five numbers
        # whiten it, where a Cholesky factor of 6 x 6 would be needed in the camera's
        total += whitener(lever[i], theta, w)
        to_lever(E, w, raw, one)
        for a in range(6):
            e[i, a] = one[a, 0]
        to_lever(E, w, full, J[i])
    return total


@inline_kernel
def _lever(at, pairs, i, predicted, to_hand, E):
    """Fill E with the lever's axes of pair i; return the lever's length."""
    return lever_frame(at.X.R, at.X.t, at.gamma, pairs[0][i], pairs[1][i], predicted.t_hat, to_hand, E)


@kernel
def linearise(unknowns, pairs, to_hand, e, J, reach):
    """Fill e (n, 6), J (n, 6, 13) and reach (n, 3), the lever from flange to target, in camera axes: not whitened."""
    at, predicted = named(unknowns), prediction()
    E = np.empty((3, 3))
    for i in range(e.shape[0]):
        residual(at, pairs, i, e[i], predicted)
        jacobian(at, e[i], predicted, J[i])
        length = _lever(at, pairs, i, predicted, to_hand, E)
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
def move(at, step, n_free):
    """Return Unknowns moved by the step (n_free,)."""
    X, Z, gamma = at
    Rx, Rz = np.empty((3, 3)), np.empty((3, 3))
    rotate_left(step[3:6], X.R, Rx)
    rotate_left(step[9:12], Z.R, Rz)
    if n_free > 12:
        gamma = gamma + step[12]
    tx, tz = np.empty(3), np.empty(3)
    for i in range(3):
        tx[i] = X.t[i] + step[i]
        tz[i] = Z.t[i] + step[6 + i]
    return Unknowns(Pose(Rx, tx), Pose(Rz, tz), gamma)


@inner_kernel
def _newton_step(C, g, step):
    """Fill step (m,) = -C g; return its largest component in standard deviations."""
    m = g.shape[0]
    size = 0.0
    for a in range(m):
        step[a] = 0.0
        for b in range(m):
            step[a] -= C[a, b] * g[b]
        size = max(size, abs(step[a]) / sqrt(C[a, a]))
    return size


@inner_kernel
def _after(step, J, e):
    """Move residuals e (n, 6) to what they will be after the step (m,), to first order."""
    n, _, m = J.shape
    for i in range(n):
        for a in range(6):
            for b in range(m):
                e[i, a] += J[i, a, b] * step[b]


@kernel
def fit_pairs(unknowns, observed, noise, m, settled):
    """Alternate Gauss-Newton on X, Z (and gamma where m is 13) with scoring on the variances theta (3,).

    noise: theta, its floor (3,), and whether it is fitted. settled: the largest step in standard deviations, and
    largest change of a variance in parts of its total, that count as an answer; and the most rounds.

    Returns ok, X, Z, gamma, theta, C (m, m), (e (n, 6) whitened, J (n, 6, m), lever (n,)), restricted log-likelihood,
    iterations.
    """
    at, keep, n = named(unknowns), observed[1], observed[1].shape[0]
    floor, estimate = noise[1], noise[2]
    tolerance, limit = settled
    e, J, lever = np.empty((n, 6)), np.empty((n, 6, m)), np.empty(n)
    H, L, C = np.empty((m, m)), np.zeros((m, m)), np.zeros((m, m))
    g, step = np.empty(m), np.empty(m)
    theta, new = noise[0].copy(), noise[0].copy()
    search = Search(noise[0].copy(), np.zeros(3), np.empty(3), np.empty((3, 3)), np.array([1.0, -np.inf]))
    likelihood, near, ok, iteration = np.nan, False, False, 0
    while iteration < limit and not ok:
        logdet = _weighed(at, observed, theta, e, J, lever)
        cost = normal_equations(e, J, H, g)
        determinant = factor_invert(H, L, C)
        if not np.isfinite(cost + logdet + determinant):
            break
        iteration += 1
        size = _newton_step(C, g, step)
        for a in range(m):
            cost += g[a] * step[a]
        _after(step, J, e)
        # restricted likelihood (Patterson, Thompson 1971): log det of the information pays for the freedom of X and Z,
        # without which the variances of few pairs would come out too small
        likelihood = -0.5 * (logdet + cost + determinant)
        change = 0.0
        if estimate and size < LINEAR:
            change = next_variances(likelihood, near, theta, floor, observed, (e, J, C, lever), search, new)
            near = True
        elif estimate:  # far away the residuals' size is the noise
            scaled_variances(theta, floor, keep, cost, m, new)
            change = 1.0
            near = False
        at = move(at, step, m)
        copy_1(new, theta)
        ok = size < tolerance and change < tolerance
    X, Z, gamma = at
    return ok, (X.R, X.t), (Z.R, Z.t), gamma, theta, C, (e, J, lever), likelihood, iteration


@kernel
def first_variances(unknowns, pairs, keep, floor):
    """Return theta (3,) from the residuals of a start: translation, and orientation shared out evenly."""
    at, predicted = named(unknowns), prediction()
    e = np.empty(6)
    sums = np.zeros(2)
    used = 0
    for i in range(keep.shape[0]):
        if keep[i]:
            residual(at, pairs, i, e, predicted)
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
def residuals_after(unknowns, pairs, steps, out):
    """Fill out (n, 6) with the residual of each pair after a step (n, m) of its own, in camera axes."""
    at, predicted = named(unknowns), prediction()
    for i in range(out.shape[0]):
        residual(move(at, steps[i], steps.shape[1]), pairs, i, out[i], predicted)
