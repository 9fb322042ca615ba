"""The nouns that flow through armsight: frozen, checked, copied, read-only."""

from armsight.records.board import BoardView
from armsight.records.by_value import ByValue, Saveable
from armsight.records.checks import (
    checked_array,
    checked_poses,
    checked_rows,
    for_kernels,
    frozen_array,
    one_of,
    real_array,
    require_count,
    require_kind,
    require_number,
    require_numbers,
    require_rigid,
    require_texts,
    trusted,
)
from armsight.records.covariance import NamedCovariance
from armsight.records.frames import Frame
from armsight.records.measured import NotSeen, Points, PoseStatus, Spots, TargetPose
from armsight.records.motion import JointReading, Motion
from armsight.records.noise import LinearNoise, NoiseModel
from armsight.records.path import WELD_OFF, WELD_ON, TaughtPath
from armsight.records.progress import Progress, Silent
from armsight.records.target import Colour, Target, TargetKind, board_target, spot_target, unmeasured_target
from armsight.records.timing import AT_ONCE, CameraTiming
from armsight.records.tracks import SpotTrack

__all__ = [
    "AT_ONCE",
    "WELD_OFF",
    "WELD_ON",
    "BoardView",
    "ByValue",
    "CameraTiming",
    "Colour",
    "Frame",
    "JointReading",
    "LinearNoise",
    "Motion",
    "NamedCovariance",
    "NoiseModel",
    "NotSeen",
    "Points",
    "PoseStatus",
    "Progress",
    "Saveable",
    "Silent",
    "SpotTrack",
    "Spots",
    "Target",
    "TargetKind",
    "TargetPose",
    "TaughtPath",
    "board_target",
    "checked_array",
    "checked_poses",
    "checked_rows",
    "for_kernels",
    "frozen_array",
    "one_of",
    "real_array",
    "require_count",
    "require_kind",
    "require_number",
    "require_numbers",
    "require_rigid",
    "require_texts",
    "spot_target",
    "trusted",
    "unmeasured_target",
]
