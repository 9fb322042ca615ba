"""Where the lights of a target are, from frames that a calibrated rig took of it."""

from armsight.calibrate.light_target.adjustment import LitFrame as LitFrame
from armsight.calibrate.light_target.calibrate import calibrate_target as calibrate_target
from armsight.calibrate.light_target.grown import LitMoment as LitMoment
from armsight.calibrate.light_target.many import NamedSights as NamedSights
from armsight.calibrate.light_target.many import calibrate_lights as calibrate_lights
from armsight.calibrate.light_target.result import LightDistance as LightDistance
from armsight.calibrate.light_target.result import TargetResult as TargetResult
