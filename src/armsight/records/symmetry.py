"""The turns that bring a printed board onto itself: what one image of it cannot tell apart."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from armsight.records.target import Target, TargetKind

Index = NDArray[np.intp]


def grid_turns(board: Target) -> dict[int, Index]:
    """Return the quarter turns (0..3, about z) that carry the board's points onto its points, colours aside.

    Each comes with its renumbering: point i of the turned board lies where point turn[i] was.
    """
    grid = board.xyz_m[:, :2] / board.pitch_m
    halves = np.rint(2.0 * grid - grid.min(axis=0) - grid.max(axis=0)).astype(np.intp)  # centred, in half steps
    order = np.lexsort(halves.T)
    turned = halves
    found: dict[int, Index] = {}
    for quarter in range(4):
        order_turned = np.lexsort(turned.T)
        if (turned[order_turned] == halves[order]).all():
            turn = np.empty(len(order), dtype=np.intp)
            turn[order_turned] = order
            found[quarter] = turn
        turned = np.stack([-turned[:, 1], turned[:, 0]], axis=1)
    return found


def symmetries(board: Target) -> tuple[Index, ...]:
    """Return the renumberings that leave the print unchanged, the identity first.

    A checkerboard's colours count: a 9x6 board (inner corners) has only the identity, an 8x6 one may be
    half a turn off without a trace. Markers and tags have names and lights are no print: only the identity.
    """
    identity = np.arange(len(board.names), dtype=np.intp)
    if board.kind in (TargetKind.CHARUCO, TargetKind.APRILGRID, TargetKind.SPOTS):
        return (identity,)
    turns = grid_turns(board)
    if board.kind is TargetKind.CHECKERBOARD:
        parity = np.rint(board.xyz_m[:, :2].sum(axis=1) / board.pitch_m).astype(int) % 2
        # a quarter turn moves the square beyond a corner to the side, where the colour is the other
        turns = {q: turn for q, turn in turns.items() if ((parity[turn] + q) % 2 == parity).all()}
    return tuple(turns.values())
