"""An unknown arm's joints, axes and table from a beacon's paths."""

from armsight.calibrate.identify.chain import Axis
from armsight.calibrate.identify.identify import INCREMENTS, METHODS, identify
from armsight.calibrate.identify.result import Identification, JointFound
from armsight.calibrate.identify.sweeps import Sweeps, even_ones

__all__ = ["INCREMENTS", "METHODS", "Axis", "Identification", "JointFound", "Sweeps", "even_ones", "identify"]
