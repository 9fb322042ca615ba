"""Observations -> parameters: cameras, rigs, and what they were fitted to."""

from armsight.calibrate.camera import CameraCalibration, calibrate_camera
from armsight.calibrate.options import BoardOptions
from armsight.calibrate.stereo import StereoCalibration, calibrate_stereo

__all__ = ["BoardOptions", "CameraCalibration", "StereoCalibration", "calibrate_camera", "calibrate_stereo"]
