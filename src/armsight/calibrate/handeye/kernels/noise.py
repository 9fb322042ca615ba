"""Compiled noise of the hand-eye fit: its axes, its whitening, and the scoring of its variances.

theta (3,) holds three variances: of the translation (the robot's and the camera's together: they act alike), of the
camera's orientation, and of the robot's orientation, which reaches the target through its lever.
"""

from __future__ import annotations

from math import log, sqrt
from typing import Any, NamedTuple

import numpy as np

from armsight._numba import inner_kernel, kernel
from armsight.fitting.kernels import solve_damped
from armsight.geometry.kernels import copy_1


class Search(NamedTuple):
    """Where the search for the variances stands.

    best (3,): those of the highest likelihood so far. last (3,): their last change. score (3,), information (3, 3):
    room. state (2,): the share of a scoring step that is taken, and the highest likelihood so far.
    """

    best: Any
    last: Any
    score: Any
    information: Any
    state: Any


@kernel
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
        E[:] = 0.0
        for i in range(3):
            E[i, i] = 1.0
        return 0.0
    for j in range(3):
        E[2, j] = z[j] / length
    # any two axes square to the lever will do; built from the unit vector most across it they are never ill-conditioned
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


@inner_kernel
def to_lever(E, w, v, out):
    """Fill out (6, m) with the columns of v (6, m) turned into the lever's axes and whitened by w of `whitener`."""
    for c in range(out.shape[1]):
        out[0, c] = (E[0, 0] * v[0, c] + E[0, 1] * v[1, c] + E[0, 2] * v[2, c]) * w[0]
        out[1, c] = (E[1, 0] * v[3, c] + E[1, 1] * v[4, c] + E[1, 2] * v[5, c]) * w[2] - out[0, c] * w[1]
        out[2, c] = -(E[1, 0] * v[0, c] + E[1, 1] * v[1, c] + E[1, 2] * v[2, c]) * w[0]
        out[3, c] = (E[0, 0] * v[3, c] + E[0, 1] * v[4, c] + E[0, 2] * v[5, c]) * w[2] - out[2, c] * w[1]
        out[4, c] = (E[2, 0] * v[0, c] + E[2, 1] * v[1, c] + E[2, 2] * v[2, c]) * w[3]
        out[5, c] = (E[2, 0] * v[3, c] + E[2, 1] * v[4, c] + E[2, 2] * v[5, c]) * w[4]


@inner_kernel
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


@kernel
def shapes(length, theta, w, q):
    """Fill q (3, 5): of each variance the whitened derivative of the noise: block (00, 01, 11), single t, single w."""
    whitener(length, theta, w)
    for k in range(3):  # every derivative is u u' in the block: (1, 0), (0, 1), (length, 1)
        u0 = w[0] if k == 0 else (0.0 if k == 1 else w[0] * length)
        u1 = -w[1] * u0 if k == 0 else w[2] - w[1] * u0
        q[k, 0], q[k, 1], q[k, 2] = u0 * u0, u0 * u1, u1 * u1
        q[k, 3] = w[3] * w[3] if k == 0 else 0.0
        q[k, 4] = 0.0 if k == 0 else w[4] * w[4]


@inner_kernel
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
            # 1 - e e' - J C J' of the whitened pair, where the shapes have entries: d log L / d theta_k is -1/2 tr Q_k
            # times it
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


@inner_kernel
def scoring_step(theta, score, information, floor, out):
    """Fill out (3,) with the scoring step of the variances; those at their floor that would fall stay."""
    copy_1(theta, out)
    index = np.empty(3, np.int64)
    count = 0
    for k in range(3):
        # one at its floor that wants to fall is no unknown: kept, it would hold the others back
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
    # a quadratic model far from the maximum may ask for less than nothing: no step takes more than nine tenths
    out[0] = max(out[0], 0.1 * theta[0])
    if out[1] + out[2] < 0.1 * (theta[1] + theta[2]):
        out[1], out[2] = 0.1 * theta[1], 0.1 * theta[2]


@inner_kernel
def next_variances(likelihood, near, theta, floor, observed, whitened, search, new):
    """Fill new (3,) with the variances after those of this restricted likelihood; return their largest relative change.

    near: whether the last step was one of these. whitened: e (n, 6), J (n, 6, m), C (m, m), lever (n,).
    """
    e, J, C, lever = whitened
    best, last, state = search.best, search.last, search.state
    # Fisher scoring promises no ascent: a step that lost likelihood is halved towards the best so far
    if near and likelihood < state[1] - 1e-7:
        for k in range(3):
            new[k] = 0.5 * (theta[k] + best[k])
    else:
        copy_1(theta, best)
        state[1] = likelihood
        variance_step(e, J, C, lever, theta, observed[1], search.score, search.information)
        scoring_step(theta, search.score, search.information, floor, new)
        turned = 0.0  # steps that go to and fro overshoot: shorten them until they do not
        for k in range(3):
            turned += (new[k] - theta[k]) * last[k] / (theta[min(k, 1)] + theta[2 * min(k, 1)]) ** 2
        state[0] = max(0.5 * state[0], 0.1) if turned < 0.0 else min(1.5 * state[0], 1.0)
        for k in range(3):
            last[k] = new[k] - theta[k]
            new[k] = theta[k] + state[0] * last[k]
    # orientation's two variances are hard to tell apart: each is measured by their sum, which is well known
    change = abs(new[0] - theta[0]) / theta[0]
    for k in range(1, 3):
        change = max(change, abs(new[k] - theta[k]) / (theta[1] + theta[2]))
    return change


@inner_kernel
def scaled_variances(theta, floor, keep, cost, m, new):
    """Fill new (3,) with theta scaled to the sum of squares that the m parameters leave: what is right far away."""
    used = 0
    for i in range(keep.shape[0]):
        used += 6 if keep[i] else 0
    factor = max(cost / max(used - m, 1), 1e-3)
    for k in range(3):
        new[k] = max(theta[k] * factor, floor[k])


@inner_kernel
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
