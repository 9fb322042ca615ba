"""The only place that touches hardware: cameras, robots, files as cameras."""

from armsight._files import DeviceLock
from armsight.drivers.camera_settings import AUTOMATIC, CameraSettings, PairSettings, by_side
from armsight.drivers.images import AS_THEY_ARE, ImageReading, list_images, read_image
from armsight.drivers.live import OpenCvCamera, cameras_there
from armsight.drivers.moments import FileMoments, Moment, Moments, OneImage, by_name, moments_of, news_of, pairs_of
from armsight.drivers.opening import CAMERA, is_live, is_video, open_moments, open_source
from armsight.drivers.pace import Pace, Paced
from armsight.drivers.protocols import (
    PROVING,
    FrameSource,
    MomentSource,
    Robot,
    RobotState,
    RobotTraits,
    Sent,
    Views,
    listen,
)
from armsight.drivers.replay import Replay, ReplayRobot, check_forward
from armsight.drivers.sources import FPS, Capture, ImageFolder, VideoFile, cores, frame_period_s, ordered_map
from armsight.drivers.timed_moments import MAX_SKEW_S, RecordedMoments, TimedMoments
from armsight.records.result_parts import Skew
from armsight.registry import CAMERAS, CELLS, PAPERS, ROBOTS, SCENARIOS, SETS, TWINS, folder, known, load

__all__ = [
    "AS_THEY_ARE",
    "AUTOMATIC",
    "CAMERA",
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
    "MomentSource",
    "Moments",
    "OneImage",
    "OpenCvCamera",
    "Pace",
    "Paced",
    "PairSettings",
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
    "Views",
    "by_name",
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
    "moments_of",
    "news_of",
    "open_moments",
    "open_source",
    "ordered_map",
    "pairs_of",
    "read_image",
]
