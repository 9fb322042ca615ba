"""Is a light of the target covered in part? Its outline beside those of the target's other lights in the same view.

Lights of one target look alike in one view: tilt, blur, motion and bloom shape them alike. What an edge cuts off makes
a light narrower in one direction and hardly in the other; its centre moves by less than its width falls short in radii.
"""

from __future__ import annotations

from math import atan2, cos, exp, log, pi, sin, sqrt
from typing import Any, NamedTuple

import numpy as np

from armsight._numba import inner_kernel, kernel, lean_kernel
from armsight.measure.spots.kernels import columns as col
from armsight.measure.spots.kernels.outline import AREA, EDGE_X, EDGE_Y, MOMENTS, RING, XX, XY, YY, outline
from armsight.optics.kernels.camera import CameraK, RigK

GATE_PX = 0.25
WIDER_PX = 0.5
"""How far (px, all views together) a light's radius along one direction may fall short of the others', and exceed it:
of whole lights of 810 composites 98 % are narrower by less than 0.19 px in one view."""
BOTH_PX = 0.1
"""The same in each of two views: a soft edge narrows a light by little, but in both of them."""
CUT = 2.5
"""Standard deviation of the centre, in px, for each px^2 over the others' radius that a light's second moment falls
short: of 395 half-hidden lights of composites the centres are off by 2.1 in the middle, by 3.2 at nine tenths."""
EDGE = 0.05
"""Change of what is behind a light, in heights of the light, from which an edge runs through it: what is seen there may
be before it, and whatever its outline lacks across the edge is then hidden. Of 4860 lights that nobody covers a tenth
is beyond, nearly all of them before a room; of 44 poses there that a half-hidden light made worse than they claimed,
64 %."""
CLAIMED = 1.0
"""Standard deviations that a centre's own covariance already allows for."""
ODD_PX = 0.6
ODD_SIGMAS = 3.0
"""The same in one view, and standard deviations of its centre on top, against each other light, from which it is no
light like the others: one composite in 265. One that is so in both views is not, however little is claimed of its
centre: LITTLE_PX on top."""
LARGER = 2.0
"""Ratio of its size to each other one's from which a light whose centre claims COMPARABLE_PX or worse is wider by
itself, and not by what is bright beside it: of 11 such lights of composites, 2.4 and more, all are off by more than 4
of their standard deviations; of the 19 others that look wider, 1.3 at the most, one is."""
LITTLE_PX = 0.15
IN_ONE_VIEW = 0.5
UNEVEN = 0.32
"""Logarithm of the ratio of radii from which a light is of another size, whatever its form: clipped lights of twice the
brightness differ by 0.26."""
COMPARABLE_PX = 0.3
"""Standard deviation of a centre above which a light's own outline is in doubt, as where something bright touches it:
the others are not compared with it."""
BLUR_PX2 = 1.0
"""Square of the part of a radius that does not shrink with distance: the lens's blur and the pixel."""

NO_DOUBT, DOUBT, ODD_ONE = range(3)
UU, UV, VV, ODD = range(4)
FINDING = 4
"""Of a light in one view: variance to be added to its centre's, and 1 where it is unlike every other one."""


class SpotsK(NamedTuple):
    """The spots of n lights in one view: uv (n, 2) px, cov (n, 2, 2), size (n,) px; 0 or less: not to be looked at."""

    uv: Any
    cov: Any
    size: Any


@lean_kernel
def radii(mine, other, out):
    """Fill out (3,), logarithms: how much narrower and how much wider a light is than the other, each in the direction
    in which it is so most, and how much larger."""
    det = other[XX] * other[YY] - other[XY] ** 2
    # eigenvalues of other^-1 mine, squares of the ratios of radii where they are extreme, by trace and determinant
    half = 0.5 * (other[YY] * mine[XX] - 2.0 * other[XY] * mine[XY] + other[XX] * mine[YY]) / det
    ratio = (mine[XX] * mine[YY] - mine[XY] ** 2) / det
    root = sqrt(max(half * half - ratio, 0.0))
    out[0] = -0.5 * log(max(half - root, 1e-4))
    out[1] = 0.5 * log(max(half + root, 1e-4))
    out[2] = 0.5 * (out[1] - out[0])


@lean_kernel
def differences(mine, other, out):
    """Fill out (3,): px by which a light is narrower, and wider, in one direction than the other; log of their ratio.

    What it is in both directions does not count for the first two, up to UNEVEN: a fainter light is smaller all round.
    """
    radii(mine, other, out)
    radius = sqrt(other[AREA] / pi)
    both = out[0] + out[1]
    narrower = min(out[0], both)
    wider = min(out[1], both)
    if abs(out[2]) > UNEVEN:
        narrower = max(narrower, -out[2])
        wider = max(wider, out[2])
    out[0] = narrower * radius
    out[1] = wider * radius


@lean_kernel
def add_along(angle, variance, row):
    """Add a variance along a direction to row (.., uu, uv, vv)."""
    c = cos(angle)
    s = sin(angle)
    row[UU] += variance * c * c
    row[UV] += variance * c * s
    row[VV] += variance * s * s


@lean_kernel
def doubt_light(mine, mean, sigma, narrower, wider, row):
    """Add to row what may be hidden of a light (where narrower), and what may lie beside it (where wider).

    Where an edge takes f of a disc of radius r, its second moment falls short by as many r^2 as its centre moves by r.
    """
    xx = mean[XX] - mine[XX]
    xy = mean[XY] - mine[XY]
    yy = mean[YY] - mine[YY]
    # principal directions of what the second moments fall short by: where it was cut off, and square to that
    angle = 0.5 * atan2(2.0 * xy, xx - yy)
    root = sqrt(0.25 * (xx - yy) ** 2 + xy * xy)
    half = 0.5 * (xx + yy)
    known = (CLAIMED * sigma) ** 2
    per = CUT / sqrt(mean[AREA] / pi)
    first = per * (half + root)
    second = per * (half - root)
    if narrower:
        add_along(angle, max(max(first, 0.0) ** 2 - known, 0.0), row)
        add_along(angle + 0.5 * pi, max(max(second, 0.0) ** 2 - known, 0.0), row)
    if wider:
        add_along(angle, max(min(first, 0.0) ** 2 - known, 0.0), row)
        add_along(angle + 0.5 * pi, max(min(second, 0.0) ** 2 - known, 0.0), row)


@lean_kernel
def doubt_edge(mine, mean, sigma, row):
    """Add to row what the thing whose edge runs through a light may hide of it: what it lacks across the edge.

    That is not less than what no one sees: radii are compared to within BOTH_PX, and a disc's second moment falls short
    by half a radius times that.
    """
    size = sqrt(mine[EDGE_X] ** 2 + mine[EDGE_Y] ** 2)
    if size < EDGE:
        return
    c = mine[EDGE_X] / size
    s = mine[EDGE_Y] / size
    short = (mean[XX] - mine[XX]) * c * c + 2.0 * (mean[XY] - mine[XY]) * c * s + (mean[YY] - mine[YY]) * s * s
    variance = (CUT * max(short / sqrt(mean[AREA] / pi), 0.5 * BOTH_PX)) ** 2
    known = (CLAIMED * sigma) ** 2 + row[UU] * c * c + 2.0 * row[UV] * c * s + row[VV] * s * s
    add_along(atan2(s, c), max(variance - known, 0.0), row)


@lean_kernel
def compare_view(outlines, size, sigma, mean, d, found):
    """Compare the lights (n, OUTLINE) of one view. size (n,); sigma (n,): largest standard deviation of each centre.

    Fills mean (n, OUTLINE) with that of the others, its AREA 0 where there is none, and found (n, 3): px by which a
    light is narrower and wider than it, and 1 where it is unlike every other one.
    """
    n = outlines.shape[0]
    for i in range(n):
        mean[i] = 0.0
        found[i, 0] = 0.0
        found[i, 1] = 0.0
        found[i, 2] = 0.0
        if outlines[i, AREA] == 0.0:
            continue
        others = 0
        narrower = 1e9
        wider = 1e9
        larger = True
        for k in range(n):
            if k == i or not outlines[k, AREA] > 0.0 or sigma[k] > COMPARABLE_PX:
                continue
            others += 1
            if outlines[i, AREA] < 0.0:
                continue
            for m in range(MOMENTS):
                mean[i, m] += outlines[k, m]
            differences(outlines[i], outlines[k], d)
            narrower = min(narrower, d[0])
            wider = min(wider, d[1])
            larger = larger and size[i] > LARGER * size[k]
        if outlines[i, AREA] < 0.0:  # dark in its middle, where others are bright
            found[i, 2] = 1.0 if others > 1 else 0.0
            continue
        if others == 0:
            continue
        for m in range(MOMENTS):
            mean[i, m] /= others
        if n == 2:  # of two lights the smaller one
            wider = 0.0
        doubt = ODD_SIGMAS * sigma[i]
        if narrower > ODD_PX + doubt or (wider > ODD_PX + doubt and (sigma[i] <= COMPARABLE_PX or larger)):
            found[i, 2] = 1.0
        elif max(narrower, wider) > ODD_PX + LITTLE_PX:
            found[i, 2] = IN_ONE_VIEW
        differences(outlines[i], mean[i], d)
        found[i, 0] = max(d[0], 0.0)
        if sigma[i] <= COMPARABLE_PX:
            found[i, 1] = max(d[1], 0.0)


@lean_kernel
def turn_alike(camera, P, lean, outlines):
    """Change the outlines of flat lights, as at the first one's distance, to what they would be in its place.

    lean (3,): their radius times their normal in rig axes. A disc's second moments are a quarter of its radius' square
    in its plane, and each is looked at from another side.
    """
    k, R, t = camera
    lx = R[0, 0] * lean[0] + R[0, 1] * lean[1] + R[0, 2] * lean[2]
    ly = R[1, 0] * lean[0] + R[1, 1] * lean[1] + R[1, 2] * lean[2]
    lz = R[2, 0] * lean[0] + R[2, 1] * lean[1] + R[2, 2] * lean[2]
    square = lx * lx + ly * ly + lz * lz
    first = R[2, 0] * P[0, 0] + R[2, 1] * P[0, 1] + R[2, 2] * P[0, 2] + t[2]
    fx = 0.5 * k[0] / first
    fy = 0.5 * k[1] / first
    at_xx = 0.0
    at_xy = 0.0
    at_yy = 0.0
    for i in range(P.shape[0]):
        z = R[2, 0] * P[i, 0] + R[2, 1] * P[i, 1] + R[2, 2] * P[i, 2] + t[2]
        a = (R[0, 0] * P[i, 0] + R[0, 1] * P[i, 1] + R[0, 2] * P[i, 2] + t[0]) / z
        b = (R[1, 0] * P[i, 0] + R[1, 1] * P[i, 1] + R[1, 2] * P[i, 2] + t[1]) / z
        xx = fx * fx * (square * (1.0 + a * a) - (lx - a * lz) ** 2)
        xy = fx * fy * (square * a * b - (lx - a * lz) * (ly - b * lz))
        yy = fy * fy * (square * (1.0 + b * b) - (ly - b * lz) ** 2)
        if i == 0:
            at_xx = xx
            at_xy = xy
            at_yy = yy
        xx = outlines[i, XX] + at_xx - xx
        xy = outlines[i, XY] + at_xy - xy
        yy = outlines[i, YY] + at_yy - yy
        if outlines[i, AREA] > 0.0 and xx > 0.0 and xx * yy > xy * xy:
            outlines[i, XX] = xx
            outlines[i, XY] = xy
            outlines[i, YY] = yy


@lean_kernel
def outlines_of(image, flip, camera, P, lean, spots, outlines, sigma, work):
    """Fill outlines (n, OUTLINE), as at the first light's place, and sigma (n,) of the lights in one image."""
    R, t = camera.R, camera.t
    uv, size = spots.uv, spots.size
    first = 0.0
    for i in range(P.shape[0]):
        c = spots.cov[i]
        # the larger root of the covariance's characteristic equation: the worst direction
        sigma[i] = sqrt(0.5 * (c[0, 0] + c[1, 1]) + sqrt(0.25 * (c[0, 0] - c[1, 1]) ** 2 + c[0, 1] ** 2))
        depth = R[2, 0] * P[i, 0] + R[2, 1] * P[i, 1] + R[2, 2] * P[i, 2] + t[2]
        if i == 0:
            first = depth
        outlines[i, AREA] = 0.0
        if not (size[i] > 0.0 and depth > 0.0 and first > 0.0):
            continue
        outline(image, flip, uv[i, 0], uv[i, 1], size[i], work, outlines[i])
        if outlines[i, AREA] > 0.0:
            # area and moments go with the inverse square of the distance, but for the part that blur makes, which stays
            share = max(1.0 - BLUR_PX2 * pi / outlines[i, AREA], 0.0)
            nearer = exp(2.0 * share * log(depth / first))
            for m in range(MOMENTS):
                outlines[i, m] *= nearer
    if lean[0] ** 2 + lean[1] ** 2 + lean[2] ** 2 > 0.0:
        turn_alike(camera, P, lean, outlines)


@inner_kernel
def compare_views(rig, p, outlines, side, other, mean, d, found):
    """Compare a light at p (3,), beside which there is none to compare it with, with itself in another view.

    outlines (v, OUTLINE): its own. Fills mean (OUTLINE,) with what the view of `side` would show of the other one's
    outline if it faced that camera, and found (3,) as compare_view does. Where an edge runs through the light it may
    lack the same in both views: it is then compared with a round one as large as it is long.
    """
    k, R, t = rig
    if not (outlines[side, AREA] > 0.0 and outlines[other, AREA] > 0.0):
        return
    z = R[side, 2, 0] * p[0] + R[side, 2, 1] * p[1] + R[side, 2, 2] * p[2] + t[side, 2]
    a = (R[side, 0, 0] * p[0] + R[side, 0, 1] * p[1] + R[side, 0, 2] * p[2] + t[side, 0]) / z
    b = (R[side, 1, 0] * p[0] + R[side, 1, 1] * p[1] + R[side, 1, 2] * p[2] + t[side, 1]) / z
    far = R[other, 2, 0] * p[0] + R[other, 2, 1] * p[1] + R[other, 2, 2] * p[2] + t[other, 2]
    A = np.empty((2, 2))  # from px of the other view to px of this one
    for j in range(2):
        # 1 px of the other view is far / f m along its axis j, in a plane that faces it, and is seen from here
        x = R[side, 0, 0] * R[other, j, 0] + R[side, 0, 1] * R[other, j, 1] + R[side, 0, 2] * R[other, j, 2]
        y = R[side, 1, 0] * R[other, j, 0] + R[side, 1, 1] * R[other, j, 1] + R[side, 1, 2] * R[other, j, 2]
        deep = R[side, 2, 0] * R[other, j, 0] + R[side, 2, 1] * R[other, j, 1] + R[side, 2, 2] * R[other, j, 2]
        A[0, j] = k[side, 0] / z * (x - a * deep) * far / k[other, j]
        A[1, j] = k[side, 1] / z * (y - b * deep) * far / k[other, j]
    xx = outlines[other, XX]
    xy = outlines[other, XY]
    yy = outlines[other, YY]
    mean[AREA] = outlines[other, AREA] * abs(A[0, 0] * A[1, 1] - A[0, 1] * A[1, 0])
    mean[XX] = A[0, 0] ** 2 * xx + 2.0 * A[0, 0] * A[0, 1] * xy + A[0, 1] ** 2 * yy
    mean[XY] = A[0, 0] * A[1, 0] * xx + (A[0, 0] * A[1, 1] + A[0, 1] * A[1, 0]) * xy + A[0, 1] * A[1, 1] * yy
    mean[YY] = A[1, 0] ** 2 * xx + 2.0 * A[1, 0] * A[1, 1] * xy + A[1, 1] ** 2 * yy
    mine = outlines[side]
    if mine[EDGE_X] ** 2 + mine[EDGE_Y] ** 2 > EDGE**2:
        half = 0.5 * (mine[XX] - mine[YY])
        length = 0.5 * (mine[XX] + mine[YY]) + sqrt(half * half + mine[XY] ** 2)
        if length > 0.5 * (mean[XX] + mean[YY]):
            mean[XX] = length
            mean[XY] = 0.0
            mean[YY] = length
    differences(mine, mean, d)
    found[0] = max(d[0], 0.0)
    found[1] = 0.0


@lean_kernel
def judge_light(outlines, mean, sigma, found, out):
    """Fill out (v, FINDING) for a light from its outline, that of the others, and found (compare_view), in all views.

    A light that is odd is so in those views in which it looks it. Returns NO_DOUBT, DOUBT or ODD_ONE.
    """
    odd = 0.0
    short = 0.0
    long = 0.0
    in_views = 0
    for side in range(found.shape[0]):
        odd += found[side, 2]
        short += found[side, 0] ** 2
        long += found[side, 1] ** 2
        in_views += found[side, 0] > BOTH_PX
    if odd >= 1.0:
        for side in range(found.shape[0]):
            out[side, ODD] = 1.0 if found[side, 2] > 0.0 else 0.0
        return ODD_ONE
    narrower = short > GATE_PX**2 or in_views > 1
    wider = long > WIDER_PX**2
    verdict = NO_DOUBT
    for side in range(found.shape[0]):
        if (narrower and found[side, 0] > 0.0) or (wider and found[side, 1] > 0.0):
            doubt_light(outlines[side], mean[side], sigma[side], narrower, wider, out[side])
        if mean[side, AREA] > 0.0:
            doubt_edge(outlines[side], mean[side], sigma[side], out[side])
        if out[side, UU] + out[side, VV] > 0.0:
            verdict = DOUBT
    return verdict


@lean_kernel
def nearest_view(rig, p, outlines, sigma, side):
    """Return the view that sees a light at p (3,) from nearest to where `side` does, and its whole outline; -1 where
    there is none. outlines (v, OUTLINE), sigma (v,): its own."""
    R, t = rig.R, rig.t
    nearest, most = -1, -2.0
    for other in range(sigma.shape[0]):
        if other == side or not outlines[other, AREA] > 0.0 or not sigma[other] <= COMPARABLE_PX:
            continue
        along = a2 = b2 = 0.0
        for i in range(3):  # from the light to either centre of projection, -R' t
            a = -p[i] - (R[side, 0, i] * t[side, 0] + R[side, 1, i] * t[side, 1] + R[side, 2, i] * t[side, 2])
            b = -p[i] - (R[other, 0, i] * t[other, 0] + R[other, 1, i] * t[other, 1] + R[other, 2, i] * t[other, 2])
            along += a * b
            a2 += a * a
            b2 += b * b
        along /= sqrt(a2 * b2)
        if along > most:
            most = along
            nearest = other
    return nearest


@kernel
def look_at_view(image, options, camera, P, lean, spots, outlines, mean, found, sigma):
    """Compare a target's lights in the image (h, w, c) of a view: one at a time, as a tuple's length is compiled in.

    camera: as a CameraK; P (n, 3): the lights in rig axes; lean (3,): the radius of flat lights times their normal in
    rig axes, zero where they are not known to be flat. spots: as SpotsK, in the order of P, of size 0 where the view
    shows none. Fills outlines and mean (n, OUTLINE), found (n, 3) and sigma (n,).
    """
    spots = SpotsK(*spots)
    work = np.empty((2, RING))
    outlines_of(image, np.uint8(options[col.O_FLIP]), CameraK(*camera), P, lean, spots, outlines, sigma, work)
    compare_view(outlines, spots.size, sigma, mean, work[0], found)


@kernel
def judge_lights(rig, P, outlines, mean, found, sigma, out):
    """Fill out (v, n, FINDING), zero before, from what look_at_view found; return NO_DOUBT, DOUBT or ODD_ONE."""
    rig = RigK(*rig)
    d = np.empty(3)
    verdict = NO_DOUBT
    for i in range(P.shape[0]):
        for side in range(sigma.shape[0]):
            if mean[side, i, AREA] == 0.0:
                other = nearest_view(rig, P[i], outlines[:, i], sigma[:, i], side)
                if other >= 0:
                    compare_views(rig, P[i], outlines[:, i], side, other, mean[side, i], d, found[side, i])
        verdict = max(verdict, judge_light(outlines[:, i], mean[:, i], sigma[:, i], found[:, i], out[:, i]))
    return verdict
