"""Every value that is published, by its name: what it means, its type and unit, and where it comes from.

Nodes of OPC UA, keys of MQTT's JSON and the tables of docs/guide/plant.md follow from VALUES.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from armsight._version import __version__
from armsight.geometry import quat_of_matrix
from armsight.verify.supervision import Level, Seen
from armsight_plant.state import NAMES, PlantState, Quality, RobotSeen, trust

Given = bool | int | float | str | list[float] | None


@dataclass(frozen=True, slots=True, kw_only=True)
class Value:
    """One value. kind: bool, int, float, str or list (of floats). part: source, robot or seen: whose time and trust it
    has. get: takes the state's part, and returns None where there is nothing."""

    name: str
    kind: type
    part: str
    text: str
    get: Callable[[Any], Given]
    unit: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class PublishedValue:
    """A value as it is now: None where there is nothing that may be used; at_s: when it was so, Unix time."""

    value: Given
    quality: Quality
    at_s: float


def told(state: PlantState | None, now_s: float, stale_s: float) -> dict[str, PublishedValue]:
    """Return every value as it may be used at now_s of time.monotonic.

    A stale value is the last one, marked as such; what is said of tolerance is never told of old data.
    """
    trusted = trust(state, now_s, stale_s)
    found = {}
    for one in VALUES:
        quality: Quality = getattr(trusted, one.part)
        part = state if state is None or one.part == "source" else getattr(state, one.part)
        value = None if part is None or quality is Quality.SILENT else one.get(part)
        if one.name in VERDICTS and quality is not Quality.GOOD:
            value = None
        elif value is None and quality is not Quality.SILENT:
            quality = Quality.UNDECIDED if one.name in VERDICTS else Quality.WAITING
        found[one.name] = PublishedValue(value=value, quality=quality, at_s=_when(state, one.part, part))
    return found


def _when(state: PlantState | None, part: str, of: Any) -> float:
    if state is None:
        return float("nan")
    if part == "source" or of is None or not np.isfinite(of.at_s):
        return state.made_unix_s
    return state.unix_s(of.at_s)


IN_TOLERANCE, LEVEL = "verdict.in_tolerance", "verdict.level"
VERDICTS = (IN_TOLERANCE, LEVEL)


def _status(name: str) -> Callable[[RobotSeen], Given]:
    def get(robot: RobotSeen) -> Given:
        value: Given = None if robot.status is None else getattr(robot.status, name)
        return value

    return get


def _flange(which: int) -> Callable[[RobotSeen], Given]:
    def get(robot: RobotSeen) -> Given:
        return None if robot.T_base_flange is None else _xyz_quat(robot.T_base_flange)[which]

    return get


def _pose(which: int) -> Callable[[Seen], Given]:
    def get(seen: Seen) -> Given:
        T = seen.pose.T_parent_target
        if T is None or (which and seen.pose.status.size != 6):
            return None
        return _xyz_quat(T)[which]

    return get


def _xyz_quat(T: NDArray[np.float64]) -> tuple[list[float], list[float]]:
    return T[:3, 3].tolist(), list(quat_of_matrix(T))


def _pose_std(seen: Seen) -> Given:
    covariance = seen.pose.covariance
    return None if covariance is None else np.sqrt(np.diag(covariance)).tolist()


def _compared(name: str) -> Callable[[Seen], Given]:
    def get(seen: Seen) -> Given:
        return None if seen.compared is None else getattr(seen.compared, name)

    return get


def _level(seen: Seen) -> Given:
    """Return the level; of a pair that could not be compared only one that was raised before."""
    return None if seen.compared is None and seen.level is Level.GOOD else seen.level.word


def _why(seen: Seen) -> str:
    if seen.lost or seen.level is not Level.GOOD:
        return seen.lost or seen.why
    if not seen.limits.all:
        return "no level is set"
    return "" if seen.in_tolerance else "the error is within its level, but not by more than its doubt"


VALUES: tuple[Value, ...] = (
    Value(name="source", kind=str, part="source", text="What runs: serve or verify --live.", get=lambda s: s.source),
    Value(name="software", kind=str, part="source", text="Its version.", get=lambda s: f"armsight {__version__}"),
    Value(
        name="why",
        kind=str,
        part="source",
        text="Why the robot's loop does not run, or nothing is recorded; empty.",
        get=lambda s: s.why or s.recording,
    ),
    Value(name="robot.name", kind=str, part="robot", text="Its name.", get=lambda r: r.name),
    Value(
        name="robot.state",
        kind=str,
        part="robot",
        text="Of its link: closed, ready, moving, stopped, lost.",
        get=lambda r: None if r.status is None else r.status.robot.value,
    ),
    Value(
        name="robot.guard",
        kind=str,
        part="robot",
        text="Of the guard: disabled, running, holding, retreating, stopped.",
        get=lambda r: None if r.status is None else r.status.guard.value,
    ),
    Value(
        name="robot.reason", kind=str, part="robot", text="Why the guard does not let it move.", get=_status("reason")
    ),
    Value(name="robot.enabled", kind=bool, part="robot", text="Whether the enable is held.", get=_status("enabled")),
    Value(name="robot.driver", kind=str, part="robot", text="Who drives; empty for nobody.", get=_status("driver")),
    Value(
        name="robot.joints",
        kind=list,
        part="robot",
        text="The newest reading, rad (a slide: m).",
        get=lambda r: None if r.reading is None else r.reading.q.tolist(),
    ),
    Value(
        name="robot.flange_m",
        kind=list,
        part="robot",
        unit="m",
        text="x, y, z of the flange in the base, by the arm's model.",
        get=_flange(0),
    ),
    Value(name="robot.flange_quat", kind=list, part="robot", text="Its rotation: x, y, z, w.", get=_flange(1)),
    Value(name="robot.cycles_late", kind=int, part="robot", text="Cycles that began late.", get=_status("late")),
    Value(name="robot.cycles_missed", kind=int, part="robot", text="Cycles left out.", get=_status("missed")),
    Value(
        name="robot.lateness_s",
        kind=float,
        part="robot",
        unit="s",
        text="99 % of the cycles began at most so late.",
        get=_status("lateness_p99_s"),
    ),
    Value(
        name="pose.status",
        kind=str,
        part="seen",
        text="ok, doubtful, position_only, lost: act on ok alone.",
        get=lambda s: s.pose.status.value,
    ),
    Value(name="pose.frame", kind=str, part="seen", text="The frame it is given in.", get=lambda s: s.pose.parent),
    Value(name="pose.xyz_m", kind=list, part="seen", unit="m", text="x, y, z of the target.", get=_pose(0)),
    Value(name="pose.quat", kind=list, part="seen", text="Its rotation: x, y, z, w.", get=_pose(1)),
    Value(
        name="pose.std",
        kind=list,
        part="seen",
        text="Standard deviations: x, y, z in m, rotation vector in rad.",
        get=_pose_std,
    ),
    Value(
        name=IN_TOLERANCE,
        kind=bool,
        part="seen",
        text="true: within every level by twice the doubt in any direction. false: beyond one. Else not known.",
        get=lambda s: s.in_tolerance,
    ),
    Value(name=LEVEL, kind=str, part="seen", text="good, warn or stop: raised so far.", get=_level),
    Value(name="verdict.why", kind=str, part="seen", text="Why not good, or why not known.", get=_why),
    Value(name="verdict.error_m", kind=float, part="seen", unit="m", text="Error of place.", get=_compared("error_m")),
    Value(
        name="verdict.std_m",
        kind=float,
        part="seen",
        unit="m",
        text="Its doubt along the error, 1 sigma.",
        get=_compared("std_m"),
    ),
    Value(
        name="verdict.error_rad",
        kind=float,
        part="seen",
        unit="rad",
        text="Error of rotation.",
        get=_compared("error_rad"),
    ),
    Value(
        name="verdict.std_rad",
        kind=float,
        part="seen",
        unit="rad",
        text="Its doubt along the error, 1 sigma.",
        get=_compared("std_rad"),
    ),
)


def alarm_values(state: PlantState | None) -> dict[str, dict[str, Given]]:
    """Return every alarm there can be by its name, those that are not there as inactive."""
    there = {} if state is None else {one.name: one for one in state.alarms}
    found: dict[str, dict[str, Given]] = {}
    for name, (severity, latched, _) in NAMES.items():
        one = there.get(name)
        found[name] = {
            "id": "" if one is None else one.id,
            "active": one is not None and one.active,
            "acknowledged": one is None or one.acknowledged,
            "acknowledged_by": "" if one is None else one.acknowledged_by,
            "why": "" if one is None else one.why,
            "since_s": 0.0 if one is None else one.since_s,
            "severity": severity,
            "latched": latched,
        }
    return found
