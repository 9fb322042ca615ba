"""Robots are opened by DRIVER:DEVICE; what cannot be is refused with what there is."""

from __future__ import annotations

import pytest

from armsight.app.robot.opening import open_robot
from armsight.clock import ManualClock
from armsight.drivers import RobotState
from armsight.errors import BadFile, DeviceNotFound, UsageError
from refusals import refuses


def test_a_simulated_robot_stands_at_its_scenarios_home() -> None:
    robot = open_robot("sim:webcam-cell", ManualClock())
    assert robot.state is RobotState.CLOSED
    with robot:
        assert robot.read().q[1] == pytest.approx(-1.0472, abs=1e-4)


@pytest.mark.parametrize("text", ["sim", "sim:", ":x", ""])
def test_what_is_no_driver_and_device_is_refused(text: str) -> None:
    with refuses(UsageError, "DRIVER:DEVICE"):
        open_robot(text, ManualClock())


def test_unknown_names_are_refused_with_those_known() -> None:
    with pytest.raises(DeviceNotFound, match="sim"):
        open_robot("nosuch:1", ManualClock())
    with pytest.raises((DeviceNotFound, BadFile), match="webcam-cell"):
        open_robot("sim:no-such", ManualClock())
