"""A known arm's geometry corrected from measurements; where a rig stands to it; what to measure next."""

from armsight.calibrate.arm.calibration import calibrate_arm
from armsight.calibrate.arm.fit import ArmFit, LimitReached, Tolerance
from armsight.calibrate.arm.model import ArmModel
from armsight.calibrate.arm.points import ArmPoints
from armsight.calibrate.arm.propose import Proposal, propose
from armsight.calibrate.arm.result import ArmCalibration, Errors
from armsight.calibrate.arm.world import WorldCalibration, calibrate_world

__all__ = [
    "ArmCalibration",
    "ArmFit",
    "ArmModel",
    "ArmPoints",
    "Errors",
    "LimitReached",
    "Proposal",
    "Tolerance",
    "WorldCalibration",
    "calibrate_arm",
    "calibrate_world",
    "propose",
]
