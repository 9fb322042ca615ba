"""Kapucu and Baysec (2005) as printed, with MATH 4.1's corrections: all triples, Chauvenet's criterion, means."""

from __future__ import annotations

from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from armsight.fitting.chauvenet import chauvenet

Array = NDArray[np.float64]


def triple_circle(xyz_m: Array, order: Array) -> tuple[Array, Array, float]:
    """Return centre, axis and radius as the means over all combinations of three points (MATH 4.1)."""
    P = xyz_m[np.argsort(order)]
    i = np.array(list(combinations(range(len(P)), 3)))
    a, b = P[i[:, 1]] - P[i[:, 0]], P[i[:, 2]] - P[i[:, 0]]
    n = np.cross(a, b)
    size = np.linalg.norm(n, axis=1)
    good = size > 1e-12 * np.linalg.norm(a, axis=1) * np.linalg.norm(b, axis=1)
    a, b, n, size, first = a[good], b[good], n[good], size[good], P[i[good, 0]]
    aa, bb = (a * a).sum(axis=1)[:, None], (b * b).sum(axis=1)[:, None]
    centres = first + (aa * np.cross(b, n) + bb * np.cross(n, a)) / (2.0 * size[:, None] ** 2)
    radii = np.linalg.norm(centres - first, axis=1)
    axes = n / size[:, None]
    kept = chauvenet(np.column_stack([centres, radii]))
    axis = axes[kept].mean(axis=0)
    return centres[kept].mean(axis=0), axis / np.linalg.norm(axis), float(radii[kept].mean())


def pair_line(xyz_m: Array, order: Array) -> tuple[Array, Array]:
    """Return a point and the direction of the line as the means over all pairs of points."""
    P = xyz_m[np.argsort(order)]
    i = np.array(list(combinations(range(len(P)), 2)))
    d = P[i[:, 1]] - P[i[:, 0]]
    directions = d / np.linalg.norm(d, axis=1)[:, None]
    mean = directions[chauvenet(directions)].mean(axis=0)
    return P.mean(axis=0), mean / np.linalg.norm(mean)
