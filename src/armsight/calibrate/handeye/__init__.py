"""Hand-eye calibration that says whether it is right."""

from armsight.calibrate.handeye.advice import scale_is_wrong, verdict
from armsight.calibrate.handeye.calibrate import (
    HandEyeOptions,
    calibrate_eye_in_hand,
    calibrate_eye_to_hand,
    expected_deviation,
)
from armsight.calibrate.handeye.noise import Noise, Part
from armsight.calibrate.handeye.pairs import PosePairs, Setup
from armsight.calibrate.handeye.result import HandEye, Scale
from armsight.calibrate.handeye.solution import Solution, solve_pairs

__all__ = [
    "HandEye",
    "HandEyeOptions",
    "Noise",
    "Part",
    "PosePairs",
    "Scale",
    "Setup",
    "Solution",
    "calibrate_eye_in_hand",
    "calibrate_eye_to_hand",
    "expected_deviation",
    "scale_is_wrong",
    "solve_pairs",
    "verdict",
]
