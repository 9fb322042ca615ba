"""Compiled: rays of pixels and how far two of them are from meeting; points from pixels, with covariances.

Points are found in closed form and by maximum likelihood, from any number of views of a rig. A view that does not show
a point has an infinite covariance there (`missing`), and counts for nothing.
"""

from __future__ import annotations

import numpy as np

from armsight._numba import inner_kernel, kernel, lean_kernel
from armsight.fitting.kernels import invert_spd, solve_damped
from armsight.geometry.kernels import copy_1, dot
from armsight.optics.kernels.camera import RigK, see_point, undistort_point

# What became of a pair of pixels; armsight.optics.triangulate.Verdict gives the names.
FOUND, NO_RAY, PARALLEL, BEHIND = 0, 1, 2, 3

PARALLEL_SINE = 1e-9
"""Rays closer to parallel than this (1e-9 rad) meet only in the rounding."""

DEPTH_DEVIATION = 1.0 / 3.0
"""A distance that is less than 3 standard deviations from infinite is not one: its covariance means nothing."""

TRIANGULATE_STEPS = 30
SETTLED = 1e-9  # fall of chi-square, relative and absolute, that counts as none: 3e-5 of a standard deviation


@lean_kernel
def _undetermined(X, S, centre):
    """Tell whether the standard deviation along the sight line exceeds DEPTH_DEVIATION of the distance."""
    s2 = 0.0
    n2 = 0.0
    for i in range(3):
        for j in range(3):
            s2 += (X[i] - centre[i]) * S[i, j] * (X[j] - centre[j])
        n2 += (X[i] - centre[i]) ** 2
    # v'S v = |v|^2 sigma^2 of v from the camera to the point: sigma <= share |v|, without a root
    return not s2 <= DEPTH_DEVIATION * DEPTH_DEVIATION * n2 * n2


@lean_kernel
def centre_of(R, t, c):
    """Fill c (3,) with the centre of projection -R' t in rig axes."""
    for i in range(3):
        c[i] = -(R[0, i] * t[0] + R[1, i] * t[1] + R[2, i] * t[2])


@lean_kernel
def missing(S):
    """Tell whether a view does not show a light: the covariance S (2, 2) of its spot there is infinite."""
    return S[0, 0] == np.inf


@lean_kernel
def n_sights(cov):
    """Return how many of the views with cov (v, 2, 2) show a light."""
    n = 0
    for s in range(cov.shape[0]):
        n += not missing(cov[s])
    return n


@lean_kernel
def first_centre(rig, cov, c):
    """Fill c (3,) with the centre of the first camera that shows a light, seen with cov (v, 2, 2)."""
    s = 0
    while missing(cov[s]):
        s += 1
    centre_of(rig.R[s], rig.t[s], c)


@lean_kernel
def _parallel(rays):
    """Tell whether two rays (2, 3) are parallel to rounding."""
    cross2 = (
        (rays[0, 1] * rays[1, 2] - rays[0, 2] * rays[1, 1]) ** 2
        + (rays[0, 2] * rays[1, 0] - rays[0, 0] * rays[1, 2]) ** 2
        + (rays[0, 0] * rays[1, 1] - rays[0, 1] * rays[1, 0]) ** 2
    )
    a2 = rays[0, 0] ** 2 + rays[0, 1] ** 2 + rays[0, 2] ** 2
    b2 = rays[1, 0] ** 2 + rays[1, 1] ** 2 + rays[1, 2] ** 2
    return not cross2 > PARALLEL_SINE**2 * a2 * b2


@inner_kernel
def triangulate_linear_point(rig, uv, cov, X, S):
    """Fill X (3,), S (3, 3) from the pixels uv (v, 2) of all views with cov (v, 2, 2); return the verdict.

    Linear least squares of x (r3 X + t3) = r1 X + t1 and the same in y, in normalised coordinates of the views.
    """
    k, R, t = rig
    views = uv.shape[0]
    if n_sights(cov) < 2:
        return PARALLEL
    A = np.zeros((2 * views, 3))
    H, g = np.zeros((3, 3)), np.zeros(3)
    xy = np.empty((views, 2))
    J = np.empty((views, 2, 2))
    rays = np.empty((2, 3))  # the first one, and the latest
    parallel = True
    first = views
    for s in range(views):
        if missing(cov[s]):
            continue
        if not undistort_point(k[s], uv[s, 0], uv[s, 1], xy[s], J[s]):
            return NO_RAY
        # rows weighted by depth, not in px: a start (Hartley and Zisserman 2004, section 12.2)
        for c in range(2):
            for j in range(3):
                A[2 * s + c, j] = R[s, c, j] - xy[s, c] * R[s, 2, j]
            b = xy[s, c] * t[s, 2] - t[s, c]
            for i in range(3):
                g[i] -= A[2 * s + c, i] * b
                for j in range(3):
                    H[i, j] += A[2 * s + c, i] * A[2 * s + c, j]
        first = min(first, s)
        at = 0 if s == first else 1
        for j in range(3):
            rays[at, j] = R[s, 0, j] * xy[s, 0] + R[s, 1, j] * xy[s, 1] + R[s, 2, j]
        parallel &= s == first or _parallel(rays)
    if parallel:
        return PARALLEL
    P = np.empty((3, 3))
    if not (solve_damped(H, g, 0.0, X) and invert_spd(H, P)):
        return PARALLEL
    S[:] = 0.0
    behind = False
    G = np.empty((3, 2))  # d X / d pixel of one view
    for s in range(views):
        if missing(cov[s]):
            continue
        z = R[s, 2, 0] * X[0] + R[s, 2, 1] * X[1] + R[s, 2, 2] * X[2] + t[s, 2]
        behind |= not z > 0.0
        for i in range(3):
            # a row's error changes by -z with its x, so that d X / d x = z P a, P = (A'A)^-1
            mx = P[i, 0] * A[2 * s, 0] + P[i, 1] * A[2 * s, 1] + P[i, 2] * A[2 * s, 2]
            my = P[i, 0] * A[2 * s + 1, 0] + P[i, 1] * A[2 * s + 1, 1] + P[i, 2] * A[2 * s + 1, 2]
            for c in range(2):
                G[i, c] = z * (mx * J[s, 0, c] + my * J[s, 1, c])
        for i in range(3):
            gx = G[i, 0] * cov[s, 0, 0] + G[i, 1] * cov[s, 1, 0]
            gy = G[i, 0] * cov[s, 0, 1] + G[i, 1] * cov[s, 1, 1]
            for j in range(3):
                S[i, j] += gx * G[j, 0] + gy * G[j, 1]
    centre = np.empty(3)
    first_centre(rig, cov, centre)
    if _undetermined(X, S, centre):
        return PARALLEL
    return BEHIND if behind else FOUND


@inner_kernel
def _point_normal(rig, uv, W, X, H, g):
    """Fill H (3, 3) and g (3,) of the whitened reprojection of X; return the squared sum, infinite behind a camera."""
    k, R, t = rig
    H[:] = 0.0
    g[:] = 0.0
    p = np.empty(2)
    J = np.empty((2, 3))
    cost = 0.0
    for s in range(uv.shape[0]):
        if W[s, 0, 0] == 0.0:
            continue
        if not see_point(k[s], R[s], t[s], X, p, J):
            return np.inf
        rx = p[0] - uv[s, 0]
        ry = p[1] - uv[s, 1]
        wx = W[s, 0, 0] * rx + W[s, 0, 1] * ry
        wy = W[s, 1, 0] * rx + W[s, 1, 1] * ry
        cost += rx * wx + ry * wy
        for i in range(3):
            a = W[s, 0, 0] * J[0, i] + W[s, 0, 1] * J[1, i]
            b = W[s, 1, 0] * J[0, i] + W[s, 1, 1] * J[1, i]
            g[i] += J[0, i] * wx + J[1, i] * wy
            for j in range(3):
                H[i, j] += a * J[0, j] + b * J[1, j]
    return cost


@lean_kernel
def invert_2(S, out):
    """Fill out (2, 2) with the inverse of the symmetric positive S; False where it is not positive."""
    det = S[0, 0] * S[1, 1] - S[0, 1] * S[1, 0]
    if not (det > 0.0 and S[0, 0] > 0.0):
        return False
    out[0, 0] = S[1, 1] / det
    out[1, 1] = S[0, 0] / det
    out[0, 1] = -S[0, 1] / det
    out[1, 0] = -S[1, 0] / det
    return True


@lean_kernel
def view_weights(cov, W):
    """Fill W (v, 2, 2) with the inverses of cov (v, 2, 2), zero where a view is missing; False where one has none."""
    for s in range(cov.shape[0]):
        if missing(cov[s]):
            W[s] = 0.0
        elif not invert_2(cov[s], W[s]):
            return False
    return True


@inner_kernel
def triangulate_ml_point(rig, uv, cov, X, S):
    """Fill X (3,), S (3, 3) at the least whitened reprojection error; return (verdict, chi-square)."""
    verdict = triangulate_linear_point(rig, uv, cov, X, S)
    if verdict != FOUND:
        return verdict, np.nan
    W = np.empty_like(cov)
    if not view_weights(cov, W):
        return NO_RAY, np.nan
    H = np.empty((3, 3))
    g = np.empty(3)
    H2 = np.empty((3, 3))
    g2 = np.empty(3)
    step = np.empty(3)
    trial = np.empty(3)
    cost = _point_normal(rig, uv, W, X, H, g)
    damping = 0.0
    for _ in range(TRIANGULATE_STEPS):
        if not solve_damped(H, g, damping, step):
            return PARALLEL, np.nan
        for i in range(3):
            trial[i] = X[i] + step[i]
        new = _point_normal(rig, uv, W, trial, H2, g2)
        if new <= cost:
            settled = cost - new <= SETTLED * (1.0 + new)
            copy_1(trial, X)
            cost = new
            H, H2 = H2, H
            g, g2 = g2, g
            damping *= 0.1
            if settled:
                break
        else:
            if abs(dot(step, g)) <= SETTLED * (1.0 + cost):
                break
            damping = max(10.0 * damping, 1e-4)
    centre = np.empty(3)
    first_centre(rig, cov, centre)
    if not invert_spd(H, S) or _undetermined(X, S, centre):
        return PARALLEL, np.nan
    return FOUND, cost


@kernel
def triangulate_rows(rig, uv, cov, likeliest, X, S, chi2, verdict):
    """Triangulate uv (n, v, 2), cov (n, v, 2, 2) into X (n, 3), S (n, 3, 3), NaN where refused; likeliest or closed."""
    rig = RigK(*rig)
    W = np.empty(cov.shape[1:])
    H = np.empty((3, 3))
    g = np.empty(3)
    for i in range(uv.shape[0]):
        if likeliest:
            verdict[i], chi2[i] = triangulate_ml_point(rig, uv[i], cov[i], X[i], S[i])
        else:
            verdict[i] = triangulate_linear_point(rig, uv[i], cov[i], X[i], S[i])
            if verdict[i] == FOUND and view_weights(cov[i], W):
                chi2[i] = _point_normal(rig, uv[i], W, X[i], H, g)
        if verdict[i] != FOUND:
            X[i] = np.nan
            S[i] = np.nan
            chi2[i] = np.nan


@kernel
def rays_in_rig(k, R, uv, d, D, ok):
    """Fill rays d (n, 3), of depth 1 in the camera, in rig axes, D (n, 3, 2) = d ray / d pixel, and ok (n,)."""
    xy = np.empty(2)
    J = np.empty((2, 2))
    for i in range(uv.shape[0]):
        ok[i] = undistort_point(k, uv[i, 0], uv[i, 1], xy, J)
        if not ok[i]:
            d[i] = np.nan
            D[i] = np.nan
            continue
        for r in range(3):  # R is camera from rig: its transpose carries the ray into the rig's axes
            d[i, r] = R[0, r] * xy[0] + R[1, r] * xy[1] + R[2, r]
            for c in range(2):
                D[i, r, c] = R[0, r] * J[0, c] + R[1, r] * J[1, c]


@lean_kernel
def epipolar_residual(d_left, D_left, d_right, D_right, baseline, g_left, g_right):
    """Return baseline . (d_left x d_right) of one pair of rays and fill its gradients (2,) by the two pixels."""
    a = d_right[1] * baseline[2] - d_right[2] * baseline[1]  # d e / d d_left = d_right x baseline
    b = d_right[2] * baseline[0] - d_right[0] * baseline[2]
    c = d_right[0] * baseline[1] - d_right[1] * baseline[0]
    e = d_left[0] * a + d_left[1] * b + d_left[2] * c
    p = baseline[1] * d_left[2] - baseline[2] * d_left[1]  # d e / d d_right = baseline x d_left
    q = baseline[2] * d_left[0] - baseline[0] * d_left[2]
    r = baseline[0] * d_left[1] - baseline[1] * d_left[0]
    for j in range(2):
        g_left[j] = a * D_left[0, j] + b * D_left[1, j] + c * D_left[2, j]
        g_right[j] = p * D_right[0, j] + q * D_right[1, j] + r * D_right[2, j]
    return e


@lean_kernel
def quadratic_form_2(S, g):
    """Return g' S g for S (2, 2), g (2,)."""
    return g[0] * (S[0, 0] * g[0] + S[0, 1] * g[1]) + g[1] * (S[1, 0] * g[0] + S[1, 1] * g[1])


@kernel
def epipolar_rows(d_left, D_left, d_right, D_right, baseline, out):
    """Fill out (n, 2): signed distance in px of each left pixel from its partner's line, and of each right one."""
    g_left = np.empty(2)
    g_right = np.empty(2)
    for i in range(out.shape[0]):
        e = epipolar_residual(d_left[i], D_left[i], d_right[i], D_right[i], baseline, g_left, g_right)
        out[i, 0] = e / np.hypot(g_left[0], g_left[1])
        out[i, 1] = e / np.hypot(g_right[0], g_right[1])


@kernel
def epipolar_matrix(d_left, D_left, cov_left, d_right, D_right, cov_right, baseline, chi2):
    """Fill chi2 (n, m): whitened squared epipolar distance of every left spot to every right one; NaN without ray."""
    g_left = np.empty(2)
    g_right = np.empty(2)
    for i in range(chi2.shape[0]):
        for j in range(chi2.shape[1]):
            e = epipolar_residual(d_left[i], D_left[i], d_right[j], D_right[j], baseline, g_left, g_right)
            variance = quadratic_form_2(cov_left[i], g_left) + quadratic_form_2(cov_right[j], g_right)
            chi2[i, j] = e * e / variance
