"""Where the lights of a target are, from frames that a calibrated rig took of it."""

from armsight.calibrate.light_target.adjustment import LitFrame
from armsight.calibrate.light_target.calibrate import calibrate_target
from armsight.calibrate.light_target.result import LightDistance, TargetResult

__all__ = ["LightDistance", "LitFrame", "TargetResult", "calibrate_target"]
