"""The pixels around one bright area as the slower fits want them: values, which of them to use, and their moments."""

from __future__ import annotations

from math import atan2, sqrt

import numpy as np

from armsight.measure.spots.kernels.area import ACCEPTED, HOT, SMALL, STATUS, near, skirt
from armsight.measure.spots.kernels.compiled import kernel
from armsight.measure.spots.kernels.scan import PEAK, X_MAX, X_MIN, Y_MAX, Y_MIN


@kernel
def patch_box(comp, h, w, box):
    """Fill box (x0, x1, y0, y1) with a component's bounds and a margin that holds its skirt and some background."""
    half = 0.5 * max(comp[X_MAX] - comp[X_MIN], comp[Y_MAX] - comp[Y_MIN])
    margin = int(min(max(0.5 * half + 2.0, 4.0), 9.0))
    box[0] = max(int(comp[X_MIN]) - margin, 0)
    box[1] = min(int(comp[X_MAX]) + margin + 1, w)
    box[2] = max(int(comp[Y_MIN]) - margin, 0)
    box[3] = min(int(comp[Y_MAX]) + margin + 1, h)


@kernel
def fill_patch(image, flip, saturation, mask, box, values, use):
    """Fill values and use (ny, nx) from the image; use is 0 for clipped and masked pixels."""
    for j in range(values.shape[0]):
        for i in range(values.shape[1]):
            grey = np.uint8(image[box[2] + j, box[0] + i] ^ flip)
            values[j, i] = grey
            free = mask.size == 0 or mask[box[2] + j, box[0] + i] != 0
            use[j, i] = 1 if grey < saturation and free else 0


@kernel
def leave_to(own, other, box, use):
    """Set use to 0 where a pixel belongs to another component rather than to this one."""
    ox = 0.5 * (own[X_MIN] + own[X_MAX])
    oy = 0.5 * (own[Y_MIN] + own[Y_MAX])
    ow = 0.5 * (own[X_MAX] - own[X_MIN]) + 2.0
    oh = 0.5 * (own[Y_MAX] - own[Y_MIN]) + 2.0
    nx = 0.5 * (other[X_MIN] + other[X_MAX])
    ny = 0.5 * (other[Y_MIN] + other[Y_MAX])
    nw = 0.5 * (other[X_MAX] - other[X_MIN]) + 2.0
    nh = 0.5 * (other[Y_MAX] - other[Y_MIN]) + 2.0
    for j in range(use.shape[0]):
        y = box[2] + j
        for i in range(use.shape[1]):
            x = box[0] + i
            mine = ((x - ox) / ow) ** 2 + ((y - oy) / oh) ** 2
            theirs = ((x - nx) / nw) ** 2 + ((y - ny) / nh) ** 2
            if theirs < mine:
                use[j, i] = 0


@kernel
def used(use):
    """Return how many pixels of the patch are used."""
    n = 0
    for j in range(use.shape[0]):
        for i in range(use.shape[1]):
            n += use[j, i]
    return n


@kernel
def shape_of(values, use, comp, box, level, background, shape):
    """Fill shape (8,): centre, second moments xx, xy, yy above level; the same about half height, unweighted: 5..7."""
    half = background + 0.5 * (comp[PEAK] - background)
    s = np.zeros(6)
    a = np.zeros(6)
    for j in range(values.shape[0]):
        y = float(box[2] + j)
        if y < comp[Y_MIN] or y > comp[Y_MAX]:
            continue
        for i in range(values.shape[1]):
            x = float(box[0] + i)
            v = values[j, i] - level
            if v <= 0.0 or x < comp[X_MIN] or x > comp[X_MAX]:
                continue
            s[0] += v
            s[1] += v * x
            s[2] += v * y
            s[3] += v * x * x
            s[4] += v * x * y
            s[5] += v * y * y
            if values[j, i] > half:
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
        shape[2 + 3 * k] = max(m[3] / total - cx * cx, 0.1)
        shape[3 + 3 * k] = m[4] / total - cx * cy
        shape[4 + 3 * k] = max(m[5] / total - cy * cy, 0.1)


@kernel
def principal(xx, xy, yy):
    """Return the larger and the smaller second moment, and the angle of the larger."""
    mean = 0.5 * (xx + yy)
    root = sqrt(0.25 * (xx - yy) ** 2 + xy * xy)
    return mean + root, max(mean - root, 0.05), 0.5 * atan2(2.0 * xy, xx - yy)


@kernel
def make_patch(image, flip, saturation, mask, comps, state, i, hot, n_hot, subtract, box, values, use):
    """Fill the patch of component i: pixels of hot pixels and of neighbours left out (all, or those not subtracted)."""
    fill_patch(image, flip, saturation, mask, box, values, use)
    for k in range(n_hot):
        x = hot[k, 0] - box[0]
        y = hot[k, 1] - box[2]
        if 0 <= x < use.shape[1] and 0 <= y < use.shape[0]:
            use[y, x] = 0
    for j in range(comps.shape[0]):
        status = state[j, STATUS]
        if j == i or status in (HOT, SMALL) or (subtract > 0 and status == ACCEPTED):
            continue
        if near(comps[i], comps[j], skirt(comps[i]) + 2.0):
            leave_to(comps[i], comps[j], box, use)
