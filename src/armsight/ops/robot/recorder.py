"""A loop in a thread of its own, what it does into a recording by another, and a robot server's log in that form."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable
from pathlib import Path
from types import TracebackType
from typing import Any, Self, TypeVar

from armsight.clock import Clock, SystemClock
from armsight.control.status import QueueSink
from armsight.errors import ArmsightError, RecordingFailed, UsageError
from armsight.priority import bound_control, control_first
from armsight.records import JointReading
from armsight.store.recording import RecordingWriter

EVERY_S = 0.1
"""Time between two looks into the queue; what waits is written in chunks anyway."""
SHOW_S = 0.2
"""Time between two calls of show, in s."""

Result = TypeVar("Result")


def run_with_progress(target: Callable[[], Result], show: Callable[[], None]) -> Result:
    """Return what target returns, or raise what it raises; show is called now and then meanwhile, from this thread.

    target goes before all else on the machine where the system allows that. No cycle of a loop within it waits for the
    screen that show writes to.
    """
    results: list[Result] = []
    errors: list[BaseException] = []

    def run() -> None:
        control_first()
        try:
            results.append(target())
        except BaseException as error:  # raised again below, where somebody hears it
            errors.append(error)

    bound_control()
    thread = threading.Thread(target=run, name="control loop")
    thread.start()
    while thread.is_alive():
        thread.join(SHOW_S)
        show()
    if errors:
        raise errors[0]
    return results[0]


def require_new(folder: Path, *names: str) -> Path:
    """Return the path of the first of these recordings in a folder.

    Raises UsageError where one is there: those of a robot's motion are never replaced.
    """
    if any((folder / name).exists() for name in names):
        raise UsageError(
            f"{folder} holds a recording already", consequence="Nothing is moved", cure="Give another folder (-o)"
        )
    return folder / names[0]


class LoopRecorder:
    """Writes what its sink takes into an .mcap file while it is open. `with LoopRecorder(path, clock) as recorder`.

    Leaving it writes the rest. A disk that fails ends the recording, not the loop: `failed` then says why.
    """

    def __init__(self, path: Path, clock: Clock) -> None:
        """Raises UsageError where the file is there already: a robot's motion is never replaced."""
        if path.exists():
            raise UsageError(f"{path} is there already", consequence="Nothing is moved", cure="Choose another name")
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
            for method, args in items:
                getattr(self._writer, method)(*args)
            self._writer.tick()
        except ArmsightError as error:
            self.failed = error


NAME = "armsight serve"


class RecordingLog:
    """Keeps events, commands and readings in an MCAP file; never waits for the disk. t_s is on clock, the loop's.

    What the loop did arrives a moment after what the server did meanwhile. It is kept in the order of arrival; given_s
    of a command and the text of an event say when it really was.
    """

    def __init__(self, path: Path, *, clock: Clock | None = None) -> None:
        """Raises UsageError where the file is there already: a robot's motion is never replaced."""
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
        text = message if t_s == self._event_s else f"{message} ({self._event_s - t_s:.3f} s earlier)"
        self._recorder.sink.event(self._event_s, text, level, NAME)

    def command(self, t_s: float, who: str, kind: str, values: dict[str, Any]) -> None:
        """Keep a command: who gave it, its kind and values."""
        self._command_s = max(self._command_s, t_s)
        self._recorder.sink.command(self._command_s, kind, {"who": who, "given_s": t_s, **values})

    def joints(self, reading: JointReading) -> None:
        """Keep a reading."""
        self._recorder.sink.joints(reading)


def require_recorded(failed: str) -> None:
    """Raise RecordingFailed where the disk took no more, failed in words: told again at the end, by an exit code."""
    if failed:
        raise RecordingFailed(
            f"the recording ended before the robot's session: {failed}",
            consequence="What was done after that is not kept; what was written until then can be read",
            cure="Make room, or name another disk (--log), before the next session",
        )


def default_log() -> Path:
    """Return a new log's path in the current folder, by the time of day."""
    return Path(time.strftime("serve-%Y%m%d-%H%M%S.mcap"))
