"""Board observations -> cameras and rigs, by bundle adjustment."""

from armsight.calibrate.cameras.monocular import calibrate_camera
from armsight.calibrate.cameras.observations import BoardOptions
from armsight.calibrate.cameras.result import CameraCalibration, StereoCalibration
from armsight.calibrate.cameras.stereo import calibrate_stereo

__all__ = ["BoardOptions", "CameraCalibration", "StereoCalibration", "calibrate_camera", "calibrate_stereo"]
