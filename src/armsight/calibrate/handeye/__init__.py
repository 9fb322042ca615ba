"""Hand-eye calibration that says whether it is right."""

from armsight.calibrate.handeye.advice import propose
from armsight.calibrate.handeye.calibrate import (
    calibrate_eye_in_hand,
    calibrate_eye_to_hand,
    expected_deviation,
)
from armsight.calibrate.handeye.image_comparison import ImageComparison, LeftOutErrors, ObservationModel
from armsight.calibrate.handeye.images import ImageHandEye, calibrate_from_views
from armsight.calibrate.handeye.noise import Noise, Part
from armsight.calibrate.handeye.one_axis import TargetHeight
from armsight.calibrate.handeye.pairs import PosePairs, Setup
from armsight.calibrate.handeye.result import HandEyeResult, Proposal, RejectedPair, Scale
from armsight.calibrate.handeye.solution import Solution, solve_pairs, warm_up
from armsight.calibrate.handeye.stream_pairing import TimeOffset, pairs_of_streams, time_offset

__all__ = [
    "HandEyeResult",
    "ImageComparison",
    "ImageHandEye",
    "LeftOutErrors",
    "Noise",
    "ObservationModel",
    "Part",
    "PosePairs",
    "Proposal",
    "RejectedPair",
    "Scale",
    "Setup",
    "Solution",
    "TargetHeight",
    "TimeOffset",
    "calibrate_eye_in_hand",
    "calibrate_eye_to_hand",
    "calibrate_from_views",
    "expected_deviation",
    "pairs_of_streams",
    "propose",
    "solve_pairs",
    "time_offset",
    "warm_up",
]
