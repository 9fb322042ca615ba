"""The only place that touches hardware: cameras, robots, files as cameras."""

from armsight._files import DeviceLock
from armsight.drivers.camera_settings import AUTOMATIC, CameraSettings, PairSettings, by_side
from armsight.drivers.images import AS_THEY_ARE, ImageReading, list_images, read_image
from armsight.drivers.live import OpenCvCamera, cameras_there
from armsight.drivers.moments import FileMoments, Moment, Moments, OneImage
from armsight.drivers.opening import is_live, is_video, open_moments, open_pairs, open_source
from armsight.drivers.pace import Pace, Paced
from armsight.drivers.protocols import PROVING, FrameSource, PairSource, Robot, RobotState, RobotTraits, Sent, listen
from armsight.drivers.replay import Replay, ReplayRobot, check_forward
from armsight.drivers.sources import FPS, Capture, ImageFolder, VideoFile, cores, frame_period_s, ordered_map
from armsight.drivers.timed_moments import MAX_SKEW_S, RecordedMoments, TimedMoments
from armsight.records.result_parts import Skew
from armsight.registry import CAMERAS, CELLS, PAPERS, ROBOTS, SCENARIOS, SETS, TWINS, folder, known, load

__all__ = [
    "AS_THEY_ARE",
    "AUTOMATIC",
    "CAMERAS",
    "CELLS",
    "FPS",
    "MAX_SKEW_S",
    "PAPERS",
    "PROVING",
    "ROBOTS",
    "SCENARIOS",
    "SETS",
    "TWINS",
    "CameraSettings",
    "Capture",
    "DeviceLock",
    "FileMoments",
    "FrameSource",
    "ImageFolder",
    "ImageReading",
    "Moment",
    "Moments",
    "OneImage",
    "OpenCvCamera",
    "Pace",
    "Paced",
    "PairSettings",
    "PairSource",
    "RecordedMoments",
    "Replay",
    "ReplayRobot",
    "Robot",
    "RobotState",
    "RobotTraits",
    "Sent",
    "Skew",
    "TimedMoments",
    "VideoFile",
    "by_side",
    "cameras_there",
    "check_forward",
    "cores",
    "folder",
    "frame_period_s",
    "is_live",
    "is_video",
    "known",
    "list_images",
    "listen",
    "load",
    "open_moments",
    "open_pairs",
    "open_source",
    "ordered_map",
    "read_image",
]
