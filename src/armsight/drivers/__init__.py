"""The only place that touches hardware: cameras, robots, files as cameras."""

from armsight._files import DeviceLock
from armsight.drivers.camera_settings import AUTOMATIC, CameraSettings, PairSettings, by_side
from armsight.drivers.images import AS_THEY_ARE, ImageReading, list_images, read_image
from armsight.drivers.live import LivePairs, OpenCvCamera, cameras_there
from armsight.drivers.opening import (
    FilePairs,
    Overlaid,
    SplitImages,
    ended_early,
    is_live,
    is_video,
    open_pairs,
    open_source,
    open_split,
)
from armsight.drivers.pace import Pace, Paced
from armsight.drivers.protocols import PROVING, FrameSource, PairSource, Robot, RobotState, RobotTraits, Sent, listen
from armsight.drivers.replay import Replay, ReplayRobot, check_forward
from armsight.drivers.sources import FPS, Capture, ImageFolder, VideoFile, cores, frame_period_s, ordered_map
from armsight.records.result_parts import Skew
from armsight.registry import CAMERAS, CELLS, PAPERS, ROBOTS, SCENARIOS, SETS, TWINS, folder, known, load

__all__ = [
    "AS_THEY_ARE",
    "AUTOMATIC",
    "CAMERAS",
    "CELLS",
    "FPS",
    "PAPERS",
    "PROVING",
    "ROBOTS",
    "SCENARIOS",
    "SETS",
    "TWINS",
    "CameraSettings",
    "Capture",
    "DeviceLock",
    "FilePairs",
    "FrameSource",
    "ImageFolder",
    "ImageReading",
    "LivePairs",
    "OpenCvCamera",
    "Overlaid",
    "Pace",
    "Paced",
    "PairSettings",
    "PairSource",
    "Replay",
    "ReplayRobot",
    "Robot",
    "RobotState",
    "RobotTraits",
    "Sent",
    "Skew",
    "SplitImages",
    "VideoFile",
    "by_side",
    "cameras_there",
    "check_forward",
    "cores",
    "ended_early",
    "folder",
    "frame_period_s",
    "is_live",
    "is_video",
    "known",
    "list_images",
    "listen",
    "load",
    "open_pairs",
    "open_source",
    "open_split",
    "ordered_map",
    "read_image",
]
