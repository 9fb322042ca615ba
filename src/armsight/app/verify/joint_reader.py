"""The joints of a running robot, read once a cycle in a thread of their own."""

from __future__ import annotations

import threading
from types import TracebackType
from typing import Self

from armsight.clock import Clock
from armsight.drivers import Robot
from armsight.errors import DeviceFailed
from armsight.records import JointReading
from armsight.records.joint_history import JointHistory

JOIN_S = 2.0
"""How long the end of the thread is waited for."""


class JointReader:
    """Keeps the readings of an open robot; as a context manager it reads them in a thread.

    Where reading fails, `why` says so until it succeeds again: a link may come back.
    """

    def __init__(self, robot: Robot, clock: Clock) -> None:
        self._robot = robot
        self._clock = clock
        self.history = JointHistory(robot.cycle_s)
        self.why = ""
        self._new: list[JointReading] = []
        self._lock = threading.Lock()
        self._ending = threading.Event()
        self._thread: threading.Thread | None = None

    def poll(self) -> None:
        """Read once."""
        try:
            reading = self._robot.read()
        except DeviceFailed as error:
            self.why = error.cause
            return
        self.why = ""
        if self.history.add(reading):
            with self._lock:
                self._new.append(reading)

    def take(self) -> list[JointReading]:
        """Return the readings since the last call."""
        with self._lock:
            new, self._new = self._new, []
        return new

    def __enter__(self) -> Self:
        self._ending.clear()
        self._thread = threading.Thread(target=self._run, name=f"joints of {self._robot.name}", daemon=True)
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._ending.set()
        if self._thread is not None:
            self._thread.join(timeout=JOIN_S)
        self._thread = None

    def _run(self) -> None:
        while not self._ending.is_set():
            self.poll()
            self._ending.wait(self._robot.cycle_s)
