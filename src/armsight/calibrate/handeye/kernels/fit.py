"""Compiled core of the hand-eye fit: F_i X B_i = Z for many pose pairs, with the noises estimated.

F is the robot's pose (T_base_flange where the camera is in the hand, its inverse where the camera stands beside),
X the unknown place of the camera, B the camera's T_camera_target, Z the unknown place of the target. Everything is
seen where it is measured: the residual is B against its prediction X^-1 F^-1 Z, in the camera's axes, translation
then rotation vector. X and Z move as t + dt, Exp(dw) R in their parents' axes: parameters (12,) dtX, dwX, dtZ, dwZ,
and a thirteenth, gamma, that scales the predicted distances (1 / gamma is the true over the assumed target's size).
"""

from __future__ import annotations

from math import log, sqrt

import numpy as np
from numba import njit

from armsight.calibrate.handeye.kernels.start import log_rotation, multiply, multiply_t
from armsight.fitting.kernels import solve_damped
from armsight.geometry.kernels import rotate_left

LINEAR = 30.0
"""Within so many standard deviations of the answer the residuals follow the parameters linearly, to a share of the
noise that is far below its own doubt; the noises are judged only there."""


@njit(cache=True)
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
    log_rotation(work[1], e[3:])


@njit(cache=True)
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


@njit(cache=True)
def lever_frame(Rx, tx, gamma, Rf, tf, t_hat, to_hand, E):
    """Fill E (3, 3), rows x, y, z with z along the lever from the flange's origin to the target's, in camera axes.

    Returns the lever's length.
    """
    z = np.empty(3)
    for i in range(3):
        o = -tx[i]  # from the camera to the flange, in the frame that X is expressed in
        if to_hand:
            o -= Rf[0, i] * tf[0] + Rf[1, i] * tf[1] + Rf[2, i] * tf[2]
        for j in range(3):
            if i == 0:
                z[j] = t_hat[j]
        for j in range(3):
            z[j] -= Rx[i, j] * o
    length = sqrt(z[0] * z[0] + z[1] * z[1] + z[2] * z[2])
    if length < 1e-12:
        E[:] = np.eye(3)
        return 0.0
    for j in range(3):
        E[2, j] = z[j] / length
    least = 0
    for j in range(3):
        if abs(E[2, j]) < abs(E[2, least]):
            least = j
    f = 1.0 / sqrt(1.0 - E[2, least] ** 2)
    for j in range(3):
        E[0, j] = ((1.0 if j == least else 0.0) - E[2, least] * E[2, j]) * f
    E[1, 0] = E[2, 1] * E[0, 2] - E[2, 2] * E[0, 1]
    E[1, 1] = E[2, 2] * E[0, 0] - E[2, 0] * E[0, 2]
    E[1, 2] = E[2, 0] * E[0, 1] - E[2, 1] * E[0, 0]
    return gamma * length


@njit(cache=True)
def to_lever(E, w, v, out):
    """Fill out (6, m) with the columns of v (6, m) turned into the lever's axes and whitened by w of `whitener`."""
    for c in range(out.shape[1]):
        out[0, c] = (E[0, 0] * v[0, c] + E[0, 1] * v[1, c] + E[0, 2] * v[2, c]) * w[0]
        out[1, c] = (E[1, 0] * v[3, c] + E[1, 1] * v[4, c] + E[1, 2] * v[5, c]) * w[2] - out[0, c] * w[1]
        out[2, c] = -(E[1, 0] * v[0, c] + E[1, 1] * v[1, c] + E[1, 2] * v[2, c]) * w[0]
        out[3, c] = (E[0, 0] * v[3, c] + E[0, 1] * v[4, c] + E[0, 2] * v[5, c]) * w[2] - out[2, c] * w[1]
        out[4, c] = (E[2, 0] * v[0, c] + E[2, 1] * v[1, c] + E[2, 2] * v[2, c]) * w[3]
        out[5, c] = (E[2, 0] * v[3, c] + E[2, 1] * v[4, c] + E[2, 2] * v[5, c]) * w[4]


@njit(cache=True)
def whitener(length, theta, w):
    """Fill w (5,): the inverse Cholesky factor of the noise in the lever's axes; return log det of the noise.

    There it falls into two equal blocks, (tx, wy) and (-ty, wx), and the two singles tz, wz:
    [[a + l^2 c, l c], [l c, b + c]], a and b + c, with theta = (a, b, c) the variances of the translation, of the
    camera's orientation and of the robot's.
    """
    a, b, c = theta[0], theta[1], theta[2]
    v00 = a + length * length * c
    determinant = a * (b + c) + length * length * b * c
    w[0] = 1.0 / sqrt(v00)
    w[2] = sqrt(v00 / determinant)
    w[1] = length * c * w[0] * w[2]
    w[3] = 1.0 / sqrt(a)
    w[4] = 1.0 / sqrt(b + c)
    return 2.0 * log(determinant) + log(a) + log(b + c)


@njit(cache=True)
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
        residual(Rx, tx, Rz, tz, gamma, Rf[i], tf[i], Rb[i], tb[i], raw[:, 0], P, t_hat, work)
        jacobian(Rx, gamma, raw[:, 0], P, t_hat, full)
        lever[i] = lever_frame(Rx, tx, gamma, Rf[i], tf[i], t_hat, to_hand, E)
        total += whitener(lever[i], theta, w)
        to_lever(E, w, raw, one)
        e[i] = one[:, 0]
        to_lever(E, w, full, J[i])
    return total


@njit(cache=True)
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


@njit(cache=True)
def shapes(length, theta, w, q):
    """Fill q (3, 5): of each variance the whitened derivative of the noise: block (00, 01, 11), single t, single w."""
    whitener(length, theta, w)
    for k in range(3):  # every derivative is u u' in the block: (1, 0), (0, 1), (length, 1)
        u0 = w[0] if k == 0 else (0.0 if k == 1 else w[0] * length)
        u1 = -w[1] * u0 if k == 0 else w[2] - w[1] * u0
        q[k, 0], q[k, 1], q[k, 2] = u0 * u0, u0 * u1, u1 * u1
        q[k, 3] = w[3] * w[3] if k == 0 else 0.0
        q[k, 4] = 0.0 if k == 0 else w[4] * w[4]


@njit(cache=True)
def variance_step(e, J, C, lever, theta, keep, score, information):
    """Fill score (3,) and expected information (3, 3) of the restricted likelihood by the variances.

    C (m, m) is the covariance of the parameters. Restricted maximum likelihood (Patterson, Thompson 1971); the
    information is that of known parameters, lowered by the share of the residuals that they use up.
    """
    n, _, m = J.shape
    score[:] = 0.0
    information[:] = 0.0
    w = np.empty(5)
    q = np.empty((3, 5))
    CJ = np.empty((6, m))
    M = np.empty(8)
    used = 0
    for i in range(n):
        if not keep[i]:
            continue
        used += 6
        shapes(lever[i], theta, w, q)
        for a in range(6):
            for b in range(m):
                CJ[a, b] = 0.0
            for c in range(m):
                f = J[i, a, c]
                for b in range(m):
                    CJ[a, b] += f * C[c, b]
        for a in range(8):
            r, c = (a, a) if a < 6 else (2 * a - 12, 2 * a - 11)  # the diagonal, then (0, 1) and (2, 3)
            s = (1.0 if r == c else 0.0) - e[i, r] * e[i, c]
            for b in range(m):
                s -= J[i, c, b] * CJ[r, b]
            M[a] = s
        for k in range(3):
            score[k] -= 0.5 * (q[k, 0] * (M[0] + M[2]) + 2.0 * q[k, 1] * (M[6] + M[7]) + q[k, 2] * (M[1] + M[3]))
            score[k] -= 0.5 * (q[k, 3] * M[4] + q[k, 4] * M[5])
            for j in range(k + 1):
                block = q[k, 0] * q[j, 0] + 2.0 * q[k, 1] * q[j, 1] + q[k, 2] * q[j, 2]
                information[k, j] += block + 0.5 * (q[k, 3] * q[j, 3] + q[k, 4] * q[j, 4])
    share = max(used - m, 1) / max(used, 1)
    for k in range(3):
        for j in range(k + 1):
            information[k, j] *= share
            information[j, k] = information[k, j]


@njit(cache=True)
def scoring_step(theta, score, information, floor, out):
    """Fill out (3,) with the scoring step of the variances; those at their floor that would fall stay."""
    out[:] = theta
    index = np.empty(3, np.int64)
    count = 0
    for k in range(3):
        if theta[k] > floor[k] or score[k] > 0.0:
            index[count] = k
            count += 1
    if count == 0:
        return
    A = np.empty((count, count))
    b = np.empty(count)
    step = np.empty(count)
    for r in range(count):
        for c in range(count):
            A[r, c] = information[index[r], index[c]]
        A[r, r] *= 1.0 + 1e-9
        b[r] = -score[index[r]]
    if not solve_damped(A, b, 0.0, step):
        return
    for r in range(count):
        out[index[r]] = max(theta[index[r]] + step[r], floor[index[r]])
    out[0] = max(out[0], 0.1 * theta[0])
    if out[1] + out[2] < 0.1 * (theta[1] + theta[2]):
        out[1], out[2] = 0.1 * theta[1], 0.1 * theta[2]


@njit(cache=True)
def factor_invert(H, L, C):
    """Fill L (m, m) with the Cholesky factor of H and C with its inverse; return log det H, NaN where not SPD."""
    m = H.shape[0]
    total = 0.0
    for i in range(m):
        for j in range(i + 1):
            s = H[i, j]
            for k in range(j):
                s -= L[i, k] * L[j, k]
            if i == j:
                if not s > 1e-15 * H[i, i]:
                    return np.nan
                L[i, i] = sqrt(s)
                total += log(s)
            else:
                L[i, j] = s / L[j, j]
    for j in range(m):  # upper triangle of L: the inverse factor, transposed
        for i in range(j, m):
            s = 1.0 if i == j else 0.0
            for k in range(j, i):
                s -= L[i, k] * C[j, k]
            C[j, i] = s / L[i, i]
    for i in range(m):
        for j in range(i, m):
            s = 0.0
            for k in range(j, m):
                s += C[i, k] * C[j, k]
            C[i, j] = s
    for i in range(m):
        for j in range(i):
            C[i, j] = C[j, i]
    return total


@njit(cache=True)
def move(X, Z, gamma, step, n_free):
    """Return X, Z, gamma moved by the step (n_free,)."""
    Rx, tx = X
    Rz, tz = Z
    Rx2, Rz2 = np.empty((3, 3)), np.empty((3, 3))
    rotate_left(step[3:6], Rx, Rx2)
    rotate_left(step[9:12], Rz, Rz2)
    if n_free > 12:
        gamma = gamma + step[12]
    return (Rx2, tx + step[0:3]), (Rz2, tz + step[6:9]), gamma


@njit(cache=True)
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
                best[:] = theta
                best_likelihood = likelihood
                variance_step(e, J, C, lever, theta, keep, score, information)
                scoring_step(theta, score, information, floor, new)
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
        theta[:] = new
        if size < tolerance and change < tolerance:
            return True, X, Z, gamma, theta, C, e, J, lever, likelihood, iteration + 1
    return False, X, Z, gamma, theta, C, e, J, lever, likelihood, limit


@njit(cache=True)
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
    sums /= max(3 * used - 6, 1)
    theta = np.empty(3)
    theta[0] = max(sums[0], floor[0])
    theta[1] = max(0.7 * sums[1], floor[1])
    theta[2] = max(0.3 * sums[1], floor[2])
    return theta


@njit(cache=True)
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
    rhs = np.empty(6)
    y = np.empty(6)
    step = np.zeros(13)
    P = np.empty((3, 3))
    t_hat = np.empty(3)
    work = np.empty((2, 3, 3))
    for i in range(n):
        M = J[i] @ C @ J[i].T
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
