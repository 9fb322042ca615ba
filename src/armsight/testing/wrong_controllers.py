"""What may be wrong with a controller, as the contract of robot drivers has it."""

from __future__ import annotations

import re
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from armsight.drivers import PROVING, Robot, RobotState
from armsight.errors import DeviceFailed
from armsight.testing.checks import check
from armsight.units import DEG

LONGEST_S = 3.0
"""Within so much of the controller's time a wrong one is found."""

MOST_RAD = 0.14 * DEG
"""No joint of a wrong controller moves farther: the probe's 0.04 degrees and a tenth."""

SETTLE_S = 0.2
"""So long it is watched after it was found."""


class WrongController(StrEnum):
    """What is wrong with a controller; its cycle, where that is it, as a multiple of what the driver is set to."""

    RELATIVE = "relative mode"
    QUARTER_CYCLE = "cycle x 0.25"
    HALF_CYCLE = "cycle x 0.5"
    DOUBLE_CYCLE = "cycle x 2"
    TRIPLE_CYCLE = "cycle x 3"
    REVERSED = "one axis reversed"
    EXCHANGED = "two axes exchanged"
    SCALE = "scale 1.1"
    RADIANS = "scale 57.3"
    GEAR = "gear ratio 2"

    @property
    def cycles(self) -> float:
        """The controller's cycle as a multiple of what the driver is set to."""
        return float(self.value.split()[-1]) if self.value.startswith("cycle") else 1.0


CAUSES = {
    WrongController.RELATIVE: "relative mode|cumulative",
    WrongController.REVERSED: "reversed",
    WrongController.EXCHANGED: "exchanged",
    WrongController.SCALE: "times as far",
    WrongController.RADIANS: "radians for degrees",
    WrongController.GEAR: "gear",
}
"""A word of the cause that a driver has to name; of a cycle, its setting."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class WrongCase:
    """A robot not yet opened, whose controller is wrong, and where that controller's joints really are (n,)."""

    robot: Robot
    advance: Callable[[float], None]
    joints: Callable[[], NDArray[np.float64]]


def check_wrong(fault: WrongController, case: WrongCase) -> None:
    """Ask for motion of a wrong controller; check that the driver finds out, says so, and what moved till then."""
    robot, start, largest, said = case.robot, case.joints(), 0.0, ""

    def pass_cycle() -> float:
        case.advance(robot.cycle_s)
        return max(largest, float(np.abs(case.joints() - start).max()))

    step = 0.1 * robot.cycle_s * np.where(np.arange(robot.n_joints) % 2, -0.7, 1.0)
    with ExitStack() as stack:
        try:
            stack.enter_context(robot)
            for _ in range(round(LONGEST_S / robot.cycle_s)):
                largest = pass_cycle()
                robot.step_joints(step)
        except DeviceFailed as error:
            said = str(error)
        for _ in range(round(SETTLE_S / robot.cycle_s)):
            largest = pass_cycle()
    check(bool(said), f"a controller with {fault} is found out")
    named = CAUSES.get(fault, "cycle_s")
    check(re.search(named, said) is not None, f"a controller with {fault} is told as that, not as: {said}")
    check(largest <= MOST_RAD, f"a controller with {fault} moves no joint by {largest / DEG:.2f} degrees")


def prove(robot: Robot, advance: Callable[[float], None]) -> None:
    """Ask for next to no motion until the robot takes motion."""
    for _ in range(round(LONGEST_S / robot.cycle_s)):
        if (
            robot.state is RobotState.STOPPED
            or PROVING not in robot.step_joints(np.full(robot.n_joints, 1e-12)).limited
        ):
            return
        advance(robot.cycle_s)
    check(False, "a link to a right controller is proven")
