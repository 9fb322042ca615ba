"""Degrees given for radians, and millimetres for metres, are refused before anything moves or is computed."""

from pathlib import Path

import pytest

from armsight.clock import SystemClock
from armsight.errors import BadFile, Inconsistent, UsageError
from armsight.ops.identification.left_out import read_limits
from armsight.ops.kinematics import show_arm
from armsight.ops.robot.opening import guard_for, open_robot
from armsight.ops.robots import jog
from armsight.store.arm_file import read_arm
from armsight.store.interpret import limits_look_like_degrees, looks_like_degrees
from armsight.store.urdf import arm_from_urdf
from armsight.units import DEG
from refusals import refuses

LIMITS = "format: armsight/limits\nversion: 1\njoints:\n" + 6 * "- {lower: LO, upper: HI}\n"
ARM = (
    "format: armsight/arm\nversion: 1\nconvention: standard\njoints:\n"
    "- {name: j1, type: revolute, a_m: 0.3, alpha_rad: ALPHA, lower: LO, upper: HI}\n"
)
URDF = (
    '<robot name="r"><link name="a"/><link name="b"/><joint name="j" type="continuous"><parent link="a"/>'
    '<child link="b"/><axis xyz="0 0 1"/><origin xyz="XYZ" rpy="RPY"/></joint></robot>'
)


def test_limits_of_a_live_identification() -> None:
    with refuses(Inconsistent, "degrees", "298"):
        read_limits("-28:298")
    assert read_limits("-0.5:5.2,0:0.3").tolist() == [[-0.5, 5.2], [0.0, 0.3]]
    assert read_limits("-28deg:298deg,0mm:300mm")[0] == pytest.approx([-28 * DEG, 298 * DEG])
    assert read_limits("-28deg:298deg,0mm:300mm")[1] == pytest.approx([0.0, 0.3])
    assert read_limits("-7.85rad:7.85rad")[0] == pytest.approx([-7.85, 7.85])  # a wrist of 450 degrees, stated
    with pytest.raises(UsageError):
        read_limits("-28grad:5")


def test_a_joint_is_not_jogged_by_degrees() -> None:
    asked: list[str] = []
    with refuses(Inconsistent, "degrees", "573"):
        jog("sim:webcam-cell", 1, 10.0, confirm=lambda question: bool(asked.append(question)))
    assert not asked


def test_limits_of_the_guard(tmp_path: Path) -> None:
    robot = open_robot("sim:webcam-cell", SystemClock())
    for low, high, good in ((-170, 170, False), (-2.9, 2.9, True), (-7.85, 7.85, True)):
        (tmp_path / "limits.yaml").write_text(LIMITS.replace("LO", str(low)).replace("HI", str(high)))
        if good:
            assert guard_for(robot, limits=tmp_path / "limits.yaml") is not None
        else:
            with refuses(Inconsistent, "degrees"):
                guard_for(robot, limits=tmp_path / "limits.yaml")


def test_an_arm_file(tmp_path: Path) -> None:
    def arm(alpha: float, low: float, high: float, a_m: float = 0.3) -> Path:
        text = ARM.replace("ALPHA", str(alpha)).replace("LO", str(low)).replace("HI", str(high))
        text = text.replace("a_m: 0.3", f"a_m: {a_m}")
        (tmp_path / "arm.yaml").write_text(text)
        return tmp_path / "arm.yaml"

    assert read_arm(arm(1.5708, -2.9, 2.9)).n == 1
    assert read_arm(arm(1.5708, -1000.0, 1000.0)).n == 1  # endless
    with refuses(BadFile, "j1", "alpha_rad", "degrees"):
        read_arm(arm(90.0, -2.9, 2.9))
    with refuses(BadFile, "lower", "upper", "degrees"):
        read_arm(arm(1.5708, -170.0, 170.0))
    with refuses(BadFile, "a_m", "millimetres"):
        read_arm(arm(1.5708, -2.9, 2.9, a_m=-300.0))


@pytest.mark.parametrize(
    ("xyz", "rpy", "wrong"), [("0 0 1", "0 -7 3", ""), ("0 0 1000", "0 0 0", "xyz"), ("0 0 1", "90 0 0", "rpy")]
)
def test_a_urdf_in_mm_or_degrees(xyz: str, rpy: str, wrong: str) -> None:
    text = URDF.replace("XYZ", xyz).replace("RPY", rpy)
    if not wrong:
        assert arm_from_urdf(text).n == 1
        return
    with refuses(BadFile, f"origin {wrong}"):
        arm_from_urdf(text)


def test_joint_values_on_the_command_line(tmp_path: Path) -> None:
    with refuses(UsageError, "degrees", "90"):
        show_arm("ur10", tmp_path / "a.html", q="0,-90,90,0,0,0")


def test_what_stays_below() -> None:
    assert not looks_like_degrees([[0.0, 6.2], [-3.1, 1.0]]) and looks_like_degrees([[0.0, 28.0]])
    assert not looks_like_degrees([[float("nan")]])
    assert not limits_look_like_degrees([-float("inf"), float("inf")])
