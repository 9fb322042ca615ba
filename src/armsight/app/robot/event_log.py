"""The log of a robot server: every command and event into a recording, written by a thread of its own."""

from __future__ import annotations

import math
import time
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from armsight.app.robot.recorder import LoopRecorder
from armsight.clock import Clock, SystemClock
from armsight.records import JointReading

NAME = "armsight serve"


class RecordingLog:
    """Keeps events, commands and readings in an MCAP file; never waits for the disk. t_s is on clock, the loop's.

    What the loop did arrives a moment after what the server did meanwhile. It is kept in the order of arrival; given_s
    of a command and the text of an event say when it really was.
    """

    def __init__(self, path: Path, *, clock: Clock | None = None) -> None:
        """Raises UsageError where the file is there already."""
        self._recorder = LoopRecorder(path, clock or SystemClock())
        self._event_s = self._command_s = -math.inf

    @property
    def dropped(self) -> int:
        """How many commands and readings found no room, because disk or processor were too slow."""
        return self._recorder.sink.dropped

    @property
    def failed(self) -> str:
        """Why the disk takes no more; empty while it does."""
        return "" if self._recorder.failed is None else str(self._recorder.failed)

    def __enter__(self) -> Self:
        self._recorder.__enter__()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._recorder.__exit__(kind, error, trace)

    def event(self, t_s: float, level: str, message: str) -> None:
        """Keep something that happened; level: info, warning or error."""
        self._event_s = max(self._event_s, t_s)  # a recording takes a channel's records in the order of time only
        told = message if t_s == self._event_s else f"{message} ({self._event_s - t_s:.3f} s earlier)"
        self._recorder.sink.event(self._event_s, told, level, NAME)

    def command(self, t_s: float, who: str, kind: str, values: dict[str, Any]) -> None:
        """Keep a command: who gave it, its kind and values."""
        self._command_s = max(self._command_s, t_s)
        self._recorder.sink.command(self._command_s, kind, {"who": who, "given_s": t_s, **values})

    def joints(self, reading: JointReading) -> None:
        """Keep a reading."""
        self._recorder.sink.joints(reading)


def default_log() -> Path:
    """Return a new log's path in the current folder, by the time of day."""
    return Path(time.strftime("serve-%Y%m%d-%H%M%S.mcap"))
