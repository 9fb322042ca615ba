"""Corners that lie on a grid, but not on that of the squares: what is found where the counts asked for are wrong."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from armsight.errors import BadImage
from armsight.measure.boards.gridmap import GridMap, fit_map
from armsight.records import Target

Array = NDArray[np.float64]
Image = NDArray[np.uint8]

OFF_LINE = 0.3
"""An outer row or column further than this from where the rest of the board puts it, in squares, is not the board's:
the paper's edge behind half squares is off by half a square."""
ALTERNATE = 0.9
"""Share of neighbouring squares that must differ as black and white do: of boards in photographs all do, of grids laid
across the squares 0.4 to 0.82."""
WITHIN = (0.3, 0.7)
"""Where in a square its grey level is read, along each axis."""


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
    for axis, count in enumerate((board.columns, board.rows)):
        for end, name in ((0, "first"), (count - 1, "last")):
            if off_line(grid, guess, grid[:, axis] == end) > OFF_LINE:
                raise BadImage(
                    f"{source}: the {name} {'row' if axis else 'column'} of {board.columns}x{board.rows} inner corners "
                    f"is not where the others put it",
                    consequence="There may be fewer, and the image is not used",
                    cure="Count the inner corners again",
                )


def off_line(grid: Array, uv_px: Array, line: NDArray[np.bool_]) -> float:
    """Return how far the corners of a line (n,) are from where the map of the others puts them: median, in squares."""
    smooth, _ = fit_map(grid[~line], uv_px[~line])
    square = np.linalg.norm(smooth.derivatives(grid[line])[0], axis=1).min(axis=1)
    return float(np.median(np.linalg.norm(smooth(grid[line]) - uv_px[line], axis=1) / square))


def alternating_share(image: Image, board: Target, smooth: GridMap) -> float:
    """Return the share of neighbouring inner squares, read at four places each, whose grey levels differ in turn."""
    x, y = np.meshgrid(np.arange(board.columns - 1.0), np.arange(board.rows - 1.0))
    steps: list[Array] = []
    for dx in WITHIN:
        for dy in WITHIN:
            at = np.rint(smooth(np.stack([(x + dx).ravel(), (y + dy).ravel()], axis=1))).astype(int)
            column, row = (np.clip(at[:, i], 0, image.shape[1 - i] - 1) for i in range(2))
            level = image[row, column].astype(float).reshape(x.shape) * np.where((x + y) % 2 == 0, 1.0, -1.0)
            steps += [(level[:, 1:] + level[:, :-1]).ravel(), (level[1:] + level[:-1]).ravel()]
    bright_less_dark = np.concatenate(steps)
    return float(max(np.mean(bright_less_dark > 0.0), np.mean(bright_less_dark < 0.0)))
