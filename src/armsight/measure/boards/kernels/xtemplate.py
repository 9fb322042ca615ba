"""Compiled search for a square's corners with the X-shaped templates of Pachidis et al. 2005, appendix."""

from __future__ import annotations

import numpy as np

from armsight._numba import inner_kernel, kernel

RINGS = 5
"""The legs of the 11 x 11 template are five pixels long."""


@inner_kernel
def _matches(labels, own, u, v, legs, rings):
    """Return how many of the legs' pixels have the right colour: the first leg the square's, the other three not."""
    h, w = labels.shape
    right = 0
    for leg in range(4):
        for k in range(1, rings + 1):
            col = u + int(np.rint(k * legs[leg, 0]))
            row = v + int(np.rint(k * legs[leg, 1]))
            inside = 0 <= col < w and 0 <= row < h and labels[row, col] == own
            if inside == (leg == 0):
                right += 1
    return right


@inner_kernel
def _aim(quad, corner, legs):
    """Fill legs (4, 2): from the corner into the square, then through the three sectors outside; largest entry 1.

    For a square that stands upright they are the diagonals of the paper's template in one of its four orientations.
    """
    e1 = quad[(corner + 1) % 4] - quad[corner]
    e2 = quad[(corner + 3) % 4] - quad[corner]
    e1 = e1 / (np.hypot(e1[0], e1[1]) + 1e-12)
    e2 = e2 / (np.hypot(e2[0], e2[1]) + 1e-12)
    for axis in range(2):
        legs[0, axis] = e1[axis] + e2[axis]
        legs[1, axis] = e1[axis] - e2[axis]
    for leg in range(2):
        longest = max(abs(legs[leg, 0]), abs(legs[leg, 1])) + 1e-12
        for axis in range(2):
            legs[leg, axis] /= longest
            legs[leg + 2, axis] = -legs[leg, axis]


@kernel
def place_corners(labels, own, quads, radius, rings, corners, score):
    """Place the four corners of each square at the mean of their inner and outer peaks.

    labels (h, w) int32: which square each pixel belongs to. own (n,): the squares' labels. quads (n, 4, 2): rough
    corners, px, in order round the square. radius (n,), rings (n,): how far to search and how long the legs are,
    px. Fills corners (n, 4, 2) and score (n, 4), the share of the legs' pixels that fit at the two peaks.

    The template whose centre is the square's colour peaks at the corner's inner pixel, the one whose centre is
    the substrate's at its outer pixel; several pixels with the same response count with their mean.
    """
    h, w = labels.shape
    legs = np.empty((4, 2))
    for i in range(len(own)):
        for c in range(4):
            _aim(quads[i], c, legs)
            best = np.full(2, -1)
            total = np.zeros((2, 3))
            u0, v0 = int(np.rint(quads[i, c, 0])), int(np.rint(quads[i, c, 1]))
            for v in range(max(0, v0 - radius[i]), min(h, v0 + radius[i] + 1)):
                for u in range(max(0, u0 - radius[i]), min(w, u0 + radius[i] + 1)):
                    # in the square and beyond it the template is centred on different colours: two peaks, the corner
                    # between them
                    kind = 0 if labels[v, u] == own[i] else 1
                    response = _matches(labels, own[i], u, v, legs, rings[i])
                    if response > best[kind]:
                        best[kind] = response
                        total[kind] = 0.0
                    if response == best[kind]:
                        total[kind, 0] += u
                        total[kind, 1] += v
                        total[kind, 2] += 1.0
            corners[i, c] = quads[i, c]
            score[i, c] = 0.0
            if best[0] >= 0 and best[1] >= 0:
                for axis in range(2):
                    corners[i, c, axis] = 0.5 * (total[0, axis] / total[0, 2] + total[1, axis] / total[1, 2])
                # four legs of that many pixels at each of the two peaks
                score[i, c] = (best[0] + best[1]) / (8.0 * rings[i])
