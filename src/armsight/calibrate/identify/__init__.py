"""An unknown arm's joints, axes and table from a beacon's paths."""

from armsight.calibrate.identify.chain import Axis as Axis
from armsight.calibrate.identify.identify import INCREMENTS as INCREMENTS
from armsight.calibrate.identify.identify import METHODS as METHODS
from armsight.calibrate.identify.identify import identify as identify
from armsight.calibrate.identify.result import Identification as Identification
from armsight.calibrate.identify.result import JointFound as JointFound
from armsight.calibrate.identify.sweeps import Sweeps as Sweeps
from armsight.calibrate.identify.sweeps import even_ones as even_ones
