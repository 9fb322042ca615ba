"""Corners that lie on a grid, but not on that of a checkerboard's squares: there where counts are wrong."""

from __future__ import annotations

import numpy as np

from armsight.arrays import Array, Image
from armsight.errors import BadImage
from armsight.measure.boards.gridmap import GridMap, fit_map
from armsight.measure.boards.kernels.gridmap import off_line
from armsight.records import Target

OFF_LINE = 0.3
"""An outer row or column further than this from where the rest of the board puts it, in squares, is not the board's:
the paper's edge behind half squares is off by half a square."""
ALTERNATE = 0.9
"""Share of neighbouring squares that must differ as black and white do: of boards in photographs all do, of grids laid
across the squares 0.4 to 0.82."""
PLACES_WITHIN = np.array([(0.3, 0.3), (0.3, 0.7), (0.7, 0.3), (0.7, 0.7)])[:, None, None]
"""Where in a square its grey level is read."""


def refuse_miscount(image: Image, board: Target, guess: Array, source: str) -> None:
    """Raise BadImage where corners (n, 2) px are not those of columns x rows neighbouring squares' corners."""
    grid = np.rint(board.xyz_m[:, :2] / board.pitch_m)
    smooth, _ = fit_map(grid, guess)
    if alternating_share(image, board, smooth) < ALTERNATE:
        raise BadImage(
            f"{source}: the grid of {board.columns}x{board.rows} corners that is there has no squares between them",
            consequence="The image is not used",
            cure="Count the inner corners again, or show the whole board, sharp and evenly lit",
        )
    for side, axis, line in outer_lines(board):
        if off_line(grid, guess, axis, line) > OFF_LINE:
            raise too_few(
                f"{source}: the {side} of {board.columns}x{board.rows} inner corners is not where the others put it"
            )


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


def alternating_share(image: Image, board: Target, smooth: GridMap) -> float:
    """Return the share of neighbouring inner squares, read at four places each, whose grey levels differ in turn."""
    c, r = board.columns - 1, board.rows - 1
    square = np.stack(np.meshgrid(np.arange(c), np.arange(r)), axis=-1)  # (r, c, 2)
    level = levels_at(image, smooth((square + PLACES_WITHIN).reshape(-1, 2))).reshape(-1, r, c)
    level *= np.where(square.sum(axis=2) % 2 == 0, 1.0, -1.0)
    across, along = level[:, :, 1:] + level[:, :, :-1], level[:, 1:] + level[:, :-1]
    bright, dark = (
        np.count_nonzero(s > 0.0) + np.count_nonzero(t > 0.0) for s, t in ((across, along), (-across, -along))
    )
    return max(bright, dark) / (across.size + along.size)


def levels_at(image: Image | Array, uv: Array) -> Array:
    """Return the grey levels (n,) at the pixels nearest to uv (n, 2)."""
    at = np.rint(uv).astype(np.intp)
    row, column = at[:, 1].clip(0, image.shape[0] - 1), at[:, 0].clip(0, image.shape[1] - 1)
    return np.asarray(image[row, column], np.float64)
