"""Board observations -> cameras and rigs, by bundle adjustment."""

from armsight.calibrate.cameras.calibrate import calibrate_camera, calibrate_stereo
from armsight.calibrate.cameras.many_result import CamerasCalibration
from armsight.calibrate.cameras.observations import BoardOptions
from armsight.calibrate.cameras.result import CameraCalibration, StereoCalibration

CameraResult = CameraCalibration
RigResult = StereoCalibration
"""What `armsight` calls them; a mirror rig's is a RigResult too."""

__all__ = [
    "BoardOptions",
    "CameraCalibration",
    "CameraResult",
    "CamerasCalibration",
    "RigResult",
    "StereoCalibration",
    "calibrate_camera",
    "calibrate_stereo",
]
