"""The recording from which a whole cell is calibrated: its cameras and the arm's readings, and how far it has come."""

from __future__ import annotations

import threading
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from armsight.app.live.station import MeasurementProcess, Snapshot
from armsight.arrays import Array
from armsight.clock import Clock
from armsight.defaults import LOOK_S, LOST_LOOKS
from armsight.errors import ArmsightError, DeviceFailed, UsageError
from armsight.optics import SIDES
from armsight.records import JointReading, Motion
from armsight.store.tracks import write_joints

ReadJoints = Callable[[], JointReading]
"""Returns the robot's newest joints in rad or m. Raises DeviceFailed."""

FRAMES, LOG = "frames.mcap", "joints.csv"
BEGIN_S, END_S = 5.0, 30.0
"""Time in which the measuring process must have begun to write, and have closed the file."""
CELLS = 3
STILL_PX = 1.5
"""A spot this near to one of the last picture stands: a lamp, or a target at rest, which was counted as it came."""
SILENT_S = 1.0


@dataclass(slots=True, kw_only=True)
class CellWatch:
    """What a recording holds so far.

    n_lights: of the target, 0 where it is not known. seconds: from its first picture to its newest. cells: of each
    picture, how often a moving spot was seen in each ninth (3, 3). gap_s: the longest time between two readings.
    """

    n_lights: int = 0
    sides: tuple[str, ...] = SIDES
    seconds: float = 0.0
    n_pictures: int = 0
    cells: dict[str, NDArray[np.int64]] = field(default_factory=dict)
    whole: Counter[str] = field(default_factory=Counter)
    missed: dict[str, int] = field(default_factory=dict)
    gap_s: float = 0.0
    readings: list[tuple[float, Array]] = field(default_factory=list)
    _low: Array | None = None
    _high: Array | None = None
    _first_s: float | None = None
    _before: dict[str, Array] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.cells = {side: np.zeros((CELLS, CELLS), dtype=np.int64) for side in self.sides}

    def add_pictures(self, shown: Snapshot) -> None:
        """Take the pictures of a moment."""
        t_s = shown.view.t_s
        self._first_s = t_s if self._first_s is None else self._first_s
        self.seconds = t_s - self._first_s
        self.n_pictures += 1
        for (side, view), spots in zip(shown.view.cameras.items(), shown.spots, strict=True):
            uv = np.asarray(spots.uv_px)
            enough = len(uv) >= max(self.n_lights, 1)
            self.whole[side] += enough
            self.missed[side] = 0 if enough else self.missed.get(side, 0) + 1
            if side in self._before:
                self._count(side, _moved(uv, self._before[side]), (view.width, view.height))
            self._before[side] = uv

    def _count(self, side: str, uv: Array, size: tuple[int, int]) -> None:
        places = (uv / size * CELLS).astype(int).clip(0, CELLS - 1)
        for column, row in {(int(c), int(r)) for c, r in places}:
            self.cells[side][row, column] += 1

    def add_reading(self, reading: JointReading) -> None:
        """Take a reading; one that was taken before is left out."""
        if self.readings:
            since_s = reading.t_s - self.readings[-1][0]
            if since_s <= 0.0:
                return
            self.gap_s = max(self.gap_s, since_s)
        self.readings.append((reading.t_s, reading.q))
        low, high = self._low, self._high
        self._low = reading.q if low is None else np.minimum(low, reading.q)
        self._high = reading.q if high is None else np.maximum(high, reading.q)

    @property
    def ranges(self) -> Array:
        """Over how much each joint has moved (n,) in rad or m; (0,) without readings."""
        return np.empty(0) if self._low is None or self._high is None else np.asarray(self._high - self._low)

    @property
    def lost_side(self) -> str:
        """The camera that has not seen all lights for a while, empty where both see them; of others than a pair where
        any one does, and else the last to see them."""
        if self.sides != SIDES and min(self.missed.values(), default=0) < LOST_LOOKS:
            return ""
        lost = [side for side, n in self.missed.items() if n >= LOST_LOOKS]
        return "" if not lost else lost[0] if self.sides == SIDES else min(lost, key=self.missed.__getitem__)

    def seen_share(self, side: str) -> float:
        """Return in which share of the pictures a camera saw as many spots as the target has lights."""
        return self.whole[side] / max(self.n_pictures, 1)


def _moved(uv: Array, before: Array) -> Array:
    if not len(uv) or not len(before):
        return uv
    far = np.linalg.norm(uv[:, None] - before[None], axis=2).min(axis=1) > STILL_PX
    return np.asarray(uv[far])


class CellRecorder:
    """Records in a thread of its own until it is ended, or the station ends: a page that is closed ends nothing.

    Writes FRAMES, and LOG where a robot tells its joints. watch: what there is so far; failure: what went wrong.
    """

    def __init__(
        self,
        station: MeasurementProcess,
        folder: Path,
        read_joints: ReadJoints | None,
        clock: Clock,
        *,
        n_lights: int,
        sides: tuple[str, ...] = SIDES,
    ) -> None:
        self.folder, self.watch, self.failure = folder, CellWatch(n_lights=n_lights, sides=sides), ""
        self.silent, self.dropped = "", 0
        """Why the robot tells nothing just now, empty where it does; pairs that the disk had no time for."""
        self._station, self._read_joints, self._clock = station, read_joints, clock
        self._shown: Snapshot | None = None
        self._before = station.recording
        self._asked, self._writing = threading.Event(), False
        self._thread = threading.Thread(target=self._run, name="cell recording", daemon=True)

    @property
    def running(self) -> bool:
        """Whether it goes on."""
        return self._thread.is_alive()

    def begin(self) -> None:
        """Begin to record. Raises UsageError where another recording runs, DeviceFailed where no pictures come."""
        if self._station.recording.file is not None:
            raise UsageError(
                f"{self._station.recording.file.name} is being recorded",
                consequence="Nothing is begun",
                cure="End that recording first, on the page Live",
            )
        if self._station.failure or self._station.ended or self._station.shown is None:
            why = self._station.failure or ("the frames have ended" if self._station.ended else "no pictures come yet")
            raise DeviceFailed(why, consequence="Nothing is recorded", cure="Look at the cameras, then begin again")
        if self._read_joints is not None:
            self._read_joints()  # a robot that tells nothing is told before the motion, not after it
        self._before = self._station.recording  # which may hold why an earlier one failed
        self._station.record(self.folder / FRAMES)
        self._thread.start()

    def end(self) -> None:
        """End it, and wait until its files are whole."""
        self._asked.set()
        if self.running:
            self._thread.join()

    def look(self) -> None:
        """Take what is new of pictures and joints."""
        shown = self._station.shown
        if self._writing and shown is not None and shown is not self._shown:
            self._shown = shown
            self.watch.add_pictures(shown)
        if self._read_joints is None:
            return
        try:
            self.watch.add_reading(self._read_joints())
            self.silent = ""
        except ArmsightError as error:
            self.silent = str(error)

    def _run(self) -> None:
        try:
            self._record()
        except Exception as error:  # a thread's death would go unseen, and the page wait for it
            self.failure = f"{type(error).__name__}: {error}"
        self._write_log()

    def _record(self) -> None:
        begun_s, asked_s = self._clock.now_s(), None
        while True:
            state = self._station.recording
            if state.file == self.folder / FRAMES:
                self._writing, self.dropped = True, state.n_dropped
            elif self._writing or (state.failure and state is not self._before):
                self.failure = state.failure or ("" if asked_s is not None else self._ended_by_itself())
                return
            self.look()
            now_s = self._clock.now_s()
            if self._asked.is_set() and asked_s is None:
                asked_s = now_s
                self._station.record(None)
            if not self._writing and now_s - begun_s > BEGIN_S:
                self._station.record(None)
                self.failure = "The cameras' pictures were not written. Look at the cameras, then record again"
                return
            if asked_s is not None and now_s - asked_s > END_S:
                self.failure = "The recording was not closed in time. What is in it may not be whole"
                return
            self._asked.wait(LOOK_S) if asked_s is None else self._clock.sleep_until(now_s + LOOK_S)

    def _ended_by_itself(self) -> str:
        why = self._station.failure
        return f"The recording ended by itself{f': {why}' if why else ', or was ended on the page Live'}"

    def _write_log(self) -> None:
        if not self.watch.readings:
            return
        t, q = zip(*self.watch.readings, strict=True)
        try:
            write_joints(self.folder / LOG, Motion(t_s=np.array(t), q=np.array(q)))
        except ArmsightError as error:
            self.failure = self.failure or str(error)
