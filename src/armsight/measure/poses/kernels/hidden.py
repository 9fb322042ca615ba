"""Is a light of the target covered in part? Its outline beside those of the target's other lights in the same view.

Lights of one target look alike in one view: tilt, blur, motion and bloom shape them alike. What an edge cuts off makes
a light narrower in one direction and hardly in the other; its centre moves by less than its width falls short in radii.
"""

from __future__ import annotations

from math import atan2, cos, log, pi, sin, sqrt

import numpy as np

from armsight._numba import inner_kernel, kernel
from armsight.measure.spots.kernels.outline import AREA, OUTLINE, RING, XX, XY, YY, outline

GATE_PX = 0.27
GATE_SIGMAS = 2.0
"""How far (px, and standard deviations of its centre on top) a light's radius along one direction may be off those of
the others: of 1,590 lights of 265 composites nobody covers, 99 % are within."""
ODD_PX = 0.6
ODD_SIGMAS = 3.0
"""The same, against each other light, from which it is no light like the others: one composite in 265."""
UNEVEN = 0.5
"""Logarithm of the ratio of radii from which a light is of another size, whatever its form; lights of twice the
brightness that are clipped differ by 0.3."""
FALSE_TWIN = 1e9
BLUR_PX2 = 1.0
"""Square of the part of a radius that does not shrink with distance: the lens's blur and the pixel."""

NO_DOUBT, DOUBT, ODD = range(3)


@inner_kernel
def radii(mine, other, out):
    """Fill out (3,), logarithms: how much narrower and how much wider a light is than the other, each in the direction in
    which it is so most, and how much larger."""
    det = other[XX] * other[YY] - other[XY] ** 2
    half = 0.5 * (other[YY] * mine[XX] - 2.0 * other[XY] * mine[XY] + other[XX] * mine[YY]) / det
    ratio = (mine[XX] * mine[YY] - mine[XY] ** 2) / det
    root = sqrt(max(half * half - ratio, 0.0))
    out[0] = -0.5 * log(max(half - root, 1e-4))
    out[1] = 0.5 * log(max(half + root, 1e-4))
    out[2] = 0.5 * (out[1] - out[0])


@inner_kernel
def differences(mine, other, out):
    """Fill out (3,): px by which a light is narrower, and wider, in one direction than the other; log of their ratio.

    What it is in both directions does not count for the first two: a fainter light is smaller all round.
    """
    radii(mine, other, out)
    radius = sqrt(other[AREA] / pi)
    both = out[0] + out[1]
    out[0] = min(out[0], both) * radius
    out[1] = min(out[1], both) * radius


@inner_kernel
def add_along(angle, length, variance):
    """Add length^2 along a direction to variance (2, 2)."""
    c = length * cos(angle)
    s = length * sin(angle)
    variance[0, 0] += c * c
    variance[0, 1] += c * s
    variance[1, 0] += c * s
    variance[1, 1] += s * s


@inner_kernel
def compare_view(outlines, sigma, variance, odd):
    """Compare the lights (n, OUTLINE) of one view; return NO_DOUBT, DOUBT or ODD.

    sigma (n,): largest standard deviation of each centre. Adds to variance (n, 2, 2) what may be hidden of each, and sets
    odd (n,) to 1 where one is unlike every other.
    """
    n = outlines.shape[0]
    mean = np.empty(OUTLINE)
    d = np.empty(3)
    verdict = NO_DOUBT
    for i in range(n):
        if not outlines[i, AREA] > 0.0:
            continue
        mean[:] = 0.0
        others = 0
        narrower = FALSE_TWIN
        wider = FALSE_TWIN
        for k in range(n):
            if k == i or not outlines[k, AREA] > 0.0:
                continue
            others += 1
            for m in range(OUTLINE):
                mean[m] += outlines[k, m]
            differences(outlines[i], outlines[k], d)
            narrower = min(narrower, d[0])
            wider = min(wider, d[1])
        if others == 0:
            continue
        for m in range(OUTLINE):
            mean[m] /= others
        if max(narrower, wider) > ODD_PX + ODD_SIGMAS * sigma[i] and not (others == 1 and wider > narrower):
            odd[i] = 1
            verdict = ODD
        differences(outlines[i], mean, d)
        gate = GATE_PX + GATE_SIGMAS * sigma[i]
        # direction in which it falls short most of the others' moments
        angle = 0.5 * atan2(
            2.0 * (mean[XY] - outlines[i, XY]), mean[XX] - outlines[i, XX] - (mean[YY] - outlines[i, YY])
        )
        if d[0] > gate:
            add_along(angle, d[0], variance[i])
        if d[1] > gate:
            add_along(angle + 0.5 * pi, d[1], variance[i])
        uneven = abs(d[2]) * sqrt(mean[AREA] / pi)
        if abs(d[2]) > UNEVEN and uneven > gate:
            add_along(0.0, uneven, variance[i])
            add_along(0.5 * pi, uneven, variance[i])
        if verdict == NO_DOUBT and variance[i, 0, 0] + variance[i, 1, 1] > 0.0:
            verdict = DOUBT
    return verdict


@kernel
def compare_lights(left, right, flip, R, t, P, uv, cov, size, usable, variance, odd):
    """Compare a target's lights in both images (h, w, c); return NO_DOUBT, DOUBT or ODD.

    R (2, 3, 3), t (2, 3): of the cameras; P (n, 3): the lights in rig axes. uv (n, 2, 2), cov (n, 2, 2, 2), size, usable
    (n, 2): [light, side]. Fills variance (n, 2, 2, 2) with what may be hidden, and odd (n, 2).
    """
    n = uv.shape[0]
    outlines = np.zeros((n, OUTLINE))
    sigma = np.empty(n)
    depth = np.empty(n)
    ring = np.empty(RING)
    sums = np.empty(6)
    worst = NO_DOUBT
    for side in range(2):
        image = left if side == 0 else right
        for i in range(n):
            outlines[i, AREA] = 0.0
            c = cov[i, side]
            root = sqrt(0.25 * (c[0, 0] - c[1, 1]) ** 2 + c[0, 1] ** 2)
            sigma[i] = sqrt(0.5 * (c[0, 0] + c[1, 1]) + root)
            depth[i] = t[side, 2]
            for m in range(3):
                depth[i] += R[side, 2, m] * P[i, m]
            if usable[i, side] == 0 or not depth[i] > 0.0:
                continue
            outline(image, flip, uv[i, side, 0], uv[i, side, 1], size[i, side], ring, sums, outlines[i])
            area = outlines[i, AREA]
            if area > 0.0:  # as at the first light's distance
                share = max(1.0 - BLUR_PX2 * pi / area, 0.0)
                nearer = (depth[i] / depth[0]) ** (2.0 * share)
                for m in range(OUTLINE):
                    outlines[i, m] *= nearer
        worst = max(worst, compare_view(outlines, sigma, variance[:, side], odd[:, side]))
    return worst
