"""What a servo is asked to do, and the clock of one that runs step by step beside a simulation."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Protocol

from armsight.clock import Clock, ManualClock
from armsight.drivers import PairSource, Robot
from armsight.records import Frame

Pair = tuple[Frame, Frame]


class SteppedPairs(Protocol):
    """Cameras of a simulated cell: pairs by their number."""

    fps: float
    latency_s: float
    origin_s: float

    def pair(self, index: int) -> Pair:
        """Return the pair exposed index / fps after the opening."""
        ...


class SteppedClock(ManualClock):
    """A clock that jumps to the moment waited for, and on the way there to every frame's arrival.

    So a loop and its cameras run in one thread, in the order in which they would by real time, however long it takes
    to draw a frame; nothing is ever late.
    """

    def __init__(self, t_s: float = 0.0) -> None:
        super().__init__(t_s)
        self._pairs: SteppedPairs | None = None
        self._take: Callable[[Pair], None] | None = None
        self._index = 0

    def watch(self, pairs: SteppedPairs, take: Callable[[Pair], None]) -> None:
        """Give the pairs that arrive from now on to take, each at its time of arrival."""
        passed_s = self.now_s() - pairs.origin_s - pairs.latency_s
        self._index = max(1, int(passed_s * pairs.fps + 1e-9) + 1)
        self._pairs, self._take = pairs, take

    def sleep_until(self, t_s: float) -> None:
        """Jump to t_s where that lies ahead, by way of all arrivals until then."""
        for arrival_s, pair in self._arrivals(t_s):
            super().sleep_until(arrival_s)
            if self._take is not None:
                self._take(pair())
        super().sleep_until(t_s)

    def _arrivals(self, t_s: float) -> Iterator[tuple[float, Callable[[], Pair]]]:
        """Yield the times of arrival until t_s, and what makes the pair, which is exposed before."""
        pairs = self._pairs
        while pairs is not None:
            index = self._index
            arrival_s = pairs.origin_s + index / pairs.fps + pairs.latency_s
            if arrival_s > t_s:
                return
            self._index = index + 1
            yield arrival_s, lambda index=index, pairs=pairs: pairs.pair(index)  # type: ignore[misc]  # bound now


CAMERA, TOOL = "camera", "tool"


@dataclass(frozen=True, slots=True, kw_only=True)
class ServoDevices:
    """A robot and its cameras, not yet open. overlaid: one image holds both views.

    origin_s: tells the clock's time of the cameras' zero once they are open, None where only arrivals tell it.
    stepped: the clock of a simulated cell, which moves only as far as the loop waits; None: real time.
    """

    robot: Robot
    pairs: PairSource
    clock: Clock
    overlaid: bool = False
    origin_s: Callable[[], float] | None = None
    stepped: SteppedClock | None = None
