"""A path on the page: changed step by step, each of which can be undone, checked for the arm, and played."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType

import numpy as np

from armsight.app.live.station import Station
from armsight.app.operator.job_runner import BackgroundJob
from armsight.app.operator.robot_cell import RobotCell
from armsight.app.operator.session_robot import SessionRobot
from armsight.app.operator.watched import watcher_of
from armsight.app.path.check import check
from armsight.app.play.run import run_play
from armsight.app.requests.motion import PlayJob
from armsight.app.schemas.paths import PathCheckOutput
from armsight.app.schemas.play import PlayOutput
from armsight.clock import SystemClock
from armsight.control.paths import offset_along_tool, resampled, reversed_path, smoothed, tilted, without_rows
from armsight.control.play import PathSource
from armsight.errors import NotEnoughData, UsageError
from armsight.records import TaughtPath
from armsight.store.cell_file import CellFile, cell_path
from armsight.store.path_file import read_path, write_path
from armsight.units import DEG, MM

WORK = "play"
FILE = "path.csv"
STEPS_KEPT = 50
TOOLS: Mapping[str, str] = MappingProxyType(
    {"resample": "mm", "smooth": "mm", "offset": "mm", "angle": "deg", "reverse": ""}
)
"""What can be done to a path, and the unit of its figure."""


class PathDesk:
    """The path of a cell, in FOLDER/path.csv once it is kept."""

    def __init__(self, folder: Path) -> None:
        """Take the path that the folder holds, if any. Raises BadFile."""
        self._folder = folder
        self._file = folder / FILE
        self._path: TaughtPath | None = read_path(self._file) if self._file.is_file() else None
        self._before: list[TaughtPath] = []
        self.source: PathSource | None = None

    @property
    def path(self) -> TaughtPath | None:
        """The path as it stands; None where none was taught."""
        return self._path

    @property
    def changes(self) -> int:
        """How many changes can be undone."""
        return len(self._before)

    def load(self, file: Path) -> None:
        """Take the path of another file; this can be undone. Raises BadFile."""
        self._replace(read_path(file))

    def delete(self, rows: list[int]) -> None:
        """Take rows out. Raises NotEnoughData where fewer than two stay, Inconsistent for a tag that has no room."""
        self._replace(without_rows(self.require(), rows))

    def change(self, tool: str, value: float) -> None:
        """Use a tool of TOOLS with a figure in its unit. Raises UsageError, Inconsistent, Degenerate."""
        path = self.require()
        match tool:
            case "resample":
                self._replace(resampled(path, value * MM))
            case "smooth":
                self._replace(smoothed(path, bound_m=value * MM))
            case "offset":
                self._replace(offset_along_tool(path, value * MM))
            case "angle":
                self._replace(tilted(path, travel_rad=value * DEG))
            case "reverse":
                self._replace(reversed_path(path))
            case _:
                raise UsageError(f"{tool!r} is no tool for paths", cure=f"Use {', '.join(TOOLS)}")

    def undo(self) -> None:
        """Take the last change back; nothing happens where there is none."""
        if self._before:
            self._path = self._before.pop()
            write_path(self._file, self._path)

    def require(self) -> TaughtPath:
        """Return the path. Raises NotEnoughData where none was taught."""
        if self._path is None:
            raise NotEnoughData("there is no path yet", consequence="Nothing is done", cure="Teach one first")
        return self._path

    def _replace(self, path: TaughtPath) -> None:
        write_path(self._file, path)
        if self._path is not None:
            self._before = [*self._before[-STEPS_KEPT:], self._path]
        self._path = path


@dataclass(frozen=True, slots=True, kw_only=True)
class PlayRequest:
    """How the path is run: its speed where it leaves that open, rounding of corners, and whether the tool is turned."""

    folder: Path
    cell: CellFile
    speed_mm_s: float = 10.0
    blend_mm: float = 3.0
    keep_rotation: bool = False


def check_path(asked: PlayRequest, robot: RobotCell) -> PathCheckOutput:
    """Check the path for the arm from where it stands; write path-check.html. Raises as app.path.check."""
    start = ",".join(repr(value) for value in robot.joints().tolist())
    limits = cell_path(asked.folder, asked.cell.limits, "limits")
    return check(
        asked.folder / FILE,
        str(_arm(asked)),
        limits=limits,
        speed_m_s=asked.speed_mm_s * MM,
        start=start,
        out=asked.folder / "path-check.html",
    )


def play(
    asked: PlayRequest, robot: RobotCell, desk: PathDesk, station: Station | None, work: BackgroundJob
) -> PlayOutput:
    """Run the path while the operator holds the enable, at the seat's override; station: watches it where it can.

    Raises as run_play.
    """
    desk.require()
    clock = SystemClock()
    seat = robot.seat
    moved = SessionRobot(seat, lambda: work.browser, clock, waits=False, cancelled=work.cancelled)
    job = PlayJob(
        robot=robot.robot,
        path=asked.folder / FILE,
        out=asked.folder / time.strftime("played-%Y%m%d-%H%M%S"),
        arm=_arm(asked),
        limits=cell_path(asked.folder, asked.cell.limits, "limits"),
        override=seat.override,
        path_speed_m_s=asked.speed_mm_s * MM,
        blend_m=asked.blend_mm * MM,
        keep_rotation=asked.keep_rotation,
        retract_m=0.0,
    )

    def begun(source: PathSource) -> None:
        desk.source = source

    def follow_override(*_: object) -> None:
        if desk.source is not None and not np.isclose(desk.source.override, seat.override):
            desk.source.override = seat.override

    try:
        return run_play(
            job,
            work.ask,
            follow_override,
            work,
            opened=(moved, clock, watcher_of(asked.folder, asked.cell, seat.arm, station, clock)),
            begun=begun,
            enabled=lambda: seat.enabled(work.browser),
        )
    finally:
        desk.source = None


def _arm(asked: PlayRequest) -> Path:
    arm = cell_path(asked.folder, asked.cell.arm, "arm")
    if arm is None:
        raise NotEnoughData("the cell has no arm yet", consequence="Nothing is moved", cure="See the page Settings")
    return arm
