"""The usual case, fast: one round Gaussian light, fitted by Gauss-Newton to the pixels of its window.

Model: m(x, y) = b + A X(x) Y(y). X is a Gaussian of unit height and variance q, sampled at the pixel's centre; a
pixel's integration adds 1/12 px^2 to the variance, and the rest of its effect is below 1e-4 of A for a spot's sigma
from 1 px. For narrower spots X is the integral over the pixel (error function). Because the model separates, the
normal matrix needs only sums along the two axes; pixels that carry no information (clipped, hot, masked out) are
taken out of the sums one by one.

Parameters: u, v, A, 1/q, b.
"""

from __future__ import annotations

from math import sqrt
from typing import Any, NamedTuple

import numpy as np

from armsight._numba import inner_kernel, lean_kernel, lean_sum_kernel
from armsight.fitting.kernels import solve_damped
from armsight.measure.spots.kernels.columns import copy_to
from armsight.measure.spots.kernels.gaussian_axes import PIXEL_VARIANCE, P, assemble, gram, profile, tilt_sums
from armsight.measure.spots.kernels.leastsquares import remaining_square, uncertainty, variance_inflation

MOST = 129
"""Largest side of a window in px."""
MOST_DROPPED = 2048
"""Most pixels of a window that may carry no information."""
REACH = 3.2
"""Half side of the window in standard deviations: what lies beyond holds less than 0.1 % of the information."""
STEPS = 12
CLOSE = 0.25
"""Stop after a step that lowered chi-square by less than this (half a standard deviation); the next would be a
thousandth."""

# columns of the fit's result
U, V, A, Q, B, DOF, RSS, SIGNAL, FOURTH, SQUARE, RUN, TILT_X, TILT_Y, PRODUCTS = range(14)
COV = 14  # 14..16: C_H (uu, uv, vv); 17..19: C_G
RESULT = 20


class Workspace(NamedTuple):
    """Arrays that the fit of one light after the other writes into; making them for each would take as long as it."""

    fx: Any  # (3, MOST) profile and derivatives along x
    fy: Any
    gx: Any  # (4, 4) their sums of products
    gy: Any
    H: Any  # (5, 5) normal matrix, and the same weighted with the model
    G: Any
    tilt: Any  # (8, 2) see uncertainty
    sums: Any  # (4, 4)
    data: Any  # (6,) sums of the data times the profiles
    g: Any  # (5,) gradient, step, parameters, a pixel's derivatives
    step: Any
    p: Any
    J: Any
    light: Any  # (2,) sums over dropped pixels
    answer: Any  # (8,) of uncertainty
    box: Any  # (4,) window: x0, x1, y0, y1
    dropped: Any  # (MOST_DROPPED, 2) pixels that carry no information
    residuals: Any  # (MOST + 1, MOST + 1), zero beside the window's first row and column


@inner_kernel
def new_work():
    """Return fresh work arrays."""
    return Workspace(
        np.empty((3, MOST)),
        np.empty((3, MOST)),
        np.empty((4, 4)),
        np.empty((4, 4)),
        np.empty((P, P)),
        np.empty((P, P)),
        np.empty((P + 3, 2)),
        np.empty((4, 4)),
        np.empty(6),
        np.empty(P),
        np.empty(P),
        np.empty(P),
        np.empty(P),
        np.empty(2),
        np.empty(8),
        np.empty(4, np.int64),
        np.empty((MOST_DROPPED, 2), np.int64),
        np.empty((MOST + 1, MOST + 1)),
    )


@lean_sum_kernel
def project(image, flip, x0, y0, nx, ny, fx, fy, d):
    """Fill d (6,) with the sums over the window of v X'Y, v X Y', v X Y, v (X" Y + X Y"), v and v^2."""
    d0 = 0.0
    d1 = 0.0
    d2 = 0.0
    d3 = 0.0
    total = 0.0
    square = 0.0
    first = np.uint64(x0)  # unsigned: without the test for negative indices the loop becomes vector code
    for j in range(ny):
        y = np.uint64(y0 + j)
        tx = 0.0
        tc = 0.0
        ts = 0.0
        for i in range(nx):
            v = float(np.uint8(image[y, first + np.uint64(i)] ^ flip))
            tx += v * fx[0, i]
            tc += v * fx[1, i]
            ts += v * fx[2, i]
            total += v
            square += v * v
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


@lean_kernel
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


@lean_kernel
def exclude_pixels(image, flip, n, full, w):
    """Subtract the n dropped pixels from H and g; with full also from G and tilt, with their light into w.light.

    Returns their sum of squared residuals.
    """
    squares = 0.0
    w.light[0] = 0.0
    w.light[1] = 0.0
    J = w.J
    for k in range(n):
        x = w.dropped[k, 0]
        y = w.dropped[k, 1]
        m = pixel_jacobian(w.fx, w.fy, x - w.box[0], y - w.box[2], w.p[2], J)
        r = np.int64(np.uint8(image[y, x] ^ flip)) - w.p[4] - m
        squares += r * r
        if full == 0:
            for i in range(P):
                w.g[i] += r * J[i]
                for j in range(P):
                    w.H[i, j] -= J[i] * J[j]
            continue
        w.light[0] += m
        w.light[1] += m * m
        dx = x - w.p[0]
        dy = y - w.p[1]
        for i in range(P):
            w.tilt[i, 0] -= J[i] * dx
            w.tilt[i, 1] -= J[i] * dy
            for j in range(P):
                w.G[i, j] -= m * J[i] * J[j]
        w.tilt[P, 0] -= dx * dx
        w.tilt[P, 1] -= dx * dy
        w.tilt[P + 1, 0] -= dx * dy
        w.tilt[P + 1, 1] -= dy * dy
    return squares


@lean_kernel
def collect_dropped(picture, hot, box, dropped):
    """Fill dropped with the pixels of box (x0, x1, y0, y1) that are clipped, masked out or hot; return how many."""
    image, flip, saturation, mask = picture
    n = 0
    for y in range(box[2], box[3]):
        for x in range(box[0], box[1]):
            if np.uint8(image[y, x] ^ flip) >= saturation or (mask.size > 0 and mask[y, x] == 0):
                if n >= dropped.shape[0]:
                    return -1
                dropped[n, 0] = x
                dropped[n, 1] = y
                n += 1
    for k in range(hot.shape[0]):
        x = hot[k, 0]
        y = hot[k, 1]
        if box[0] <= x < box[1] and box[2] <= y < box[3] and np.uint8(image[y, x] ^ flip) < saturation:
            if n >= dropped.shape[0]:
                return -1
            dropped[n, 0] = x
            dropped[n, 1] = y
            n += 1
    return n


@lean_kernel
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


@lean_sum_kernel
def residual_sums(image, flip, n_dropped, w, out):
    """Write into out what the residuals r say: FOURTH (sum of r^2 m), RUN, and TILT (of r dx, r dy).

    RUN: sum of products of neighbouring residuals over its own standard deviation; a fitting model leaves |RUN| of
    order 1, whatever the noise level and however it varies.
    """
    p = w.p
    fx = w.fx
    fy = w.fy
    residuals = w.residuals
    dropped = w.dropped
    x0 = w.box[0]
    y0 = w.box[2]
    nx = w.box[1] - x0
    ny = w.box[3] - y0
    first = np.uint64(x0)
    for i in range(nx + 1):
        residuals[0, i] = 0.0
    for j in range(ny):
        residuals[j + 1, 0] = 0.0
        height = p[2] * fy[0, j]
        y = np.uint64(y0 + j)
        for i in range(nx):
            grey = float(np.uint8(image[y, first + np.uint64(i)] ^ flip))
            residuals[j + 1, i + 1] = grey - p[4] - height * fx[0, i]
    for k in range(n_dropped):
        residuals[dropped[k, 1] - y0 + 1, dropped[k, 0] - x0 + 1] = 0.0
    fourth = 0.0
    products = 0.0
    spread = 0.0
    tilt_x = 0.0
    tilt_y = 0.0
    for j in range(1, ny + 1):
        row_fourth = 0.0
        total = 0.0
        for i in range(1, nx + 1):
            r = residuals[j, i]
            left = residuals[j, i - 1]
            up = residuals[j - 1, i]
            rr = r * r
            row_fourth += rr * fx[0, i - 1]
            products += r * (left + up)
            spread += rr * (left * left + up * up)
            total += r
            tilt_x += r * float(i)
        fourth += p[2] * fy[0, j - 1] * row_fourth
        tilt_x += total * (x0 - 1 - p[0])
        tilt_y += total * (y0 + j - 1 - p[1])
    out[FOURTH] = fourth
    out[RUN] = products / sqrt(spread) if spread > 0.0 else 0.0
    out[PRODUCTS] = products
    out[TILT_X] = tilt_x
    out[TILT_Y] = tilt_y


@lean_kernel
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


@lean_kernel
def normal_equations(image, flip, n_dropped, w):
    """Fill w.H and the gradient w.g at w.p over the window w.box; return the sum of squared residuals."""
    p = w.p
    x0 = w.box[0]
    y0 = w.box[2]
    nx = w.box[1] - x0
    ny = w.box[3] - y0
    profile(p[0], 1.0 / p[3], x0, nx, w.fx)
    profile(p[1], 1.0 / p[3], y0, ny, w.fy)
    gram(w.fx, nx, 0.0, w.gx)
    gram(w.fy, ny, 0.0, w.gy)
    assemble(w.gx, w.gy, p[2], w.H)
    project(image, flip, x0, y0, nx, ny, w.fx, w.fy, w.data)
    d = w.data
    H = w.H
    w.g[0] = -p[2] * d[0]
    w.g[1] = -p[2] * d[1]
    w.g[2] = -d[2]
    w.g[3] = -p[2] * d[3]
    w.g[4] = -d[4]
    for i in range(P):
        w.g[i] += p[2] * H[i, 2] + p[4] * H[i, 4]
    rss = d[5] - 2.0 * (p[4] * d[4] + p[2] * d[2] - p[2] * p[4] * H[2, 4])
    rss += p[4] * p[4] * H[4, 4] + p[2] * p[2] * H[2, 2]
    if n_dropped > 0:
        rss -= exclude_pixels(image, flip, n_dropped, np.int64(0), w)
    return rss


@lean_kernel
def fit_round(picture, hot, clipped, start, prior, w, out):
    """Fit one round Gaussian from start (u, v, A, q, b) into out (RESULT,); False where it does not converge.

    clipped: whether some of the window's pixels may carry no information. prior (4,): of the background's slope.
    """
    image, flip = picture.grey, picture.flip
    p = w.p
    copy_to(start, p)
    p[3] = 1.0 / start[3]
    n_dropped = np.int64(0)
    width = 0.0
    for _ in range(STEPS):
        if not 0.5 < 1.0 / (p[3] * max(width, 1e-9)) < 1.25:
            width = 1.0 / p[3]
            if not set_box(p[0], p[1], width, image.shape[0], image.shape[1], w.box):
                return False
            if clipped:
                n_dropped = collect_dropped(picture, hot, w.box, w.dropped)
                if n_dropped < 0:
                    return False
        n = (w.box[1] - w.box[0]) * (w.box[3] - w.box[2]) - n_dropped
        if n < 2 * P:
            return False
        rss = normal_equations(image, flip, n_dropped, w)
        if not solve_damped(w.H, w.g, 1e-9, w.step):
            return False
        fall = 0.0
        for i in range(P):
            fall -= w.g[i] * w.step[i]
        length = step_length(w.step, p)
        if length == 1.0 and fall < CLOSE * max(rss / n, PIXEL_VARIANCE):
            return finish(image, flip, n_dropped, n - P, rss - fall, prior, w, out)
        for i in range(P):
            p[i] += length * w.step[i]
        if not (p[2] > 0.0 and abs(p[0] - start[0]) + abs(p[1] - start[1]) < 4.0 + sqrt(start[3])):
            return False
    return False


@lean_kernel
def finish(image, flip, n_dropped, dof, rss, prior, w, out):
    """Write the result into out: w.p plus the last, small w.step, the sums being those at w.p.

    Returns False where the covariance does not exist.
    """
    p = w.p
    nx = w.box[1] - w.box[0]
    ny = w.box[3] - w.box[2]
    signal = p[2] * w.gx[0, 1] * w.gy[0, 1]
    square = p[2] * p[2] * w.gx[1, 1] * w.gy[1, 1]
    gram(w.fx, nx, 1.0, w.gx)
    gram(w.fy, ny, 1.0, w.gy)
    assemble(w.gx, w.gy, p[2], w.G)
    for i in range(P):
        for j in range(P):
            w.G[i, j] *= p[2]
    tilt_sums(w.fx, w.fy, nx, ny, w.box[0], w.box[2], p, w.sums, w.tilt)
    w.light[0] = 0.0
    w.light[1] = 0.0
    if n_dropped > 0:
        exclude_pixels(image, flip, n_dropped, np.int64(1), w)
    residual_sums(image, flip, n_dropped, w, out)
    w.tilt[P + 2, 0] = out[TILT_X]
    w.tilt[P + 2, 1] = out[TILT_Y]
    for i in range(P):
        w.tilt[P + 2, 0] -= w.tilt[i, 0] * w.step[i]
        w.tilt[P + 2, 1] -= w.tilt[i, 1] * w.step[i]
    out[A] = p[2] + w.step[2]
    out[Q] = 1.0 / (p[3] + w.step[3])
    out[B] = p[4] + w.step[4]
    out[DOF] = dof
    out[RSS] = max(rss, 0.0)
    noise = max(out[RSS] / max(dof, 1.0), PIXEL_VARIANCE)
    out[SIGNAL] = uncertainty(w.H, w.G, w.tilt, prior, noise, signal - w.light[0], w.answer)
    out[SQUARE] = remaining_square(square - w.light[1], signal - w.light[0], out[SIGNAL])
    wider = variance_inflation(out[RUN], out[PRODUCTS], out[RSS])
    for k in range(6):
        out[COV + k] = wider * w.answer[k]
    out[U] = p[0] + w.step[0] + w.answer[6]
    out[V] = p[1] + w.step[1] + w.answer[7]
    return out[SIGNAL] == out[SIGNAL]
