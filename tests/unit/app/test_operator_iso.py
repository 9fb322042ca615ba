"""An ISO 9283 run of the operator's page: planned before the cameras, made by a robot of the test's own, and judged."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.app.operator import iso_run
from armsight.app.operator.iso_run import IsoRequest
from armsight.app.operator.robot_cell import prepare_simulated
from armsight.clock import ManualClock
from armsight.drivers import RobotState, Sent
from armsight.errors import NotEnoughData
from armsight.ops.requests.motion import RobotJob
from armsight.records import JointReading, PoseStatus, Silent, TargetPose
from armsight.store.arm_file import read_arm
from armsight.store.cell_file import read_cell
from armsight.store.handeye_file import read_handeye
from refusals import refuses

HOME = np.deg2rad([0.0, -60.0, 90.0, -30.0, 90.0, 0.0])
SCATTER_M, OFF_M = 60e-6, np.array([0.4e-3, 0.0, -0.3e-3])
CAMERA_M = 20e-6


class Robot:
    """Goes where it is told; where it really stands scatters anew at each place, and is off by OFF_M."""

    name, n_joints, cycle_s = "test", 6, 0.02
    takes_joints, takes_poses, guarded = True, False, True

    def __init__(self, clock: ManualClock, rng: np.random.Generator) -> None:
        self.q, self.clock, self.rng = HOME.copy(), clock, rng
        self.off_m = np.zeros(3)
        self.state = RobotState.READY
        self.number, self.stopped = 0, 0

    def read(self) -> JointReading:
        return JointReading(t_s=self.clock.now_s(), q=self.q, sequence=self.number, source=self.name)

    def step_joints(self, step: np.ndarray) -> Sent:
        if np.abs(step).max() > 0.0:
            self.off_m = OFF_M + self.rng.normal(0.0, SCATTER_M, 3)
        self.q = self.q + step
        self.number += 1
        return Sent(q=self.q, t_s=self.clock.now_s(), sequence=self.number, limited=())

    def stop(self) -> None:
        self.stopped += 1


class Cameras:
    """Sees the target of the arm, with noise of its own; blind: from how many looks on not."""

    def __init__(self, cell: SimpleNamespace, robot: Robot, *, blind: int = 10**9) -> None:
        self.cell, self.robot, self.blind, self.looks = cell, robot, blind, 0
        self.rng = np.random.default_rng(5)

    def observe(self, while_: str) -> tuple[float, TargetPose]:
        self.robot.clock.advance(0.033)
        self.looks += 1
        now = self.robot.clock.now_s()
        if self.looks > self.blind:
            return now, TargetPose(t_s=now, status=PoseStatus.LOST, parent="rig", why="a hand is before it")
        flange = self.cell.arm.T_world_base * RigidTransform.from_matrix(dh(self.cell.arm, self.robot.q))
        T = RigidTransform.from_translation(self.robot.off_m) * flange * self.cell.T_flange_target
        seen = self.cell.T_world_rig.inv() * T
        seen = RigidTransform.from_components(
            seen.translation + self.rng.normal(0.0, CAMERA_M, 3),
            Rotation.from_rotvec(self.rng.normal(0.0, 1e-4, 3)) * seen.rotation,
        )
        covariance = np.diag([CAMERA_M**2] * 3 + [1e-8] * 3)
        pose = TargetPose(
            t_s=now, status=PoseStatus.OK, parent="rig", T_parent_target=seen.as_matrix(), covariance=covariance
        )
        return now, pose


def dh(arm, q: np.ndarray) -> np.ndarray:
    """Standard Denavit-Hartenberg by plain products."""
    T = np.eye(4)
    for joint, value in zip(arm.joints, q, strict=True):
        c, s = np.cos(joint.theta_rad + value), np.sin(joint.theta_rad + value)
        ca, sa = np.cos(joint.alpha_rad), np.sin(joint.alpha_rad)
        T = T @ np.array(
            [
                [c, -s * ca, s * sa, joint.a_m * c],
                [s, c * ca, -c * sa, joint.a_m * s],
                [0, sa, ca, joint.d_m],
                [0, 0, 0, 1.0],
            ]
        )
    return T


@pytest.fixture(scope="module")
def cell(tmp_path_factory):
    folder = tmp_path_factory.mktemp("iso") / "cell"
    prepare_simulated(RobotJob(robot="sim:webcam-cell"), folder)
    arm, handeye = read_arm(folder / "arm.yaml"), read_handeye(folder / "handeye.yaml")
    return SimpleNamespace(
        folder=folder,
        arm=arm,
        T_flange_target=handeye.T_parent_target,
        T_world_rig=arm.T_world_base * handeye.T_parent_camera,
        robot=SimpleNamespace(session=SimpleNamespace(arm=arm, override=1.0), joints=lambda: HOME.copy()),
        asked=IsoRequest(folder=folder, cell=read_cell(folder), cycles=8, speed_m_s=0.5, frames_per_visit=3),
    )


def made(cell, tmp_path, **cameras):
    clock = ManualClock()
    robot = Robot(clock, np.random.default_rng(3))
    plan = iso_run.plan(cell.asked, cell.robot)
    visits, ended = iso_run.visited(plan, cell.asked, robot, Cameras(cell, robot, **cameras), clock, Silent())
    return plan, visits, ended, robot


def test_the_run_tells_accuracy_and_repeatability(cell, tmp_path):
    """8 visits: AP within 4 standard errors of 0.5 mm; RP is mean + 3 S of distances of such a scatter."""
    plan, visits, ended, _ = made(cell, tmp_path)
    done = iso_run.judged(plan, cell.asked, visits, ended, tmp_path / "iso")
    figures = done.output.iso9283
    assert (done.cycles, done.ended) == (8, "") and not set(iso_run.SMALL_SIDES_M) & {0.25}
    for place in ("P1", "P2", "P3", "P4", "P5"):
        one = figures[f"AP_m {place}"]
        assert one.value == pytest.approx(np.linalg.norm(OFF_M), abs=4.0 * SCATTER_M / np.sqrt(8))
        assert 1.0 * SCATTER_M < figures[f"RP_m {place}"].value < 6.0 * SCATTER_M
    assert (tmp_path / "iso" / "report.html").exists()
    assert {row[0] for row in iso_run.figures(done)} >= {"AP", "RP", "AP P1", "RP P5"}


def test_a_run_that_ends_early_is_judged_by_what_there_is(cell, tmp_path):
    plan, visits, ended, robot = made(cell, tmp_path, blind=260)
    assert "a hand" in ended and robot.stopped == 1
    done = iso_run.judged(plan, cell.asked, visits, ended, tmp_path / "iso")
    assert 3 <= done.cycles < 8 and done.ended == ended


def test_a_robot_that_is_stopped_ends_the_run(cell):
    clock = ManualClock()
    robot = Robot(clock, np.random.default_rng(3))
    robot.state = RobotState.STOPPED
    plan = iso_run.plan(cell.asked, cell.robot)
    visits, ended = iso_run.visited(plan, cell.asked, robot, Cameras(cell, robot), clock, Silent())
    assert not visits and "is stopped" in ended
    with refuses(NotEnoughData, "stopped"):
        iso_run.judged(plan, cell.asked, visits, ended, cell.folder / "never")


def test_a_robot_that_does_not_go_on_is_told(cell):
    class Stuck(Robot):
        def step_joints(self, step):
            return Sent(q=self.q, t_s=self.clock.now_s(), sequence=0, limited=("the fence",))

    clock = ManualClock()
    robot = Stuck(clock, np.random.default_rng(3))
    plan = iso_run.plan(cell.asked, cell.robot)
    _, ended = iso_run.visited(plan, cell.asked, robot, Cameras(cell, robot), clock, Silent())
    assert "towards" in ended and "the fence" in ended
