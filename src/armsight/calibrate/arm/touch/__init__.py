"""An arm corrected from what its tip touched: spikes, flats, balls, dial gauges; no tracker or camera."""

from armsight.calibrate.arm.touch.calibration import calibrate_touched
from armsight.calibrate.arm.touch.touches import Kind, KnownLength, Touches

__all__ = ["Kind", "KnownLength", "Touches", "calibrate_touched"]
