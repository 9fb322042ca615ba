"""Compiled lenses: where points are seen, and the rays behind pixels.

A lens travels as one vector p (14,): fx, fy, cx, cy, skew (px), then k1, k2, p1, p2, k3; with the eleventh number over
0 it is a fisheye, of k1, k2, k3, k4; the last three are k4, k5, k6 of OpenCV's rational model, by whose polynomial the
radial series is divided. The centre of the top-left pixel is (0, 0).
"""

from __future__ import annotations

from math import atan2, cos, hypot, radians, sin, tan

import numpy as np

from armsight._numba import inner_kernel, kernel

FISHEYE_EDGE = radians(89.5)
"""Rays of a fisheye are traced up to here: x and y of (x, y, 1) have no end at 90 degrees."""


@inner_kernel
def fisheye_height(p, angle):
    """Return how far from the middle, in focal lengths, a fisheye shows a ray at an angle (rad) from its axis."""
    # Kannala and Brandt (2006): r = theta + k1 theta^3 + k2 theta^5 + k3 theta^7 + k4 theta^9
    height = angle
    power = angle
    for j in range(4):
        power *= angle * angle
        height += p[5 + j] * power
    return height


@inner_kernel
def trace_fisheye(p, xd, yd):
    """Return (x, y) of the ray (x, y, 1) that a fisheye shows at (xd, yd), by bisection; NaN from 89.5 degrees on."""
    height = hypot(xd, yd)
    low, high = 0.0, FISHEYE_EDGE
    if height >= fisheye_height(p, high):
        return np.nan, np.nan
    if height < 1e-9:
        return xd, yd
    # bisection, for it cannot leave the image; 60 halvings are below rounding
    for _ in range(60):
        middle = 0.5 * (low + high)
        if fisheye_height(p, middle) < height:
            low = middle
        else:
            high = middle
    reach = tan(0.5 * (low + high)) / height
    return reach * xd, reach * yd


@inner_kernel
def bend(p, x, y):
    """Return the distorted image (xd, yd) of the ray (x, y, 1): Brown's radial series and decentring terms; or a
    fisheye's, which are of the ray's angle."""
    if p[10] > 0.0:
        turn = atan2(y, x)
        height = fisheye_height(p, atan2(hypot(x, y), 1.0))
        return height * cos(turn), height * sin(turn)
    # Brown (1966): x (1 + k1 r^2 + k2 r^4 + k3 r^6) + 2 p1 x y + p2 (r^2 + 2 x^2), and y alike with p1 and p2 exchanged
    rr = x * x + y * y
    stretch = 1.0 + p[5] * rr + p[6] * rr * rr + p[9] * rr * rr * rr
    stretch /= 1.0 + p[11] * rr + p[12] * rr * rr + p[13] * rr * rr * rr
    decentre = 2.0 * (p[7] * y + p[8] * x)  # both decentring terms share 2 (p1 y + p2 x) along the ray
    return x * (stretch + decentre) + p[8] * rr, y * (stretch + decentre) + p[7] * rr


@kernel
def see_points(p, X, uv):
    """Fill uv (n, 2) with the pixels of points X (n, 3) in camera axes; NaN for points not in front."""
    for i in range(X.shape[0]):
        if X[i, 2] > 0.0:
            xd, yd = bend(p, X[i, 0] / X[i, 2], X[i, 1] / X[i, 2])
            uv[i, 0] = p[0] * xd + p[4] * yd + p[2]
            uv[i, 1] = p[1] * yd + p[3]
        else:
            uv[i, 0] = np.nan
            uv[i, 1] = np.nan


@kernel
def trace_rays(p, uv, rays):
    """Fill rays (n, 2) with (x, y) of the ray (x, y, 1) behind each pixel uv (n, 2); NaN where none is found.

    Newton on bend() with its slope by central differences, damped by nothing: lenses that fold inside their
    own image are not simulated.
    """
    h = 1e-6
    for i in range(uv.shape[0]):
        # u = fx xd + skew yd + cx, v = fy yd + cy, solved from below
        yd = (uv[i, 1] - p[3]) / p[1]
        xd = (uv[i, 0] - p[2] - p[4] * yd) / p[0]
        if p[10] > 0.0:
            rays[i, 0], rays[i, 1] = trace_fisheye(p, xd, yd)
            continue
        x, y = xd, yd
        error = 1.0
        for _ in range(20):
            fx, fy = bend(p, x, y)
            ex, ey = xd - fx, yd - fy
            error = abs(ex) + abs(ey)
            if error < 1e-14:
                break
            ax, ay = bend(p, x + h, y)
            bx, by = bend(p, x - h, y)
            cx, cy = bend(p, x, y + h)
            dx, dy = bend(p, x, y - h)
            xx, yx = (ax - bx) / (2.0 * h), (ay - by) / (2.0 * h)
            xy, yy = (cx - dx) / (2.0 * h), (cy - dy) / (2.0 * h)
            # Newton's step: the slope's inverse, by Cramer's rule, times what is missing
            det = xx * yy - xy * yx
            x += (yy * ex - xy * ey) / det
            y += (xx * ey - yx * ex) / det
        rays[i, 0] = x if error < 1e-9 else np.nan
        rays[i, 1] = y if error < 1e-9 else np.nan
