"""Calibrations of other programs and devices, read and written: see formats for the kinds of cameras' files.

Written only: COLMAP, TF, easy_handeye.
"""

from armsight.store.foreign.formats import (
    FORMATS,
    READ,
    WRITTEN,
    CameraFormat,
    read_foreign_camera,
    read_foreign_rig,
)
from armsight.store.foreign.kalibr import camera_from_kalibr, camera_to_kalibr, rig_from_kalibr, rig_to_kalibr
from armsight.store.foreign.opencv import camera_from_opencv, camera_to_opencv, rig_from_opencv, rig_to_opencv
from armsight.store.foreign.ros import camera_from_ros, camera_to_ros, rig_from_ros, rig_to_ros
from armsight.store.foreign.several import Asked
from armsight.store.foreign.storage import kind_of
from armsight.store.foreign.written import (
    FrameNames,
    Transform,
    write_easy_handeye,
    write_easy_handeye2,
    write_tf_launch,
)
