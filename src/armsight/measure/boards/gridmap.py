"""The smooth map from a board's grid to the image, and which way up a board is seen.

The map is a homography and, on top, the lens as a cubic polynomial.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from armsight.arrays import Array, Index
from armsight.measure.boards.kernels.gridmap import fit_grid_map, map_derivatives, map_points
from armsight.records import BoardView, Target
from armsight.records.board import symmetries


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class GridMap:
    """H (3, 3) and the cubic's coefficients (10, 2) over grid coordinates centred on `centre` and divided by `half`."""

    H: Array
    cubic: Array
    centre: Array
    half: float

    def __call__(self, grid: Array) -> Array:
        """Return the pixels (n, 2) of grid coordinates (n, 2)."""
        at = np.array(grid, dtype=np.float64, order="C")
        return np.asarray(map_points(self.H, self.cubic, self.centre, self.half, at))

    def derivatives(self, grid: Array) -> tuple[Array, Array]:
        """Return the image steps of one square (n, 2, 2; columns: along x, y) and second derivatives (n, 2, 3)."""
        at = np.array(grid, dtype=np.float64, order="C")
        first, second = map_derivatives(self.H, self.cubic, self.centre, self.half, at)
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
    nodes, uv = (np.array(table, dtype=np.float64, order="C") for table in (grid, uv_px))
    H, cubic, centre, half, distance = fit_grid_map(nodes, uv)
    return GridMap(H=H, cubic=cubic, centre=centre, half=half), distance


def axis_px(uv: Array, index: Index, board: Target) -> Array:
    """Return the image direction (2,) of the board's x axis, by a linear fit of pixels on board coordinates."""
    xy = board.xyz_m[index, :2]
    xy = xy - xy.mean(axis=0)
    slope = np.linalg.lstsq(xy.T @ xy, xy.T @ uv, rcond=None)[0][0]
    return np.asarray(slope / np.linalg.norm(slope))


def most_upright(numberings: Sequence[Array], board: Target) -> Array:
    """Return that numbering (n, 2) of all the board's points whose x axis points furthest to the image's right."""
    if len(numberings) == 1:
        return numberings[0]
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
