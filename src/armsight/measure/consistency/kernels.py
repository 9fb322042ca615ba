"""Compiled evidence of one frame on what rig, target and clocks may have wrong.

With the pose fitted, residuals r (predicted minus seen) know of a parameter's error only what the pose cannot take
over: b = D'Wr and N = D'WD - B'H^-1 B with D the pixels' derivatives by the parameters, G by the pose, W the inverse of
the spots' covariances, H = G'WG, B = G'WD. Summed over frames they are all that a fit of the parameters to every
residual, each frame's pose free, would need. The parameters are the rig's 16 v - 6, the target's m (by its basis), and
the times by which the cameras but the first expose later.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from armsight._numba import inner_kernel, kernel
from armsight.fitting.kernels import invert_spd
from armsight.geometry.kernels import copy_2, multiply
from armsight.measure.motion.kernels.state import STATE, N, P, R, state_at
from armsight.measure.motion.kernels.views import ViewK, innovation_covariance, observe, select
from armsight.measure.poses.kernels.rig_covariance import add_information, light_slopes, n_parameters, place_slopes
from armsight.optics.kernels.camera import RigK
from armsight.optics.kernels.triangulation import invert_2, missing


class LightsK(NamedTuple):
    """Lights of the target: X (n, 3) m in its axes, basis (n, 3, m): how they follow the target's m parameters."""

    X: Any
    basis: Any


@kernel
def frame_evidence(rig, target, T, cov, residual, velocity, N, b, S, C):
    """Fill N (q, q), b (q,), S (6, q) = d pose / d parameters, C (6, 6) = H^-1; return chi-square, -1 where singular.

    rig, target: as RigK, LightsK, the n lights seen; under T (4, 4), with cov (n, v, 2, 2), residual (n, v, 2).
    velocity (n, 3) of the lights in rig axes, m/s; 0 where not known.
    """
    rig, target = RigK(*rig), LightsK(*target)
    X, basis = target
    n, m = X.shape[0], basis.shape[2]
    own = n_parameters(rig)
    q = own + m + cov.shape[1] - 1
    B = np.zeros((6, q))
    H = np.zeros((6, 6))
    g = np.zeros(6)
    uv = np.empty(2)
    p = np.empty(3)
    J = np.empty((2, 3))
    E = np.empty((2, 3))
    D = np.empty((2, own))
    W = np.empty((2, 2))
    G = np.empty((2, 6))
    row = np.zeros((2, q))
    N[:] = 0.0
    b[:] = 0.0
    chi2 = 0.0
    for light in range(n):
        for s in range(cov.shape[1]):
            if missing(cov[light, s]):
                continue
            if not (light_slopes(rig, T, X[light], p, s, uv, J, D, G) and invert_2(cov[light, s], W)):
                return -1.0
            place_slopes(J, T, E)
            copy_2(D, row)
            row[:, own:] = 0.0  # of the light before
            add_by_basis(E, basis[light], row[:, own:])
            if s > 0:
                for i in range(2):
                    v = velocity[light]
                    # exposed later, a camera sees the light where its velocity has taken it by then
                    row[i, own + m + s - 1] = J[i, 0] * v[0] + J[i, 1] * v[1] + J[i, 2] * v[2]
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
    # the pose eliminated by the Schur complement: N - B'H^-1 B, b - B'H^-1 g, with S = -H^-1 B
    for j in range(q):
        for i in range(6):
            b[j] += S[i, j] * g[i]  # nothing at the minimum
            for a in range(q):
                N[j, a] += B[i, j] * S[i, a]
    return chi2


@inner_kernel
def add_by_basis(E, basis, row):
    """Add to row (2, m or more) how a pixel follows the target's m parameters.

    E (2, 3): how it follows the light's place; basis (3, m): how that follows the parameters.
    """
    for i in range(2):
        for j in range(basis.shape[1]):
            for a in range(3):
                row[i, j] += E[i, a] * basis[a, j]


@inner_kernel
def view_slopes(predicted, filtered, rig, s, view, light, basis, H, A, e):
    """Fill H (m, 18), A (m, q), zero before, and e (m,): the slopes by state and parameters, and the innovations.

    predicted, filtered: the states before and after the view of side s; light (m / 2,): its lights' rows of basis.
    False where one of them is behind the camera.
    """
    camera = rig.k[s], rig.R[s], rig.t[s]
    T = np.eye(4)
    x = np.empty(STATE)
    position = np.empty(3)
    here = np.empty(2)
    J = np.empty((2, 3))
    E = np.empty((2, 3))
    own = n_parameters(rig)
    D = np.empty((2, own))
    G = np.empty((2, 6))
    for j in range(light.shape[0]):
        at, tau = view.X[j], view.tau[j]
        state_at(filtered, tau, x)
        for c in range(3):
            T[c, 3] = x[P + c]
            for r in range(3):
                T[c, r] = x[R + 3 * c + r]
        seen = observe(predicted, camera, at, tau, here, H[2 * j : 2 * j + 2])
        e[2 * j] = view.uv[j, 0] - here[0]
        e[2 * j + 1] = view.uv[j, 1] - here[1]
        # slopes where the gain has them
        seen &= observe(filtered, camera, at, tau, here, H[2 * j : 2 * j + 2])
        seen &= light_slopes(rig, T, at, position, s, here, J, D, G)
        if not seen:
            return False
        place_slopes(J, T, E)
        copy_2(D, A[2 * j : 2 * j + 2])
        add_by_basis(E, basis[light[j]], A[2 * j : 2 * j + 2, own:])
    return True


@kernel
def run_evidence(views, spots, rig, target, counted, filtered, predicted, sums):
    """As frame_evidence for single views, each at its own time, whose motion the filter eliminates.

    Fill the states' d: how predicted and filtered ones follow the parameters; add to each block's sums. An innovation e
    of covariance S knows of the parameters' error x by A x, A = D + H d: D the pixels' derivatives by the parameters, H
    by the state, d those of the predicted state. So N = A'S^-1 A and b = -A'S^-1 e, summed over views.

    All plain tuples: views, spots, rig, filtered, predicted: as run_filter has them, and leaves the states; target: as
    LightsK, all m of them. counted: weight (n,) and block (n,) of each view. sums: information (B, q, q), score (B, q),
    chi2 (B,). The last column, a delay, stays 0: smoothing has estimated it.
    """
    _, side, first = views
    light, uv, cov, tau = spots
    rig, target = RigK(*rig), LightsK(*target)
    weight, block = counted
    xs, Cs, ds = filtered
    xp, Cp, dp, Fs = predicted
    information, score, chi2 = sums
    q = dp.shape[2]
    for i in range(first.shape[0] - 1):
        dp[i] = 0.0
        if Fs[i, 0, 0] != 0.0:
            multiply(Fs[i], ds[i - 1], dp[i])
        ds[i] = dp[i]
        a, b = first[i], first[i + 1]
        m = 2 * (b - a)
        if m == 0:
            continue
        H = np.zeros((m, N))
        G = np.empty((m, N))
        S = np.empty((m, m))
        inverse = np.empty((m, m))
        A = np.zeros((m, q))
        e = np.empty(m)
        at = np.empty((b - a, 3))
        select(target.X, light[a:b], at)
        view = ViewK(at, tau[a:b], uv[a:b], cov[a:b])
        if not view_slopes(xp[i], xs[i], rig, side[i], view, light[a:b], target.basis, H, A, e):
            continue
        innovation_covariance(H, Cp[i], view.cov, G, S)
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
        ds[i] -= Cs[i] @ (H.T @ by_spot_weights(view.cov, A))


@inner_kernel
def by_spot_weights(cov, A):
    """Return (m, q): A (m, q) times the inverses of the spots' covariances cov (m / 2, 2, 2)."""
    out = np.empty(A.shape)
    for j in range(cov.shape[0]):
        V = cov[j]
        det = V[0, 0] * V[1, 1] - V[0, 1] * V[1, 0]
        for p in range(A.shape[1]):
            out[2 * j, p] = (V[1, 1] * A[2 * j, p] - V[0, 1] * A[2 * j + 1, p]) / det
            out[2 * j + 1, p] = (V[0, 0] * A[2 * j + 1, p] - V[1, 0] * A[2 * j, p]) / det
    return out
