"""Compiled search for the one consistent assignment of the spots of both views to the target's names.

Pairs of spots that agree with the epipolar constraint are triangulated; names are then given to pairs by
depth-first search, cut wherever a distance between two of them is not the target's; what is left is judged by
its reprojection.
"""

from __future__ import annotations

from math import log
from typing import Any, NamedTuple

import numpy as np

from armsight._numba import inner_kernel, kernel, lean_kernel
from armsight.geometry.kernels import copy_1, copy_2
from armsight.measure.poses.kernels.pose import (
    SOLVED,
    Lights,
    Observations,
    kabsch,
    new_work,
    pose_normal,
    refine_pose,
    weights,
)
from armsight.optics.kernels.camera import RigK
from armsight.optics.kernels.triangulation import (
    BEHIND,
    FOUND,
    epipolar_residual,
    missing,
    quadratic_form_2,
    rays_in_rig,
    triangulate_linear_point,
)

MAX_PAIRS = 1024
MANY_PAIRS = 8192  # of coarse centres
MAX_NODES = 10_000_000  # pairs looked at in the search; about 0.1 s
HOPELESS = 20.0  # chi-square of a closed-form start over the limit beyond which no fit brings it below
JUDGED = 1500  # as many pairs take as long as judging a whole arrangement
POOLED = 4  # pairs are looked at for a pool in the time of one
SURELY = 1.0 + 1e-9  # rounding may not part what the pool lets through from what `_near` does


class PairsK(NamedTuple):
    """Pairs of spots that may be one light: index (c, 2) of the left and the right spot, uv (c, 2, 2) px, and weight.

    W (c, 2, 2, 2): inverse of the spots' covariances. P (c, 3) m, S (c, 3, 3): the point where they meet, its
    covariance. spread (c,) m: how far each may be off in any direction.
    """

    index: Any
    uv: Any
    W: Any
    P: Any
    S: Any
    spread: Any


class Model(NamedTuple):
    """The m lights of a target: X (m, 3), their distances D (m, m), the radius of flat ones (m), their normal (3,)."""

    X: Any
    D: Any
    radius: Any
    normal: Any


class Rules(NamedTuple):
    """What an arrangement must keep: gate of the distances, squared standard deviations; whether views are overlaid.

    slack2 (px^2) is added to every coordinate's variance. limits (m + 1,): largest chi-square of a fit of that many
    spots. margin: a hypothesis is kept while its chi-square is within margin of the best one's. smaller: whether those
    of fewer names than the most are kept as well. most_nodes: pairs looked at before the search is cut short.
    """

    slack2: Any
    gate: Any
    limits: Any
    margin: Any
    overlaid: Any
    smaller: Any
    most_nodes: Any


class Best(NamedTuple):
    """The best hypotheses so far: names (h, m) the pair of each name or -1, chi2 (h,) ascending, poses (h, 3, 4)."""

    names: Any
    chi2: Any
    poses: Any


@kernel
def candidate_pairs(rig, baseline, left, right, slack2, gate, overlaid, most):
    """Return pairs (c, 2), uv (c, 2, 2), cov (c, 2, 2, 2), P (c, 3), S (c, 3, 3), and how many more lay behind.

    rig: as a RigK, its baseline (3,) m. left, right: uv (n, 2) and cov (n, 2, 2) of the spots of each side. gate:
    largest whitened squared epipolar distance, with slack2 added to every coordinate's variance, which is in S as well.
    Pairs behind a camera or without a finite distance are counted or left out. overlaid: left and right are the same
    spots, of one image that holds both views, and no spot is its own partner.
    """
    rig = RigK(*rig)
    uv_left, cov_left = left
    uv_right, cov_right = right
    n_left = uv_left.shape[0]
    n_right = uv_right.shape[0]
    limit = min(n_left * n_right, most)
    pairs = np.empty((limit, 2), np.intp)
    uv = np.empty((limit, 2, 2))
    cov = np.empty((limit, 2, 2, 2))
    P = np.empty((limit, 3))
    S = np.empty((limit, 3, 3))
    d_left = np.empty((n_left, 3))
    D_left = np.empty((n_left, 3, 2))
    ok_left = np.empty(n_left, np.bool_)
    d_right = np.empty((n_right, 3))
    D_right = np.empty((n_right, 3, 2))
    ok_right = np.empty(n_right, np.bool_)
    rays_in_rig(rig.k[0], rig.R[0], uv_left, d_left, D_left, ok_left)
    rays_in_rig(rig.k[1], rig.R[1], uv_right, d_right, D_right, ok_right)
    g_left = np.empty(2)
    g_right = np.empty(2)
    wide = np.empty((2, 2, 2))
    count = 0
    behind = 0
    for i in range(n_left):
        for j in range(n_right):
            if not (ok_left[i] and ok_right[j]) or count == limit or (overlaid and i == j):
                continue
            e = epipolar_residual(d_left[i], D_left[i], d_right[j], D_right[j], baseline, g_left, g_right)
            variance = quadratic_form_2(cov_left[i], g_left) + quadratic_form_2(cov_right[j], g_right)
            variance += slack2 * (g_left[0] ** 2 + g_left[1] ** 2 + g_right[0] ** 2 + g_right[1] ** 2)
            if not e * e <= gate * variance:
                continue
            copy_1(uv_left[i], uv[count, 0])
            copy_1(uv_right[j], uv[count, 1])
            copy_2(cov_left[i], cov[count, 0])
            copy_2(cov_right[j], cov[count, 1])
            for s in range(2):
                copy_2(cov[count, s], wide[s])
                wide[s, 0, 0] += slack2
                wide[s, 1, 1] += slack2
            verdict = triangulate_linear_point(rig, uv[count], wide, P[count], S[count])
            if verdict == FOUND:
                pairs[count, 0] = i
                pairs[count, 1] = j
                count += 1
            elif verdict == BEHIND:
                behind += 1
    return pairs[:count], uv[:count], cov[:count], P[:count], S[:count], behind


@kernel
def distance_fits(P, S, a, b, distance, gate):
    """Tell whether the points a and b are `distance` apart within gate (squared standard deviations)."""
    d = (P[a, 0] - P[b, 0], P[a, 1] - P[b, 1], P[a, 2] - P[b, 2])  # no array: this runs a hundred thousand times
    length2 = d[0] * d[0] + d[1] * d[1] + d[2] * d[2]
    variance = 0.0
    for i in range(3):
        for j in range(3):
            variance += d[i] * (S[a, i, j] + S[b, i, j]) * d[j]
    # variance of the length is variance / length^2
    return (np.sqrt(length2) - distance) ** 2 * length2 <= gate * variance


@lean_kernel
def _spreads(S, gate, spread):
    """Fill spread (c,) with how far each point may be off in any direction: at least what `distance_fits` allows."""
    for c in range(S.shape[0]):
        spread[c] = np.sqrt(gate * (S[c, 0, 0] + S[c, 1, 1] + S[c, 2, 2]))


@lean_kernel
def _near(P, spread, a, b, distance):
    """Tell, cheaply, whether the points a and b could be `distance` apart."""
    x = P[a, 0] - P[b, 0]
    y = P[a, 1] - P[b, 1]
    z = P[a, 2] - P[b, 2]
    length2 = x * x + y * y + z * z
    slack = spread[a] + spread[b]
    low = max(distance - slack, 0.0)
    return low * low <= length2 <= (distance + slack) ** 2


@lean_kernel
def _fill_pool(anchor, name, candidates, D, pool):
    """Fill pool with the candidates as far from the anchor, which is `name`, as one of the later names is; return how
    many: all others `_near` refuses beside it, whatever they are called.
    """
    P, spread = candidates.P, candidates.spread
    low, high = np.inf, 0.0
    for later in range(name + 1, D.shape[0]):
        low, high = min(low, D[name, later]), max(high, D[name, later])
    x, y, z = P[anchor, 0], P[anchor, 1], P[anchor, 2]
    n = np.int64(0)
    for c in range(P.shape[0]):
        length2 = (P[c, 0] - x) ** 2 + (P[c, 1] - y) ** 2 + (P[c, 2] - z) ** 2
        slack = SURELY * (spread[anchor] + spread[c])
        pool[n] = c
        n += max(low - slack, 0.0) ** 2 <= length2 <= (high + slack) ** 2
    return n


@lean_kernel
def _allowed(name, candidate, chosen, candidates, D, rules):
    """Tell whether the candidate may be `name` beside the names already chosen: no spot serves twice."""
    pairs = candidates.index
    for other in range(name):
        c = chosen[other]
        if c < 0:
            continue
        if not _near(candidates.P, candidates.spread, c, candidate, D[other, name]):
            return False
        if pairs[c, 0] == pairs[candidate, 0] or pairs[c, 1] == pairs[candidate, 1]:
            return False
        if rules.overlaid and (pairs[c, 0] == pairs[candidate, 1] or pairs[c, 1] == pairs[candidate, 0]):
            return False
        if not distance_fits(candidates.P, candidates.S, c, candidate, D[other, name], rules.gate):
            return False
    return True


@lean_kernel
def _next_allowed(k, last, name, among, chosen, candidates, D, rules):
    """Return the first place from k up to last whose candidate may be `name` beside those chosen; last where none."""
    while k < last and not _allowed(name, among[k], chosen, candidates, D, rules):
        k += 1
    return k


@inner_kernel
def _judge(rig, model, ellipse, candidates, chosen, count, limit, Rp, tp):
    """Fit the pose to the chosen pairs; return chi-square, infinite where there is none or far above the limit."""
    pairs = candidates.index
    x = np.empty((count, 3))
    p = np.empty((count, 3))
    r = np.empty((count, 2))
    z = np.empty((count, 2, 2))
    w = np.empty((count, 2, 2, 2))
    n = 0
    for name in range(chosen.shape[0]):
        c = chosen[name]
        if c >= 0:
            copy_1(model.X[name], x[n])
            copy_1(candidates.P[c], p[n])
            r[n, 0] = model.radius if ellipse[0, pairs[c, 0]] else 0.0
            r[n, 1] = model.radius if ellipse[1, pairs[c, 1]] else 0.0
            copy_2(candidates.uv[c], z[n])
            copy_2(candidates.W[c, 0], w[n, 0])
            copy_2(candidates.W[c, 1], w[n, 1])
            n += 1
    kabsch(x, p, Rp, tp)
    H = np.empty((6, 6))
    residual = np.empty((count, 2, 2))
    lights, seen = Lights(x, r, model.normal), Observations(z, w)
    if not pose_normal(rig, lights, seen, Rp, tp, H, np.empty(6), residual, new_work()) <= HOPELESS * limit:
        return np.inf
    state, chi2 = refine_pose(rig, lights, seen, Rp, tp, H, residual)
    return chi2 if state == SOLVED else np.inf


@kernel
def search(rig, model, ellipse, pairs, rules, best):
    """Fill the best hypotheses and return (how many, how many passed in all, whether the search was cut short).

    All but ellipse are plain tuples: rig, model, rules, best as RigK, Model, Rules, Best have them; pairs: index, uv,
    cov, P, S from candidate_pairs. ellipse (2, n): which spots of each side are outlines of discs.
    Only hypotheses with the largest number of names are kept, but where rules.smaller is True: then all of three names
    and more, ordered by chi-square less what their number of spots lets expect.
    """
    rig, model, rules, kept = RigK(*rig), Model(*model), Rules(*rules), Best(*best)
    index, uv, cov, P, S = pairs
    m = model.X.shape[0]
    C = index.shape[0]
    W = np.empty_like(cov)
    if not weights(cov, rules.slack2, W):
        return np.int64(0), np.int64(0), False
    spread = np.empty(C)
    _spreads(S, rules.gate, spread)
    candidates = PairsK(index, uv, W, P, S, spread)
    chosen = np.full(m, -1, np.intp)
    following = np.zeros(m, np.intp)
    every = np.arange(C)
    pool = np.empty(C + 1, np.intp)  # what may stand beside the first one chosen, in the candidates' order
    Rp, tp = np.empty((3, 3)), np.empty(3)
    # typed: a bare 0 would have every callee compiled once for the literal and once for the number
    found = count = level = nodes = passed = pooled = np.int64(0)
    most = np.int64(3)
    while level >= 0:
        nodes += 1
        if nodes > rules.most_nodes:
            return found, passed, True
        if level == m:
            chi2 = _judge(rig, model, ellipse, candidates, chosen, count, rules.limits[count], Rp, tp)
            nodes += JUDGED
            if chi2 <= rules.limits[count]:
                passed += 1
                if rules.smaller:
                    chi2 -= rules.limits[count]
                elif count > most:
                    # those with fewer names are forgotten: the more spots fit, the less can chance explain
                    found = np.int64(0)
                    most = count
                found = _keep(found, rules.margin, chosen, chi2, Rp, tp, kept)
            level -= 1
            continue
        if chosen[level] >= 0:  # come back from below: give the name up again
            chosen[level] = -1
            count -= 1
        among, last = (every, C) if count == 0 else (pool, pooled)
        k = _next_allowed(following[level], last, level, among, chosen, candidates, model.D, rules)
        nodes += k - following[level]
        if k < last:
            chosen[level] = among[k]
            count += 1
            following[level] = k + 1
            if count == 1:
                pooled = _fill_pool(among[k], level, candidates, model.D, pool)
                nodes += C // POOLED
        # leave the name without a spot, unless too few names would then be left to reach the most so far
        elif k == last and count + (m - level - 1) >= most:
            following[level] = last + 1
        else:
            level -= 1
            continue
        level += 1
        if level < m:
            following[level] = 0
    return found, passed, False


SLACKS = np.array([0.02, 0.05, 0.1, 0.2, 0.3])  # px


@kernel
def neg2_log_likelihood(rig, lights, views, Rp, tp):
    """Return -2 log likelihood of the spots uv (n, v, 2), cov (n, v, 2, 2) of a target at the pose Rp, tp.

    rig, lights: as RigK, Lights. With the slack of SLACKS that suits it best: what the calibration adds is not known.
    """
    uv, cov = views
    X, radius, normal = lights
    n = X.shape[0]
    residual = np.empty(uv.shape)
    W = np.empty_like(cov)
    if not weights(cov, 0.0, W):
        return np.inf
    H, g = np.empty((6, 6)), np.empty(6)
    lights, seen = Lights(X.copy(), radius, normal), Observations(uv, W)
    if not np.isfinite(pose_normal(RigK(*rig), lights, seen, Rp.copy(), tp.copy(), H, g, residual, new_work())):
        return np.inf
    best = np.inf
    for slack in SLACKS:
        total = 0.0
        for i in range(n):
            for s in range(cov.shape[1]):
                if missing(cov[i, s]):
                    continue
                a = cov[i, s, 0, 0] + slack * slack
                b = cov[i, s, 0, 1]
                c = cov[i, s, 1, 1] + slack * slack
                det = a * c - b * b
                x = residual[i, s, 0]
                y = residual[i, s, 1]
                total += (c * x * x - 2.0 * b * x * y + a * y * y) / det + log(det)
        best = min(best, total)
    return best


@lean_kernel
def _keep(found, margin, chosen, chi2, Rp, tp, best):
    """Insert a hypothesis in ascending order of chi-square; return how many are kept."""
    chi2s = best.chi2
    if found and chi2 > chi2s[0] + margin:
        return found
    at = found
    while at > 0 and chi2s[at - 1] > chi2:
        at -= 1
    last = min(found, best.names.shape[0] - 1)
    if at > last:
        return found
    for i in range(last, at, -1):
        copy_1(best.names[i - 1], best.names[i])
        chi2s[i] = chi2s[i - 1]
        copy_2(best.poses[i - 1], best.poses[i])
    copy_1(chosen, best.names[at])
    chi2s[at] = chi2
    copy_2(Rp, best.poses[at])
    for a in range(3):
        best.poses[at, a, 3] = tp[a]
    found = last + 1
    # a better one may have moved the margin: the last ones are beyond it then
    while chi2s[found - 1] > chi2s[0] + margin:
        found -= 1
    return found
