"""Robots are opened by DRIVER:DEVICE; what cannot be is refused with what there is."""

from __future__ import annotations

from dataclasses import replace

import pytest

from armsight.clock import ManualClock
from armsight.drivers import RobotState, RobotTraits
from armsight.errors import BadFile, DeviceNotFound, Inconsistent, UsageError
from armsight.ops.robot.opening import open_robot
from armsight.ops.robot.robot_run import check_arm
from armsight.store.arm_file import arm_from_mapping
from refusals import refuses


def test_a_simulated_robot_stands_at_its_scenarios_home() -> None:
    robot = open_robot("sim:webcam-cell", ManualClock())
    assert robot.state is RobotState.CLOSED
    with robot:
        assert robot.read().q[1] == pytest.approx(-1.0472, abs=1e-4)


def test_an_arm_file_of_another_arm_is_refused_before_a_servo_moves_it() -> None:
    with open_robot("sim:webcam-cell", ManualClock()) as robot:
        described = RobotTraits.of(robot).arm_mapping
        assert described is not None
        arm = arm_from_mapping(described())
        check_arm(robot, arm)
        first = arm.joints[0]
        for other in (replace(first, d_m=first.d_m + 0.03), replace(first, theta_rad=first.theta_rad + 0.1)):
            with refuses(Inconsistent, "another arm"):
                check_arm(robot, replace(arm, joints=(other, *arm.joints[1:])))


@pytest.mark.parametrize("text", ["sim", "sim:", ":x", ""])
def test_what_is_no_driver_and_device_is_refused(text: str) -> None:
    with refuses(UsageError, "DRIVER:DEVICE"):
        open_robot(text, ManualClock())


def test_unknown_names_are_refused_with_those_known() -> None:
    with pytest.raises(DeviceNotFound, match="sim"):
        open_robot("nosuch:1", ManualClock())
    with pytest.raises((DeviceNotFound, BadFile), match="webcam-cell"):
        open_robot("sim:no-such", ManualClock())
