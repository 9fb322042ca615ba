"""Moments of frames from a camera's thread to the disk: compressed in threads, written in order, memory bounded."""

from __future__ import annotations

import math
import os
import sys
import threading
from collections import deque
from collections.abc import Callable, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Self

from armsight.clock import Clock, SystemClock
from armsight.drivers import cores
from armsight.errors import ArmsightError
from armsight.optics import SIDES
from armsight.records import Frame
from armsight.store.atomic import disk_errors
from armsight.store.recording import Encoded, ImageFormat, RecordingWriter, encode

QUEUE_BYTES = 128_000_000
"""Frames that may wait: over a second of raw 720p pairs at 60 a second."""

QUEUE_PAIRS = 16
"""Pairs from files that may wait: enough to keep every core at compressing."""

QUEUE_S = 0.3
"""A live pair that would have to wait longer, at the pace of the last pairs, is dropped before it is compressed: with a
chunk's quarter of a second, what a killed program loses stays below a second on a machine that is too slow as well."""

PACE_WEIGHT, PACE_LIMIT_S = 0.2, 0.1
"""Weight of the newest pair in the pace, and the most it counts for: a disk that pauses once is no slow disk."""

TICK_S = 0.05
"""How often the writer looks whether a chunk is due while no frame comes."""

SYNC_S = 1.0
"""How often the disk is told to keep what it was given: what a power cut costs. In a thread of its own, since a sync
takes as long as the disk likes."""


BEHIND = 5
"""By so much nicer are threads that compress live frames: what measures them gets three quarters of a core that both
want. A picture may be compressed a little later, and not be measured later."""


def _behind() -> None:
    """Let what measures have the processor first, where a system gives each thread a priority of its own."""
    if sys.platform == "linux":
        with suppress(OSError):
            own = os.getpriority(os.PRIO_PROCESS, 0)
            os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), own + BEHIND)


@dataclass(frozen=True, slots=True)
class _Waiting:
    """The frames of a moment by camera, or what else is to be written."""

    frames: Mapping[str, Frame]
    encoded: Mapping[str, Future[Encoded | None]]
    size: int
    write: Callable[[RecordingWriter], None] | None = None


class Recorder:
    """Takes moments in one thread, writes them in another; as a context manager it ends with everything written.

    live: a moment that finds no room, or would have to wait too long, is dropped and counted; else put() waits for
    room. Closes the writer.
    """

    def __init__(
        self,
        writer: RecordingWriter,
        kind: ImageFormat,
        *,
        live: bool,
        clock: Clock | None = None,
        workers: int | None = None,
        sync_s: float = SYNC_S,
    ) -> None:
        self._writer = writer
        self._kind = kind
        self._live = live
        self._clock = clock or SystemClock()
        self._sync_s = sync_s
        self._pool = ThreadPoolExecutor(workers or cores(), "encode", initializer=_behind if live else None)
        self._waiting: deque[_Waiting] = deque()
        self._bytes = 0
        self._pace_s = 0.0
        self._room = threading.Condition()
        self._ending = threading.Event()
        self._failure: BaseException | None = None
        self._written = self._dropped = self._told = 0
        self._event_s = -math.inf
        self._threads = [
            threading.Thread(target=self._write, name="recorder", daemon=True),
            threading.Thread(target=self._sync, name="recorder-sync", daemon=True),
        ]

    @property
    def written(self) -> int:
        """Moments in the file or its chunk being filled."""
        return self._written

    @property
    def dropped(self) -> int:
        """Moments for which there was no room or no time."""
        return self._dropped

    def put(self, frames: Mapping[str, Frame]) -> bool:
        """Hand over a moment; False where it was dropped. Raises what writing has met: DeviceFailed, Inconsistent.

        frames: by camera, one for each that has one. Any thread may call this, one for each camera.
        """
        size = sum(frame.image.nbytes for frame in frames.values())
        with self._room:
            while self._failure is None and self._full(size):
                if self._live:
                    self._dropped += 1
                    return False
                self._room.wait()
            if self._failure is not None:
                raise self._failure
            encoded = {}
            if self._kind is not ImageFormat.RAW:
                encoded = {name: self._pool.submit(encode, one.image, self._kind) for name, one in frames.items()}
            self._waiting.append(_Waiting(frames, encoded, size))
            self._bytes += size
            self._room.notify_all()
        return True

    def add(self, write: Callable[[RecordingWriter], None]) -> None:
        """Have another record written in its turn, never dropped. Raises what writing has met."""
        with self._room:
            if self._failure is not None:
                raise self._failure
            self._waiting.append(_Waiting({}, {}, 0, write))
            self._room.notify_all()

    def close(self) -> None:
        """Write what waits, end the threads, close the file. Raises what writing has met and nobody was told yet."""
        with self._room:
            self._ending.set()
            self._room.notify_all()
        for thread in self._threads:
            thread.join()
        self._pool.shutdown(cancel_futures=True)
        try:
            if self._failure is not None:
                raise self._failure
        finally:
            self._writer.close()

    def __enter__(self) -> Self:
        for thread in self._threads:
            thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            self.close()
        except BaseException as failure:
            if failure is not error:
                raise

    def _full(self, size: int) -> bool:
        n = sum(bool(item.frames) for item in self._waiting)
        if not n:
            return False
        return self._bytes + size > QUEUE_BYTES or (n * self._pace_s > QUEUE_S if self._live else n >= QUEUE_PAIRS)

    def _write(self) -> None:
        try:
            while True:
                with self._room:
                    if not self._waiting:
                        if self._ending.is_set():
                            return
                        self._room.wait(TICK_S)
                    item = self._waiting[0] if self._waiting else None
                if item is None:
                    self._writer.tick()
                    continue
                begun_s = self._clock.now_s()
                self._one(item)
                if item.frames:
                    took_s = min(self._clock.now_s() - begun_s, PACE_LIMIT_S)
                    self._pace_s += PACE_WEIGHT * (took_s - self._pace_s)
                with self._room:
                    self._waiting.popleft()
                    self._bytes -= item.size
                    self._room.notify_all()
        except BaseException as error:
            with self._room:
                self._failure = error
                self._room.notify_all()

    def _one(self, item: _Waiting) -> None:
        if item.write is not None:
            item.write(self._writer)
        if not item.frames:
            return
        self._writer.moment(item.frames, {name: one.result() for name, one in item.encoded.items()})
        self._written += 1
        if self._dropped > self._told:
            news = self._dropped - self._told
            self._told += news
            t_s = next(iter(item.frames.values())).t_s
            self._event_s = max(self._event_s, t_s)  # of two cameras by themselves one may be a little behind
            what = "frames" if len(item.frames) == 1 else "pairs" if tuple(item.frames) == SIDES else "moments"
            why = f"{news} {what} dropped before this: the disk or the processor is too slow"
            self._writer.event(self._event_s, why, level="warning")

    def _sync(self) -> None:
        while not self._ending.wait(self._sync_s):
            try:
                self._writer.sync()
            except OSError:
                return  # writing meets it as well, and tells


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

    def put(self, frames: Mapping[str, Frame]) -> None:
        """Take a moment where a file is open; a disk that fails ends it."""
        if self._open is None:
            return
        try:
            self._open[1].put(frames)
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
