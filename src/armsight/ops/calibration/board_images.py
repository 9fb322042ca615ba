"""Find a board in many frames at once."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Protocol, TypeVar

from armsight.drivers import Ahead
from armsight.errors import BadImage, Inconsistent
from armsight.measure.boards import find_board, find_two_boards
from armsight.records import BoardView, Frame, NotSeen, Target, TargetKind

_COUNTED = {
    TargetKind.CHECKERBOARD: "inner corners, where four squares meet (a board of 10x7 squares has 9x6)",
    TargetKind.CIRCLES: "circles",
    TargetKind.ACIRCLES: "circles of a column and of a row",
    TargetKind.CHARUCO: "squares (not the inner corners), and check the name of the markers' dictionary",
    TargetKind.APRILGRID: "tags",
}
"""What columns and rows of a board are counts of."""


def count_again(board: Target) -> str:
    """Return what to do where no image shows the board."""
    return f"Count the board's {_COUNTED[board.kind]}, and check that it is sharp and well lit in the images"


Seen = BoardView | NotSeen
"""The view, or why there is none."""

Item = TypeVar("Item")
Found = TypeVar("Found")


class Keeper(Protocol):
    """What keeps the images in which the board was found."""

    def keep(self, frame: Frame) -> None:
        """Keep the image of a frame; several threads may ask at once."""


def see_board(frame: Frame, board: Target, detector: str = "auto", pictures: Keeper | None = None) -> Seen:
    """Return what is seen of the board in one frame, or the reason why it is not; pictures: keeps where it is."""
    if frame.unreadable:
        return NotSeen(frame.unreadable)
    try:
        view = find_board(frame.image, board, source=frame.source, detector=detector)
    except BadImage as error:
        return NotSeen(error.cause.removeprefix(f"{frame.source}: "), error.unseen, error.size)
    if pictures is not None:
        pictures.keep(frame)
    return view


def see_two_boards(frame: Frame, board: Target, pictures: Keeper) -> tuple[BoardView, BoardView] | NotSeen:
    """Return the board in both views of a complex image, or why it is not in both; pictures: keeps where it is."""
    try:
        both = find_two_boards(frame.image, board, source=frame.source)
    except BadImage as error:
        return NotSeen(error.cause.removeprefix(f"{frame.source}: "), error.unseen)
    pictures.keep(frame)
    return both


def require_counts(seen: Sequence[Seen], board: Target, text: str) -> None:
    """Raise Inconsistent where more images show a board of one other size than show this one; text: as it was asked."""
    n_views = sum(isinstance(one, BoardView) for one in seen)
    sizes = Counter(one.size for one in seen if isinstance(one, NotSeen) and one.size is not None)
    if not sizes:
        return
    (size, count), *_ = sizes.most_common(1)
    if count <= n_views:
        return
    counted = _COUNTED[board.kind].split(" (")[0].split(",")[0]
    right = text.replace(f"{board.columns}x{board.rows}", f"{size[0]}x{size[1]}", 1)
    raise Inconsistent(
        f"a board of {size[0]}x{size[1]} {counted} is seen in {count} of {len(seen)} images, "
        f"and one of {board.columns}x{board.rows} in {n_views}",
        consequence="Nothing was calibrated: part of a larger board may have been taken for the board",
        cure=f"Count the {counted} again; perhaps --board {right} is meant",
    )


def in_parallel(
    function: Callable[[Item], Found], items: Iterable[Item], *, workers: int | None = None
) -> Iterator[Found]:
    """Yield function(item) in order, on all cores: OpenCV's detectors run without the interpreter's lock."""
    return Ahead(function, items, workers=workers)
