"""The separable round Gaussian: its profile along an axis, and the sums over a window that need only the two axes.

And the normal distribution at many places at once, from a table: as exact as math.erf and ten times as fast.
"""

from __future__ import annotations

from math import erf, exp, pi, sqrt

import numpy as np

from armsight._numba import inner_kernel, lean_kernel, lean_sum_kernel

PIXEL_VARIANCE = 1.0 / 12.0
NARROW = 0.9
"""Variance (px^2) below which a pixel's integral replaces its sample."""
P = 5
"""Parameters of a round light: u, v, A, 1/q, b."""


@lean_kernel
def profile(centre, q, start, n, f):
    """Fill f (3, n): profile, its derivative by the centre and by 1/q, at pixels start..start+n-1."""
    if q < NARROW:
        # q holds the pixel's own variance, which integrating over it brings anew
        s2 = max(q - PIXEL_VARIANCE, 0.01)
        s = sqrt(s2)
        # as much light as the sampled profile of the same height: both sum up to sqrt(2 pi q)
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
        # exp(-(d + 1)^2 w / 2) from the one before, by two products in place of an exponential
        e *= ratio
        ratio *= shrink


@lean_kernel
def gaussian_line(first, n, centre, w, e):
    """Fill e (n,) with exp(-w (x - centre)^2 / 2) at x = first, first + 1, ...

    From the pixel nearest to the centre outwards, each from the one before by two products: four exponentials for n.
    """
    near = min(max(int(min(max(centre - first + 0.5, 0.0), n - 1.0)), 0), n - 1)
    d = first + near - centre
    e[near] = exp(-0.5 * w * d * d)
    shrink = exp(-w)
    here = e[near]
    ratio = exp(-w * (d + 0.5))
    for i in range(near + 1, n):
        here *= ratio
        ratio *= shrink
        e[i] = here
    here = e[near]
    ratio = exp(w * (d - 0.5))
    for i in range(near - 1, -1, -1):
        here *= ratio
        ratio *= shrink
        e[i] = here


@lean_kernel
def gram(f, n, power, g):
    """Fill g (4, 4) with the sums of products of 1, f0, f1, f2 over n pixels, each times f0**power.

    power is 0.0 or 1.0.
    """
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


@lean_kernel
def assemble(gx, gy, a, H):
    """Fill H (5, 5) = sum of J'J from the axes' sums gx, gy (4, 4) and the height a."""
    # the model is a product along the axes: sums over the window are products of sums along them
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


@inner_kernel
def tilt_sums(fx, fy, nx, ny, x0, y0, p, sums, tilt):
    """Fill rows 0..6 of tilt (8, 2) for a window (see leastsquares.uncertainty). sums (4, 4): work.

    Rows of sums: X, X', X" and 1 summed over columns; the same times dx; the same along y.
    """
    for k in range(4):
        sums[0, k] = 0.0
        sums[1, k] = 0.0
        sums[2, k] = 0.0
        sums[3, k] = 0.0
    xx = 0.0
    yy = 0.0
    for i in range(nx):
        d = x0 + i - p[0]
        xx += d * d
        sums[0, 3] += 1.0
        sums[1, 3] += d
        for k in range(3):
            sums[0, k] += fx[k, i]
            sums[1, k] += d * fx[k, i]
    for j in range(ny):
        d = y0 + j - p[1]
        yy += d * d
        sums[2, 3] += 1.0
        sums[3, 3] += d
        for k in range(3):
            sums[2, k] += fy[k, j]
            sums[3, k] += d * fy[k, j]
    a = p[2]
    tilt[0, 0] = a * sums[1, 1] * sums[2, 0]
    tilt[1, 0] = a * sums[1, 0] * sums[2, 1]
    tilt[2, 0] = sums[1, 0] * sums[2, 0]
    tilt[3, 0] = a * (sums[1, 2] * sums[2, 0] + sums[1, 0] * sums[2, 2])
    tilt[4, 0] = sums[1, 3] * ny
    tilt[0, 1] = a * sums[0, 1] * sums[3, 0]
    tilt[1, 1] = a * sums[0, 0] * sums[3, 1]
    tilt[2, 1] = sums[0, 0] * sums[3, 0]
    tilt[3, 1] = a * (sums[0, 2] * sums[3, 0] + sums[0, 0] * sums[3, 2])
    tilt[4, 1] = nx * sums[3, 3]
    tilt[5, 0] = xx * ny
    tilt[5, 1] = sums[1, 3] * sums[3, 3]
    tilt[6, 0] = tilt[5, 1]
    tilt[6, 1] = nx * yy


NODES = 64
"""Nodes of the normal distribution's table per standard deviation: its series from the nearest one is exact to
1e-16."""
LAST_Z = 8.9
LAST_NODE = 9 * NODES
DENSITY = np.array([exp(-0.5 * (i / NODES) ** 2) / sqrt(2.0 * pi) for i in range(-LAST_NODE, LAST_NODE + 1)])
PROBABILITY = np.array([0.5 * (1.0 + erf(i / NODES / sqrt(2.0))) for i in range(-LAST_NODE, LAST_NODE + 1)])


@lean_sum_kernel
def normal(z, density, probability):
    """Fill density and probability of the standard normal distribution at z; NaN gives any number."""
    for i in range(z.shape[0]):
        x = min(max(z[i], -LAST_Z), LAST_Z)
        near = np.floor(x * NODES + 0.5)
        k = np.uint64(np.int64(near) + LAST_NODE)  # unsigned: without the test for negative indices it is vector code
        a = near * (1.0 / NODES)
        d = x - a
        t = -d * (a + 0.5 * d)
        here = 1.0 + t * (
            1.0 + t * (1.0 / 2.0 + t * (1.0 / 6.0 + t * (1.0 / 24.0 + t * (1.0 / 120.0 + t * (1.0 / 720.0)))))
        )
        b = a * a
        c2 = (b - 1.0) * (1.0 / 6.0)
        c3 = -a * (b - 3.0) * (1.0 / 24.0)
        c4 = (b * (b - 6.0) + 3.0) * (1.0 / 120.0)
        c5 = -a * (b * (b - 10.0) + 15.0) * (1.0 / 720.0)
        step = d * (1.0 + d * (-0.5 * a + d * (c2 + d * (c3 + d * (c4 + d * c5)))))
        density[i] = DENSITY[k] * here
        probability[i] = PROBABILITY[k] + DENSITY[k] * step
