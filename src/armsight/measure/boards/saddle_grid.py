"""Checkerboards at a glance: saddles of a small copy of the image, linked along their edges into a grid.

A grid is only given where it is whole and can lie in one way: what else there is to know needs the thorough detectors.
"""

from __future__ import annotations

import cv2
import numpy as np

from armsight.arrays import Array, Image, Index
from armsight.measure.boards.kernels.saddles import STEP, grow_grids, saddle_corners, saddle_pixels, saddles_near

SMALLEST_SIDE_PX = 100
"""The shorter side of the smallest copy that is looked at: a board's squares are then of five pixels and more."""
LARGEST_WIDTH_PX = 1300
"""Larger copies are not looked at: there the thorough detectors are asked."""
BLUR_PX = 1.0
"""Of the Gaussian that takes the pixels' noise, in pixels of the copy."""
LEAST_RESPONSE = 400
"""Of a saddle, in squared grey levels: of an edge of some ten of them."""
MOST_PLACES = 20_000
MOST_CORNERS = 700
"""Strongest saddles that are linked: what bounds the time in pictures of gravel, text and noise."""
GOES_ON = 0.5
"""A line next to the board of which this share is there may be one more of the board's: it is not known which are."""


def grid_at_a_glance(image: Image, columns: int, rows: int) -> Array | None:
    """Return the corners (n, 2), row by row, of a whole grid in the smallest copy that shows one, to a part of a px."""
    copies = [image]
    while min(copies[-1].shape) >= 2 * SMALLEST_SIDE_PX:
        copies.append(shrunk(copies[-1], 2))
    for power, copy in reversed(list(enumerate(copies))):
        uv = _complete_grid(_calmed(copy), columns, rows) if copy.shape[1] <= LARGEST_WIDTH_PX else None
        if uv is not None:
            return uv if power == 0 else _sharpened(image, (uv + 0.5) * 2**power - 0.5, 2**power)
    return None


def _calmed(image: Image) -> Image:
    """Return the image without the noise of its pixels."""
    return np.asarray(cv2.GaussianBlur(image, (5, 5), BLUR_PX), dtype=np.uint8)


def _sharpened(image: Image, uv: Array, reach: int) -> Array:
    """Return corners (n, 2), known to so many px, as the saddles of the image itself."""
    margin = reach + 2 * STEP
    low = np.maximum(uv.min(axis=0).astype(np.intp) - margin, 0)
    high = uv.max(axis=0).astype(np.intp) + margin + 2
    return np.asarray(saddles_near(_calmed(image[low[1] : high[1], low[0] : high[0]]), uv - low, reach) + low)


def shrunk(image: Image, factor: int) -> Image:
    """Return the image made smaller by a whole factor, grey levels averaged."""
    small = cv2.resize(image, None, fx=1 / factor, fy=1 / factor, interpolation=cv2.INTER_AREA)
    return np.asarray(small, dtype=np.uint8)


def _complete_grid(calm: Image, columns: int, rows: int) -> Array | None:
    """Return the one whole grid of this size in an image without noise, or None."""
    pixels, strength = saddle_pixels(calm, LEAST_RESPONSE, MOST_PLACES)
    corners = saddle_corners(calm, pixels)
    if len(corners) > MOST_CORNERS:
        strongest = np.argpartition(-strength, MOST_CORNERS)[:MOST_CORNERS]
        corners = saddle_corners(calm, np.ascontiguousarray(pixels[strongest]))
    if len(corners) < columns * rows:
        return None
    grid, node = grow_grids(corners)
    count = np.bincount(grid[grid >= 0])
    found = [
        uv
        for one in np.flatnonzero(count >= columns * rows)
        for uv in [_window(node[grid == one], corners[grid == one, :2], columns, rows)]
        if uv is not None
    ]
    return found[0] if len(found) == 1 else None


def _window(node: Index, uv: Array, columns: int, rows: int) -> Array | None:
    """Return the corners (columns * rows, 2) of the one part of a grid, places (n, 2) of pixels (n, 2), of this size.

    None where a part of it is missing, it may lie in several ways, or it goes on beyond.
    """
    at = node - node.min(axis=0) + 1
    table = np.full(at.max(axis=0) + 2, -1)
    table[at[:, 0], at[:, 1]] = np.arange(len(at))
    if np.count_nonzero(table >= 0) < len(at):  # two corners in one place
        return None
    found = []
    for turned in (table,) if columns == rows else (table, table.T):
        if turned.shape[0] < columns + 2 or turned.shape[1] < rows + 2:
            continue
        total = (turned >= 0).cumsum(axis=0).cumsum(axis=1)  # its first row and column are empty
        held = total[columns:, rows:] - total[:-columns, rows:] - total[columns:, :-rows] + total[:-columns, :-rows]
        found += [(turned, int(i) + 1, int(j) + 1) for i, j in np.argwhere(held == columns * rows)]
    if len(found) != 1:
        return None
    turned, i, j = found[0]
    around = turned[i - 1 : i + columns + 1, j - 1 : j + rows + 1] >= 0
    for side in (around[0, 1:-1], around[-1, 1:-1], around[1:-1, 0], around[1:-1, -1]):
        if np.count_nonzero(side) >= GOES_ON * len(side):
            return None
    return uv[turned[i : i + columns, j : j + rows].T.ravel()]
