"""The other lights: light and derivatives of each model at all pixels of a patch at once.

Every model is sampled at the pixel's centre; the pixel's integration is part of the blur (1/12 px^2).

JOINT     p = b, 1/q, then u, v, A of each light: round Gaussians of one width that touch
STREAK    p = b, u, v, A, s, angle, h: a Gaussian of width s drawn along a segment of length 2 h (motion blur)
ELLIPSE   p = b, u, v, A, s, m0, m1, m2: a flat ellipse x'Mx <= 1, M = [[m0, m1], [m1, m2]], with an edge of blur s

Derivatives J (n, pixels) lie parameter by parameter, and a loop writes one or two of them: such loops become vector
code, in which a pixel costs a tenth of what it does one by one. They cost more than the light, which a fit first looks
at alone: each model's slopes go on from what its light has left in the grid's work and in J.
"""

from __future__ import annotations

from math import cos, pi, sin, sqrt
from typing import Any, NamedTuple

import numpy as np

from armsight._numba import inner_kernel, lean_kernel, lean_sum_kernel
from armsight.measure.spots.kernels.gaussian_axes import gaussian_line, normal

JOINT, STREAK, ELLIPSE = 0, 1, 2
FAR = 5.0
"""Blurs from the edge of an ellipse beyond which it is flat."""
CORE_VARIANCE = 0.05
"""Keeps the direction of an ellipse's edge defined at its centre, px^2."""
ROOT_2 = sqrt(2.0)
ROOT_2PI = sqrt(2.0 * pi)
CLIPPED_PIXEL = 2
"""Mark of a pixel whose value is a lower bound."""
LEAST_BLUR = 0.2
MOST_BLUR = 25.0

WORK = 8


class Grid(NamedTuple):
    """The pixels of a patch: of the first one x0, y0, how many nx, ny, and of each the place x, y (nx ny,)."""

    x0: Any
    y0: Any
    nx: Any
    ny: Any
    x: Any
    y: Any
    work: Any  # (WORK, nx ny)


@inner_kernel
def grid_of(x0, y0, nx, ny):
    """Return the pixels of a patch."""
    x = np.empty(nx * ny)
    y = np.empty(nx * ny)
    for j in range(ny):
        for i in range(nx):
            x[j * nx + i] = float(x0 + i)
            y[j * nx + i] = float(y0 + j)
    return Grid(float(x0), float(y0), nx, ny, x, y, np.empty((WORK, nx * ny)))


@lean_sum_kernel
def outer(ex, ey, nx, ny, e):
    """Fill e (nx ny,) with the products of ex (nx,) and ey (ny,)."""
    for j in range(ny):
        row = e[j * nx : (j + 1) * nx]
        for i in range(nx):
            row[i] = ey[j] * ex[i]


@lean_sum_kernel
def add_scaled(a, b, factor):
    """Add factor times a to b."""
    for i in range(a.shape[0]):
        b[i] += factor * a[i]


@lean_sum_kernel
def scaled(a, factor, b):
    """Fill b with factor times a."""
    for i in range(a.shape[0]):
        b[i] = factor * a[i]


@lean_sum_kernel
def moved_round(e, x, u, scale, by_u):
    """Fill by_u with the derivative of a Gaussian's light e by its centre: scale (x - u) e."""
    for i in range(e.shape[0]):
        by_u[i] = scale * (x[i] - u) * e[i]


@lean_sum_kernel
def wider_round(e, x, y, u, v, height, by_width):
    """Add the derivative of a Gaussian's light by 1 / variance."""
    for i in range(e.shape[0]):
        by_width[i] -= 0.5 * height * ((x[i] - u) ** 2 + (y[i] - v) ** 2) * e[i]


@lean_kernel
def joint_light(p, n, grid, J, m):
    """Fill m (pixels,) with the light of (n - 2) / 3 Gaussians, and of J (n, pixels) each one's own for height 1."""
    for i in range(m.shape[0]):
        m[i] = 0.0
    w = p[1]
    # separable: nx + ny values of the Gaussian in place of nx ny
    ex = grid.work[0]
    ey = grid.work[1]
    for k in range(2, n, 3):
        gaussian_line(grid.x0, grid.nx, p[k], w, ex)
        gaussian_line(grid.y0, grid.ny, p[k + 1], w, ey)
        outer(ex, ey, grid.nx, grid.ny, J[k + 2])
        add_scaled(J[k + 2], m, p[k + 2])


@lean_kernel
def joint_slopes(p, n, grid, J):
    """Fill the rest of J (n, pixels)."""
    for i in range(J.shape[1]):
        J[1, i] = 0.0
    for k in range(2, n, 3):
        e = J[k + 2]
        height = p[k + 2]
        moved_round(e, grid.x, p[k], height * p[1], J[k])
        moved_round(e, grid.y, p[k + 1], height * p[1], J[k + 1])
        wider_round(e, grid.x, grid.y, p[k], p[k + 1], height, J[1])


@lean_sum_kernel
def streak_axes(grid, p, c, s_, across, a, b):
    """Fill the distance across the streak p, and those along it from its two ends, in widths.

    c, s_: cosine and sine of its angle.
    """
    x, y, u, v, by_s, h = grid.x, grid.y, p[1], p[2], 1.0 / p[4], p[6]
    for i in range(x.shape[0]):
        dx = x[i] - u
        dy = y[i] - v
        across[i] = (dy * c - dx * s_) * by_s
        a[i] = (dx * c + dy * s_ + h) * by_s
        b[i] = a[i] - 2.0 * h * by_s


@lean_sum_kernel
def streak_ends(fa, to_a, fb, to_b, a, b, scale):
    """Replace fa by fa - fb, to_a by the profile along, fb by fa + fb and to_b by a fa - b fb, all scaled."""
    for i in range(a.shape[0]):
        first = scale * fa[i]
        last = scale * fb[i]
        to_a[i] = scale * (to_a[i] - to_b[i])
        fa[i] = first - last
        fb[i] = first + last
        to_b[i] = a[i] * first - b[i] * last


@lean_sum_kernel
def streak_moved(across, z, along, ends, height, s, c, s_, by_u):
    """Fill the derivative by a coordinate of the centre, of which c and s_ are the direction along and across."""
    factor = height / s
    for i in range(z.shape[0]):
        by_u[i] = factor * across[i] * (z[i] * along[i] * s_ - ends[i] * c)


@lean_sum_kernel
def streak_turned(across, z, a, along, ends, height, s, h, by_angle):
    """Fill the derivative by the angle."""
    for i in range(z.shape[0]):
        t = a[i] - h / s
        by_angle[i] = height * across[i] * z[i] * (ends[i] + t * along[i])


@lean_sum_kernel
def streak_wider(across, z, along, moments, height, s, by_s):
    """Fill the derivative by the width."""
    factor = height / s
    for i in range(z.shape[0]):
        by_s[i] = factor * across[i] * (z[i] * z[i] * along[i] + along[i] - moments[i])


@lean_sum_kernel
def streak_longer(across, along, both, height, s, h, by_h):
    """Fill the derivative by half the length."""
    for_ends, for_whole = height / s, height / h
    for i in range(along.shape[0]):
        by_h[i] = across[i] * (both[i] * for_ends - along[i] * for_whole)


@lean_kernel
def streak_light(p, grid, J, m):
    """Fill m (pixels,) with the light of a streak, and of J (7, pixels) the row of its height."""
    s = p[4]
    w = grid.work
    z, a, b, across, fa, along, fb, to_b = w[0], w[1], w[2], w[3], w[4], w[5], w[6], w[7]
    streak_axes(grid, p, cos(p[5]), sin(p[5]), z, a, b)
    normal(z, across, fa)
    # the density times sqrt(2 pi): a profile of height 1
    scaled(across, ROOT_2PI, across)
    normal(a, fa, along)
    normal(b, fb, to_b)
    # along = sqrt(2 pi) s / (2 h) (Phi(a) - Phi(b)): for h -> 0 a round Gaussian of the same height
    streak_ends(fa, along, fb, to_b, a, b, ROOT_2PI * s / (2.0 * p[6]))
    for i in range(m.shape[0]):
        J[3, i] = across[i] * along[i]
    scaled(J[3], p[3], m)


@lean_kernel
def streak_slopes(p, grid, J):
    """Fill the rest of J (7, pixels)."""
    c = cos(p[5])
    s_ = sin(p[5])
    w = grid.work
    z, a, across, fa, along, fb, to_b = w[0], w[1], w[3], w[4], w[5], w[6], w[7]
    # u moves along by c and across by -s, v along by s and across by c
    streak_moved(across, z, along, fa, p[3], p[4], c, -s_, J[1])
    streak_moved(across, z, along, fa, p[3], p[4], s_, c, J[2])
    streak_wider(across, z, along, to_b, p[3], p[4], J[4])
    streak_turned(across, z, a, along, fa, p[3], p[4], p[6], J[5])
    streak_longer(across, along, fb, p[3], p[4], p[6], J[6])


@lean_sum_kernel
def edge_form(x, y, u, v, m0, m1, m2, Q, by_Q, G):
    """Fill Q = S + CORE_VARIANCE tr M, its inverse, and G = g^2 of an ellipse; see ellipse_light.

    Divisions and roots are what an ellipse's pixel costs: none is done twice.
    """
    k = CORE_VARIANCE
    # entries of M^2: g^2 = x'M^2x / x'Mx is the squared slope of sqrt(S)
    n0 = m0 * m0 + m1 * m1
    n1 = m1 * (m0 + m2)
    n2 = m1 * m1 + m2 * m2
    for i in range(x.shape[0]):
        dx = x[i] - u
        dy = y[i] - v
        q = m0 * dx * dx + 2.0 * m1 * dx * dy + m2 * dy * dy + k * (m0 + m2)
        Q[i] = q
        by_Q[i] = 1.0 / q
        G[i] = (n0 * dx * dx + 2.0 * n1 * dx * dy + n2 * dy * dy + k * (n0 + n2)) * by_Q[i]


@lean_sum_kernel
def edge_distance(Q, G, core, s, d, h, by_gh):
    """Fill the distance d to the edge, h = sqrt(S + s^2 g^2), and the inverse of g (1 + h)."""
    for i in range(Q.shape[0]):
        S = Q[i] - core
        h[i] = np.sqrt(max(S, 0.0) + s * s * G[i])
        by_gh[i] = 1.0 / (np.sqrt(G[i]) * (1.0 + h[i]))
        d[i] = (1.0 - S) * by_gh[i]


@lean_sum_kernel
def edge_cut(d, s, height, share, slope):
    """Fill slope = dm / dd by the density that it holds; beyond FAR it is zero, and the share one or zero."""
    for i in range(d.shape[0]):
        far = abs(d[i]) > FAR * s
        inside, here, steep = 1.0 if d[i] > 0.0 else 0.0, share[i], slope[i] * (height / s)
        share[i] = inside if far else here  # what is read before it is chosen from is chosen in vector code
        slope[i] = 0.0 if far else steep


@lean_sum_kernel
def edge_blur(slope, d, h, G, s, by_hh, by_s):
    """Fill the derivative by the blur s, and the inverse of h (1 + h)."""
    inverse = 1.0 / s
    for i in range(d.shape[0]):
        by_hh[i] = 1.0 / (h[i] * (1.0 + h[i]))
        by_s[i] = -slope[i] * d[i] * (inverse + s * G[i] * by_hh[i])


@lean_sum_kernel
def edge_factors(slope, by_Q, by_gh, by_hh, s, d, h):
    """Replace h and d by a and b: the light's change is -a dS - b (dP - G dQ), P = x'M^2x + CORE_VARIANCE tr M^2."""
    for i in range(d.shape[0]):
        inner = 0.5 * d[i] * by_hh[i]
        a = slope[i] * (by_gh[i] + inner)
        by_g = by_gh[i] * (1.0 + h[i])
        d[i] = slope[i] * (0.5 * d[i] * by_g * by_g + s * s * inner) * by_Q[i]
        h[i] = a


@lean_sum_kernel
def edge_moved(grid, p, a, b, G, of_M, of_M2, by_u):
    """Fill the derivative by a coordinate of the centre, for that row of M and of M^2, two numbers each."""
    x, y, u, v = grid.x, grid.y, p[1], p[2]
    mx, my = of_M
    nx, ny = of_M2
    for i in range(x.shape[0]):
        dx = x[i] - u
        dy = y[i] - v
        by_S = mx * dx + my * dy
        by_u[i] = 2.0 * (a[i] * by_S + b[i] * (nx * dx + ny * dy - G[i] * by_S))


@lean_sum_kernel
def edge_formed(x, y, u, v, a, b, G, m, m1, by_m):
    """Fill the derivative by the entry m of M's diagonal that goes with x; m1: M's other entry."""
    k = CORE_VARIANCE
    for i in range(x.shape[0]):
        dx = x[i] - u
        dy = y[i] - v
        xx = dx * dx
        by_m[i] = -a[i] * xx - b[i] * (2.0 * (m * (xx + k) + m1 * dx * dy) - G[i] * (xx + k))


@lean_sum_kernel
def edge_turned(grid, p, a, b, G, by_m):
    """Fill the derivative by m1."""
    x, y, u, v, m0, m1, m2 = grid.x, grid.y, p[1], p[2], p[5], p[6], p[7]
    k = CORE_VARIANCE
    for i in range(x.shape[0]):
        dx = x[i] - u
        dy = y[i] - v
        xy = 2.0 * dx * dy
        by_P = 2.0 * m1 * (dx * dx + dy * dy + 2.0 * k) + (m0 + m2) * xy
        by_m[i] = -a[i] * xy - b[i] * (by_P - G[i] * xy)


@lean_kernel
def ellipse_light(p, grid, J, m):
    """Fill m (pixels,) with the light of an edge-blurred ellipse, and of J (8, pixels) the row of its height.

    m = A Phi(d / s), d = (1 - S) / (g (1 + sqrt(S + s^2 g^2))), S = x'Mx, g^2 = x'M^2x / x'Mx: the distance to the
    edge, which tends to a parabola within a blur of the centre. For a disc of radius r: d = (r^2 - R^2) /
    (r + sqrt(R^2 + s^2)), within 0.15 % of the true convolution for r >= 1.5 px and s from 0.5 to 2 px.
    """
    w = grid.work
    Q, G, d, h, slope, z, by_Q, by_gh = w[0], w[1], w[2], w[3], w[4], w[5], w[6], w[7]
    edge_form(grid.x, grid.y, p[1], p[2], p[5], p[6], p[7], Q, by_Q, G)
    edge_distance(Q, G, CORE_VARIANCE * (p[5] + p[7]), p[4], d, h, by_gh)
    scaled(d, 1.0 / p[4], z)
    normal(z, slope, J[3])
    edge_cut(d, p[4], p[3], J[3], slope)
    scaled(J[3], p[3], m)


@lean_kernel
def ellipse_slopes(p, grid, J):
    """Fill the rest of J (8, pixels)."""
    u, v, m0, m1, m2 = p[1], p[2], p[5], p[6], p[7]
    w = grid.work
    G, d, h, slope, by_hh, by_Q, by_gh = w[1], w[2], w[3], w[4], w[5], w[6], w[7]
    edge_blur(slope, d, h, G, p[4], by_hh, J[4])
    edge_factors(slope, by_Q, by_gh, by_hh, p[4], d, h)
    n1 = m1 * (m0 + m2)
    edge_moved(grid, p, h, d, G, (m0, m1), (m0 * m0 + m1 * m1, n1), J[1])
    edge_moved(grid, p, h, d, G, (m1, m2), (n1, m1 * m1 + m2 * m2), J[2])
    edge_formed(grid.x, grid.y, u, v, h, d, G, m0, m1, J[5])
    edge_turned(grid, p, h, d, G, J[6])
    edge_formed(grid.y, grid.x, v, u, h, d, G, m2, m1, J[7])


@lean_kernel
def light(kind, p, n, grid, J, m):
    """Fill m (pixels,) with the light of the model (without background); J and the grid's work are written to."""
    if kind == JOINT:
        joint_light(p, n, grid, J, m)
    elif kind == STREAK:
        streak_light(p, grid, J, m)
    else:
        ellipse_light(p, grid, J, m)


@lean_kernel
def slopes(kind, p, n, grid, J):
    """Fill J (n, pixels) with the derivatives of the model whose light was filled last."""
    for i in range(J.shape[1]):
        J[0, i] = 1.0
    if kind == JOINT:
        joint_slopes(p, n, grid, J)
    elif kind == STREAK:
        streak_slopes(p, grid, J)
    else:
        ellipse_slopes(p, grid, J)


@lean_kernel
def is_feasible(kind, p, n):
    """Tell whether parameters may be evaluated at all."""
    if kind == JOINT:
        # p[1] is one over the variance
        return p[1] > MOST_BLUR**-2 and p[1] < LEAST_BLUR**-2
    if not (LEAST_BLUR < p[4] < MOST_BLUR):
        return False
    if kind == STREAK:
        return 0.05 < p[6] < 60.0
    # positive definite, and with a trace of M below 16 no half axis below a quarter of a px
    return p[5] > 0.0 and p[5] * p[7] - p[6] * p[6] > 1e-9 and p[5] + p[7] < 16.0
