"""The log of a robot server: every command and event into a recording, written by a thread of its own."""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Callable
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from armsight.clock import Clock, SystemClock
from armsight.errors import ArmsightError
from armsight.records import JointReading
from armsight.store.recording import RecordingWriter

WAITING = 20_000
"""Records that may wait for the disk: a minute of a 4 ms loop with its commands."""

TICK_S = 0.2


class RecordingLog:
    """Keeps events, commands and readings in an MCAP file; never waits for the disk, and counts what it had to drop.

    t_s of all that is kept is on clock, the loop's. failed: why the disk refused, empty while it takes everything;
    what comes after that is dropped.
    """

    def __init__(self, path: Path, *, clock: Clock | None = None, overwrite: bool = False) -> None:
        self._path = path
        self._clock = clock or SystemClock()
        self._overwrite = overwrite
        self._queue: queue.Queue[Callable[[RecordingWriter], None] | None] = queue.Queue(WAITING)
        self._thread: threading.Thread | None = None
        self.dropped = 0
        self.failed = ""

    def __enter__(self) -> Self:
        origin_ns = time.time_ns() - round(self._clock.now_s() * 1e9)
        writer = RecordingWriter(self._path, origin_ns=origin_ns, overwrite=self._overwrite)
        self._thread = threading.Thread(target=self._write, args=(writer,), name="armsight-log")
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._thread is not None:
            self._queue.put(None)
            self._thread.join()
        self._thread = None

    def event(self, t_s: float, level: str, message: str) -> None:
        """Keep something that happened; level: info, warning or error."""
        self._add(lambda writer: writer.event(t_s, message, level=level, name="armsight serve"))

    def command(self, t_s: float, who: str, kind: str, values: dict[str, Any]) -> None:
        """Keep a command: who gave it, its kind and values."""
        self._add(lambda writer: writer.command(t_s, kind, {"who": who, **values}))

    def joints(self, reading: JointReading) -> None:
        """Keep a reading."""
        self._add(lambda writer: writer.joints(reading))

    def _add(self, record: Callable[[RecordingWriter], None]) -> None:
        try:
            self._queue.put_nowait(record)
        except queue.Full:
            self.dropped += 1

    def _write(self, writer: RecordingWriter) -> None:
        with writer:
            while True:
                try:
                    record = self._queue.get(timeout=TICK_S)
                except queue.Empty:
                    record = RecordingWriter.tick
                if record is None:
                    return
                self._keep(writer, record)

    def _keep(self, writer: RecordingWriter, record: Callable[[RecordingWriter], None]) -> None:
        if self.failed:
            self.dropped += record is not RecordingWriter.tick
            return
        try:
            record(writer)
        except ArmsightError as error:
            self.failed = str(error)


def default_log() -> Path:
    """Return a new log's path in the current folder, by the time of day."""
    return Path(time.strftime("serve-%Y%m%d-%H%M%S.mcap"))
