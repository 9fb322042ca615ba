"""What is published: one record that is replaced as a whole, how far each part of it may be trusted, what is wrong."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from armsight.app.requests.plant import STALE_S
from armsight.control.guard import GuardState
from armsight.control.status import HOW_LONG, RobotStatus
from armsight.drivers import RobotState
from armsight.records import JointReading
from armsight.verify.supervision import Level, Seen
from armsight_plant.alarms import Alarm, Condition


class Quality(StrEnum):
    """How far a value may be trusted; the status codes of OPC UA stand in docs/guide/plant.md."""

    GOOD = "good"
    UNDECIDED = "undecided"
    """It is new, and what it was asked cannot be said: in tolerance or not, with what the measurement is worth."""
    STALE = "stale"
    """It is the last one, and too old."""
    WAITING = "waiting"
    """There was none yet, or this source has none."""
    SILENT = "silent"
    """The source says nothing any more."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RobotSeen:
    """A robot by its loop and link. status: None where only its joints are read. reading: the newest, None before it;
    at_s: of that, on time.monotonic. T_base_flange (4, 4): by the arm's model, None without one."""

    name: str
    status: RobotStatus | None
    reading: JointReading | None
    at_s: float
    T_base_flange: NDArray[np.float64] | None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PlantState:
    """All that is published of one moment.

    source: what runs. made_s, made_unix_s: when this was put together, on time.monotonic and as Unix time. robot: None
    where its loop does not run; why then says it. seen: None where nothing was measured. recording: why nothing is
    recorded any more, empty while it is. measures: whether this source measures at all.
    """

    source: str
    made_s: float
    made_unix_s: float
    robot: RobotSeen | None = None
    why: str = ""
    seen: Seen | None = None
    recording: str = ""
    measures: bool = False
    alarms: tuple[Alarm, ...] = ()

    def unix_s(self, at_s: float) -> float:
        """Return a moment of time.monotonic as Unix time."""
        return self.made_unix_s - self.made_s + at_s


@dataclass(frozen=True, slots=True, kw_only=True)
class Trust:
    """The quality of each part of a state at one moment."""

    source: Quality
    robot: Quality
    seen: Quality


def trust(state: PlantState | None, now_s: float, stale_s: float = STALE_S) -> Trust:
    """Return how far a state may be trusted at now_s of time.monotonic; None: nothing was ever said."""
    if state is None or not 0.0 <= now_s - state.made_s + 1e-3 <= stale_s:
        return Trust(source=Quality.SILENT, robot=Quality.SILENT, seen=Quality.SILENT)
    robot = Quality.SILENT if state.robot is None else _age(state.robot.at_s, now_s, stale_s)
    seen = Quality.WAITING if state.seen is None else _age(state.seen.at_s, now_s, stale_s)
    return Trust(source=Quality.GOOD, robot=robot, seen=seen)


def _age(at_s: float, now_s: float, stale_s: float) -> Quality:
    if math.isnan(at_s):
        return Quality.WAITING
    return Quality.GOOD if abs(now_s - at_s) <= stale_s else Quality.STALE  # what is yet to come is of a wrong clock


def conditions(state: PlantState, stale_s: float = STALE_S) -> list[Condition]:
    """Return what is wrong in a state, by the names of alarms."""
    wrong = []
    status = None if state.robot is None else state.robot.status
    if state.robot is None:
        wrong.append(Condition(name="robot", why=HOW_LONG.sub("", state.why) or "nothing is known of it"))
    if status is not None and status.robot not in (RobotState.READY, RobotState.MOVING):
        wrong.append(Condition(name="link", why=f"the robot is {status.robot.value}"))
    if status is not None and status.guard is GuardState.STOPPED:
        wrong.append(Condition(name="stopped", why=status.reason))
    if status is not None and status.guard is GuardState.HOLDING and status.enabled and status.reason:
        wrong.append(Condition(name="holding", why=status.reason))
    if state.recording:
        wrong.append(Condition(name="recording", why=state.recording))
    seen = state.seen
    if seen is not None and seen.level is not Level.GOOD:
        name = "beyond-stop" if seen.level is Level.STOP else "beyond-warn"
        wrong.append(Condition(name=name, why=seen.why or f"the level {seen.level.word} was raised"))
    if state.measures:
        old = trust(state, state.made_s, stale_s).seen is not Quality.GOOD
        if seen is None or old:
            wrong.append(Condition(name="blind", why="no pictures come"))
        elif seen.compared is None and seen.blind:
            wrong.append(Condition(name="blind", why=seen.lost))
    return wrong
