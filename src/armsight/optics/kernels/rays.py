"""Compiled: rays of pixels in rig axes, and how far two of them are from meeting (epipolar distances)."""

from __future__ import annotations

import numpy as np

from armsight._numba import inner_kernel, kernel
from armsight.optics.kernels.camera import undistort_point


@kernel
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


@inner_kernel
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


@inner_kernel
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
