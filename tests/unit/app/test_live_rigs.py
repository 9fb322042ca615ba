"""Servo, play, supervision and teaching by one and by three cameras of the arm cell; one of three is knocked."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation
from tests.unit.app.test_verify_live import Ticking

from armsight.calibrate.tooltip import TipRecording
from armsight.clock import ManualClock
from armsight.errors import Inconsistent, UsageError
from armsight.measure.poses.setup import Setup
from armsight.ops import motion, teaching
from armsight.ops.action import action_of
from armsight.ops.calibration.pivot import pivot
from armsight.ops.servo.vision import ServoDevices, SteppedClock
from armsight.ops.simulation.scenarios import load_scenario
from armsight.ops.verification.supervising import Supervised
from armsight.ops.verify import supervise
from armsight.records import Silent, TaughtPath
from armsight.store import rig_from_mapping, target_from_mapping, write_rig, write_target, write_text
from armsight.store.arm_file import arm_from_mapping, write_arm
from armsight.store.path_file import write_path
from armsight.store.rigs import World, write_world
from armsight.store.yamls import dump_yaml
from armsight_sim.live import live_cell
from armsight_sim.scenario_builder import build_world
from refusals import names_it, refuses

THREE = ("left", "right", "far-right")
FPS = 15.0
KNOCK = RigidTransform.from_rotation(Rotation.from_rotvec([0.0, np.radians(0.1), 0.0]))


class ArmCell:
    """The arm cell in the dark at half the size, its lights seen from all sides before them; and its files."""

    def __init__(self, folder: Path, clock: Any, *names: str, flat: bool = False, **asked: Any) -> None:
        model = load_scenario("arm-cell")[0]
        keys = model.model_dump() | {"room": "dark"}
        lenses = [keys["cameras"][side] for side in ("left", "right")] + list(keys["cameras"]["others"].values())
        for lens in lenses:
            lens |= {key: 0.5 * lens[key] for key in ("fx", "fy", "cx", "cy")}
        keys["cameras"] |= {"width": 640, "height": 360, "pipeline": "ideal"}
        keys["target"] |= {"facing": None, "wide_deg": 90.0, "sigma_px": 1.3}
        if flat:
            spots = keys["target"]["spots_m"]
            keys["target"]["spots_m"] = {name: [x, y, 0.0] for name, (x, y, _) in spots.items()}
        model = type(model).model_validate(keys)
        self.clock, self.folder, self.names = clock, folder, names
        self.cell = live_cell(model, clock, fps=FPS, **asked)
        self.cell.pairs.see_by(names)
        self.rig = rig_from_mapping(self.cell.rig, "rig").only(*names)
        self.target = target_from_mapping(self.cell.target, "target")
        write_rig(folder / "rig.yaml", self.rig)
        write_target(folder / "target.yaml", self.target)
        self.world = build_world(model, frames=1)
        places = {"T_base_camera": self.cell.T_mount_rig, "T_flange_target": self.world.T_flange_tool}
        poses = {
            name: {"xyz_m": T.translation.tolist(), "quat_xyzw": T.rotation.as_quat().tolist()}
            for name, T in places.items()
        }
        handeye = {"format": "armsight/handeye", "version": 1, "setup": "eye-to-hand", **poses}
        write_text(folder / "handeye.yaml", dump_yaml(handeye))

    def given(self) -> dict[str, Any]:
        device = ServoDevices(
            robot=self.cell.robot,
            pairs=self.cell.pairs,
            clock=self.clock,
            origin_s=lambda: float(self.cell.origin_s),
            stepped=self.clock,
        )
        files = {name: self.folder / f"{name}.yaml" for name in ("rig", "target", "handeye")}
        return {"robot": device, "out": self.folder / "out", "confirm": True, **files}

    def servo(self, seconds_s: float, knocked_s: float = np.inf) -> tuple[Any, float]:
        """Follow, a camera knocked at a time; return the result, and how far off the tool stood at last, m."""
        robot, off_m, hit = self.cell.robot, [0.0], []

        def show(status: Any, error_m: float | None) -> None:
            t_s = self.clock.now_s()
            if t_s - self.cell.origin_s > knocked_s and not hit:
                hit.append(self.cell.pairs.knock("right", KNOCK))
            T_world_flange = robot.true.T_world_base * robot.true_flange(t_s)
            off = T_world_flange.inv() * self.cell.pairs.target_at(t_s - self.cell.origin_s)
            off_m[0] = float(np.linalg.norm(off.translation - [0.0, 0.0, 0.1]))

        more = {"at": "tool", "distance_m": 0.1, "rotation": "hold", "seconds_s": seconds_s, "show": show}
        return action_of(motion.servo).run({**self.given(), **more}), off_m[0]


def test_a_servo_follows_by_one_camera(tmp_path: Path) -> None:
    done, off_m = ArmCell(tmp_path, SteppedClock(), "left", hand="still").servo(2.5)
    assert done.stopped_by == "time" and done.wrong_premise is None and done.n_ok > 0.9 * done.n_frames
    assert done.followed > 0.8 and off_m < 0.005, "the arm's own errors of 0.5 mm a length are left"


def test_a_servo_stops_where_a_camera_is_knocked_and_names_it(tmp_path: Path) -> None:
    done, off_m = ArmCell(tmp_path, SteppedClock(), *THREE, hand="still").servo(6.0, knocked_s=2.5)
    assert done.state == "stopped" and done.wrong_premise == "rig" and done.exit_code == 3
    assert names_it(done.stopped_by, "right") and "--again right" in done.stopped_by
    assert done.n_cycles < 4.5 / 0.008 and off_m < 0.005


def test_one_camera_is_refused_a_flat_target(tmp_path: Path) -> None:
    with refuses(UsageError, "one camera", "tilt"):
        ArmCell(tmp_path, SteppedClock(), "left", flat=True, hand="still").servo(1.0)


def test_a_path_is_watched_by_three_cameras_and_stops_where_one_is_knocked(tmp_path: Path) -> None:
    cell = ArmCell(tmp_path, SteppedClock(), *THREE)
    robot = cell.cell.robot
    stand = robot.true.T_world_base * robot.true_flange(0.0)
    rows = [(stand * RigidTransform.from_translation([x, 0.0, 0.01])).as_matrix() for x in (0.0, 0.02, 0.06)]
    path = TaughtPath(
        T_world_tip=np.array(rows), t_s=np.arange(3.0), speed_m_s=np.full(3, 0.01), tags=("", "", ""), parent="world"
    )
    write_path(tmp_path / "path.csv", path)
    shown: list[float] = []

    def show(status: Any, at: Any, seen: Any) -> None:
        if cell.clock.now_s() - cell.cell.origin_s > 2.5 and not shown:
            shown.append(cell.clock.now_s())
            cell.cell.pairs.knock("right", KNOCK)

    given = {**cell.given(), "path": tmp_path / "path.csv", "show": show, "stop_m": 0.02}
    done = action_of(motion.play).run({**given, "approach_speed_m_s": 0.05, "retract_m": 0.004, "blend_m": 0.002})
    assert done.measured is not None and done.measured.n > 10
    assert done.state == "stopped" and done.wrong_premise == "rig" and names_it(done.stopped_by, "right")
    assert cell.clock.now_s() - shown[0] < 2.0


def test_supervision_goes_on_by_the_cameras_that_agree(tmp_path: Path) -> None:
    cell = ArmCell(tmp_path, Ticking(), "left", "right", "far-left", "far-right", play=True)
    write_world(tmp_path / "world.yaml", World(parent="world", T_parent_rig=cell.world.T_base_rig))
    content = {"format": "armsight/arm", "version": 1, **cell.world.true.mapping(cell.world.T_flange_tool)}
    write_arm(tmp_path / "arm.yaml", arm_from_mapping(content, "arm"))
    told: list[str] = []
    seen: list[Any] = []

    def show(pose: Any, compared: Any, level: Any, lost: str) -> None:
        seen.append(compared)
        if len(seen) == 40:
            cell.cell.pairs.knock("right", KNOCK)

    devices = Supervised(
        robot=cell.cell.robot,
        pairs=cell.cell.pairs,
        origin_s=lambda: cell.cell.origin_s,
        on_step=cell.clock.calls.append,
    )
    files = {name: tmp_path / f"{name}.yaml" for name in ("rig", "target", "arm", "world")}
    named = {"left": None, "right": None, "cameras": {name: f"here:{name}" for name in cell.names}}
    more = {**named, "clock": cell.clock, "devices": devices}
    done = supervise(**files, **more, robot="here", out=tmp_path / "out", show=show, tell=told.append, frames=110)
    doubts = done.to_dict()["doubts"]
    assert any("right" in text and "--again right" in text for text in doubts), doubts
    assert any(names_it(text, "right") for text in told)
    assert sum(one is not None for one in seen[80:]) > 20, "it goes on by the others"
    assert done.to_dict()["errors"]["max_m"] < 2.5e-3, "5 mm where two cameras outvote the third, one of them knocked"


def test_teaching_ends_at_a_knocked_camera_and_keeps_what_was_taught_before(tmp_path: Path) -> None:
    cell = ArmCell(tmp_path, ManualClock(), *THREE, hand="still")
    recorder = teaching.standing_recorder(None, None, every=1, mean=False)
    recorder.start()
    count: list[float] = []

    def seen(pose: Any) -> None:
        count.append(pose.t_s)
        if len(count) == 50:
            cell.cell.pairs.knock("right", KNOCK)

    lesson, setup = teaching.Lesson(recorder, tmp_path / "out"), Setup(rig=cell.rig, target=cell.target)
    with cell.cell.robot, refuses(Inconsistent, "right"):
        teaching.teach_standing(lesson, setup, cell.cell.pairs, 20.0, Silent(), seen=seen)
    assert 20 < len(recorder) <= 50 and (tmp_path / "out" / "path.csv").exists()


def pivoting(cell: ArmCell, tip_m: np.ndarray) -> None:
    """Let a hand turn the target about a tip (3,) in its axes, that rests where it is at first, to all sides."""
    T_world_target = cell.cell.pairs._hand(np.zeros(1))[0]
    rests = T_world_target.apply(tip_m)

    def path(t_s: np.ndarray) -> RigidTransform:
        turns = Rotation.from_rotvec(0.35 * np.stack([np.sin(2.1 * t_s), np.sin(1.7 * t_s), np.sin(0.9 * t_s)], axis=1))
        R = T_world_target.rotation * turns
        return RigidTransform.from_components(rests - R.apply(tip_m), R)

    cell.cell.pairs._hand = path


@pytest.mark.parametrize("knocked", [False, True])
def test_a_tip_is_pivoted_before_three_cameras_and_refused_where_one_is_knocked(tmp_path: Path, knocked: bool) -> None:
    cell, tip_m = ArmCell(tmp_path, ManualClock(), *THREE, hand="still"), np.array([0.01, -0.02, -0.1])
    pivoting(cell, tip_m)
    if knocked:
        cell.cell.pairs.knock("far-right", KNOCK)
    setup = Setup(rig=cell.rig, target=cell.target)
    with cell.cell.robot:
        if knocked:
            with refuses(Inconsistent, "far-right"):
                pivot(setup, cell.cell.pairs, TipRecording(point=None, good_m=3e-5), Silent())
            return
        found = pivot(setup, cell.cell.pairs, TipRecording(point=None, good_m=3e-5), Silent())
    assert found.reached and np.linalg.norm(np.asarray(found.tip_m) - tip_m) < 2e-4
