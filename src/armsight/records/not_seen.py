"""That a board, a target or its lights were not seen, and why."""

from __future__ import annotations

from dataclasses import dataclass

from armsight.errors import Unseen


@dataclass(frozen=True, slots=True)
class NotSeen:
    """What stands in the place of a view that there is none of: why, in words for people, and the cause for code.

    size: larger and smaller count of the points of the board that is seen instead, where one is.
    """

    why: str
    cause: Unseen = Unseen.OTHER
    size: tuple[int, int] | None = None
