"""Compiled images of lights and points in one camera or both of a rig, with derivatives.

One light is a point, or a flat disc whose outline has a centre that the perspective shifts.
"""

from __future__ import annotations

from math import sqrt

import numpy as np

from armsight._numba import kernel, lean_kernel
from armsight.optics.kernels.camera import distort, intrinsics_jacobian, project_point, see_point


@lean_kernel
def bend_outline(k, x, y, z, nx, ny, nz, radius, uv):
    """Fill uv (2,) with the centre of a disc's distorted image; x/z, y/z is the centre of its undistorted outline.

    The mean over the outline's area is, to second order, that over four points (radius / sqrt 2) off the centre along
    two directions square to each other in the disc's plane, weighted by how much the distortion swells them.
    """
    if abs(nx) < abs(ny):
        ex, ey, ez = 0.0, nz, -ny
    else:
        ex, ey, ez = -nz, 0.0, nx
    length = sqrt(ex * ex + ey * ey + ez * ez)
    if not length > 1e-9:  # seen straight on
        ex, ey, ez, length = 1.0, 0.0, 0.0, 1.0
    ex, ey, ez = ex / length, ey / length, ez / length
    fx, fy, fz = ny * ez - nz * ey, nz * ex - nx * ez, nx * ey - ny * ex
    a, b = x / z, y / z
    s = radius * sqrt(0.5) / z
    g0, g1 = s * (ex - a * ez), s * (ey - b * ez)
    h0, h1 = s * (fx - a * fz), s * (fy - b * fz)
    xd = 0.0
    yd = 0.0
    area = 0.0
    for i in range(4):
        sign = 1.0 if i < 2 else -1.0
        dx, dy = (g0, g1) if i % 2 == 0 else (h0, h1)
        px, py, xx, xy, yy = distort(k, a + sign * dx, b + sign * dy)
        w = xx * yy - xy * xy
        xd += w * px
        yd += w * py
        area += w
    xd /= area
    yd /= area
    uv[0] = k[0] * xd + k[4] * yd + k[2]
    uv[1] = k[1] * yd + k[3]


@lean_kernel
def see_light(camera, p, radius, normal, uv, J):
    """Fill uv (2,), J (2, 3) = d uv / d p for a light at p (3,) in rig axes; False behind the camera.

    radius > 0: a flat disc with the unit normal (3,) in rig axes; uv is then the centre of its outline. The dual
    conic of the outline is r^2 (I - n n') - c c', whose centre is the image of c + (r^2 / c_z) (n_z n - e_z).
    Its change with p is that of the point: the rest is below r^2 / z^2 of it.
    """
    k, R, t = camera
    x = R[0, 0] * p[0] + R[0, 1] * p[1] + R[0, 2] * p[2] + t[0]
    y = R[1, 0] * p[0] + R[1, 1] * p[1] + R[1, 2] * p[2] + t[1]
    z = R[2, 0] * p[0] + R[2, 1] * p[1] + R[2, 2] * p[2] + t[2]
    if not project_point(k, x, y, z, uv, J):
        return False
    if radius > 0.0:
        nx = R[0, 0] * normal[0] + R[0, 1] * normal[1] + R[0, 2] * normal[2]
        ny = R[1, 0] * normal[0] + R[1, 1] * normal[1] + R[1, 2] * normal[2]
        nz = R[2, 0] * normal[0] + R[2, 1] * normal[1] + R[2, 2] * normal[2]
        s = radius * radius / z
        if not z > radius:
            return False
        bend_outline(k, x + s * nz * nx, y + s * nz * ny, z + s * (nz * nz - 1.0), nx, ny, nz, radius, uv)
    for i in range(2):
        a, b, c = J[i, 0], J[i, 1], J[i, 2]
        for j in range(3):
            J[i, j] = a * R[0, j] + b * R[1, j] + c * R[2, j]
    return True


@kernel
def see_all(k, R, t, X, uv, J):
    """Fill uv (n, V, 2) [light, camera] and J (n, V, 2, 3) = d uv / d X for X (n, 3) in rig axes; NaN without image."""
    for i in range(X.shape[0]):
        for s in range(k.shape[0]):
            if not see_point(k[s], R[s], t[s], X[i], uv[i, s], J[i, s]):
                # not zero: that would be a residual like any other, and pull the light behind the camera
                uv[i, s] = np.nan
                J[i, s] = np.nan


@kernel
def see_points(k, R, t, X, uv, J, D):
    """Fill uv (m, 2) of points X (m, 3), J (m, 2, 3) by X, D (m, 2, 10) by the intrinsics; NaN without an image."""
    by_camera = np.empty((2, 3))
    for i in range(X.shape[0]):
        x = R[0, 0] * X[i, 0] + R[0, 1] * X[i, 1] + R[0, 2] * X[i, 2] + t[0]
        y = R[1, 0] * X[i, 0] + R[1, 1] * X[i, 1] + R[1, 2] * X[i, 2] + t[1]
        z = R[2, 0] * X[i, 0] + R[2, 1] * X[i, 1] + R[2, 2] * X[i, 2] + t[2]
        if not project_point(k, x, y, z, uv[i], by_camera):
            uv[i] = np.nan
            J[i] = 0.0
            D[i] = 0.0
            continue
        # d uv / d X = d uv / d p_camera R
        for a in range(2):
            for b in range(3):
                J[i, a, b] = by_camera[a, 0] * R[0, b] + by_camera[a, 1] * R[1, b] + by_camera[a, 2] * R[2, b]
        intrinsics_jacobian(k, x, y, z, D[i])
