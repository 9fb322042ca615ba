"""Delay, drift, read-outs and jitter of two free-running cameras, from lights waved before them."""

from armsight.calibrate.timing.calibrate import calibrate_timing
from armsight.calibrate.timing.result import TimingResult

__all__ = ["TimingResult", "calibrate_timing"]
