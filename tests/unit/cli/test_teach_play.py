"""armsight teach and armsight play: their files, what they refuse before any motion, and how they end."""

import json
import os
import re
import threading
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation
from typer.testing import CliRunner

from armsight.cli.commands import app
from armsight.clock import ManualClock
from armsight.drivers.jog_inputs import listening
from armsight.errors import Cancelled, UsageError
from armsight.ops import motion
from armsight.ops.robot.opening import ClockedRobot, arm_of, open_robot
from armsight.ops.teaching import TaughtBeside
from armsight.records import PoseStatus, TargetPose, TaughtPath
from armsight.store import read_poses, write_text
from armsight.store.path_file import read_path, write_path
from armsight.store.recording import Recording
from armsight.units import MM
from refusals import refuses
from robot_runs import acted
from simulated import simulated

SIM = "sim:webcam-cell"


def command(*args: object) -> tuple[int, dict, str]:
    result = CliRunner().invoke(app, [*map(str, args), "--json"])
    return result.exit_code, json.loads(result.stdout or "{}"), result.stderr


@pytest.fixture(scope="module")
def cell() -> Path:
    return simulated("webcam-cell", frames=3, room="dark")


@pytest.fixture
def path(tmp_path: Path) -> Path:
    """Return the file of a path of 10 mm before the flange of the webcam cell's robot."""
    clock = ManualClock()
    with open_robot(SIM, clock) as robot:
        clock.advance(0.04)
        arm = arm_of(robot, None)
        stand = RigidTransform.from_matrix(arm.fk(arm.values(robot.read().q)))
    rows = [(stand * RigidTransform.from_translation([x, 0.0, 0.005])).as_matrix() for x in (0.0, 0.01)]
    write_path(tmp_path / "path.csv", TaughtPath.of_poses(RigidTransform.from_matrix(np.array(rows)), speed_m_s=0.05))
    return tmp_path / "path.csv"


def played(path: Path, **more):
    clock = ManualClock()
    robot = ClockedRobot(robot=open_robot(SIM, clock), clock=clock, called=SIM)
    asked = {"confirm": lambda _: True, "out": path.parent / "out", "approach_speed_m_s": 0.05, "retract_m": 0.004}
    return acted(motion.play, **{"robot": robot, "path": path, **asked, **more})


def test_a_path_is_taught_before_cameras_that_stand(cell: Path, tmp_path: Path) -> None:
    files = [part for name in ("rig", "target", "world") for part in (f"--{name}", cell / f"{name}.yaml")]
    out = tmp_path / "out"
    code, done, _ = command("teach", *files, "--left", cell / "left", "--right", cell / "right", "-o", out)
    assert code == 0
    assert (done["n_rows"], done["stopped_by"], done["parent"], done["n_cycles"]) == (3, "end", "world", 0)
    true = read_poses(cell / "truth_world.csv")
    off = read_path(out / "path.csv").xyz_m - [pose.T_parent_target[:3, 3] for pose in true]
    assert np.abs(off).max() < 1e-3
    code, refused, _ = command("teach", *files, "--left", cell / "left", "-o", tmp_path / "other")
    assert code == 2 and "right" in refused["error"]["cause"]


def test_a_path_is_asked_for_run_and_recorded(path: Path) -> None:
    asked: list[str] = []
    done = played(path, confirm=lambda question: bool(asked.append(question)) or True)
    assert done.finished and done.stopped_by == "end" and done.share == 1.0
    assert "along 10.0 mm" in asked[0] and "deg" in asked[0] and "no camera" in asked[0]
    with Recording(path.parent / "out" / "play.mcap") as recording:
        commands, told = list(recording.commands()), [event.message for event in recording.events()]
    goals = np.array([c.values["xyz_m"] for c in commands if c.kind == "set_point" and "xyz_m" in c.values])
    assert np.allclose(np.ptp(goals, axis=0).max(), 0.01, atol=1e-6)
    assert {c.kind for c in commands} == {"set_point", "joints"}
    assert any(text.startswith("path at") for text in told) and any(text.startswith("finished at") for text in told)
    with refuses(UsageError, "recording"):
        played(path)


def test_the_speed_that_is_told_is_the_largest_of_the_recording(path: Path) -> None:
    asked: list[str] = []
    tip = path.parent / "tip.yaml"  # its flange goes further than the tip where the tool turns
    write_text(tip, "format: armsight/tip\nversion: 1\ntip_m: [0.02, 0.0, 0.1]\n")
    turned = read_path(path).T_world_tip.copy()
    turned[:, :3, :3] = turned[:, :3, :3] @ Rotation.from_rotvec([0.0, 0.3, 0.0]).as_matrix()
    write_path(path, TaughtPath.of_poses(RigidTransform.from_matrix(turned), speed_m_s=0.03))
    played(path, tip=tip, weave="sine:0.002:0.01", confirm=lambda question: bool(asked.append(question)) or True)
    told_mm_s = float(re.search(r"at up to ([0-9.]+) mm/s", asked[0])[1])
    with open_robot(SIM, ManualClock()) as robot:
        arm = arm_of(robot, None)
    with Recording(path.parent / "out" / "play.mcap") as recording:
        sent = [c for c in recording.commands() if c.kind == "joints"]
    flange = arm.fk(arm.values(np.array([c.values["q"] for c in sent])))
    took_s = np.median(np.diff([c.t_s for c in sent]))
    speed = [
        np.linalg.norm(np.diff(flange[:, :3, :3] @ place + flange[:, :3, 3], axis=0), axis=1).max() / took_s
        for place in ([0.02, 0.0, 0.1], [0.0, 0.0, 0.0])
    ]
    assert max(speed) / MM == pytest.approx(told_mm_s, rel=0.05)


def test_nothing_is_written_or_moved_without_a_yes(path: Path) -> None:
    with pytest.raises(Cancelled):
        played(path, confirm=lambda _: False)
    assert not (path.parent / "out").exists()


def test_a_recorder_knows_no_place_before_the_servo_began() -> None:
    beside = TaughtBeside(None, every=1, mean=False)
    beside.recorder.start()
    T = np.eye(4)
    beside.observe(
        TargetPose(t_s=0.0, status=PoseStatus.OK, parent="rig", T_parent_target=T, covariance=np.eye(6)), 0.0
    )
    assert beside.recorder.counts.unplaced == 1


def test_a_key_does_its_thing(monkeypatch) -> None:
    master, slave = os.openpty()
    pressed = threading.Event()
    with os.fdopen(slave) as terminal:
        monkeypatch.setattr("sys.stdin", terminal)
        with listening({" ": pressed.set}):
            os.write(master, b"x ")
            assert pressed.wait(10.0)
    os.close(master)
