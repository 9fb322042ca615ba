"""Which Python name does what a command of the command line does: for the table in the docs, and for error texts."""

from __future__ import annotations

import re
import sys
from collections.abc import Mapping
from functools import cache

from armsight.errors import ArmsightError
from armsight.ops import actions
from armsight.ops.action import action_of

OTHERS: Mapping[str, str] = {
    **{name: name for name in ("batch", "design", "simulate", "twin")},
    **{f"convert {kind}": "convert" for kind in ("camera", "rig", "poses", "table", "handeye", "arm")},
    **{f"kinematics {name}": f"Arm.{does}" for name, does in (("fk", "fk"), ("ik", "ik_many"), ("path", "track"))},
    "kinematics jacobian": "Arm.jacobian",
}
"""Public names of what is done otherwise than by the action of the command, or is no action."""


@cache
def commands() -> Mapping[str, str]:
    """Return the public name that does a command, the first of several; tools/python_flags.py lists every flag."""
    face = sys.modules[__name__.partition(".")[0]]
    public = [call for call in actions() if getattr(face, call.__name__, None) is call]
    return {action_of(call).command: call.__name__ for call in reversed(public)} | dict(OTHERS)


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
    "--link-radius-mm": "link_radius_m",
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


@cache
def _command() -> re.Pattern[str]:
    return re.compile(r"`?armsight (" + "|".join(sorted(commands(), key=len, reverse=True)) + r")\b`?")


def parameter(flag: str) -> str:
    """Return what a flag of the command line is called in Python."""
    return PARAMETERS.get(flag, flag.lstrip("-").replace("-", "_"))


def in_python(error: ArmsightError) -> None:
    """Let an error name parameters for flags and functions for commands."""
    for part in ("cause", "consequence", "cure"):
        text = _command().sub(lambda found: f"armsight.{commands()[found[1]]}", getattr(error, part))
        setattr(error, part, _FLAG.sub(lambda found: parameter(found[1]), text.replace("--yes", "confirm=True")))
    error.args = (error.cause, *error.args[1:])
