"""One joint of a robot moved by a given way, or the arm by keys or a gamepad, through the guard."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from typing import Annotated

import numpy as np

from armsight.clock import Clock
from armsight.control.guard import Guard, GuardState
from armsight.control.setpoints import Enable, GoalSource, JogFrame, JogSource
from armsight.control.status import QueueSink, RobotStatus
from armsight.drivers import Robot
from armsight.drivers.jog_inputs import JogInput
from armsight.errors import ArmsightError, Cancelled, DeviceFailed, Inconsistent, UsageError
from armsight.fields import Doc
from armsight.ops.robot.opening import beside_outside
from armsight.ops.robot.robot_run import RobotRun
from armsight.records.output import Output, output
from armsight.shown import Shown, digits
from armsight.units import DEG, MM, displayed

SETTLE_S = 0.5
"""Time in which the arm comes to rest behind its last command."""
STUCK_S = 1.0
"""Held for so long, or sent nowhere, the motion is given up."""
UNASKED = "without asking"


@output
class JogOutput(Output):
    """robot jog: one joint moved by a given way, or the arm moved by hand."""

    asked: Annotated[float | None, Doc("The way asked for, rad or m; null where a hand moved the arm.")]
    sent: Annotated[list[float], Doc("Where the robot was last told to go, rad or m.")]
    reached: Annotated[list[float], Doc("What it reads at rest, rad or m.")]
    limited: Annotated[list[str], Doc("The limits that slowed the motion, in words.")]
    outside: Annotated[str, Doc("Which limits the arm stood outside of at the start, by how much; empty: none.")]
    state: Annotated[str, Doc("What the robot can do now: ready, moving or stopped.")]
    joint: int | None  # from 1, where one was moved

    def summary(self) -> Iterator[Shown]:
        """Yield where the robot stands."""
        if self.joint is None:
            yield f"the joints stand at {', '.join(digits(v, 6) for v in self.reached)} (rad or m)"
        else:
            stands = digits(self.reached[self.joint - 1], 6)
            yield f"joint {self.joint} stands at {stands} (rad or m); the robot is {self.state}"


ROUNDING = 1e-9
"""Rad or m by which joints that are held may differ: no robot moves by less, at any speed, for STUCK_S."""


class _Watcher:
    """Ends the loop where the joint arrived, or cannot, and gathers what limited it.

    stuck: the robot takes every step and goes nowhere, as where its controller cuts each to nothing.
    """

    def __init__(self, cycle_s: float) -> None:
        self._cycle_s = cycle_s
        self._cycles = 0
        self._stood = 0
        self._sent = np.empty(0)
        self.limited: list[str] = []
        self.stuck = False

    def __call__(self, status: RobotStatus) -> bool:
        self.limited += [name for name in status.limited if name not in self.limited]
        ended = status.finished or status.guard is not GuardState.RUNNING
        self._cycles = self._cycles + 1 if status.at_rest and ended else 0
        # against where it began to stand: joints that are held differ by rounding from cycle to cycle
        stands = not ended and len(self._sent) > 0 and float(np.abs(status.q_sent - self._sent).max()) < ROUNDING
        self._stood, self._sent = (self._stood + 1, self._sent) if stands else (0, status.q_sent)
        self.stuck |= self._stood * self._cycle_s > STUCK_S
        longest_s = STUCK_S if status.guard is GuardState.HOLDING else SETTLE_S
        return self.stuck or self._cycles * self._cycle_s > longest_s


def jog_joint(run: RobotRun, joint: int, by: float) -> JogOutput:
    """Move one joint (from 1) by a way in rad or m after asking, and return what was sent and reached.

    Raises UsageError; Inconsistent for a way beyond a limit; DeviceFailed, DeviceLost where the robot or the guard
    stopped; Cancelled.
    """
    robot = run.robot
    _check(joint, by, robot)
    _check_degrees(joint, by, run.guard)
    j = joint - 1
    with run:
        start = robot.read().q
        goal = start + by * (np.arange(len(start)) == j)
        with run.planning():
            _check_range(joint, by, run.guard, float(start[j]), run.outside)
        run.ask(question(joint, by, robot, run.guard, float(start[j])), unasked=UNASKED)
        watcher = _Watcher(robot.cycle_s)

        def show_progress(status: RobotStatus | None) -> None:
            if status is not None:
                run.progress.update(100.0 * abs(float(status.q_sent[j] - start[j]) / by), 100.0)

        with run.recorded() as sink:
            run.follow(GoalSource(goal, "jog"), sink, watcher, show_progress)
        with beside_outside(run.outside):
            _check_end(run.status, robot, stuck=watcher.stuck)
        return _output(run, watcher.limited, by, joint)


def _output(run: RobotRun, limited: list[str], asked: float | None, joint: int | None) -> JogOutput:
    """Return where an open robot was sent, and stands."""
    return JogOutput(
        asked=asked,
        sent=[] if run.status is None else run.status.q_sent.tolist(),
        reached=run.robot.read().q.tolist(),
        limited=limited,
        outside=run.outside,
        state=run.robot.state.value,
        joint=joint,
    )


def question(number: int, by: float, robot: Robot, guard: Guard, start: float) -> str:
    """Return what is asked before the joint moves: in degrees or mm, with the speed it may reach."""
    joint = guard.arm.joints[number - 1]
    slides = not guard.arm.revolute[number - 1]
    name, unit = displayed("m" if slides else "rad")
    most = guard.bounds.speed[number - 1] if slides else min(guard.bounds.speed[number - 1], guard.limits.turn_rad_s)
    return (
        f"Move joint {number} ({joint.name}) of {robot.name} by {by / unit:+.2f} {name}, "
        f"from {start / unit:.2f} to {(start + by) / unit:.2f} {name}, at up to {most / unit:.1f} {name}/s and "
        f"{guard.limits.speed_m_s / MM:.0f} mm/s at the tool?"
    )


def _check(joint: int, by: float, robot: Robot) -> None:
    if not 1 <= joint <= robot.n_joints:
        raise UsageError(
            f"{robot.name} has joints 1 to {robot.n_joints}, not {joint}",
            consequence="Nothing is moved",
            cure="Give one of them (--joint)",
        )
    if not (math.isfinite(by) and by != 0.0):
        raise UsageError(
            f"a way of {by:g} is none",
            consequence="Nothing is moved",
            cure="Give rad or m (--by), for instance 0.1",
        )


def _check_degrees(joint: int, by: float, guard: Guard) -> None:
    """Raise Inconsistent for a way of a revolute joint that is more than half a turn: degrees given for radians."""
    if guard.arm.revolute[joint - 1] and abs(by) > math.pi:
        raise Inconsistent(
            f"a way of {by:g} rad is {by / DEG:.0f} degrees: it looks like degrees",
            consequence="Nothing was moved",
            cure=f"Give radians (--by {by * DEG:.4f} is {by:g} degrees), and more than half a turn in parts",
        )


def _check_range(joint: int, by: float, guard: Guard, start: float, outside: str) -> None:
    """Raise Inconsistent for a goal beyond the joint's range, unless the way there leads back towards it."""
    j, goal = joint - 1, start + by
    low, high = float(guard.bounds.lower[j]), float(guard.bounds.upper[j])
    beyond, before = (max(low - q, q - high) for q in (goal, start))
    if beyond > 0.0 and not beyond < before:
        way = low - start if start < low else high - start
        raise Inconsistent(
            f"joint {joint} would go to {goal:.4g}, its limits are {low:.4g} to {high:.4g} rad or m"
            + (f"; {outside}" if outside else ""),
            consequence="Nothing was moved",
            cure=f"Go back within them (--by {way:.4g} and more), or take the limits of where it stands"
            if before > 0.0
            else "Ask for a shorter way (--by)",
        )


def _check_end(status: RobotStatus | None, robot: Robot, *, stuck: bool = False) -> None:
    """Raise where the guard did not let the motion come to its end, or the robot did not go."""
    if stuck:
        raise DeviceFailed(
            f"{robot.name} takes every step and goes nowhere",
            consequence="It was stopped before its goal",
            cure="Look at the speed override and the limits of its controller; a driver's Sent.q is where it goes",
        )
    if status is None or status.guard is GuardState.RUNNING:
        return
    if status.guard is GuardState.DISABLED:
        raise Cancelled("stopped", consequence=f"{robot.name} came to rest before its goal")
    if status.guard is GuardState.HOLDING:
        raise Inconsistent(
            status.why,
            consequence=f"{robot.name} came to rest before its goal",
            cure="Ask for a shorter way, or look at the limits (--limits)",
        )
    raise DeviceFailed(
        status.why,
        consequence=f"{robot.name} was stopped",
        cure="Look at the robot and its controller, then begin anew",
    )


LOOK_S = 0.05
"""Longest time between two looks at the hand."""


Inputs = Callable[[str, int], AbstractContextManager[JogInput]]
"""Opens what a hand moves, by its name and the number of axes."""


def jog_by_hand(run: RobotRun, hand: str, frame: str, inputs: Inputs) -> JogOutput:
    """Move a robot as a hand (keyboard, gamepad[:DEVICE]) says until it is done; return where the robot stands.

    Asked once, before anything can move. Raises UsageError, DeviceNotFound; DeviceFailed where robot, guard or gamepad
    failed; Cancelled.
    """
    robot, clock = run.robot, run.clock
    _check_frame(frame, run.knows_lengths, robot.name)
    source = JogSource(robot.n_joints, frame, speed_m_s=run.guard.limits.speed_m_s)
    axes = robot.n_joints if source.frame is JogFrame.JOINTS else 6
    with run, inputs(hand, axes) as led:
        with run.planning():
            asked = hand_question(robot, run.guard, source.frame, led)
        run.ask(asked, unasked=UNASKED)
        enable = Enable(clock)
        with run.recorded() as sink:
            limited = _follow(run, source, sink, _Hand(led, source, enable, clock), enable)
        return _output(run, limited, None, None)


def _follow(run: RobotRun, source: JogSource, sink: QueueSink, hand: _Hand, enable: Enable) -> list[str]:
    """Run the loop beside the hand until the hand is done; return the limits that slowed it."""
    limited: list[str] = []
    resting_since_s: list[float] = []

    def done(status: RobotStatus) -> bool:
        limited.extend(name for name in status.limited if name not in limited)
        if not hand.ended or not status.at_rest:
            return status.guard is GuardState.STOPPED
        # the motors lag behind what was sent: where the arm is, is read once they have settled
        resting_since_s.append(status.t_s)
        return status.t_s - resting_since_s[0] >= SETTLE_S

    def show_progress(status: RobotStatus | None) -> None:
        if run.progress.cancelled():
            hand.end()
        if status is not None:
            run.progress.update(float(status.cycle), 0.0, status.why)

    hand.start()
    try:
        run.follow(source, sink, done, show_progress, enabled=enable.alive)
    finally:
        # first let go, then wait: the hand's thread may be in its last look for a while
        hand.end()
        hand.join()
    if hand.error is not None:
        raise hand.error
    status = run.status
    if status is not None and status.guard is GuardState.STOPPED:
        raise DeviceFailed(
            status.why,
            consequence="The robot was stopped",
            cure="Look at the robot and its controller, then begin anew",
        )
    return limited


class _Hand(threading.Thread):
    """Looks at a hand, renews the enable while it is held, and lets go of everything where it cannot be read."""

    def __init__(self, inputs: JogInput, source: JogSource, enable: Enable, clock: Clock) -> None:
        super().__init__(name="jog input")
        self._inputs, self._source, self._enable, self._clock = inputs, source, enable, clock
        self.ended = False
        self.error: ArmsightError | None = None

    def end(self) -> None:
        """Let go, and look no more."""
        self.ended = True
        self._let_go()

    def run(self) -> None:
        try:
            while not self.ended:
                self._look()
        except ArmsightError as error:
            self.error = error
        finally:
            self.end()

    def _look(self) -> None:
        seen = self._inputs.wait(LOOK_S)
        if seen is None:
            return
        if seen.ended:
            self.ended = True
        elif seen.enabled:
            self._source.push(seen.axes, self._clock.now_s())
            self._enable.keep()
        else:
            self._let_go()

    def _let_go(self) -> None:
        self._source.release()
        self._enable.release()


def _check_frame(frame: str, lengths_known: bool, name: str) -> None:
    """Refuse a frame that is none, or one that needs the arm's lengths where they are not known."""
    if frame not in set(JogFrame):
        raise UsageError(
            f"{frame!r} is no frame", consequence="Nothing is moved", cure="Give joints, base or tool (--frame)"
        )
    if frame != JogFrame.JOINTS and not lengths_known:
        raise UsageError(
            f"the lengths of {name} are not known, so its tool cannot be led along {frame} axes",
            consequence="Nothing is moved",
            cure="Give the arm (--arm), or --frame joints",
        )


def hand_question(robot: Robot, guard: Guard, frame: JogFrame, hand: JogInput) -> str:
    """Return what is asked before the robot may move."""
    return (
        f"Move {robot.name} by hand ({frame}), at up to {guard.limits.turn_rad_s / DEG:.1f} deg/s and "
        f"{guard.limits.speed_m_s / MM:.0f} mm/s at the tool? {hand.help()}"
    )
