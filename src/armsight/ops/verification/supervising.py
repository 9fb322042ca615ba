"""One pair of live frames after the other: measured, compared with where the arm should be, judged."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from types import TracebackType
from typing import Self

import numpy as np

from armsight.clock import Clock
from armsight.control.session.service import TokenBucket
from armsight.defaults import BLIND_S
from armsight.drivers import MomentSource, Robot, Views, news_of
from armsight.drivers.trackers.source import BodyStream, TrackedBody
from armsight.errors import DeviceFailed, StaleData
from armsight.measure.consistency.findings import LeftOut
from armsight.ops.recording.recorder import Recorder
from armsight.ops.verification.eyes import Eyes, Sighted
from armsight.records import JointReading, PoseStatus, TargetPose
from armsight.records.motion import JointHistory
from armsight.store.recording import ImageFormat, RecordingWriter
from armsight.verify.live import LiveLog
from armsight.verify.supervision import Alarm, Compared, Level, Limits, PredictedPose, Seen, Watch

PLANT = "plant"
WARNINGS_PER_S = 20.0
NOTES = 100
"""Notes of the plant's systems that wait for the next pair; the oldest are left out."""
AFTER_STOP_S = 1.0
"""Supervision goes on so long after a stop: the recording shows how the arm came to rest."""


Show = Callable[[TargetPose, Compared | None, Level, str], None]
"""Is told of every pair: the pose, what was compared, the level, and what was lost."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Supervised:
    """A robot and the moments of cameras, or a tracker's body, that watch it, not yet open.

    origin_s: tells the clock's time of the cameras' zero once they are open, None where only arrivals tell it. on_step:
    takes what is to be called whenever time passes, of a clock that moves by itself; None: the joints' thread reads.
    """

    robot: Robot
    pairs: MomentSource | BodyStream
    origin_s: Callable[[], float] | None = None
    on_step: Callable[[Callable[[], None]], None] | None = None


class Judge:
    """Judges one pose after the other, stops the robot beyond a level that says so, and keeps what was found."""

    def __init__(self, limits: Limits, stop: Callable[[], None]) -> None:
        self.log = LiveLog(limits=limits)
        self.seen = nothing_yet(limits)
        """The newest pose, for the plant's systems."""
        self.why = ""
        self._watch, self._stop = Watch(limits), stop

    @property
    def level(self) -> Level:
        """The level now."""
        return self._watch.level

    def add(self, compared: Compared) -> Alarm | None:
        """Judge a pose that was compared; return the alarm where the level rises, its stop already sent."""
        alarm = self._watch.add(compared)
        if alarm is not None and alarm.level is Level.STOP:
            self.stop()
        return alarm

    def stop(self) -> None:
        """Stop the robot, and hold the level."""
        self._stop()
        self._watch.level = Level.STOP
        self.log.stopped = True

    def show(
        self,
        pose: TargetPose,
        compared: Compared | None,
        lost: str,
        raised: Alarm | None,
        *,
        at_s: float,
        blind: bool,
    ) -> None:
        """Make the pose the newest, and keep what was raised at it. at_s: of its exposure, on time.monotonic."""
        if raised is not None:
            self.log.alarms.append(raised)
            self.why = self.why if raised.level is Level.GOOD else raised.why
        if self.level is Level.GOOD:
            self.why = ""
        self.seen = Seen(
            pose=pose,
            compared=compared,
            level=self.level,
            why=self.why,
            limits=self.log.limits,
            lost=lost,
            at_s=at_s,
            blind=blind,
        )


def nothing_yet(limits: Limits) -> Seen:
    """Return what is seen before the first picture."""
    now_s, why = time.monotonic(), "no pictures came yet"
    pose = TargetPose(t_s=now_s, status=PoseStatus.LOST, parent="rig", why=why)
    return Seen(pose=pose, compared=None, level=Level.GOOD, why="", limits=limits, lost=why, at_s=now_s)


class Supervision:
    """What goes on from pair to pair: measured, compared, judged, the robot stopped; then written and told.

    latency_s: from exposure to frame in memory. blind_stop_s: stop where nothing was compared for so long.
    """

    def __init__(
        self,
        eyes: Eyes,
        expectation: PredictedPose,
        devices: Supervised,
        clock: Clock,
        limits: Limits,
        *,
        latency_s: float,
        blind_stop_s: float | None = None,
    ) -> None:
        self.devices = devices
        self.show: Show = lambda *_: None
        self.tell: Callable[[str], None] = lambda _: None
        """Takes what a person should hear of the plant's systems."""
        self.judge = Judge(limits, devices.robot.stop)
        self.stops = limits.stops or blind_stop_s is not None
        self._expectation, self._clock = expectation, clock
        self._latency_s, self._blind_stop_s = latency_s, blind_stop_s
        self._reader = JointReader(devices.robot, clock)
        self._recorder: Recorder | None = None
        self._eyes = eyes
        self.contradictions: list[LeftOut] = []
        """What was found of cameras that are left out, or of a rig whose poses are doubtful."""
        self._ahead_s = np.inf  # the clock's time at the cameras' zero
        self._seen_s: float | None = None
        self._blind = False
        self._stopped_s: float | None = None
        self.seen: Seen | None = None
        """The newest pair, for the plant's systems."""
        self._lost: list[str] = []
        self._notes: deque[tuple[str, str]] = deque(maxlen=NOTES)
        self._warnings, self._left_out = TokenBucket(WARNINGS_PER_S, WARNINGS_PER_S, clock.now_s()), 0

    def open(self, stack: ExitStack, recording: Path) -> None:
        """Begin the recording, and to read the joints; all ends with the stack."""
        writer = RecordingWriter(recording, overwrite=True)
        stack.enter_context(writer)
        self._eyes.attach(writer)
        self._recorder = stack.enter_context(Recorder(writer, ImageFormat.PNG, live=True))
        if self.devices.on_step is not None:
            self.devices.on_step(self._reader.poll)  # the clock's owner lets time pass, and readings with it
        else:
            stack.enter_context(self._reader)

    def take(self, moment: Views | TrackedBody) -> None:
        """Measure, compare, judge, and only then write and tell."""
        begun_s = time.perf_counter()
        for message in news_of(self.devices.pairs, self._lost):
            self.note("warning", message)
        now_s = self._clock.now_s()
        sighted = self._eyes.take(moment)
        self._ahead_s = min(self._ahead_s, now_s - sighted.newest_s - self._latency_s)
        pose = sighted.pose
        for one in self._eyes.contradictions:
            if one.words not in [other.words for other in self.contradictions]:
                self.contradictions.append(one)
                self.note("warning", f"{one.told if one.names else one.words} {one.cure}.")
        zero_s = self._ahead_s if self.devices.origin_s is None else self.devices.origin_s()
        compared, lost = self._compared(pose, pose.t_s + zero_s)
        alarm = None if compared is None else self.judge.add(compared)
        if alarm is not None and alarm.level is Level.STOP:
            self._stopped_s = pose.t_s
        raised = alarm or self._sight(pose.t_s, compared is not None, lost)
        ms = (time.perf_counter() - begun_s) * 1e3
        self.judge.log.add(sighted.sequence, pose, compared, self.judge.level, lost, ms)
        self.judge.show(pose, compared, lost, raised, at_s=self._monotonic_s(pose.t_s + zero_s), blind=self._blind)
        self.seen = self.judge.seen
        self._record(sighted, raised, zero_s)
        self.show(pose, compared, self.judge.level, lost)

    def ended(self, seconds_s: float | None, pairs: int | None) -> bool:
        """Whether enough was seen: so long, so many pairs, or how the arm came to rest after a stop."""
        log = self.judge.log
        if self._stopped_s is not None and log.rows[-1].t_s - self._stopped_s >= AFTER_STOP_S:
            return True
        by_time = seconds_s is not None and log.duration_s >= seconds_s
        return by_time or (pairs is not None and len(log.rows) >= pairs)

    def _compared(self, pose: TargetPose, at_s: float) -> tuple[Compared | None, str]:
        if pose.status is not PoseStatus.OK:
            return None, f"target: {pose.why or pose.status.value}"
        try:
            return self._expectation.compare(pose, self._reader.history.at(at_s)), ""
        except StaleData as error:
            return None, f"joints: {self._reader.why or error.cause}"

    def _sight(self, t_s: float, seen: bool, lost: str) -> Alarm | None:
        """Return what to tell where nothing was compared for BLIND_S, once; stop where that was asked for."""
        if seen or self._seen_s is None:
            self._seen_s, self._blind = t_s, False
            return None
        dark_s = t_s - self._seen_s
        if self._blind_stop_s is not None and dark_s >= self._blind_stop_s and self._stopped_s is None:
            self.judge.stop()
            self._stopped_s = t_s
            return Alarm(level=Level.STOP, t_s=t_s, why=f"stop: blind for {dark_s:.2f} s; {lost}")
        if self._blind or dark_s < BLIND_S:
            return None
        self._blind = True
        return Alarm(level=Level.GOOD, t_s=t_s, why=f"blind: nothing compared for {dark_s:.2f} s; {lost}")

    def _record(self, sighted: Sighted, raised: Alarm | None, zero_s: float) -> None:
        recorder = self._recorder
        if recorder is None:
            return
        if sighted.frames:
            recorder.put(sighted.frames)
        pose = sighted.pose
        readings = self._reader.take()
        notes = [self._notes.popleft() for _ in range(len(self._notes))]
        for level, message in notes:
            if level != "info":
                self.tell(message)

        def write(writer: RecordingWriter) -> None:
            for reading in readings:
                writer.joints(replace(reading, t_s=reading.t_s - zero_s))
            writer.pose(pose)
            for level, message in notes:
                writer.event(pose.t_s, message, level=level, name=PLANT)
            if raised is not None:
                writer.event(raised.t_s, raised.why, level="error" if raised.level is Level.STOP else "warning")

        recorder.add(write)

    def joints(self) -> tuple[JointReading | None, float, str]:
        """Return the newest reading, its moment on time.monotonic, and why none can be had; for any thread."""
        reading = self._reader.newest
        return reading, float("nan") if reading is None else self._monotonic_s(reading.t_s), self._reader.why

    def _monotonic_s(self, t_s: float) -> float:
        return time.monotonic() - (self._clock.now_s() - t_s)

    def note(self, level: str, message: str) -> None:
        """Keep something from the plant's systems, which is recorded and told with the next pair; for one thread.

        Of a flood of warnings, from whoever is refused again and again, only their number.
        """
        if level == "warning" and not self._warnings.pay(self._clock.now_s()):
            self._left_out += 1
            return
        if self._left_out:
            self._notes.append(("warning", f"{self._left_out} more warnings were left out"))
            self._left_out = 0
        self._notes.append((level, message))


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
        self.newest: JointReading | None = None
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
        self.why, self.newest = "", reading
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
