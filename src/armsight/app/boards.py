"""Find a board in many frames at once."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from typing import TypeVar

from armsight.drivers import ordered_map
from armsight.errors import BadImage, DataRefused
from armsight.measure.boards import find_board
from armsight.records import BoardView, Frame, Target, TargetKind, board_target

Seen = BoardView | str
"""The view, or why there is none."""

Item = TypeVar("Item")
Found = TypeVar("Found")

SMALLEST_SIDE = 3
"""Inner corners along a side below which nearly anything looks like a board."""


def see_board(frame: Frame, board: Target) -> Seen:
    """Return what is seen of the board in one frame, or the reason why it is not."""
    try:
        return find_board(frame.image, board, source=frame.source)
    except BadImage as error:
        return error.cause.removeprefix(f"{frame.source}: ")


def in_parallel(
    function: Callable[[Item], Found], items: Iterable[Item], *, workers: int | None = None
) -> Iterator[Found]:
    """Yield function(item) in order, on all cores: OpenCV's detectors run without the interpreter's lock."""
    return ordered_map(function, items, workers=workers)


def other_size(frame: Frame, board: Target) -> str:
    """Return 'COLUMNSxROWS' of a checkerboard of another size that is in the frame, or ''."""
    if board.kind is not TargetKind.CHECKERBOARD:
        return ""
    c, r = board.columns, board.rows
    sizes = [(r, c), *((c + dc, r + dr) for dc in (0, -1, 1, -2) for dr in (0, -1, 1, -2) if dc or dr)]
    # larger boards first: a smaller one is found inside a larger one by some detectors
    for columns, rows in sorted(sizes, key=lambda size: -size[0] * size[1]):
        if min(columns, rows) < SMALLEST_SIDE or columns == rows == 0:
            continue
        other = board_target(TargetKind.CHECKERBOARD, columns, rows, board.pitch_m)
        with suppress(DataRefused):
            find_board(frame.image, other, source=frame.source)
            return f"{columns}x{rows}"
    return ""
