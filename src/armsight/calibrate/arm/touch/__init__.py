"""An arm corrected from what its tip touched: spikes, flats, balls, dial gauges; no tracker or camera."""

from armsight.calibrate.arm.touch.calibration import calibrate_touched as calibrate_touched
from armsight.calibrate.arm.touch.touches import Kind as Kind
from armsight.calibrate.arm.touch.touches import KnownLength as KnownLength
from armsight.calibrate.arm.touch.touches import Touches as Touches
