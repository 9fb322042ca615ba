"""Which Python name does what a command of the command line does: for the table in the docs, and for error texts."""

from __future__ import annotations

import re
from collections.abc import Mapping

from armsight.errors import ArmsightError

COMMANDS: Mapping[str, str] = {
    "measure": "measure",
    "batch": "batch",
    "record": "record",
    "verify": "verify",
    "compare": "compare",
    "design": "design",
    "join": "join",
    "identify": "identify_arm",
    "simulate": "simulate",
    "reproduce": "reproduce",
    "doctor": "doctor",
    "servo": "servo",
    "teach": "teach",
    "play": "play",
    "twin": "twin",
    "calibrate camera": "calibrate_camera",
    "calibrate stereo": "calibrate_stereo",
    "calibrate mirrors": "calibrate_mirrors",
    "calibrate zoom-rig": "calibrate_zoom_rig",
    "calibrate handeye": "calibrate_hand_eye",
    "calibrate tooltip": "calibrate_tool_tip",
    "calibrate pivot": "calibrate_pivot",
    "calibrate arm": "calibrate_arm",
    "calibrate robot-world": "calibrate_robot_world",
    "calibrate target": "calibrate_target",
    "calibrate timing": "calibrate_timing",
    "calibrate cell": "calibrate_cell",
    "convert recording": "export_recording",
    "convert camera": "convert",
    "convert rig": "convert",
    "convert poses": "convert",
    "convert table": "convert",
    "convert handeye": "convert",
    "convert arm": "convert",
    "kinematics fk": "Arm.fk",
    "kinematics ik": "Arm.ik_many",
    "kinematics jacobian": "Arm.jacobian",
    "kinematics path": "Arm.track",
    "robot test": "check_robot",
    "robot jog": "jog",
}
"""The public name that does what a command does; tools/python_flags.py lists every flag."""

PARAMETERS: Mapping[str, str] = {
    "--approach-speed": "approach_speed_m_s",
    "--arm-lag": "arm_lag_s",
    "--arm-noise-mm": "arm_noise_m",
    "--arm-turn-deg": "arm_turn_rad",
    "--as": "kind",
    "--band": "band_m",
    "--baseline": "baseline_m",
    "--baseline-mm": "baseline_m",
    "--blend": "blend_m",
    "--clocks-within": "clocks_within_s",
    "--cycle": "cycle_s",
    "--distance": "distance_m",
    "--exposure": "exposure_s",
    "--focal-mm": "focal_m",
    "--for": "for_s",
    "--from": "poses",
    "--gap-mm": "gap_m",
    "--goal": "goal_m",
    "--jobs": "workers",
    "--hand-speed": "hand_speed_m_s",
    "--latency": "latency_s",
    "--latency-std": "latency_std_s",
    "--max-skew": "max_skew_s",
    "--near-mm": "near_m",
    "--no-prediction": "predict",
    "--offset": "offset_s",
    "--path-speed": "path_speed_m_s",
    "--pixel-um": "pixel_m",
    "--plate-mm": "thickness_m",
    "--point": "point_m",
    "--point-sigma": "point_std_m",
    "--pupil": "pupil_m",
    "--pupil-std": "pupil_std_m",
    "--rate": "rate_hz",
    "--resume-deg": "resume_rad",
    "--resume-mm": "resume_m",
    "--retract": "retract_m",
    "--robot-set": "robot_settings",
    "--seconds": "seconds_s",
    "--span": "span_rad",
    "--stop-at": "stop_m",
    "--stop-blind": "blind_stop_s",
    "--stop-deg": "stop_rad",
    "--stop-mm": "stop_m",
    "--tilt-deg": "tilt_rad",
    "--toe-in-deg": "toe_in_rad",
    "--tolerance-deg": "tolerance_rad",
    "--tolerance-mm": "tolerance_m",
    "--unit": "unit_m",
    "--wanted-mm": "wanted_m",
    "--warn-deg": "warn_rad",
    "--warn-mm": "warn_m",
    "--yes": "confirm",
    "-o": "out",
}
"""Parameters that are not called as the flag is, with _ for -: those that say their unit, or another word."""

_FLAG = re.compile(r"(?<![\w-])(--[a-z][a-z0-9]*(?:-[a-z0-9]+)*|-o)\b")
_COMMAND = re.compile(r"`?armsight (" + "|".join(sorted(COMMANDS, key=len, reverse=True)) + r")\b`?")


def parameter(flag: str) -> str:
    """Return what a flag of the command line is called in Python."""
    return PARAMETERS.get(flag, flag.lstrip("-").replace("-", "_"))


def in_python(error: ArmsightError) -> None:
    """Let an error name parameters for flags and functions for commands."""
    for part in ("cause", "consequence", "cure"):
        text = _COMMAND.sub(lambda found: f"armsight.{COMMANDS[found[1]]}", getattr(error, part))
        setattr(error, part, _FLAG.sub(lambda found: parameter(found[1]), text.replace("--yes", "confirm=True")))
    error.args = (error.cause, *error.args[1:])
