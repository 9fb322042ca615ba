"""Alarms by the states of ISA-18.2 and OPC UA Part 9: active or not, acknowledged or not. Pure, without a clock.

To acknowledge is to say that somebody has seen it. It moves nothing, enables nothing, and ends no stop.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass, replace
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from armsight.control.guard import GuardState
from armsight.control.status import HOW_LONG, RobotStatus
from armsight.drivers import RobotState
from armsight.errors import UsageError
from armsight.ops.requests.plant import STALE_S
from armsight.records import JointReading
from armsight.verify.supervision import Level, Seen

NAMES = {
    "robot": (900, True, "Nothing is known of the robot: its loop or its link is gone"),
    "link": (800, True, "The robot is stopped, lost or closed, by its own word"),
    "stopped": (700, True, "The guard has stopped the robot, until it is reset"),
    "holding": (400, False, "The guard holds an enabled robot, for a reason that ends by itself"),
    "recording": (300, False, "What happens is not recorded any more"),
    "beyond-stop": (950, True, "The arm is off by more than the level that stops it"),
    "beyond-warn": (600, True, "The arm is off by more than the level that warns"),
    "blind": (500, False, "Whether the arm is where it says it is, cannot be said: nothing is compared"),
}
"""Every alarm there is: its severity (OPC UA: 1 to 1000), whether it is latched, and what it means."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Condition:
    """Something that is wrong now: its name in NAMES, and why in words that stay the same while it lasts."""

    name: str
    why: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Alarm:
    """One occurrence of an alarm.

    id: of this occurrence alone, also beyond a restart: whoever acknowledges says what they saw. since_s: Unix time at
    which it was raised. active: whether its cause is there; acknowledged_by: who, empty for nobody yet.
    """

    id: str
    name: str
    why: str
    since_s: float
    active: bool = True
    acknowledged_by: str = ""

    @property
    def severity(self) -> int:
        """How grave it is, 1 to 1000."""
        return NAMES[self.name][0]

    @property
    def latched(self) -> bool:
        """Whether it stays after its cause has gone, until somebody acknowledges it."""
        return NAMES[self.name][1]

    @property
    def acknowledged(self) -> bool:
        """Whether somebody said that they have seen it."""
        return bool(self.acknowledged_by)


class AlarmBook:
    """The alarms that are there, one of a name at a time; for one thread.

    raised: active, not acknowledged. It goes with its cause where it is acknowledged or not latched; a latched one that
    nobody acknowledged stays, no longer active. A cause that comes back meanwhile makes the same occurrence active;
    one that comes back after it has gone is another occurrence, to be acknowledged anew. So is a latched one whose why
    becomes another: a robot that was seen to be stopped and then is lost was not seen to be lost.
    """

    def __init__(self) -> None:
        self._alarms: dict[str, Alarm] = {}
        self._newest_ms = -math.inf

    @property
    def alarms(self) -> tuple[Alarm, ...]:
        """Those that are there, the gravest first."""
        return tuple(sorted(self._alarms.values(), key=lambda one: (-one.severity, one.name)))

    def update(self, conditions: Iterable[Condition], now_s: float) -> list[str]:
        """Take what is wrong now, at Unix time now_s; return what became of it, in words."""
        wrong = {one.name: one for one in conditions}
        told = []
        for name, alarm in list(self._alarms.items()):
            if name not in wrong and alarm.active:
                told.append(f"alarm {alarm.id} has gone")
                if alarm.latched and not alarm.acknowledged:
                    self._alarms[name] = replace(alarm, active=False)
                else:
                    del self._alarms[name]
        for name, one in wrong.items():
            before = self._alarms.get(name)
            if before is None or (before.latched and before.why != one.why):
                before = Alarm(id=self._new_id(name, now_s), name=name, why=one.why, since_s=now_s, active=False)
            if not before.active:
                told.append(f"alarm {before.id}: {one.why}")
            self._alarms[name] = replace(before, active=True, why=one.why)
        return told

    def acknowledge(self, number: str, who: str) -> Alarm:
        """Note that somebody has seen the alarm of this id; return it. Raises UsageError where there is none."""
        alarm = next((one for one in self._alarms.values() if one.id == number), None)
        if alarm is None:
            raise UsageError(f"there is no alarm {number[:80]!r}", consequence="Nothing was acknowledged")
        if alarm.acknowledged:
            return alarm
        seen = replace(alarm, acknowledged_by=who)
        if seen.active:
            self._alarms[seen.name] = seen
        else:
            del self._alarms[seen.name]
        return seen

    def _new_id(self, name: str, now_s: float) -> str:
        self._newest_ms = max(self._newest_ms + 1, round(1e3 * now_s))  # a clock that is set back makes none twice
        return f"{name}-{self._newest_ms:.0f}"


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


LONGEST = 400
"""Characters of a note, at most."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Note:
    """Something for the log; level: info, warning or error."""

    level: str
    message: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Acknowledge:
    """Somebody has seen the alarm of this id; from_: their address."""

    id: str
    who: str
    address: str


Request = Note | Acknowledge
Tell = Callable[[Request], bool]
"""Sends a request; returns whether there was room for it."""


def encode(request: Request) -> bytes:
    """Return a request as bytes; a note that is too long is cut."""
    values = {name: value[:LONGEST] for name, value in asdict(request).items()}
    return json.dumps({"kind": type(request).__name__, **values}).encode()


def decode(data: bytes) -> Request:
    """Return the request again."""
    values = json.loads(data)
    kind = values.pop("kind")
    return Note(**values) if kind == "Note" else Acknowledge(**values)
