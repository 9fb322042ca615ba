"""The mirrors' alignment, live, while a person turns their screws before a board: `calibrate mirrors --check`."""

from __future__ import annotations

import threading
from collections import deque
from dataclasses import dataclass, field
from pathlib import Path

from armsight.app.live.station import MeasurementProcess
from armsight.calibrate.mirrors.diagnosis import APART, STILL, MirrorTurn
from armsight.calibrate.mirrors.result import MirrorCheckOutput, check_output
from armsight.drivers import read_image
from armsight.errors import UsageError
from armsight.ops.calibration.board_images import see_two_boards
from armsight.ops.calibration.board_pictures import BoardPictures
from armsight.ops.calibration.mirrors import AlignmentWatch, reference_of
from armsight.records import Frame, NotSeen
from armsight.store import parse_board, read_camera, read_rig
from armsight.store.cell_file import COMPLEX, CellMirrors

LOOKS = 120
"""Looks kept for the plot: two minutes at one a second."""
BACK = 4
"""Looks that an answer rests on: with fewer a small board tells too little, with more it would lag behind the screw."""
FINE_RAD = 5e-4
"""A turn smaller than this is finer than a screw is set by hand: half a pixel at a focal length of 1000 px."""
COARSE_RAD = 5e-4
"""Standard deviation of an angle between the axes from which it is not said that nothing is left to turn: a turn of
FINE_RAD makes an angle of twice as much, two of these."""


@dataclass(frozen=True, slots=True, kw_only=True)
class MirrorState:
    """How the mirrors stand. check: as the command tells it, None where the board was not seen, and why in words.

    turns: what is to be done, mirror by mirror, each by how much it is to be turned; empty where nothing is. others:
    mirrors that may have moved in place of the one that is named. several: more than one mirror has moved.
    """

    number: int
    check: MirrorCheckOutput | None = None
    why: str = ""
    turns: tuple[MirrorTurn, ...] = ()
    others: tuple[int, ...] = ()
    several: bool = False

    @property
    def std_rad(self) -> float:
        """The largest standard deviation of the three angles between the axes; NaN where the board was not seen."""
        if self.check is None:
            return float("nan")
        std = self.check.change_std
        return max(std.drx_rad, std.dry_rad, std.drz_rad)

    @property
    def unsure(self) -> bool:
        """Whether nothing is seen to be turned, and too little is told for it to be said."""
        return self.check is not None and not self.turns and self.std_rad > COARSE_RAD

    @property
    def done(self) -> bool:
        """Whether the mirrors stand as they should, and are known well enough for it to be said."""
        return self.check is not None and not self.turns and not self.unsure


@dataclass(slots=True, kw_only=True)
class MirrorAlignment:
    """Looks at the picture of now, again and again.

    built: how the mirrors were built. With a rig they are held against how they were calibrated, where not parallel
    axes are asked for; else, with the lens and the baseline as designed, against these. folder: takes the picture of
    now.
    """

    board: str
    built: CellMirrors
    folder: Path
    rig: Path | None = None
    camera: Path | None = None
    parallel: bool = False
    looks: deque[MirrorState] = field(default_factory=lambda: deque(maxlen=LOOKS))
    _watch: AlignmentWatch | None = None
    _count: int = 0
    _lock: threading.Lock = field(default_factory=threading.Lock)

    @property
    def to_parallel(self) -> bool:
        """Whether the mirrors are held against parallel axes."""
        return self.parallel or self.rig is None

    @property
    def possible(self) -> bool:
        """Whether there is anything to hold the mirrors against: a rig, or the lens and the baseline as designed."""
        return self.rig is not None or (self.camera is not None and self.built.baseline_m is not None)

    def look(self, station: MeasurementProcess) -> MirrorState:
        """Return how the mirrors stand now. Raises UsageError where too little is known, DataRefused, DeviceFailed."""
        if not station.job.complex:
            raise UsageError("the cell has two cameras, and no mirrors", cure="Give one camera on the page Settings")
        with self._lock:
            return self._look(station)

    def _look(self, station: MeasurementProcess) -> MirrorState:
        board = parse_board(self.board)
        if self._watch is None:
            rig = None if self.rig is None else read_rig(self.rig)
            camera = None if self.camera is None else read_camera(self.camera)
            reference = reference_of(self.built, rig, camera, parallel=self.parallel)
            self._watch = AlignmentWatch(reference=reference, board=board, back=BACK)
        file = self.folder / "now.png"
        station.save({COMPLEX: file})
        self._count += 1
        frame = Frame(image=read_image(file), t_s=float(self._count), sequence=self._count, source="the picture")
        file.unlink(missing_ok=True)
        seen = see_two_boards(frame, board, BoardPictures())
        if isinstance(seen, NotSeen):
            stand = MirrorState(number=self._count, why=seen.why)
        else:
            stand = stand_of(self._count, check_output(self._watch.see(seen), ()))
        self.looks.append(stand)
        return stand

    def hold_against(self, *, parallel: bool) -> None:
        """Hold the mirrors against parallel axes from now on, or against the rig as it was calibrated."""
        with self._lock:
            self.parallel = parallel
            self._watch = None
            self.looks.clear()


def stand_of(number: int, check: MirrorCheckOutput) -> MirrorState:
    """Return what is to be turned by what a check tells; a suspect is turned back, fine turns are left."""
    if check.turns is not None:
        turns = tuple(turn for turn in check.turns if check.moved and _large(turn))
    elif check.suspects:
        best, *rest = check.suspects
        turns = (MirrorTurn(mirror=best.mirror, turn_rad=-best.turn_rad, tilt_rad=-best.tilt_rad),)
        others = tuple(one.mirror for one in rest if one.chi2 - best.chi2 <= APART)
        several = not others and best.chi2 > 4.0 * STILL
        return MirrorState(number=number, check=check, turns=turns, others=others, several=several)
    else:
        turns = ()
    return MirrorState(number=number, check=check, turns=turns)


def _large(turn: MirrorTurn) -> bool:
    return max(abs(turn.turn_rad), abs(turn.tilt_rad)) >= FINE_RAD
