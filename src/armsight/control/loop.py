"""The control loop: read, ask the source, ask the guard, send; once a cycle, in the thread that calls it.

It waits by sleeping, then spinning; where the robot's controller sets the pace, for its next cycle, so that each of
those takes one step at most and has nothing to catch up. Before the first cycle everything is compiled and called once;
the garbage collector is off while it runs; nothing in it opens a file or waits for another thread but the link's.
"""

from __future__ import annotations

import gc
import math
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Protocol, runtime_checkable

import numpy as np

from armsight.arrays import Array
from armsight.clock import Clock
from armsight.control.guard import Decision, Guard, GuardState, Inputs, TargetState
from armsight.control.setpoints import CycleState, Finished, Hold, SetPoint, SetPointSource
from armsight.control.status import EventSink, Jitter, NoSink, RobotStatus, Timing
from armsight.drivers import Pace, Paced, Robot, RobotState, RobotTraits, Sent
from armsight.errors import ArmsightError, DeviceFailed, StaleData
from armsight.records import JointReading

SWITCH_S = 2e-4
"""How long another Python thread may keep the loop from running; Python's own 5 ms is longer than a cycle."""
END_S = 3.0
"""A robot that did not come to rest so long after the end was asked for is stopped by its own means."""
BEGIN_S = 0.5
"""The first reading is waited for so long, as long as a loop that runs may be without one."""
LATE_SHARE = 0.5
"""A cycle that begins later than this share of itself counts as late."""
PATIENCE = 1.5
"""Cycles that a controller's next one is waited for; then this one passes without a step."""


@runtime_checkable
class FollowsTarget(Protocol):
    """A source that depends on a target seen by cameras: the guard holds where the target is not there."""

    def target(self, now_s: float) -> tuple[TargetState, float | None]:
        """Return what is known of the target, and the age in s of the newest frame that shows it."""


class ControlLoop:
    """Moves an open robot through a guard. `run` blocks; all other methods may be called from any thread.

    enabled: tells whether the operator's enable is alive, such as Enable.alive. A source that has a method warm_up()
    gets it called before the first cycle; one that FollowsTarget is asked for its target each cycle. by_pose: send
    poses of the flange by move_pose; where not said, a robot gets them whose traits say that it takes no
    joints.
    """

    def __init__(
        self,
        robot: Robot,
        guard: Guard,
        source: SetPointSource,
        clock: Clock,
        *,
        enabled: Callable[[], bool],
        sink: EventSink | None = None,
        by_pose: bool | None = None,
    ) -> None:
        self._robot, self._guard, self._clock = robot, guard, clock
        self._source = source
        self._enabled = enabled
        self._sink = sink or NoSink()
        self._by_pose = not RobotTraits.of(robot).takes_joints if by_pose is None else by_pose
        self._T_tool_flange = guard.arm.T_flange_tool.inv()
        self._stop_why = ""
        self._reset = False
        self._ending = False
        self._status: RobotStatus | None = None
        self._jitter = Jitter(LATE_SHARE * guard.cycle_s)
        self._reading: JointReading | None = None
        self._finished = False
        self._paced = robot if isinstance(robot, Paced) else None
        self._pace: Pace | None = None

    @property
    def status(self) -> RobotStatus | None:
        """The newest cycle; None before the first."""
        return self._status

    def timing(self) -> Timing:
        """Return how punctual the loop was."""
        return self._jitter.timing()

    def stop(self, why: str = "stopped by the operator") -> None:
        """Bring the robot to rest from the next cycle on, until reset(). Legal at any time; never raises."""
        self._stop_why = why

    def reset(self) -> None:
        """Leave a stop; the robot moves again once the enable was let go of and given anew."""
        self._reset = True

    def end(self) -> None:
        """Let run() return as soon as the robot is at rest."""
        self._ending = True

    def exchange(self, source: SetPointSource) -> None:
        """Follow another source from the next cycle on; there is one at a time."""
        self._source = source

    def run(self, *, for_s: float = math.inf, until: Callable[[RobotStatus], bool] | None = None) -> Timing:
        """Run until end(), for_s has passed or until says so, come to rest, and return how punctual it was.

        The robot stands still before it begins and after it ended. Raises what the robot raises where it cannot be
        begun; troubles under way are states of the guard, and are in the status and in the events.
        """
        with quiet_interpreter():  # already as it begins, so that the link's thread has its turn in each cycle
            self._begin()
            try:
                self._cycles(for_s, until)
            except BaseException:
                self._robot.stop()
                raise
        return self._jitter.timing()

    def _begin(self) -> None:
        """Find where the robot was last told to go, and call everything once, so that no cycle is the first."""
        guard = self._guard
        if self._robot.n_joints != guard.arm.n:
            raise DeviceFailed(
                f"{self._robot.name} has {self._robot.n_joints} joints, the arm {guard.arm.name} has {guard.arm.n}",
                consequence="It is not moved",
                cure="Give the arm of this robot",
            )
        self._reading = self._first_reading()
        guard.begin(self._standing(), self._clock.now_s())
        guard.warm_up()
        warm_up = getattr(self._source, "warm_up", None)
        if warm_up is not None:
            warm_up()
        guard.begin(self._standing(), self._clock.now_s())
        if self._paced is not None:
            self._paced.slow_down(guard.bounds.speed)  # also where others ask it for motion beside this loop
            self._pace = self._paced.wait_step(-1, 0.0)

    def _first_reading(self) -> JointReading:
        """Return a fresh reading, wait BEGIN_S for it: a busy computer that has just loaded all reads late."""
        until_s = self._clock.now_s() + BEGIN_S
        while True:
            try:
                return self._robot.read()
            except StaleData:
                now_s = self._clock.now_s()
                if now_s > until_s:
                    raise
                self._clock.sleep_until(now_s + self._guard.cycle_s)

    def _standing(self) -> Array:
        """Return where the robot stands by its last command; one that takes only poses, by its reading."""
        if self._by_pose:
            return self._robot.read().q
        return self._robot.step_joints(np.zeros(self._guard.arm.n)).q

    def _cycles(self, for_s: float, until: Callable[[RobotStatus], bool] | None) -> None:
        clock, cycle_s = self._clock, self._guard.cycle_s
        start_s = due_s = ending_s = clock.now_s() + cycle_s
        while True:
            waiting, missed, due_s = self._due(due_s)
            clock.sleep_until(due_s)
            woke_s = clock.now_s()
            late_s = woke_s - due_s
            missed = max(missed, int(late_s / cycle_s))
            status = self._cycle(woke_s, late_s, waiting=waiting)
            self._jitter.cycle(woke_s, late_s, clock.now_s(), missed)
            if self._paced is None:
                due_s += (1 + missed) * cycle_s
            if woke_s - start_s >= for_s or (until is not None and until(status)):
                self._ending = True
            if not self._ending:
                ending_s = woke_s
            elif status.at_rest:
                return
            elif woke_s - ending_s > END_S:
                self._robot.stop()
                return

    def _due(self, due_s: float) -> tuple[bool, int, float]:
        """Return whether this cycle has to pass without a step, how many were missed before it, and when it was due.

        A robot without a pace of its own is told the next step at due_s. Of another it was due when the controller was
        given the last one, or earlier by those that it could have been given since.
        """
        before = self._pace
        if self._paced is None or before is None:
            return False, 0, due_s
        pace = self._pace = self._paced.wait_step(before.steps, PATIENCE * self._guard.cycle_s)
        missed = max(0, pace.cycles - before.cycles - 1)
        unused = pace.steps - max(before.steps, pace.asked) - 1
        if unused < 0:
            return True, missed, self._clock.now_s()
        return False, missed, pace.t_s - unused * self._guard.cycle_s

    def _cycle(self, now_s: float, late_s: float, *, waiting: bool = False) -> RobotStatus:
        """Do one cycle, begun late_s too late; also called by tests and by loops that keep time otherwise.

        waiting: the controller has not taken the last step yet.
        """
        guard, source = self._guard, self._source
        if self._reset:
            self._do_reset(now_s)  # before the robot is asked for its state: what it was before the reset is no fault
        reading, robot_state = self._read()
        idle = self._ending or waiting  # a set point that could not be sent would be lost to a path
        wanted = Hold() if idle else self._asked(source, guard.cycle_state(now_s, self._reading))
        target, age_s = source.target(now_s) if isinstance(source, FollowsTarget) else (None, None)
        inputs = Inputs(
            now_s=now_s,
            enabled=self._enabled(),
            robot=robot_state,
            robot_why=getattr(self._robot, "why", ""),
            late_s=late_s,
            stop=self._stop_why,
            target=target,
            target_age_s=age_s,
            waiting=waiting,
        )
        decision = guard.step(wanted, reading, inputs)
        self._send(decision, now_s)
        for event in decision.events:
            self._sink.event(event.t_s, event.message, event.level, f"guard/{source.name}")
        self._finished = self._finished if waiting else isinstance(wanted, Finished)
        return self._noted(inputs, decision, source.name)

    def _asked(self, source: SetPointSource, now: CycleState) -> SetPoint:
        """Return what the source wants; a source that fails is told to hold, as the contract says it never does."""
        try:
            return source.next(now)
        except Exception as error:  # the arm must come to rest whatever a source does
            return Hold(why=f"the source {source.name} failed: {error}")

    def _read(self) -> tuple[JointReading | None, RobotState]:
        state = self._robot.state
        try:
            reading = self._robot.read()
        except ArmsightError:
            return None, state
        self._reading = reading
        self._sink.joints(reading)
        return reading, state

    def _send(self, decision: Decision, now_s: float) -> None:
        """Send what was decided; a robot that refuses is noticed by its state in the next cycle, or stopped here."""
        if decision.stop_robot:
            self._robot.stop()
        if decision.step is None:
            return
        try:
            sent = self._command(decision)
        except ArmsightError as error:
            self._stop_why = self._stop_why or f"the command failed: {error.cause}"
            return
        if not self._by_pose:
            self._guard.acknowledge(sent.q, sent.limited)
        else:
            self._guard.acknowledge(decision.q)
        values = {"q": sent.q.tolist(), "limited": list(sent.limited), "state": decision.state.value}
        self._sink.command(now_s, "pose" if self._by_pose else "joints", values)

    def _command(self, decision: Decision) -> Sent:
        if self._by_pose:
            return self._robot.move_pose(decision.T_base_tool * self._T_tool_flange)
        return self._robot.step_joints(decision.step if decision.step is not None else np.zeros(self._guard.arm.n))

    def _do_reset(self, now_s: float) -> None:
        self._reset = False
        if self._guard.state is not GuardState.STOPPED:
            return
        self._stop_why = ""  # first, so that a stop asked for meanwhile counts
        try:
            self._robot.reset()
            self._guard.reset(self._standing(), now_s)
        except ArmsightError as error:
            self._stop_why = f"the reset failed: {error.cause}"

    def _noted(self, inputs: Inputs, decision: Decision, source: str) -> RobotStatus:
        """Return the status of this cycle, which is now the newest."""
        status = RobotStatus(
            t_s=inputs.now_s,
            cycle=self._jitter.n_cycles + 1,
            robot=inputs.robot,
            guard=decision.state,
            why=decision.why,
            limited=decision.limited,
            source=source,
            reading=self._reading,
            q_sent=decision.q,
            at_rest=decision.at_rest,
            finished=self._finished,
            enabled=inputs.enabled,
            late=self._jitter.late,
            missed=self._jitter.missed,
        )
        self._status = status
        return status


@contextmanager
def quiet_interpreter() -> Iterator[None]:
    """Keep Python from collecting garbage, and from letting other threads run for long, until it ends."""
    was_on, switch_s = gc.isenabled(), sys.getswitchinterval()
    gc.disable()  # without a last collection: of a console's objects it takes half a second, and holds its server
    sys.setswitchinterval(min(switch_s, SWITCH_S))
    try:
        yield
    finally:
        sys.setswitchinterval(switch_s)
        if was_on:
            gc.enable()
