"""Compiled pose of named spots seen by a rig's cameras: start, maximum likelihood of all sights, covariance.

Spots are indexed [light, view], for any number of views. Where a view does not show a light the spot's uv is NaN, its
covariance infinite and its weight zero. A pose is Rp (3, 3), tp (3,) with p_rig = Rp p_target + tp.
"""

from __future__ import annotations

from math import sqrt
from typing import Any, NamedTuple

import numpy as np

from armsight._numba import inner_kernel, kernel, lean_kernel
from armsight.fitting.kernels import diagonalise, invert_spd, solve_damped
from armsight.geometry.kernels import copy_1, copy_2, copy_3, cross, dot, rotate_left, sandwich
from armsight.optics.kernels.camera import CameraK, RigK, see_point
from armsight.optics.kernels.light_image import see_light
from armsight.optics.kernels.triangulation import FOUND, invert_2, missing, triangulate_ml_point

SOLVED, NO_WEIGHT, NO_POINT, BEHIND_CAMERA, OPEN, ENDLESS = 0, 1, 2, 3, 4, 5

MAX_STEPS = 200  # five or fewer where residuals are noise; a target seen straight on that does not fit takes many
SETTLED = 1e-8  # fall of chi-square, relative and absolute, that counts as none: 1e-4 of a standard deviation


class Lights(NamedTuple):
    """The n named lights of a target: X (n, 3) m, in its axes.

    radius (n, v): of a flat light whose outline the spot of that view is, in m, else 0; normal (3,): of their plane.
    """

    X: Any
    radius: Any
    normal: Any


class Observations(NamedTuple):
    """What the v cameras saw of n lights: uv (n, v, 2) px, W (n, v, 2, 2) the inverse of each spot's covariance."""

    uv: Any
    W: Any


class Workspace(NamedTuple):
    """Small arrays that one light after the other is projected with; making them would take as long as that."""

    q: Any  # (3,) the light turned, in rig axes, the normal there
    p: Any
    m: Any
    px: Any  # (2,) its pixel, and the derivatives: by its place (2, 3), by the pose (2, 6), these weighted
    J: Any
    G: Any
    WG: Any


@inner_kernel
def new_work():
    """Return fresh work arrays."""
    return Workspace(
        np.empty(3), np.empty(3), np.empty(3), np.empty(2), np.empty((2, 3)), np.empty((2, 6)), np.empty((2, 6))
    )


@inner_kernel
def kabsch(X, P, R, t):
    """Fill R (3, 3), t (3,) so that P ~ R X + t for X, P (n, 3) in least squares (Horn's quaternion)."""
    n = X.shape[0]
    mx = np.zeros(3)
    mp = np.zeros(3)
    for i in range(n):
        for a in range(3):
            mx[a] += X[i, a] / n
            mp[a] += P[i, a] / n
    M = np.zeros((3, 3))
    for i in range(n):
        for a in range(3):
            for b in range(3):
                M[a, b] += (X[i, a] - mx[a]) * (P[i, b] - mp[b])
    N = np.empty((4, 4))
    N[0, 0] = M[0, 0] + M[1, 1] + M[2, 2]
    N[0, 1] = M[1, 2] - M[2, 1]
    N[0, 2] = M[2, 0] - M[0, 2]
    N[0, 3] = M[0, 1] - M[1, 0]
    N[1, 1] = M[0, 0] - M[1, 1] - M[2, 2]
    N[1, 2] = M[0, 1] + M[1, 0]
    N[1, 3] = M[2, 0] + M[0, 2]
    N[2, 2] = -M[0, 0] + M[1, 1] - M[2, 2]
    N[2, 3] = M[1, 2] + M[2, 1]
    N[3, 3] = -M[0, 0] - M[1, 1] + M[2, 2]
    for a in range(4):
        for b in range(a):
            N[a, b] = N[b, a]
    V = np.empty((4, 4))
    diagonalise(N, V)
    k = 0
    for a in range(1, 4):
        if N[a, a] > N[k, k]:
            k = a
    w, x, y, z = V[0, k], V[1, k], V[2, k], V[3, k]
    R[0, 0] = 1.0 - 2.0 * (y * y + z * z)
    R[0, 1] = 2.0 * (x * y - w * z)
    R[0, 2] = 2.0 * (x * z + w * y)
    R[1, 0] = 2.0 * (x * y + w * z)
    R[1, 1] = 1.0 - 2.0 * (x * x + z * z)
    R[1, 2] = 2.0 * (y * z - w * x)
    R[2, 0] = 2.0 * (x * z - w * y)
    R[2, 1] = 2.0 * (y * z + w * x)
    R[2, 2] = 1.0 - 2.0 * (x * x + y * y)
    for a in range(3):
        t[a] = mp[a] - (R[a, 0] * mx[0] + R[a, 1] * mx[1] + R[a, 2] * mx[2])


@lean_kernel
def pose_normal(rig, lights, seen, Rp, tp, H, g, residual, work):
    """Fill H (6, 6), g (6,), residual (n, v, 2) of chi-square / 2 at the pose Rp, tp; return chi-square.

    The pose moves as t + dt, Exp(dw) R in rig axes. Infinite where a light is behind a camera that shows it.
    """
    X, normal = lights.X, lights.normal
    q, p, m, px, J, G, WG = work
    for i in range(6):
        g[i] = 0.0
        for j in range(6):
            H[i, j] = 0.0
    for i in range(3):
        m[i] = Rp[i, 0] * normal[0] + Rp[i, 1] * normal[1] + Rp[i, 2] * normal[2]
    chi2 = 0.0
    for n in range(X.shape[0]):
        for i in range(3):
            q[i] = Rp[i, 0] * X[n, 0] + Rp[i, 1] * X[n, 1] + Rp[i, 2] * X[n, 2]
            p[i] = q[i] + tp[i]
        for s in range(seen.uv.shape[1]):
            if seen.W[n, s, 0, 0] == 0.0:
                residual[n, s, 0] = 0.0
                residual[n, s, 1] = 0.0
                continue
            if not see_light(CameraK(rig.k[s], rig.R[s], rig.t[s]), p, lights.radius[n, s], m, px, J):
                return np.inf
            rx = px[0] - seen.uv[n, s, 0]
            ry = px[1] - seen.uv[n, s, 1]
            residual[n, s, 0] = rx
            residual[n, s, 1] = ry
            for i in range(2):
                a, b, c = J[i, 0], J[i, 1], J[i, 2]
                G[i, 0] = a
                G[i, 1] = b
                G[i, 2] = c
                G[i, 3] = q[1] * c - q[2] * b  # (q x J')
                G[i, 4] = q[2] * a - q[0] * c
                G[i, 5] = q[0] * b - q[1] * a
            w = seen.W[n, s]
            for j in range(6):
                WG[0, j] = w[0, 0] * G[0, j] + w[0, 1] * G[1, j]
                WG[1, j] = w[1, 0] * G[0, j] + w[1, 1] * G[1, j]
            chi2 += rx * (w[0, 0] * rx + w[0, 1] * ry) + ry * (w[1, 0] * rx + w[1, 1] * ry)
            for i in range(6):
                g[i] += WG[0, i] * rx + WG[1, i] * ry
                for j in range(i + 1):
                    H[i, j] += G[0, i] * WG[0, j] + G[1, i] * WG[1, j]
    for i in range(6):
        for j in range(i):
            H[j, i] = H[i, j]
    return chi2


@inner_kernel
def refine_pose(rig, lights, seen, Rp, tp, H, residual):
    """Move Rp, tp to the least chi-square from where they are; return (state, chi-square).

    H (6, 6) and residual (n, v, 2) are left at the minimum. Levenberg-Marquardt, damped after Nielsen.
    """
    g = np.empty(6)
    H2 = np.empty((6, 6))
    g2 = np.empty(6)
    residual2 = np.empty_like(residual)
    step = np.empty(6)
    R2 = np.empty((3, 3))
    t2 = np.empty(3)
    work = new_work()
    chi2 = pose_normal(rig, lights, seen, Rp, tp, H, g, residual, work)
    if not np.isfinite(chi2):
        return BEHIND_CAMERA, np.inf
    damping = 0.0
    growth = 2.0
    for _ in range(MAX_STEPS):
        if not solve_damped(H, g, damping, step):
            return OPEN, np.inf
        promised = -dot(step, g)  # fall of chi-square, more where damped
        rotate_left(step[3:], Rp, R2)
        for i in range(3):
            t2[i] = tp[i] + step[i]
        new = pose_normal(rig, lights, seen, R2, t2, H2, g2, residual2, work)
        if new <= chi2:
            settled = chi2 - new <= SETTLED * (1.0 + chi2)
            share = 2.0 * (chi2 - new) / promised - 1.0
            chi2 = new
            copy_2(R2, Rp)
            copy_1(t2, tp)
            copy_2(H2, H)
            copy_1(g2, g)
            copy_3(residual2, residual)
            if settled or promised <= SETTLED * (1.0 + chi2):
                return SOLVED, chi2
            # less damping the better the promise was kept; where foreshortening bends the residuals it is not
            damping *= max(1.0 / 3.0, 1.0 - share**3)
            growth = 2.0
        else:
            if promised <= SETTLED * (1.0 + chi2):
                return SOLVED, chi2
            damping = max(growth * damping, 1e-2)
            growth *= 2.0
    return ENDLESS, np.inf


@inner_kernel
def weights(cov, slack2, W):
    """Fill W (n, v, 2, 2) with the inverse of cov + slack2 I, zero where it is missing; False where one has none."""
    S = np.empty((2, 2))
    for n in range(cov.shape[0]):
        for s in range(cov.shape[1]):
            if missing(cov[n, s]):
                W[n, s] = 0.0
                continue
            copy_2(cov[n, s], S)
            S[0, 0] += slack2
            S[1, 1] += slack2
            if not invert_2(S, W[n, s]):
                return False
    return True


@kernel
def slack_chi2(residual, cov, slack2):
    """Return the sum of squares of residual (n, v, 2), whitened with cov (n, v, 2, 2) + slack2 I."""
    S = np.empty((2, 2))
    W = np.empty((2, 2))
    total = 0.0
    for n in range(residual.shape[0]):
        for s in range(residual.shape[1]):
            if missing(cov[n, s]):
                continue
            copy_2(cov[n, s], S)
            S[0, 0] += slack2
            S[1, 1] += slack2
            if not invert_2(S, W):
                return np.inf
            x, y = residual[n, s, 0], residual[n, s, 1]
            total += x * (W[0, 0] * x + W[0, 1] * y) + y * (W[1, 0] * x + W[1, 1] * y)
    return total


@kernel
def triangulate_all(rig, uv, cov, P, S):
    """Fill P (n, 3), S (n, 3, 3) by maximum likelihood, NaN where there is none; return whether all n are points."""
    rig = RigK(*rig)
    whole = True
    for n in range(uv.shape[0]):
        verdict, _ = triangulate_ml_point(rig, uv[n], cov[n], P[n], S[n])
        if verdict != FOUND:
            P[n] = np.nan
            S[n] = np.nan
            whole = False
    return whole


@kernel
def point_residuals(rig, uv, P, residual):
    """Fill residual (n, v, 2) = image of P (n, 3) minus uv (n, v, 2); False where a point is behind a camera.

    Zero where uv is NaN.
    """
    k, R, t = rig
    seen = np.empty(2)
    J = np.empty((2, 3))
    for n in range(P.shape[0]):
        for s in range(uv.shape[1]):
            if np.isnan(uv[n, s, 0]):
                residual[n, s, 0] = 0.0
                residual[n, s, 1] = 0.0
                continue
            if not see_point(k[s], R[s], t[s], P[n], seen, J):
                return False
            residual[n, s, 0] = seen[0] - uv[n, s, 0]
            residual[n, s, 1] = seen[1] - uv[n, s, 1]
    return True


@kernel
def stack_view(uv_view, cov_view, s, uv, cov):
    """Fill uv (n, v, 2) and cov (n, v, 2, 2) [light, view] of view s from its spots, in the lights' order."""
    for i in range(uv.shape[0]):
        for a in range(2):
            uv[i, s, a] = uv_view[i, a]
            for b in range(2):
                cov[i, s, a, b] = cov_view[i, a, b]


@inner_kernel
def solve_named(rig, views, slack2, lights, start, P, S, T, C, residual):
    """Pose of a target from its n named spots: a RigK, uv (n, v, 2) and cov (n, v, 2, 2), a slack in px^2, and Lights.

    start (4, 4): a pose to begin with; lights then count that have no point by themselves, as of one sight. Zero where
    there is none: each light must have a point.
    Returns (state, chi-square with slack, chi-square of the spots' own noise). Fills the points each by itself
    P (n, 3), S (n, 3, 3), the pose T (4, 4), its covariance C (6, 6) (translation, rotation vector; rig axes), residual
    (n, v, 2) in px. Arrays are filled, not returned: handing one back costs as much as the algebra.
    """
    uv, cov = views
    X, radius, normal = lights
    lights = Lights(X.copy(), radius, normal)  # writable as in the search: one compilation serves both
    W = np.empty_like(cov)
    H = np.empty((6, 6))
    Rp = np.empty((3, 3))
    tp = np.empty(3)
    if not weights(cov, 0.0, W):
        return NO_WEIGHT, np.inf, np.inf
    # with the plain tuple, as Python calls it: one compilation serves both
    whole = triangulate_all(rig, uv, cov, P, S)
    if start[3, 3] != 0.0:
        for i in range(3):
            for j in range(3):
                Rp[i, j] = start[i, j]
            tp[i] = start[i, 3]
    elif whole:
        kabsch(lights.X, P, Rp, tp)
    else:
        return NO_POINT, np.inf, np.inf
    state, chi2 = refine_pose(RigK(*rig), lights, Observations(uv, W), Rp, tp, H, residual)
    if state == SOLVED and not invert_spd(H, C):
        state = OPEN
    for i in range(3):
        for j in range(3):
            T[i, j] = Rp[i, j]
        T[i, 3] = tp[i]
        T[3, i] = 0.0
    T[3, 3] = 1.0
    return state, slack_chi2(residual, cov, slack2), chi2


@kernel
def pachidis_frame(P, S, T, C):
    """Frame of three points P (3, 3), rows A, B, C, with joint covariance S (9, 9); False where they are on one line.

    Origin G at their mean, u = A to G, w = (B - G) x (A - G), v = w x u (Pachidis 2005, eqs. 7-8). C (6, 6) is the
    covariance of (dt, dw) to first order; T (4, 4) the pose.
    """
    a = np.empty(3)
    b = np.empty(3)
    for i in range(3):
        T[i, 3] = (P[0, i] + P[1, i] + P[2, i]) / 3.0
        a[i] = P[0, i] - T[i, 3]
        b[i] = P[1, i] - T[i, 3]
    u, v, w = np.empty(3), np.empty(3), np.empty(3)
    cross(b, a, w)
    na = sqrt(dot(a, a))
    nw = sqrt(dot(w, w))
    if not (na > 0.0 and nw > 1e-6 * na * na):
        return False
    for i in range(3):
        u[i] = -a[i] / na
        w[i] /= nw
    cross(w, u, v)
    for i in range(3):
        T[i, 0] = u[i]
        T[i, 1] = v[i]
        T[i, 2] = w[i]
    # turn about v: -w . du; about w: v . du; about u: -v . dw
    J = np.zeros((6, 9))
    ba = dot(b, u)  # b = ba u + bv v in the plane
    bv = dot(b, v)
    for point in range(3):
        da = (2.0 if point == 0 else -1.0) / 3.0  # d a / d P_point
        db = (2.0 if point == 1 else -1.0) / 3.0
        for i in range(3):
            c = 3 * point + i
            J[i, c] = 1.0 / 3.0
            about_v = da * w[i] / na  # -w . du, du = -da / na
            about_w = -da * v[i] / na
            # w stays square to a and b: w . (db + dw x b) = 0 and the same for a
            about_u = (db * w[i] + about_v * ba) / bv
            for j in range(3):
                J[3 + j, c] = about_u * u[j] + about_v * v[j] + about_w * w[j]
    sandwich(J, S, C)
    return True
