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
from armsight.measure.motion.kernels.state import STATE, N, P, R, multiply_t, state_at
from armsight.measure.motion.kernels.views import observe
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


@kernel
def run_evidence(
    side,
    first,
    light,
    uv,
    cov,
    tau,
    k,
    Rc,
    tc,
    X,
    basis,
    weight,
    block,
    xs,
    xp,
    Cp,
    Cs,
    Fs,
    dp,
    ds,
    information,
    score,
    chi2,
):
    """As frame_evidence for single views, each at its own time, whose motion the filter eliminates.

    Fill dp, ds (n, 18, q): how predicted and filtered states follow the parameters; add to each block's sums. An
    innovation e of covariance S knows of the parameters' error x by A x, A = D + H d: D the pixels' derivatives by the
    parameters, H by the state, d those of the predicted state. So N = A'S^-1 A and b = -A'S^-1 e, summed over views.

    weight, block (n,): of each view, and the block it counts for; information (B, q, q), score (B, q), chi2 (B,). xs,
    xp, Cp, Cs, Fs: as run_filter leaves them. basis (m, 3, p): as target_basis has it. The
    last column, a delay, stays 0: smoothing has estimated it.
    """
    q = dp.shape[2]
    T = np.eye(4)
    x = np.empty(STATE)
    place = np.empty(3)
    here = np.empty(2)
    J = np.empty((2, 3))
    E = np.empty((2, 3))
    D = np.empty((2, PARAMETERS))
    G6 = np.empty((2, 6))
    for i in range(first.shape[0] - 1):
        dp[i] = 0.0
        if Fs[i, 0, 0] != 0.0:
            multiply(Fs[i], ds[i - 1], dp[i])
        ds[i] = dp[i]
        a, s = first[i], side[i]
        m = 2 * (first[i + 1] - a)
        if m == 0:
            continue
        H = np.zeros((m, N))
        G = np.empty((m, N))
        S = np.empty((m, m))
        inverse = np.empty((m, m))
        A = np.zeros((m, q))
        e = np.empty(m)
        seen = True
        for j in range(m // 2):
            at = X[light[a + j]]
            state_at(xs[i], tau[a + j], x)
            for c in range(3):
                T[c, 3] = x[P + c]
                for r in range(3):
                    T[c, r] = x[R + 3 * c + r]
            seen &= observe(xp[i], k[s], Rc[s], tc[s], at, tau[a + j], here, H[2 * j : 2 * j + 2])
            e[2 * j] = uv[a + j, 0] - here[0]
            e[2 * j + 1] = uv[a + j, 1] - here[1]
            # slopes where the gain has them
            seen &= observe(xs[i], k[s], Rc[s], tc[s], at, tau[a + j], here, H[2 * j : 2 * j + 2])
            seen &= light_slopes(k, Rc, tc, T, at, place, s, here, J, D, G6)
            if not seen:
                break
            place_slopes(J, T, E)
            for c in range(2):
                for p in range(PARAMETERS):
                    A[2 * j + c, p] = D[c, p]
                for p in range(basis.shape[2]):
                    for r in range(3):
                        A[2 * j + c, PARAMETERS + p] += E[c, r] * basis[light[a + j], r, p]
        if not seen:
            continue
        multiply(H, Cp[i], G)
        multiply_t(G, H, S)
        for j in range(m // 2):
            for c in range(2):
                for r in range(2):
                    S[2 * j + c, 2 * j + r] += cov[a + j, c, r]
        if not invert_spd(S, inverse):
            continue
        for j in range(m):
            for p in range(q):
                for c in range(N):
                    A[j, p] += H[j, c] * dp[i, c, p]
        SA = inverse @ A
        w = weight[i]
        o = block[i]
        for j in range(m):
            for c in range(m):
                chi2[o] += w * e[j] * inverse[j, c] * e[c]
            for p in range(q):
                score[o, p] -= w * e[j] * SA[j, p]
        information[o] += w * (A.T @ SA)
        # the gain, C H' / cov with the covariance afterwards, turns what is missed into the state
        RA = np.empty((m, q))
        for j in range(m // 2):
            V = cov[a + j]
            det = V[0, 0] * V[1, 1] - V[0, 1] * V[1, 0]
            for p in range(q):
                RA[2 * j, p] = (V[1, 1] * A[2 * j, p] - V[0, 1] * A[2 * j + 1, p]) / det
                RA[2 * j + 1, p] = (V[0, 0] * A[2 * j + 1, p] - V[1, 0] * A[2 * j, p]) / det
        ds[i] -= Cs[i] @ (H.T @ RA)
