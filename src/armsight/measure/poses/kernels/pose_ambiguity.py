"""Other poses that fit as well: where foreshortening bends the residuals, first order claims too small a covariance.

A flat target's image hardly tells the tilts apart that mirror each other about the line of sight, nor small tilts from
none: foreshortening goes with their square. Only what the two views differ by does. Where that is known badly, poses
far outside the ellipsoid of first order may still fit the pixels.
"""

from __future__ import annotations

from math import acos, exp, log, pi, sin, sqrt

import numpy as np

from armsight._numba import inner_kernel, lean_kernel
from armsight.fitting.kernels import invert_spd, solve_damped
from armsight.geometry.kernels import copy_1, copy_2, cross, dot, rotate_left
from armsight.measure.poses.kernels.pose import (
    SOLVED,
    Lights,
    Observations,
    new_work,
    pose_normal,
    refine_pose,
    weights,
)
from armsight.optics.kernels.camera import RigK
from armsight.optics.kernels.triangulation import centre_of, invert_2, missing

POSSIBLE = 25.0
"""Rise of chi-square (one quantity) up to which another pose is possible: five standard deviations."""
PLAIN = 4.0 * POSSIBLE
"""Rise that the lights' depths alone set against the mirrored tilt from which neither it nor small tilts are looked
for: what the other parameters can give back of it is less than half."""
LOOK_STEPS = 12
"""Poses looked at on the way to a mirrored tilt and a quarter beyond it, and along the least certain turn."""
FARTHEST = 5.0
"""Standard deviations up to which the latter are."""
SETTLE_STEPS = 4
ASTRAY_PX = 2.0
"""How far off a spot may be that is of something else beside its light; further off it would not fit at all."""
ASTRAY_ODDS = 0.05
"""How often a spot before a room is, at most: chosen, not counted."""
LEAST_TURN = 1e-3
"""Turn (rad) from a tilt to its mirror image below which they are one."""


@lean_kernel
def scale(a, factor):
    """Multiply a vector by a number, in place."""
    for i in range(a.shape[0]):
        a[i] *= factor


@lean_kernel
def split(T, R, t):
    """Fill R (3, 3) and t (3,) from the pose T (4, 4)."""
    for i in range(3):
        for j in range(3):
            R[i, j] = T[i, j]
        t[i] = T[i, 3]


@lean_kernel
def det_2(S):
    """Return the determinant of S (2, 2)."""
    return S[0, 0] * S[1, 1] - S[0, 1] * S[1, 0]


@inner_kernel
def mirrored_turn(R, t, Rp, centre, normal, turn):
    """Fill turn (3,) with the rotation vector from the tilt Rp to its mirror image about a camera's line of sight.

    centre (3,): of the lights in rig axes; normal (3,): of the lights' plane in target axes.
    """
    u, n = np.empty(3), np.empty(3)
    for i in range(3):  # from the camera's centre, -R' t
        u[i] = centre[i] + R[0, i] * t[0] + R[1, i] * t[1] + R[2, i] * t[2]
        n[i] = dot(Rp[i], normal)
    scale(u, 1.0 / sqrt(dot(u, u)))
    if dot(n, u) < 0.0:
        scale(n, -1.0)
    cross(n, u, turn)
    length = sqrt(dot(turn, turn))
    scale(turn, 0.0 if length < 0.5 * LEAST_TURN else 2.0 * acos(min(dot(n, u), 1.0)) / length)


@inner_kernel
def plane_normal(lights):
    """Return the normal (3,) of the plane of three lights, of more that of the target's, in target axes."""
    X = lights.X
    normal = np.empty(3)
    copy_1(lights.normal, normal)
    if X.shape[0] == 3:
        first, second = np.empty(3), np.empty(3)
        for i in range(3):
            first[i] = X[1, i] - X[0, i]
            second[i] = X[2, i] - X[0, i]
        cross(first, second, normal)
        scale(normal, 1.0 / sqrt(dot(normal, normal)))
    return normal


@inner_kernel
def settle_beside(rig, lights, seen, free, Rp, tp, residual, work):
    """Move Rp, tp along the columns of free (6, m) towards the least chi-square; return it (infinite: none)."""
    m = free.shape[1]
    H = np.empty((6, 6))
    g = np.empty(6)
    small = np.empty(m)
    slope = np.empty(m)
    bend = np.empty((m, m))
    step = np.empty(6)
    R2 = np.empty((3, 3))
    t2 = np.empty(3)
    chi2 = pose_normal(rig, lights, seen, Rp, tp, H, g, residual, work)
    for _ in range(SETTLE_STEPS):
        for i in range(m):  # bend = free' H free, slope = free' g
            slope[i] = 0.0
            for a in range(6):
                step[a] = 0.0
                for b in range(6):
                    step[a] += H[a, b] * free[b, i]
                slope[i] += free[a, i] * g[a]
            for j in range(m):
                bend[i, j] = 0.0
                for a in range(6):
                    bend[i, j] += step[a] * free[a, j]
        if not np.isfinite(chi2) or not solve_damped(bend, slope, 0.0, small):
            return np.inf
        for i in range(6):
            step[i] = dot(free[i], small)
        rotate_left(step[3:], Rp, R2)
        for i in range(3):
            t2[i] = tp[i] + step[i]
        new = pose_normal(rig, lights, seen, R2, t2, H, g, residual, work)
        if not new < chi2:
            break
        fell = chi2 - new
        chi2 = new
        copy_2(R2, Rp)
        copy_1(t2, tp)
        if fell < 0.01:
            break
    return chi2


@lean_kernel
def turned_about(Rp, tp, centre, turn, R2, t2):
    """Fill R2, t2 with the pose turned by the rotation vector about the centre (3,) of the lights."""
    rotate_left(turn, Rp, R2)
    for i in range(3):  # R2 Rp' (tp - centre), of which Exp(turn) = R2 Rp'
        t2[i] = centre[i]
        for j in range(3):
            t2[i] += dot(R2[i], Rp[j]) * (tp[j] - centre[j])


@inner_kernel
def difference(Rp, tp, R2, t2, d):
    """Fill d (6,) with the way from the pose Rp, tp to R2, t2: translation, rotation vector."""
    E = np.empty((3, 3))
    for i in range(3):
        d[i] = t2[i] - tp[i]
        for j in range(3):
            E[i, j] = dot(R2[i], Rp[j])
    angle = acos(min(max(0.5 * (E[0, 0] + E[1, 1] + E[2, 2] - 1.0), -1.0), 1.0))
    factor = 0.5 if angle < 1e-6 else angle / (2.0 * sin(min(angle, pi - 1e-6)))
    d[3] = factor * (E[2, 1] - E[1, 2])
    d[4] = factor * (E[0, 2] - E[2, 0])
    d[5] = factor * (E[1, 0] - E[0, 1])


@lean_kernel
def add_outer(d, factor, C):
    """Add factor d d' to C (n, n)."""
    for i in range(d.shape[0]):
        for j in range(d.shape[0]):
            C[i, j] += factor * d[i] * d[j]


@inner_kernel
def reach_out(C, d, rise):
    """Widen C (6, 6) so that d (6,) lies no more standard deviations out than the root of rise; return by how much it
    did."""
    inverse = np.empty((6, 6))
    if not invert_spd(C, inverse):
        return 1.0
    out = 0.0
    for i in range(6):
        out += d[i] * dot(inverse[i], d)
    rise = max(rise, 1.0)
    if out <= rise:
        return 1.0
    add_outer(d, 1.0 / rise - 1.0 / out, C)
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
    first, second = np.empty(3), np.empty(3)
    cross(axis, other, first)
    scale(first, 1.0 / sqrt(dot(first, first)))
    cross(axis, first, second)
    for i in range(3):
        free[3 + i, 3] = first[i]
        free[3 + i, 4] = second[i]
    return free


@inner_kernel
def looks(rig, Rp, centre, plane, C):
    """Return turns (v + 1, 3) from the tilt Rp and shares (v + 1, m) of each to look at.

    To the mirror image in each camera, that itself first, and along the least certain turn of C (6, 6) both ways.
    """
    views = rig.k.shape[0]
    turns = np.empty((views + 1, 3))
    shares = np.empty((views + 1, LOOK_STEPS))
    for s in range(views):
        mirrored_turn(rig.R[s], rig.t[s], Rp, centre, plane, turns[s])
        for j in range(LOOK_STEPS):
            shares[s, j] = 1.0 if j == 0 else 1.25 * j / (LOOK_STEPS - 1)
    tilts = np.empty((3, 3))
    copy_2(C[3:, 3:], tilts)
    values, vectors = np.linalg.eigh(tilts)
    for i in range(3):
        turns[views, i] = sqrt(max(values[2], 0.0)) * vectors[i, 2]
    for j in range(LOOK_STEPS):  # from half way outwards, then from there inwards
        step = (j // 2 + LOOK_STEPS // 4) % (LOOK_STEPS // 2) + 1
        shares[views, j] = FARTHEST * (2.0 * step / LOOK_STEPS) * (1.0 if j % 2 == 0 else -1.0)
    return turns, shares


@inner_kernel
def depth_chi2(rig, P, S):
    """Return the rise of chi-square that the depths of the points P (n, 3), S (n, 3, 3) set against the mirrored tilt.

    Each light's depth beyond their mean, along the line of sight to it, would change its sign. A pair is near enough
    together for the rig's origin to stand for both; of other rigs it is the camera with the least. NaN where a light
    has no point.
    """
    rig, views = RigK(*rig), rig[0].shape[0]
    eye = np.zeros(3)
    least = np.inf
    for s in range(1 if views == 2 else views):
        if views != 2:
            centre_of(rig.R[s], rig.t[s], eye)
        chi2 = depth_chi2_from(eye, P, S)
        if not chi2 >= least:
            least = chi2
    return least


@inner_kernel
def depth_chi2_from(eye, P, S):
    """Return the same for the lines of sight from one eye (3,)."""
    n = P.shape[0]
    centre, p = np.zeros(3), np.empty(3)
    for i in range(n):
        for a in range(3):
            centre[a] += (P[i, a] - eye[a]) / n
    far = sqrt(dot(centre, centre))
    chi2 = 0.0
    for i in range(n):
        variance = 0.0
        for a in range(3):
            p[a] = P[i, a] - eye[a]
            variance += centre[a] * dot(S[i, a], centre) / far**2
        chi2 += 4.0 * ((dot(p, centre) - far * far) / far) ** 2 / max(variance, 1e-30)
    return chi2


@inner_kernel
def fold(rig, lights, views, T, factor, C):
    """Widen C (6, 6) of the pose T (4, 4) for tilts that first order takes as too unlikely; return by how much.

    rig, lights, views: as solve_named takes them. factor: on every pixel's variance, of misfit, which C has.
    The number is the largest ratio of squared deviations to the rise of chi-square, 1 where first order holds.
    """
    rig = RigK(*rig)
    uv, cov = views
    W = np.empty_like(cov)
    X = lights[0].copy()  # writable as in the search: one compilation serves both
    lights, seen = Lights(X, lights[1], lights[2]), Observations(uv, W)
    residual = np.empty(uv.shape)
    Rp, tp = np.empty((3, 3)), np.empty(3)
    split(T, Rp, tp)
    R2, t2, turn = np.empty((3, 3)), np.empty(3), np.empty(3)
    d, H = np.empty(6), np.empty((6, 6))
    centre = np.zeros(3)
    for i in range(X.shape[0]):
        for a in range(3):
            centre[a] += (dot(Rp[a], X[i]) + tp[a]) / X.shape[0]
    if not weights(cov, 0.0, W):
        return 1.0
    work = new_work()
    base = pose_normal(rig, lights, seen, Rp, tp, H, np.empty(6), residual, work)
    most = 1.0
    turns, shares = looks(rig, Rp, centre, plane_normal(lights), C)
    last = turns.shape[0] - 1
    for s in range(last + 1):
        angle = sqrt(dot(turns[s], turns[s]))
        if angle < LEAST_TURN:
            continue
        copy_1(turns[s], turn)
        scale(turn, 1.0 / angle)
        free = free_beside(turn)
        for j in range(shares.shape[1]):
            copy_1(turns[s], turn)
            scale(turn, shares[s, j])
            turned_about(Rp, tp, centre, turn, R2, t2)
            if s < last and j == 0:  # the mirrored tilt: to the least chi-square near it
                state, least = refine_pose(rig, lights, seen, R2, t2, H, residual)
                rise = least - base if state == SOLVED else np.inf
            else:
                rise = settle_beside(rig, lights, seen, free, R2, t2, residual, work) - base
            if rise < POSSIBLE * factor:
                difference(Rp, tp, R2, t2, d)
                most = max(most, reach_out(C, d, rise / factor))
            if s < last and j == 0 and (most == 1.0 or not rise < POSSIBLE * factor):
                break  # there is no other tilt, or it does not fit
            if s == last and j == 1 and most == 1.0:
                break  # first order holds to either side
    return most


@inner_kernel
def one_astray(rig, lights, views, T, chi2, C):
    """Widen C (6, 6) of the pose T (4, 4) for one spot that is of something else, whichever that may be.

    rig, lights, views: as solve_named takes them. Each spot is taken as known to ASTRAY_PX only, in turn; the poses
    that follow count by their probability beside that of chi2, of the pose as it is, with a prior of ASTRAY_ODDS each.
    """
    rig, lights = RigK(*rig), Lights(*lights)
    uv, cov = views
    views = uv.shape[1]
    n = uv.shape[0] * views
    W, W2 = np.empty_like(cov), np.empty((2, 2))
    seen = Observations(uv, W)
    if not weights(cov, 0.0, W):
        return
    cost = np.full(n, np.inf)
    spread = np.zeros((n, 6, 6))
    H, residual, d = np.empty((6, 6)), np.empty(uv.shape), np.empty(6)
    R0, t0 = np.empty((3, 3)), np.empty(3)
    R2, t2, wide = np.empty((3, 3)), np.empty(3), np.empty((2, 2))
    split(T, R0, t0)
    for j in range(n):
        i, s = j // views, j % views
        if missing(cov[i, s]):
            continue
        copy_2(R0, R2)
        copy_1(t0, t2)
        copy_2(W[i, s], W2)
        copy_2(cov[i, s], wide)
        wide[0, 0] += ASTRAY_PX**2
        wide[1, 1] += ASTRAY_PX**2
        invert_2(wide, W[i, s])
        state, least = refine_pose(rig, lights, seen, R2, t2, H, residual)
        copy_2(W2, W[i, s])
        if state != SOLVED or not invert_spd(H, spread[j]):
            continue
        cost[j] = least - log(det_2(cov[i, s]) / det_2(wide)) - 2.0 * log(ASTRAY_ODDS)
        difference(R0, t0, R2, t2, d)
        add_outer(d, 1.0, spread[j])
    best = chi2
    for j in range(n):
        best = min(best, cost[j])
    total = exp(-0.5 * (chi2 - best))
    for j in range(n):
        total += exp(-0.5 * (cost[j] - best))
    for j in range(n):
        odds = exp(-0.5 * (cost[j] - best)) / total
        for a in range(6):
            for b in range(6):
                C[a, b] += odds * spread[j, a, b]
