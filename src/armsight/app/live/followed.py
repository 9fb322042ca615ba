"""The cameras of a simulated cell whose robot is moved by the loop of another process."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from types import TracebackType
from typing import Any, Self

from armsight.app.simulate.scenarios import live_cell
from armsight.clock import Clock
from armsight.control.session.channels import JointTrack
from armsight.drivers import Skew
from armsight.records import Frame

ROOM = "plain"
"""What stands behind a target that is led about: before a workshop's hundreds of bright things three lights seen askew
cannot always be told, and a person would mask them."""


@dataclass(frozen=True, slots=True)
class FollowedCell:
    """scenario: its name or file. track: where the loop's process says the joints are, on the machine's clock."""

    scenario: str
    track: JointTrack
    room: str = ROOM


class FollowedPairs:
    """What the cell's cameras see of an arm that stands where the track says; frames are stamped with the clock."""

    skew: Skew | None = None
    total: int | None = None

    def __init__(self, cell: FollowedCell, clock: Clock) -> None:
        """Open nothing yet. Raises DeviceNotFound, BadFile, Inconsistent for the scenario."""
        self._cell: Any = live_cell(cell.scenario, clock, room=cell.room)
        self._cell.robot.follow(cell.track.at)
        self.name = str(self._cell.pairs.name)

    def __enter__(self) -> Self:
        self._cell.pairs.__enter__()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._cell.pairs.__exit__(kind, error, trace)

    def __iter__(self) -> Iterator[tuple[Frame, Frame]]:
        origin_s = float(self._cell.origin_s)
        for left, right in self._cell.pairs:
            yield replace(left, t_s=origin_s + left.t_s), replace(right, t_s=origin_s + right.t_s)
