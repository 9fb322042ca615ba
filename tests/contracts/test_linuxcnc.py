"""The LinuxCNC driver on the real LinuxCNC, where it is installed: the contract, in real time, and its limits."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from typing import Any, ClassVar

import numpy as np
import pytest

from armsight.clock import SystemClock
from armsight.drivers.linuxcnc import LinuxcncRobot
from armsight.testing import RobotCase, RobotContract, WrongCase, WrongController
from armsight.testing.clocks import HaltingClock
from armsight_sim.twins import linuxcnc
from armsight_sim.twins.linuxcnc import LinuxcncTwin

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
