"""A known arm's geometry corrected from measurements; where a rig stands to it; what to measure next."""

from armsight.calibrate.arm.calibration import calibrate_arm
from armsight.calibrate.arm.fit import ArmFit, LimitReached, Tolerance
from armsight.calibrate.arm.model import ArmModel
from armsight.calibrate.arm.points import ArmPoints
from armsight.calibrate.arm.propose import Proposal, propose
from armsight.calibrate.arm.result import ArmResult, Errors, RobotWorldResult
from armsight.calibrate.arm.world import calibrate_world

__all__ = [
    "ArmFit",
    "ArmModel",
    "ArmPoints",
    "ArmResult",
    "Errors",
    "LimitReached",
    "Proposal",
    "RobotWorldResult",
    "Tolerance",
    "calibrate_arm",
    "calibrate_world",
    "propose",
]
