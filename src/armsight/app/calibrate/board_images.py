"""Find a board in many frames at once."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from typing import TypeVar

from armsight.drivers import ordered_map
from armsight.errors import BadImage
from armsight.measure.boards import find_board
from armsight.records import BoardView, Frame, NotSeen, Target

Seen = BoardView | NotSeen
"""The view, or why there is none."""

Item = TypeVar("Item")
Found = TypeVar("Found")


def see_board(frame: Frame, board: Target, detector: str = "auto") -> Seen:
    """Return what is seen of the board in one frame, or the reason why it is not."""
    try:
        return find_board(frame.image, board, source=frame.source, detector=detector)
    except BadImage as error:
        return NotSeen(error.cause.removeprefix(f"{frame.source}: "), error.unseen)


def in_parallel(
    function: Callable[[Item], Found], items: Iterable[Item], *, workers: int | None = None
) -> Iterator[Found]:
    """Yield function(item) in order, on all cores: OpenCV's detectors run without the interpreter's lock."""
    return ordered_map(function, items, workers=workers)
