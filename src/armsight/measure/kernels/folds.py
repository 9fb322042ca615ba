"""Other poses that fit as well: where foreshortening bends the residuals, first order claims too small a covariance.

A flat target's image hardly tells the tilts apart that mirror each other about the line of sight, nor small tilts from
none: foreshortening goes with their square. Only what the two views differ by does. Where that is known badly, poses
far outside the ellipsoid of first order may still fit the pixels.
"""

from __future__ import annotations

from math import acos, exp, log, pi, sin, sqrt

import numpy as np

from armsight._numba import inner_kernel, kernel
from armsight.fitting.kernels import invert_spd, solve_damped
from armsight.geometry.kernels import rotate_left
from armsight.measure.kernels.pose import SOLVED, pose_normal, refine_pose, weights
from armsight.optics.kernels.triangulation import invert_2

POSSIBLE = 25.0
"""Rise of chi-square (one quantity) up to which another pose is possible: five deviations."""
PLAIN = 4.0 * POSSIBLE
"""Rise that the lights' depths alone set against the mirrored tilt from which neither it nor small tilts are looked
for: what the other parameters can give back of it is less than half."""
LOOK_STEPS = 12
"""Poses looked at on the way to a mirrored tilt and a quarter beyond it, and along the least certain turn."""
FARTHEST = 5.0
"""Deviations up to which the latter are."""
SETTLE_STEPS = 4
ASTRAY_PX = 2.0
"""How far off a spot may be that is of something else beside its light; further off it would not fit at all."""
ASTRAY_ODDS = 0.05
"""How often a spot before a room is, at most: chosen, not counted."""
LEAST_TURN = 1e-3
"""Turn (rad) from a tilt to its mirror image below which they are one."""


@inner_kernel
def mirrored_turn(R, t, Rp, centre, normal, turn):
    """Fill turn (3,) with the rotation vector from the tilt Rp to its mirror image about a camera's line of sight.

    centre (3,): of the lights in rig axes; normal (3,): of the lights' plane in target axes.
    """
    u = centre + np.ascontiguousarray(R.T) @ t  # from the camera's centre, -R' t
    u /= np.linalg.norm(u)
    n = Rp @ normal
    if np.dot(n, u) < 0.0:
        n = -n
    axis = np.cross(n, u)
    length = np.linalg.norm(axis)
    if length < 0.5 * LEAST_TURN:
        turn[:] = 0.0
        return
    turn[:] = 2.0 * acos(min(np.dot(n, u), 1.0)) / length * axis


@inner_kernel
def settle_beside(k, R, t, X, radius, normal, uv, W, free, Rp, tp, residual):
    """Move Rp, tp along the columns of free (6, m) towards the least chi-square; return it (infinite: none)."""
    m = free.shape[1]
    H = np.empty((6, 6))
    g = np.empty(6)
    small = np.empty(m)
    across = np.ascontiguousarray(free.T)
    R2 = np.empty((3, 3))
    chi2 = pose_normal(k, R, t, X, radius, normal, uv, W, Rp, tp, H, g, residual)
    for _ in range(SETTLE_STEPS):
        if not np.isfinite(chi2) or not solve_damped(across @ H @ free, across @ g, 0.0, small):
            return np.inf
        step = free @ small
        rotate_left(step[3:], Rp, R2)
        t2 = tp + step[:3]
        new = pose_normal(k, R, t, X, radius, normal, uv, W, R2, t2, H, g, residual)
        if not new < chi2:
            break
        fell = chi2 - new
        chi2 = new
        Rp[:] = R2
        tp[:] = t2
        if fell < 0.01:
            break
    return chi2


@inner_kernel
def turned_about(Rp, tp, centre, turn, R2, t2):
    """Fill R2, t2 with the pose turned by the rotation vector about the centre (3,) of the lights."""
    rotate_left(turn, Rp, R2)
    E = R2 @ np.ascontiguousarray(Rp.T)
    t2[:] = centre + E @ (tp - centre)


@inner_kernel
def difference(Rp, tp, R2, t2, d):
    """Fill d (6,) with the way from the pose Rp, tp to R2, t2: translation, rotation vector."""
    d[:3] = t2 - tp
    E = R2 @ np.ascontiguousarray(Rp.T)
    w = np.array([E[2, 1] - E[1, 2], E[0, 2] - E[2, 0], E[1, 0] - E[0, 1]])
    angle = acos(min(max(0.5 * (E[0, 0] + E[1, 1] + E[2, 2] - 1.0), -1.0), 1.0))
    d[3:] = w * (0.5 if angle < 1e-6 else angle / (2.0 * sin(min(angle, pi - 1e-6))))


@inner_kernel
def reach_out(C, d, rise):
    """Widen C (6, 6) so that d (6,) lies no more deviations out than the root of rise; return by how much it did."""
    inverse = np.empty((6, 6))
    if not invert_spd(C, inverse):
        return 1.0
    out = np.dot(d, inverse @ d)
    rise = max(rise, 1.0)
    if out <= rise:
        return 1.0
    C += (1.0 / rise - 1.0 / out) * np.outer(d, d)
    return out / rise


@inner_kernel
def free_beside(axis):
    """Return (6, 5): the changes of a pose that do not turn it about the axis (3,)."""
    free = np.zeros((6, 5))
    for i in range(3):
        free[i, i] = 1.0
    least = 0
    for i in range(3):
        if abs(axis[i]) < abs(axis[least]):
            least = i
    other = np.zeros(3)
    other[least] = 1.0
    first = np.cross(axis, other)
    first /= np.linalg.norm(first)
    free[3:, 3] = first
    free[3:, 4] = np.cross(axis, first)
    return free


@inner_kernel
def looks(R, t, Rp, centre, plane, C):
    """Return turns (3, 3) from the tilt Rp and shares (3, m) of each to look at.

    To the mirror image in either camera, that itself first, and along the least certain turn of C (6, 6) both ways.
    """
    turns = np.empty((3, 3))
    shares = np.empty((3, LOOK_STEPS))
    for s in range(2):
        mirrored_turn(R[s], t[s], Rp, centre, plane, turns[s])
        for j in range(LOOK_STEPS):
            shares[s, j] = 1.0 if j == 0 else 1.25 * j / (LOOK_STEPS - 1)
    values, vectors = np.linalg.eigh(np.ascontiguousarray(C[3:, 3:]))
    turns[2] = sqrt(max(values[2], 0.0)) * vectors[:, 2]
    for j in range(LOOK_STEPS):  # from half way outwards, then from there inwards
        step = (j // 2 + LOOK_STEPS // 4) % (LOOK_STEPS // 2) + 1
        shares[2, j] = FARTHEST * (2.0 * step / LOOK_STEPS) * (1.0 if j % 2 == 0 else -1.0)
    return turns, shares


@kernel
def depth_chi2(P, S):
    """Return the rise of chi-square that the depths of the points P (n, 3), S (n, 3, 3) set against the mirrored tilt.

    Each light's depth beyond their mean, along the line of sight to it, would change its sign.
    """
    n = P.shape[0]
    centre = np.zeros(3)
    for i in range(n):
        centre += P[i] / n
    u = centre / np.linalg.norm(centre)
    chi2 = 0.0
    for i in range(n):
        chi2 += 4.0 * np.dot(P[i] - centre, u) ** 2 / max(np.dot(u, np.ascontiguousarray(S[i]) @ u), 1e-30)
    return chi2


@kernel
def fold(k, R, t, X, radius, normal, plane, uv, cov, T, factor, C):
    """Widen C (6, 6) of the pose T (4, 4) for tilts that first order takes as too unlikely; return by how much.

    plane (3,): normal of the lights' plane in target axes. factor: on every pixel's variance, of misfit, which C has.
    The number is the largest ratio of squared deviations to the rise of chi-square, 1 where first order holds.
    """
    W = np.empty_like(cov)
    residual = np.empty((X.shape[0], 2, 2))
    Rp = np.ascontiguousarray(T[:3, :3])
    tp = np.ascontiguousarray(T[:3, 3])
    R2, t2 = np.empty((3, 3)), np.empty(3)
    d, H = np.empty(6), np.empty((6, 6))
    centre = np.zeros(3)
    for i in range(X.shape[0]):
        centre += (Rp @ X[i] + tp) / X.shape[0]
    if not weights(cov, 0.0, W):
        return 1.0
    base = pose_normal(k, R, t, X, radius, normal, uv, W, Rp, tp, H, np.empty(6), residual)
    most = 1.0
    turns, shares = looks(R, t, Rp, centre, plane, C)
    for s in range(3):
        angle = np.linalg.norm(turns[s])
        if angle < LEAST_TURN:
            continue
        free = free_beside(turns[s] / angle)
        for j in range(shares.shape[1]):
            turned_about(Rp, tp, centre, shares[s, j] * turns[s], R2, t2)
            if s < 2 and j == 0:  # the mirrored tilt: to the least chi-square near it
                state, least = refine_pose(k, R, t, X, radius, normal, uv, W, R2, t2, H, residual)
                rise = least - base if state == SOLVED else np.inf
            else:
                rise = settle_beside(k, R, t, X, radius, normal, uv, W, free, R2, t2, residual) - base
            if rise < POSSIBLE * factor:
                difference(Rp, tp, R2, t2, d)
                most = max(most, reach_out(C, d, rise / factor))
            if s < 2 and j == 0 and (most == 1.0 or not rise < POSSIBLE * factor):
                break  # there is no other tilt, or it does not fit
            if s == 2 and j == 1 and most == 1.0:
                break  # first order holds to either side
    return most


@kernel
def one_astray(k, R, t, X, radius, normal, uv, cov, T, chi2, C):
    """Widen C (6, 6) of the pose T (4, 4) for one spot that is of something else, whichever that may be.

    Each spot is taken as known to ASTRAY_PX only, in turn; the poses that follow count by their probability beside that
    of chi2, of the pose as it is, with a prior of ASTRAY_ODDS each.
    """
    n = X.shape[0]
    W, W2 = np.empty_like(cov), np.empty((2, 2))
    if not weights(cov, 0.0, W):
        return
    cost = np.full(2 * n, np.inf)
    spread = np.zeros((2 * n, 6, 6))
    H, residual, d = np.empty((6, 6)), np.empty((n, 2, 2)), np.empty(6)
    R0, t0 = np.ascontiguousarray(T[:3, :3]), np.ascontiguousarray(T[:3, 3])
    for j in range(2 * n):
        i, s = j // 2, j % 2
        R2, t2 = R0.copy(), t0.copy()
        W2[:] = W[i, s]
        wide = cov[i, s] + ASTRAY_PX**2 * np.eye(2)
        invert_2(wide, W[i, s])
        state, least = refine_pose(k, R, t, X, radius, normal, uv, W, R2, t2, H, residual)
        W[i, s] = W2
        if state != SOLVED or not invert_spd(H, spread[j]):
            continue
        cost[j] = least - log(np.linalg.det(cov[i, s]) / np.linalg.det(wide)) - 2.0 * log(ASTRAY_ODDS)
        difference(R0, t0, R2, t2, d)
        spread[j] += np.outer(d, d)
    best = min(cost.min(), chi2)
    odds = np.exp(-0.5 * (cost - best))
    total = odds.sum() + exp(-0.5 * (chi2 - best))
    for j in range(2 * n):
        C += odds[j] / total * spread[j]
