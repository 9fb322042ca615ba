"""Board observations -> cameras and rigs, by bundle adjustment."""

from armsight.calibrate.cameras.calibrate import calibrate_camera as calibrate_camera
from armsight.calibrate.cameras.calibrate import calibrate_stereo as calibrate_stereo
from armsight.calibrate.cameras.many_result import CamerasCalibration as CamerasCalibration
from armsight.calibrate.cameras.observations import BoardOptions as BoardOptions
from armsight.calibrate.cameras.result import CameraCalibration as CameraCalibration
from armsight.calibrate.cameras.result import StereoCalibration as StereoCalibration

CameraResult = CameraCalibration
RigResult = StereoCalibration
"""What `armsight` calls them; a mirror rig's is a RigResult too."""
