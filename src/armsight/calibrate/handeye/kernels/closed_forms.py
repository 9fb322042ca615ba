"""Compiled starts of the hand-eye fit: closed forms, and the consensus of most pairs against gross errors.

F_i X B_i = Z, with F the robot's pose as the fit sees it (see kernels.fit), rotations RF, RX, RB, RZ.
"""

from __future__ import annotations

from math import sqrt

import numpy as np

from armsight._numba import inner_kernel, kernel
from armsight.fitting.kernels import solve_damped
from armsight.geometry.kernels import copy_1, rotvec_of

MEDIAN_NORM = 1.538
"""Median length of a vector of three standard normals."""

GENEROUS = 6.0
"""Robust standard deviations up to which a pair joins the consensus: with ten pairs the standard deviation is known to
a quarter."""


@kernel
def rotvecs(R):
    """Return the rotation vectors (n, 3) of R (n, 3, 3)."""
    out = np.empty((R.shape[0], 3))
    for i in range(R.shape[0]):
        rotvec_of(R[i], out[i])
    return out


@inner_kernel
def multiply(A, B, out):
    """Fill out (3, 3) with A B."""
    for i in range(3):
        for j in range(3):
            out[i, j] = A[i, 0] * B[0, j] + A[i, 1] * B[1, j] + A[i, 2] * B[2, j]


@inner_kernel
def multiply_t(A, B, out):
    """Fill out (3, 3) with A B'."""
    for i in range(3):
        for j in range(3):
            out[i, j] = A[i, 0] * B[j, 0] + A[i, 1] * B[j, 1] + A[i, 2] * B[j, 2]


@inner_kernel
def det_3(M):
    """Return the determinant of M (3, 3)."""
    return (
        M[0, 0] * (M[1, 1] * M[2, 2] - M[1, 2] * M[2, 1])
        - M[0, 1] * (M[1, 0] * M[2, 2] - M[1, 2] * M[2, 0])
        + M[0, 2] * (M[1, 0] * M[2, 1] - M[1, 1] * M[2, 0])
    )


@inner_kernel
def project_rotation(M):
    """Return the rotation (3, 3) nearest to M, or to -M where that has the positive determinant."""
    U, _, Vt = np.linalg.svd(M)
    R = np.empty((3, 3))
    multiply(U, Vt, R)
    # a singular vector's sign is free, and with it that of the determinant
    if det_3(R) < 0.0:
        for i in range(3):
            for j in range(3):
                R[i, j] = -R[i, j]
    return R


@kernel
def shah_rotations(Rf, Rb, keep):
    """Return RX, RZ of RF RX RB = RZ from the dominant singular vectors of the sum of RF (x) RB' (Shah 2013)."""
    # With vec row by row RF RX RB = RZ is (RF (x) RB') vec RX = vec RZ. Every term is orthogonal, so that their sum
    # makes nothing more than n times as long: of exact pairs vec RX and vec RZ are its dominant singular vectors
    K = np.zeros((9, 9))
    for n in range(Rf.shape[0]):
        if keep[n]:
            for i in range(3):
                for k in range(3):
                    f = Rf[n, i, k]
                    for j in range(3):
                        for m in range(3):
                            K[3 * i + j, 3 * k + m] += f * Rb[n, m, j]
    Vt = np.linalg.svd(K)[2]
    M = np.empty((3, 3))
    for i in range(3):
        for j in range(3):
            M[i, j] = Vt[0, 3 * i + j]
    RX = project_rotation(M)
    return RX, mean_target(RX, Rf, Rb, keep)


@kernel
def mean_target(RX, Rf, Rb, keep):
    """Return RZ nearest to all RF RX RB."""
    total = np.zeros((3, 3))
    a = np.empty((3, 3))
    b = np.empty((3, 3))
    for n in range(Rf.shape[0]):
        if keep[n]:
            multiply(Rf[n], RX, a)
            multiply(a, Rb[n], b)
            for i in range(3):
                for j in range(3):
                    total[i, j] += b[i, j]
    return project_rotation(total)


@kernel
def translations(RX, Rf, tf, tb, keep, free_scale):
    """Return ok, tX, tZ, gamma of tB = gamma (P (tZ - tF) - RX' tX) by linear least squares, gamma 1 unless free."""
    # with the scale free the unknowns are gamma tZ, gamma tX and gamma, in which the equation is linear
    m = 7 if free_scale else 6
    H = np.zeros((m, m))
    g = np.zeros(m)
    row = np.zeros((3, 7))
    for n in range(Rf.shape[0]):
        if not keep[n]:
            continue
        for i in range(3):
            row[i, 6] = 0.0
            for j in range(3):
                row[i, j] = RX[0, i] * Rf[n, j, 0] + RX[1, i] * Rf[n, j, 1] + RX[2, i] * Rf[n, j, 2]
                row[i, 3 + j] = -RX[j, i]
            for j in range(3):
                row[i, 6] -= row[i, j] * tf[n, j]
            y = tb[n, i] if free_scale else tb[n, i] - row[i, 6]
            for a in range(m):
                g[a] -= row[i, a] * y
                for b in range(m):
                    H[a, b] += row[i, a] * row[i, b]
    x = np.zeros(7)
    x[6] = 1.0
    ok = solve_damped(H, g, 1e-13, x[:m])
    tX, tZ = np.empty(3), np.empty(3)
    for i in range(3):
        tX[i] = x[3 + i] / x[6]
        tZ[i] = x[i] / x[6]
    return ok, tX, tZ, x[6]


@inner_kernel
def robust_sigma(errors):
    """Return the standard deviation of one component from the lengths of residuals (n,), most of them good.

    The four pairs that made the solution fit it by themselves: the median of few is raised for that (Rousseeuw, Leroy
    1987).
    """
    n = errors.shape[0]
    return max(np.median(errors) / MEDIAN_NORM * (1.0 + 5.0 / max(n - 3, 1)), 1e-15)


@inner_kernel
def sample_rotation(Rf, Rb, index):
    """Return RX from the motions within a few pairs: their rotation vectors turned onto each other (Kabsch)."""
    # Motions within the sample are free of Z: (F_q^-1 F_p) X = X (B_q B_p^-1), so that RX turns the camera's rotation
    # vectors onto the robot's (Park, Martin 1994)
    M = np.zeros((3, 3))
    R = np.empty((3, 3))
    RT = np.empty((3, 3))
    a = np.empty(3)
    b = np.empty(3)
    count = index.shape[0]
    for i in range(count):
        for j in range(i):
            p, q = index[i], index[j]
            for r in range(3):
                for c in range(3):
                    RT[r, c] = Rf[q, c, r]
            multiply(RT, Rf[p], R)
            rotvec_of(R, a)
            multiply_t(Rb[q], Rb[p], R)
            rotvec_of(R, b)
            for r in range(3):
                for c in range(3):
                    M[r, c] += a[r] * b[c]
    U, _, Vt = np.linalg.svd(M)
    multiply(U, Vt, R)
    if det_3(R) < 0.0:
        for i in range(3):
            U[i, 2] = -U[i, 2]
        multiply(U, Vt, R)
    return R


@inner_kernel
def rotation_errors(RX, RZ, Rf, Rb, out):
    """Fill out (n,) with the angle between RF RX RB and RZ."""
    P = np.empty((3, 3))
    Q = np.empty((3, 3))
    w = np.empty(3)
    for i in range(Rf.shape[0]):
        multiply(Rf[i], RX, P)
        multiply(P, Rb[i], Q)
        multiply_t(Q, RZ, P)
        rotvec_of(P, w)
        out[i] = sqrt(w[0] * w[0] + w[1] * w[1] + w[2] * w[2])


@inner_kernel
def translation_errors(RX, tX, tZ, gamma, Rf, tf, tb, out):
    """Fill out (n,) with the distance between tB and its prediction, in the camera's unit."""
    y = np.empty(3)
    for n in range(Rf.shape[0]):
        for j in range(3):
            y[j] = -tX[j]
            for c in range(3):
                y[j] += Rf[n, c, j] * (tZ[c] - tf[n, c])
        total = 0.0
        for i in range(3):
            d = tb[n, i] - gamma * (RX[0, i] * y[0] + RX[1, i] * y[1] + RX[2, i] * y[2])
            total += d * d
        out[n] = sqrt(total)


@inner_kernel
def agreeing(errors, sigma, keep):
    """Fill keep (n,): which errors (n,) are not gross beside the robust standard deviation sigma."""
    for i in range(errors.shape[0]):
        keep[i] = errors[i] < GENEROUS * sigma


@kernel
def rotation_consensus(Rf, Rb, samples, keep, errors):
    """Return RX, RZ that most pairs agree on, and the robust standard deviation of one component in rad; fill keep,
    errors.

    Least median of squares over the samples (S, 4) (Rousseeuw 1984), then Shah's closed form on those that agree.
    """
    n = Rf.shape[0]
    best = np.inf
    mask = np.zeros(n, np.bool_)
    RX, RZ = np.eye(3), np.eye(3)
    for s in range(samples.shape[0]):
        mask[:] = False
        for i in samples[s]:
            mask[i] = True
        R = sample_rotation(Rf, Rb, samples[s])
        T = mean_target(R, Rf, Rb, mask)
        rotation_errors(R, T, Rf, Rb, errors)
        middle = np.median(errors)
        if middle < best:
            best, RX, RZ = middle, R, T
    rotation_errors(RX, RZ, Rf, Rb, errors)
    for _ in range(3):
        sigma = robust_sigma(errors)
        agreeing(errors, sigma, keep)
        RX, RZ = shah_rotations(Rf, Rb, keep)
        rotation_errors(RX, RZ, Rf, Rb, errors)
    sigma = robust_sigma(errors)
    agreeing(errors, sigma, keep)
    return RX, RZ, sigma


@kernel
def translation_consensus(RX, Rf, tf, tb, samples, free_scale, keep, errors):
    """Return ok, tX, tZ, gamma, robust standard deviation in the camera's unit; lower keep to the pairs that agree."""
    n = Rf.shape[0]
    mask = np.zeros(n, np.bool_)
    agreed = keep.copy()
    best = np.inf
    ok, tX, tZ, gamma = translations(RX, Rf, tf, tb, keep, free_scale)
    # first all pairs whose rotations agree, the best start where nothing is gross; then the samples among them
    for s in range(-1, samples.shape[0]):
        if s < 0:
            copy_1(keep, mask)
        else:
            mask[:] = False
            complete = True
            for i in samples[s]:
                mask[i] = True
                complete = complete and keep[i]
            if not complete:
                continue
        good, x, z, c = translations(RX, Rf, tf, tb, mask, free_scale)
        if not good:
            continue
        translation_errors(RX, x, z, c, Rf, tf, tb, errors)
        middle = np.median(errors[keep])
        if middle < best:
            best, ok, tX, tZ, gamma = middle, True, x, z, c
    if not ok:
        return False, tX, tZ, gamma, np.inf
    sigma = np.inf
    for _ in range(3):
        translation_errors(RX, tX, tZ, gamma, Rf, tf, tb, errors)
        sigma = robust_sigma(errors[keep])
        agreeing(errors, sigma, agreed)
        for i in range(n):
            agreed[i] = agreed[i] and keep[i]
        good, x, z, c = translations(RX, Rf, tf, tb, agreed, free_scale)
        if good:
            tX, tZ, gamma = x, z, c
    copy_1(agreed, keep)
    return True, tX, tZ, gamma, sigma
