"""Which way up a board is seen."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from armsight.records import BoardView, Target
from armsight.records.board import symmetries

Array = NDArray[np.float64]


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
