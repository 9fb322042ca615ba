"""The taught path of a cell: its changes, its playback at the page's enable, and the cameras that watch it."""

from __future__ import annotations

import time
from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType
from typing import Annotated

import numpy as np
from scipy.spatial.transform import RigidTransform

from armsight.app.live.station import MeasurementProcess, Snapshot
from armsight.app.operator.job_runner import BackgroundJob
from armsight.app.operator.robot_cell import RobotCell, read_placement
from armsight.app.operator.station_observer import Snapshots, StationFollower
from armsight.clock import Clock, SystemClock
from armsight.control.paths import offset_along_tool, resampled, reversed_path, smoothed, tilted, without_rows
from armsight.control.play import PathSource
from armsight.control.status import QueueSink
from armsight.defaults import PATH_SPEED_M_S
from armsight.errors import ArmsightError, DeviceFailed, NotEnoughData, UsageError
from armsight.ops.measurement.outputs import moved_pose
from armsight.ops.motion import play
from armsight.ops.path.check import PathCheckOutput, checked
from armsight.ops.play.play_job import Seen, WatchedRobot, sight_of
from armsight.ops.play.play_path import PlayOutput
from armsight.ops.requests.motion import ABOVE_0
from armsight.records import PoseStatus, TaughtPath
from armsight.store.cell_file import CellFile, cell_path
from armsight.store.handeye_file import HandEyeFile
from armsight.store.path_file import read_path, write_path
from armsight.units import DEG, MM

SILENT_S = 2.0
"""A station that shows nothing new for so long does not watch any more."""


class StationWatcher(StationFollower):
    """The measuring station as what watches a path: its poses, brought back into the rig's axes."""

    stepped = False
    does = "watching"

    def __init__(
        self, station: MeasurementProcess, handeye: HandEyeFile, T_rig_parent: RigidTransform, clock: Clock
    ) -> None:
        """T_rig_parent: of the frame that the station's poses are in, seen from the rig."""
        super().__init__(Snapshots(lambda: station, clock))
        self.sight = sight_of(handeye)
        self._T_rig_parent = T_rig_parent
        self._counts = dict.fromkeys(PoseStatus, 0)
        self._failed: ArmsightError | None = None

    def open(self, stack: ExitStack, sink: QueueSink, seen: Seen) -> None:
        """Tell what the station shows until stack ends."""
        self._sink, self._seen = sink, seen
        self.follow()
        stack.callback(self.close)

    def counts(self) -> Mapping[PoseStatus, int]:
        """Return the moments so far by what they showed."""
        return dict(self._counts)

    def failed(self) -> ArmsightError | None:
        """Return why nothing is watched any more."""
        return self._failed

    def contradiction(self) -> str:
        """Return nothing: the station's cameras are a pair, which cannot tell which of them is wrong."""
        return ""

    def _look(self) -> None:
        if self._snapshots.failure or self._snapshots.silent_s > SILENT_S:
            why = self._snapshots.failure or "no pictures come any more"
            self._failed = DeviceFailed(
                f"{why} while the path was played",
                consequence="The robot is held: nobody watched it",
                cure="Look at the cameras, then play again",
            )
            self._ended.set()

    def _take(self, shown: Snapshot) -> None:
        if self._failed is not None:
            return
        pose = shown.pose
        if pose.T_parent_target is not None:
            pose = moved_pose(pose, self._T_rig_parent, "rig")
        exposed_s = shown.view.t_s  # monotonic time is one for all processes of a machine
        self._counts[pose.status] += 1
        self._seen(pose, exposed_s)
        self._sink.pose(replace(pose, t_s=exposed_s))


def watcher_of(folder: Path, cell: CellFile, station: MeasurementProcess | None, clock: Clock) -> StationWatcher | None:
    """Return what watches the cell's robot; None without cameras, or where their position on it is not known.

    Raises BadFile.
    """
    if station is None or station.job.rig is None:
        return None
    placement = read_placement(folder, cell)
    if placement.handeye is None:
        return None
    # with world.yaml the station's poses are in its frame
    T_parent_rig = RigidTransform.identity() if placement.world is None else placement.world.T_parent_rig
    return StationWatcher(station, placement.handeye, T_parent_rig.inv(), clock)


JOB_NAME = "play"
FILE = "path.csv"
STEPS_KEPT = 50
TOOLS: Mapping[str, str] = MappingProxyType(
    {"resample": "mm", "smooth": "mm", "offset": "mm", "angle": "deg", "reverse": ""}
)
"""What can be done to a path, and the unit of its figure."""


class PathEditor:
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


@dataclass(frozen=True, kw_only=True)
class PlayRequest:
    """How the path is run: its speed where it leaves that open, and whether the tool keeps its rotation.

    A page proposes that it does: it teaches with a target whose axes are seldom the tool's.
    """

    folder: Path
    cell: CellFile
    speed_m_s: Annotated[float, ABOVE_0] = PATH_SPEED_M_S
    keep_rotation: bool = True


def check_path(asked: PlayRequest, robot: RobotCell, editor: PathEditor) -> PathCheckOutput:
    """Check the path for the arm from where it stands; write path-check.html. Raises as ops.path.check."""
    arm = robot.session.arm
    if arm is None:
        raise NotEnoughData("the robot's arm is not known", consequence="Its path is not checked")
    found = checked(
        editor.require(),
        arm,
        robot.limits,
        speed_m_s=asked.speed_m_s,
        start=robot.joints(),
        keep_rotation=asked.keep_rotation,
        page_of=FILE,
    )
    found.write(asked.folder / "path-check.html")
    return found


def play_path(
    asked: PlayRequest,
    robot: RobotCell,
    editor: PathEditor,
    station: MeasurementProcess | None,
    background: BackgroundJob,
) -> PlayOutput:
    """Run the path while the operator holds the enable, at the session's override; station: watches it where it can.

    Raises as ops.motion.play.
    """
    path = editor.require()
    clock, session = SystemClock(), robot.session
    moved = background.robot(session, clock, waits=False)

    def begun(source: PathSource) -> None:
        editor.source = source

    def follow_override(*_: object) -> None:
        if editor.source is not None and not np.isclose(editor.source.override, session.override):
            editor.source.override = session.override

    watcher = watcher_of(asked.folder, asked.cell, station, clock)
    try:
        return play(
            WatchedRobot(robot=moved, clock=clock, called=robot.robot, watcher=watcher),
            path,
            confirm=background.ask,
            out=asked.folder / time.strftime("played-%Y%m%d-%H%M%S"),
            limits=cell_path(asked.folder, asked.cell.limits, "limits"),
            override=session.override,
            path_speed_m_s=asked.speed_m_s,
            keep_rotation=asked.keep_rotation,
            show=follow_override,
            begun=begun,
            enabled=lambda: session.enabled(background.browser),
            progress=background,
        )
    finally:
        editor.source = None
