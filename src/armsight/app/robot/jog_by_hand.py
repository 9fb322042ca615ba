"""A robot moved by keys or a gamepad, through the guard, while the person holds the enable."""

from __future__ import annotations

import os
import select
import sys
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager

from armsight.app.arm_files import given_arm
from armsight.app.requests.motion import HandJogJob
from armsight.app.robot.jog import SETTLE_S, UNASKED, JogOutput, jog_output
from armsight.app.robot.opening import robot_of
from armsight.app.robot.robot_run import Confirm, RobotRun
from armsight.clock import Clock, SystemClock
from armsight.control.guard import Guard, GuardState
from armsight.control.setpoints import Enable, JogFrame, JogSource
from armsight.control.status import QueueSink, RobotStatus
from armsight.drivers import Robot
from armsight.drivers.jog_inputs import JogInput, open_jog_input, single_keys
from armsight.errors import ArmsightError, DeviceFailed, UsageError
from armsight.records import Progress, Silent
from armsight.units import DEG, MM

LOOK_S = 0.05
"""Longest time between two looks at the hand."""


def jog_by_hand(
    job: HandJogJob,
    confirm: Confirm,
    progress: Progress | None = None,
    *,
    clock: Clock | None = None,
    opened: Robot | None = None,
    inputs: Callable[[str, int], AbstractContextManager[JogInput]] = open_jog_input,
) -> JogOutput:
    """Move a robot as a hand says until it is done, and return where the robot stands.

    confirm: asked once, before anything can move. opened, inputs: in place of what the job names. Raises UsageError,
    DeviceNotFound; DeviceFailed where robot, guard or gamepad failed; Cancelled.
    """
    clock, model = clock or SystemClock(), given_arm(job.arm)
    robot = opened or robot_of(job, clock, model)
    run = RobotRun(job, robot, model, clock, progress or Silent())
    _check(job, run.knows_lengths, robot.name)
    source = JogSource(robot.n_joints, job.frame, speed_m_s=run.guard.limits.speed_m_s)
    axes = robot.n_joints if source.frame is JogFrame.JOINTS else 6
    with run, inputs(job.hand, axes) as hand:
        with run.planning():
            asked = _question(robot, run.guard, source.frame, hand)
        run.ask(confirm, asked, unasked=UNASKED)
        enable = Enable(clock)
        with run.recorded(job.record) as sink:
            limited = _follow(run, source, sink, _Hand(hand, source, enable, clock), enable)
        return jog_output(run, limited, None)


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


def _check(job: HandJogJob, lengths_known: bool, name: str) -> None:
    """Refuse a frame that is none, or one that needs the arm's lengths where they are not known."""
    if job.frame not in set(JogFrame):
        raise UsageError(
            f"{job.frame!r} is no frame", consequence="Nothing is moved", cure="Give joints, base or tool (--frame)"
        )
    if job.frame != JogFrame.JOINTS and not lengths_known:
        raise UsageError(
            f"the lengths of {name} are not known, so its tool cannot be led along {job.frame} axes",
            consequence="Nothing is moved",
            cure="Give the arm (--arm), or --frame joints",
        )


def _question(robot: Robot, guard: Guard, frame: JogFrame, hand: JogInput) -> str:
    """Return what is asked before the robot may move."""
    return (
        f"Move {robot.name} by hand ({frame}), at up to {guard.limits.turn_rad_s / DEG:.1f} deg/s and "
        f"{guard.limits.speed_m_s / MM:.0f} mm/s at the tool? {hand.help()}"
    )


KEYS_S = 0.1


@contextmanager
def listening(actions: Mapping[str, Callable[[], object]]) -> Iterator[None]:
    """Call the action of each key that is pressed, from a thread, until it ends. Without a terminal nothing happens."""
    if not sys.stdin.isatty():
        yield
        return
    end = threading.Event()

    def look(fd: int) -> None:
        while not end.is_set():
            if not select.select([fd], [], [], KEYS_S)[0]:
                continue
            for key in os.read(fd, 64).decode("ascii", "ignore"):
                action = actions.get(key)
                if action is not None:
                    action()

    with single_keys() as fd:
        thread = threading.Thread(target=look, args=(fd,), name="keys", daemon=True)
        thread.start()
        try:
            yield
        finally:
            end.set()
            thread.join()
