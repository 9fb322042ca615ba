"""Alarms by the states of ISA-18.2 and OPC UA Part 9: active or not, acknowledged or not. Pure, without a clock.

To acknowledge is to say that somebody has seen it. It moves nothing, enables nothing, and ends no stop.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace

from armsight.errors import UsageError

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
