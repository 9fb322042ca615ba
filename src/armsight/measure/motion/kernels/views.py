"""Compiled: what one view, or one complete pose, tells of a state."""

from __future__ import annotations

from math import sqrt
from typing import Any, NamedTuple

import numpy as np

from armsight._numba import inner_kernel, kernel, lean_kernel
from armsight.fitting.kernels import invert_spd
from armsight.measure.motion.kernels.state import (
    STATE,
    A,
    N,
    P,
    R,
    V,
    difference,
    move,
    multiply,
    multiply_t,
    turned,
)
from armsight.optics.kernels.camera import see_point

UPDATE_ROUNDS = 4
"""Gauss-Newton steps of an update at the most; two are enough unless the state was a guess."""
SETTLED2 = 1e-4
"""Square of a step over its own uncertainty below which an update has settled."""


class ViewK(NamedTuple):
    """n lights in one view: X (n, 3) m in the target's frame, and their spots uv (n, 2) px, cov (n, 2, 2) px^2.

    tau (n,): by how many seconds each is exposed after the view's time.
    """

    X: Any
    tau: Any
    uv: Any
    cov: Any


@lean_kernel
def select(X, light, out):
    """Fill out (n, 3) with the rows light (n,) of X."""
    for i in range(light.shape[0]):
        for c in range(3):
            out[i, c] = X[light[i], c]


@kernel
def observe(x, camera, X, tau, uv, H):
    """Fill uv (2,) and H (2, 18): where a light at X of the target is seen tau after the state's time.

    False where it is behind the camera, in the order of CameraK: a plain tuple for all callers, one compilation.
    """
    k, Rc, tc = camera
    E = np.empty((3, 3))
    turned(x, tau, E)
    r = np.empty(3)
    y = np.empty(3)
    for i in range(3):
        r[i] = x[R + 3 * i] * X[0] + x[R + 3 * i + 1] * X[1] + x[R + 3 * i + 2] * X[2]
    for i in range(3):
        y[i] = E[i, 0] * r[0] + E[i, 1] * r[1] + E[i, 2] * r[2]
    position = np.empty(3)
    for i in range(3):
        # constant acceleration over tau, as in state_at; jerk is but noise
        position[i] = x[P + i] + tau * x[V + i] + 0.5 * tau * tau * x[A + i] + y[i]
    J = np.empty((2, 3))
    if not see_point(k, Rc, tc, position, uv, J):
        return False
    h = 0.5 * tau * tau
    for m in range(2):
        # J . (w x y) = w . (y x J); before the turn E: w . (r x E'J)
        c0 = y[1] * J[m, 2] - y[2] * J[m, 1]
        c1 = y[2] * J[m, 0] - y[0] * J[m, 2]
        c2 = y[0] * J[m, 1] - y[1] * J[m, 0]
        e0 = E[0, 0] * J[m, 0] + E[1, 0] * J[m, 1] + E[2, 0] * J[m, 2]
        e1 = E[0, 1] * J[m, 0] + E[1, 1] * J[m, 1] + E[2, 1] * J[m, 2]
        e2 = E[0, 2] * J[m, 0] + E[1, 2] * J[m, 1] + E[2, 2] * J[m, 2]
        H[m, 3] = r[1] * e2 - r[2] * e1
        H[m, 4] = r[2] * e0 - r[0] * e2
        H[m, 5] = r[0] * e1 - r[1] * e0
        H[m, 9], H[m, 10], H[m, 11] = tau * c0, tau * c1, tau * c2
        H[m, 15], H[m, 16], H[m, 17] = h * c0, h * c1, h * c2
        for i in range(3):
            H[m, i] = J[m, i]
            H[m, 6 + i] = tau * J[m, i]
            H[m, 12 + i] = h * J[m, i]
    return True


@kernel
def observe_all(x, camera, X, tau, uv, H):
    """As observe, of the lights X (m, 3), each at its own tau (m,): uv (m, 2), H (2 m, 18)."""
    seen = True
    for i in range(X.shape[0]):
        seen &= observe(x, camera, X[i], tau[i], uv[i], H[2 * i : 2 * i + 2])
    return seen


@kernel
def choose(expected, light, spots, gate2, kept):
    """Fill kept with the spots within the gate of their light, and the only ones that are; return how many, chi-square.

    expected: uv (m, 2) and S (2 m, 2 m) of the lights; light (n,): which of them each spot may be; spots: uv (n, 2),
    cov (n, 2, 2). Chi-square is of the kept ones together, infinite where it cannot be told.
    """
    at, S = expected
    uv, cov = spots
    count = np.int64(0)
    for i in range(at.shape[0]):
        near = np.int64(0)
        for k in range(light.shape[0]):
            if light[k] != i:
                continue
            x, y = uv[k, 0] - at[i, 0], uv[k, 1] - at[i, 1]
            a, c = S[2 * i, 2 * i] + cov[k, 0, 0], S[2 * i + 1, 2 * i + 1] + cov[k, 1, 1]
            b = S[2 * i, 2 * i + 1] + cov[k, 0, 1]
            # the whitened square of the distance below the gate, both sides times the determinant
            if c * x * x - 2.0 * b * x * y + a * y * y < gate2 * (a * c - b * b):
                kept[count] = k
                near += 1
                if near == 2:
                    break
        count += near == 1
    # lights move together: their joint covariance, with each spot's own on the diagonal
    T, r = np.empty((2 * count, 2 * count)), np.empty(2 * count)
    for p in range(count):
        i = light[kept[p]]
        for c in range(2):
            r[2 * p + c] = uv[kept[p], c] - at[i, c]
            for q in range(count):
                for d in range(2):
                    T[2 * p + c, 2 * q + d] = S[2 * i + c, 2 * light[kept[q]] + d]
            for d in range(2):
                T[2 * p + c, 2 * p + d] += cov[kept[p], c, d]
    inverse = np.empty_like(T)
    if not invert_spd(T, inverse):
        return count, np.inf
    chi2 = 0.0
    for c in range(2 * count):
        for d in range(2 * count):
            chi2 += r[c] * inverse[c, d] * r[d]
    return count, chi2


@inner_kernel
def update(x, C, camera, view, residual):
    """Bring the spots of one view (a ViewK) into the state x, C at its time.

    Iterated: linearised anew at the answer (Bell and Cathey 1993). x, C are changed in place; residual (n, 2): spots
    less prediction. Returns (chi-square of the innovation, log of its determinant); -1 where something is behind the
    camera or nothing can be solved; the state is then as it was.
    """
    uv, cov = view.uv, view.cov
    n = uv.shape[0]
    m = 2 * n
    H = np.empty((m, N))
    G = np.empty((m, N))
    S = np.empty((m, m))
    T = np.empty((m, m))
    r = np.empty(m)
    e = np.empty(m)
    d = np.zeros(N)
    px = np.empty(2)
    # the state itself moves once all has been solved
    z = x.copy()
    chi2 = -1.0
    logdet = 0.0
    for turn in range(UPDATE_ROUNDS):
        for i in range(n):
            if not observe(z, camera, view.X[i], view.tau[i], px, H[2 * i : 2 * i + 2]):
                return -1.0, 0.0
            r[2 * i] = uv[i, 0] - px[0]
            r[2 * i + 1] = uv[i, 1] - px[1]
        if turn == 0:
            for i in range(n):
                residual[i, 0] = r[2 * i]
                residual[i, 1] = r[2 * i + 1]
        innovation_covariance(H, C, cov, G, S)
        if not invert_spd(S, T):
            return -1.0, 0.0
        for i in range(m):  # innovation about the first prediction: r + H d
            s = r[i]
            for j in range(N):
                s += H[i, j] * d[j]
            e[i] = s
        if turn == 0:
            # of the prediction alone: later rounds have used these spots, and would flatter the level of jerk
            chi2 = quadratic_form(T, e)
            logdet = log_determinant(S)
        change = step_by_gain(G, T, e, C, d)
        for j in range(STATE):
            z[j] = x[j]
        move(z, d)
        if change < SETTLED2:
            break
    lower_covariance(G, T, C)
    for j in range(STATE):
        x[j] = z[j]
    return chi2, logdet


@lean_kernel
def innovation_covariance(H, C, cov, G, S):
    """Fill G (m, 18) = H C and S (m, m) = H C H' + cov, for spots of covariance cov (n, 2, 2), m = 2 n."""
    multiply(H, C, G)
    multiply_t(G, H, S)
    for i in range(cov.shape[0]):
        for a in range(2):
            for b in range(2):
                S[2 * i + a, 2 * i + b] += cov[i, a, b]


@lean_kernel
def quadratic_form(T, e):
    """Return e' T e for T (m, m), e (m,)."""
    s = 0.0
    for i in range(e.shape[0]):
        for j in range(e.shape[0]):
            s += e[i] * T[i, j] * e[j]
    return s


@lean_kernel
def step_by_gain(G, T, e, C, d):
    """Replace the error d (18,) by K e, the gain K = G' T; return the squared change over the state's variances.

    K = C H' S^-1 (Bar-Shalom, Li and Kirubarajan 2001, section 5.2.3), with G = H C (m, 18) and T = S^-1 (m, m).
    """
    m = e.shape[0]
    change = 0.0
    for j in range(N):
        s = 0.0
        for i in range(m):
            t = 0.0
            for q in range(m):
                t += T[i, q] * e[q]
            s += G[i, j] * t
        step = s - d[j]
        change += step * step / C[j, j]
        d[j] = s
    return change


@inner_kernel
def lower_covariance(G, T, C):
    """Replace C (18, 18) by C - G' T G, that after the update; only half is computed, so that it stays symmetric."""
    m = G.shape[0]
    D = np.empty((m, N))
    multiply(T, G, D)
    for i in range(N):
        for j in range(i + 1):
            s = C[i, j]
            for q in range(m):
                s -= G[q, i] * D[q, j]
            C[i, j] = s
            C[j, i] = s


@lean_kernel
def pose_innovation(x, C, x_seen, cov, d, S, inverse):
    """Fill the pose's innovation d (18,), of which 6 count, its covariance S (6, 6) and inverse; return chi-square."""
    difference(x_seen, x, d)
    for i in range(6):
        for j in range(6):
            S[i, j] = C[i, j] + cov[i, j]
    if not invert_spd(S, inverse):
        return 1e300
    chi2 = 0.0
    for i in range(6):
        for j in range(6):
            chi2 += d[i] * inverse[i, j] * d[j]
    return chi2


@inner_kernel
def pose_distance2(x, C, x_seen, cov):
    """Return the squared Mahalanobis distance of a measured pose from where the state has it."""
    return pose_innovation(x, C, x_seen, cov, np.empty(N), np.empty((6, 6)), np.empty((6, 6)))


@inner_kernel
def update_pose(x, C, x_seen, cov):
    """Bring the pose of x_seen (24,) with cov (6, 6) into a state, in place; return chi-square and log determinant."""
    d = np.empty(N)
    S = np.empty((6, 6))
    inverse = np.empty((6, 6))
    chi2 = pose_innovation(x, C, x_seen, cov, d, S, inverse)
    if chi2 == 1e300:
        return chi2, 0.0
    G = np.empty((N, 6))
    K = np.empty((N, 6))
    step = np.empty(N)
    for i in range(N):
        for j in range(6):
            # a pose is the first six errors of a state, H = (1 0): C H' is their columns
            G[i, j] = C[i, j]
    multiply(G, inverse, K)
    for i in range(N):
        s = 0.0
        for j in range(6):
            s += K[i, j] * d[j]
        step[i] = s
    for i in range(N):
        for j in range(i + 1):
            s = C[i, j]
            for q in range(6):
                s -= K[i, q] * G[j, q]
            C[i, j] = s
            C[j, i] = s
    move(x, step)
    return chi2, log_determinant(S)


@inner_kernel
def log_determinant(S):
    """Return the logarithm of the determinant of S (n, n), symmetric and positive."""
    n = S.shape[0]
    L = np.empty((n, n))
    total = 0.0
    for i in range(n):
        for j in range(i + 1):
            s = S[i, j]
            for q in range(j):
                s -= L[i, q] * L[j, q]
            if i == j:
                # a pivot that rounding makes 0 must not make the log likelihood infinite
                L[i, i] = sqrt(max(s, 1e-300))
                total += 2.0 * np.log(L[i, i])
            else:
                L[i, j] = s / L[j, j]
    return total
