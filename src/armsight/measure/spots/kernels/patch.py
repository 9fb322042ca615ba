"""The pixels around one bright area as the slower fits want them: values, which of them to use, moments, residuals."""

from __future__ import annotations

from math import atan2, erf, exp, log, pi, sqrt
from typing import Any, NamedTuple

import numpy as np

from armsight._numba import inner_kernel, lean_kernel
from armsight.measure.spots.kernels import columns as col
from armsight.measure.spots.kernels.area import ACCEPTED, HOT, SMALL, boxes_overlap, fit_margin
from armsight.measure.spots.kernels.columns import copy_to
from armsight.measure.spots.kernels.light_models import CLIPPED_PIXEL, JOINT, ROOT_2, ROOT_2PI, STREAK

DEEP = 2.0
"""Depth of the valley between two lights in standard deviations of the noise; the smoothed values have a third of
it."""
SHALLOW = 0.04
"""The same as a share of the higher light's height: ripples that sharpening and compression leave are below it."""
MOST_MAXIMA = 32


class Patch(NamedTuple):
    """The pixels about an area: values (ny, nx) of those in box (x0, x1, y0, y1; ends excluded).

    use (ny, nx): 0 for pixels that do not count, CLIPPED_PIXEL for lower bounds, else 1.
    """

    box: Any
    values: Any
    use: Any


@inner_kernel
def new_patch(comp, h, w):
    """Return the patch of a component in an image of this size, not filled yet."""
    box = np.empty(4, np.int64)
    patch_box(comp, h, w, box)
    shape = (box[3] - box[2], box[1] - box[0])
    return Patch(box, np.empty(shape), np.empty(shape, np.uint8))


@lean_kernel
def patch_box(comp, h, w, box):
    """Fill box (x0, x1, y0, y1) with a component's bounds and a margin that holds its tails and some background."""
    half = 0.5 * max(comp[col.X_MAX] - comp[col.X_MIN], comp[col.Y_MAX] - comp[col.Y_MIN])
    margin = int(min(max(0.5 * half + 2.0, 4.0), 9.0))
    box[0] = max(int(comp[col.X_MIN]) - margin, 0)
    box[1] = min(int(comp[col.X_MAX]) + margin + 1, w)
    box[2] = max(int(comp[col.Y_MIN]) - margin, 0)
    box[3] = min(int(comp[col.Y_MAX]) + margin + 1, h)


@lean_kernel
def fill_patch(picture, patch):
    """Fill values and use from the image; use is 0 for masked pixels, CLIPPED_PIXEL for clipped ones."""
    image, flip, saturation, mask = picture
    box, values, use = patch
    for j in range(values.shape[0]):
        for i in range(values.shape[1]):
            grey = np.uint8(image[box[2] + j, box[0] + i] ^ flip)
            values[j, i] = grey
            free = mask.size == 0 or mask[box[2] + j, box[0] + i] != 0
            use[j, i] = 0 if not free else 1 if grey < saturation else CLIPPED_PIXEL


@lean_kernel
def exclude_other_area(own, other, patch):
    """Set use to 0 where a pixel belongs to another component rather than to this one."""
    box, use = patch.box, patch.use
    ox = 0.5 * (own[col.X_MIN] + own[col.X_MAX])
    oy = 0.5 * (own[col.Y_MIN] + own[col.Y_MAX])
    ow = 0.5 * (own[col.X_MAX] - own[col.X_MIN]) + 2.0
    oh = 0.5 * (own[col.Y_MAX] - own[col.Y_MIN]) + 2.0
    nx = 0.5 * (other[col.X_MIN] + other[col.X_MAX])
    ny = 0.5 * (other[col.Y_MIN] + other[col.Y_MAX])
    nw = 0.5 * (other[col.X_MAX] - other[col.X_MIN]) + 2.0
    nh = 0.5 * (other[col.Y_MAX] - other[col.Y_MIN]) + 2.0
    for j in range(use.shape[0]):
        y = box[2] + j
        for i in range(use.shape[1]):
            x = box[0] + i
            # in half axes of their bounds: a border between two areas whatever their sizes
            mine = ((x - ox) / ow) ** 2 + ((y - oy) / oh) ** 2
            theirs = ((x - nx) / nw) ** 2 + ((y - ny) / nh) ** 2
            if theirs < mine:
                use[j, i] = 0


@lean_kernel
def used(use):
    """Return how many pixels of the patch are used for what they are."""
    n = 0
    for j in range(use.shape[0]):
        for i in range(use.shape[1]):
            n += use[j, i] == 1
    return n


@inner_kernel
def shape_of(patch, comp, level, background, shape):
    """Fill shape (10,): centre, second moments xx, xy, yy above level; the same above half height, unweighted: 5..7.

    8: how many pixels are above half height; 9: how many of these below three quarters of it.
    """
    box, values = patch.box, patch.values
    half = background + 0.5 * (comp[col.PEAK] - background)
    upper = background + 0.75 * (comp[col.PEAK] - background)
    s = np.zeros(6)
    a = np.zeros(6)
    shape[9] = 0.0
    for j in range(values.shape[0]):
        y = float(box[2] + j)
        if y < comp[col.Y_MIN] or y > comp[col.Y_MAX]:
            continue
        for i in range(values.shape[1]):
            x = float(box[0] + i)
            v = values[j, i] - level
            if v <= 0.0 or x < comp[col.X_MIN] or x > comp[col.X_MAX]:
                continue
            s[0] += v
            s[1] += v * x
            s[2] += v * y
            s[3] += v * x * x
            s[4] += v * x * y
            s[5] += v * y * y
            if values[j, i] > half:
                shape[9] += values[j, i] < upper
                a[0] += 1.0
                a[1] += x
                a[2] += y
                a[3] += x * x
                a[4] += x * y
                a[5] += y * y
    for k in range(2):
        m = s if k == 0 else a
        total = max(m[0], 1e-9)
        cx = m[1] / total
        cy = m[2] / total
        if k == 0:
            shape[0] = cx
            shape[1] = cy
        # not below 0.1, about a pixel's own: a single column has a width
        shape[2 + 3 * k] = max(m[3] / total - cx * cx, 0.1)
        shape[3 + 3 * k] = m[4] / total - cx * cy
        shape[4 + 3 * k] = max(m[5] / total - cy * cy, 0.1)
    shape[8] = a[0]


@lean_kernel
def smoothed(values, use, j, i):
    """Return the mean of the 3 x 3 pixels around (j, i), or -1 where one of them is not used."""
    if j < 1 or i < 1 or j > values.shape[0] - 2 or i > values.shape[1] - 2:
        return -1.0
    total = 0.0
    for a in range(j - 1, j + 2):
        for b in range(i - 1, i + 2):
            if use[a, b] == 0:
                return -1.0
            total += values[a, b]
    return total / 9.0


@lean_kernel
def valley(patch, a, b):
    """Return the lowest smoothed value on the straight line between two peaks (x, y, height)."""
    x0, y0 = patch.box[0], patch.box[2]
    steps = int(max(abs(a[0] - b[0]), abs(a[1] - b[1]))) + 1
    low = 1e9
    for k in range(steps + 1):
        x = a[0] + (b[0] - a[0]) * k / steps
        y = a[1] + (b[1] - a[1]) * k / steps
        v = smoothed(patch.values, patch.use, int(y + 0.5) - y0, int(x + 0.5) - x0)
        # where pixels are left out nothing is known, and nothing parts the two
        if v >= 0.0:
            low = min(low, v)
    return low


@inner_kernel
def find_peaks(patch, level, noise, peaks):
    """Fill peaks (.., 3: x, y, height) with the maxima that a valley parts from all higher ones; return how many."""
    box, values, use = patch
    x0, y0 = box[0], box[2]
    found = np.empty((MOST_MAXIMA, 3))
    means = np.empty(values.shape)
    for j in range(values.shape[0]):
        for i in range(values.shape[1]):
            means[j, i] = smoothed(values, use, j, i)
    n = 0
    for j in range(1, values.shape[0] - 1):
        for i in range(1, values.shape[1] - 1):
            v = means[j, i]
            if v <= level or n == MOST_MAXIMA:
                continue
            top = True
            for a in range(-1, 2):
                for b in range(-1, 2):
                    other = means[j + a, i + b]
                    # of equal ones the first in reading order alone is a maximum
                    if other > v or (other == v and (a < 0 or (a == 0 and b < 0))):
                        top = False
            if top:
                k = n
                while k > 0 and found[k - 1, 2] < v:
                    copy_to(found[k - 1], found[k])
                    k -= 1
                found[k, 0] = x0 + i
                found[k, 1] = y0 + j
                found[k, 2] = v
                n += 1
    count = np.int64(0)
    depth = max(DEEP * sqrt(noise), SHALLOW * (found[0, 2] - level)) if n > 0 else 0.0
    for k in range(n):
        parted = count < peaks.shape[0]
        for m in range(count):
            if valley(patch, found[k], peaks[m]) > found[k, 2] - depth:
                parted = False
        if parted:
            copy_to(found[k], peaks[count])
            count += 1
    return count


@lean_kernel
def principal(xx, xy, yy):
    """Return the larger and the smaller second moment, and the angle of the larger."""
    # eigenvalues and direction of [[xx, xy], [xy, yy]]
    mean = 0.5 * (xx + yy)
    root = sqrt(0.25 * (xx - yy) ** 2 + xy * xy)
    return mean + root, max(mean - root, 0.05), 0.5 * atan2(2.0 * xy, xx - yy)


@lean_kernel
def make_patch(picture, comps, state, i, hot, subtract, patch):
    """Fill the patch of component i: pixels of hot pixels and of neighbours left out (all, or those not subtracted)."""
    fill_patch(picture, patch)
    box, use = patch.box, patch.use
    for k in range(hot.shape[0]):
        x = hot[k, 0] - box[0]
        y = hot[k, 1] - box[2]
        if 0 <= x < use.shape[1] and 0 <= y < use.shape[0]:
            use[y, x] = 0
    for j in range(comps.shape[0]):
        status = state[j, col.STATUS]
        # the light of a neighbour that was measured is taken off instead
        if j == i or status in (HOT, SMALL) or (subtract > 0 and status == ACCEPTED):
            continue
        if boxes_overlap(comps[i], comps[j], fit_margin(comps[i]) + 2.0):
            exclude_other_area(comps[i], comps[j], patch)


@lean_kernel
def residual_autocorrelation(residuals):
    """Return the sum of products of neighbouring residuals, and that over its own standard deviation
    (round_gaussian.residual_sums)."""
    products = 0.0
    spread = 0.0
    for j in range(residuals.shape[0]):
        for i in range(residuals.shape[1]):
            r = residuals[j, i]
            left = residuals[j, i - 1] if i > 0 else 0.0
            above = residuals[j - 1, i] if j > 0 else 0.0
            # of independent residuals the sum has the sum of the products' squares as its variance
            products += r * (left + above)
            spread += r * r * (left * left + above * above)
    return products, products / sqrt(spread) if spread > 0.0 else 0.0


@lean_kernel
def antisymmetric_part(residuals, use, u, v, antisymmetric):
    """Fill antisymmetric with the part of the residuals that changes sign under reflection at (u, v), times root 2.

    Only this part moves a centre: a profile that is wrong but symmetric (a halo, a ring) leaves it alone. Returns
    the sum of its squares and how many pixels it has. u and v count from the patch's first pixel.
    """
    turn_x = int(np.round(2.0 * u))
    turn_y = int(np.round(2.0 * v))
    squares = 0.0
    count = 0
    for j in range(residuals.shape[0]):
        for i in range(residuals.shape[1]):
            antisymmetric[j, i] = 0.0
            a = turn_y - j
            b = turn_x - i
            if 0 <= a < residuals.shape[0] and 0 <= b < residuals.shape[1] and use[j, i] == 1 and use[a, b] == 1:
                antisymmetric[j, i] = (residuals[j, i] - residuals[a, b]) / ROOT_2
                squares += antisymmetric[j, i] ** 2
                count += 1
    return squares, count


# Where the fits of a light begin: from these moments, and from the peaks.

LEAST_RATIO = 1.5
"""Of a light's height to its threshold's, as far as a start goes by it."""
HALF_EDGE, LEAST_START, USUAL_START, MOST_START = 0.674, 0.35, 0.8, 3.0
"""Width in blurs of an edge from half its height to three quarters, and the blurs that a fit may start from."""


@lean_kernel
def widened(comp, background):
    """Return a round Gaussian's variance over the second moment of what of it is above the threshold."""
    # above exp(-x) of its height, in t = r^2 / 2 q: of exp(-t) - exp(-x) from 0 to x
    x = log(max((comp[col.PEAK] - background) / max(comp[col.LEVEL] + 0.5 - background, 0.5), LEAST_RATIO))
    rest = exp(-x)
    return (1.0 - (1.0 + x) * rest) / (1.0 - (1.0 + x + 0.5 * x * x) * rest)


@lean_kernel
def start_model(kind, lights, comp, shape, background, peaks, p):
    """Fill p with a start from the moments, or from the peaks (.., 3) for three lights and more; return its length."""
    large, small, angle = principal(shape[2], shape[3], shape[4])
    height = max(comp[col.PEAK] - background, 1.0)
    p[0] = background
    if kind == JOINT and lights > 2:
        low = max(comp[col.LEVEL] + 0.5 - background, 0.5)
        for k in range(lights):
            p[2 + 3 * k] = peaks[k, 0]
            p[3 + 3 * k] = peaks[k, 1]
            p[4 + 3 * k] = max(peaks[k, 2] - background, 1.1 * low)
        # the area of a Gaussian above a level L is 2 pi q ln(A / L), see round_start
        p[1] = 2.0 * pi * lights * log(max(height / low, 1.5)) / comp[col.AREA]
        return 2 + 3 * lights
    if kind == JOINT:
        # the second moments are of what is above the threshold: less than the light's own
        q = widened(comp, background) * 0.5 * (large + small) if lights == 1 else 1.3 * small + 0.1
        p[1] = 1.0 / q
        # two lights of +-apart: the second moment along is the one across and apart^2
        apart = sqrt(max(large - small, 0.2 * small)) if lights == 2 else 0.0
        for k in range(lights):
            sign = 2.0 * k - 1.0
            p[2 + 3 * k] = shape[0] + sign * apart * np.cos(angle)
            p[3 + 3 * k] = shape[1] + sign * apart * np.sin(angle)
            p[4 + 3 * k] = height * (1.0 if lights == 1 else 1.0 / (1.0 + exp(-2.0 * apart * apart / q)))
        return 2 + 3 * lights
    p[1] = shape[0]
    p[2] = shape[1]
    p[3] = height
    if kind == STREAK:
        p[4] = sqrt(1.3 * small)
        p[5] = angle
        # a segment of half length h has the second moment h^2 / 3
        p[6] = sqrt(3.0 * max(large - small, 0.3 * small))
        p[3] = height * 2.0 * p[6] / (ROOT_2PI * p[4] * erf(p[6] / (ROOT_2 * p[4])))
        return 7
    p[4] = min(max(shape[9] / (HALF_EDGE * 2.0 * sqrt(pi * max(shape[8], 1.0))), LEAST_START), MOST_START)
    if comp[col.CLIPPED] > 0.0:  # three quarters of its height are not where they seem to be
        p[4] = USUAL_START
    # a flat ellipse x'Mx <= 1 has the second moments M^-1 / 4
    det = 4.0 * max(shape[5] * shape[7] - shape[6] ** 2, 0.05)
    p[5] = shape[7] / det
    p[6] = -shape[6] / det
    p[7] = shape[5] / det
    return 8
