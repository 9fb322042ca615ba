"""Delays, drifts, read-outs and jitter of free-running cameras, from lights waved before them."""

from armsight.calibrate.timing.calibrate import calibrate_clocks, calibrate_timing
from armsight.calibrate.timing.result import CamerasTiming, TimingResult

__all__ = ["CamerasTiming", "TimingResult", "calibrate_clocks", "calibrate_timing"]
