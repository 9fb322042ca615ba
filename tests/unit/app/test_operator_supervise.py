"""The arm supervised from the operator's page, before a station and a robot of the test's own."""

from __future__ import annotations

import json
import threading
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from armsight.app.operator.robot_cell import prepare_simulated
from armsight.app.operator.supervise import Levels, StationSupervisor
from armsight.errors import NotEnoughData, UsageError
from armsight.ops.requests.motion import RobotJob
from armsight.records import JointReading, PoseStatus, TargetPose
from armsight.store.arm_file import read_arm
from armsight.store.cell_file import read_cell
from armsight.store.handeye_file import read_handeye
from armsight.units import MM
from armsight.verify.supervision import Level, Limits
from armsight_plant.state import PlantState, conditions
from refusals import refuses

HOME = np.deg2rad([0.0, -60.0, 90.0, -30.0, 90.0, 0.0])
STD = (1e-4, 1e-4, 1e-4, 1e-3, 1e-3, 1e-3)


def levels(warn_mm: float, stop_mm: float) -> Limits:
    return Levels(warn_m=warn_mm * MM, stop_m=stop_mm * MM).limits


class Cell:
    """A robot that stands at HOME and tells it 100 times a second; its cameras see the target off by so much."""

    def __init__(self, folder) -> None:
        self.folder = folder
        arm, handeye = read_arm(folder / "arm.yaml"), read_handeye(folder / "handeye.yaml")
        T_flange = RigidTransform.from_matrix(arm.fk(HOME)) * arm.T_flange_tool.inv()
        T_world_rig = arm.T_world_base * handeye.T_parent_camera
        self.T_rig_target = T_world_rig.inv() * T_flange * handeye.T_parent_target
        self.t_s, self.stops = 10.0, []
        host = SimpleNamespace(status=self.status)
        authority = SimpleNamespace(robot=SimpleNamespace(cycle_s=0.01))
        session = SimpleNamespace(arm=arm, stop=self.stops.append)
        self.robot = SimpleNamespace(
            service=SimpleNamespace(host=host, authority=authority), session=session, joints=lambda: HOME.copy()
        )
        self.station = SimpleNamespace(shown=None)
        self.number, self.heard = 0, threading.Event()

    def status(self):
        self.t_s += 0.01
        if self.t_s > 10.05:  # some readings are there
            self.heard.set()
        return SimpleNamespace(reading=JointReading(t_s=self.t_s, q=HOME, sequence=0, source="test"))

    def show(self, supervisor, off_m=(0.0, 0.0, 0.0), status="ok", times=1):
        """Show moments, each once the one before was taken."""
        for _ in range(times):
            self.number += 1
            n = supervisor.state.n
            T = RigidTransform.from_translation(off_m) * self.T_rig_target
            pose = TargetPose(
                t_s=self.t_s,
                status=PoseStatus(status),
                parent="rig",
                why="a hand is before it",
                **(
                    {}
                    if status == "lost"
                    else {"T_parent_target": T.as_matrix(), "covariance": np.diag(np.square(STD))}
                ),
            )
            self.station.shown = SimpleNamespace(pose=pose, view=SimpleNamespace(t_s=self.t_s, sequence=self.number))
            pause = threading.Event()
            for _ in range(2000):
                if supervisor.state.n > n:
                    break
                pause.wait(0.005)
            assert supervisor.state.n > n

    def supervised(self, warn_mm=2.0, stop_mm=5.0):
        run = StationSupervisor(
            self.folder, read_cell(self.folder), self.robot, lambda: self.station, levels(warn_mm, stop_mm)
        )
        assert self.heard.wait(10.0)
        return run


@pytest.fixture
def cell(tmp_path):
    prepare_simulated(RobotJob(robot="sim:webcam-cell"), tmp_path / "cell")
    return Cell(tmp_path / "cell")


def test_an_arm_that_is_where_it_says_raises_nothing_and_one_that_is_not_is_stopped(cell):
    run = cell.supervised()
    cell.show(run, times=4)
    assert run.state.level is Level.GOOD and run.state.compared.error_m == pytest.approx(0.0, abs=1e-9)
    assert run.seen.in_tolerance is True
    cell.show(run, off_m=(0.0, 0.0035, 0.0), times=3)
    assert run.state.level is Level.WARN and not cell.stops
    assert run.seen.in_tolerance is False and run.seen.why == run.state.why
    assert run.state.compared.error_m == pytest.approx(3.5e-3, abs=1e-9) and "2 mm" in run.state.why
    cell.show(run, off_m=(0.0, 0.009, 0.0), times=2)
    assert run.state.level is Level.STOP and len(cell.stops) == 1 and cell.stops[0].who == "supervision"
    done = run.end()
    assert done.stopped and done.level == "stop" and done.n_compared == done.n == 9
    assert {path.name for path in run.out.iterdir()} == {"verify.json", "errors.csv", "report.html"}
    assert json.loads((run.out / "verify.json").read_text())["errors"]["max_m"] == pytest.approx(0.009, abs=1e-6)


def test_cameras_that_show_nothing_from_the_beginning_make_the_plant_blind(cell):
    run = cell.supervised()
    assert run.seen.in_tolerance is None and run.seen.lost
    told = PlantState(source="", made_s=run.seen.at_s + 2.0, made_unix_s=0.0, why="x", seen=run.seen, measures=True)
    assert {one.name for one in conditions(told)} == {"robot", "blind"}
    cell.show(run)
    assert run.seen.in_tolerance is True
    run.end()


def test_a_target_that_is_hidden_is_told_and_compared_with_nothing(cell):
    run = cell.supervised()
    cell.show(run)
    cell.show(run, status="lost", times=2)
    state = run.state
    assert state.compared is None and "a hand" in state.why and not cell.stops
    assert run.seen.in_tolerance is None and "a hand" in run.seen.lost
    assert run.end().n_compared == 1


def test_without_a_stop_level_the_robot_is_never_stopped(cell):
    run = cell.supervised(stop_mm=0.0)
    cell.show(run, off_m=(0.05, 0.0, 0.0), times=3)
    assert run.state.level is Level.WARN and not cell.stops
    run.end()


def test_what_cannot_be_supervised_is_refused(cell):
    with pytest.raises(UsageError, match="above"):
        levels(5.0, 2.0)
    unplaced = read_cell(cell.folder).model_copy(update={"handeye": ""})
    with refuses(NotEnoughData, "not known"):
        StationSupervisor(cell.folder, unplaced, cell.robot, lambda: cell.station, levels(1.0, 2.0))
    carried = read_cell(cell.folder).model_copy(update={"cameras": "carried"})
    with refuses(UsageError, "ride"):
        StationSupervisor(cell.folder, carried, cell.robot, lambda: cell.station, levels(1.0, 2.0))
    run = cell.supervised()
    with refuses(NotEnoughData, "showed"):
        run.end()
