"""The model of a robot's arm, which the guard of a server moves it by."""

from __future__ import annotations

from armsight.app.arm_files import load_arm
from armsight.app.robot.guarding import arm_of
from armsight.app.robot.opening import open_robot
from armsight.clock import SystemClock
from armsight.errors import UsageError
from armsight.kinematics import Arm


def arm_model(robot: str, arm: str | None) -> Arm:
    """Return the arm of a robot DRIVER:DEVICE: the given file's or preset's; a simulated robot brings its own.

    Nothing is opened. Raises UsageError where none is given, and as load_arm and open_robot do.
    """
    if arm is not None:
        return load_arm(arm)
    told = arm_of(open_robot(robot, SystemClock()), None)
    if told is None:
        raise UsageError(
            f"the arm behind {robot} is not known",
            consequence="The guard cannot keep the limits of its tool, so it is not served",
            cure="Give --arm with its arm.yaml, its .urdf or a preset's name",
        )
    return told
