"""Compiled: one filter over all views, what they tell of the timing, and what all of them tell of each (smoothing)."""

from __future__ import annotations

from math import sqrt
from typing import Any, NamedTuple

import numpy as np

from armsight._numba import inner_kernel, kernel, lean_kernel
from armsight.fitting.kernels import invert_spd
from armsight.measure.motion.kernels.state import (
    N,
    add_jerk,
    difference,
    move,
    multiply,
    multiply_t,
    predict,
    transposed,
)
from armsight.measure.motion.kernels.views import ViewK, innovation_covariance, observe, select, update
from armsight.optics.kernels.camera import RigK

MOMENT_S = 1e-5
"""Over which the speed of a spot in the image is taken."""
MAX_RATE_PX_S = 2e4
"""Dependence on time beyond which a view says nothing of the timing: five times that of 2 m/s at half a metre."""
MIN_SPEED2 = 9.0
"""Square of a spot's speed over its variance below which a view says nothing of the timing."""


class Filtered(NamedTuple):
    """States after n views: x (n, 24), their covariances C (n, 18, 18), and d (n, 18, q), how they follow unknowns."""

    x: Any
    C: Any
    d: Any


class Predicted(NamedTuple):
    """The same before each view's own spots, and F (n, 18, 18): how errors got there from the view before.

    F is zero in the first view of a stretch, which begins anew: nothing goes over it.
    """

    x: Any
    C: Any
    d: Any
    F: Any


@kernel
def run_filter(views, spots, line, rig, X, motion, start, filtered, predicted, equations):
    """One filter with its own jerk (n,) at each view: fill filtered and predicted states as smooth wants them.

    views, spots, rig, X, start: see run_filters. motion: jerk (n,) and ratio. line (m, q): how much later each spot is
    for each of q unknowns of the timing, which the states' d are by. equations: L (q, q) and g (q,), to which the
    innovations' least-squares equations for them are added.
    """
    t, side, first = views
    light, uv, cov, tau = spots
    rig = RigK(*rig)
    jerk, ratio = motion
    begin, C0, fresh = start
    xs, Cs, ds = filtered
    xp, Cp, dp, Fs = predicted
    L, g = equations
    for i in range(t.shape[0]):
        a, b = first[i], first[i + 1]
        if fresh[i]:
            xp[i] = begin[i]
            Cp[i] = C0[i]
            dp[i] = 0.0
            Fs[i] = 0.0
        else:
            predict(xs[i - 1], Cs[i - 1], t[i] - t[i - 1], jerk[i], ratio * jerk[i], xp[i], Cp[i], Fs[i])
            multiply(Fs[i], ds[i - 1], dp[i])
        xs[i] = xp[i]
        Cs[i] = Cp[i]
        ds[i] = dp[i]
        if b > a:
            at = np.empty((b - a, 3))
            select(X, light[a:b], at)
            s = side[i]
            camera, view = (rig.k[s], rig.R[s], rig.t[s]), ViewK(at, tau[a:b], uv[a:b], cov[a:b])
            residual = np.empty((b - a, 2))
            chi2, _ = update(xs[i], Cs[i], camera, view, residual)
            if chi2 >= 0.0 and line.shape[1]:
                by_timing((xp[i], Cp[i]), (xs[i], Cs[i]), camera, view, line[a:b], residual, ds[i], L, g)


@lean_kernel
def speed_uncertainty2(H, C):
    """Return the sum of the variances of the speeds in the image that a state with C (18, 18) gives spots, px^2/s^2."""
    s = 0.0
    for i in range(H.shape[0]):
        for a in range(6):
            for b in range(6):
                s += H[i, a] * C[6 + a, 6 + b] * H[i, b]
    return s


@inner_kernel
def timing_slopes(x, x_after, camera, view, line, A, H):
    """Fill A (m, q) = d spots / d unknowns of the timing and H (m, 18) = d spots / d state; return the speeds squared.

    The sum is of all spots' speeds in the image, (px/s)^2; -1 where something is behind the camera. line: see
    by_timing.
    """
    n, q = line.shape
    X, tau = view.X, view.tau
    here = np.empty(2)
    later = np.empty(2)
    scratch = np.zeros((2, N))
    speed2 = 0.0
    for i in range(n):
        # speeds from before, which are independent of the residual; slopes where the gain has them
        if not observe(x, camera, X[i], tau[i], here, scratch):
            return -1.0
        if not observe(x, camera, X[i], tau[i] + MOMENT_S, later, scratch):
            return -1.0
        for a in range(2):
            speed2 += ((later[a] - here[a]) / MOMENT_S) ** 2
            for p in range(q):
                A[2 * i + a, p] = (later[a] - here[a]) / MOMENT_S * line[i, p]
        if not observe(x_after, camera, X[i], tau[i], here, H[2 * i : 2 * i + 2]):
            return -1.0
    return speed2


@inner_kernel
def by_timing(before, after, camera, view, line, residual, d, L, g):
    """Carry through an update how a state depends on unknowns of the timing, d (18, q) in place.

    before, after: (x, C) of the state before the view's spots, which lay residual (n, 2) off, and after them; line (n,
    q): how much later each spot is for each unknown. Adds to L (q, q) and g (q,) the equations of these spots.
    """
    x, C = before
    x_after, C_after = after
    n, q = line.shape
    m = 2 * n
    H = np.zeros((m, N))
    A = np.empty((m, q))
    S = np.empty((m, m))
    inverse = np.empty((m, m))
    G = np.empty((m, N))
    speed2 = timing_slopes(x, x_after, camera, view, line, A, H)
    if speed2 < 0.0:
        return
    innovation_covariance(H, C, view.cov, G, S)
    if not invert_spd(S, inverse):
        return
    # an innovation changes with an unknown by what it changes itself and by what the prediction has of it: A + H d
    for i in range(m):
        for p in range(q):
            for j in range(N):
                A[i, p] += H[i, j] * d[j, p]
    top = 0.0
    for i in range(m):
        for p in range(q):
            top = max(top, abs(A[i, p]))
    # hardly anything holds the state, and it is not linear over its uncertainty; or its speed is but noise
    if top < MAX_RATE_PX_S and speed2 > MIN_SPEED2 * speed_uncertainty2(H, C):
        for p in range(q):
            for i in range(m):
                w = 0.0
                for j in range(m):
                    w += inverse[i, j] * A[j, p]
                g[p] += w * residual[i // 2, i % 2]
                for r in range(q):
                    L[p, r] += w * A[i, r]
    carry_by_gain(H, A, C_after, view.cov, d)


@inner_kernel
def carry_by_gain(H, A, C, cov, d):
    """Take from d (18, q) what the gain C H' / cov turns into the state of A (m, q), the spots' change by the unknowns.

    C (18, 18) is the covariance after the update: with it the gain needs no inverse of the innovation's.
    """
    f = np.empty(N)
    for i in range(cov.shape[0]):
        det = cov[i, 0, 0] * cov[i, 1, 1] - cov[i, 0, 1] * cov[i, 1, 0]
        for p in range(A.shape[1]):
            u, v = A[2 * i, p], A[2 * i + 1, p]
            a = (cov[i, 1, 1] * u - cov[i, 0, 1] * v) / det
            b = (cov[i, 0, 0] * v - cov[i, 1, 0] * u) / det
            for j in range(N):
                f[j] = a * H[2 * i, j] + b * H[2 * i + 1, j]
            for j in range(N):
                s = 0.0
                for c in range(N):
                    s += C[j, c] * f[c]
                d[j, p] -= s


@kernel
def smooth(t, motion, filtered, predicted):
    """Smooth the filtered states in place, backwards (Rauch, Tung and Striebel 1965); as Filtered and Predicted.

    t (n,) in s; motion: jerk (n,) and ratio, as run_filter had them. False where a covariance cannot be inverted.
    """
    xs, Cs, ds = filtered
    xp, Cp, dp, Fs = predicted
    jerk, ratio = motion
    n = xs.shape[0]
    K = np.empty((N, N))
    d = np.empty(N)
    g = np.empty(N)
    for k in range(n - 2, -1, -1):
        F = Fs[k + 1]
        if F[0, 0] == 0.0:
            continue
        if not smoothing_gain(F, Cs[k], Cp[k + 1], K):
            return False
        difference(xs[k + 1], xp[k + 1], d)
        for i in range(N):
            g[i] = 0.0
            for j in range(N):
                g[i] += K[i, j] * d[j]
        move(xs[k], g)
        for i in range(N):
            for p in range(ds.shape[2]):
                s = 0.0
                for j in range(N):
                    s += K[i, j] * (ds[k + 1, j, p] - dp[k + 1, j, p])
                ds[k, i, p] += s
        smooth_covariance(F, K, t[k + 1] - t[k], (jerk[k + 1], ratio * jerk[k + 1]), Cs[k], Cs[k + 1])
    return True


@inner_kernel
def smoothing_gain(F, C, Cp, K):
    """Fill K = C F' Cp^-1 (18, 18): how much of what later views changed in the next state goes back to this one.

    False where the covariance Cp of the next state's prediction cannot be inverted.
    """
    scaled = np.empty((N, N))
    inverse = np.empty((N, N))
    E = np.empty((N, N))
    G = np.empty((N, N))
    s = np.empty(N)
    # scaled to a unit diagonal: metres beside rad/s^2, whose squares are 1e12 apart, would not be inverted
    for i in range(N):
        s[i] = 1.0 / sqrt(Cp[i, i])
    for i in range(N):
        for j in range(N):
            scaled[i, j] = Cp[i, j] * s[i] * s[j]
    if not invert_spd(scaled, inverse):
        return False
    for i in range(N):
        for j in range(N):
            inverse[i, j] *= s[i] * s[j]
    multiply(F, C, E)
    transposed(E, G)
    multiply(G, inverse, K)
    return True


@inner_kernel
def smooth_covariance(F, K, tau, jerks, C, C_next):
    """Make C (18, 18) of the filter that of all views, C_next being that of the state tau later.

    (1 - K F) C (1 - K F)' + K (Q + C_next) K', as Joseph's form of the filter's update: a sum of squares. What is the
    same on paper, C + K (C_next - Cp) K', takes two large numbers from each other where a stretch begins.
    """
    E = np.empty((N, N))
    G = np.empty((N, N))
    D = np.empty((N, N))
    multiply(K, F, E)
    for i in range(N):
        for j in range(N):
            E[i, j] = (1.0 if i == j else 0.0) - E[i, j]
            D[i, j] = C_next[i, j]
    add_jerk(D, tau, jerks[0], jerks[1])
    multiply(E, C, G)
    multiply_t(G, E, C)
    multiply(K, D, G)
    multiply_t(G, K, D)
    for i in range(N):
        for j in range(N):
            C[i, j] += D[i, j]
