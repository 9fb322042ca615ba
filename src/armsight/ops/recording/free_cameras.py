"""Cameras, each by itself with its own times, into one recording; a process of its own, beside a robot's loop."""

from __future__ import annotations

import multiprocessing
import signal
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path
from types import TracebackType
from typing import Annotated, Self

from armsight.clock import Clock, SystemClock
from armsight.drivers import AUTOMATIC, CameraSettings, FrameSource
from armsight.drivers.live import SILENCE_S
from armsight.errors import ArmsightError, Cancelled, DeviceFailed, DeviceLost
from armsight.fields import Doc
from armsight.ops.recording.recorder import Recorder
from armsight.ops.sources.cameras import require_watching
from armsight.ops.sources.frames import camera_source
from armsight.priority import give_way
from armsight.records.output import Output, output
from armsight.store.recording import ImageFormat, RecordingWriter

SILENT_S = SILENCE_S + 1.0
"""A camera without a frame for so long is lost; drivers that know more tell it earlier."""
TAIL_S = 0.5
"""Recorded after the end was asked for: what was exposed before it is still on its way."""
BEGIN_S, END_S = 60.0, 10.0
"""Longest wait for the first frames, and for what waits to be written."""
TICK_S = 0.05


@output
class CameraRecorded(Output):
    """One camera's share of a recording."""

    camera: Annotated[str, Doc("Its name in the recording, such as left.")]
    n_frames: Annotated[int, Doc("Frames recorded.")]
    n_dropped: Annotated[int, Doc("Frames that found no room: the disk or the processor is too slow.")]
    duration_s: Annotated[float, Doc("From its first frame to its last, s.")]


@dataclass(frozen=True, slots=True, kw_only=True)
class FreeJob:
    """Live cameras by name and the .mcap for their frames. Raises UsageError for what cannot be recorded so."""

    cameras: Mapping[str, str]
    out: Path
    settings: CameraSettings = AUTOMATIC

    def __post_init__(self) -> None:
        require_watching(self.cameras.values(), "the arm")


class FreeCameras:
    """The cameras while it is open: `with FreeCameras(job) as cameras`. It opens once all have sent a frame.

    failed: why they are no longer recorded, None while they are; it costs nothing to ask. recorded: of each camera,
    once it is closed.
    """

    def __init__(self, job: FreeJob, *, cancelled: Callable[[], bool] = lambda: False) -> None:
        """Start nothing yet; cancelled gives up the wait for the first frames."""
        self._job, self._cancelled = job, cancelled
        self.failed: ArmsightError | None = None
        self.recorded: tuple[CameraRecorded, ...] = ()
        self._news = threading.Event()
        context = multiprocessing.get_context("spawn")
        self._results, self._messages = context.Pipe(duplex=False)
        self._heard, self._orders = context.Pipe(duplex=False)
        self._process = context.Process(
            target=_work, args=(job, self._messages, self._heard), name="armsight-cameras", daemon=True
        )
        self._reader = threading.Thread(target=self._read, name="cameras", daemon=True)

    def __enter__(self) -> Self:
        """Raises DeviceFailed where a camera cannot be opened or sends nothing, Cancelled."""
        self._process.start()
        self._messages.close()
        self._heard.close()
        self._reader.start()
        try:
            self._wait()
        except BaseException:
            self._end()
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._end()

    def _wait(self) -> None:
        until_s = time.monotonic() + BEGIN_S
        while not self._news.wait(TICK_S):
            if self._cancelled():
                raise Cancelled("stopped before the cameras had begun", consequence="Nothing was moved")
            if time.monotonic() > until_s:
                raise DeviceFailed(f"the cameras sent nothing for {BEGIN_S:g} s", consequence="Nothing was moved")
        if self.failed is not None:
            raise self.failed

    def _end(self) -> None:
        self._orders.close()  # which is what ends it, as this process's own end does
        self._process.join(END_S)
        if self._process.is_alive():
            self._process.kill()
            self._process.join()
        self._reader.join()

    def _read(self) -> None:
        done = False
        with suppress(EOFError, OSError):
            while True:
                message = self._results.recv()
                if isinstance(message, ArmsightError):
                    self.failed = self.failed or message
                elif isinstance(message, tuple):
                    self.recorded, done = message, True
                self._news.set()
        self._results.close()
        if not done and self.failed is None:
            self.failed = DeviceFailed("the process that records the cameras ended by itself")
        self._news.set()


def _work(job: FreeJob, messages: Connection, orders: Connection) -> None:
    """Record until the other end of orders closes; tell that it has begun, what went wrong, and what was recorded."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches both processes; the other ends this one in order
    give_way()  # a frame that is dropped costs little, a cycle that is late a hold
    with suppress(BrokenPipeError):
        try:
            messages.send(record_free(job, lambda: messages.send(None), lambda: orders.poll(TICK_S), SystemClock()))
        except ArmsightError as error:
            messages.send(error)


def record_free(
    job: FreeJob, begun: Callable[[], None], ended: Callable[[], bool], clock: Clock
) -> tuple[CameraRecorded, ...]:
    """Record the cameras until ended, and TAIL_S more; begun is called once all have sent a frame.

    ended waits for a moment before it says no. Stamps are the machine's monotonic time, where a camera has none of its
    own. Raises DeviceFailed where a camera or the disk fails, or a camera is silent; what was recorded until then is
    kept.
    """
    with _opened(job, clock) as feeds:
        running, at_s = False, clock.now_s()
        while not ended():
            _require(feeds, clock.now_s(), at_s)
            if not running and all(feed.n_frames for feed in feeds):
                running = True
                begun()
        if running:
            clock.sleep_until(clock.now_s() + TAIL_S)
    return tuple(feed.told() for feed in feeds)


def _require(feeds: tuple[_Feed, ...], now_s: float, opened_s: float) -> None:
    """Raise what a camera has failed of, or that it is silent."""
    for feed in feeds:
        if feed.failed is not None:
            raise feed.failed
        if now_s - max(feed.heard_s, opened_s) > SILENT_S:
            raise DeviceLost(f"{feed.name} sent no frame for {SILENT_S:g} s", cure="Check the plug and the cable")


class _Feed:
    """One camera's frames from its source into the recorder, in a thread of its own."""

    def __init__(self, side: str, name: str, source: FrameSource, recorder: Recorder, clock: Clock) -> None:
        self.name = name
        self.heard_s = 0.0
        self.n_frames = self._n_dropped = 0
        self.failed: ArmsightError | None = None
        self._side, self._source, self._recorder, self._clock = side, source, recorder, clock
        self._first_s = self._last_s = 0.0
        self._ending = False
        self._thread = threading.Thread(target=self._run, name=f"camera {side}", daemon=True)

    def start(self) -> None:
        """Begin to read."""
        self._thread.start()

    def end(self) -> None:
        """Take no more frames; a driver that hangs is left to itself."""
        self._ending = True
        self._thread.join(TAIL_S)

    def told(self) -> CameraRecorded:
        """Return what was recorded."""
        return CameraRecorded(
            camera=self._side,
            n_frames=self.n_frames,
            n_dropped=self._n_dropped,
            duration_s=self._last_s - self._first_s,
        )

    def _run(self) -> None:
        try:
            for frame in self._source:
                if self._ending:
                    return
                self.heard_s = self._clock.now_s()
                if not self._recorder.put({self._side: frame}):
                    self._n_dropped += 1
                    continue
                self._first_s = self._first_s if self.n_frames else frame.t_s
                self._last_s = frame.t_s
                self.n_frames += 1
            self.failed = DeviceLost(f"{self.name} sends no more frames")
        except ArmsightError as error:
            self.failed = error
        except Exception as error:  # of a driver of one's own, whatever it raises
            self.failed = DeviceFailed(f"{self.name} failed: {error}")


@contextmanager
def _opened(job: FreeJob, clock: Clock) -> Iterator[tuple[_Feed, ...]]:
    """Give the cameras while they are read into the recording; no file is made before all are open."""
    with ExitStack() as stack:
        sources = [
            stack.enter_context(camera_source(text, name, origin_s=0.0, settings=job.settings))
            for name, text in job.cameras.items()
        ]
        writer = RecordingWriter(job.out, origin_ns=time.time_ns() - round(1e9 * clock.now_s()))
        recorder = stack.enter_context(Recorder(writer, ImageFormat.PNG, live=True))
        feeds = tuple(
            _Feed(name, text, source, recorder, clock)
            for (name, text), source in zip(job.cameras.items(), sources, strict=True)
        )
        for feed in feeds:
            feed.start()
        try:
            yield feeds
        finally:
            for feed in feeds:
                feed.end()
