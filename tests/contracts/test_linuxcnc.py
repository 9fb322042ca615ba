"""The LinuxCNC driver on the real LinuxCNC, where it is installed: the contract, in real time, and its limits."""

from __future__ import annotations

import socket
import subprocess
import time
from collections.abc import Callable, Iterator
from typing import Any, ClassVar

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from tests.contracts.conftest import until

from armsight.clock import SystemClock
from armsight.drivers import RobotState
from armsight.drivers.linuxcnc import LinuxcncRobot
from armsight.errors import DeviceFailed
from armsight.testing import RobotCase, RobotContract, WrongCase, WrongController
from armsight.testing.clocks import HaltingClock
from armsight_sim.twins import linuxcnc
from armsight_sim.twins.base import small_arm_mapping
from armsight_sim.twins.linuxcnc import LinuxcncTwin
from refusals import refuses

pytestmark = [
    pytest.mark.alone,
    pytest.mark.skipif(bool(linuxcnc.missing()), reason=f"{linuxcnc.missing()}: {linuxcnc.APT}"),
]

JOG_SCALE = 1e-4
SCALES = {
    WrongController.REVERSED: {1: -1.0},
    WrongController.SCALE: dict.fromkeys(range(6), 1.1),
    WrongController.GEAR: {2: 2.0},
}
"""Joints' jog-scale in HAL as a multiple of what it should be."""


@pytest.fixture(scope="module")
def twin() -> Iterator[LinuxcncTwin]:
    with LinuxcncTwin(port="49170") as twin:
        yield twin


class Line:
    """What comes from LinuxCNC, on the way to its driver."""

    def __init__(self, robot: LinuxcncRobot) -> None:
        self._received, robot._received = robot._received, self.received  # type: ignore[method-assign]
        self.cut = self.frozen = False
        self._last: list[Any] = []

    def received(self, wait_s: float) -> list[Any]:
        packets = self._received(wait_s)
        if self.cut:
            return []
        self._last = self._last if self.frozen else packets[-1:] or self._last
        return self._last if self.frozen else packets


@pytest.fixture
def make(twin: LinuxcncTwin) -> Callable[..., RobotCase]:
    def of(scales: dict[int, float]) -> RobotCase:
        for joint in range(6):
            twin.hal("setp", f"joint.{joint}.jog-scale", repr(JOG_SCALE * scales.get(joint, 1.0)))
        clock = HaltingClock(SystemClock())
        robot = LinuxcncRobot(twin.address.partition(":")[2], settings={"switch_on": True}, clock=clock)
        line = Line(robot)

        def stand_still(time_s: float) -> None:
            clock.halt(robot.name)
            time.sleep(time_s)
            clock.go_on()

        return RobotCase(
            robot=robot,
            advance=time.sleep,
            lose_link=lambda: setattr(line, "cut", True),
            freeze=lambda: setattr(line, "frozen", True),
            stand_still=stand_still,
            true_joints=lambda: np.radians(twin.joints_deg()),
            tolerance=2e-4,
        )

    return of


class TestContract(RobotContract):
    STAND_STILLS: ClassVar[tuple[tuple[float, bool], ...]] = ((0.15, False), (1.5, False))

    @pytest.fixture(autouse=True)
    def _of(self, make: Callable[..., RobotCase]) -> None:
        self._make = make

    def make(self) -> RobotCase:
        return self._make({})

    def make_wrong(self, fault: WrongController) -> WrongCase | str:
        if fault not in SCALES:
            return "counts are differences in degrees, in cycles that the driver chooses; others are in test_links.py"
        case = self._make(SCALES[fault])
        return WrongCase(robot=case.robot, advance=case.advance, joints=case.true_joints or (lambda: np.zeros(6)))


WHERE = """
import sys
sys.path.append("/usr/lib/python3/dist-packages")
import linuxcnc
linuxcnc.nmlfile = "linuxcnc.nml"
stat = linuxcnc.stat()
stat.poll()
print(*stat.position[:6])
"""


def test_the_twins_kinematics_are_the_arms(twin: LinuxcncTwin) -> None:
    told, _ = twin.begin("/usr/bin/python3", "-c", WHERE, stdout=subprocess.PIPE, text=True).communicate()
    x, y, z, a, b, c = map(float, told.split())
    pose = np.eye(4)
    for joint, q in zip(small_arm_mapping()["joints"], np.radians(twin.joints_deg()), strict=True):
        twist, turn = Rotation.from_euler("x", joint["alpha_rad"]), Rotation.from_euler("z", q)
        before, after = np.eye(4), np.eye(4)
        before[:3, :3], before[0, 3] = twist.as_matrix(), joint["a_m"]
        after[:3, :3], after[2, 3] = turn.as_matrix(), joint["d_m"]
        pose = pose @ before @ after
    assert np.abs(pose[:3, 3] - np.array([x, y, z]) / 1000.0).max() < 1e-6
    turned = Rotation.from_euler("xyz", [a, b, c], degrees=True)
    assert (turned * Rotation.from_matrix(pose[:3, :3]).inv()).magnitude() < 1e-6


def test_a_second_one_is_refused_and_no_port_is_open(twin: LinuxcncTwin) -> None:
    with refuses(DeviceFailed, "another LinuxCNC"), LinuxcncTwin(port="49171"):
        pass
    with pytest.raises(OSError), socket.create_connection(("127.0.0.1", 5005), timeout=1.0):
        pass


def test_an_e_stop_and_auto_are_told_and_what_is_allowed_is_switched(twin: LinuxcncTwin) -> None:
    device = twin.address.partition(":")[2]
    for press, named in (("halui.estop.activate", "e-stop"), ("halui.mode.auto", "AUTO")):
        twin.hal("setp", press, "1")
        robot = LinuxcncRobot(device)
        with robot:
            assert robot.state is RobotState.STOPPED
            twin.hal("setp", press, "0")
            until(lambda robot=robot, named=named: named in robot.why)
        with LinuxcncRobot(device, settings={"switch_on": True, "open_s": 20.0}) as robot:
            assert robot.state is RobotState.READY
