"""Compiled: filters of different jerk side by side, and how likely each level is at each moment."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from armsight._numba import inner_kernel, kernel, lean_kernel
from armsight.fitting.kernels import invert_spd
from armsight.measure.motion.kernels.state import STATE, N, add_jerk, multiply, multiply_t, predict
from armsight.measure.motion.kernels.views import (
    ViewK,
    log_determinant,
    observe,
    pose_distance2,
    quadratic_form,
    select,
    update,
    update_pose,
)
from armsight.optics.kernels.camera import RigK

IMPOSSIBLE = -1e6
"""Log likelihood of a view that a state cannot explain at all."""
LEFT = 1e-6
"""Share of a spot's variance that is left of it at the least where a view alone says where the target is."""
LOST_WEIGHT = 1e-4
"""Probability of a level below which its filter goes on from the likeliest one's state."""


@lean_kernel
def mixed(w, m, stick):
    """Return the probability of level m before the next view: levels change to a neighbour now and then."""
    # beyond the first and the last level there is none: what would go there stays
    last = w.shape[0] - 1
    lower = w[m - 1] if m > 0 else w[m]
    upper = w[m + 1] if m < last else w[m]
    return (1.0 - stick) * w[m] + 0.5 * stick * (lower + upper)


@inner_kernel
def weigh(xs, Cs, w, log, stick):
    """Bring the levels' log likelihoods log (K,) into their probabilities w (K,); return the number of the likeliest.

    A level that has lost its way goes on from the likeliest one's state.
    """
    K = w.shape[0]
    v = np.empty(K)
    top = -1e300
    for m in range(K):
        top = max(top, log[m])
    total = 0.0
    best = 0
    for m in range(K):
        # over the likeliest: the likelihoods themselves would be 0; below e^-300 a level could not come back
        v[m] = mixed(w, m, stick) * np.exp(max(log[m] - top, -300.0))
        total += v[m]
        if v[m] > v[best]:
            best = m
    for m in range(K):
        w[m] = v[m] / total
        # a filter of little jerk that a knock has left behind would never see the target again
        if w[m] < LOST_WEIGHT:
            xs[m] = xs[best]
            Cs[m] = Cs[best]
            w[m] = LOST_WEIGHT
    return best


class MotionArrays(NamedTuple):
    """How a target may move: jerk (K,) m^2/s^5, the levels, and ratio, that of the angular one (rad^2/s^5) to it.

    stick: chance that the level changes from one view to the next.
    """

    jerk: Any
    ratio: Any
    stick: Any


@kernel
def step_filters(states, dt, motion, rig, X, views, spots, log):
    """Bring views of one time into filters of different jerk, side by side; return the number of the likeliest.

    All plain tuples: states: x (K, 24), C (K, 18, 18) and w (K,), the levels' probabilities, changed in place; motion,
    rig: as MotionArrays, RigK; X, spots: see run_filters; views: side (n,) and first (n + 1,). dt: s since the views
    before. Of no spots: only time passes. log (K,): the views' log likelihood under each level.
    """
    xs, Cs, w = states
    motion, rig = MotionArrays(*motion), RigK(*rig)
    side, first = views
    light, uv, cov, tau = spots
    K = motion.jerk.shape[0]
    y = np.empty(STATE)
    D = np.empty((N, N))
    F = np.empty((N, N))
    log[:] = 0.0
    if dt > 0.0:
        for m in range(K):
            predict(xs[m], Cs[m], dt, motion.jerk[m], motion.ratio * motion.jerk[m], y, D, F)
            xs[m] = y
            Cs[m] = D
    for i in range(side.shape[0]):
        a, b, s = first[i], first[i + 1], side[i]
        if a == b:
            continue
        at = np.empty((b - a, 3))
        select(X, light[a:b], at)
        residual = np.empty((b - a, 2))
        camera, view = (rig.k[s], rig.R[s], rig.t[s]), ViewK(at, tau[a:b], uv[a:b], cov[a:b])
        for m in range(K):
            chi2, logdet = update(xs[m], Cs[m], camera, view, residual)
            log[m] += -0.5 * (chi2 + logdet) if chi2 >= 0.0 else IMPOSSIBLE
    return weigh(xs, Cs, w, log, motion.stick)


@kernel
def step_poses(states, best, dt, motion, x_seen, cov, after):
    """As step_filters for a complete pose x_seen (24,), of which only position and rotation count, with cov (6, 6).

    Fills the states after; best: the row of the likeliest level before. Returns the likeliest one, and the squared
    Mahalanobis distances of the pose from where that level before, and a knock (the last level), expect it.
    """
    xs, Cs, w = states
    xs_new, Cs_new, w_new = after
    jerk, ratio, stick = motion
    K = jerk.shape[0]
    F = np.empty((N, N))
    D = np.empty((N, N))
    log = np.empty(K)
    mahalanobis2 = 0.0
    knocked = 0.0
    for m in range(K):
        predict(xs[m], Cs[m], dt, jerk[m], ratio * jerk[m], xs_new[m], Cs_new[m], F)
        if m == best:
            D[:] = Cs_new[m]
            # the state of the likeliest level, as uncertain as if the last level had driven it since
            add_jerk(D, dt, jerk[K - 1] - jerk[m], ratio * (jerk[K - 1] - jerk[m]))
            knocked = pose_distance2(xs_new[m], D, x_seen, cov)
        chi2, logdet = update_pose(xs_new[m], Cs_new[m], x_seen, cov)
        if m == best:
            mahalanobis2 = chi2
        log[m] = -0.5 * (chi2 + logdet)
    w_new[:] = w
    likeliest = weigh(xs_new, Cs_new, w_new, log, stick)
    return likeliest, mahalanobis2, knocked


@kernel
def run_filters(views, spots, rig, X, motion, start, logs):
    """Filters of different jerk over all views: fill logs (n, K) with each view's log likelihoods.

    All plain tuples: views: t (n,), side (n,), first (n + 1,), in the order of time, and which spots are theirs. spots:
    light (m,), a row of X, uv (m, 2), cov (m, 2, 2), tau (m,). rig, motion: as RigK, MotionArrays. start: x (n, 24),
    C (n, 18, 18), with which the rows of fresh (n,) start anew.
    """
    t, side, first = views
    begin, C0, fresh = start
    n, K = logs.shape
    xs = np.empty((K, STATE))
    Cs = np.empty((K, N, N))
    w = np.empty(K)
    for i in range(n):
        dt = 0.0
        if fresh[i]:
            w[:] = 1.0 / K
            for m in range(K):
                xs[m] = begin[i]
                Cs[m] = C0[i]
        else:
            dt = t[i] - t[i - 1]
        step_filters((xs, Cs, w), dt, motion, rig, X, (side[i : i + 1], first[i : i + 2]), spots, logs[i])


@kernel
def levels_of_all(logs, fresh, stick, post):
    """Fill post (n, K) with the levels' probabilities given all views (forward-backward, within each stretch)."""
    n, K = logs.shape
    e = np.empty(K)
    w = np.empty(K)
    for i in range(n):
        if fresh[i]:
            w[:] = 1.0 / K
        for m in range(K):
            e[m] = mixed(w, m, stick)
        tempered(logs[i], e, w)
        post[i] = w
    # backwards: how likely each level makes all later views of its stretch (Rabiner 1989, section III)
    back = np.ones(K)
    for i in range(n - 1, -1, -1):
        total = 0.0
        for m in range(K):
            post[i, m] *= back[m]
            total += post[i, m]
        for m in range(K):
            post[i, m] /= total
        if fresh[i]:
            back[:] = 1.0
            continue
        tempered(logs[i], back, e)
        for m in range(K):
            back[m] = mixed(e, m, stick)


@lean_kernel
def tempered(log, before, after):
    """Fill after (K,) with probabilities before (K,) times the likelihoods of log (K,), their sum 1."""
    top = -1e300
    for m in range(log.shape[0]):
        top = max(top, log[m])
    total = 0.0
    for m in range(log.shape[0]):
        after[m] = before[m] * np.exp(max(log[m] - top, -300.0))
        total += after[m]
    for m in range(log.shape[0]):
        after[m] /= total


@kernel
def left_out(xs, Cs, views, spots, rig, X, logs):
    """Fill logs (n,) with the log density of each view's spots by what all other views say of them, but for a constant.

    xs (n, 24), Cs (n, 18, 18): smoothed by all views. views, spots, rig, X: see run_filters. What is left of a spot
    about them, r with covariance S = cov - H C H', is cov / S times smaller than about the others, so that their log
    density is -(r S^-1 r - log |S|) / 2.
    """
    _, side, first = views
    light, uv, cov, tau = spots
    rig = RigK(*rig)
    here = np.empty(2)
    for i in range(first.shape[0] - 1):
        a, b = first[i], first[i + 1]
        m = 2 * (b - a)
        H = np.zeros((m, N))
        G = np.empty((m, N))
        S = np.empty((m, m))
        inverse = np.empty((m, m))
        r = np.empty(m)
        logs[i] = 0.0 if m == 0 else IMPOSSIBLE
        s = side[i]
        seen = m > 0
        camera = (rig.k[s], rig.R[s], rig.t[s])
        at = np.empty((b - a, 3))
        select(X, light[a:b], at)
        for j in range(b - a):
            seen &= observe(xs[i], camera, at[j], tau[a + j], here, H[2 * j : 2 * j + 2])
            for c in range(2):
                r[2 * j + c] = uv[a + j, c] - here[c]
        if not seen:
            continue
        # the smoothed state follows these spots, too: what is left of them has less than their own covariance
        multiply(H, Cs[i], G)
        multiply_t(G, H, S)
        for j in range(m):
            for c in range(m):
                S[j, c] = -S[j, c]
        for j in range(b - a):
            for c in range(2):
                # LEFT more: a view that alone tells the pose leaves nothing over, and S would have no inverse
                for d in range(2):
                    S[2 * j + c, 2 * j + d] += (1.0 + LEFT) * cov[a + j, c, d]
        if not invert_spd(S, inverse):
            continue
        logs[i] = 0.5 * (log_determinant(S) - quadratic_form(inverse, r))
