"""armsight sees where a robot arm really is.

Everything public is here: `armsight.estimate_pose`, `armsight.read_rig` and the other names of `dir(armsight)`.
Arrays go in, records come out; lengths are in metres, angles in radians, pixels count from the centre of the top-left
one, and `T_a_b` is the pose of frame b in frame a.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from armsight._version import __version__ as __version__

if TYPE_CHECKING:
    from armsight.api.cameras import CameraResult as CameraResult
    from armsight.api.cameras import RigResult as RigResult
    from armsight.api.cameras import calibrate_camera as calibrate_camera
    from armsight.api.cameras import calibrate_mirrors as calibrate_mirrors
    from armsight.api.cameras import calibrate_stereo as calibrate_stereo
    from armsight.api.files import open_recording as open_recording
    from armsight.api.files import read_arm as read_arm
    from armsight.api.files import read_camera as read_camera
    from armsight.api.files import read_joints as read_joints
    from armsight.api.files import read_path as read_path
    from armsight.api.files import read_poses as read_poses
    from armsight.api.files import read_rig as read_rig
    from armsight.api.files import read_target as read_target
    from armsight.api.pose import LightTarget as LightTarget
    from armsight.api.pose import PoseEstimate as PoseEstimate
    from armsight.api.pose import PoseTracker as PoseTracker
    from armsight.api.pose import estimate_pose as estimate_pose
    from armsight.api.pose import find_spots as find_spots
    from armsight.api.remote import RobotConnection as RobotConnection
    from armsight.api.remote import connect as connect
    from armsight.api.robots import ArmIdentification as ArmIdentification
    from armsight.api.robots import ArmResult as ArmResult
    from armsight.api.robots import HandEyeResult as HandEyeResult
    from armsight.api.robots import ToolTipResult as ToolTipResult
    from armsight.api.robots import calibrate_arm as calibrate_arm
    from armsight.api.robots import calibrate_hand_eye as calibrate_hand_eye
    from armsight.api.robots import calibrate_tool_tip as calibrate_tool_tip
    from armsight.api.robots import identify_arm as identify_arm
    from armsight.api.simulation import Simulation as Simulation
    from armsight.api.simulation import scenarios as scenarios
    from armsight.api.simulation import simulate as simulate
    from armsight.api.tracks import PoseTrack as PoseTrack
    from armsight.errors import ArmsightError as ArmsightError
    from armsight.errors import DataRefused as DataRefused
    from armsight.errors import UsageError as UsageError
    from armsight.kinematics import Arm as Arm
    from armsight.kinematics import Joint as Joint
    from armsight.kinematics import presets as presets
    from armsight.measure.settings import SpotSettings as SpotSettings
    from armsight.optics import Camera as Camera
    from armsight.optics import Rig as Rig
    from armsight.optics import triangulate as triangulate
    from armsight.records import Colour as Colour
    from armsight.records import PoseStatus as PoseStatus
    from armsight.records import Spots as Spots
    from armsight.records import Target as Target
    from armsight.records import TaughtPath as TaughtPath

_MODULES: dict[str, tuple[str, ...]] = {
    "armsight.api.pose": (
        "LightTarget",
        "PoseEstimate",
        "PoseTracker",
        "estimate_pose",
        "find_spots",
    ),
    "armsight.api.tracks": ("PoseTrack",),
    "armsight.api.cameras": (
        "CameraResult",
        "RigResult",
        "calibrate_camera",
        "calibrate_mirrors",
        "calibrate_stereo",
    ),
    "armsight.api.robots": (
        "ArmIdentification",
        "ArmResult",
        "HandEyeResult",
        "ToolTipResult",
        "calibrate_arm",
        "calibrate_hand_eye",
        "calibrate_tool_tip",
        "identify_arm",
    ),
    "armsight.api.files": (
        "open_recording",
        "read_arm",
        "read_camera",
        "read_joints",
        "read_path",
        "read_poses",
        "read_rig",
        "read_target",
    ),
    "armsight.api.remote": (
        "RobotConnection",
        "connect",
    ),
    "armsight.api.simulation": (
        "Simulation",
        "scenarios",
        "simulate",
    ),
    "armsight.measure.settings": ("SpotSettings",),
    "armsight.kinematics": (
        "Arm",
        "Joint",
        "presets",
    ),
    "armsight.optics": (
        "Camera",
        "Rig",
        "triangulate",
    ),
    "armsight.records": (
        "Colour",
        "PoseStatus",
        "Spots",
        "Target",
        "TaughtPath",
    ),
    "armsight.errors": (
        "ArmsightError",
        "DataRefused",
        "UsageError",
    ),
}
"""The public names by the module that they are loaded from when first used: importing armsight itself loads nothing."""

_PLACES = {name: module for module, names in _MODULES.items() for name in names}


def __getattr__(name: str) -> Any:
    if name not in _PLACES:
        raise AttributeError(f"module 'armsight' has no attribute {name!r}")
    module = import_module(_PLACES[name])
    value = getattr(module, name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted([*_PLACES, "__version__"])
