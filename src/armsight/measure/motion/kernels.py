"""Compiled filter of a moving target: pose, velocity and acceleration, from the spots of one view at a time.

State: position p (m), rotation R, velocity v, angular velocity w, acceleration a, angular acceleration b of the target,
all in rig axes. Its error (18,): dp, dw with Exp(dw) R, then those of v, w, a, b. Acceleration and angular acceleration
are driven by white noise (jerk) of power spectral density s: for each axis the covariance added over dt is
s [[dt^5/20, dt^4/8, dt^3/6], [., dt^3/3, dt^2/2], [., ., dt]] (Bar-Shalom, Li and Kirubarajan 2001, section 6.2.3).

A state travels as x (24,): p, the rows of R, v, w, a, b.
"""

from __future__ import annotations

from math import sqrt

import numpy as np

from armsight._numba import kernel
from armsight.fitting.kernels import invert_spd
from armsight.geometry.kernels import rotation_from_rotvec, rotvec_of
from armsight.optics.kernels.camera import see_point

N = 18
"""Errors of a state."""
STATE = 24
P, R, V, W, A, B = 0, 3, 12, 15, 18, 21
"""Where each part of a state begins."""
ROUNDS = 4
"""Gauss-Newton steps of an update at the most; two are enough unless the state was a guess."""
SETTLED2 = 1e-4
"""Square of a step over its own uncertainty below which an update has settled."""
IMPOSSIBLE = -1e6
"""Log likelihood of a view that a state cannot explain at all."""
LOST_WEIGHT = 1e-4
"""Probability of a level below which its filter goes on from the likeliest one's state."""


@kernel
def turned(x, tau, E):
    """Fill E (3, 3) with the turn that the state makes in tau."""
    phi = np.empty(3)
    for i in range(3):
        phi[i] = tau * x[W + i] + 0.5 * tau * tau * x[B + i]
    rotation_from_rotvec(phi, E)


@kernel
def state_at(x, tau, out):
    """Fill out with the state tau later, without noise."""
    E = np.empty((3, 3))
    turned(x, tau, E)
    for i in range(3):
        out[P + i] = x[P + i] + tau * x[V + i] + 0.5 * tau * tau * x[A + i]
        out[V + i] = x[V + i] + tau * x[A + i]
        out[W + i] = x[W + i] + tau * x[B + i]
        out[A + i] = x[A + i]
        out[B + i] = x[B + i]
        for j in range(3):
            out[R + 3 * i + j] = E[i, 0] * x[R + j] + E[i, 1] * x[R + 3 + j] + E[i, 2] * x[R + 6 + j]


@kernel
def transition(x, tau, F):
    """Fill F (18, 18): how the error of a state becomes that of the state tau later."""
    E = np.empty((3, 3))
    turned(x, tau, E)
    h = 0.5 * tau * tau
    F[:] = 0.0
    phi = np.empty(3)
    for i in range(3):
        phi[i] = tau * x[W + i] + h * x[B + i]
    for i in range(3):
        F[i, i] = 1.0
        F[i, 6 + i] = tau
        F[i, 12 + i] = h
        for k in (6, 9, 12, 15):
            F[k + i, k + i] = 1.0
        F[6 + i, 12 + i] = tau
        F[9 + i, 15 + i] = tau
        for j in range(3):
            F[3 + i, 3 + j] = E[i, j]
    # the left Jacobian of the turn to first order: I + [phi] / 2
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        F[3 + i, 9 + i] = tau
        F[3 + i, 9 + j] = -0.5 * tau * phi[k]
        F[3 + i, 9 + k] = 0.5 * tau * phi[j]
        for c in range(3):
            F[3 + i, 15 + c] = 0.5 * tau * F[3 + i, 9 + c]


@kernel
def multiply(X, Y, out):
    """Fill out with X Y, leaving out what is zero in X."""
    n, m, p = X.shape[0], Y.shape[1], X.shape[1]
    for i in range(n):
        for j in range(m):
            out[i, j] = 0.0
        for k in range(p):
            f = X[i, k]
            if f != 0.0:
                for j in range(m):
                    out[i, j] += f * Y[k, j]


@kernel
def multiply_t(X, Y, out):
    """Fill out with X Y'."""
    n, m, p = X.shape[0], Y.shape[0], X.shape[1]
    for i in range(n):
        for j in range(m):
            s = 0.0
            for k in range(p):
                s += X[i, k] * Y[j, k]
            out[i, j] = s


@kernel
def add_jerk(C, tau, jerk, angular_jerk):
    """Add to C (18, 18) what jerk (m^2/s^5) and angular jerk (rad^2/s^5) leave open over tau."""
    t2 = tau * tau
    t3 = t2 * tau
    for axis in range(6):
        s = jerk if axis < 3 else angular_jerk
        p, v, a = axis, 6 + axis, 12 + axis
        C[p, p] += s * t3 * t2 / 20.0
        C[p, v] += s * t2 * t2 / 8.0
        C[v, p] += s * t2 * t2 / 8.0
        C[p, a] += s * t3 / 6.0
        C[a, p] += s * t3 / 6.0
        C[v, v] += s * t3 / 3.0
        C[v, a] += s * t2 / 2.0
        C[a, v] += s * t2 / 2.0
        C[a, a] += s * tau


@kernel
def predict(x, C, tau, jerk, angular_jerk, out, D, F):
    """Fill the state out, its covariance D (18, 18) tau later, and F, how errors got there."""
    G = np.empty((N, N))
    transition(x, tau, F)
    multiply(F, C, G)
    multiply_t(G, F, D)
    add_jerk(D, tau, jerk, angular_jerk)
    state_at(x, tau, out)


@kernel
def move(x, d):
    """Move a state by an error (18,)."""
    E = np.empty((3, 3))
    S = np.empty((3, 3))
    rotation_from_rotvec(d[3:6], E)
    for i in range(3):
        x[P + i] += d[i]
        x[V + i] += d[6 + i]
        x[W + i] += d[9 + i]
        x[A + i] += d[12 + i]
        x[B + i] += d[15 + i]
        for j in range(3):
            S[i, j] = E[i, 0] * x[R + j] + E[i, 1] * x[R + 3 + j] + E[i, 2] * x[R + 6 + j]
    for i in range(3):
        for j in range(3):
            x[R + 3 * i + j] = S[i, j]


@kernel
def difference(x, y, d):
    """Fill d (18,) with the error that moves y to x."""
    S = np.empty((3, 3))
    for i in range(3):
        d[i] = x[P + i] - y[P + i]
        d[6 + i] = x[V + i] - y[V + i]
        d[9 + i] = x[W + i] - y[W + i]
        d[12 + i] = x[A + i] - y[A + i]
        d[15 + i] = x[B + i] - y[B + i]
        for j in range(3):
            S[i, j] = (
                x[R + 3 * i] * y[R + 3 * j] + x[R + 3 * i + 1] * y[R + 3 * j + 1] + x[R + 3 * i + 2] * y[R + 3 * j + 2]
            )
    rotvec_of(S, d[3:6])


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
    for turn in range(ROUNDS):
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


@kernel
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
def smooth(xs, Cs, xp, Cp, Fs):
    """Smooth the filtered states xs (n, 24), Cs (n, 18, 18) in place, backwards (Rauch, Tung and Striebel 1965).

    xp, Cp: predictions of each before its own spots; Fs: how errors got there from the one before. A row whose Fs is
    zero begins anew: nothing goes over it. False where a covariance cannot be inverted.
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
        multiply_t(Cs[k], F, G)
        multiply(G, inverse, K)
        difference(xs[k + 1], xp[k + 1], d)
        for i in range(N):
            t = 0.0
            for j in range(N):
                t += K[i, j] * d[j]
            g[i] = t
        move(xs[k], g)
        for i in range(N):
            for j in range(N):
                D[i, j] = Cs[k + 1, i, j] - Cp[k + 1, i, j]
        multiply(K, D, E)
        multiply_t(E, K, D)
        for i in range(N):
            for j in range(N):
                Cs[k, i, j] += D[i, j]
    return True


@kernel
def select(X, light, out):
    """Fill out (n, 3) with the rows light (n,) of X."""
    for i in range(light.shape[0]):
        for c in range(3):
            out[i, c] = X[light[i], c]


@kernel
def mixed(w, m, stick):
    """Return the probability of level m before the next view: levels change to a neighbour now and then."""
    last = w.shape[0] - 1
    lower = w[m - 1] if m > 0 else w[m]
    upper = w[m + 1] if m < last else w[m]
    return (1.0 - stick) * w[m] + 0.5 * stick * (lower + upper)


@kernel
def step_filters(xs, Cs, w, dt, jerk, ratio, stick, k, Rc, tc, X, tau, uv, cov, log):
    """Bring a view into filters of different jerk, side by side; return the number of the likeliest.

    xs (K, 24), Cs, and w (K,), the levels' probabilities, are changed in place. dt: s since the view before; X (n, 3),
    tau (n,), uv (n, 2), cov: its spots, of none (n = 0) where only time passes. jerk (K,): levels, m^2/s^5; angular
    ones are ratio times them. stick: chance that the level changes. log (K,): the view's log likelihood under each.
    """
    K = jerk.shape[0]
    y = np.empty(STATE)
    D = np.empty((N, N))
    F = np.empty((N, N))
    residual = np.empty((X.shape[0], 2))
    v = np.empty(K)
    top = -1e300
    for m in range(K):
        if dt > 0.0:
            predict(xs[m], Cs[m], dt, jerk[m], ratio * jerk[m], y, D, F)
            xs[m] = y
            Cs[m] = D
        log[m] = 0.0
        if X.shape[0]:
            chi2, logdet = update(xs[m], Cs[m], k, Rc, tc, X, tau, uv, cov, residual)
            log[m] = -0.5 * (chi2 + logdet) if chi2 >= 0.0 else IMPOSSIBLE
        top = max(top, log[m])
    total = 0.0
    best = 0
    for m in range(K):
        v[m] = mixed(w, m, stick) * np.exp(max(log[m] - top, -300.0))
        total += v[m]
        if v[m] > v[best]:
            best = m
    for m in range(K):
        w[m] = v[m] / total
        if w[m] < LOST_WEIGHT:  # has lost its way: goes on from the likeliest
            xs[m] = xs[best]
            Cs[m] = Cs[best]
            w[m] = LOST_WEIGHT
    return best


@kernel
def run_filters(t, side, first, light, uv, cov, tau, k, Rc, tc, X, jerk, ratio, stick, begin, C0, fresh, logs, weight):
    """Filters of different jerk over all views: fill logs, weight (n, K) with each view's likelihoods and the levels'.

    t (n,), side (n,), first (n + 1,): views in the order of time, and which spots are theirs; light, uv (m, 2), cov,
    tau (m,): spots. begin (n, 24), C0 (n, 18, 18): states with which the rows of fresh (n,) start anew.
    """
    n, K = logs.shape
    xs = np.empty((K, STATE))
    Cs = np.empty((K, N, N))
    w = np.empty(K)
    for i in range(n):
        a, b = first[i], first[i + 1]
        at = np.empty((b - a, 3))
        select(X, light[a:b], at)
        dt = 0.0
        if fresh[i]:
            w[:] = 1.0 / K
            for m in range(K):
                xs[m] = begin[i]
                Cs[m] = C0[i]
        else:
            dt = t[i] - t[i - 1]
        s = side[i]
        step_filters(xs, Cs, w, dt, jerk, ratio, stick, k[s], Rc[s], tc[s], at, tau[a:b], uv[a:b], cov[a:b], logs[i])
        weight[i] = w


@kernel
def levels_of_all(logs, weight, fresh, stick, post):
    """Fill post (n, K) with the levels' probabilities given all views (forward-backward, within each stretch)."""
    n, K = logs.shape
    back = np.ones(K)
    e = np.empty(K)
    for i in range(n - 1, -1, -1):
        total = 0.0
        for m in range(K):
            post[i, m] = weight[i, m] * back[m]
            total += post[i, m]
        for m in range(K):
            post[i, m] /= total
        if fresh[i]:
            back[:] = 1.0
            continue
        top = -1e300
        for m in range(K):
            top = max(top, logs[i, m])
        for m in range(K):
            e[m] = np.exp(max(logs[i, m] - top, -300.0)) * back[m]
        total = 0.0
        for m in range(K):
            back[m] = mixed(e, m, stick)
            total += back[m]
        for m in range(K):
            back[m] /= total


@kernel
def run_filter(t, side, first, light, uv, cov, tau, k, Rc, tc, X, jerk, ratio, begin, C0, fresh, xs, Cs, xp, Cp, Fs):
    """One filter with its own jerk (n,) at each view: fill filtered and predicted states as smooth wants them."""
    for i in range(t.shape[0]):
        a, b = first[i], first[i + 1]
        if fresh[i]:
            xp[i] = begin[i]
            Cp[i] = C0[i]
            Fs[i] = 0.0
        else:
            predict(xs[i - 1], Cs[i - 1], t[i] - t[i - 1], jerk[i], ratio * jerk[i], xp[i], Cp[i], Fs[i])
        xs[i] = xp[i]
        Cs[i] = Cp[i]
        if b > a:
            at = np.empty((b - a, 3))
            select(X, light[a:b], at)
            s = side[i]
            residual = np.empty((b - a, 2))
            update(xs[i], Cs[i], k[s], Rc[s], tc[s], at, tau[a:b], uv[a:b], cov[a:b], residual)
