"""The arm supervised from the page: the target as the station sees it, beside where the joints say it is."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import numpy as np

from armsight.app.live.station import MeasurementProcess, Snapshot
from armsight.app.operator.robot_cell import RobotCell, read_placement
from armsight.app.operator.station_observer import Snapshots, StationFollower
from armsight.calibrate.cameras.pairing import turns_of
from armsight.clock import SystemClock
from armsight.control.session.operator_session import Person
from armsight.defaults import BLIND_S, JOINT_STD, LATENCY_STD_S
from armsight.errors import NotEnoughData, StaleData, UsageError
from armsight.fields import Bounds
from armsight.measure.poses.moments import require_rotation
from armsight.ops.measurement.run import target_of
from armsight.ops.saving import write_with_page
from armsight.ops.verification.live import NOT_SUPERVISED
from armsight.ops.verification.supervising import Judge
from armsight.records import PoseStatus, TargetPose
from armsight.store.cell_file import CellFile, cell_path
from armsight.units import DEG, MM
from armsight.verify.live import VerifyLiveOutput, live_output
from armsight.verify.supervision import Compared, Level, Limits, PredictedPose, Seen

KEPT = 90_000
"""Moments kept for the files: the newest hour at 25 a second."""
SHOWN = 600
"""Moments kept for the curves of a page."""
NO_LEVEL_BELOW_0 = Bounds(least=0.0)
SUPERVISION = Person(who="supervision")
DOUBTS = (
    "where the cameras and the target are is of the hand-eye calibration, whose uncertainty is not counted",
    "the station shows some 25 moments a second: an error shorter than that may pass unseen",
)


@dataclass(frozen=True, slots=True, kw_only=True)
class SupervisedState:
    """What a page shows: the level so far, moments seen, the newest comparison, None where nothing was, and why."""

    level: Level
    n: int
    compared: Compared | None
    why: str


class StationSupervisor(StationFollower):
    """Compares every moment that the station shows, raises levels, and stops the robot beyond one that says so."""

    does = "supervising"

    def __init__(
        self,
        folder: Path,
        cell: CellFile,
        robot: RobotCell,
        station: Callable[[], MeasurementProcess | None],
        limits: Limits,
    ) -> None:
        """Begin at once. Raises UsageError for carried cameras, NotEnoughData where cameras or target have no place on
        the robot, BadFile.
        """
        super().__init__(Snapshots(station, SystemClock()), robot)
        self._session = robot.session
        self._expectation = _expectation(folder, cell, robot)
        self.out = folder / time.strftime("supervised-%Y%m%d-%H%M%S")
        # with world.yaml the station's poses are in its frame, of the world or of the arm's base
        placement = read_placement(folder, cell, target=False)
        self._T_world_shown = placement.world_parent(self._expectation.arm) if cell.world else None
        self._judge = Judge(limits, lambda: self._session.stop(SUPERVISION))
        self._last: tuple[Compared | None, str] = (None, "")
        self._compared_s = time.monotonic()
        self.curve: deque[tuple[float, float, float]] = deque(maxlen=SHOWN)
        self.follow()

    @property
    def seen(self) -> Seen:
        """The newest moment, for the plant's systems; that no picture came yet makes them blind too."""
        return self._judge.seen

    @property
    def state(self) -> SupervisedState:
        """How far off the arm is."""
        compared, lost = self._last
        why = self._judge.why or ("" if compared is not None else lost)
        return SupervisedState(level=self._judge.level, n=len(self._judge.log.rows), compared=compared, why=why)

    def end(self) -> VerifyLiveOutput:
        """End it; write verify.json, errors.csv and report.html. Raises NotEnoughData where nothing was seen."""
        self.close()
        if not self._judge.log.rows:
            raise NotEnoughData("the cameras showed nothing", consequence="Nothing was supervised")
        done = live_output(self._judge.log, recording="", doubts=DOUBTS)
        write_with_page(self.out, done)
        return done

    def _look(self) -> None:
        if self._snapshots.silent_s > BLIND_S:
            self._last = (None, "no pictures come")

    def _take(self, shown: Snapshot) -> None:
        begun_s = time.perf_counter()
        pose, judge = shown.pose, self._judge
        compared, lost = self._compared(pose)
        alarm = None if compared is None else judge.add(compared)
        ms = (time.perf_counter() - begun_s) * 1e3
        self._last = (compared, lost)
        self._compared_s = self._compared_s if compared is None else time.monotonic()
        blind = time.monotonic() - self._compared_s > BLIND_S
        judge.show(pose, compared, lost, alarm, at_s=pose.t_s, blind=blind)
        if compared is not None:
            self.curve.append((compared.t_s, compared.error_m / MM, compared.error_rad / DEG))
        judge.log.add(shown.view.sequence, pose, compared, judge.level, lost, ms)
        # a tenth at once: to shift the list by one with every picture would cost more each hour
        if len(judge.log.rows) > KEPT:
            del judge.log.rows[: KEPT // 10]

    def _compared(self, pose: TargetPose) -> tuple[Compared | None, str]:
        if pose.status is not PoseStatus.OK or pose.T_parent_target is None:
            return None, pose.why or "the target is not seen whole"
        expectation = self._expectation
        if self._T_world_shown is not None:
            expectation = replace(expectation, T_parent_rig=self._T_world_shown)
        try:
            return expectation.compare(pose, self._history.at(pose.t_s)), ""
        except StaleData as error:
            return None, error.cause


def _expectation(folder: Path, cell: CellFile, robot: RobotCell) -> PredictedPose:
    if cell.on_robot:
        raise UsageError("the cameras ride on the arm", cure="Supervise with cameras that stand beside it")
    target, turns = cell_path(folder, cell.target, "target"), np.eye(4)[None]
    if target is not None:
        seen = target_of(target)
        require_rotation(seen, NOT_SUPERVISED)
        turns = turns_of(seen)
    arm, T_world_rig = read_placement(folder, cell).on_robot(robot.session.arm, "Nothing is supervised")
    return PredictedPose(arm=arm, T_parent_rig=T_world_rig, joint_std=JOINT_STD, time_std_s=LATENCY_STD_S, turns=turns)


@dataclass(frozen=True, kw_only=True)
class Levels:
    """The levels that a page proposes, which asks for none of rotation; 0: none."""

    warn_m: Annotated[float, NO_LEVEL_BELOW_0] = 2.0 * MM
    stop_m: Annotated[float, NO_LEVEL_BELOW_0] = 5.0 * MM

    @property
    def limits(self) -> Limits:
        """As the supervision takes them. Raises UsageError where the arm would stop before it warns."""
        return Limits(warn_m=self.warn_m or None, stop_m=self.stop_m or None)
