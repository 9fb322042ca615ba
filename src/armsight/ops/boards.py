"""Printed boards, to print."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from armsight.fields import Bounds, Doc, Flag
from armsight.ops.action import Input, action
from armsight.ops.flags import BOARD, OUT
from armsight.ops.kinds import READERS
from armsight.units import MM

if TYPE_CHECKING:
    from armsight.store.board_print import BoardPrint

__all__ = ["print_board"]


@action(
    "board",
    writes=True,
    examples=("checkerboard:9x6:0.025 -o board.pdf", "aprilgrid:6x6:0.088:0.3 --paper a0 -o board.svg"),
)
def print_board(
    board: Annotated[Any, Doc(BOARD), Input(f"{READERS}:board", kind=str), Flag(positional=True, metavar="BOARD")],
    out: Annotated[Path, Doc("File to write: .pdf or .svg."), OUT],
    *,
    paper: Annotated[str, Doc("a0 to a5, letter, legal, tabloid, or WIDTHxHEIGHT in mm.")] = "a4",
    dot_m: Annotated[
        float | None,
        Doc("Of circles: diameter of a dot. [default: half of their distance]"),
        Bounds(least=0.1 * MM),
        Flag("--dot", quantity="m"),
    ] = None,
    bigger_first: Annotated[
        bool, Doc("Of circles: make the first dot twice as wide, which tells where x begins.")
    ] = False,
    old_layout: Annotated[bool, Doc("Of ChArUco boards: the layout before OpenCV 4.6.")] = False,
) -> BoardPrint:
    """Write a board to print in true size, with rulers to measure the print by.

    Parameters
    ----------
    board
        A board's text, its file or a Target.
    out
        A .pdf or .svg.

    Raises
    ------
    UsageError
        The board is larger than the paper, or cannot be printed.
    DeviceFailed
        The disk refuses.

    Examples
    --------
    >>> armsight.print_board("checkerboard:9x6:0.025", folder / "board.pdf").size_m[0]
    0.25
    """
    from armsight.store.board_print import print_board as write

    return write(board, out, paper=paper, dot_m=dot_m, bigger_first=bigger_first, old_layout=old_layout)
