"""Hand-eye calibration that says whether it is right."""

from armsight.calibrate.handeye.advice import propose as propose
from armsight.calibrate.handeye.calibrate import calibrate_eye_in_hand as calibrate_eye_in_hand
from armsight.calibrate.handeye.calibrate import calibrate_eye_to_hand as calibrate_eye_to_hand
from armsight.calibrate.handeye.calibrate import expected_deviation as expected_deviation
from armsight.calibrate.handeye.image_comparison import ImageComparison as ImageComparison
from armsight.calibrate.handeye.image_comparison import LeftOutErrors as LeftOutErrors
from armsight.calibrate.handeye.image_comparison import ObservationModel as ObservationModel
from armsight.calibrate.handeye.images import ImageHandEye as ImageHandEye
from armsight.calibrate.handeye.images import calibrate_from_views as calibrate_from_views
from armsight.calibrate.handeye.noise import Noise as Noise
from armsight.calibrate.handeye.noise import Part as Part
from armsight.calibrate.handeye.one_axis import TargetHeight as TargetHeight
from armsight.calibrate.handeye.pairs import PosePairs as PosePairs
from armsight.calibrate.handeye.pairs import Setup as Setup
from armsight.calibrate.handeye.result import HandEyeResult as HandEyeResult
from armsight.calibrate.handeye.result import Proposal as Proposal
from armsight.calibrate.handeye.result import RejectedPair as RejectedPair
from armsight.calibrate.handeye.result import Scale as Scale
from armsight.calibrate.handeye.solution import Solution as Solution
from armsight.calibrate.handeye.solution import solve_pairs as solve_pairs
from armsight.calibrate.handeye.solution import warm_up as warm_up
from armsight.calibrate.handeye.stream_pairing import TimeOffset as TimeOffset
from armsight.calibrate.handeye.stream_pairing import pairs_of_streams as pairs_of_streams
from armsight.calibrate.handeye.stream_pairing import time_offset as time_offset
