"""From the control loop to the recording: a queue that never makes the loop wait."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol

from armsight.records import JointReading, TargetPose

LONGEST = 65_536
"""Records that wait at most: four minutes of two a cycle of 8 ms."""


class EventSink(Protocol):
    """Takes what the loop does; no method blocks, writes to a disk or raises."""

    def event(self, t_s: float, message: str, level: str, name: str) -> None:
        """Take a state change or a fault; level: info, warning or error."""
        ...

    def command(self, t_s: float, kind: str, values: Mapping[str, Any]) -> None:
        """Take what was sent to the robot."""
        ...

    def joints(self, reading: JointReading) -> None:
        """Take a reading."""
        ...


class NoSink:
    """Forgets everything."""

    def event(self, t_s: float, message: str, level: str, name: str) -> None:
        """Forget it."""

    def command(self, t_s: float, kind: str, values: Mapping[str, Any]) -> None:
        """Forget it."""

    def joints(self, reading: JointReading) -> None:
        """Forget it."""


@dataclass(frozen=True, slots=True)
class Queued:
    """One record that waits: the method of the recording's writer that takes it, and its arguments."""

    method: str
    args: tuple[Any, ...]
    options: Mapping[str, Any] = field(default_factory=dict)


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
            self._items.append(Queued("event", (t_s, message), {"level": level, "name": name}))

    def command(self, t_s: float, kind: str, values: Mapping[str, Any]) -> None:
        """Queue it, or drop it where the queue is full."""
        self._put(Queued("command", (t_s, kind, values)))

    def joints(self, reading: JointReading) -> None:
        """Queue it, or drop it where the queue is full."""
        self._put(Queued("joints", (reading,)))

    def pose(self, pose: TargetPose) -> None:
        """Queue a pose of the target, from the thread that measures, or drop it where the queue is full."""
        self._put(Queued("pose", (pose,)))

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
