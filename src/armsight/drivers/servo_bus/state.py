"""What the servos of an arm told within one cycle, and whether it can be."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from armsight.drivers.servo_bus.found import ServoFound
from armsight.drivers.servo_bus.packets import Answer
from armsight.drivers.servo_bus.settings import JointOfServo
from armsight.drivers.servo_bus.tables import ALERT, STEP_RAD, TICKS, Family
from armsight.units import MS

FASTEST_RAD_S = 12.0
"""No servo of an arm, driven or by hand, turns faster by half: an STS3215 does 5 rad/s without a load."""
FLICKER = 3
"""Steps by which a reading may differ beside what the arm moves."""
GAP_CYCLES = 3
"""Over so many missed cycles an arm may have moved; one that is elsewhere after more is not believed."""
TICK_OFF_MS = 30.0
"""By so much may the servo's own time between two answers differ from ours, where this computer is busy."""
SAG_SHARE = 0.8
"""A supply below this share of what it was when the link was opened gives out under the arm's load."""
REMEMBERED = 4
"""Goals that a servo may hold: one that did not arrive is sent again."""


@dataclass(frozen=True, slots=True)
class ServoState:
    """One servo: its position and goal in steps, whether its torque is on, voltage and heat as in its table, alarms.

    torque, alarms: as last read, where they are no part of the answer. tick: of its own clock, ms; None without one.
    """

    position: int
    goal: int
    torque: bool
    voltage: int
    heat: int
    alarms: str
    tick: int | None


def state_of(family: Family, answer: Answer, start: int, before: ServoState | None) -> ServoState:
    """Return what an answer tells of the table from start on; before: what was known of the servo."""
    data = answer.data
    torque, alarms = before is not None and before.torque, "" if before is None else before.alarms
    if family.watched is None:
        torque = bool(family.torque.of(data, start))
        bits = family.alarm.of(data, start)
        alarms = _listed(family, bits) or family.told(answer.error)
    elif not answer.error & ALERT:
        alarms = family.told(answer.error)
    else:
        alarms = alarms or "a hardware alert"
    return ServoState(
        position=family.position.of(data, start),
        goal=family.goal.of(data, start),
        torque=torque,
        voltage=family.voltage.of(data, start),
        heat=family.heat.of(data, start),
        alarms=alarms,
        tick=None if family.tick is None else family.tick.of(data, start),
    )


def watched_of(family: Family, answer: Answer, start: int, before: ServoState) -> ServoState:
    """Return a state with torque and alarms as the part of the table tells that holds them."""
    bits = family.alarm.of(answer.data, start)
    return replace(before, torque=bool(family.torque.of(answer.data, start)), alarms=_listed(family, bits))


def _listed(family: Family, bits: int) -> str:
    words = [family.alarms.get(bit, f"alarm {bit}") for bit in range(8) if bits >> bit & 1]
    return " and ".join(words)


class Believed:
    """The states that were believed, and what speaks against new ones."""

    def __init__(self, joints: Sequence[JointOfServo], found: Sequence[ServoFound], family: Family) -> None:
        self._joints, self._found, self._family = joints, found, family
        self._given: deque[tuple[int, ...]] = deque(maxlen=REMEMBERED)
        self._first: Sequence[ServoState] = ()
        self.states: list[ServoState] = []
        self.t_s = 0.0

    @property
    def q(self) -> NDArray[np.float64]:
        """Where the joints are read, (n,) in rad."""
        return np.array([j.q(s.position) for j, s in zip(self._joints, self.states, strict=True)])

    def give(self, steps: tuple[int, ...]) -> None:
        """Note goals that go out."""
        if not self._given or self._given[-1] != steps:
            self._given.append(steps)

    def forget(self) -> None:
        """Expect no goals: the servos hold what they held before."""
        self._given.clear()

    @property
    def taken(self) -> bool:
        """Whether the servos hold the goals that were given last."""
        return not self._given or tuple(state.goal for state in self.states) == self._given[-1]

    def against(self, states: Sequence[ServoState], t_s: float, cycle_s: float, *, any_place: bool) -> str:
        """Return why states read at t_s cannot be, empty where they can. any_place: nothing was read for long."""
        if not self.states:
            return ""
        passed_s = t_s - self.t_s
        most = FASTEST_RAD_S * min(passed_s, GAP_CYCLES * cycle_s) / STEP_RAD + FLICKER
        for i, (joint, now, last) in enumerate(zip(self._joints, states, self.states, strict=True)):
            if not any_place and abs(now.position - last.position) > most:
                return f"{joint.called} tells a place that it cannot have come to"
            if self._given and now.torque and all(now.goal != steps[i] for steps in self._given):
                return f"{joint.called} holds a goal that was not given here: another program drives it, or it started"
            if now.tick is not None and last.tick is not None:
                ticks = (now.tick - last.tick) % TICKS
                off = (ticks - passed_s / MS + TICKS / 2) % TICKS - TICKS / 2
                if ticks == 0 or abs(off) > TICK_OFF_MS + 0.02 * passed_s / MS:
                    return f"{joint.called} tells another time than has passed: it started anew, or its answer is old"
        return ""

    def take(self, states: Sequence[ServoState], t_s: float) -> None:
        """Believe states read at t_s."""
        self._first = self._first or list(states)
        self.states, self.t_s = list(states), t_s

    def alarm(self, *, enabled: bool) -> str:
        """Return what is wrong with a servo, with the cure; empty where nothing is. enabled: torque should be on."""
        for joint, state, own, first in zip(self._joints, self.states, self._found, self._first, strict=True):
            if state.alarms:
                return f"{joint.called} tells {state.alarms}: {_cure(state.alarms)}"
            if state.voltage < max(own.least_volts, SAG_SHARE * first.voltage):
                return (
                    f"the supply of {joint.called} has fallen to {state.voltage / 10:.1f} V (it was "
                    f"{first.voltage / 10:.1f} V): take a stronger one, or look for what the arm pushes against"
                )
            if own.most_heat and state.heat >= own.most_heat:
                return f"{joint.called} is at {state.heat} degrees C, as hot as it may be: let it cool"
            if enabled and not state.torque:
                return f"the torque of {joint.called} is off: it started anew, or something else switched it off"
        return ""

    def held(self, apart_rad: float) -> NDArray[np.float64]:
        """Return where the arm is held (n,) in rad: a servo's own goal, or where it is where that is not held.

        A servo under load hangs a little below its goal; told to go to where it is, it would sink once more. apart_rad:
        one farther off is held up by something, and must not leap when freed.
        """
        pairs = zip(self._joints, self.states, strict=True)
        return np.array(
            [
                j.q(s.goal if s.torque and abs(s.goal - s.position) * STEP_RAD <= apart_rad else s.position)
                for j, s in pairs
            ]
        )

    def absent(self, answers: Mapping[int, Answer]) -> str:
        """Return which servos gave no sound answer, in words."""
        missing = [joint.called for joint in self._joints if joint.id not in answers]
        if len(missing) == len(self._joints):
            return "no servo answers any more: its supply, or its cable"
        one = len(missing) == 1
        return f"{', '.join(missing)} {'does' if one else 'do'} not answer any more, and the others do: " + (
            "its cable, or its supply" if one else "their cable, or their supply"
        )


def _cure(alarms: str) -> str:
    if "overload" in alarms:
        return "take the load off; it has lowered its torque"
    if "voltage" in alarms:
        return "give it the voltage it is made for"
    return "switch the arm off and let it cool" if "heat" in alarms else "look at it"
