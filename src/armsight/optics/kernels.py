"""Compiled pinhole projection with Brown-Conrady distortion, and its derivatives.

A camera's intrinsics travel as one vector k (10,): fx, fy, cx, cy, skew, k1, k2, p1, p2, k3; of a view through a glass
plate as k (12,), with the plate's thickness (m) and refractive index behind them.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from armsight.fitting.kernels import invert_spd, solve_damped

UNDISTORT_STEPS = 30
UNDISTORT_TOLERANCE = 1e-13


@njit(cache=True)
def distort(k, x, y):
    """Return the distorted normalised point and its derivative (xx, xy, yy) by (x, y); xy is symmetric."""
    k1, k2, p1, p2, k3 = k[5], k[6], k[7], k[8], k[9]
    r2 = x * x + y * y
    radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
    slope = k1 + r2 * (2.0 * k2 + 3.0 * r2 * k3)  # d radial / d r2
    xd = x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x)
    yd = y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y
    dxx = radial + 2.0 * x * x * slope + 2.0 * p1 * y + 6.0 * p2 * x
    dxy = 2.0 * x * y * slope + 2.0 * p1 * x + 2.0 * p2 * y
    dyy = radial + 2.0 * y * y * slope + 6.0 * p1 * y + 2.0 * p2 * x
    return xd, yd, dxx, dxy, dyy


PLATE_ROUNDS = 4
"""Steps to the ray that meets a point through the plate; each gains a factor of a thousand (shift over depth)."""


@njit(cache=True)
def plate_shift(thickness, index, U, V):
    """Return mu (m) of MATH 3.1: the ray (U, V, 1) through a plate at 45 degrees seems to start at (-mu, 0, +mu)."""
    c = (1.0 - U) / np.sqrt(2.0 * (1.0 + U * U + V * V))
    return thickness * np.sqrt(0.5) * (1.0 - c / np.sqrt(index * index - 1.0 + c * c))


@njit(cache=True)
def behind_plate(thickness, index, x, y, z):
    """Return x and z of a point as a pinhole without the plate would have it, whose centre the chief ray points to."""
    chief = plate_shift(thickness, index, 0.0, 0.0)
    shift = 0.0
    for _ in range(PLATE_ROUNDS):
        depth = z - shift
        shift = plate_shift(thickness, index, (x + shift) / depth, y / depth) - chief
    return x + shift, z - shift


@njit(cache=True)
def project_point(k, x, y, z, uv, J):
    """Fill uv (2,) and J (2, 3) = d uv / d (x, y, z) for a point in camera axes; False where z <= 0.

    Through a plate J leaves out how the shift changes with the point: a thousandth of J.
    """
    if not z > 0.0:
        return False
    if k.shape[0] > 10 and k[10] > 0.0:
        x, z = behind_plate(k[10], k[11], x, y, z)
    iz = 1.0 / z
    a = x * iz
    b = y * iz
    xd, yd, dxx, dxy, dyy = distort(k, a, b)
    fx, fy, skew = k[0], k[1], k[4]
    uv[0] = fx * xd + skew * yd + k[2]
    uv[1] = fy * yd + k[3]
    ua = fx * dxx + skew * dxy
    ub = fx * dxy + skew * dyy
    va = fy * dxy
    vb = fy * dyy
    J[0, 0] = ua * iz
    J[0, 1] = ub * iz
    J[0, 2] = -(ua * a + ub * b) * iz
    J[1, 0] = va * iz
    J[1, 1] = vb * iz
    J[1, 2] = -(va * a + vb * b) * iz
    return True


@njit(cache=True)
def intrinsics_jacobian(k, x, y, z, D):
    """Fill D (2, 10) = d uv / d intrinsics for a point in camera axes with z > 0."""
    a = x / z
    b = y / z
    xd, yd, _, _, _ = distort(k, a, b)
    fx, fy, skew = k[0], k[1], k[4]
    r2 = a * a + b * b
    D[:] = 0.0
    D[0, 0] = xd
    D[1, 1] = yd
    D[0, 2] = 1.0
    D[1, 3] = 1.0
    D[0, 4] = yd
    power = r2
    for j in (5, 6, 9):
        D[0, j] = fx * a * power + skew * b * power
        D[1, j] = fy * b * power
        power *= r2
    px, py = 2.0 * a * b, r2 + 2.0 * b * b  # by p1
    D[0, 7] = fx * px + skew * py
    D[1, 7] = fy * py
    px, py = r2 + 2.0 * a * a, 2.0 * a * b  # by p2
    D[0, 8] = fx * px + skew * py
    D[1, 8] = fy * py


@njit(cache=True)
def undistort_point(k, u, v, xy, J):
    """Fill xy (2,) with the normalised ray (x/z, y/z) of a pixel and J (2, 2) = d xy / d (u, v).

    Newton's iteration on the distortion polynomial. False where it does not converge or where the polynomial
    folds over: the pixel has no ray under this model.
    """
    yd = (v - k[3]) / k[1]
    xd = (u - k[2] - k[4] * yd) / k[0]
    x = xd
    y = yd
    ok = False
    for _ in range(UNDISTORT_STEPS):
        fx, fy, dxx, dxy, dyy = distort(k, x, y)
        det = dxx * dyy - dxy * dxy
        if not det > 0.0:
            return False
        ex = fx - xd
        ey = fy - yd
        x -= (dyy * ex - dxy * ey) / det
        y -= (dxx * ey - dxy * ex) / det
        if abs(ex) + abs(ey) < UNDISTORT_TOLERANCE:
            ok = True
            break
    if not ok:
        return False
    _, _, dxx, dxy, dyy = distort(k, x, y)
    det = dxx * dyy - dxy * dxy
    if not (det > 0.0 and dxx > 0.0):
        return False
    # d(xd, yd)/d(u, v) = [[1/fx, -skew/(fx fy)], [0, 1/fy]]
    a = 1.0 / k[0]
    b = -k[4] / (k[0] * k[1])
    c = 1.0 / k[1]
    xy[0] = x
    xy[1] = y
    J[0, 0] = dyy * a / det
    J[0, 1] = (dyy * b - dxy * c) / det
    J[1, 0] = -dxy * a / det
    J[1, 1] = (-dxy * b + dxx * c) / det
    return True


@njit(cache=True)
def project_many(k, R, t, X, uv):
    """Fill uv (n, 2) with the pixels of points X (n, 3) seen through p_camera = R X + t; NaN behind the camera."""
    J = np.empty((2, 3))
    for i in range(X.shape[0]):
        x = R[0, 0] * X[i, 0] + R[0, 1] * X[i, 1] + R[0, 2] * X[i, 2] + t[0]
        y = R[1, 0] * X[i, 0] + R[1, 1] * X[i, 1] + R[1, 2] * X[i, 2] + t[1]
        z = R[2, 0] * X[i, 0] + R[2, 1] * X[i, 1] + R[2, 2] * X[i, 2] + t[2]
        if not project_point(k, x, y, z, uv[i], J):
            uv[i, 0] = np.nan
            uv[i, 1] = np.nan


@njit(cache=True)
def undistort_many(k, uv, xy):
    """Fill xy (n, 2) with the normalised rays of pixels uv (n, 2); NaN where a pixel has no ray."""
    J = np.empty((2, 2))
    for i in range(uv.shape[0]):
        if not undistort_point(k, uv[i, 0], uv[i, 1], xy[i], J):
            xy[i, 0] = np.nan
            xy[i, 1] = np.nan


@njit(cache=True)
def see_point(k, R, t, X, uv, J):
    """Fill uv (2,) and J (2, 3) = d uv / d X for a point X (3,) in rig axes, p_camera = R X + t; False behind it."""
    x = R[0, 0] * X[0] + R[0, 1] * X[1] + R[0, 2] * X[2] + t[0]
    y = R[1, 0] * X[0] + R[1, 1] * X[1] + R[1, 2] * X[2] + t[1]
    z = R[2, 0] * X[0] + R[2, 1] * X[1] + R[2, 2] * X[2] + t[2]
    if not project_point(k, x, y, z, uv, J):
        return False
    for i in range(2):
        a, b, c = J[i, 0], J[i, 1], J[i, 2]
        for j in range(3):
            J[i, j] = a * R[0, j] + b * R[1, j] + c * R[2, j]
    return True


@njit(cache=True)
def rays_in_rig(k, R, uv, d, D, ok):
    """Fill rays d (n, 3) in rig axes of pixels uv (n, 2), D (n, 3, 2) = d ray / d pixel, ok (n,) where there is one.

    The rays have unit depth in the camera, not unit length.
    """
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


@njit(cache=True)
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


@njit(cache=True)
def quadratic_form_2(S, g):
    """Return g' S g for S (2, 2), g (2,)."""
    return g[0] * (S[0, 0] * g[0] + S[0, 1] * g[1]) + g[1] * (S[1, 0] * g[0] + S[1, 1] * g[1])


@njit(cache=True)
def epipolar_rows(d_left, D_left, d_right, D_right, baseline, out):
    """Fill out (n, 2): signed distance in px of each left pixel from its partner's line, and of each right one."""
    g_left = np.empty(2)
    g_right = np.empty(2)
    for i in range(out.shape[0]):
        e = epipolar_residual(d_left[i], D_left[i], d_right[i], D_right[i], baseline, g_left, g_right)
        out[i, 0] = e / np.hypot(g_left[0], g_left[1])
        out[i, 1] = e / np.hypot(g_right[0], g_right[1])


@njit(cache=True)
def epipolar_matrix(d_left, D_left, cov_left, d_right, D_right, cov_right, baseline, chi2):
    """Fill chi2 (n, m): whitened squared epipolar distance of every left spot to every right one; NaN without ray."""
    g_left = np.empty(2)
    g_right = np.empty(2)
    for i in range(chi2.shape[0]):
        for j in range(chi2.shape[1]):
            e = epipolar_residual(d_left[i], D_left[i], d_right[j], D_right[j], baseline, g_left, g_right)
            variance = quadratic_form_2(cov_left[i], g_left) + quadratic_form_2(cov_right[j], g_right)
            chi2[i, j] = e * e / variance


# What became of a pair of pixels; armsight.optics.triangulate.Verdict gives the names.
FOUND, NO_RAY, PARALLEL, BEHIND = 0, 1, 2, 3

PARALLEL_SINE = 1e-9
"""Rays closer to parallel than this (1e-9 rad) meet only in the rounding."""

DEPTH_DEVIATION = 1.0 / 3.0
"""A distance that is less than 3 standard deviations from infinite is not one: its covariance means nothing."""

TRIANGULATE_STEPS = 30
SETTLED = 1e-9  # fall of chi-square, relative and absolute, that counts as none: 3e-5 of a deviation


@njit(cache=True)
def _undetermined(X, S, centre):
    """Tell whether the deviation along the sight line exceeds DEPTH_DEVIATION of the distance."""
    s2 = 0.0
    n2 = 0.0
    for i in range(3):
        for j in range(3):
            s2 += (X[i] - centre[i]) * S[i, j] * (X[j] - centre[j])
        n2 += (X[i] - centre[i]) ** 2
    return not s2 <= DEPTH_DEVIATION * DEPTH_DEVIATION * n2 * n2


@njit(cache=True)
def centre_of(R, t, c):
    """Fill c (3,) with the centre of projection -R' t in rig axes."""
    for i in range(3):
        c[i] = -(R[0, i] * t[0] + R[1, i] * t[1] + R[2, i] * t[2])


@njit(cache=True)
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


@njit(cache=True)
def triangulate_linear_point(k, R, t, uv, cov, X, S):
    """Fill X (3,), S (3, 3) from the pixels uv (2, 2) of both sides with cov (2, 2, 2); return the verdict.

    Linear least squares of x (r3 X + t3) = r1 X + t1 and the same in y, in normalised coordinates of both views.
    """
    A = np.empty((4, 3))
    b = np.empty(4)
    xy = np.empty((2, 2))
    J = np.empty((2, 2, 2))
    rays = np.empty((2, 3))
    for s in range(2):
        if not undistort_point(k[s], uv[s, 0], uv[s, 1], xy[s], J[s]):
            return NO_RAY
        for c in range(2):
            for j in range(3):
                A[2 * s + c, j] = R[s, c, j] - xy[s, c] * R[s, 2, j]
            b[2 * s + c] = xy[s, c] * t[s, 2] - t[s, c]
        for j in range(3):
            rays[s, j] = R[s, 0, j] * xy[s, 0] + R[s, 1, j] * xy[s, 1] + R[s, 2, j]
    if _parallel(rays):
        return PARALLEL
    H = np.zeros((3, 3))
    g = np.zeros(3)
    for r in range(4):
        for i in range(3):
            g[i] -= A[r, i] * b[r]
            for j in range(3):
                H[i, j] += A[r, i] * A[r, j]
    P = np.empty((3, 3))
    if not (solve_damped(H, g, 0.0, X) and invert_spd(H, P)):
        return PARALLEL
    S[:] = 0.0
    behind = False
    G = np.empty((3, 2))  # d X / d pixel of one side
    for s in range(2):
        z = R[s, 2, 0] * X[0] + R[s, 2, 1] * X[1] + R[s, 2, 2] * X[2] + t[s, 2]
        behind |= not z > 0.0
        for i in range(3):
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
    centre_of(R[0], t[0], centre)
    if _undetermined(X, S, centre):
        return PARALLEL
    return BEHIND if behind else FOUND


@njit(cache=True)
def _point_normal(k, R, t, uv, W, X, H, g):
    """Fill H (3, 3) and g (3,) of the whitened reprojection of X; return the squared sum, infinite behind a camera."""
    H[:] = 0.0
    g[:] = 0.0
    p = np.empty(2)
    J = np.empty((2, 3))
    cost = 0.0
    for s in range(2):
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


@njit(cache=True)
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


@njit(cache=True)
def triangulate_ml_point(k, R, t, uv, cov, X, S):
    """Fill X (3,), S (3, 3) at the least whitened reprojection error; return (verdict, chi-square, 1 dof)."""
    verdict = triangulate_linear_point(k, R, t, uv, cov, X, S)
    if verdict != FOUND:
        return verdict, np.nan
    W = np.empty((2, 2, 2))
    if not (invert_2(cov[0], W[0]) and invert_2(cov[1], W[1])):
        return NO_RAY, np.nan
    H = np.empty((3, 3))
    g = np.empty(3)
    H2 = np.empty((3, 3))
    g2 = np.empty(3)
    step = np.empty(3)
    cost = _point_normal(k, R, t, uv, W, X, H, g)
    damping = 0.0
    for _ in range(TRIANGULATE_STEPS):
        if not solve_damped(H, g, damping, step):
            return PARALLEL, np.nan
        trial = X + step
        new = _point_normal(k, R, t, uv, W, trial, H2, g2)
        if new <= cost:
            settled = cost - new <= SETTLED * (1.0 + new)
            X[:] = trial
            cost = new
            H, H2 = H2, H
            g, g2 = g2, g
            damping *= 0.1
            if settled:
                break
        else:
            if abs(np.dot(step, g)) <= SETTLED * (1.0 + cost):
                break
            damping = max(10.0 * damping, 1e-4)
    centre = np.empty(3)
    centre_of(R[0], t[0], centre)
    if not invert_spd(H, S) or _undetermined(X, S, centre):
        return PARALLEL, np.nan
    return FOUND, cost


@njit(cache=True)
def triangulate_rows(k, R, t, uv, cov, likeliest, X, S, chi2, verdict):
    """Triangulate uv (n, 2, 2) [point, side] with cov (n, 2, 2, 2) into X (n, 3), S (n, 3, 3); NaN where refused.

    likeliest: by maximum likelihood; else the linear closed form.
    """
    W = np.empty((2, 2, 2))
    H = np.empty((3, 3))
    g = np.empty(3)
    for i in range(uv.shape[0]):
        if likeliest:
            verdict[i], chi2[i] = triangulate_ml_point(k, R, t, uv[i], cov[i], X[i], S[i])
        else:
            verdict[i] = triangulate_linear_point(k, R, t, uv[i], cov[i], X[i], S[i])
            if verdict[i] == FOUND and invert_2(cov[i, 0], W[0]) and invert_2(cov[i, 1], W[1]):
                chi2[i] = _point_normal(k, R, t, uv[i], W, X[i], H, g)
        if verdict[i] != FOUND:
            X[i] = np.nan
            S[i] = np.nan
            chi2[i] = np.nan
