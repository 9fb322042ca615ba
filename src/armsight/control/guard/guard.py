"""The guard: every motion passes it, and what it lets through can always come to rest within the limits."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from armsight.arrays import Array
from armsight.control.guard.decision import Decision, GuardEvent, GuardState, Inputs
from armsight.control.guard.faults import Fault, Watch
from armsight.control.guard.follow import Follower, Move
from armsight.control.guard.limits import Limits, joint_bounds
from armsight.control.setpoints import (
    CycleState,
    Hold,
    JointGoal,
    JointVelocity,
    SetPoint,
    ToolPose,
    ToolTwist,
)
from armsight.drivers import Robot, RobotTraits
from armsight.errors import UsageError
from armsight.kinematics import Arm
from armsight.records import JointReading

CUT_SHARE = 0.1
"""Share of the following tolerance by which a robot may round a command; more is a command that was cut."""
SEVERITY = {GuardState.STOPPED: 3, GuardState.DISABLED: 2, GuardState.HOLDING: 1}


class Guard:
    """Keeps an arm within limits: give it a set point, a reading and the inputs once a cycle, and send what it decides.

    At every moment it holds a way to rest that keeps all limits, found and checked one cycle before; a set point is
    followed only as far as such a way exists behind it. Faults lead to defined states (docs/guide/guard.md), never to
    the last velocity. Pure: no clock, no thread, no file. It is no certified safety function.
    """

    def __init__(self, arm: Arm, limits: Limits, cycle_s: float) -> None:
        """Take the robot's arm, cycle_s in s; raises UsageError, Inconsistent where limits and arm do not fit."""
        if not cycle_s > 0.0:
            raise UsageError(f"a cycle of {cycle_s} s cannot be", consequence="The robot is not moved")
        self.arm, self.limits, self.cycle_s = arm, limits, cycle_s
        self.bounds = joint_bounds(arm, limits)
        self._follower = Follower(arm, limits, self.bounds, cycle_s)
        self._watch = Watch(limits, self.bounds, cycle_s)
        self._begun = False
        self.state, self.why = GuardState.DISABLED, ""
        self._kind = ""
        self._limited: tuple[str, ...] = ()
        self._wait_release = False
        self._cut: Fault | None = None
        self._refused: Fault | None = None
        self._stop_sent = False
        self._resting = self._waited = 0
        self._outside = ""

    @classmethod
    def of(cls, robot: Robot, arm: Arm, limits: Limits) -> Guard:
        """Return the guard of a robot: one whose joints hang below their goals may be so far off more."""
        hangs = RobotTraits.of(robot).hangs_rad
        return cls(arm, replace(limits, following=limits.following + hangs), robot.cycle_s)

    @property
    def q_sent(self) -> Array:
        """Where the robot was last told to go (n,)."""
        return self._follower.now.q

    def begin(self, q: Array, now_s: float) -> None:
        """Take over a robot that was told to stand at readings q (n,). Raises UsageError, Inconsistent for such q."""
        self._follower.stand(self.arm.checked(q))
        self._watch.begin(self._follower.now.q, now_s)
        self.state, self.why, self._kind = GuardState.DISABLED, "", ""
        self._cut = self._refused = None
        self._stop_sent, self._begun, self._resting = False, True, 0
        self._outside = self._follower.outside()

    def reset(self, q: Array, now_s: float) -> None:
        """Leave STOPPED; the robot stands at q (n,). The enable must be let go of and given anew before it moves."""
        self.begin(q, now_s)
        self._wait_release = True

    def cycle_state(self, now_s: float, reading: JointReading | None) -> CycleState:
        """Return what the source is told at now_s."""
        return CycleState(
            t_s=now_s,
            cycle_s=self.cycle_s,
            q=self._follower.now.q if reading is None else reading.q,
            q_sent=self._follower.now.q,
            qd_sent=self._follower.now.qd,
            T_base_tool=self._follower.T_base_tool,
            running=self.state is GuardState.RUNNING,
            refused=self._refused is not None and self._kind == self._refused.kind,
            q_s=None if reading is None else reading.t_s,
            enabled=self.state is not GuardState.DISABLED,
        )

    def step(self, wanted: SetPoint, reading: JointReading | None, inputs: Inputs) -> Decision:
        """Decide what is sent this cycle. Raises UsageError before begin(); no set point, reading or input raises."""
        if not self._begun:
            raise UsageError("the guard was not told where the robot stands", cure="Call begin() first")
        self._waited = self._waited + 1 if inputs.waiting else 0
        self._watch.turn(inputs.now_s)
        if inputs.late_s >= self.cycle_s or self._watch.stood_s or self._waited > self.limits.silent_cycles:
            self._follower.stand(self._follower.now.q)  # told nothing for a cycle, the robot came to rest by itself
        fault = self._worst(wanted, reading, inputs)
        if inputs.waiting:
            return self._waits(fault, inputs.now_s)
        retreat = None if fault is None else self._retreat(fault, inputs)
        move: Move | None = None
        retreating = False
        if fault is None:
            move, fault = self._followed(wanted)
        elif retreat is not None:
            move, refused = self._follower.tried(retreat, self.limits.retreat_speed)
            retreating, fault = refused is None, refused or fault
        events = self._standing_outside(inputs.now_s) + self._enter(fault, retreating, inputs.now_s, move)
        return self._sent(move, fault, events)

    def _standing_outside(self, now_s: float) -> tuple[GuardEvent, ...]:
        """Return, once, which limits the arm stood outside of when it was taken over, and the way back."""
        outside, self._outside = self._outside, ""
        return (GuardEvent(now_s, "warning", f"the arm stands {outside}"),) if outside else ()

    def acknowledge(self, q: Array, limited: tuple[str, ...] = ()) -> None:
        """Take note of where the robot says it was really told to go (n,); a command that it cut is a fault."""
        off = np.abs(q - self._follower.now.q) - CUT_SHARE * self.bounds.following
        if off.max() > 0.0 or not np.isfinite(q).all():
            limits = f": {', '.join(limited)}" if limited else ""
            why = f"the robot cut the command for joint {int(np.argmax(off)) + 1}{limits}"
            self._cut = Fault(GuardState.STOPPED, "cut", why)
        if np.isfinite(q).all():
            self._follower.correct(q)
            self._watch.sent(self._follower.now.q)

    def warm_up(self) -> None:
        """Run all that a cycle may run once, on another guard, so that no cycle waits for the compiler."""
        other, still = Guard(self.arm, self.limits, self.cycle_s), np.zeros(3)
        other.begin(self._follower.now.q, 0.0)
        for wanted in (
            JointVelocity(qd=np.zeros(self.arm.n)),
            ToolTwist(velocity_m_s=still, angular_rad_s=still),
            JointGoal(q=self._follower.now.q + 1e-3),
            ToolPose(T_base_tool=self._follower.T_base_tool),
            Hold(),
        ):
            reading = JointReading(q=self._follower.now.q, t_s=0.0, sequence=0, source="warm-up")
            other.step(wanted, reading, Inputs(now_s=0.0, enabled=True))
            other.acknowledge(other._follower.now.q)

    def _worst(self, wanted: SetPoint, reading: JointReading | None, inputs: Inputs) -> Fault | None:
        """Return the gravest fault. A stop stays until the reset; the enable counts only after it was let go of."""
        faults = self._watch.faults(wanted, reading, inputs)
        if self._cut is not None:
            faults.append(self._cut)
        if not inputs.enabled:
            self._wait_release = False
        if self._wait_release:
            faults.append(Fault(GuardState.DISABLED, "enable", "after a reset the enable must be let go of and given"))
        if self.state is GuardState.STOPPED:
            gone = any(fault.without_robot for fault in faults)
            return Fault(GuardState.STOPPED, self._kind, self.why, without_robot=gone)
        return max(faults, key=lambda fault: (fault.without_robot, SEVERITY[fault.state]), default=None)

    def _followed(self, wanted: SetPoint) -> tuple[Move | None, Fault | None]:
        """Return the move of a set point, or why there is none; one that met a limit first comes to rest there."""
        if self._refused is not None and not self._follower.now.at_rest:
            return None, self._refused
        move, fault = self._follower.tried(wanted, 1.0)
        self._refused = fault
        return move, fault

    def _retreat(self, fault: Fault, inputs: Inputs) -> SetPoint | None:
        """Return the set pose that the arm goes back to where the target has been away for long; None elsewhere."""
        if self.limits.retreat is None or not fault.kind.startswith("target"):
            return None
        if self._watch.away_s(inputs.now_s) < self.limits.retreat_after_s:
            return None
        return JointGoal(q=self.limits.retreat)

    def _enter(self, fault: Fault | None, retreating: bool, now_s: float, move: Move | None) -> tuple[GuardEvent, ...]:
        """Take the state that the fault leads to, and return what the recording is told of it."""
        state = GuardState.RETREATING if retreating else GuardState.RUNNING if fault is None else fault.state
        kind, why = ("", "") if fault is None else (fault.kind, fault.why)
        limited = move.limited if move is not None else ()
        events = []
        if (state, kind) != (self.state, self._kind):
            level = {GuardState.STOPPED: "error", GuardState.RUNNING: "info"}.get(state, "warning")
            events.append(GuardEvent(now_s, level, f"{state}: {why}" if why else str(state)))
        new = (name for name in limited if name not in self._limited)
        events.extend(GuardEvent(now_s, "info", f"limited: {name}") for name in new)
        self.state, self.why, self._kind, self._limited = state, why, kind, limited
        return tuple(events)

    def _sent(self, move: Move | None, fault: Fault | None, events: tuple[GuardEvent, ...]) -> Decision:
        """Move on by the move, or along the way to rest, and say what is sent."""
        if fault is not None and fault.without_robot:
            self._follower.stand(self._follower.now.q)
            return self._decision(None, events, stop_robot=self._first_stop())
        step = self._follower.advance(move)
        self._resting = self._resting + 1 if self._follower.now.at_rest and not step.any() else 0
        settled = self._resting * self.cycle_s > self.limits.lag_s  # the arm comes to rest later than its commands
        stopped = settled and self.state is GuardState.STOPPED
        return self._decision(None if stopped else step, events, stop_robot=stopped and self._first_stop())

    def _waits(self, fault: Fault | None, now_s: float) -> Decision:
        """Say what is so while nothing can be sent: the arm stands still, and goes on where it was once it can be."""
        events = () if fault is None else self._enter(fault, retreating=False, now_s=now_s, move=None)
        if fault is not None and fault.without_robot:
            return self._sent(None, fault, events)
        standing = self._follower.now.at_rest
        self._resting = self._resting + 1 if standing else 0
        settled = self._resting * self.cycle_s > self.limits.lag_s and self.state is GuardState.STOPPED
        return self._decision(None, events, stop_robot=settled and self._first_stop())

    def _first_stop(self) -> bool:
        first, self._stop_sent = not self._stop_sent, True
        return first

    def _decision(self, step: Array | None, events: tuple[GuardEvent, ...], *, stop_robot: bool) -> Decision:
        return Decision(
            step=step,
            q=self._follower.now.q,
            qd=self._follower.now.qd,
            T_base_tool=self._follower.T_base_tool,
            state=self.state,
            why=self.why,
            limited=self._limited,
            at_rest=self._follower.now.at_rest,
            stop_robot=stop_robot,
            events=events,
        )
