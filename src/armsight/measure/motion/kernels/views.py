"""Compiled: what one view tells of a state, and what all views together tell of each (smoothing)."""

from __future__ import annotations

from math import sqrt

import numpy as np

from armsight._numba import inner_kernel, kernel
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
    transposed,
    turned,
)
from armsight.optics.kernels.camera import see_point

UPDATE_ROUNDS = 4
"""Gauss-Newton steps of an update at the most; two are enough unless the state was a guess."""
MOMENT_S = 1e-5
"""Over which the speed of a spot in the image is taken."""
MAX_RATE_PX_S = 2e4
"""Dependence on time beyond which a view says nothing of the timing: five times that of 2 m/s at half a metre."""
MIN_SPEED2 = 9.0
"""Square of a spot's speed over its variance below which a view says nothing of the timing."""
SETTLED2 = 1e-4
"""Square of a step over its own uncertainty below which an update has settled."""


@kernel
def observe(x, k, Rc, tc, X, tau, uv, H):
    """Fill uv (2,) and H (2, 18): where a light at X of the target is seen tau after the state's time.

    False where it is behind the camera. k, Rc, tc: of the camera, p_camera = Rc p_rig + tc.
    """
    E = np.empty((3, 3))
    turned(x, tau, E)
    r = np.empty(3)
    y = np.empty(3)
    for i in range(3):
        r[i] = x[R + 3 * i] * X[0] + x[R + 3 * i + 1] * X[1] + x[R + 3 * i + 2] * X[2]
    for i in range(3):
        y[i] = E[i, 0] * r[0] + E[i, 1] * r[1] + E[i, 2] * r[2]
    place = np.empty(3)
    for i in range(3):
        place[i] = x[P + i] + tau * x[V + i] + 0.5 * tau * tau * x[A + i] + y[i]
    J = np.empty((2, 3))
    if not see_point(k, Rc, tc, place, uv, J):
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
def update(x, C, k, Rc, tc, X, tau, uv, cov, residual):
    """Bring spots uv (n, 2), cov (n, 2, 2), of lights X (n, 3) in one view into it, tau (n,) after the state's time.

    Iterated: linearised anew at the answer (Bell and Cathey 1993). x, C are changed in place; residual (n, 2): spots
    less prediction. Returns (chi-square of the innovation, log of its determinant); -1 where something is behind the
    camera or nothing can be solved; the state is then as it was.
    """
    n = uv.shape[0]
    m = 2 * n
    H = np.empty((m, N))
    G = np.empty((m, N))
    S = np.empty((m, m))
    T = np.empty((m, m))
    r = np.empty(m)
    e = np.empty(m)
    d = np.zeros(N)
    step = np.empty(N)
    px = np.empty(2)
    z = x.copy()
    chi2 = -1.0
    logdet = 0.0
    for turn in range(UPDATE_ROUNDS):
        for i in range(n):
            if not observe(z, k, Rc, tc, X[i], tau[i], px, H[2 * i : 2 * i + 2]):
                return -1.0, 0.0
            r[2 * i] = uv[i, 0] - px[0]
            r[2 * i + 1] = uv[i, 1] - px[1]
        if turn == 0:
            for i in range(n):
                residual[i, 0] = r[2 * i]
                residual[i, 1] = r[2 * i + 1]
        multiply(H, C, G)
        multiply_t(G, H, S)
        for i in range(n):
            for a in range(2):
                for b in range(2):
                    S[2 * i + a, 2 * i + b] += cov[i, a, b]
        if not invert_spd(S, T):
            return -1.0, 0.0
        for i in range(m):  # innovation about the first prediction: r + H d
            s = r[i]
            for j in range(N):
                s += H[i, j] * d[j]
            e[i] = s
        if turn == 0:
            chi2 = 0.0
            for i in range(m):
                for j in range(m):
                    chi2 += e[i] * T[i, j] * e[j]
            logdet = log_determinant(S)
        change = 0.0
        for j in range(N):
            s = 0.0
            for i in range(m):
                t = 0.0
                for q in range(m):
                    t += T[i, q] * e[q]
                s += G[i, j] * t
            step[j] = s - d[j]
            change += step[j] * step[j] / C[j, j]
            d[j] = s
        for j in range(STATE):
            z[j] = x[j]
        move(z, d)
        if change < SETTLED2:
            break
    D = np.empty((m, N))
    multiply(T, G, D)
    for i in range(N):
        for j in range(i + 1):
            s = C[i, j]
            for q in range(m):
                s -= G[q, i] * D[q, j]
            C[i, j] = s
            C[j, i] = s
    for j in range(STATE):
        x[j] = z[j]
    return chi2, logdet


@inner_kernel
def speed_uncertainty2(H, C):
    """Return the sum of the variances of the speeds in the image that a state with C (18, 18) gives spots, px^2/s^2."""
    s = 0.0
    for i in range(H.shape[0]):
        for a in range(6):
            for b in range(6):
                s += H[i, a] * C[6 + a, 6 + b] * H[i, b]
    return s


@inner_kernel
def by_timing(x, x_after, C, C_after, k, Rc, tc, X, tau, line, cov, residual, d, L, g):
    """Carry through an update how a state depends on unknowns of the timing, d (18, q) in place.

    x, C: the state before spots X (n, 3), cov (n, 2, 2), which lay residual (n, 2) off; x_after, C_after: after them;
    line (n, q): how much later each spot is for each unknown. Adds to L (q, q) and g (q,) the equations of these spots.
    """
    n, q = line.shape
    m = 2 * n
    H = np.zeros((m, N))
    here = np.empty(2)
    later = np.empty(2)
    scratch = np.zeros((2, N))
    A = np.empty((m, q))
    S = np.empty((m, m))
    inverse = np.empty((m, m))
    G = np.empty((m, N))
    speed2 = 0.0
    for i in range(n):
        # speeds from before, which are independent of the residual; slopes where the gain has them
        if not observe(x, k, Rc, tc, X[i], tau[i], here, scratch):
            return
        if not observe(x, k, Rc, tc, X[i], tau[i] + MOMENT_S, later, scratch):
            return
        for a in range(2):
            speed2 += ((later[a] - here[a]) / MOMENT_S) ** 2
            for p in range(q):
                A[2 * i + a, p] = (later[a] - here[a]) / MOMENT_S * line[i, p]
        if not observe(x_after, k, Rc, tc, X[i], tau[i], here, H[2 * i : 2 * i + 2]):
            return
    multiply(H, C, G)
    multiply_t(G, H, S)
    for i in range(n):
        for a in range(2):
            for b in range(2):
                S[2 * i + a, 2 * i + b] += cov[i, a, b]
    if not invert_spd(S, inverse):
        return
    for i in range(m):
        for p in range(q):
            for j in range(N):
                A[i, p] += H[i, j] * d[j, p]
    top = 0.0
    for i in range(m):
        for p in range(q):
            top = max(top, abs(A[i, p]))
    # hardly anything holds the state, and it is not linear over its uncertainty; or its speed is but noise
    told = top < MAX_RATE_PX_S and speed2 > MIN_SPEED2 * speed_uncertainty2(H, C)
    for p in range(q):
        for i in range(m):
            if not told:
                break
            w = 0.0
            for j in range(m):
                w += inverse[i, j] * A[j, p]
            g[p] += w * residual[i // 2, i % 2]
            for r in range(q):
                L[p, r] += w * A[i, r]
    for i in range(n):  # the gain is C_after H' / cov
        det = cov[i, 0, 0] * cov[i, 1, 1] - cov[i, 0, 1] * cov[i, 1, 0]
        for p in range(q):
            u, v = A[2 * i, p], A[2 * i + 1, p]
            a = (cov[i, 1, 1] * u - cov[i, 0, 1] * v) / det
            b = (cov[i, 0, 0] * v - cov[i, 1, 0] * u) / det
            for j in range(N):
                G[0, j] = a * H[2 * i, j] + b * H[2 * i + 1, j]
            for j in range(N):
                s = 0.0
                for c in range(N):
                    s += C_after[j, c] * G[0, c]
                d[j, p] -= s


@inner_kernel
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
                L[i, i] = sqrt(max(s, 1e-300))
                total += 2.0 * np.log(L[i, i])
            else:
                L[i, j] = s / L[j, j]
    return total


@kernel
def smooth(xs, Cs, ds, xp, Cp, dp, Fs):
    """Smooth the filtered states xs (n, 24), Cs (n, 18, 18) in place, backwards (Rauch, Tung and Striebel 1965).

    xp, Cp: predictions of each before its own spots; Fs: how errors got there from the one before; ds, dp (n, 18, q):
    how filtered (smoothed in place) and predicted states depend on unknowns of the timing. A row whose Fs is zero
    begins anew: nothing goes over it. False where a covariance cannot be inverted.
    """
    n = xs.shape[0]
    G = np.empty((N, N))
    inverse = np.empty((N, N))
    K = np.empty((N, N))
    D = np.empty((N, N))
    E = np.empty((N, N))
    d = np.empty(N)
    g = np.empty(N)
    scaled = np.empty((N, N))
    s = np.empty(N)
    for k in range(n - 2, -1, -1):
        F = Fs[k + 1]
        if F[0, 0] == 0.0:
            continue
        for i in range(N):
            s[i] = 1.0 / sqrt(Cp[k + 1, i, i])
        for i in range(N):
            for j in range(N):
                scaled[i, j] = Cp[k + 1, i, j] * s[i] * s[j]
        if not invert_spd(scaled, inverse):
            return False
        for i in range(N):
            for j in range(N):
                inverse[i, j] *= s[i] * s[j]
        multiply(F, Cs[k], E)
        transposed(E, G)
        multiply(G, inverse, K)
        difference(xs[k + 1], xp[k + 1], d)
        for i in range(N):
            t = 0.0
            for j in range(N):
                t += K[i, j] * d[j]
            g[i] = t
        move(xs[k], g)
        for i in range(N):
            for p in range(ds.shape[2]):
                t = 0.0
                for j in range(N):
                    t += K[i, j] * (ds[k + 1, j, p] - dp[k + 1, j, p])
                ds[k, i, p] += t
        for i in range(N):
            for j in range(N):
                D[i, j] = Cs[k + 1, i, j] - Cp[k + 1, i, j]
        multiply(K, D, E)
        multiply_t(E, K, D)
        for i in range(N):
            for j in range(N):
                Cs[k, i, j] += D[i, j]
    return True
