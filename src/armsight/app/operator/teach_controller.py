"""A path taught before the measuring station: recorded beside the page, so that a page loaded anew loses nothing."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from armsight.app.live.station import MeasurementProcess, Snapshot
from armsight.app.operator.robot_cell import RobotCell, read_placement
from armsight.app.operator.station_observer import Snapshots, StationFollower
from armsight.clock import Clock
from armsight.control.teach import CarriedRig, PathRecorder, RigPose, StandingRig, Teaching
from armsight.errors import NotEnoughData
from armsight.measure.poses.moments import require_rotation
from armsight.ops.measurement.run import target_of
from armsight.ops.teaching import NOT_TAUGHT, Lesson, at_tip
from armsight.records.motion import JointHistory
from armsight.store.cell_file import CellFile, cell_path
from armsight.store.handeye_file import read_tip

FOLDER = "taught"
EVERY = 5
"""Frames of which a pose is the mean."""


class TeachController(StationFollower):
    """Records the tip's path in world while the target is led along, by hand or by the robot's jog keys."""

    does = "teaching"

    def __init__(
        self,
        folder: Path,
        cell: CellFile,
        robot: RobotCell,
        station: Callable[[], MeasurementProcess | None],
        clock: Clock,
    ) -> None:
        """station: asked anew each time, as it may be replaced. Raises BadFile; NotEnoughData where the cameras'
        position is not known, UsageError of a target without rotation."""
        super().__init__(Snapshots(station, clock), robot)
        self.out = folder / FOLDER
        target = cell_path(folder, cell.target, "target")
        if target is not None:
            require_rotation(target_of(target), NOT_TAUGHT)
        tip = cell_path(folder, cell.tip, "tip")
        T_target_tip = at_tip(None if tip is None else read_tip(tip).tip_m)
        rig_pose = _rig_pose(folder, cell, robot, self._history)
        self.recorder = PathRecorder(rig_pose, T_target_tip, every=EVERY, mean=True)
        self._points = 0
        self.follow()

    @property
    def recording(self) -> bool:
        """Whether poses are taken."""
        return self.recorder.state is Teaching.RECORDING

    @property
    def lost(self) -> int:
        """Frames that were not taken."""
        counts = self.recorder.counts
        return counts.lost + counts.doubtful + counts.position_only + counts.unplaced

    def start(self) -> None:
        """Record until the pause."""
        self._points = 0
        self.recorder.start()

    def pause(self) -> None:
        """Record no more."""
        self._points = 0
        self.recorder.pause()

    def point(self) -> None:
        """Take one pose, the mean of the next frames: hold the target still."""
        if not self.recording:
            self._points = len(self.recorder) + 1
            self.recorder.start()

    def save(self) -> Path:
        """Write path.csv and targets.csv, and return the former. Raises NotEnoughData for less than two poses."""
        self.recorder.pause()
        Lesson(self.recorder, self.out).save()
        return self.out / "path.csv"

    def _take(self, shown: Snapshot) -> None:
        self.recorder.observe(shown.pose, shown.pose.t_s)
        if self._points and len(self.recorder) >= self._points:
            self.pause()


def _rig_pose(folder: Path, cell: CellFile, robot: RobotCell, history: JointHistory) -> RigPose:
    """Return where the rig is in world at a moment."""
    arm = robot.session.arm
    placement = read_placement(folder, cell, target=cell.on_robot)
    placed = placement.rig_pose(arm, robot.joints())
    if placed is None or arm is None:
        raise NotEnoughData(
            "where the cameras are before the robot is not known",
            consequence="A path taught now could not be run",
            cure="Calibrate hand-eye first, on the page Calibrate",
        )
    if cell.on_robot and placement.handeye is not None:
        return CarriedRig(arm=arm, history=history, T_flange_rig=placement.handeye.T_parent_camera)
    # a view is in the rig's axes, or, where world.yaml is there, already in those of its frame
    return StandingRig(T_world_rig=placement.world_parent(arm) if cell.world else placed)
