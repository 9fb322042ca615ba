"""Is a light of the target covered in part? Its outline beside those of the target's other lights in the same view.

Lights of one target look alike in one view: tilt, blur, motion and bloom shape them alike. What an edge cuts off makes
a light narrower in one direction and hardly in the other; its centre moves by less than its width falls short in radii.
"""

from __future__ import annotations

from math import atan2, cos, exp, log, pi, sin, sqrt

import numpy as np

from armsight._numba import inner_kernel, kernel
from armsight.measure.spots.kernels.detection.area import O_FLIP
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
BLUR_PX2 = 1.0
"""Square of the part of a radius that does not shrink with distance: the lens's blur and the pixel."""

NO_DOUBT, DOUBT, ODD_ONE = range(3)
UU, UV, VV, ODD = range(4)
FINDING = 4
"""Of a light in one view: variance to be added to its centre's, and 1 where it is unlike every other one."""


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
def add_along(angle, length, row):
    """Add length^2 along a direction to the variance in row (.., uu, uv, vv)."""
    c = length * cos(angle)
    s = length * sin(angle)
    row[UU] += c * c
    row[UV] += c * s
    row[VV] += s * s


@inner_kernel
def shortest(mine, mean):
    """Return the direction in which a light falls short most of the mean's second moments."""
    return 0.5 * atan2(2.0 * (mean[XY] - mine[XY]), mean[XX] - mine[XX] - (mean[YY] - mine[YY]))


@inner_kernel
def doubt_light(mine, mean, gate, d, row):
    """Add to row what may be hidden of a light, or lie beside it, where it is further off the others' mean than the gate."""
    differences(mine, mean, d)
    if d[0] > gate:
        add_along(shortest(mine, mean), d[0], row)
    if d[1] > gate:
        add_along(shortest(mine, mean) + 0.5 * pi, d[1], row)
    uneven = abs(d[2]) * sqrt(mean[AREA] / pi)
    if abs(d[2]) > UNEVEN and uneven > gate:
        row[UU] += uneven * uneven
        row[VV] += uneven * uneven


@inner_kernel
def compare_view(outlines, sigma, work, out):
    """Compare the lights (n, OUTLINE) of one view; return NO_DOUBT, DOUBT or ODD_ONE.

    sigma (n,): largest standard deviation of each centre. Fills out (n, FINDING).
    """
    n = outlines.shape[0]
    mean = work[0]
    d = work[1]
    verdict = NO_DOUBT
    for i in range(n):
        if not outlines[i, AREA] > 0.0:
            continue
        mean[:] = 0.0
        others = 0
        narrower = 1e9
        wider = 1e9
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
        if others == 1:  # of two lights the smaller one
            wider = 0.0
        doubt_light(outlines[i], mean, GATE_PX + GATE_SIGMAS * sigma[i], d, out[i])
        if max(narrower, wider) > ODD_PX + ODD_SIGMAS * sigma[i]:
            out[i, ODD] = 1.0
            verdict = ODD_ONE
        elif verdict == NO_DOUBT and out[i, UU] + out[i, VV] > 0.0:
            verdict = DOUBT
    return verdict


@inner_kernel
def outlines_of(image, flip, R, t, P, uv, cov, size, outlines, sigma, work):
    """Fill outlines (n, OUTLINE), as at the first light's distance, and sigma (n,) of the lights in one image."""
    first = 0.0
    for i in range(P.shape[0]):
        c = cov[i]
        sigma[i] = sqrt(0.5 * (c[0, 0] + c[1, 1]) + sqrt(0.25 * (c[0, 0] - c[1, 1]) ** 2 + c[0, 1] ** 2))
        depth = R[2, 0] * P[i, 0] + R[2, 1] * P[i, 1] + R[2, 2] * P[i, 2] + t[2]
        if i == 0:
            first = depth
        outlines[i, AREA] = 0.0
        if not (size[i] > 0.0 and depth > 0.0 and first > 0.0):
            continue
        outline(image, flip, uv[i, 0], uv[i, 1], size[i], work, outlines[i])
        if outlines[i, AREA] > 0.0:
            share = max(1.0 - BLUR_PX2 * pi / outlines[i, AREA], 0.0)
            nearer = exp(2.0 * share * log(depth / first))
            for m in range(OUTLINE):
                outlines[i, m] *= nearer


@kernel
def compare_lights(left, right, options, R, t, P, left_uv, left_cov, left_size, right_uv, right_cov, right_size, out):
    """Compare a target's lights in both images (h, w, c); return NO_DOUBT, DOUBT or ODD_ONE.

    R (2, 3, 3), t (2, 3): of the cameras; P (n, 3): the lights in rig axes. uv (n, 2), cov (n, 2, 2) and size (n,) of the
    spots of each side; a size of zero or less: not to be looked at. Fills out (2, n, FINDING), zero before.
    """
    n = P.shape[0]
    flip = np.uint8(options[O_FLIP])
    outlines = np.empty((n, OUTLINE))
    sigma = np.empty(n)
    work = np.empty((2, RING))
    outlines_of(left, flip, R[0], t[0], P, left_uv, left_cov, left_size, outlines, sigma, work)
    verdict = compare_view(outlines, sigma, work, out[0])
    outlines_of(right, flip, R[1], t[1], P, right_uv, right_cov, right_size, outlines, sigma, work)
    return max(verdict, compare_view(outlines, sigma, work, out[1]))
