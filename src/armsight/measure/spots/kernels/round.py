"""The usual case, fast: one round Gaussian light, fitted by Gauss-Newton to the pixels of its window.

Model: m(x, y) = b + A X(x) Y(y). X is a Gaussian of unit height and variance q, sampled at the pixel's centre; a
pixel's integration adds 1/12 px^2 to the variance, and the rest of its effect is below 1e-4 of A for a spot's sigma
from 1 px. For narrower spots X is the integral over the pixel (error function). Because the model separates, the
normal matrix needs only sums along the two axes; pixels that carry no information (clipped, hot, masked out) are
taken out of the sums one by one.

Parameters: u, v, A, 1/q, b.
"""

from __future__ import annotations

from math import erf, exp, pi, sqrt

import numpy as np
from numba import njit

from armsight.fitting.kernels import solve_damped
from armsight.measure.spots.kernels.compiled import copy_to, kernel
from armsight.measure.spots.kernels.uncertainty import uncertainty

PIXEL_VARIANCE = 1.0 / 12.0
NARROW = 0.9
"""Variance (px^2) below which a pixel's integral replaces its sample."""
MOST = 129
"""Largest side of a window in px."""
REACH = 4.0
"""Half side of the window in standard deviations: what lies beyond holds less than 0.1 % of the information."""
STEPS = 12
CLOSE = 1e-3
"""Stop where a step lowers chi-square by less than this: 3 % of a standard deviation."""
P = 5

# columns of the fit's result
U, V, A, Q, B, DOF, RSS, SIGNAL, FOURTH, SQUARE, RUN, TILT_X, TILT_Y = range(13)
COV = 13  # 13..15: C_H (uu, uv, vv); 16..18: C_G
RESULT = 19


@kernel
def profile(centre, q, start, n, f):
    """Fill f (3, n): profile, its derivative by the centre and by 1/q, at pixels start..start+n-1."""
    if q < NARROW:
        s2 = max(q - PIXEL_VARIANCE, 0.01)
        s = sqrt(s2)
        scale = sqrt(q) / s
        z = start - 0.5 - centre
        lower = exp(-0.5 * z * z / s2)
        area = sqrt(pi / 2.0) * s
        lower_erf = erf(z / (sqrt(2.0) * s))
        for i in range(n):
            t = z + 1.0
            upper = exp(-0.5 * t * t / s2)
            upper_erf = erf(t / (sqrt(2.0) * s))
            plain = area * (upper_erf - lower_erf)
            by_s = (plain - (t * upper - z * lower)) / s
            by_q = scale * (plain * (0.5 / q - 0.5 / s2) + 0.5 * by_s / s)
            f[0, i] = scale * plain
            f[1, i] = -scale * (upper - lower)
            f[2, i] = -q * q * by_q
            z = t
            lower = upper
            lower_erf = upper_erf
        return
    w = 1.0 / q
    d = start - centre
    e = exp(-0.5 * d * d * w)
    ratio = exp(-(d + 0.5) * w)
    shrink = exp(-w)
    for i in range(n):
        f[0, i] = e
        f[1, i] = e * d * w
        f[2, i] = -0.5 * e * d * d
        d += 1.0
        e *= ratio
        ratio *= shrink


@kernel
def gram(f, n, power, g):
    """Fill g (4, 4) with the sums of products of 1, f0, f1, f2 over n pixels, each times f0 to the power (0.0 or 1.0)."""
    for i in range(4):
        for j in range(4):
            g[i, j] = 0.0
    for i in range(n):
        x = f[0, i]
        c = f[1, i]
        s = f[2, i]
        k = 1.0 + power * (x - 1.0)
        g[0, 0] += k
        g[0, 1] += k * x
        g[0, 2] += k * c
        g[0, 3] += k * s
        g[1, 1] += k * x * x
        g[1, 2] += k * x * c
        g[1, 3] += k * x * s
        g[2, 2] += k * c * c
        g[2, 3] += k * c * s
        g[3, 3] += k * s * s
    g[2, 1] = g[1, 2]
    g[3, 1] = g[1, 3]
    g[3, 2] = g[2, 3]


@kernel
def assemble(gx, gy, a, H):
    """Fill H (5, 5) = sum of J'J from the axes' sums gx, gy (4, 4) and the height a."""
    H[0, 0] = a * a * gx[2, 2] * gy[1, 1]
    H[0, 1] = a * a * gx[1, 2] * gy[1, 2]
    H[0, 2] = a * gx[1, 2] * gy[1, 1]
    H[0, 3] = a * a * (gx[2, 3] * gy[1, 1] + gx[1, 2] * gy[1, 3])
    H[0, 4] = a * gx[0, 2] * gy[0, 1]
    H[1, 1] = a * a * gx[1, 1] * gy[2, 2]
    H[1, 2] = a * gx[1, 1] * gy[1, 2]
    H[1, 3] = a * a * (gx[1, 3] * gy[1, 2] + gx[1, 1] * gy[2, 3])
    H[1, 4] = a * gx[0, 1] * gy[0, 2]
    H[2, 2] = gx[1, 1] * gy[1, 1]
    H[2, 3] = a * (gx[1, 3] * gy[1, 1] + gx[1, 1] * gy[1, 3])
    H[2, 4] = gx[0, 1] * gy[0, 1]
    H[3, 3] = a * a * (gx[3, 3] * gy[1, 1] + 2.0 * gx[1, 3] * gy[1, 3] + gx[1, 1] * gy[3, 3])
    H[3, 4] = a * (gx[0, 3] * gy[0, 1] + gx[0, 1] * gy[0, 3])
    H[4, 4] = gx[0, 0] * gy[0, 0]
    for i in range(P):
        for j in range(i):
            H[i, j] = H[j, i]


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"reassoc", "contract", "nsz"})
def project(image, flip, x0, y0, nx, ny, fx, fy, d):
    """Fill d (6,) with the sums over the window of v X'Y, v X Y', v X Y, v (X" Y + X Y"), v and v^2."""
    d0 = 0.0
    d1 = 0.0
    d2 = 0.0
    d3 = 0.0
    total = 0
    square = 0
    for j in range(ny):
        row = image[y0 + j]
        tx = 0.0
        tc = 0.0
        ts = 0.0
        for i in range(nx):
            grey = np.int32(np.uint8(row[x0 + i] ^ flip))
            v = float(grey)
            tx += v * fx[0, i]
            tc += v * fx[1, i]
            ts += v * fx[2, i]
            total += grey
            square += grey * grey
        d0 += fy[0, j] * tc
        d1 += fy[1, j] * tx
        d2 += fy[0, j] * tx
        d3 += fy[0, j] * ts + fy[2, j] * tx
    d[0] = d0
    d[1] = d1
    d[2] = d2
    d[3] = d3
    d[4] = total
    d[5] = square


@kernel
def pixel_jacobian(fx, fy, i, j, a, J):
    """Fill J (5,) at the window's pixel (i, j) and return the light's part of the model there."""
    x = fx[0, i]
    y = fy[0, j]
    J[0] = a * fx[1, i] * y
    J[1] = a * x * fy[1, j]
    J[2] = x * y
    J[3] = a * (fx[2, i] * y + x * fy[2, j])
    J[4] = 1.0
    return a * x * y


@kernel
def take_out(image, flip, dropped, n_dropped, x0, y0, fx, fy, p, H, G, g, tilt):
    """Subtract the dropped pixels (n, 2) of x, y from H, G (5, 5), the gradient g (5,) and tilt; return their squares."""
    J = np.empty(P)
    squares = 0.0
    for k in range(n_dropped):
        x = dropped[k, 0]
        y = dropped[k, 1]
        m = pixel_jacobian(fx, fy, x - x0, y - y0, p[2], J)
        r = np.int64(np.uint8(image[y, x] ^ flip)) - p[4] - m
        squares += r * r
        for i in range(P):
            g[i] -= r * J[i]
            for j in range(P):
                H[i, j] -= J[i] * J[j]
                G[i, j] -= m * J[i] * J[j]
        dx = x - p[0]
        dy = y - p[1]
        for i in range(P):
            tilt[i, 0] -= J[i] * dx
            tilt[i, 1] -= J[i] * dy
        tilt[P, 0] -= dx * dx
        tilt[P, 1] -= dx * dy
        tilt[P + 1, 0] -= dx * dy
        tilt[P + 1, 1] -= dy * dy
    return squares


@kernel
def collect_dropped(image, flip, saturation, mask, hot, n_hot, box, dropped):
    """Fill dropped with the pixels of box (x0, x1, y0, y1) that are clipped, masked out or hot; return how many."""
    n = 0
    for y in range(box[2], box[3]):
        for x in range(box[0], box[1]):
            if np.uint8(image[y, x] ^ flip) >= saturation or (mask.size > 0 and mask[y, x] == 0):
                if n >= dropped.shape[0]:
                    return -1
                dropped[n, 0] = x
                dropped[n, 1] = y
                n += 1
    for k in range(n_hot):
        x = hot[k, 0]
        y = hot[k, 1]
        if box[0] <= x < box[1] and box[2] <= y < box[3] and np.uint8(image[y, x] ^ flip) < saturation:
            if n >= dropped.shape[0]:
                return -1
            dropped[n, 0] = x
            dropped[n, 1] = y
            n += 1
    return n


@kernel
def set_box(u, v, q, h, w, box):
    """Fill box (x0, x1, y0, y1) with the fit's window, cut at the image; False where it is too large."""
    r = int(REACH * sqrt(q) + 1.5)
    if 2 * r + 1 > MOST:
        return False
    x = int(u + 0.5)
    y = int(v + 0.5)
    box[0] = max(x - r, 0)
    box[1] = min(x + r + 1, w)
    box[2] = max(y - r, 0)
    box[3] = min(y + r + 1, h)
    return True


@kernel
def residual_sums(image, flip, dropped, n_dropped, box, fx, fy, p, out):
    """Write into out what the residuals r say: SIGNAL, FOURTH, SQUARE (sums of m, r^2 m, m^2), RUN, TILT (of r dx, r dy).

    RUN: sum of products of neighbouring residuals over its own deviation; a fitting model leaves |RUN| of order 1,
    whatever the noise level and however it varies.
    """
    nx = box[1] - box[0]
    ny = box[3] - box[2]
    above = np.zeros(nx)
    keep = np.ones((ny if n_dropped > 0 else 0, nx), np.uint8)
    for k in range(n_dropped):
        keep[dropped[k, 1] - box[2], dropped[k, 0] - box[0]] = 0
    signal = 0.0
    fourth = 0.0
    square = 0.0
    products = 0.0
    spread = 0.0
    tilt_x = 0.0
    tilt_y = 0.0
    for j in range(ny):
        row = image[box[2] + j]
        left = 0.0
        ay = p[2] * fy[0, j]
        for i in range(nx):
            m = ay * fx[0, i]
            r = float(np.uint8(row[box[0] + i] ^ flip)) - p[4] - m
            if n_dropped > 0 and keep[j, i] == 0:
                r = 0.0
                m = 0.0
            rr = r * r
            signal += m
            fourth += rr * m
            square += m * m
            products += r * (left + above[i])
            spread += rr * (left * left + above[i] * above[i])
            tilt_x += r * (box[0] + i - p[0])
            tilt_y += r * (box[2] + j - p[1])
            left = r
            above[i] = r
    out[SIGNAL] = signal
    out[FOURTH] = fourth
    out[SQUARE] = square
    out[RUN] = products / sqrt(spread) if spread > 0.0 else 0.0
    out[TILT_X] = tilt_x
    out[TILT_Y] = tilt_y


@kernel
def tilt_sums(fx, fy, nx, ny, x0, y0, p, tilt):
    """Fill rows 0..6 of tilt (8, 2) for a window (see uncertainty)."""
    sx = np.zeros(4)  # sums of X, X', X" and pixels; then the same times dx
    tx = np.zeros(4)
    sy = np.zeros(4)
    ty = np.zeros(4)
    xx = 0.0
    yy = 0.0
    for i in range(nx):
        d = x0 + i - p[0]
        xx += d * d
        sx[3] += 1.0
        tx[3] += d
        for k in range(3):
            sx[k] += fx[k, i]
            tx[k] += d * fx[k, i]
    for j in range(ny):
        d = y0 + j - p[1]
        yy += d * d
        sy[3] += 1.0
        ty[3] += d
        for k in range(3):
            sy[k] += fy[k, j]
            ty[k] += d * fy[k, j]
    a = p[2]
    tilt[0, 0] = a * tx[1] * sy[0]
    tilt[1, 0] = a * tx[0] * sy[1]
    tilt[2, 0] = tx[0] * sy[0]
    tilt[3, 0] = a * (tx[2] * sy[0] + tx[0] * sy[2])
    tilt[4, 0] = tx[3] * ny
    tilt[0, 1] = a * sx[1] * ty[0]
    tilt[1, 1] = a * sx[0] * ty[1]
    tilt[2, 1] = sx[0] * ty[0]
    tilt[3, 1] = a * (sx[2] * ty[0] + sx[0] * ty[2])
    tilt[4, 1] = nx * ty[3]
    tilt[5, 0] = xx * ny
    tilt[5, 1] = tx[3] * ty[3]
    tilt[6, 0] = tilt[5, 1]
    tilt[6, 1] = nx * yy


@kernel
def step_length(step, p):
    """Return the factor 0..1 that keeps a step's width change within a factor 1.6 and its shift within a sigma."""
    s = 1.0 / sqrt(p[3])
    length = 1.0
    if abs(step[3]) > 0.6 * p[3]:
        length = 0.6 * p[3] / abs(step[3])
    shift = sqrt(step[0] * step[0] + step[1] * step[1])
    if shift * length > s:
        length = s / shift
    return length


@kernel
def fit_round(image, flip, saturation, mask, hot, n_hot, clipped, start, prior, dropped, fx, fy, out):
    """Fit one round Gaussian from start (u, v, A, q, b) into out (RESULT,); False where it does not converge.

    clipped: whether some of the window's pixels may carry no information. prior (4,): of the background's slope.
    dropped (n, 2), fx, fy (3, MOST): work.
    """
    h, w = image.shape
    p = np.empty(P)
    copy_to(start, p)
    p[3] = 1.0 / start[3]
    box = np.empty(4, np.int64)
    H = np.empty((P, P))
    G = np.zeros((P, P))
    tilt = np.zeros((P + 3, 2))
    gx = np.empty((4, 4))
    gy = np.empty((4, 4))
    d = np.empty(6)
    g = np.empty(P)
    step = np.empty(P)
    n_dropped = np.int64(0)
    width = 0.0
    for _ in range(STEPS):
        if not 0.5 < 1.0 / (p[3] * max(width, 1e-9)) < 1.25:
            width = 1.0 / p[3]
            if not set_box(p[0], p[1], width, h, w, box):
                return False
            if clipped:
                n_dropped = collect_dropped(image, flip, saturation, mask, hot, n_hot, box, dropped)
                if n_dropped < 0:
                    return False
        nx = box[1] - box[0]
        ny = box[3] - box[2]
        n = nx * ny - n_dropped
        if n < 2 * P:
            return False
        profile(p[0], 1.0 / p[3], box[0], nx, fx)
        profile(p[1], 1.0 / p[3], box[2], ny, fy)
        gram(fx, nx, 0.0, gx)
        gram(fy, ny, 0.0, gy)
        assemble(gx, gy, p[2], H)
        project(image, flip, box[0], box[2], nx, ny, fx, fy, d)
        g[0] = p[2] * d[0]
        g[1] = p[2] * d[1]
        g[2] = d[2]
        g[3] = p[2] * d[3]
        g[4] = d[4]
        rss = d[5] - 2.0 * (p[4] * d[4] + p[2] * d[2] - p[2] * p[4] * H[2, 4])
        rss += p[4] * p[4] * H[4, 4] + p[2] * p[2] * H[2, 2]
        for i in range(P):
            g[i] -= p[2] * H[i, 2] + p[4] * H[i, 4]
        if n_dropped > 0:
            rss -= take_out(image, flip, dropped, n_dropped, box[0], box[2], fx, fy, p, H, G, g, tilt)
        for i in range(P):
            g[i] = -g[i]
        if not solve_damped(H, g, 1e-9, step):
            return False
        fall = 0.0
        for i in range(P):
            fall -= g[i] * step[i]
        length = step_length(step, p)
        for i in range(P):
            p[i] += length * step[i]
        if not (p[2] > 0.0 and abs(p[0] - start[0]) + abs(p[1] - start[1]) < 4.0 + sqrt(start[3])):
            return False
        if length == 1.0 and fall < CLOSE * max(rss / n, PIXEL_VARIANCE):
            return finish(image, flip, dropped, n_dropped, box, fx, fy, p, rss - fall, prior, out)
    return False


@kernel
def finish(image, flip, dropped, n_dropped, box, fx, fy, p, rss, prior, out):
    """Write the converged fit's result into out; False where its covariance does not exist."""
    nx = box[1] - box[0]
    ny = box[3] - box[2]
    profile(p[0], 1.0 / p[3], box[0], nx, fx)
    profile(p[1], 1.0 / p[3], box[2], ny, fy)
    H = np.empty((P, P))
    G = np.empty((P, P))
    gx = np.empty((4, 4))
    gy = np.empty((4, 4))
    g = np.zeros(P)
    gram(fx, nx, 0.0, gx)
    gram(fy, ny, 0.0, gy)
    assemble(gx, gy, p[2], H)
    gram(fx, nx, 1.0, gx)
    gram(fy, ny, 1.0, gy)
    assemble(gx, gy, p[2], G)
    for i in range(P):
        for j in range(P):
            G[i, j] *= p[2]
    tilt = np.zeros((P + 3, 2))
    tilt_sums(fx, fy, nx, ny, box[0], box[2], p, tilt)
    if n_dropped > 0:
        take_out(image, flip, dropped, n_dropped, box[0], box[2], fx, fy, p, H, G, g, tilt)
    residual_sums(image, flip, dropped, n_dropped, box, fx, fy, p, out)
    tilt[P + 2, 0] = out[TILT_X]
    tilt[P + 2, 1] = out[TILT_Y]
    out[A] = p[2]
    out[Q] = 1.0 / p[3]
    out[B] = p[4]
    out[DOF] = nx * ny - n_dropped - P
    out[RSS] = max(rss, 0.0)
    work = np.empty(8)
    noise = max(out[RSS] / max(out[DOF], 1.0), PIXEL_VARIANCE)
    out[SIGNAL] = uncertainty(H, G, tilt, prior, noise, out[SIGNAL], work)
    for k in range(6):
        out[COV + k] = work[k]
    out[U] = p[0] + work[6]
    out[V] = p[1] + work[7]
    return out[SIGNAL] == out[SIGNAL]
