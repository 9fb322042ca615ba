"""The keys that other programs rely on: as the contract names them, described, and left out or null as promised."""

from __future__ import annotations

import json
from collections.abc import Iterator
from math import inf, nan
from pathlib import Path

import pytest
from pydantic import ValidationError

from armsight.app.schemas import (
    arm,
    cameras,
    compare,
    files,
    handeye,
    kinematics,
    machine,
    measure,
    paths,
    play,
    reproduce,
    robot,
    servo,
    timing,
    verify,
    verify_live,
)
from armsight.app.schemas.base import Output, PointStd, PoseOutput, PoseStd, absent
from armsight.app.schemas.catalogue import OUTPUTS

MEASURE = "n_frames n_ok n_doubtful n_position_only n_lost reprojection_rms_px ms_per_frame reasons"
MEASURE_MAYBE = "candidates std consistency skew timing error zoom assumed_fps made_with"
STEREO = (
    "rms_px epipolar_rms_px baseline_m n_pairs n_used rejected std holdout_rms_px holdout_epipolar_rms_px metric "
    "metric_is_left_out alignment advice"
)
HANDEYE = (
    "setup std std_target n_pairs n_used rejected residual_rms_m residual_rms_rad loo_rms_m loo_rms_rad noise "
    "turning_rms_rad verdict concerns advice"
)
HANDEYE_MAYBE = (
    "T_flange_camera T_base_target T_base_camera T_flange_target target_scale reprojection_rms_px time_offset_s "
    "time_offset_std_s proposals n_effective correlation_time_s crossval camera_file covariance_factor"
)
TIP = "tip_m point_m std residual_rms_m n_used rejected turning_rms_rad notes"
TIP_MAYBE = "mean_tip_m loo_rms_m n_effective correlation_time_s"
ARM = (
    "n before after crossval free fixed std corrections condition outliers still couplings at_limit notes "
    "noise model verdict gain other_arm urdf"
)
PATH = "file n_before n length_m corners"
PLACE, TURN = "x_m y_m z_m", "rx_rad ry_rad rz_rad"
NOISE = "linear levels variance_levels2 std_levels2 correlation n_frames widening"

KEYS: dict[type[Output], tuple[str, str]] = {
    OUTPUTS["measure"]: (MEASURE, MEASURE_MAYBE),
    measure.FrameTime: ("median p99", ""),
    measure.PoseDeviations: ("total random systematic", ""),
    measure.SkewOutput: ("mean_s largest_s n_dropped", ""),
    measure.ConsistencyOutput: (
        "verdict cause estimate std unit effect_m effect_rad since_s equally_likely others components chi2_per_dof "
        "noise_scale refused claimed_m n_frames undetected_m sentence advice",
        "",
    ),
    OUTPUTS["demo"]: (f"{MEASURE} truth inside_95 seconds_s assumptions pictures", MEASURE_MAYBE),
    measure.TruthError: ("rms max claimed", ""),
    OUTPUTS["reproduce"]: (
        "paper seed scenarios tables figures n_compared n_reached missed assumptions doubts missing seconds_s",
        "",
    ),
    reproduce.ReproducedTable: (
        "title rows paper paper_method armsight truth paper_truth errors credible share share_of_method notes",
        "",
    ),
    reproduce.ReproducedErrors: ("paper paper_method armsight", ""),
    OUTPUTS["verify-live"]: (
        "n n_compared n_lost n_stale duration_s rate_hz missed level stopped alarms errors levels blind_s decision_ms "
        "recording doubts verdict",
        "",
    ),
    verify_live.LiveAlarm: ("t_s level why", ""),
    verify_live.LiveErrors: ("rms_m max_m rms_rad max_rad std_m std_rad", ""),
    verify_live.LiveLevels: ("warn_m stop_m warn_rad stop_rad", ""),
    verify_live.DecisionTime: ("median p99", ""),
    OUTPUTS["verify-mastering"]: (
        "n cause offset_rad std_rad rms_before_m rms_after_m joints rejected doubts verdict",
        "tool_moved",
    ),
    verify_live.MasteringJoint: ("index name judged why offset_rad std_rad", ""),
    OUTPUTS["verify-mastering-poses"]: ("poses expected_std_rad file notes", ""),
    verify_live.MasteringPose: ("q decides", ""),
    OUTPUTS["calibrate-camera"]: (
        "rms_px n_images n_used rejected fx_px fy_px cx_px cy_px distortion std holdout_rms_px advice",
        "noise zoom lens",
    ),
    cameras.ZoomOutput: ("zoom settings focal_lengths_px left_out focal_error_rms advice", ""),
    cameras.LeftOutSetting: ("zoom focal_error_px focal_std_px image_rms_px", ""),
    OUTPUTS["calibrate-zoom-rig"]: ("settings at pupils advice", ""),
    measure.ZoomAt: ("zoom interpolated fx_px fx_std_px fx_interpolation_px pupil_m", ""),
    OUTPUTS["calibrate-camera-noise"]: ("noise", ""),
    cameras.CameraNoise: (NOISE, ""),
    cameras.MeasuredNoise: (
        f"{NOISE} n_given n_copies brightness_rms shift_px_rms moving frozen unusable frame_ratio line_deviation "
        "advice",
        "",
    ),
    OUTPUTS["calibrate-stereo"]: (STEREO, ""),
    cameras.AlignmentOutput: ("convergence_rad vertical_rad vertical_px roll_rad height_m advance_m", ""),
    OUTPUTS["calibrate-mirrors"]: (f"{STEREO} one_lens forms", ""),
    cameras.MirrorAlignment: ("convergence_rad vertical_rad vertical_px roll_rad height_m advance_m plate", ""),
    cameras.PlateOutput: ("m_m l_m thickness_m index seen_thickness_m seen_thickness_std_m", ""),
    cameras.FormOutput: ("name x_m y_m z_m epipolar_px", ""),
    OUTPUTS["calibrate-mirrors-check"]: (
        "alignment change change_std moved certain suspects advice n_views missed",
        "turns",
    ),
    cameras.SuspectMirror: ("mirror turn_rad tilt_rad chi2", ""),
    cameras.MirrorTurnOutput: ("mirror turn_rad tilt_rad", ""),
    OUTPUTS["calibrate-target"]: (
        "spots_m std distances_m n_frames n_used rejected residual_rms_px loo_rms_px advice",
        "",
    ),
    OUTPUTS["calibrate-timing"]: (
        "delay_s drift_ppm readout_s jitter_s std middle_s std_middle_s period_s n_frames lost common_s lights "
        "residual_px verdict advice",
        "",
    ),
    timing.BothSeconds: ("left right", ""),
    OUTPUTS["calibrate-handeye"]: (HANDEYE, HANDEYE_MAYBE),
    handeye.RejectedPair: ("row name why", ""),
    handeye.NoisePart: ("value", "std at_most"),
    handeye.ImageCrossval: ("kept n_images poses corners why", "corners_and_camera"),
    handeye.ImagesLeftOut: ("position_m orientation_rad points_m reprojection_px", ""),
    handeye.HandEyeNoise: ("translation_m robot_m camera_m robot_rad camera_rad", ""),
    PoseOutput: ("xyz_m quat_xyzw", ""),
    PointStd: (PLACE, ""),
    PoseStd: (f"{PLACE} {TURN}", ""),
    OUTPUTS["calibrate-tooltip"]: (TIP, TIP_MAYBE),
    OUTPUTS["calibrate-pivot"]: (f"{TIP} goal_m reached", TIP_MAYBE),
    OUTPUTS["calibrate-arm"]: (ARM, "holdout proposals expected_std n_effective correlation_time_s"),
    arm.ToolErrors: ("mean_m rms_m max_m", ""),
    arm.BeforeAfter: ("before after", ""),
    arm.Outlier: ("row error_m", ""),
    OUTPUTS["calibrate-robot-world"]: ("T_base_rig std residual_rms_m n_used rejected notes", ""),
    OUTPUTS["identify"]: ("joints method notes noise misfit", "plan left_out"),
    arm.LeftOutJoint: ("joint held_at", ""),
    arm.IdentifiedJoint: (
        "index type a_m alpha_rad d_m theta_rad beta_rad lower upper sign std n discarded residual_rms_m "
        "residual_rms_px p_line decided radius_m axis",
        "",
    ),
    arm.JointAxis: ("point_m direction", ""),
    OUTPUTS["identify-propose"]: ("plan notes", ""),
    arm.PlanOutput: ("sweeps expected_std noise_px notes", ""),
    arm.PlannedSweepOutput: ("joint from to readings rest way radius_m ended_by", ""),
    OUTPUTS["verify"]: (
        "n time alignment before after task measurement_std joints cause kind parameters explained iso9283 rejected "
        "doubts verdict",
        "configurations decide_by compared",
    ),
    verify.VerifyTime: ("offset_s std_s drift_ppm bursts", ""),
    verify.VerifyAlignment: ("free T_measured_base T_flange_tool std undetermined", ""),
    verify.PoseError: ("rms_m rms_rad max_m", ""),
    verify.ErrorFigures: ("me mae max sd rms", ""),
    verify.VerifyJoint: (
        "index name me mae max sd rms measurement_std offset_rad std_rad judged why gain_heldout kind",
        "",
    ),
    verify.CauseParameter: ("value std", ""),
    verify.Explained: ("measurement joint zeros model", ""),
    verify.ConfigurationPairs: ("n mean_m p95_m max_m", ""),
    verify.IsoFigure: ("value n wanted withheld std corrected corrected_std note", ""),
    OUTPUTS["verify-plan"]: (
        "arm cube quat_xyzw speed_m_s poses motions branch singularity_distance limit_margin refused files",
        "",
    ),
    verify.PlannedCube: ("centre_m side_m plane corners_m", ""),
    verify.PlannedPose: ("xyz_m q", ""),
    verify.PlannedTest: ("test figures repeats n", ""),
    verify.ComparedRun: ("folder n after cause", ""),
    OUTPUTS["record"]: (
        "file format n_pairs n_dropped n_missed duration_s pairs_per_s size_bytes skew_s",
        "",
    ),
    OUTPUTS["record-repair"]: ("file messages duration_s lost_bytes damaged_chunks", ""),
    OUTPUTS["convert-recording"]: ("from out n", ""),
    OUTPUTS["compare"]: ("kind a b agree verdict p parameters effects notes", "n report same_rig same_target"),
    compare.ComparedParameter: ("name unit a b difference std sigmas", ""),
    compare.ComparedEffect: ("name value unit", ""),
    OUTPUTS["join"]: ("kind by offset_s offset_std_s drift_ppm n_measured n rejected notes", "file"),
    OUTPUTS["convert-table"]: ("kind how columns ranges n notes file", ""),
    OUTPUTS["convert"]: ("from to files n note", ""),
    OUTPUTS["convert-arm"]: ("arm file joints convention", ""),
    OUTPUTS["simulate"]: ("scenario seed n_frames out", "n_dropped views commands"),
    OUTPUTS["kinematics-fk"]: ("arm n n_beyond_limits", ""),
    OUTPUTS["kinematics-ik"]: ("arm n status unsolved", ""),
    kinematics.UnsolvedPose: ("pose status why", ""),
    OUTPUTS["kinematics-jacobian"]: ("arm n axes", ""),
    OUTPUTS["kinematics-path"]: ("arm n n_reached branch issues", ""),
    kinematics.PathIssue: ("kind first last worst joint value limit text", ""),
    OUTPUTS["kinematics-formulas"]: ("arm file", ""),
    OUTPUTS["kinematics-show"]: ("arm file tool_xyz_m", ""),
    OUTPUTS["path-change"]: (PATH, ""),
    OUTPUTS["path-smooth"]: (f"{PATH} outliers dropped moved_max_m moved_rms_m turned_max_rad", ""),
    paths.PathOutlierOutput: ("row off_m off_rad text", ""),
    OUTPUTS["path-check"]: ("arm ok n n_reached length_m duration_s troubles issues start_q", ""),
    paths.PathIssueOutput: ("row trouble value limit text", ""),
    OUTPUTS["path-export"]: ("file format n length_m checked start_q", ""),
    OUTPUTS["path-from-picks"]: ("file frame n n_picks length_m points refused", ""),
    paths.PickedPointOutput: ("pick px other_px std_px correlation second xyz_m std", ""),
    paths.RefusedPickOutput: ("pick u_px v_px kind why", ""),
    OUTPUTS["robot-test"]: ("driver cycle_s n_cycles late missed period_ms silence_ms q state", ""),
    robot.PeriodOutput: ("median p99 max", ""),
    OUTPUTS["robot-jog"]: ("asked sent reached limited outside state", ""),
    OUTPUTS["servo"]: (
        "state n_cycles late missed stopped_by n_frames n_ok n_doubtful n_position_only n_lost gain delay error "
        "followed outside holds vision_ms recording",
        "",
    ),
    OUTPUTS["teach"]: (
        "state n_cycles late stopped_by path parent n_rows n_stretches length_m n_ok n_doubtful n_position_only n_lost "
        "n_unplaced servo",
        "",
    ),
    OUTPUTS["play"]: (
        "state n_cycles late missed stopped_by finished share length_m planned_fastest_m_s planned_s took_s slowest "
        "rounded_m measured outside holds recording",
        "",
    ),
    play.PlayMeasuredOutput: ("n rms_m max_m last_m mean_m arm_lag_s n_doubtful n_position_only n_lost", ""),
    servo.ServoGainOutput: ("used no_overshoot stable cycle_s n_delay note", ""),
    servo.ServoDelayOutput: ("camera_s arm_s", ""),
    servo.ServoErrorOutput: ("rms_m max_m last_m last_rad", ""),
    servo.ServoTimeOutput: ("median p99", ""),
    OUTPUTS["doctor"]: ("versions machine cameras drivers kernels problems rig", ""),
    machine.RigResolution: ("baseline_m rms_px sigma_px distances", "accuracy"),
    machine.AccuracyPlan: ("accuracy_m depths_m sigma_px baseline_m settings advice", ""),
    machine.SettingPlan: ("zoom_left zoom_right focal_px now reached baseline_m at_baseline", ""),
    machine.ReachedAccuracy: ("spots_m rig_m total_m common width_m", ""),
    OUTPUTS["error"]: ("error", ""),
}
"""Keys that are always there, and those left out where they do not apply."""


def models(base: type[Output] = Output) -> Iterator[type[Output]]:
    """Every model of the package."""
    for model in base.__subclasses__():
        if model.__module__.startswith("armsight."):
            yield model
            yield from models(model)


@pytest.mark.parametrize("model", KEYS, ids=lambda model: model.__name__)
def test_the_keys_are_those_that_programs_rely_on(model: type[Output]) -> None:
    always, maybe = KEYS[model]
    schema = model.model_json_schema(mode="serialization")
    assert set(schema["properties"]) == set(f"{always} {maybe}".split())
    assert set(schema["required"]) == set(always.split())


def test_every_command_has_its_keys_written_down() -> None:
    assert set(OUTPUTS.values()) <= set(KEYS)


@pytest.mark.parametrize("model", sorted(set(models()), key=lambda model: model.__name__), ids=lambda m: m.__name__)
def test_every_key_is_described_in_one_line(model: type[Output]) -> None:
    for name, field in model.model_fields.items():
        if field.exclude:  # an object beside the figures, in Python only
            continue
        assert field.description and field.description.endswith("."), name
        assert "\n" not in field.description and len(field.description) < 170, name
        # what has a default is left out where it is None, what has none is always there
        assert field.is_required() == (field.exclude_if is None), name
        assert field.is_required() or (field.default is None and field.exclude_if is absent), name


def test_a_key_that_does_not_apply_is_left_out_and_a_figure_without_data_is_null() -> None:
    known, unknown = handeye.NoisePart(value=1e-3, std=1e-4), handeye.NoisePart(value=None, at_most=2e-3)
    assert known.to_dict() == {"value": 1e-3, "std": 1e-4}
    assert unknown.to_dict() == {"value": None, "at_most": 2e-3}


def test_a_number_that_is_not_finite_becomes_null_in_text_only(tmp_path: Path) -> None:
    error = measure.TruthError(rms=nan, max=inf, claimed=1.0)
    assert error.to_dict()["max"] == inf
    assert json.loads(error.to_json()) == {"rms": None, "max": None, "claimed": 1.0}
    error.write(tmp_path / "out" / "error.json")
    assert json.loads((tmp_path / "out" / "error.json").read_text()) == {"rms": None, "max": None, "claimed": 1.0}


def test_words_of_python_are_no_obstacle_to_keys() -> None:
    done = files.ExportOutput(source="a.mcap", out="b", n={"times.csv": 3})
    assert done.to_dict() == {"from": "a.mcap", "out": "b", "n": {"times.csv": 3}}


def test_a_result_cannot_be_changed_and_takes_no_unknown_key() -> None:
    std = PointStd(x_m=1.0, y_m=2.0, z_m=3.0)
    assert std.translation_m == (1.0, 2.0, 3.0)
    with pytest.raises(ValidationError):
        std.x_m = 0.0  # type: ignore[misc]
    with pytest.raises(ValidationError):
        PointStd(x_m=1.0, y_m=2.0, z_m=3.0, w_m=4.0)  # type: ignore[call-arg]
