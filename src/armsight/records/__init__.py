"""The nouns that flow through armsight: frozen, checked, copied, read-only."""

from armsight.records.by_value import ByValue, Saveable
from armsight.records.camera import AT_ONCE, CameraTiming, LinearNoise, NoiseModel
from armsight.records.checks import (
    changed,
    checked_array,
    checked_poses,
    checked_rows,
    for_kernels,
    freeze,
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
from armsight.records.measured import NotSeen, Points, PoseStatus, Spots, TargetPose
from armsight.records.motion import WELD_OFF, WELD_ON, JointReading, Motion, TaughtPath
from armsight.records.progress import Progress, Silent
from armsight.records.result_parts import NamedCovariance
from armsight.records.target import Colour, Target, TargetKind, board_target, spot_target, unmeasured_target
from armsight.records.views import BoardView, Frame, SpotTrack
