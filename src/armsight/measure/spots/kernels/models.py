"""The other lights: value and derivatives of each model at a pixel, and one damped least-squares fit for all.

Every model is sampled at the pixel's centre; the pixel's integration is part of the blur (1/12 px^2).

JOINT     p = b, 1/q, then u, v, A of each light: round Gaussians of one width that touch
STREAK    p = b, u, v, A, s, angle, h: a Gaussian of width s drawn along a segment of length 2 h (motion blur)
ELLIPSE   p = b, u, v, A, s, m0, m1, m2: a flat ellipse x'Mx <= 1, M = [[m0, m1], [m1, m2]], with an edge of blur s
"""

from __future__ import annotations

from math import cos, erf, exp, pi, sin, sqrt

import numpy as np

from armsight.fitting.kernels import solve_damped
from armsight.measure.spots.kernels.axes import PIXEL_VARIANCE
from armsight.measure.spots.kernels.compiled import copy_to, kernel

JOINT, STREAK, ELLIPSE = 0, 1, 2
STEPS = 40
CLOSE = 3e-3
"""Stop where a step lowers chi-square by less than this share of the noise variance."""
FAR = 5.0
"""Blurs from the edge of an ellipse beyond which it is flat."""
CORE_VARIANCE = 0.05
"""Keeps the direction of an ellipse's edge defined at its centre, px^2."""
ROOT_2 = sqrt(2.0)
ROOT_2PI = sqrt(2.0 * pi)
PRIOR_NOISE = 0.01
PRIOR_HEIGHT = 4.0
PRIOR_BLUR = 1.0
"""Standard deviations of the priors: of the height in heights of the start, of the blur in px, for a noise of this
share of the height. Unclipped lights tell both a hundred times better."""
CLIPPED_PIXEL = 2
"""Mark of a pixel whose value is a lower bound."""
LEAST_BLUR = 0.2
MOST_BLUR = 25.0


@kernel
def joint_at(p, n, x, y, J):
    """Return the light of (n - 2) / 3 Gaussians at a pixel and fill J (n,)."""
    total = 0.0
    by_width = 0.0
    J[0] = 1.0
    w = p[1]
    for k in range(2, n, 3):
        dx = x - p[k]
        dy = y - p[k + 1]
        r2 = dx * dx + dy * dy
        e = exp(-0.5 * r2 * w)
        m = p[k + 2] * e
        J[k] = m * dx * w
        J[k + 1] = m * dy * w
        J[k + 2] = e
        by_width -= 0.5 * m * r2
        total += m
    J[1] = by_width
    return total


@kernel
def streak_at(p, c, s_, x, y, J):
    """Return the light of a streak at a pixel and fill J (7,); c, s_: cosine and sine of its angle."""
    dx = x - p[1]
    dy = y - p[2]
    s = p[4]
    h = p[6]
    t = dx * c + dy * s_
    n = dy * c - dx * s_
    across = exp(-0.5 * n * n / (s * s))
    a = (t + h) / s
    b = (t - h) / s
    scale = ROOT_2PI * s / (2.0 * h)
    fa = exp(-0.5 * a * a) / ROOT_2PI
    fb = exp(-0.5 * b * b) / ROOT_2PI
    along = 0.5 * (erf(a / ROOT_2) - erf(b / ROOT_2)) * scale
    m = p[3] * across * along
    by_t = p[3] * across * (fa - fb) / s * scale
    by_n = -n / (s * s) * m
    J[0] = 1.0
    J[1] = -by_t * c + by_n * s_
    J[2] = -by_t * s_ - by_n * c
    J[3] = across * along
    J[4] = n * n / (s * s * s) * m + p[3] * across * (along - scale * (a * fa - b * fb)) / s
    J[5] = by_t * n - by_n * t
    J[6] = p[3] * across * ((fa + fb) / s * scale - along / h)
    return m


@kernel
def ellipse_at(p, x, y, J):
    """Return the light of an edge-blurred ellipse at a pixel and fill J (8,).

    m = A Phi(d / s), d = (1 - S) / (g (1 + sqrt(S + s^2 g^2))), S = x'Mx, g^2 = x'M^2x / x'Mx: the distance to the
    edge, which tends to a parabola within a blur of the centre. For a disc of radius r: d = (r^2 - R^2) /
    (r + sqrt(R^2 + s^2)), within 0.15 % of the true convolution for r >= 1.5 px and s from 0.5 to 2 px.
    """
    dx = x - p[1]
    dy = y - p[2]
    s = p[4]
    m0 = p[5]
    m1 = p[6]
    m2 = p[7]
    xx = dx * dx
    xy = dx * dy
    yy = dy * dy
    n0 = m0 * m0 + m1 * m1
    n1 = m1 * (m0 + m2)
    n2 = m1 * m1 + m2 * m2
    S = m0 * xx + 2.0 * m1 * xy + m2 * yy
    Q = S + CORE_VARIANCE * (m0 + m2)
    G = (n0 * xx + 2.0 * n1 * xy + n2 * yy + CORE_VARIANCE * (n0 + n2)) / Q
    g = sqrt(G)
    h = sqrt(S + s * s * G)
    d = (1.0 - S) / (g * (1.0 + h))
    z = d / s
    J[0] = 1.0
    if abs(z) > FAR:
        for i in range(1, 8):
            J[i] = 0.0
        if z < 0.0:
            return 0.0
        J[3] = 1.0
        return p[3]
    phi = 0.5 * (1.0 + erf(z / ROOT_2))
    slope = p[3] * exp(-0.5 * z * z) / (ROOT_2PI * s)  # dm / dd
    J[3] = phi
    J[4] = -slope * z - slope * d / (1.0 + h) * s * G / h
    # by u, v, m0, m1, m2: derivatives of S, of x'M^2x and of Q
    sx = -2.0 * (m0 * dx + m1 * dy)
    sy = -2.0 * (m1 * dx + m2 * dy)
    k = CORE_VARIANCE
    J[1] = slope * edge_slope(sx, -2.0 * (n0 * dx + n1 * dy), sx, S, Q, G, g, h, d, s)
    J[2] = slope * edge_slope(sy, -2.0 * (n1 * dx + n2 * dy), sy, S, Q, G, g, h, d, s)
    J[5] = slope * edge_slope(xx, 2.0 * (m0 * (xx + k) + m1 * xy), xx + k, S, Q, G, g, h, d, s)
    by_p = 2.0 * (m1 * (xx + yy + 2.0 * k) + (m0 + m2) * xy)
    J[6] = slope * edge_slope(2.0 * xy, by_p, 2.0 * xy, S, Q, G, g, h, d, s)
    J[7] = slope * edge_slope(yy, 2.0 * (m2 * (yy + k) + m1 * xy), yy + k, S, Q, G, g, h, d, s)
    return p[3] * phi


@kernel
def edge_slope(by_s, by_p, by_q, S, Q, G, g, h, d, s):
    """Return the derivative of the distance to the edge from those of S, P and Q (see ellipse_at)."""
    by_g2 = (by_p - G * by_q) / Q
    return -by_s / (g * (1.0 + h)) - d * (0.5 * by_g2 / G + 0.5 * (by_s + s * s * by_g2) / (h * (1.0 + h)))


@kernel
def model_at(kind, p, n, c, s, x, y, J):
    """Return the light (without background) of the model at a pixel and fill J (n,)."""
    if kind == JOINT:
        return joint_at(p, n, x, y, J)
    if kind == STREAK:
        return streak_at(p, c, s, x, y, J)
    return ellipse_at(p, x, y, J)


@kernel
def legal(kind, p, n):
    """Tell whether parameters may be evaluated at all."""
    if kind == JOINT:
        return p[1] > MOST_BLUR**-2 and p[1] < LEAST_BLUR**-2
    if not (LEAST_BLUR < p[4] < MOST_BLUR):
        return False
    if kind == STREAK:
        return 0.05 < p[6] < 60.0
    return p[5] > 0.0 and p[5] * p[7] - p[6] * p[6] > 1e-9 and p[5] + p[7] < 16.0


@kernel
def prior_weight(kind, i, height):
    """Return the weight of parameter i's prior: weak, only there for what clipping hides (the height, the blur)."""
    variance = max(PIXEL_VARIANCE, (PRIOR_NOISE * height) ** 2)
    if kind == JOINT:
        return variance / (PRIOR_HEIGHT * height) ** 2 if i > 1 and (i - 2) % 3 == 2 else 0.0
    if i == 3:
        return variance / (PRIOR_HEIGHT * height) ** 2
    return variance / (PRIOR_BLUR * PRIOR_BLUR) if i == 4 else 0.0


@kernel
def add_prior(kind, p, start, n, H, g):
    """Add the priors about start (n,) to H (n, n) and g (n,); return what they add to the sum of squares."""
    total = 0.0
    height = start[4] if kind == JOINT else start[3]
    for i in range(n):
        w = prior_weight(kind, i, height)
        if w > 0.0:
            d = p[i] - start[i]
            H[i, i] += w
            g[i] += w * d
            total += w * d * d
    return total


@kernel
def normal_equations(kind, p, n, values, use, x0, y0, H, g):
    """Fill H (n, n), g (n,) of the patch values (ny, nx), where use is not zero; return the sum of squares.

    Where use is CLIPPED_PIXEL the light is at least as bright as the value: a model that is brighter costs nothing.
    """
    J = np.empty(n)
    for a in range(n):
        g[a] = 0.0
        for b in range(n):
            H[a, b] = 0.0
    c = cos(p[5]) if kind == STREAK else 0.0
    s = sin(p[5]) if kind == STREAK else 0.0
    rss = 0.0
    for j in range(values.shape[0]):
        for i in range(values.shape[1]):
            if use[j, i] == 0:
                continue
            r = model_at(kind, p, n, c, s, float(x0 + i), float(y0 + j), J) + p[0] - values[j, i]
            if use[j, i] == CLIPPED_PIXEL and r > 0.0:
                continue
            rss += r * r
            for a in range(n):
                k = J[a]
                if k == 0.0:
                    continue
                g[a] += r * k
                for b in range(a + 1):
                    H[a, b] += k * J[b]
    for a in range(n):
        for b in range(a):
            H[b, a] = H[a, b]
    return rss


@kernel
def fit_model(kind, p, n, values, use, x0, y0, count, H):
    """Fit p (n,) in place by Levenberg-Marquardt; return the sum of squares, or -1 where it does not converge."""
    g = np.empty(n)
    step = np.empty(n)
    trial = np.empty(n)
    H2 = np.empty((n, n))
    g2 = np.empty(n)
    start = np.empty(n)
    copy_to(p[:n], start)
    if not legal(kind, p, n):
        return -1.0
    extra = 0.0
    rss = normal_equations(kind, p, n, values, use, x0, y0, H, g)
    add_prior(kind, p, start, n, H, g)
    damping = 1e-3
    for _ in range(STEPS):
        if not solve_damped(H, g, damping, step):
            return -1.0
        for i in range(n):
            trial[i] = p[i] + step[i]
        new = rss + 1.0
        new_extra = 0.0
        if legal(kind, trial, n):
            new = normal_equations(kind, trial, n, values, use, x0, y0, H2, g2)
            new_extra = add_prior(kind, trial, start, n, H2, g2)
            new += new_extra
        if not new <= rss:
            damping *= 10.0
            if damping > 1e6:
                return -1.0
            continue
        gain = rss - new
        rss = new
        extra = new_extra
        copy_to(trial, p)
        copy_to(g2, g)
        for i in range(n):
            copy_to(H2[i], H[i])
        if gain < CLOSE * rss / count and damping <= 1e-3:
            return rss - extra
        damping = max(0.1 * damping, 1e-9)
    return rss - extra if kind == ELLIPSE else -1.0  # its centre is settled long before what clipping hides


@kernel
def weighted_information(kind, p, n, values, use, x0, y0, u, v, G, tilt, residuals, out3):
    """Fill G (n, n) = sum of m J'J, the residuals (ny, nx; 0 where unused) and out3 = sums of m, r^2 m, m^2.

    tilt (n + 3, 2): see round.uncertainty, about (u, v).
    """
    J = np.empty(n)
    for a in range(n + 3):
        tilt[a, 0] = 0.0
        tilt[a, 1] = 0.0
    for a in range(n):
        for b in range(n):
            G[a, b] = 0.0
    for a in range(3):
        out3[a] = 0.0
    c = cos(p[5]) if kind == STREAK else 0.0
    s = sin(p[5]) if kind == STREAK else 0.0
    for j in range(values.shape[0]):
        for i in range(values.shape[1]):
            residuals[j, i] = 0.0
            if use[j, i] == 0:
                continue
            m = model_at(kind, p, n, c, s, float(x0 + i), float(y0 + j), J)
            r = values[j, i] - p[0] - m
            if use[j, i] == CLIPPED_PIXEL and r < 0.0:
                continue
            residuals[j, i] = r
            out3[0] += m
            out3[1] += r * r * m
            out3[2] += m * m
            dx = x0 + i - u
            dy = y0 + j - v
            tilt[n, 0] += dx * dx
            tilt[n, 1] += dx * dy
            tilt[n + 1, 1] += dy * dy
            tilt[n + 2, 0] += r * dx
            tilt[n + 2, 1] += r * dy
            for a in range(n):
                if J[a] != 0.0:
                    tilt[a, 0] += J[a] * dx
                    tilt[a, 1] += J[a] * dy
                    for b in range(a + 1):
                        G[a, b] += m * J[a] * J[b]
    for a in range(n):
        for b in range(a):
            G[b, a] = G[a, b]


@kernel
def residuals_of(kind, p, n, values, use, x0, y0, residuals):
    """Fill residuals (ny, nx): values less model, 0 where unused."""
    J = np.empty(n)
    c = cos(p[5]) if kind == STREAK else 0.0
    s = sin(p[5]) if kind == STREAK else 0.0
    for j in range(values.shape[0]):
        for i in range(values.shape[1]):
            residuals[j, i] = 0.0
            if use[j, i] != 0:
                m = model_at(kind, p, n, c, s, float(x0 + i), float(y0 + j), J)
                r = values[j, i] - p[0] - m
                residuals[j, i] = 0.0 if use[j, i] == CLIPPED_PIXEL and r < 0.0 else r


@kernel
def light_of(kind, p, n, x0, y0, values, sign):
    """Add sign times the model's light to the patch values (ny, nx)."""
    J = np.empty(n)
    c = cos(p[5]) if kind == STREAK else 0.0
    s = sin(p[5]) if kind == STREAK else 0.0
    for j in range(values.shape[0]):
        for i in range(values.shape[1]):
            values[j, i] += sign * model_at(kind, p, n, c, s, float(x0 + i), float(y0 + j), J)
