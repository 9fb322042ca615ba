"""A limits.yaml that is wrong is told in words, with its name and the cure, and nothing moves; honest ones are not."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform
from typer.testing import CliRunner

from armsight.cli.commands import app
from armsight.clock import ManualClock, SystemClock
from armsight.control.guard import Box, Guard, JointLimit, Limits
from armsight.errors import BadFile, Cancelled, Inconsistent, UsageError
from armsight.kinematics import Arm, Joint, preset
from armsight.ops import motion, robots
from armsight.ops.robot.opening import ClockedRobot, guard_for, open_robot
from armsight.store.limits_file import limits_from_mapping, read_limits
from refusals import names_it, refuses
from robot_runs import acted

SIM = "sim:webcam-cell"
HEAD = "format: armsight/limits\nversion: 1\n"


def six(row: str) -> str:
    return "joints:\n" + 6 * f"- {{{row}}}\n"


WRONG = {  # what the file holds, and what is told of it
    "empty": ("", "empty"),
    "an arm": ("format: armsight/arm\nversion: 1\njoints: []\n", ("armsight/arm", "armsight/limits")),
    "another program's": ("joint_limits: {j1: {max_velocity: 2.0}}\n", "format"),
    "another version": ("format: armsight/limits\nversion: 2\n", "version 2"),
    "five joints": (HEAD + "joints:\n" + 5 * "- {lower: -1, upper: 1}\n", ("5 joints", "webcam-cell", "6")),
    "no joints": (HEAD + "joints: []\n", ("joints", "at least 1")),
    "a range the arm has not": (HEAD + six("lower: 6.5, upper: 7.0"), ("joint 1", "6.5 to 7", "arm's own")),
    "a range inside out": (HEAD + six("lower: 1, upper: -1"), ("joint 1", "1 to -1")),
    "nothing": (HEAD + "speed_m_s: 0\n", ("speed_m_s", "greater than 0")),
    "not a number": (HEAD + six("upper: .nan"), ("joints[0].upper", "nan")),
    "a word": (HEAD + "speed_m_s: fast\n", ("speed_m_s", "number", "fast")),
    "a unit in it": (HEAD + "speed_m_s: 100 mm/s\n", ("speed_m_s", "100 mm/s")),
    "no value": (HEAD + "forbidden:\n", ("forbidden", "no value")),
    "range in degrees": (HEAD + six("lower: -170, upper: 170"), ("degrees", "lower: -2.967, upper: 2.967")),
    "turning in degrees": (HEAD + "turn_rad_s: 60\n", ("deg/s", "turn_rad_s: 1.047")),
    "joint speed in degrees": (HEAD + six("speed: 60"), ("speed 60", "degrees", "speed: 1.047")),
    "turning's acceleration": (HEAD + "turn_acceleration_rad_s2: 1200\n", ("turn_acceleration_rad_s2", "deg/s^2")),
    "speed in mm": (HEAD + "speed_m_s: 100\n", ("speed_m_s", "100 m/s", "mm/s", "speed_m_s: 0.1")),
    "workspace in mm": (
        HEAD + "workspace: {lower_m: [-800, -800, 0], upper_m: [800, 800, 1200]}\n",
        ("workspace", "1200 m", "mm", "upper_m: [0.8, 0.8, 1.2]"),
    ),
    "box in mm": (
        HEAD + "forbidden: [{name: table, lower_m: [300, -500, -100], upper_m: [900, 500, 200]}]\n",
        ("forbidden[0] table", "900 m", "mm"),
    ),
    "margin in mm": (HEAD + "margin_m: 5\n", ("margin_m", "mm", "margin_m: 0.005")),
    "following in degrees": (HEAD + "following: 1.1\n", ("following", "degrees")),
    "target's age in ms": (HEAD + "target_age_s: 150\n", ("ms", "target_age_s: 0.15")),
    "silence without end": (HEAD + "silent_cycles: 5000\n", ("silent_cycles", "5000")),
    "singularity in percent": (HEAD + "singularity: 3\n", ("percent", "singularity: 0.03")),
    "enable's age": (HEAD + "enable_age_s: 150\n", ("enable_age_s", "150", "0.15")),
    "retreat in degrees": (HEAD + "retreat: [0, -90, 90, 0, 90, 0]\n", ("-90 rad", "joint 2", "degrees", "-1.571")),
    "retreat beyond": (HEAD + "retreat: [0, -7, 0, 0, 0, 0]\n", ("-7 rad", "joint 2", "range")),
    "retreat of two joints": (HEAD + "retreat: [0, 1]\n", ("2 joints", "webcam-cell", "6")),
    "workspace inside out": (
        HEAD + "workspace: {lower_m: [0.8, -0.8, 0], upper_m: [-0.8, 0.8, 1.2]}\n",
        ("workspace", "below", "in x"),
    ),
    "workspace out of reach": (
        HEAD + "workspace: {lower_m: [5, 5, 0], upper_m: [6, 6, 1]}\n",
        ("7.08 m", "webcam-cell", "1.68 m"),
    ),
    "workspace without space": (
        HEAD + "workspace: {lower_m: [0, 0, 0], upper_m: [0.009, 0.8, 0.8]}\n",
        ("thinner", "margin_m"),
    ),
    "box over all": (
        HEAD + "forbidden: [{name: floor, lower_m: [-2, -2, -2], upper_m: [2, 2, 2]}]\n",
        ("floor", "covers"),
    ),
    "unknown key": (HEAD + "sped_m_s: 0.1\n", ("sped_m_s", "speed_m_s")),
    "a key twice": (HEAD + "speed_m_s: 0.1\nspeed_m_s: 0.2\n", ("speed_m_s", "twice")),
    "deep": (HEAD + "joints: " + 3000 * "[" + 3000 * "]" + "\n", "deeply"),
    "huge": (HEAD + "x: " + 600_000 * "a", "0.5 MB"),
}


@pytest.mark.parametrize("name", WRONG)
def test_a_wrong_file_is_told_in_words_and_nothing_moves(tmp_path: Path, name: str) -> None:
    text, told = WRONG[name]
    path = tmp_path / "limits.yaml"
    path.write_text(text)
    asked: list[str] = []
    robot = open_robot(SIM, clock := ManualClock())
    job = {"robot": ClockedRobot(robot=robot, clock=clock), "joint": 1, "by": 0.02, "limits": path}
    with refuses((BadFile, Inconsistent, UsageError), told) as caught:
        acted(robots.jog, **job, confirm=lambda question: bool(asked.append(question)))
    assert caught.value.cause.startswith(str(path))
    assert caught.value.consequence and caught.value.cure
    assert not asked and clock.now_s() == 0.0


def test_every_value_of_the_file_that_has_a_unit_has_a_largest_one() -> None:
    for key, field in Limits.__dataclass_fields__.items():
        if field.type != "float" or key in ("retreat_speed", "enable_age_s"):
            continue  # a share up to 1, and what Limits itself bounds
        with refuses(BadFile, key):
            limits_from_mapping({"format": "armsight/limits", key: 9e5})


def test_honest_limits_are_taken(tmp_path: Path) -> None:
    path = tmp_path / "limits.yaml"

    def taken(arm: Arm, text: str) -> Guard:
        path.write_text(HEAD + text)
        return Guard(arm, read_limits(path), 0.004)

    rail = Joint(name="rail", type="prismatic", lower=-5.0, upper=5.0)
    track = taken(
        Arm(name="rail", joints=(rail, *preset("ur10").joints)),
        "joints:\n- {lower: -5, upper: 5, speed: 4, acceleration: 50}\n"
        + 6 * "- {speed: 3}\n"
        + "workspace: {lower_m: [-10, -10, -10], upper_m: [10, 10, 10]}\n",
    )
    assert track.bounds.speed[0] == 4.0
    delta = Arm(name="delta", joints=tuple(Joint(name=f"m{i}", a_m=0.4, lower=-1.0, upper=1.5) for i in range(3)))
    taken(
        delta,
        "speed_m_s: 10\nturn_rad_s: 45\nacceleration_m_s2: 150\nturn_acceleration_rad_s2: 500\njerk_m_s3: 10000\n"
        + "joints:\n"
        + 3 * "- {speed: 10, acceleration: 600, jerk: 30000}\n",
    )
    desk = Arm(name="desk", joints=tuple(Joint(name=f"j{i}", a_m=0.05, lower=-1.5, upper=1.5) for i in range(4)))
    taken(
        desk,
        "speed_m_s: 0.02\nmargin_m: 0.001\nworkspace: {lower_m: [-0.15, -0.15, 0], upper_m: [0.15, 0.15, 0.2]}\n"
        "forbidden: [{name: table, lower_m: [-1, -1, -1], upper_m: [1, 1, 0]},\n"
        "  {name: base, lower_m: [-0.03, -0.03, 0], upper_m: [0.03, 0.03, 0.05]}]\n",
    )
    endless = Arm(name="endless", joints=tuple(Joint(name=f"j{i}", a_m=0.3) for i in range(6)))
    for row in ("{}", "{speed: 3}", "{lower: -12.566, upper: 12.566}", "{lower: -1.0e+4, upper: 1.0e+4}"):
        assert math.isinf(taken(endless, "joints:\n" + 6 * f"- {row}\n").bounds.lower[0]) == ("lower" not in row)
    ur = taken(preset("ur10"), six("lower: -7.85, upper: 7.85"))  # a wrist of 450 degrees, given for an arm of one turn
    assert (ur.bounds.upper <= preset("ur10").upper).all()


def test_a_served_robot_is_not_begun_with_limits_in_degrees() -> None:
    """The loop of serve and console makes its guard without guard_for."""
    with refuses(Inconsistent, "degrees"):
        Guard(preset("ur10"), Limits(joints=(JointLimit(lower=-170.0, upper=170.0),) * 6), 0.008)
    with refuses(Inconsistent, "degrees"):
        Guard(preset("ur10"), Limits(joints=(JointLimit(speed=60.0),) * 6), 0.008)


def test_a_share_of_the_speed_does_not_hide_degrees(tmp_path: Path) -> None:
    (tmp_path / "limits.yaml").write_text(HEAD + six("speed: 60"))
    with pytest.raises(Inconsistent, match="speed 60"):
        guard_for(open_robot(SIM, SystemClock()), limits=tmp_path / "limits.yaml", share=0.1)


def test_slides_are_in_metres() -> None:
    arm = Arm(name="gantry", joints=(Joint(name="x", type="prismatic", lower=0.0, upper=2.0),))
    for row, told in (
        (JointLimit(upper=1500.0), "mm"),
        (JointLimit(speed=100.0), "mm"),
        (JointLimit(acceleration=2000.0), "mm"),
    ):
        with refuses(Inconsistent, told):
            Guard(arm, Limits(joints=(row,)), 0.008)


def test_a_tool_longer_than_the_workspace_has_no_place() -> None:
    arm = preset("puma761")
    box = Box(lower_m=np.array([0.3, 0.0, 0.3]), upper_m=np.array([0.4, 0.1, 0.4]))
    Guard(arm, Limits(workspace=box), 0.008)
    long = replace(arm, T_flange_tool=RigidTransform.from_translation([0.0, 0.0, 0.3]))
    with refuses(Inconsistent, "flange", "tool"):
        Guard(long, Limits(workspace=box), 0.008)


OUTSIDE = HEAD + "workspace: {lower_m: [-0.8, -0.8, -0.8], upper_m: [0.0, 0.8, 1.2]}\n"


def test_an_arm_that_stands_outside_is_told_before_it_moves(tmp_path: Path) -> None:
    path = tmp_path / "limits.yaml"
    path.write_text(OUTSIDE)
    run = CliRunner().invoke
    jog = ["robot", "jog", "--robot", SIM, "--limits", str(path), "--yes", "--json", "--joint"]
    done = run(app, [*jog, "2", "--by", "-0.05"])
    told = r"the arm stands outside its limits .* workspace box (lower x, tool) by 0.0988 (way back: +)"
    for text in (done.stderr, json.loads(done.stdout)["outside"]):
        assert all(part in text for part in told.split(" .* "))
    path.write_text(HEAD + "joints:\n- {lower: 0.5, upper: 1.5}\n" + 5 * "- {}\n")
    away = run(app, [*jog, "1", "--by", "-0.02"])
    assert away.exit_code == 3 and "joint 1 (lower) by 0.5" in away.stderr and "--by 0.5 and more" in away.stderr
    back = run(app, [*jog, "1", "--by", "0.02"])
    assert back.exit_code == 0 and "joint 1 (lower) by 0.5" in json.loads(back.stdout)["outside"]
    path.write_text(HEAD)
    assert json.loads(run(app, [*jog, "1", "--by", "0.01"]).stdout)["outside"] == ""


def test_commands_with_another_path_to_their_limits_refuse_them_too(tmp_path: Path) -> None:
    """servo, teach and play tell of limits in the next test; the loop of serve makes its guard without them."""
    path = tmp_path / "limits.yaml"
    path.write_text(HEAD + "speed_m_s: 100\n")
    words = ["serve", "--log", str(tmp_path / "log.mcap"), "--port", "0", "--robot", SIM, "--limits", str(path)]
    done = CliRunner().invoke(app, words)
    assert done.exit_code == 3, done.output
    assert "speed_m_s: 0.1" in " ".join(done.stderr.split())


def test_servo_and_play_tell_of_an_arm_that_stands_outside(tmp_path: Path) -> None:
    """teach is a servo with a recorder beside it."""
    path = tmp_path / "limits.yaml"
    path.write_text(OUTSIDE)
    CliRunner().invoke(app, ["simulate", "webcam-cell", "--room", "dark", "--frames", "1", "-o", str(tmp_path / "set")])
    rig, target, handeye = (tmp_path / "set" / f"{name}.yaml" for name in ("rig", "target", "handeye"))
    asked: list[str] = []
    eyes = {"rig": rig, "target": target, "handeye": handeye}
    servo = {"robot": SIM, **eyes, "out": tmp_path / "servo", "at": "tool", "limits": path}
    with pytest.raises(Cancelled):
        acted(motion.servo, **servo, confirm=lambda question: bool(asked.append(question)))
    assert names_it(asked[0], "Note", "outside")
    rows = [f"{k},,{-0.78 + 0.001 * k},-0.163941,0.255445,0.5,-0.5,-0.5,0.5,0.02," for k in range(11)]
    (tmp_path / "path.csv").write_text("index,t_s,x_m,y_m,z_m,qx,qy,qz,qw,speed_m_s,tag\n" + "\n".join(rows) + "\n")
    play = {"robot": SIM, "path": tmp_path / "path.csv", "out": tmp_path / "play", "limits": path}
    with refuses(Inconsistent, "outside", "limits"):
        acted(motion.play, **play, confirm=lambda question: bool(asked.append(question)))
    assert len(asked) == 1
