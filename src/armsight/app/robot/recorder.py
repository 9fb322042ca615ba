"""What a control loop does, into a recording: a thread of its own, so that the loop never waits for the disk."""

from __future__ import annotations

import threading
import time
from pathlib import Path
from types import TracebackType
from typing import Self

from armsight.clock import Clock
from armsight.control.events import QueueSink
from armsight.errors import ArmsightError
from armsight.store.recording import RecordingWriter

EVERY_S = 0.1
"""Time between two looks into the queue; what waits is written in chunks anyway."""


class LoopRecorder:
    """Writes what its sink takes into an .mcap file while it is open. `with LoopRecorder(path, clock) as recorder`.

    Leaving it writes the rest. A disk that fails ends the recording, not the loop: `failed` then says why.
    """

    def __init__(self, path: Path, clock: Clock) -> None:
        """Raises UsageError where the file is there already."""
        self.sink = QueueSink()
        self.failed: ArmsightError | None = None
        origin_ns = time.time_ns() - round(1e9 * clock.now_s())
        self._writer = RecordingWriter(path, origin_ns=origin_ns)
        self._end = threading.Event()
        self._thread = threading.Thread(target=self._run, name="loop recorder", daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._end.set()
        self._thread.join()
        self._write()
        self._writer.close()

    def _run(self) -> None:
        while not self._end.wait(EVERY_S):
            self._write()

    def _write(self) -> None:
        items = self.sink.drain()
        if self.failed is not None:
            return
        try:
            for item in items:
                getattr(self._writer, item.method)(*item.args, **item.options)
            self._writer.tick()
        except ArmsightError as error:
            self.failed = error
