"""Delay, drift, read-outs and jitter of two free-running cameras, from lights waved before them."""

from armsight.calibrate.timing.calibrate import TimingCalibration, calibrate_timing

__all__ = ["TimingCalibration", "calibrate_timing"]
