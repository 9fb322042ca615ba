"""armsight sees where a robot arm really is.

Everything public is here: `armsight.estimate_pose`, `armsight.read_rig` and the other names of `dir(armsight)`.
Arrays go in, records come out; lengths are in metres, angles in radians, pixels count from the centre of the top-left
one, and `T_a_b` is the pose of frame b in frame a.
"""

from __future__ import annotations

import re
import sys
from functools import cache
from importlib import import_module
from os import PathLike
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any

from armsight._files import Files

if TYPE_CHECKING:
    from armsight._version import __version__ as __version__
    from armsight.api.files import cut_recording as cut_recording
    from armsight.api.files import open_recording as open_recording
    from armsight.api.files import read_arm as read_arm
    from armsight.api.files import read_camera as read_camera
    from armsight.api.files import read_hand_eye as read_hand_eye
    from armsight.api.files import read_joints as read_joints
    from armsight.api.files import read_limits as read_limits
    from armsight.api.files import read_path as read_path
    from armsight.api.files import read_poses as read_poses
    from armsight.api.files import read_rig as read_rig
    from armsight.api.files import read_table as read_table
    from armsight.api.files import read_target as read_target
    from armsight.api.files import read_tool_tip as read_tool_tip
    from armsight.api.files import read_world as read_world
    from armsight.api.files import repair_recording as repair_recording
    from armsight.api.files import write_joints as write_joints
    from armsight.api.files import write_table as write_table
    from armsight.api.pose import LightTarget as LightTarget
    from armsight.api.pose import PoseEstimate as PoseEstimate
    from armsight.api.pose import estimate_pose as estimate_pose
    from armsight.api.pose import estimate_pose_from_spots as estimate_pose_from_spots
    from armsight.api.pose import find_spots as find_spots
    from armsight.api.remote import RemoteState as RemoteState
    from armsight.api.remote import RobotConnection as RobotConnection
    from armsight.api.remote import RobotDriver as RobotDriver
    from armsight.api.remote import connect as connect
    from armsight.api.remote import twin as twin
    from armsight.api.simulation import SimulatedFrame as SimulatedFrame
    from armsight.api.simulation import Simulation as Simulation
    from armsight.api.simulation import read_scenario as read_scenario
    from armsight.api.simulation import scenarios as scenarios
    from armsight.api.simulation import simulate as simulate
    from armsight.api.tracker import PoseTracker as PoseTracker
    from armsight.calibrate.arm import ArmResult as ArmResult
    from armsight.calibrate.arm import RobotWorldResult as RobotWorldResult
    from armsight.calibrate.camera_noise.photon_transfer import NoiseResult as NoiseResult
    from armsight.calibrate.cameras import BoardOptions as BoardOptions
    from armsight.calibrate.cameras import CameraResult as CameraResult
    from armsight.calibrate.cameras import RigResult as RigResult
    from armsight.calibrate.cameras.zoom import ZoomRigResult as ZoomRigResult
    from armsight.calibrate.cell import CellResult as CellResult
    from armsight.calibrate.handeye import HandEyeResult as HandEyeResult
    from armsight.calibrate.identify import Identification as Identification
    from armsight.calibrate.light_target import TargetResult as TargetResult
    from armsight.calibrate.timing import CamerasTiming as CamerasTiming
    from armsight.calibrate.timing import TimingResult as TimingResult
    from armsight.calibrate.tooltip_result import ToolTipResult as ToolTipResult
    from armsight.control.guard import Limits as Limits
    from armsight.drivers import CameraSettings as CameraSettings
    from armsight.drivers import Robot as Robot
    from armsight.drivers import RobotState as RobotState
    from armsight.drivers import Sent as Sent
    from armsight.errors import Ambiguous as Ambiguous
    from armsight.errors import ArmsightError as ArmsightError
    from armsight.errors import BadFile as BadFile
    from armsight.errors import BadImage as BadImage
    from armsight.errors import Cancelled as Cancelled
    from armsight.errors import DataRefused as DataRefused
    from armsight.errors import Degenerate as Degenerate
    from armsight.errors import DeviceFailed as DeviceFailed
    from armsight.errors import DeviceLost as DeviceLost
    from armsight.errors import DeviceNotFound as DeviceNotFound
    from armsight.errors import Inconsistent as Inconsistent
    from armsight.errors import NotConverged as NotConverged
    from armsight.errors import NotEnoughData as NotEnoughData
    from armsight.errors import RecordingFailed as RecordingFailed
    from armsight.errors import StaleData as StaleData
    from armsight.errors import Undetermined as Undetermined
    from armsight.errors import UsageError as UsageError
    from armsight.kinematics import Arm as Arm
    from armsight.kinematics import Inverse as Inverse
    from armsight.kinematics import Joint as Joint
    from armsight.kinematics import JointPath as JointPath
    from armsight.kinematics import presets as presets
    from armsight.measure.results import MeasureResult as MeasureResult
    from armsight.measure.settings import SpotSettings as SpotSettings
    from armsight.measure.track import PoseTrack as PoseTrack
    from armsight.ops import paths as paths
    from armsight.ops.boards import *
    from armsight.ops.calibrate_cameras import *
    from armsight.ops.calibrate_cell import *
    from armsight.ops.calibrate_hand_eye import *
    from armsight.ops.calibrate_mirrors import *
    from armsight.ops.calibrate_rig import *
    from armsight.ops.calibrate_robot import *
    from armsight.ops.convert import *
    from armsight.ops.files import *
    from armsight.ops.identify import *
    from armsight.ops.join import JoinResult as JoinResult
    from armsight.ops.kinematics import *
    from armsight.ops.machine import *
    from armsight.ops.mastering import *
    from armsight.ops.measure import *
    from armsight.ops.motion import *
    from armsight.ops.robots import *
    from armsight.ops.teach import *
    from armsight.ops.teaching import TeachResult as TeachResult
    from armsight.ops.verify import *
    from armsight.optics import Camera as Camera
    from armsight.optics import Rig as Rig
    from armsight.optics import triangulate as triangulate
    from armsight.records import Colour as Colour
    from armsight.records import Frame as Frame
    from armsight.records import JointReading as JointReading
    from armsight.records import NoiseModel as NoiseModel
    from armsight.records import PoseStatus as PoseStatus
    from armsight.records import Progress as Progress
    from armsight.records import Spots as Spots
    from armsight.records import Target as Target
    from armsight.records import TargetPose as TargetPose
    from armsight.records import TaughtPath as TaughtPath
    from armsight.store import World as World
    from armsight.store.foreign import FrameNames as FrameNames
    from armsight.store.interpret import TableFormat as TableFormat
    from armsight.store.recording import Recording as Recording
    from armsight.verify.results import VerifyResult as VerifyResult
    from armsight_lab.api import history as history
    from armsight_lab.api.batch import BatchResult as BatchResult
    from armsight_lab.api.batch import batch as batch
    from armsight_lab.api.design import design as design


@cache
def _places() -> dict[str, str]:
    """Return the module of each public name, as the imports above say; of those with a star, their `__all__`."""
    own = _source("__init__")
    found = {name: module for module, name in re.findall(r"^    from (\S+) import (\w+) as", own, re.M)}
    for module in re.findall(r"^    from armsight\.(\S+) import \*", own, re.M):
        names = re.findall(r"^__all__ = \[(.*?)\]", _source(module.replace(".", "/")), re.M | re.S)
        found |= dict.fromkeys(re.findall(r"\w+", "".join(names)), f"armsight.{module}")
    return found


def _source(place: str) -> str:
    return (Path(__file__).parent / f"{place}.py").read_text(encoding="utf-8")


_EARLIER = dict.fromkeys(
    (
        *("calibrate_hand_eye_from_images", "calibrate_hand_eye_from_streams", "identify_arm_from_frames"),
        *("ArmIdentification", "LiveIdentification"),
    ),
    "armsight.ops.earlier_names",
)
"""Names of earlier versions, which warn and say what to use."""


_EXTRAS = {"armsight_lab": "lab"}
"""Distributions of their own, by the extra that brings each."""


class _NotInstalled:
    """Stands for a public name of a distribution that is not installed, and refuses to be called or looked into."""

    def __init__(self, name: str, extra: str) -> None:
        self._name, self._extra = name, extra

    def __call__(self, *_: object, **__: object) -> None:
        from armsight.registry import not_installed

        raise not_installed(self._name, self._extra)

    def __getattr__(self, name: str) -> None:
        if name.startswith("_"):
            raise AttributeError(name)
        self()


_PACKAGES = ("measure", "verify")
"""Public names that are packages too."""


class _Face(ModuleType):
    """Keeps a public name such as armsight.measure what it is: importing the package of that name binds nothing."""

    def __setattr__(self, name: str, value: object) -> None:
        if not (name in _PACKAGES and isinstance(value, ModuleType)):
            super().__setattr__(name, value)


sys.modules[__name__].__class__ = _Face


def _save(record: object, path: str | PathLike[str]) -> Path:
    from armsight.ops.saving import save  # with all kinds of files, when the first is written

    return save(record, path)


def _plot(record: object) -> object:
    from armsight.report.figures import plot

    return plot(record)


Files.save, Files.plot = _save, _plot

if not TYPE_CHECKING:  # type checkers know the names above, and refuse all others

    def __getattr__(name: str) -> Any:
        if name == "__all__":
            return sorted(_places())
        place = _places().get(name) or _EARLIER.get(name)
        if place is None:
            raise AttributeError(f"module 'armsight' has no attribute {name!r}")
        try:
            module = import_module(place)
        except ModuleNotFoundError as error:
            if error.name not in _EXTRAS:
                raise
            return _NotInstalled(name, _EXTRAS[error.name])
        value = getattr(module, name, None)
        if value is None:  # a module of the face, such as armsight.paths
            value = import_module(f"{place}.{name}")
        if name not in _EARLIER:
            globals()[name] = value
        return value

    def __dir__() -> list[str]:
        return sorted(_places())
