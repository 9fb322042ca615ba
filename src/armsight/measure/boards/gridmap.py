"""The smooth map from a board's grid to the image, and which way up a board is seen.

The map is a homography and, on top, the lens as a cubic polynomial.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from armsight.arrays import Array, Image, Index
from armsight.errors import BadImage, unused_image
from armsight.measure.boards.kernels.gridmap import (
    fit_grid_map,
    map_derivatives,
    map_points,
    nearest_levels,
    off_line,
)
from armsight.records import BoardView, Target
from armsight.records.views import symmetries


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


# Corners that lie on a grid, but not on that of a checkerboard's squares: there where counts are wrong.

OFF_LINE = 0.3
"""An outer row or column further than this from where the rest of the board puts it, in squares, is not the board's:
the paper's edge behind half squares is off by half a square."""
ALTERNATE = 0.9
"""Share of neighbouring squares that must differ as black and white do: of boards in photographs all do, of grids laid
across the squares 0.4 to 0.82."""
PLACES_WITHIN = np.array([(0.3, 0.3), (0.3, 0.7), (0.7, 0.3), (0.7, 0.7)])[:, None, None]
"""Where in a square its grey level is read."""


def refuse_miscount(image: Image, board: Target, guess: Array, smooth: GridMap, source: str) -> bool:
    """Raise BadImage where corners (n, 2) px are not those of columns x rows neighbouring squares' corners.

    smooth: the map to them. Return whether the first square, between the first four corners, is black.
    """
    grid = np.rint(board.xyz_m[:, :2] / board.pitch_m)
    share, black = alternating_share(image, board, smooth)
    if share < ALTERNATE:
        raise unused_image(
            f"{source}: the grid of {board.columns}x{board.rows} corners that is there has no squares between them",
            cure="Count the inner corners again, or show the whole board, sharp and evenly lit",
        )
    for side, axis, line in outer_lines(board):
        if off_line(grid, np.ascontiguousarray(guess), axis, line) > OFF_LINE:
            raise too_few(
                f"{source}: the {side} of {board.columns}x{board.rows} inner corners is not where the others put it"
            )
    return black


def outer_lines(board: Target) -> list[tuple[str, int, float]]:
    """Return the board's outer rows and columns: name, axis across, and place on it."""
    names = (("first column", "last column"), ("first row", "last row"))
    last = (board.columns - 1.0, board.rows - 1.0)
    return [(names[axis][end], axis, last[axis] * end) for axis in range(2) for end in range(2)]


def too_few(cause: str) -> BadImage:
    """Return the refusal of a board that may have fewer rows or columns than were asked for."""
    return BadImage(
        cause,
        consequence="There may be fewer, and the image is not used",
        cure="Count the inner corners again, and show the whole board without reflections",
    )


def alternating_share(image: Image, board: Target, smooth: GridMap) -> tuple[float, bool]:
    """Return the share of neighbouring inner squares, read at four places each, whose grey levels differ in turn.

    And whether the first is a black one.
    """
    places, sign = _places_in_squares(board.columns - 1, board.rows - 1)
    level = levels_at(image, smooth(places)).reshape(-1, *sign.shape) * sign
    across, along = level[:, :, 1:] + level[:, :, :-1], level[:, 1:] + level[:, :-1]
    bright, dark = (
        np.count_nonzero(s > 0.0) + np.count_nonzero(t > 0.0) for s, t in ((across, along), (-across, -along))
    )
    return float(max(bright, dark) / (across.size + along.size)), bool(dark > bright)


@cache
def _places_in_squares(columns: int, rows: int) -> tuple[Array, Array]:
    """Return where squares are looked at (4 * rows * columns, 2), and +1 and -1 by their colours (rows, columns)."""
    square = np.stack(np.meshgrid(np.arange(columns), np.arange(rows)), axis=-1)
    return (square + PLACES_WITHIN).reshape(-1, 2), np.where(square.sum(axis=2) % 2 == 0, 1.0, -1.0)


def levels_at(image: Image | Array, uv: Array) -> Array:
    """Return the grey levels (n,) at the pixels nearest to uv (n, 2)."""
    return np.asarray(nearest_levels(image, np.ascontiguousarray(uv)))
