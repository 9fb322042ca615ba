"""Compiled share of the rig's calibration in the uncertainty of poses and points.

A calibration is wrong in the same way in every frame. Its 26 parameters (left and right intrinsics, then T_rig_right as
t + dt, Exp(dw) R) carry over to whatever is fitted to the pixels: d fit = -H^-1 G' W D d parameters, with G and D
the derivatives of the pixels by the fit and by the parameters.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from armsight.optics.kernels.camera import intrinsics_jacobian, see_point
from armsight.optics.kernels.triangulation import centre_of, invert_2

PARAMETERS = 26


@njit(cache=True)
def pixel_slopes(k, R, t, p, s, uv, J, D):
    """Fill J (2, 3) = d pixel / d point and D (2, 26) = d pixel / d parameters of side s; False behind the camera."""
    if not see_point(k[s], R[s], t[s], p, uv, J):
        return False
    D[:] = 0.0
    x = R[s, 0, 0] * p[0] + R[s, 0, 1] * p[1] + R[s, 0, 2] * p[2] + t[s, 0]
    y = R[s, 1, 0] * p[0] + R[s, 1, 1] * p[1] + R[s, 1, 2] * p[2] + t[s, 1]
    z = R[s, 2, 0] * p[0] + R[s, 2, 1] * p[1] + R[s, 2, 2] * p[2] + t[s, 2]
    intrinsics_jacobian(k[s], x, y, z, D[:, 10 * s : 10 * s + 10])
    if s == 1:
        q = np.empty(3)
        centre_of(R[s], t[s], q)
        q = p - q
        for i in range(2):
            for j in range(3):
                D[i, 20 + j] = -J[i, j]
            # d p_camera = R' (q x dw)
            D[i, 23] = J[i, 2] * q[1] - J[i, 1] * q[2]
            D[i, 24] = J[i, 0] * q[2] - J[i, 2] * q[0]
            D[i, 25] = J[i, 1] * q[0] - J[i, 0] * q[1]
    return True


@njit(cache=True)
def add_pose_share(k, R, t, cov, X, T, covariance, C):
    """Add the calibration's share to C (6, 6) of the pose T (4, 4) of X (n, 3) seen with cov (n, 2, 2, 2)."""
    B = np.zeros((6, PARAMETERS))
    uv = np.empty(2)
    J = np.empty((2, 3))
    D = np.empty((2, PARAMETERS))
    W = np.empty((2, 2))
    G = np.empty((2, 6))
    q = np.empty(3)
    p = np.empty(3)
    for n in range(X.shape[0]):
        for i in range(3):
            q[i] = T[i, 0] * X[n, 0] + T[i, 1] * X[n, 1] + T[i, 2] * X[n, 2]
            p[i] = q[i] + T[i, 3]
        for s in range(2):
            if not (pixel_slopes(k, R, t, p, s, uv, J, D) and invert_2(cov[n, s], W)):
                continue
            for i in range(2):
                G[i, :3] = J[i]
                G[i, 3] = q[1] * J[i, 2] - q[2] * J[i, 1]
                G[i, 4] = q[2] * J[i, 0] - q[0] * J[i, 2]
                G[i, 5] = q[0] * J[i, 1] - q[1] * J[i, 0]
            B += G.T @ (W @ D)
    A = C @ B
    C += A @ covariance @ A.T


@njit(cache=True)
def point_slopes(k, R, t, cov, P, S, A):
    """Fill A (n, 3, 26): how points P (n, 3), fitted with cov (n, 2, 2, 2) to S (n, 3, 3), follow the parameters."""
    uv = np.empty(2)
    J = np.empty((2, 3))
    D = np.empty((2, PARAMETERS))
    W = np.empty((2, 2))
    for n in range(P.shape[0]):
        B = np.zeros((3, PARAMETERS))
        for s in range(2):
            if pixel_slopes(k, R, t, P[n], s, uv, J, D) and invert_2(cov[n, s], W):
                B += J.T @ (W @ D)
        A[n] = -(np.ascontiguousarray(S[n]) @ B)
