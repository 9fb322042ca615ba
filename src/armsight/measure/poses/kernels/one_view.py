"""Compiled: poses by the spots of one view alone.

By three spots and three lights (perspective-three-point): Grunert's quartic as in Haralick, Lee, Ottenberg
and Nolle 1994, equations 9 and 10, over combinations, of which those count that explain a fourth light and more.
"""

from __future__ import annotations

from math import sqrt
from typing import Any, NamedTuple

import numpy as np

from armsight._numba import inner_kernel, kernel, lean_kernel
from armsight.fitting.kernels import invert_spd
from armsight.geometry.kernels import copy_1, copy_2, cross, dot
from armsight.measure.poses.kernels.correspondence import neg2_log_likelihood
from armsight.measure.poses.kernels.pose import (
    SOLVED,
    Lights,
    Observations,
    point_residuals,
    refine_pose,
    slack_chi2,
    weights,
)
from armsight.measure.poses.kernels.pose_ambiguity import LEAST_TURN, mirrored_turn, plane_normal, split, turned_about
from armsight.measure.poses.kernels.roots import real_quartic_roots
from armsight.measure.poses.kernels.tracking import transform_lights
from armsight.optics.kernels.camera import RigK, undistort_point


@inner_kernel
def frame_of(a, b, c, F):
    """Fill F (3, 3), columns, with axes along a to b and in the plane of a, b, c; False where they are on one line."""
    x, y, z = np.empty(3), np.empty(3), np.empty(3)
    for i in range(3):
        x[i] = b[i] - a[i]
        y[i] = c[i] - a[i]
    cross(x, y, z)
    length, across = sqrt(dot(x, x)), sqrt(dot(z, z))
    if not across > 1e-9 * length * sqrt(dot(y, y)):
        return False
    for i in range(3):
        x[i] /= length
        z[i] /= across
    cross(z, x, y)
    for i in range(3):
        F[i, 0] = x[i]
        F[i, 1] = y[i]
        F[i, 2] = z[i]
    return True


@inner_kernel
def poses_by_three(X, rays, poses):
    """Fill poses (4, 3, 4), camera from target, by which the lights X (3, 3) lie on unit rays (3, 3); return how many.

    Distances s, u s, v s of the three: v by the quartic, u and s by what is left.
    """
    a2 = (X[1, 0] - X[2, 0]) ** 2 + (X[1, 1] - X[2, 1]) ** 2 + (X[1, 2] - X[2, 2]) ** 2
    b2 = (X[0, 0] - X[2, 0]) ** 2 + (X[0, 1] - X[2, 1]) ** 2 + (X[0, 2] - X[2, 2]) ** 2
    c2 = (X[0, 0] - X[1, 0]) ** 2 + (X[0, 1] - X[1, 1]) ** 2 + (X[0, 2] - X[1, 2]) ** 2
    alpha, beta, gamma = dot(rays[1], rays[2]), dot(rays[0], rays[2]), dot(rays[0], rays[1])  # cosines
    if not b2 > 0.0:
        return 0
    k, m = (a2 - c2) / b2, (a2 + c2) / b2
    A, roots = np.empty(5), np.empty(4)
    A[4] = (k - 1.0) ** 2 - 4.0 * c2 / b2 * alpha**2
    A[3] = 4.0 * (k * (1.0 - k) * beta - (1.0 - m) * alpha * gamma + 2.0 * c2 / b2 * alpha**2 * beta)
    A[2] = 2.0 * (
        k * k
        - 1.0
        + 2.0 * k * k * beta**2
        + 2.0 * (b2 - c2) / b2 * alpha**2
        - 4.0 * m * alpha * beta * gamma
        + 2.0 * (b2 - a2) / b2 * gamma**2
    )
    A[1] = 4.0 * (-k * (1.0 + k) * beta + 2.0 * a2 / b2 * gamma**2 * beta - (1.0 - m) * alpha * gamma)
    A[0] = (1.0 + k) ** 2 - 4.0 * a2 / b2 * gamma**2
    F, E, P = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    found = 0
    if not frame_of(X[0], X[1], X[2], F):
        return 0
    for i in range(real_quartic_roots(A, roots)):
        v = roots[i]
        below = 2.0 * (gamma - v * alpha)
        square = 1.0 + v * v - 2.0 * v * beta
        if not (v > 0.0 and square > 0.0 and abs(below) > 1e-12):
            continue
        u = ((k - 1.0) * v * v - 2.0 * k * beta * v + 1.0 + k) / below
        s = sqrt(b2 / square)
        if not u > 0.0:
            continue
        for j in range(3):
            P[0, j] = s * rays[0, j]
            P[1, j] = u * s * rays[1, j]
            P[2, j] = v * s * rays[2, j]
        if not frame_of(P[0], P[1], P[2], E):
            continue
        for r in range(3):
            poses[found, r, 3] = P[0, r]
            for j in range(3):
                poses[found, r, j] = dot(E[r], F[j])
                poses[found, r, 3] -= poses[found, r, j] * X[0, j]
        found += 1
    return found


class Named(NamedTuple):
    """Hypotheses, best first: names (h, m) the spot of each light or -1, n (h,) how many have one, cost (h,) px^2, and
    poses (h, 3, 4), camera from target."""

    names: Any
    n: Any
    cost: Any
    poses: Any


@lean_kernel
def explain_spots(X, pose, xy, focal, reach, names, off, used):
    """Fill names (m,) with the spot nearest to each light's image, within reach (px), or -1.

    A spot is of the light that is nearest to it: others may stand behind that one, out of sight. off (m,), used (c,):
    work.

    Returns how many have one, and the squares of their distances (px^2) together; 0 where a light is behind.
    """
    for k in range(xy.shape[0]):
        used[k] = -1
    n = 0
    cost = 0.0
    for i in range(X.shape[0]):
        names[i] = -1
        x = dot(pose[0, :3], X[i]) + pose[0, 3]
        y = dot(pose[1, :3], X[i]) + pose[1, 3]
        z = dot(pose[2, :3], X[i]) + pose[2, 3]
        if not z > 0.0:
            return 0, np.inf
        off[i] = reach * reach
        for k in range(xy.shape[0]):
            square = focal * focal * ((xy[k, 0] - x / z) ** 2 + (xy[k, 1] - y / z) ** 2)
            if square < off[i]:
                off[i] = square
                names[i] = k
        if names[i] < 0:
            continue
        other = used[names[i]]
        if other >= 0 and off[other] <= off[i]:
            names[i] = -1
            continue
        used[names[i]] = i
        n += 1
        cost += off[i]
        if other >= 0:
            names[other] = -1
            n -= 1
            cost -= off[other]
    return n, cost


@lean_kernel
def move(best, source, to):
    """Copy a hypothesis from one place to another."""
    copy_1(best.names[source], best.names[to])
    best.n[to] = best.n[source]
    best.cost[to] = best.cost[source]
    copy_2(best.poses[source], best.poses[to])


@lean_kernel
def same_names(a, b):
    """Tell whether two namings (m,) are one."""
    differ = 0
    for i in range(a.shape[0]):
        differ += a[i] != b[i]
    return differ == 0


@lean_kernel
def keep_named(found, names, n, cost, pose, best):
    """Insert a hypothesis, more spots first, then less cost; the same names once. Return how many are kept."""
    for h in range(found):
        if same_names(best.names[h], names):
            if n < best.n[h] or (n == best.n[h] and cost >= best.cost[h]):
                return found
            for i in range(h, found - 1):
                move(best, i + 1, i)
            found -= 1
            break
    at = found
    while at > 0 and (best.n[at - 1] < n or (best.n[at - 1] == n and best.cost[at - 1] > cost)):
        at -= 1
    room = best.n.shape[0]
    if at == room:
        return found
    found = min(found + 1, room)
    for i in range(found - 1, at, -1):
        move(best, i - 1, i)
    copy_1(names, best.names[at])
    best.n[at] = n
    best.cost[at] = cost
    copy_2(pose, best.poses[at])
    return found


@inner_kernel
def settle(rig, lights, seen, Rp, tp, T, C):
    """Fill T (4, 4), C (6, 6) with the pose of least chi-square near Rp, tp; return that, infinite where none is."""
    H, residual = np.empty((6, 6)), np.empty(seen.uv.shape)
    state, chi2 = refine_pose(rig, lights, seen, Rp, tp, H, residual)
    T[:] = 0.0
    T[3, 3] = 1.0
    copy_2(Rp, T[:3, :3])
    copy_1(tp, T[:3, 3])
    return chi2 if state == SOLVED and invert_spd(H, C) else np.inf


@kernel
def tilts(rig, lights, views, slack2, start, T, C, scores):
    """Fill T (h, 4, 4), C (h, 6, 6), scores (h, 3): the pose near start (4, 4), and near its mirror images.

    One mirror image about the line of sight of each camera, of the first h - 1. scores: chi-square, infinite where
    there is no pose; the same of the spots as points, with slack2 (px^2) in addition; -2 log likelihood. C is of the
    spots' noise, to first order. rig, lights, views: as solve_named takes them.
    """
    packed, rig = rig, RigK(*rig)
    uv, cov = views
    X, radius, normal = lights
    W, P, residual, chi2 = np.empty_like(cov), np.empty(X.shape), np.empty(uv.shape), scores[:, 0]
    lights, seen = Lights(X.copy(), radius, normal), Observations(uv, W)
    Rp, tp, R2, t2 = np.empty((3, 3)), np.empty(3), np.empty((3, 3)), np.empty(3)
    chi2[:] = np.inf
    split(start, Rp, tp)
    if not weights(cov, 0.0, W):
        return
    chi2[0] = settle(rig, lights, seen, Rp, tp, T[0], C[0])
    centre, turn, plane = np.zeros(3), np.empty(3), plane_normal(lights)
    for i in range(X.shape[0]):
        for a in range(3):
            centre[a] += (dot(Rp[a], X[i]) + tp[a]) / X.shape[0]
    for s in range(chi2.shape[0] - 1):
        mirrored_turn(rig.R[s], rig.t[s], Rp, centre, plane, turn)
        if dot(turn, turn) > LEAST_TURN**2:
            turned_about(Rp, tp, centre, turn, R2, t2)
            chi2[s + 1] = settle(rig, lights, seen, R2, t2, T[s + 1], C[s + 1])
    for h in range(chi2.shape[0]):
        scores[h, 1] = np.inf
        if not np.isfinite(chi2[h]):
            continue
        transform_lights(T[h], X, P)
        if point_residuals(packed, uv, P, residual):
            scores[h, 1] = slack_chi2(residual, cov, slack2)
        split(T[h], Rp, tp)
        scores[h, 2] = neg2_log_likelihood(packed, (X, radius, normal), views, Rp, tp)


@inner_kernel
def explained_elsewhere(rig, s, X, pose, xy, first, reach, used):
    """Return how many lights have a spot within reach (px) in other views than s, to which the pose (3, 4) is."""
    n = 0
    p, P = np.empty(3), np.empty(3)
    for i in range(X.shape[0]):
        for a in range(3):
            p[a] = dot(pose[a, :3], X[i]) + pose[a, 3] - rig.t[s, a]
        for a in range(3):  # in rig axes
            P[a] = rig.R[s, 0, a] * p[0] + rig.R[s, 1, a] * p[1] + rig.R[s, 2, a] * p[2]
        for v in range(rig.k.shape[0]):
            z = dot(rig.R[v, 2], P) + rig.t[v, 2]
            if v == s or not z > 0.0:
                continue
            x, y = (dot(rig.R[v, 0], P) + rig.t[v, 0]) / z, (dot(rig.R[v, 1], P) + rig.t[v, 1]) / z
            near, at = (reach / rig.k[v, 0]) ** 2, -1
            for k in range(first[v], first[v + 1]):
                off = (xy[k, 0] - x) ** 2 + (xy[k, 1] - y) ** 2
                if off < near:
                    near, at = off, k
            if at >= 0 and used[at] < 0:
                used[at] = i
                n += 1
    return n


@kernel
def name_by_three(rig, s, X, spots, rules, best):
    """Fill best, as Named, with the ways in which the spots of view s may be the lights X (m, 3), by three of them.

    spots: of all views one after the other, uv (c, 2) px, and where each view's begin (v + 1,). rules: reach (px) of a
    light's image in this view and in others, the fewest sights that count, and the most combinations looked at. n is of
    all views together, names and cost of this one. Returns (how many, combinations looked at, whether that ended the
    search). It ends as well after a combination of spots by which all of this view, or all lights, are explained: other
    names for the same spots are then among its own, as each combination of spots is tried with all lights.
    """
    rig = RigK(*rig)
    reach, far, fewest, most = rules
    best = Named(*best)
    uv, first = spots
    m, c = X.shape[0], first[s + 1] - first[s]
    xy = np.empty(uv.shape)
    J = np.empty((2, 2))
    for v in range(rig.k.shape[0]):
        for k in range(first[v], first[v + 1]):
            if not undistort_point(rig.k[v], uv[k, 0], uv[k, 1], xy[k], J):
                xy[k] = np.nan
    own, rays = xy[first[s] : first[s + 1]], np.empty((c, 3))
    for i in range(c):
        length = sqrt(1.0 + own[i, 0] ** 2 + own[i, 1] ** 2)
        rays[i, 0] = own[i, 0] / length
        rays[i, 1] = own[i, 1] / length
        rays[i, 2] = 1.0 / length
    three, at, poses = np.empty((3, 3)), np.empty((3, 3)), np.empty((4, 3, 4))
    names, used, taken = np.empty(m, np.intp), np.empty(c, np.intp), np.empty(uv.shape[0], np.intp)
    off = np.empty(m)
    found = looked = np.int64(0)
    for a in range(c):
        for b in range(a + 1, c):
            for d in range(b + 1, c):
                copy_1(rays[a], at[0])
                copy_1(rays[b], at[1])
                copy_1(rays[d], at[2])
                for i in range(m):
                    copy_1(X[i], three[0])
                    for j in range(m):
                        if j == i:
                            continue
                        copy_1(X[j], three[1])
                        for g in range(m):
                            if g in (i, j):
                                continue
                            copy_1(X[g], three[2])
                            looked += 1
                            if looked > most:
                                return found, looked, True
                            for h in range(poses_by_three(three, at, poses)):
                                n, cost = explain_spots(X, poses[h], own, rig.k[s, 0], reach, names, off, used)
                                if n >= 3:
                                    taken[:] = -1
                                    n += explained_elsewhere(rig, s, X, poses[h], xy, first, far, taken)
                                if n >= fewest:
                                    found = keep_named(found, names, n, cost, poses[h], best)
                if found and best.n[0] >= min(uv.shape[0], m * rig.k.shape[0]):
                    return found, looked, False
    return found, looked, False
