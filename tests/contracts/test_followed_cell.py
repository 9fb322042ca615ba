"""Simulated cameras that watch a controller's arm through its link, held to the controller's own motion."""

from __future__ import annotations

import multiprocessing
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from tests.truth.emulated_links import link_of

from armsight.app.operator.robot_cell import scenario_of
from armsight.clock import ManualClock, SystemClock
from armsight.drivers import AUTOMATIC
from armsight.drivers.pace import ControllerClock
from armsight.errors import DeviceFailed, DeviceLost, DeviceNotFound, Inconsistent, UsageError
from armsight.measure.poses.pipeline import Setup, measure_pair
from armsight.ops.identification.live import open_devices
from armsight.ops.requests.motion import RobotJob
from armsight.ops.simulation.following import followed_cell, watching_cell
from armsight.ops.simulation.scenarios import live_cell, load_scenario, with_arm
from armsight.optics import Camera, parallel_rig
from armsight.records import JointReading
from armsight.store import rig_from_mapping, target_from_mapping
from armsight.store.arm_file import arm_from_mapping, write_arm
from armsight.store.yamls import dump_yaml
from armsight.testing.wrong_controllers import prove
from armsight_sim.devices import sim_robot
from armsight_sim.scenario_builder import robotics
from armsight_sim.twins.base import small_arm, twin_home
from refusals import refuses

LIGHT = target_from_mapping({"kind": "spots", "spots_m": {"A": [0.0, 0.0, 0.0]}}, "light")
SPEED_RAD_S = np.deg2rad(15.0)
PAIRS = 24


@pytest.fixture(scope="module")
def scenario(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A scenario of the twins' own arm, before small cameras, in the dark."""
    folder = tmp_path_factory.mktemp("scenario")
    mapping = small_arm().mapping(small_arm().T_world_base)
    write_arm(folder / "arm.yaml", arm_from_mapping({"format": "armsight/arm", "version": 1, **mapping}, "small"))
    model, _ = with_arm("webcam-cell", str(folder / "arm.yaml"), None)
    keys = model.model_dump() | {"room": "dark"}
    keys["cameras"] |= {"width": 640, "height": 360}
    for side in ("left", "right"):
        lens = keys["cameras"][side]
        lens |= {name: 0.5 * lens[name] for name in ("fx", "fy", "cx", "cy")}
    keys["cameras"]["pipeline"] = "ideal"  # whose noise is what the spots claim
    keys["target"]["sigma_px"] = 1.5
    file = folder / "cell.yaml"
    file.write_text(dump_yaml(keys))
    return file


def flange(q: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return T_base_flange (4, 4) of the twins' arm, by its table and the textbook's four factors."""
    T = np.eye(4)
    for joint, value in zip(small_arm().joints, q, strict=True):
        for turn, along in (((0.0, 0.0, value + joint.theta_rad), (0.0, 0.0, joint.d_m)),
                            ((joint.alpha_rad, 0.0, 0.0), (joint.a_m, 0.0, 0.0))):  # fmt: skip
            step = np.eye(4)
            step[:3, :3], step[:3, 3] = Rotation.from_rotvec(turn).as_matrix(), along
            T = T @ step
    return T


def errors(pair: Any, scenario: Path, joints: Callable[[Any], Callable[[float], Any]] | None = None) -> Any:
    """Return (PAIRS, 3): the target's place as the cameras see it minus that by the controller's own log, whitened.

    The arm goes to and fro at SPEED_RAD_S. joints: in place of what the cameras follow, made of the driver.
    """
    cell = followed_cell(str(scenario), pair.robot, pair.clock)
    if joints is not None:
        cell.robot.follow(joints(pair.robot))
    setup = Setup(rig=rig_from_mapping(cell.rig, "rig"), target=target_from_mapping(cell.target, "target"))
    keys = load_scenario(str(scenario))[0]
    T_rig_base = keys.cameras.T_mount_rig.pose().inv().as_matrix()
    T_flange_target = keys.target.T_flange_target.pose().as_matrix()
    log, seen, due = [], [], 30  # the arm is at its speed by then
    pair.prove()
    with cell.pairs as pairs:
        while len(seen) < PAIRS:
            way = WAY if int((pair.clock.now_s() - cell.origin_s) / TURN_S) % 2 == 0 else -WAY
            pair.robot.step_joints(way * SPEED_RAD_S * pair.cycle_s)
            pair.advance(pair.cycle_s)
            log.append((pair.clock.now_s(), *pair.twin.q))
            if pair.clock.now_s() > cell.origin_s + due / pairs.fps + pairs.latency_s:
                pose = measure_pair(setup, *pairs.moment(due)).pose
                seen.append((cell.origin_s + pose.t_s, pose))
                due += 3
    found, rows = [], np.array(log)
    for t_s, pose in seen:
        q = np.array([np.interp(t_s, rows[:, 0], column) for column in rows[:, 1:].T])
        true = (T_rig_base @ flange(q) @ T_flange_target)[:3, 3]
        found.append(np.linalg.solve(np.linalg.cholesky(pose.covariance[:3, :3]), pose.T_parent_target[:3, 3] - true))
    return np.array(found)


WAY, TURN_S = np.array([1.0, 0.4, -0.4, 0.0, 0.0, 1.0]), 0.6
"""Shares of the speed by joint, and how long it goes one way."""


def test_a_moving_arm_is_seen_where_its_controller_had_it_at_the_exposure(make_link: Any, scenario: Path) -> None:
    pair = make_link()
    with pair.robot:
        rms = np.sqrt(np.mean(errors(pair, scenario) ** 2))
    assert 0.7 < rms < 1.35, f"{rms:.2f} of the cameras' own deviations"


def test_an_arm_behind_rtde_is_seen_where_its_controller_had_it(scenario: Path) -> None:
    """By the driver and the controller in step: ur-rtde, which is between them, tells the controller's own stamps."""
    link = link_of("rtde", ManualClock(100.0))
    advance = link.wrong_case().advance
    link.advance, link.prove = advance, lambda: prove(link.robot, advance)
    with link.robot:
        rms = np.sqrt(np.mean(errors(link, scenario) ** 2))
    assert 0.7 < rms < 1.35, f"{rms:.2f} of the cameras' own deviations"


def held(robot: Any) -> Callable[[float], Any]:
    """Return what gives the reading that was newest at a moment: nothing between two is worked out."""
    log: list[tuple[float, Any]] = []
    robot.listen(lambda t_s, q: log.append((t_s, q)))
    return lambda t_s: next(q for at_s, q in reversed(log) if at_s <= t_s)


def test_nothing_is_guessed_beyond_what_was_heard(make_egm: Any, scenario: Path) -> None:
    """A picture waits for the joints of its exposure; where none come it is told."""
    pair = make_egm()
    with pair.robot:
        cell = followed_cell(str(scenario), pair.robot, pair.clock)
        pair.advance(0.1)
        with cell.pairs as pairs:
            pair.advance(0.1)
            assert len(pairs.moment(2)) == 2
            pair.twin.fault("silent")
            with refuses(DeviceLost, "told no joints"):
                pairs.moment(60)


class Telling:
    """A robot that tells its joints when the test does."""

    name, n_joints = "telling", 6

    def listen(self, heard: Callable[[float, Any], None]) -> None:
        self.tell = heard


def test_pictures_are_drawn_by_a_process_of_their_own_where_the_arm_was(scenario: Path) -> None:
    robot, clock = Telling(), SystemClock()
    cell = watching_cell(str(scenario), robot, clock)  # type: ignore[arg-type]
    keys = load_scenario(str(scenario))[0]
    told = live_cell(str(scenario), clock)
    setup = Setup(rig=rig_from_mapping(told.rig, "rig"), target=target_from_mapping(told.target, "target"))
    begin_s, home = clock.now_s(), twin_home(small_arm())
    for t_s in (begin_s - 1.0, begin_s + 100.0):
        robot.tell(t_s, home + 0.002 * (t_s - begin_s) * WAY)
    with cell.pairs as pairs:
        pose = measure_pair(setup, *next(iter(pairs))).pose
        (other,) = (p for p in multiprocessing.active_children() if p.name == "armsight-pictures")
        q = home + 0.002 * (cell.origin_s + pose.t_s - begin_s) * WAY
        true = (keys.cameras.T_mount_rig.pose().inv().as_matrix() @ flange(q)
                @ keys.target.T_flange_target.pose().as_matrix())[:3, 3]  # fmt: skip
        off = np.linalg.solve(np.linalg.cholesky(pose.covariance[:3, :3]), pose.T_parent_target[:3, 3] - true)
        assert np.linalg.norm(off) < 4.5
        other.kill()
        with refuses(DeviceFailed, "has ended"):
            for _ in pairs:
                pass
    assert not other.is_alive()
    with refuses(DeviceNotFound, "no scenario 'nowhere'"):  # told by the other process
        watching_cell("nowhere", robot, clock)  # type: ignore[arg-type]


def test_packets_that_come_late_are_taken_for_when_they_were_sent() -> None:
    """By the controller's stamps: delays of up to 30 ms do not move the arm in the pictures, and clocks may drift."""
    clock, rng, off = ControllerClock(0.004, numbered=True), np.random.default_rng(3), []
    for k in range(2000):
        sent_s = 500.0 + 0.004 * k * (1.0 + 5e-5)
        late_s = 2e-4 + 1e-4 * rng.random() + (0.03 * rng.random() if rng.random() < 0.5 else 0.0)
        clock.heard = lambda t_s, q, sent_s=sent_s: off.append(t_s - sent_s)
        clock.hear(0.004 * k, k, sent_s + late_s, JointReading(q=np.zeros(2), t_s=0.0, sequence=k, source="link"))
    assert max(np.abs(off[200:])) < 6e-4


def test_who_cannot_be_followed_is_refused(make_egm: Any, scenario: Path) -> None:
    robot = make_egm().robot
    clock = ManualClock()
    with refuses(UsageError, "own cameras"):
        followed_cell(
            str(scenario), sim_robot("", settings=load_scenario("webcam-cell")[0].model_dump(), clock=clock), clock
        )
    with refuses(Inconsistent, "has 3 joints", "has 6", "armsight simulate"):
        followed_cell("kapucu2005-rrp", robot, clock)
    job = RobotJob(robot="egm:6510", follow=str(scenario))
    rig = parallel_rig(Camera.pinhole(640, 480, 800.0, 800.0, 319.5, 239.5), 0.1)
    with refuses(UsageError, "--left", "its own cameras"):
        open_devices(job, rig, {"left": "camera:0"}, AUTOMATIC, LIGHT, clock)
    with refuses(UsageError, "--follow SCENARIO"):
        open_devices(RobotJob(robot="egm:6510"), rig, {}, AUTOMATIC, LIGHT, clock)
    with refuses(UsageError, "own cameras"):
        scenario_of(RobotJob(robot="sim:webcam-cell", follow=str(scenario)))


CRAIG = """
format: armsight/arm
version: 1
name: craig
convention: craig
T_world_base: {xyz_m: [0.3, -0.2, 0.1], quat_xyzw: [0.0, 0.0, 0.3826834, 0.9238795]}
joints:
- {name: j1, type: revolute, a_m: 0.0, alpha_rad: 0.0, d_m: 0.67, theta_rad: 0.1, lower: -2.0, upper: 2.0}
- {name: j2, type: revolute, a_m: 0.02, alpha_rad: -1.5707963, d_m: 0.0, theta_rad: 0.0, lower: -2.0, upper: 2.0}
- {name: j3, type: revolute, a_m: 0.43, alpha_rad: 0.01, d_m: -0.14, theta_rad: -0.2, lower: -2.0, upper: 2.0}
- {name: j4, type: prismatic, a_m: 0.05, alpha_rad: 1.2, d_m: 0.1, theta_rad: 0.0, lower: 0.0, upper: 0.4}
"""


def test_an_arm_of_another_convention_is_seen_as_it_is(tmp_path: Path) -> None:
    """Its flange in the scenario is where Craig's own factors put it, but for one turn and way at its end."""
    (tmp_path / "arm.yaml").write_text(CRAIG)
    model, text = with_arm("webcam-cell", str(tmp_path / "arm.yaml"), None)
    keys = yaml.safe_load(CRAIG)
    arm = robotics(model, 1).true
    ends = []
    for q in np.random.default_rng(4).uniform([-1, -1, -1, 0], [1, 1, 1, 0.4], (5, 4)):
        T = np.eye(4)
        for joint, value in zip(keys["joints"], q, strict=True):
            slides = joint["type"] == "prismatic"
            turn, way = (joint["theta_rad"] + (0 if slides else value)), joint["d_m"] + (value if slides else 0)
            for turned, along in (((joint["alpha_rad"], 0, 0), (joint["a_m"], 0, 0)), ((0, 0, turn), (0, 0, way))):
                step = np.eye(4)
                step[:3, :3], step[:3, 3] = Rotation.from_rotvec(turned).as_matrix(), along
                T = T @ step
        ends.append(np.linalg.inv(T) @ arm.flange(q).as_matrix())
    assert np.ptp(ends, axis=0) == pytest.approx(0.0, abs=1e-9), "the same at every posture"
    assert np.asarray(arm.T_world_base.translation) == pytest.approx([0.3, -0.2, 0.1])
    assert "T_base_frame0" in text


def test_an_arm_that_no_camera_would_see_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """In its own way on every side, with its home beyond a range, or under cameras that it carries itself."""
    with refuses(UsageError, "home position"):
        with_arm("webcam-cell", "irb120", "0,2.5,0,0,0,0")
    with refuses(UsageError, "on the arm"):
        with_arm("pachidis2005-static", "irb120", None)
    monkeypatch.setattr("armsight_sim.refit.covering", lambda *_: 0)
    with refuses(Inconsistent, "hides its flange"):
        with_arm("webcam-cell", "irb120", None)
