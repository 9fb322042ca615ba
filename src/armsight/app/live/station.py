"""A process of its own that measures live, so that no screen, however many, slows the measuring loop."""

from __future__ import annotations

import multiprocessing
import threading
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path

import cv2
import numpy as np

from armsight.app.live.measurement import DetectionSettings, LiveJob, LiveMeasurement, MeasuredMoment
from armsight.app.live.views import LiveView, SideView, complex_view
from armsight.clock import Clock, SystemClock
from armsight.errors import ArmsightError, DeviceFailed, UsageError
from armsight.ops.measurement.warm_up import prepare
from armsight.ops.recording.recorder import LiveRecording, RecordingState
from armsight.priority import give_way
from armsight.records import Frame, Silent, Spots, TargetPose
from armsight.store.atomic import write_bytes
from armsight.store.cell_file import COMPLEX

PICTURES_HZ = 30.0
"""Pictures a second that a screen gets at most: more is not seen."""
RESTS = 4.0
"""Of the time that a picture took: where others want the processors it takes longer, and so fewer are drawn, by every
browser too. With three browsers on two processors p99 from light to pose is 110 ms with 1, 25 ms with 4."""
JPEG_QUALITY = 80
SAVE_S = 5.0
"""Time after which a moment that was asked for is given up."""
SILENT_S, SILENT_FRAMES = 2.0, 4.0
"""A station is silent after so long without a picture, or so many times the pace of the last ones."""
END_S = 5.0
"""Time that the process gets to write what it records before it is ended by force."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Snapshot:
    """The newest moment: what was measured, with its whole covariance; what a screen says; the pictures.

    pose: in the view's parent. spots: of each of the view's cameras. jpegs: by picture, of one that is lost the last.
    """

    pose: TargetPose
    spots: tuple[Spots, ...]
    view: LiveView
    jpegs: Mapping[str, bytes]


@dataclass(frozen=True, slots=True)
class _Record:
    file: Path | None


@dataclass(frozen=True, slots=True)
class _Save:
    files: Mapping[str, Path]


@dataclass(frozen=True, slots=True)
class _Width:
    width_px: int


@dataclass(frozen=True, slots=True)
class _Saved:
    failure: str


@dataclass(frozen=True, slots=True)
class _Failed:
    text: str


@dataclass(frozen=True, slots=True)
class _News:
    text: str


@dataclass(frozen=True, slots=True)
class _Ended:
    pass


_Message = Snapshot | RecordingState | _Saved | _Failed | _News | _Ended


class MeasurementProcess:
    """The measuring process from the outside. Threads of the caller may use it at once.

    `shown` is the newest moment, `failure` why it does not measure (empty where it does). tell: is told once, in a
    thread of its own, of each camera that is lost or left out while the others go on, and of cameras that run freely.
    """

    def __init__(
        self, job: LiveJob, clock: Clock | None = None, tell: Callable[[str], object] = lambda _: None
    ) -> None:
        """Start nothing yet."""
        self.job = job
        self._tell = tell
        self._clock = clock or SystemClock()
        self._heard_s = 0.0
        self.shown: Snapshot | None = None
        self.recording = RecordingState()
        self.failure = ""
        self.ended = False
        self._commands: Connection | None = None
        self._process: multiprocessing.process.BaseProcess | None = None
        self._reader: threading.Thread | None = None
        self._lock = threading.Lock()
        self._stopping = False
        self._saved, self._save_failure = threading.Event(), ""
        self._newer = threading.Condition()
        self._saving = threading.Lock()
        self._width_px: int | None = None

    @property
    def silent_s(self) -> float:
        """For how long no picture has come from a station that should give some; 0 while they come at their pace."""
        shown = self.shown
        if shown is None or self.ended or self.failure:
            return 0.0
        since_s = self._clock.now_s() - self._heard_s
        usual_s = SILENT_FRAMES / shown.view.fps if shown.view.fps > 0.0 else 0.0
        return since_s if since_s > max(SILENT_S, usual_s) else 0.0

    @property
    def current(self) -> bool:
        """Whether what is shown is so now; the last picture of a source that has ended stands for it."""
        return self.shown is not None and not self.failure and self.silent_s == 0.0

    def start(self) -> None:
        """Start measuring, or start anew after a failure."""
        self.stop()
        context = multiprocessing.get_context("spawn")
        results, messages = context.Pipe(duplex=False)
        commands, self._commands = context.Pipe(duplex=False)
        self._process = context.Process(
            target=_work, args=(self.job, messages, commands), daemon=True, name="measuring"
        )
        self.failure, self.ended, self.shown, self._stopping = "", False, None, False
        self._width_px = None
        self._process.start()
        messages.close()
        commands.close()
        self._reader = threading.Thread(target=self._read, args=(results,), daemon=True, name="station")
        self._reader.start()

    def stop(self) -> None:
        """End measuring and close the recording; legal at any time."""
        if self._process is None:
            return
        self._stopping = True
        self._send(None)
        self._process.join(END_S)
        if self._process.is_alive():
            self._process.terminate()
        if self._reader is not None:
            self._reader.join()
        self._process = self._reader = self._commands = None

    def look(self, how: DetectionSettings) -> None:
        """Look for spots in another way from now on."""
        self._send(how)

    def show_width(self, width_px: int) -> None:
        """Show pictures no wider than this from now on: more than a screen has costs it its time and is not seen."""
        if width_px != self._width_px:
            self._width_px = width_px
            self._send(_Width(width_px))

    def record(self, file: Path | None) -> None:
        """Record all frames into a new .mcap, or end the recording (None). What happens stands in `recording`."""
        self._send(_Record(file))

    def shown_since(self, t_s: float) -> Snapshot:
        """Wait for a moment whose frames were exposed at t_s on the machine's clock, or later, and return it.

        Raises DeviceFailed where none comes.
        """

        def come() -> bool:
            return bool(self.failure) or self.ended or (self.shown is not None and self.shown.view.t_s >= t_s)

        with self._newer:
            self._newer.wait_for(come, SAVE_S)
            shown = self.shown
        if shown is None or shown.view.t_s < t_s:
            why = self.failure or ("the frames have ended" if self.ended else "no pictures come")
            raise DeviceFailed(why, consequence="Nothing was taken", cure="Look at the cameras")
        return shown

    def save(self, files: Mapping[str, Path]) -> None:
        """Write the next moment that has all these pictures into files by their names, bit for bit.

        One caller waits for the other. Raises DeviceFailed where no such moment comes or it is not written.
        """
        with self._saving:
            self._saved.clear()
            self._send(_Save(files))
            starting = "" if self.shown is not None else "the cameras are still starting"
            came = not (self.failure or starting) and self._saved.wait(SAVE_S)
            if not came:
                self._send(_Save({}))
            failure = self._save_failure if came else self.failure or starting or self._without(files)
        if failure:
            raise DeviceFailed(failure, consequence="No picture was taken", cure="Look at the cameras and the disk")

    def _without(self, files: Mapping[str, Path]) -> str:
        """Return which of some pictures do not come."""
        views = {} if self.shown is None else self.shown.view.cameras
        lost = [f"{name} ({view.lost})" for name, view in views.items() if name in files and view.lost]
        return f"no picture comes of {', '.join(lost or files)}"

    def _send(self, command: object) -> None:
        with self._lock, suppress(BrokenPipeError, OSError):
            if self._commands is not None:
                self._commands.send(command)

    def _read(self, results: Connection) -> None:
        with suppress(EOFError, OSError):
            while True:
                message: _Message = results.recv()
                match message:
                    case Snapshot():
                        with self._newer:
                            self._heard_s = self._clock.now_s()
                            self.shown = message
                            self._newer.notify_all()
                    case RecordingState():
                        self.recording = message
                    case _Saved(failure):
                        self._save_failure = failure
                        self._saved.set()
                    case _Failed(text):
                        self.failure = text
                    case _News(text):
                        self._tell(text)
                    case _Ended():
                        self.ended = True
        results.close()
        if not (self.failure or self.ended or self._stopping):
            self.failure = "the measuring process ended unexpectedly"
        self.recording = RecordingState(failure=self.recording.failure)
        with self._newer:
            self._newer.notify_all()


def _work(job: LiveJob, messages: Connection, commands: Connection) -> None:
    with suppress(KeyboardInterrupt, BrokenPipeError):
        try:
            _Worker(job, messages, commands, SystemClock()).run()
        except ArmsightError as error:
            messages.send(_Failed(str(error)))


class _Worker:
    """The measuring loop, and a thread that encodes and sends pictures beside it (OpenCV encodes without the lock)."""

    def __init__(self, job: LiveJob, messages: Connection, commands: Connection, clock: Clock) -> None:
        self._measurement = LiveMeasurement(job, clock)
        self._messages, self._commands, self._clock = messages, commands, clock
        self._mailbox: MeasuredMoment | None = None
        self._jpegs: dict[str, bytes] = {}
        self._told: set[str] = set()
        self._posted = threading.Condition()
        self._post_lock = threading.Lock()
        self._ending = False
        self._recording = LiveRecording(self._post, clock)
        self._save: _Save | None = None
        self._width_px: int | None = None

    def run(self) -> None:
        """Measure to the end of the source, or until told to end."""
        prepare(Silent())
        sender = threading.Thread(target=self._send, daemon=True, name="pictures")
        sender.start()
        try:
            with self._measurement.source:
                for moment in self._measurement.moments():
                    self._take(moment)
                    if self._obey():
                        return
            self._post(_Ended())
            self._wait_for_the_end()
        finally:
            self._recording.end()
            with self._posted:
                self._ending = True
                self._posted.notify()
            sender.join()

    def _take(self, moment: MeasuredMoment) -> None:
        self._recording.put({"image" if name == COMPLEX else name: frame for name, frame in moment.frames.items()})
        views, apart = moment.view.cameras.items(), getattr(self._measurement.source, "apart", "")
        away = [f"the camera {name} is lost: {view.lost}" if view.lost else view.left_out for name, view in views]
        for what in (*away, apart):
            if what and what not in self._told:
                self._told.add(what)
                self._post(_News(what))
        with self._posted:
            self._mailbox = moment
            self._posted.notify()

    def _obey(self) -> bool:
        """Do what was asked since the last moment; return whether that is to end."""
        while self._commands.poll():
            try:
                command = self._commands.recv()
            except EOFError:
                return True
            if command is None:
                return True
            self._do(command)
        return False

    def _do(self, command: object) -> None:
        match command:
            case DetectionSettings():
                with suppress(UsageError):  # the page refuses what cannot be before it asks
                    self._measurement.look(command)
            case _Record(None):
                self._recording.end()
            case _Record(Path() as file):
                self._recording.begin(file)
            case _Save():
                self._save = command
            case _Width(width_px):
                self._width_px = width_px

    def _wait_for_the_end(self) -> None:
        while not self._obey():
            self._commands.poll(None)

    def _send(self) -> None:
        """Send the newest moment, no faster than a screen shows, and rest RESTS times as long as that took."""
        give_way()
        next_s = 0.0
        while True:
            with self._posted:
                self._posted.wait_for(lambda: self._mailbox is not None or self._ending)
                if self._ending:
                    return
                moment, self._mailbox = self._mailbox, None
            if moment is None:
                continue
            self._save_moment(moment)
            begun_s = self._clock.now_s()
            if begun_s < next_s:
                continue
            self._jpegs |= {name: jpeg(frame, self._width_px) for name, frame in moment.frames.items()}
            self._post(Snapshot(pose=moment.pose, spots=moment.spots, view=moment.view, jpegs=self._jpegs))
            ended_s = self._clock.now_s()
            jitter_s = 1.0 / PICTURES_HZ  # which skips none
            next_s = max(next_s + 0.9 / PICTURES_HZ, begun_s - jitter_s, ended_s + RESTS * (ended_s - begun_s))
            self._recording.notify()

    def _save_moment(self, moment: MeasuredMoment) -> None:
        if self._save is None or not self._save.files or not self._save.files.keys() <= moment.frames.keys():
            return
        asked, self._save = self._save, None  # nobody asks for another before this one is answered
        failure = ""
        try:
            for name, file in asked.files.items():
                frame = moment.frames[name]
                file.parent.mkdir(parents=True, exist_ok=True)
                write_bytes(file, cv2.imencode(".png", np.asarray(frame.image))[1].tobytes())
        except (ArmsightError, OSError) as error:
            failure = str(error)
        self._post(_Saved(failure))

    def _post(self, message: _Message) -> None:
        with self._post_lock, suppress(BrokenPipeError, OSError):
            self._messages.send(message)


def picture_view(shown: Snapshot, picture: str) -> SideView:
    """Return what a screen shows of a picture: of a camera, or of the one with both views."""
    return complex_view(shown.view) if picture == COMPLEX else shown.view.cameras[picture]


def jpeg(frame: Frame, width_px: int | None = None) -> bytes:
    """Return a frame as a JPEG file's bytes, no wider than told."""
    image = np.asarray(frame.image)
    if width_px is not None and width_px < frame.width:
        size = (width_px, max(round(frame.height * width_px / frame.width), 1))
        image = np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)
    _, data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
    return data.tobytes()
