"""An arm of bus servos: asked and told in each cycle by a thread of its own, which sets the pace."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from typing import Any, ClassVar

import numpy as np
import serial

from armsight.arrays import Array
from armsight.clock import Clock, SystemClock
from armsight.defaults import STALE_CYCLES
from armsight.drivers.cyclic import CyclicRobot
from armsight.drivers.goals import JointGoals, JointLimits
from armsight.drivers.pace import ControllerClock, LinkCounts, LinkTimes
from armsight.drivers.proof import Standing
from armsight.drivers.servo_bus.found import TRIES, ServoFound, found
from armsight.drivers.servo_bus.line import OPENING_S, Line, open_port
from armsight.drivers.servo_bus.packets import BITS_A_BYTE
from armsight.drivers.servo_bus.settings import ServoSettings
from armsight.drivers.servo_bus.state import Believed, ServoState, state_of, watched_of
from armsight.drivers.servo_bus.tables import ALERT, STEP_RAD, STS, Family, X
from armsight.errors import DeviceFailed, DeviceLost, UsageError
from armsight.priority import control_first
from armsight.records import JointReading
from armsight.units import DEG, MS

UNANSWERED = 8
"""A bus is lost where a servo gave no sound answer in so many cycles in a row, however long this computer took."""
SILENT_CYCLES = 25.0
"""... or nothing was read for so long, whoever kept this program from asking. What it was told before is stale then."""
TAGS = 8
"""So many sizes the question has in turn: an answer to an older question is known by its size. Neither protocol numbers
its answers."""
DOUBTED = 5
"""So many answers in a row that cannot be are no disturbance."""
HANGS_RAD = 5.0 * DEG
"""A servo under load hangs below its goal by less: an STS3215 by 5 degrees under 1.6 N m, at the 17.8 N m/rad that were
identified of it (Open_Duck_Playground, joints_properties.xml)."""
CALM_S, CALM_STEPS = 0.2, 2
"""Readings of an arm at rest differ by no more steps in such a time."""
ENABLING_S = 2.0
"""Until then all torques are on, the goals taken and the arm at rest."""
USB_S = 1e-3
"""An adapter's frame."""
OVERLAP = 0.5
"""Where less than this share of the arm's file's range lies in the servo's, another zero or direction is meant."""


class ServoBusRobot(CyclicRobot):
    """An arm of servos on one line. device: the serial port. settings: see ServoSettings.

    Opening reads only. The first motion asked for switches torque on where it is off, at the place where each servo is
    or is held; closing, stopping or losing the link switches nothing off: the servos hold their last goals.
    """

    family: ClassVar[Family]
    unproven = (
        "nothing was written to its servos yet: the first motion switches torque on where it is off, and the arm is "
        "then held where it is"
    )
    reading_step = STEP_RAD
    hangs_rad = HANGS_RAD

    def __init__(self, device: str, *, settings: Mapping[str, Any] | None = None, clock: Clock | None = None) -> None:
        kept = self.settings = ServoSettings.checked(settings)
        self.port = device
        self.joints = kept.joints(self.family)
        cycle_s, n = kept.cycle_s, len(self.joints)
        name = f"{self.family.called}:{device}"
        times = LinkTimes(cycle_s=cycle_s, stale_s=STALE_CYCLES * cycle_s, silent_s=SILENT_CYCLES * cycle_s)
        super().__init__(name, limits=kept.joint_limits(n), times=times, clock=clock or SystemClock())
        self._ids = [joint.id for joint in self.joints]
        self._check_time(n)
        self.counts = LinkCounts()
        self._controller_clock = ControllerClock(cycle_s, numbered=True, own=True)
        self._standing = Standing(cycle_s, CALM_STEPS * STEP_RAD)
        self._recent: deque[Array] = deque(maxlen=max(4, round(CALM_S / cycle_s)))
        self._enabled, self._enabling = False, 0
        self._believed = Believed(self.joints, (), self.family)
        self._closing = False

    def _check_time(self, n: int) -> None:
        """Raise UsageError where a cycle is too short for what goes over the line."""
        family, extra = self.family, self.family.packets.extra
        n_bytes = (n + 1) * extra + n * (family.state[1] + TAGS) + 2 * n + extra + n * (1 + family.goal.size)
        questions = 1 if family.watched is None else 2
        n_bytes += 0 if family.watched is None else 2 * extra + family.watched[1]
        needed_s = n_bytes * BITS_A_BYTE / self.settings.baud + questions * USB_S
        if needed_s > self.cycle_s:
            raise UsageError(
                f"{n} servos at {self.settings.baud} baud take {needed_s / MS:.1f} ms, longer than a cycle of "
                f"{self.cycle_s / MS:g} ms",
                consequence="The robot is not opened",
                cure=f"Set the servos and this link to 1000000 baud, or cycle_s to {1.2 * needed_s:.3f}",
            )

    @property
    def proven(self) -> bool:
        """Whether torque is on and the servos hold the goals that they were given."""
        return self._enabled

    def _start(self) -> None:
        self._turn, self._doubts, self._unanswered, self._numbers, self._absent = 0, 0, 0, 0, ""
        self._closing, self._enabling = False, 0
        self._recent.clear()
        with ExitStack() as undo:
            self._line = Line(self._open_port(), self.settings.baud, self.family.packets)
            undo.callback(self._line.close)
            self.counts = self._line.counts
            try:
                servos = found(self._line, self.family, self.joints, self.settings.baud, self.name)
                self._goals = JointGoals(self.name, self._limits(servos), self.cycle_s)
                self._believed = Believed(self.joints, servos, self.family)
                if self.settings.torque == "off":
                    self._switch_off()
                self._first_reading()
            except DeviceLost as error:
                raise DeviceFailed(
                    f"{self.name}: {error.cause}", consequence="The robot is not opened", cure="Check its cable"
                ) from error
            self._undo = undo.pop_all()
        self._thread = threading.Thread(target=self._run, name=self.name, daemon=True)
        self._thread.start()

    def _open_port(self) -> serial.Serial:
        return open_port(self.port, self.settings.baud)

    def _limits(self, servos: list[ServoFound]) -> JointLimits:
        """Return the joints' limits: the servos' own, narrowed by what was given. Raises DeviceFailed, UsageError."""
        given = self.settings.joint_limits(self.n_joints)
        ends = np.array(
            [
                sorted((joint.q(own.lowest), joint.q(own.highest)))
                for joint, own in zip(self.joints, servos, strict=True)
            ]
        )  # (n, 2)
        self._compare(ends)
        lower, upper = np.maximum(ends[:, 0], given.lower), np.minimum(ends[:, 1], given.upper)
        if (empty := np.flatnonzero(lower >= upper)).size:
            joint, (low, high) = self.joints[empty[0]], ends[empty[0]]
            raise UsageError(
                f"{self.name}: {joint.called} goes from {low:.3f} to {high:.3f} rad, and none of that is allowed",
                consequence="The robot is not opened",
                cure="Give other lower_rad and upper_rad",
            )
        return JointLimits(lower=lower, upper=upper, max_speed=given.max_speed)

    def _compare(self, ends: Array) -> None:
        """Raise DeviceFailed where the arm's file gives other ranges than the servos keep, ends (n, 2) in rad."""
        if self.settings.arm is None:
            return
        file = self.settings.arm.ranges.T  # (n, 2)
        if file.shape != ends.shape:
            raise UsageError(
                f"{self.name}: the arm's file has {len(file)} joints, and {self.n_joints} servos are named",
                consequence="The robot is not opened",
                cure="Name the arm's servos alone (--robot-set ids=1,2,3,4,5): a gripper's is no joint of the arm",
            )
        for joint, own, there in zip(self.joints, ends, file, strict=True):
            shared = min(own[1], there[1]) - max(own[0], there[0])
            if np.isfinite(there).all() and np.isfinite(own).all() and shared < OVERLAP * (there[1] - there[0]):
                raise DeviceFailed(
                    f"{self.name}: {joint.called} goes from {own[0]:.2f} to {own[1]:.2f} rad by its own limits, and "
                    f"the arm's file says {there[0]:.2f} to {there[1]:.2f}",
                    consequence="The robot is not opened: its zero or its direction is not the file's",
                    cure="Give the calibration file of this arm, or signs and zero_steps; armsight identify finds both",
                )

    def _switch_off(self) -> None:
        """Switch torque off, as the person asked: whoever holds the arm can then lead it by hand."""
        for joint in self.joints:
            question = self.family.packets.write(joint.id, self.family.torque.at, b"\x00")
            if not any(self._line.heard(question, [joint.id], 0, OPENING_S) for _ in range(TRIES)):
                raise DeviceFailed(
                    f"{self.name}: {joint.called} does not confirm that its torque is off",
                    consequence="The robot is not opened; some servos may hold and others not",
                    cure="Hold the arm, and switch its supply off",
                )

    def _first_reading(self) -> None:
        """Read all servos once. Raises DeviceFailed where one does not answer, or an alarm stands."""
        for _ in range(TRIES + 2):
            if (states := self._ask()) is not None and self._watch_all(states):
                break
        else:
            raise DeviceFailed(
                f"{self.name}: {self._absent}", consequence="The robot is not opened", cure="Check its cable"
            )
        self._believed.take(states, self._clock.now_s())
        if alarm := self._believed.alarm(enabled=False):
            raise DeviceFailed(
                f"{self.name}: {alarm.partition(':')[0]}",
                consequence="The robot is not opened",
                cure=alarm.partition(": ")[2].capitalize(),
            )
        self._heard(self._believed.q, self._believed.t_s)

    def _watch_all(self, states: list[ServoState]) -> bool:
        """Bring torque and alarms into states, where those stand apart; tell whether all were told."""
        return self.family.watched is None or all(self._watch(states, i, OPENING_S) for i in range(len(states)))

    def _watch(self, states: list[ServoState], i: int, wait_s: float | None = None) -> bool:
        if self.family.watched is None:
            return True
        id, (start, size) = self._ids[i], self.family.watched
        question = self.family.packets.read(id, start, size)
        wait = {} if wait_s is None else {"wait_s": wait_s}
        answer = self._line.heard(question, [id], size, **wait).get(id)
        if answer is not None:
            states[i] = watched_of(self.family, answer, start, states[i])
        return answer is not None

    def _finish(self) -> None:
        self._closing = True
        self._thread.join()
        self._undo.close()

    def _run(self) -> None:
        control_first()
        due_s = self._clock.now_s()
        while not self._closing and not self._lost:
            due_s += self.cycle_s
            self._clock.sleep_until(due_s)
            if self._closing:
                return
            self._stood_still()
            skipped = max(0, int((self._clock.now_s() - due_s) / self.cycle_s))
            due_s += skipped * self.cycle_s
            try:
                self._cycle(1 + skipped)
                if self._unanswered >= UNANSWERED:
                    raise DeviceLost(self._absent)
            except DeviceLost as error:
                self._lose(error.cause)

    def _ask(self) -> list[ServoState] | None:
        """Ask all servos; return what they are told to be, or None where one gave no sound answer."""
        tag = self._turn = (self._turn + 1) % TAGS
        start, size = self.family.state[0] - tag, self.family.state[1] + tag
        question = self.family.packets.sync_read(self._ids, start, size)
        answers = self._line.heard(question, self._ids, size)
        if len(answers) < len(self._ids):
            self._unanswered, self._absent = self._unanswered + 1, self._believed.absent(answers)
            return None
        self._unanswered = 0
        before: Sequence[ServoState | None] = self._believed.states or [None] * len(self._ids)
        states = [state_of(self.family, answers[id], start, last) for id, last in zip(self._ids, before, strict=True)]
        for i, id in enumerate(self._ids):
            if answers[id].error & ALERT and self.family.watched is not None:
                self._watch(states, i)
        return states

    def _cycle(self, cycles: int) -> None:
        """Ask the servos, and tell them where to go."""
        self._numbers += cycles
        t_s = self._clock.now_s()
        states = self._ask()
        if states is None:
            return
        believed = self._believed
        if against := believed.against(states, t_s, self.cycle_s, any_place=bool(self._stood_s)):
            self.counts.refused += 1
            self._doubts, self._absent = self._doubts + 1, against
            if self._doubts >= DOUBTED:
                raise DeviceLost(against)
            return
        self._watch(states, self._numbers % len(states))
        self._doubts = 0
        self.counts.heard += 1
        believed.take(states, t_s)
        self._heard(believed.q, t_s)
        self._recent.append(believed.q)
        self._hear_clock(t_s, self._numbers)
        alarm = believed.alarm(enabled=self._enabled)
        if alarm or self._held:
            self._halt(alarm, believed.q)
        self._tick(cycles, taken=believed.taken)
        self._tell()

    def _tell(self) -> None:
        """Tell the servos their goals, where they are enabled or are being so."""
        with self._lock:
            active = self._enabled or self._enabling
            steps = tuple(joint.steps(q) for joint, q in zip(self.joints, self._goals.sent, strict=True))
        if not active or self._lost or self._outlived():
            return
        goal = self.family.goal
        self._line.tell(
            self.family.packets.sync_write(
                goal.at, {id: goal.bytes(value) for id, value in zip(self._ids, steps, strict=True)}
            )
        )
        if self._enabled:
            self._believed.give(steps)
        elif self._enabling == 1:
            torque = self.family.torque
            self._line.tell(self.family.packets.sync_write(torque.at, dict.fromkeys(self._ids, torque.bytes(1))))

    def _proving(self, *, asks: bool) -> bool:
        """Tell whether motion waits for the servos to be enabled, and begin that where it asks."""
        if self._enabled:
            return False
        if asks and not self._enabling:
            self._rebase(self._axes())
            self._enabling = -1
        if self._enabling:
            self._hold()
        return bool(self._enabling)

    def _prove(self, cycles: int, *, taken: bool) -> bool:
        """Do a cycle of enabling, where that is under way; tell whether it is not."""
        if self._stopped:
            self._enabling = 0
        if not self._enabling:
            return True
        self._enabling = max(0, self._enabling) + 1
        states = self._believed.states
        goals = [joint.steps(q) for joint, q in zip(self.joints, self._goals.sent, strict=True)]
        off = [j for j, s, g in zip(self.joints, states, goals, strict=True) if not s.torque or s.goal != g]
        if not off and self._enabling > self._recent.maxlen and self._calm():  # type: ignore[operator]
            self._enabled, self._enabling = True, 0
        elif self._enabling * self.cycle_s > ENABLING_S:
            called = ", ".join(joint.called for joint in off)
            why = f"{called} takes no goal, or its torque stays off" if off else "the arm does not come to rest"
            self._refuse(f"{why} after torque was switched on")
        return False

    def _calm(self) -> bool:
        return len(self._recent) == self._recent.maxlen and bool(
            np.ptp(np.array(self._recent), axis=0).max() <= (CALM_STEPS + 0.5) * STEP_RAD
        )

    def _unprove(self) -> None:
        super()._unprove()
        self._enabled, self._enabling = False, 0
        self._believed.forget()

    def _rebase(self, q: Array) -> None:
        """Take for its goal where each servo is held, or is."""
        super()._rebase(self._believed.held(HANGS_RAD) if self._believed.states else q)

    def _off(self, reading: JointReading) -> float:
        """Return how far the arm moved lately: under load it rests a little off its goal."""
        return 0.0 if len(self._recent) < 2 or self._calm() else 1.0


class FeetechRobot(ServoBusRobot):
    """An arm of Feetech's STS servos."""

    family = STS


class DynamixelRobot(ServoBusRobot):
    """An arm of Robotis' X servos."""

    family = X
