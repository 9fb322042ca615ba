"""A known arm's geometry corrected from measurements; where a rig stands to it; what to measure next."""

from armsight.calibrate.arm.calibration import calibrate_arm as calibrate_arm
from armsight.calibrate.arm.fit import ArmFit as ArmFit
from armsight.calibrate.arm.fit import LimitReached as LimitReached
from armsight.calibrate.arm.fit import Tolerance as Tolerance
from armsight.calibrate.arm.model import ArmModel as ArmModel
from armsight.calibrate.arm.points import ArmPoints as ArmPoints
from armsight.calibrate.arm.propose import Proposal as Proposal
from armsight.calibrate.arm.propose import propose as propose
from armsight.calibrate.arm.result import ArmResult as ArmResult
from armsight.calibrate.arm.result import Errors as Errors
from armsight.calibrate.arm.result import RobotWorldResult as RobotWorldResult
from armsight.calibrate.arm.world import calibrate_world as calibrate_world
