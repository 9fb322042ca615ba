"""The clock of a simulated cell: a loop and its cameras in one thread, however long a picture takes to draw."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Protocol

from armsight.clock import ManualClock
from armsight.drivers import Views


class SteppedMoments(Protocol):
    """Cameras of a simulated cell: moments by their number."""

    fps: float
    latency_s: float
    origin_s: float

    def moment(self, index: int) -> Views:
        """Return the moment exposed index / fps after the opening."""
        ...


class SteppedClock(ManualClock):
    """A clock that jumps to the moment waited for, and on the way there to every frame's arrival.

    So a loop and its cameras run in one thread, in the order in which they would by real time, however long it takes
    to draw a frame; nothing is ever late.
    """

    def __init__(self, t_s: float = 0.0) -> None:
        super().__init__(t_s)
        self._moments: SteppedMoments | None = None
        self._take: Callable[[Views], None] | None = None
        self._index = 0

    def watch(self, moments: SteppedMoments, take: Callable[[Views], None]) -> None:
        """Give the moments that arrive from now on to take, each at its time of arrival."""
        passed_s = self.now_s() - moments.origin_s - moments.latency_s
        self._index = max(1, int(passed_s * moments.fps + 1e-9) + 1)
        self._moments, self._take = moments, take

    def sleep_until(self, t_s: float) -> None:
        """Jump to t_s where that lies ahead, by way of all arrivals until then."""
        for arrival_s, moment in self._arrivals(t_s):
            super().sleep_until(arrival_s)
            if self._take is not None:
                self._take(moment())
        super().sleep_until(t_s)

    def _arrivals(self, t_s: float) -> Iterator[tuple[float, Callable[[], Views]]]:
        """Yield the times of arrival until t_s, and what makes the moment, which is exposed before."""
        moments = self._moments
        while moments is not None:
            index = self._index
            arrival_s = moments.origin_s + index / moments.fps + moments.latency_s
            if arrival_s > t_s:
                return
            self._index = index + 1
            yield arrival_s, lambda index=index, moments=moments: moments.moment(index)  # type: ignore[misc]  # bound now
