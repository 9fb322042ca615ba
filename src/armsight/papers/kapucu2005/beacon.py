"""The beacon in an image: a pixel of its colour by bisection, a window about it, the centroid (section 2.2)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from armsight.errors import NotEnoughData

Array = NDArray[np.float64]

WINDOW_PX = 90
"""Side of the window that is searched pixel by pixel (paper, section 2.2)."""

REDDER_BY = 60
"""Levels by which red exceeds green and blue in the beacon's colour; the paper does not print its definition."""

COARSEST_PX = 64
"""First spacing of the pixels that are tried; it is halved until one of the beacon's colour is met."""


def is_red(image: NDArray[np.uint8]) -> NDArray[np.bool_]:
    """Return which pixels of an image (rows, columns, 3), blue first, have the beacon's colour."""
    levels = image.astype(np.int16)
    return np.asarray(levels[..., 2] - np.maximum(levels[..., 0], levels[..., 1]) > REDDER_BY)


def beacon_centroid(image: NDArray[np.uint8]) -> Array:
    """Return the mean place (2,) in px, u then v, of the red pixels in the window about the first one met.

    Raises NotEnoughData where no pixel is red.
    """
    red = is_red(image)
    row, column = _first_met(red)
    half = WINDOW_PX // 2
    top, left = max(row - half, 0), max(column - half, 0)
    rows, columns = np.nonzero(red[top : row + half, left : column + half])
    return np.array([left + columns.mean(), top + rows.mean()])


def _first_met(red: NDArray[np.bool_]) -> tuple[int, int]:
    spacing = COARSEST_PX
    while spacing >= 1:
        rows, columns = np.nonzero(red[::spacing, ::spacing])
        if len(rows):
            return int(rows[0]) * spacing, int(columns[0]) * spacing
        spacing //= 2
    raise NotEnoughData(
        "no pixel of the image is red",
        consequence="The beacon has no place in it",
        cure="Look at the frames: the beacon must shine red in both views",
    )
