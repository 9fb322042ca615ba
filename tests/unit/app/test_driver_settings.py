"""Drivers get what they need beyond their device: an arm where the link speaks of poses, the user's own tags."""

import re
from pathlib import Path

import numpy as np
import pytest

from armsight.clock import ManualClock
from armsight.control.guard import Limits
from armsight.errors import DataRefused, UsageError
from armsight.kinematics import presets
from armsight.ops import identify, motion, robots, teach, verify
from armsight.ops.action import action_of
from armsight.ops.requests.motion import RobotJob, settings_of
from armsight.ops.robot import opening
from armsight.ops.robot.hosting import spec_of
from armsight.ops.robot.opening import LinkArm, driver_settings, robot_of
from refusals import refuses

Q = np.array([0.3, -1.1, 1.6, -0.9, 1.2, 0.4])


def test_an_arm_goes_from_joints_to_the_flange_and_back() -> None:
    link = LinkArm(arm=presets.ur10())
    T_base_flange = link.fk(Q)
    np.testing.assert_allclose(T_base_flange.as_matrix(), presets.ur10().fk(Q), atol=1e-12)  # no tool, base in world
    np.testing.assert_allclose(link.ik(T_base_flange, near=Q + 0.05), Q, atol=1e-6)


def test_a_pose_out_of_reach_is_refused() -> None:
    link = LinkArm(arm=presets.ur10())
    far = link.fk(Q).as_matrix().copy()
    far[:3, 3] *= 10.0
    with refuses(DataRefused, "reach"):
        link.ik(type(link.fk(Q)).from_matrix(far), near=Q)


def test_only_the_driver_that_needs_it_gets_it() -> None:
    arm = presets.ur10()
    assert set(driver_settings("alter:/dev/ttyS0", arm=arm)) == {"arm"}
    assert driver_settings("sim:webcam-cell", arm=arm) == {}
    assert driver_settings("rsi:49152", rsi_config=Path("x.xml")) == {"rsi_config": Path("x.xml")}
    with pytest.raises(UsageError, match="RSI"):
        driver_settings("egm:6510", rsi_config=Path("x.xml"))


def test_settings_of_the_command_line_reach_the_driver_and_its_words_name_what_it_knows() -> None:
    texts = ["controller=192.168.0.10", "cycle_s=0.012", "lower_rad=-1,-1,-1,-1,-1,-1"]
    job = RobotJob(robot="rsi:49152", robot_settings=settings_of(texts))
    kept = robot_of(job, ManualClock()).settings  # type: ignore[attr-defined]  # the driver's own
    assert (kept.controller, kept.cycle_s, kept.lower_rad) == ("192.168.0.10", 0.012, [-1.0] * 6)
    served = spec_of(job, presets.ur10(), Limits())
    assert served.settings["cycle_s"] == "0.012" and served.robot == "rsi:49152"
    with refuses(UsageError, "nonsense", "controller", "bind", "cycle_s"):
        robot_of(RobotJob(robot="egm:6510", robot_settings={"nonsense": 1}), ManualClock())
    with refuses(UsageError, "cycle_s"):
        robot_of(RobotJob(robot="rtde:192.0.2.1", robot_settings={"cycle_s": "fast"}), ManualClock())


@pytest.mark.parametrize(("robot", "given"), [("sim:webcam-cell", {"cycle_s": 0.004}), ("alter:p", {"arm": "ur10"})])
def test_settings_that_would_be_ignored_are_refused(robot: str, given: dict[str, object]) -> None:
    with refuses(UsageError, next(iter(given)).replace("arm", "--arm")):
        robot_of(RobotJob(robot=robot, robot_settings=given), ManualClock())


@pytest.mark.parametrize("texts", [["cycle_s"], ["=1"], ["cycle_s="], ["cycle_s=1", "cycle_s=2"]])
def test_what_is_no_setting_is_refused(texts: list[str]) -> None:
    with refuses(UsageError, "--robot-set", texts[-1]):
        settings_of(texts)


def test_every_action_that_names_a_robot_takes_its_settings() -> None:
    calls = [
        call
        for module in (identify, motion, robots, teach, verify)
        for call in vars(module).values()
        if "action" in getattr(call, "__dict__", {})
    ]
    asked = [names for names in (set(action_of(call).parameters) for call in calls) if "robot" in names]
    assert len(asked) > 6 and all({"robot_settings", "rsi_config"} < one for one in asked)


def test_robots_are_opened_in_one_place() -> None:
    """A planted call elsewhere would open a link without the settings that a person gave."""
    source = Path(opening.__file__).parents[2]
    opened = {
        path.name
        for path in source.rglob("*.py")
        if re.search(r"(?<!def )\bopen_robot\(|load\(ROBOTS", path.read_text(encoding="utf-8"))
    }
    assert opened == {"opening.py", "hosting.py"}


def test_a_link_that_knows_its_controller_listens_where_that_is_reached() -> None:
    def listens(**settings: str) -> str:
        return robot_of(RobotJob(robot="egm:6510", robot_settings=settings), ManualClock())._own_address()  # type: ignore[attr-defined]

    assert listens() == "0.0.0.0"
    assert listens(controller="127.0.0.1") == "127.0.0.1"
    assert listens(controller="127.0.0.1", bind="0.0.0.0") == "0.0.0.0"
