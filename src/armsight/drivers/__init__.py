"""The only place that touches hardware: cameras, robots, files as cameras."""

from armsight._files import DeviceLock
from armsight.drivers.ahead import Ahead, FileSource, cores
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
from armsight.drivers.sources import FPS, Capture, ImageFolder, VideoFile, frame_period_s
from armsight.drivers.timed_moments import MAX_SKEW_S, RecordedMoments, TimedMoments
from armsight.records.result_parts import Skew
from armsight.registry import CAMERAS, CELLS, PAPERS, ROBOTS, SCENARIOS, SETS, TWINS, folder, known, load
