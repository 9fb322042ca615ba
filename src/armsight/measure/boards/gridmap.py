"""The smooth map from a board's grid to the image, and which way up a board is seen.

The map is a homography and, on top, the lens as a cubic polynomial.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from armsight.records import BoardView, Target
from armsight.records.board import symmetries

Array = NDArray[np.float64]

POINTS_FOR_CUBIC = 24
"""A cubic has ten coefficients a coordinate; with fewer points than this it would follow single corners."""
FAR = 4.0
"""Points further from the map than this many robust standard deviations do not shape it."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class GridMap:
    """H (3, 3) and the cubic's coefficients (10, 2) over grid coordinates centred on `centre` and divided by `half`."""

    H: Array
    cubic: Array
    centre: Array
    half: float

    def __call__(self, grid: Array) -> Array:
        """Return the pixels (n, 2) of grid coordinates (n, 2)."""
        g = (np.asarray(grid, float) - self.centre) / self.half
        h = np.column_stack([g, np.ones(len(g))]) @ self.H.T
        return np.asarray(h[:, :2] / h[:, 2:] + monomials(g) @ self.cubic)

    def derivatives(self, grid: Array) -> tuple[Array, Array]:
        """Return the image steps of one square (n, 2, 2; columns: along x, y) and second derivatives (n, 2, 3)."""
        g = (np.asarray(grid, float) - self.centre) / self.half
        x, y = g[:, 0], g[:, 1]
        h = np.column_stack([g, np.ones(len(g))]) @ self.H.T
        w, by_w = h[:, 2:], self.H[2, :2]
        u = h[:, :2] / w
        along = (self.H[:2, :2] - u[:, :, None] * by_w) / w[:, :, None]  # (n, 2, 2) of the homography
        bent = -(along[:, :, [0, 0, 1]] * by_w[[0, 1, 1]] + along[:, :, [0, 1, 1]] * by_w[[0, 0, 1]]) / w[:, :, None]
        none, one = np.zeros(len(g)), np.ones(len(g))
        rows = (  # of the monomials, by x, y, xx, xy and yy
            (none, one, none, 2.0 * x, y, none, 3.0 * x * x, 2.0 * x * y, y * y, none),
            (none, none, one, none, x, 2.0 * y, none, x * x, 2.0 * x * y, 3.0 * y * y),
            (none, none, none, 2.0 * one, none, none, 6.0 * x, 2.0 * y, none, none),
            (none, none, none, none, one, none, none, 2.0 * x, 2.0 * y, none),
            (none, none, none, none, none, 2.0 * one, none, none, 2.0 * x, 6.0 * y),
        )
        lens = np.array(rows).transpose(2, 0, 1) @ self.cubic  # (n, 5, 2)
        first = (along + lens[:, :2].transpose(0, 2, 1)) / self.half
        second = (bent + lens[:, 2:].transpose(0, 2, 1)) / self.half**2
        return first, second


def monomials(g: Array) -> Array:
    """Return all monomials up to the third degree, (n, 10)."""
    x, y = g[:, 0], g[:, 1]
    one = np.ones(len(g))
    return np.stack([one, x, y, x * x, x * y, y * y, x**3, x * x * y, x * y * y, y**3], axis=1)


def fit_map(grid: Array, uv_px: Array) -> tuple[GridMap, Array]:
    """Return the map of grid coordinates (n, 2) to pixels (n, 2), n >= 4, and the distance (n,) of each point from it.

    Gross outliers do not pull it: they are left out, judged by the median distance.
    """
    grid, uv = np.asarray(grid, float), np.asarray(uv_px, float)
    centre = 0.5 * (grid.min(axis=0) + grid.max(axis=0))
    half = max(1.0, 0.5 * float(np.ptp(grid, axis=0).max()))
    use = np.ones(len(grid), bool)
    g = (grid - centre) / half
    H: Array = np.eye(3)
    cubic: Array = np.zeros((10, 2))
    distance: Array = np.full(len(grid), np.inf)
    for _ in range(3):
        found = cv2.findHomography(g[use], uv[use])[0]
        if found is None:  # what is left lies on one line
            break
        H = np.asarray(found, float)
        h = np.column_stack([g, np.ones(len(g))]) @ H.T
        rest = uv - h[:, :2] / h[:, 2:]
        cubic = np.zeros((10, 2))
        if np.count_nonzero(use) >= POINTS_FOR_CUBIC:
            cubic = np.asarray(np.linalg.lstsq(monomials(g[use]), rest[use], rcond=None)[0])
        distance = np.asarray(np.linalg.norm(rest - monomials(g) @ cubic, axis=1))
        limit = FAR * max(1.5 * float(np.median(distance)), 0.05)
        keep = distance <= limit
        if np.count_nonzero(keep) < 0.6 * len(grid) or (keep == use).all():
            break
        use = keep
    return GridMap(H=H, cubic=cubic, centre=centre, half=half), distance


def axis_px(uv: Array, index: NDArray[np.intp], board: Target) -> Array:
    """Return the image direction (2,) of the board's x axis, by a linear fit of pixels on board coordinates."""
    design = np.column_stack([board.xyz_m[index, :2], np.ones(len(index))])
    slope = np.linalg.lstsq(design, uv, rcond=None)[0][0]
    return np.asarray(slope / np.linalg.norm(slope))


def most_upright(numberings: Sequence[Array], board: Target) -> Array:
    """Return that numbering (n, 2) of all the board's points whose x axis points furthest to the image's right."""
    everything = np.arange(len(board.names), dtype=np.intp)
    return max(numberings, key=lambda uv: float(axis_px(uv, everything, board)[0]))


def same_way_up(left: BoardView, right: BoardView, board: Target) -> BoardView:
    """Return the right view, renumbered where the print allows it, so that its x axis points as in the left one.

    A symmetric board looks the same after half a turn (a square one after a quarter), and seen near the
    turning point two cameras may choose differently. Cameras of a pair are taken to be turned against each other
    by less than half of that.
    """
    if len(left) < 3 or len(right) < 3:
        return right
    x_left = axis_px(left.uv_px, left.index, board)
    numberings = [np.argsort(turn)[right.index] for turn in symmetries(board)]
    best = max(numberings, key=lambda index: float(axis_px(right.uv_px, index, board) @ x_left))
    return right if (best == right.index).all() else replace(right, index=best)
