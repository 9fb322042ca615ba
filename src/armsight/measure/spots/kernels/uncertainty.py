"""What the centre's covariance is made of: the noise's constant and shot parts, and the background's slope."""

from __future__ import annotations

from math import sqrt

import numpy as np

from armsight._numba import inner_kernel
from armsight.fitting.kernels import invert_spd
from armsight.measure.spots.kernels.scan import GRID


@inner_kernel
def slope_prior(levels, y, x, w, h, noise, prior):
    """Fill prior (4,): slope of the background per px along x and y at pixel (x, y), and how well it is known.

    The middle one of three rows' (columns') central differences; its standard deviation is their spread plus the step's
    unevenness plus the sample's own noise.
    """
    i = y * GRID // h
    j = x * GRID // w
    three = np.empty(3)
    for axis in range(2):
        size = (w if axis == 0 else h) / GRID
        c = j if axis == 0 else i
        o = i if axis == 0 else j
        lo = max(c - 1, 0)
        hi = min(c + 1, GRID - 1)
        known = 0
        bend = 0.0
        for k in range(max(o - 1, 0), min(o + 2, GRID)):
            a = levels[k, lo] if axis == 0 else levels[lo, k]
            b = levels[k, c] if axis == 0 else levels[c, k]
            d = levels[k, hi] if axis == 0 else levels[hi, k]
            if a < 0.0 or b < 0.0 or d < 0.0:
                continue
            three[known] = (d - a) / ((hi - lo) * size)
            # the second difference: how far the slope changes from tile to tile
            if k == o and hi - lo == 2:
                bend = abs(d - 2.0 * b + a) / size
            known += 1
        prior[axis] = 0.0
        prior[2 + axis] = 1.0
        if known > 1:
            low = min(three[0], three[1]) if known == 2 else min(three[0], three[1], three[2])
            high = max(three[0], three[1]) if known == 2 else max(three[0], three[1], three[2])
            middle = 0.5 * (low + high)
            if known == 3:
                middle = three[0] + three[1] + three[2] - low - high
            prior[axis] = middle
            prior[2 + axis] = high - low + bend + 0.25 * sqrt(noise) / size + 1e-4


LEAST_SLOPE = 0.05
"""Slope (grey levels per px) that a background before which nothing is seen to change may still have."""


@inner_kernel
def ring_prior(slope, prior):
    """Fill prior (4,) as slope_prior does where a ring about the light tells how much the background changes."""
    prior[0] = 0.0
    prior[1] = 0.0
    prior[2] = slope + LEAST_SLOPE
    prior[3] = slope + LEAST_SLOPE


MISFIT = 4.0
"""Neighbouring residuals correlated by more than this many standard deviations say that the model is wrong."""
MOST_CORRELATED = 0.9
LEVERAGE = 1.3
"""What a round fit takes of the sum of m^2, over what it takes of the sum of m; 1.295-1.30 for sigma 1.5-4 px."""


@inner_kernel
def variance_inflation(run, products, squares):
    """Return the factor of the covariance for residuals that hang together: wrong model, or noise that is not white.

    For residuals whose neighbours correlate by rho along both axes, as of first order, the information of a smooth
    light falls by (1 - rho) / (1 + rho) along each. products: sum of r times its left and upper neighbour.
    """
    if run < MISFIT or squares <= 0.0:
        return 1.0
    rho = min(0.5 * products / squares, MOST_CORRELATED)
    return ((1.0 + rho) / (1.0 - rho)) ** 2


@inner_kernel
def remaining_square(square, signal, left):
    """Return the sum of m^2 less the fit's take, from that of the sum of m (signal, of which `left` is left)."""
    return square * max(1.0 - LEVERAGE * (1.0 - left / signal), 0.1) if signal > 0.0 else 0.0


@inner_kernel
def uncertainty(H, G, tilt, prior, noise, signal, out):
    """Write C_H, C_G into out (6,), correct the centre for the background's slope; return signal less the fit's take.

    With noise variance a + g m at a pixel of model height m, the covariance of the centre is a C_H + g C_G (C_G =
    H^-1 G H^-1), and the residuals' expectation is (1 - leverage) (a + g m). The background's slope (per px along x
    and y) is one linear step of a fit with prior (4,): mean x, y, standard deviation x, y. tilt (n + 3, 2): the sums of
    J dx, J dy (n rows), of (dx, dy)'(dx, dy) (2 rows) and of r dx, r dy. The centre's shift goes to out[6:8].
    NaN where H cannot be inverted.
    """
    n = H.shape[0]
    C = np.empty((n, n))
    if not invert_spd(H, C):
        return np.nan
    # trace of H^-1 G, the light of each pixel times its leverage: what the fit takes of the signal
    trace = 0.0
    for i in range(n):
        for j in range(n):
            trace += C[i, j] * G[i, j]
    CG = np.zeros((2, n))
    CB = np.zeros((n, 2))
    for j in range(n):
        for i in range(n):
            CG[0, j] += C[0, i] * G[i, j]
            CG[1, j] += C[1, i] * G[i, j]
            CB[j, 0] += C[j, i] * tilt[i, 0]
            CB[j, 1] += C[j, i] * tilt[i, 1]
    # the slope's two parameters beside the others: the Schur complement of H in the larger matrix, and their prior
    kx = noise / (prior[2] * prior[2])
    ky = noise / (prior[3] * prior[3])
    xx = tilt[n, 0] + kx
    xy = tilt[n, 1]
    yy = tilt[n + 1, 1] + ky
    for i in range(n):
        xx -= tilt[i, 0] * CB[i, 0]
        xy -= tilt[i, 0] * CB[i, 1]
        yy -= tilt[i, 1] * CB[i, 1]
    det = xx * yy - xy * xy
    if not det > 0.0:
        return np.nan
    hx = tilt[n + 2, 0] + kx * prior[0]
    hy = tilt[n + 2, 1] + ky * prior[1]
    slope_x = (yy * hx - xy * hy) / det
    slope_y = (xx * hy - xy * hx) / det
    k = 0
    for a in range(2):
        out[6 + a] = -(CB[a, 0] * slope_x + CB[a, 1] * slope_y)
        for b in range(a, 2):
            # the centre with the slope unknown: C + CB S^-1 CB', S the complement (xx, xy, yy)
            out[k] = C[a, b]
            out[k] += (CB[a, 0] * CB[b, 0] * yy - (CB[a, 0] * CB[b, 1] + CB[a, 1] * CB[b, 0]) * xy) / det
            out[k] += CB[a, 1] * CB[b, 1] * xx / det
            t = 0.0
            for j in range(n):
                t += CG[a, j] * C[j, b]
            out[k + 3] = t
            k += 1
    return signal - trace
