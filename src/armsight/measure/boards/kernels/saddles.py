"""Compiled search for a checkerboard's corners: saddles of the grey levels, and the grid that their edges link.

One pass over the image in whole numbers; what is left after it are hundreds of places, each looked at on a ring.
"""

from __future__ import annotations

from math import pi

import numpy as np

from armsight._numba import inner_kernel, kernel

MARGIN = 5
"""Pixels at the image's edge where no ring fits."""
STEP = 2
"""Pixels between the grey levels of which second differences are taken."""
APART = 2
"""A saddle is the strongest within so many pixels."""
FURTHEST = 1.5
"""... and lies no further off its pixel, in px: what is further off than a neighbour has a place of its own."""
RING = 16
"""Places on the ring: two edges that cross are told from one another to ten degrees of slant."""
RADIUS = 3.0
"""The ring's, in px: smaller than the smallest square, outside the blur of a lens in focus."""
COS = np.cos(np.arange(RING) * (2.0 * pi / RING))
SIN = np.sin(np.arange(RING) * (2.0 * pi / RING))
STRAIGHT = 0.45
"""Two edges cross: what leaves the ring on one side leaves it on the other, to this many rad."""
LEAST_LEVELS = 10.0
"""Grey levels from the darkest to the brightest place of a ring that is looked at."""
EVEN = 0.35
"""Each of the four sectors differs from the middle level by this share of half the contrast and more."""
CONE = 0.25
"""Tangent of the angle between a corner's edge and the way to the next corner on it."""
TURN = 0.5
"""Sine of the angle by which an edge may turn from one corner to the next."""
STEPS = np.array([[1, 0], [0, 1], [-1, 0], [0, -1]])


@inner_kernel
def _row_of_saddles(image, row, out):
    """Fill out (w,) with the negative determinant of the Hessian, of second differences: large where edges cross.

    A straight edge has none, however strong; one loop without a branch, of which vector instructions are made.
    """
    up, here, down = image[row - STEP], image[row], image[row + STEP]
    for col in range(STEP, image.shape[1] - STEP):
        middle = 2 * np.int32(here[col])
        xx = np.int32(here[col - STEP]) + np.int32(here[col + STEP]) - middle
        yy = np.int32(up[col]) + np.int32(down[col]) - middle
        xy = (
            np.int32(up[col - STEP])
            + np.int32(down[col + STEP])
            - np.int32(up[col + STEP])
            - np.int32(down[col - STEP])
        )
        out[col] = xy * xy - 16 * xx * yy


@kernel
def saddle_pixels(image, least, most):
    """Return the places (n, 2), column and row, of the saddles in image (h, w) uint8, and their responses (n,).

    Those of a response over least, at most so many.
    """
    h, w = image.shape
    response = np.zeros((h, w), np.int32)
    for row in range(STEP, h - STEP):
        _row_of_saddles(image, row, response[row])
    pixels, strength = np.empty((most, 2), np.int32), np.empty(most, np.int32)
    n = 0
    for row in range(MARGIN, h - MARGIN):
        for col in range(MARGIN, w - MARGIN):
            here = response[row, col]
            if here <= least:
                continue
            peak = True
            for dv in range(-APART, APART + 1):
                for du in range(-APART, APART + 1):
                    other = response[row + dv, col + du]
                    # of two that are equal the first
                    if other > here or (other == here and (dv < 0 or (dv == 0 and du < 0))):
                        peak = False
            if peak and n < most:
                pixels[n, 0], pixels[n, 1], strength[n] = col, row, here
                n += 1
    return pixels[:n], strength[:n]


@inner_kernel
def _level(image, u, v):
    """Return the grey level between pixels."""
    col, row = int(u), int(v)
    s, t = u - col, v - row
    top = (1.0 - s) * image[row, col] + s * image[row, col + 1]
    return (1.0 - t) * top + t * ((1.0 - s) * image[row + 1, col] + s * image[row + 1, col + 1])


@inner_kernel
def _saddle_point(image, col, row):
    """Return by how much the saddle is off a pixel, where the parabola through its neighbours is level."""
    here = 2.0 * image[row, col]
    left, right, up, down = (
        1.0 * image[row, col - STEP],
        1.0 * image[row, col + STEP],
        1.0 * image[row - STEP, col],
        1.0 * image[row + STEP, col],
    )
    xx, yy, x, y = left + right - here, up + down - here, 0.5 * (right - left), 0.5 * (down - up)
    xy = 1.0 * image[row - STEP, col - STEP] + image[row + STEP, col + STEP]
    xy = 0.25 * (xy - image[row - STEP, col + STEP] - image[row + STEP, col - STEP])
    det = xx * yy - xy * xy
    if det == 0.0:  # a plane or a trough: further off than is looked at
        return 9.0, 9.0
    return STEP * (xy * y - yy * x) / det, STEP * (xy * x - xx * y) / det


@kernel
def saddles_near(image, guess, reach):
    """Return the strongest saddle (n, 2) of image (h, w) uint8 within so many px of each place of guess (n, 2), to a
    part of a pixel; the place itself where there is none.
    """
    out, response = guess.copy(), np.empty(2 * (reach + STEP) + 1, np.int32)
    for i in range(len(guess)):
        left, top = int(np.rint(guess[i, 0])) - reach - STEP, int(np.rint(guess[i, 1])) - reach - STEP
        part = image[max(top, 0) : max(top + len(response), 0), max(left, 0) : max(left + len(response), 0)]
        best, at_row, at_col = 0, 0, 0
        for row in range(STEP, part.shape[0] - STEP):
            _row_of_saddles(part, row, response)
            for col in range(STEP, part.shape[1] - STEP):
                if response[col] > best:
                    best, at_row, at_col = response[col], row, col
        if best > 0:
            du, dv = _saddle_point(part, at_col, at_row)
            if abs(du) < FURTHEST and abs(dv) < FURTHEST:
                out[i, 0], out[i, 1] = max(left, 0) + at_col + du, max(top, 0) + at_row + dv
    return out


@inner_kernel
def _edges_of(ring, angles):
    """Fill angles (4,) with where the ring's levels cross the middle; return the contrast, positive where the sector
    after the first is bright, or 0 where it is no corner.
    """
    low, high = ring.min(), ring.max()
    middle, half = 0.5 * (low + high), 0.5 * (high - low)
    if 2.0 * half < LEAST_LEVELS:
        return 0.0
    n = 0
    first = 0.0
    furthest = 0.0
    for k in range(RING):
        before, after = ring[k] - middle, ring[(k + 1) % RING] - middle
        if (before > 0.0) != (after > 0.0):
            if n == 4:
                return 0.0
            angles[n] = (k + before / (before - after)) * (2.0 * pi / RING)
            if n == 0:
                first = after
            n += 1
    if n != 4:  # an edge crosses the ring twice
        return 0.0
    if abs(angles[2] - angles[0] - pi) > STRAIGHT or abs(angles[3] - angles[1] - pi) > STRAIGHT:
        return 0.0
    for sector in range(4):
        furthest = 0.0
        for k in range(RING):
            at = k * (2.0 * pi / RING)
            if angles[0] > at:
                at += 2.0 * pi
            inside = angles[sector] < at and (sector == 3 or at < angles[sector + 1])
            if inside:
                furthest = max(furthest, abs(ring[k] - middle))
        if furthest < EVEN * half:
            return 0.0
    return half if first > 0.0 else -half


@kernel
def saddle_corners(image, pixels):
    """Return those of places (n, 2) in image (h, w) where two edges cross, as rows (m, 7): u, v px; the unit vectors
    of both edges; +1 or -1 where the sector from the first to the second, by growing angle, is bright or dark.
    """
    out, ring, angles = np.empty((len(pixels), 7)), np.empty(RING), np.empty(4)
    n = 0
    for i in range(len(pixels)):
        du, dv = _saddle_point(image, pixels[i, 0], pixels[i, 1])
        if abs(du) > FURTHEST or abs(dv) > FURTHEST:
            continue
        u, v = pixels[i, 0] + du, pixels[i, 1] + dv
        if not (MARGIN <= u < image.shape[1] - MARGIN and MARGIN <= v < image.shape[0] - MARGIN):
            continue
        for k in range(RING):
            ring[k] = _level(image, u + RADIUS * COS[k], v + RADIUS * SIN[k])
        contrast = _edges_of(ring, angles)
        if contrast == 0.0:
            continue
        out[n, 0], out[n, 1] = u, v
        for k in range(2):
            mean = 0.5 * (angles[k] + angles[k + 2] - pi)
            out[n, 2 + 2 * k], out[n, 3 + 2 * k] = np.cos(mean), np.sin(mean)
        out[n, 6] = 1.0 if contrast > 0.0 else -1.0
        n += 1
    return out[:n]


@inner_kernel
def _way(corner, x, y):
    """Return along which of a corner's four edges (x, y) points: 0 first, 1 second, 2 and 3 their other ends; or -1."""
    for k in range(2):
        along = corner[2 + 2 * k] * x + corner[3 + 2 * k] * y
        beside = corner[2 + 2 * k] * y - corner[3 + 2 * k] * x
        if abs(beside) < CONE * abs(along):
            return k if along > 0.0 else k + 2
    return -1


@inner_kernel
def _bright(corner, way):
    """Return +1 where the sector after an edge, by growing angle, is bright, else -1."""
    return corner[6] if way % 2 == 0 else -corner[6]


@inner_kernel
def _links(corners, to, end):
    """Fill to (n, 4) with the nearest corner along each edge, and end (n, 4) with by which of its edges it is met.

    What is bright on one side of the edge at this corner is bright on the same side at the next.
    """
    for i in range(len(corners)):
        nearest = np.full(4, np.inf)
        to[i] = -1
        for j in range(len(corners)):
            x, y = corners[j, 0] - corners[i, 0], corners[j, 1] - corners[i, 1]
            squared = x * x + y * y
            if j == i:
                continue
            way = _way(corners[i], x, y)
            if way < 0 or squared >= nearest[way]:
                continue
            back = _way(corners[j], -x, -y)
            if back < 0 or _bright(corners[j], back) == _bright(corners[i], way):
                continue
            # the edges across run alike
            a, b = 2 + 2 * ((way + 1) % 2), 2 + 2 * ((back + 1) % 2)
            if abs(corners[i, a] * corners[j, b + 1] - corners[i, a + 1] * corners[j, b]) > TURN:
                continue
            nearest[way], to[i, way], end[i, way] = squared, j, back


@kernel
def grow_grids(corners):
    """Return for each corner (n, 7) the number of the grid that it is of (n,), and its place there (n, 2).

    Corners are linked where each is the other's nearest along an edge; a grid in which two ways lead to different
    places has number -1.
    """
    n = len(corners)
    to, end = np.empty((n, 4), np.int64), np.zeros((n, 4), np.int64)
    _links(corners, to, end)
    grid, node = np.full(n, -1), np.zeros((n, 2), np.int64)
    turn, queue = np.zeros(n, np.int64), np.empty(n, np.int64)
    known = np.zeros(n, np.bool_)
    for start in range(n):
        if known[start]:
            continue
        known[start] = True
        queue[0] = start
        head, tail = 0, 1
        agree = True
        while head < tail:
            i = queue[head]
            head += 1
            for way in range(4):
                j = to[i, way]
                if j < 0 or to[j, end[i, way]] != i:
                    continue
                to_side = (way + turn[i]) % 4  # the grid's own directions: an edge is the first of one corner only
                turned = (to_side + 2 - end[i, way]) % 4
                u, v = node[i, 0] + STEPS[to_side, 0], node[i, 1] + STEPS[to_side, 1]
                if known[j]:
                    agree &= turn[j] == turned and node[j, 0] == u and node[j, 1] == v
                else:
                    known[j] = True
                    turn[j], node[j, 0], node[j, 1] = turned, u, v
                    queue[tail] = j
                    tail += 1
        for k in range(tail):
            grid[queue[k]] = start if agree else -1
    return grid, node
