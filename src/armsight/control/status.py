"""The state of a robot and of the loop that moves it, and the queue from it to the recording, which never waits."""

from __future__ import annotations

import re
import threading
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from armsight.control.guard import GuardState
from armsight.drivers import RobotState
from armsight.records import JointReading, TargetPose

HOW_LONG = re.compile(r",? (?:for|last seen) (?:more than )?[\d.e+-]+ m?s\b.*")
"""What differs from cycle to cycle of one reason."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RobotStatus:
    """A robot and its loop in the newest cycle; replaced as one, so that any thread may read it.

    t_s: when it was so, on the loop's clock. cycle: the cycle's number. robot: what its link says. guard: the guard's
    state, and why it does not run, in words. limited: the limits that cut the set point. source: who asks for motion.
    reading: the newest, its time on the same clock; None before the first. q_sent (n,): where the robot was last told
    to go, in rad or m. at_rest: nothing moves any more by command. finished: the source has nothing more to ask.
    enabled: whether the enable was alive. late, missed: cycles that began late, that were left out.

    Where others ask the loop for motion, their side adds what the loop does not know. dropped: how often what was asked
    was forgotten, because it held, stopped or was told to. lapsed: why the enable ended by itself, empty where it did
    not; it counts again once it was let go of. driver, driver_s: who drives, empty for nobody, and
    for how long in s. lateness_p99_s: 99 % of the cycles began at most so late, in s.
    """

    t_s: float
    cycle: int
    robot: RobotState
    guard: GuardState
    why: str = ""
    limited: tuple[str, ...] = ()
    source: str = ""
    reading: JointReading | None
    q_sent: NDArray[np.float64]
    at_rest: bool = True
    finished: bool = False
    enabled: bool = False
    late: int = 0
    missed: int = 0
    dropped: int = 0
    lapsed: str = ""
    driver: str = ""
    driver_s: float = 0.0
    lateness_p99_s: float = 0.0

    @property
    def q(self) -> NDArray[np.float64]:
        """Where the robot is by its newest reading (n,), in rad or m; where it was told to go before the first."""
        return self.q_sent if self.reading is None else self.reading.q

    @property
    def state(self) -> GuardState:
        """The guard's state, by the name that programs of the guide know it by."""
        return self.guard

    @property
    def reason(self) -> str:
        """Why it does not run, without for how long: the same in each cycle."""
        return HOW_LONG.sub("", self.why)


KEPT = 65_536
"""Newest cycles that the figures are of: four minutes at 4 ms. Counts and the largest are of all."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Timing:
    """n_cycles done; late: begun later than the share of a cycle that counts as late; missed: cycles never begun.

    lateness and period: median, 99th percentile and maximum, in s; busy: of the time from wake-up to command sent.
    """

    n_cycles: int
    late: int
    missed: int
    lateness_s: tuple[float, float, float]
    period_s: tuple[float, float, float]
    busy_s: tuple[float, float, float]


class Jitter:
    """Collects the times of a loop's cycles; for the loop's own thread."""

    def __init__(self, late_s: float) -> None:
        self._late_s = late_s
        self._values = np.zeros((3, KEPT))
        self._most = [0.0, 0.0, 0.0]
        self.n_cycles = self.late = self.missed = 0
        self._woke_s: float | None = None

    def cycle(self, woke_s: float, late_s: float, done_s: float, missed: int) -> None:
        """Note a cycle: when it woke and by how much too late, when its command was sent, cycles missed before it."""
        period_s = np.nan if self._woke_s is None else woke_s - self._woke_s
        self._woke_s = woke_s
        at = self.n_cycles % KEPT
        for row, value in enumerate((late_s, period_s, done_s - woke_s)):
            self._values[row, at] = value
            self._most[row] = max(self._most[row], value) if value == value else self._most[row]
        self.n_cycles += 1
        self.late += late_s > self._late_s
        self.missed += missed

    def timing(self) -> Timing:
        """Return the figures so far."""
        rows = self._values[:, : min(self.n_cycles, KEPT)]
        lateness, period, busy = (
            _figures(row[np.isfinite(row)], most) for row, most in zip(rows, self._most, strict=True)
        )
        return Timing(
            n_cycles=self.n_cycles,
            late=self.late,
            missed=self.missed,
            lateness_s=lateness,
            period_s=period,
            busy_s=busy,
        )


def _figures(values: NDArray[np.float64], most: float) -> tuple[float, float, float]:
    if not len(values):
        return 0.0, 0.0, most
    return float(np.median(values)), float(np.percentile(values, 99.0)), most


LONGEST = 65_536
"""Records that wait at most: four minutes of two a cycle of 8 ms."""


class EventSink(Protocol):
    """Takes what the loop does; no method blocks, writes to a disk or raises."""

    def event(self, t_s: float, message: str, level: str, name: str) -> None:
        """Take a state change or a fault; level: info, warning or error."""

    def command(self, t_s: float, kind: str, values: Mapping[str, Any]) -> None:
        """Take what was sent to the robot."""

    def joints(self, reading: JointReading) -> None:
        """Take a reading."""


class NoSink:
    """Forgets everything."""

    def event(self, t_s: float, message: str, level: str, name: str) -> None:
        """Forget it."""

    def command(self, t_s: float, kind: str, values: Mapping[str, Any]) -> None:
        """Forget it."""

    def joints(self, reading: JointReading) -> None:
        """Forget it."""


Queued = tuple[str, tuple[Any, ...]]
"""One record that waits: the method of the recording's writer that takes it, and its arguments."""


class QueueSink:
    """A bounded queue between the loop and the thread that writes.

    Where nobody empties it, commands and readings are dropped and counted; events are kept: they are few, and the
    ones a recording is made for.
    """

    def __init__(self, longest: int = LONGEST) -> None:
        self._longest = longest
        self._items: deque[Queued] = deque()
        self._lock = threading.Lock()
        self.dropped = 0

    def event(self, t_s: float, message: str, level: str, name: str) -> None:
        """Queue it."""
        with self._lock:
            self._items.append(("event", (t_s, message, level, name)))

    def command(self, t_s: float, kind: str, values: Mapping[str, Any]) -> None:
        """Queue it, or drop it where the queue is full."""
        self._put(("command", (t_s, kind, values)))

    def joints(self, reading: JointReading) -> None:
        """Queue it, or drop it where the queue is full."""
        self._put(("joints", (reading,)))

    def pose(self, pose: TargetPose) -> None:
        """Queue a pose of the target, from the thread that measures, or drop it where the queue is full."""
        self._put(("pose", (pose,)))

    def drain(self) -> list[Queued]:
        """Return what waits, oldest first, and forget it; for the thread that writes."""
        with self._lock:
            items, self._items = self._items, deque()
        return list(items)

    def _put(self, item: Queued) -> None:
        with self._lock:
            if len(self._items) < self._longest:
                self._items.append(item)
            else:
                self.dropped += 1
