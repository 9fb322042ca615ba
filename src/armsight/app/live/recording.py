"""The recording of a measuring process: one thread begins, feeds and ends it, another tells how far it is."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from armsight.app.record.recorder import Recorder
from armsight.clock import Clock
from armsight.errors import ArmsightError
from armsight.records import Frame
from armsight.store.atomic import disk_errors
from armsight.store.recording import ImageFormat, RecordingWriter


@dataclass(frozen=True, slots=True, kw_only=True)
class RecordingState:
    """file: being written, None where nothing is; n_pairs: in it; failure: why the last one ended, empty if well."""

    file: Path | None = None
    n_pairs: int = 0
    n_dropped: int = 0
    failure: str = ""


class LiveRecording:
    """At most one file at a time. That it has ended is told once it is whole, and nothing of it is told after that."""

    def __init__(self, notify: Callable[[RecordingState], None], clock: Clock) -> None:
        self._notify, self._clock = notify, clock
        self._order = threading.Lock()
        self._open: tuple[Path, Recorder] | None = None

    def begin(self, file: Path) -> None:
        """End what is open and write all pairs into a new .mcap; where that cannot be, tell why."""
        self.end()
        try:
            with disk_errors(file):
                file.parent.mkdir(parents=True, exist_ok=True)
            writer = RecordingWriter(file, clock=self._clock)
            self._open = file, Recorder(writer, ImageFormat.PNG, live=True).__enter__()
        except ArmsightError as error:
            self._notify(RecordingState(failure=str(error)))
        self.notify()

    def put(self, left: Frame, right: Frame | None) -> None:
        """Take a pair where a file is open; a disk that fails ends it."""
        if self._open is None:
            return
        try:
            self._open[1].put(left, right)
        except ArmsightError as error:
            self.end(str(error))

    def end(self, failure: str = "") -> None:
        """Write what waits and close the file, if any; then tell that it has ended, and why where it failed."""
        if self._open is None:
            return
        try:
            self._open[1].close()
        except ArmsightError as error:
            failure = failure or str(error)
        with self._order:
            self._open = None
            self._notify(RecordingState(failure=failure))

    def notify(self) -> None:
        """Tell how far it is; any thread may call this."""
        with self._order:
            if self._open is not None:
                file, recorder = self._open
                self._notify(RecordingState(file=file, n_pairs=recorder.written, n_dropped=recorder.dropped))
