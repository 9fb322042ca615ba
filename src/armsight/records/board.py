"""What was seen of a printed board in one image."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from armsight.arrays import Index
from armsight.errors import Inconsistent
from armsight.records.checks import frozen_array
from armsight.records.target import Target, TargetKind


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BoardView:
    """The points of a board found in one image.

    uv_px: (n, 2). index: (n,) position of each in the board's xyz_m; a ChArUco board may be seen in part.
    sigma_px: standard deviation of one coordinate of one point, as the detector believes it. source: the
    image's name. width, height: of the image in px.
    """

    uv_px: NDArray[np.float64]
    index: Index
    sigma_px: float
    width: int
    height: int
    source: str

    def __post_init__(self) -> None:
        index = np.array(self.index, dtype=np.intp)
        object.__setattr__(self, "uv_px", frozen_array("uv_px", self.uv_px, (len(index), 2)))
        if len(set(index.tolist())) != len(index) or (len(index) and index.min() < 0):
            raise Inconsistent(f"{self.source}: a point of the board is named twice")
        index.setflags(write=False)
        object.__setattr__(self, "index", index)
        if not self.sigma_px > 0.0:
            raise Inconsistent(f"{self.source}: a detector without noise ({self.sigma_px} px) is not believed")

    def __len__(self) -> int:
        return len(self.index)


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
