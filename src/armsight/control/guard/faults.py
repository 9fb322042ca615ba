"""The faults that the guard watches for, and the state that each leads to."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import RigidTransform

from armsight.arrays import Array
from armsight.clock import StandStill
from armsight.control.guard.decision import GuardState, Inputs, TargetState
from armsight.control.guard.limits import JointBounds, Limits
from armsight.control.setpoints import Hold, JointGoal, JointVelocity, SetPoint, ToolPose, ToolTwist
from armsight.drivers import RobotState
from armsight.records import JointReading
from armsight.units import MS


@dataclass(frozen=True, slots=True)
class Fault:
    """What is wrong and the state it leads to. kind: its name; why: in words. without_robot: nothing can be sent."""

    state: GuardState
    kind: str
    why: str
    without_robot: bool = False


class Watch:
    """Tells faults of link, readings, cycle, operator and target. One check per method, each may be seen to fail."""

    def __init__(self, limits: Limits, bounds: JointBounds, cycle_s: float) -> None:
        self._limits = limits
        self._bounds = bounds
        self._cycle_s = cycle_s
        self._sent: Array = np.zeros((math.ceil(limits.lag_s / cycle_s) + 2, len(bounds.lower)))
        self._next = 0
        self._new_s: float | None = None
        self._reading: JointReading | None = None
        self._in_time = limits.calm_cycles
        self._away_s: float | None = None
        self._turns = StandStill(cycle_s, limits.stall_s)
        self.stood_s = 0.0
        """For how long the loop stood still before this cycle; 0 where it did not."""

    def begin(self, q: Array, now_s: float) -> None:
        """Forget the past; the robot stands at q (n,) now."""
        self._sent[:] = q
        self._new_s, self._reading = now_s, None
        self._in_time = self._limits.calm_cycles
        self._away_s = None
        self._turns.begin()
        self.turn(now_s)

    def turn(self, now_s: float) -> None:
        """Note that a cycle begins."""
        self.stood_s = self._turns.turn(now_s)

    def sent(self, q: Array) -> None:
        """Note where the robot was told to go (n,), in place of what was sent longer ago than the lag."""
        self._sent[self._next] = q
        self._next = (self._next + 1) % len(self._sent)

    def away_s(self, now_s: float) -> float:
        """Return for how long the target has not been fresh."""
        return 0.0 if self._away_s is None else now_s - self._away_s

    def faults(self, wanted: SetPoint, reading: JointReading | None, inputs: Inputs) -> list[Fault]:
        """Return all that is wrong now."""
        # all are asked every cycle, also behind the first that is found: each keeps its own count of time
        found = (
            self.stall(),
            self.stop(inputs),
            self.link(inputs),
            self.silence(reading, inputs.now_s),
            self.following(reading),
            self.finite(wanted),
            self.enable(inputs),
            self.late_cycle(inputs),
            self.target(inputs),
        )
        return [fault for fault in found if fault is not None]

    def stall(self) -> Fault | None:
        """The loop stood still: what was asked, enabled and known before it counts no more, so nothing is sent."""
        if not self.stood_s:
            return None
        why = f"the control loop stood still for {self.stood_s / MS:.0f} ms"
        return Fault(GuardState.STOPPED, "stall", why, without_robot=True)

    def stop(self, inputs: Inputs) -> Fault | None:
        """A stop that somebody asks for."""
        return Fault(GuardState.STOPPED, "stop", inputs.stop) if inputs.stop else None

    def link(self, inputs: Inputs) -> Fault | None:
        """The robot's own word that it takes no commands."""
        if inputs.robot in (RobotState.READY, RobotState.MOVING):
            return None
        why = f": {inputs.robot_why}" if inputs.robot_why else ""
        return Fault(GuardState.STOPPED, "link", f"the robot is {inputs.robot.value}{why}", without_robot=True)

    def silence(self, reading: JointReading | None, now_s: float) -> Fault | None:
        """No new reading for too long: readings that stay away, and the same one again and again.

        A busy computer reads late, and the makers' own links bear many cycles of that: so the arm is held first, and
        stopped where readings stay away for as long as a loop may stand still.
        """
        if reading is not None and (self._reading is None or reading.sequence != self._reading.sequence):
            self._reading, self._new_s = reading, now_s
        quiet_s = 0.0 if self._new_s is None else now_s - self._new_s
        if quiet_s <= self._limits.silent_cycles * self._cycle_s:
            return None
        state = GuardState.STOPPED if quiet_s > self._limits.lost_s else GuardState.HOLDING
        return Fault(state, f"silence {state}", f"no new reading from the robot for {quiet_s / MS:.0f} ms")

    def following(self, reading: JointReading | None) -> Fault | None:
        """A reading far from all that was sent lately: the robot does not follow, or the reading jumped."""
        if reading is None:
            return None
        # the arm lags behind by a time that is known only roughly: it may be anywhere among what was sent in that time
        low, high = self._sent.min(axis=0), self._sent.max(axis=0)
        off = np.maximum(low - reading.q, reading.q - high) - self._bounds.following
        if not off.max() > 0.0 and np.isfinite(reading.q).all():
            return None
        j = int(np.argmax(off))
        return Fault(
            GuardState.STOPPED,
            "following",
            f"joint {j + 1} is not where it was sent: it reads {reading.q[j]:.4g}, "
            f"sent was {self._sent[self._next - 1, j]:.4g}",
        )

    def finite(self, wanted: SetPoint) -> Fault | None:
        """A set point that holds no number, or not one per joint."""
        n = len(self._bounds.lower)
        match wanted:
            case JointGoal(q=values) | JointVelocity(qd=values):
                if len(values) != n:
                    return Fault(
                        GuardState.STOPPED, "set point", f"a set point of {len(values)} joints for an arm of {n}"
                    )
                good = np.isfinite(values).all()
            case ToolTwist(velocity_m_s=v, angular_rad_s=w):
                good = np.isfinite(v).all() and np.isfinite(w).all()
            case ToolPose(T_base_tool=T):
                if not isinstance(T, RigidTransform) or T.as_matrix().shape != (4, 4):
                    return Fault(GuardState.STOPPED, "set point", "a set point that is not one pose")
                good = np.isfinite(T.as_matrix()).all()
            case _:
                return None
        return None if good else Fault(GuardState.STOPPED, "set point", "a set point that is not finite")

    def enable(self, inputs: Inputs) -> Fault | None:
        """Nobody holds the enable."""
        return None if inputs.enabled else Fault(GuardState.DISABLED, "enable", "no enable from the operator")

    def late_cycle(self, inputs: Inputs) -> Fault | None:
        """A cycle that began late, until some in a row were in time."""
        late = inputs.late_s > self._limits.late_cycles * self._cycle_s
        # the first cycle in time after a late one proves little: a machine that hangs does so several times in a row
        self._in_time = 0 if late else self._in_time + 1
        if self._in_time >= self._limits.calm_cycles:
            return None
        return Fault(GuardState.HOLDING, "late cycle", "a cycle began late")

    def target(self, inputs: Inputs) -> Fault | None:
        """The target that the source follows is not there, or what is known of it is old."""
        state, age_s = inputs.target, inputs.target_age_s
        old = age_s is not None and not age_s <= self._limits.target_age_s
        if old and state in (None, TargetState.FRESH):
            state = TargetState.STALE
        if state in (None, TargetState.FRESH):
            self._away_s = None
            return None
        if self._away_s is None:
            self._away_s = inputs.now_s
        seen_text = "" if age_s is None else f", last seen {age_s:.3g} s ago"
        return Fault(GuardState.HOLDING, f"target {state}", f"the target is {state}{seen_text}")


def hold_reason(wanted: SetPoint) -> Fault | None:
    """Return the fault of a source that asks to hold and says why."""
    return Fault(GuardState.HOLDING, "source", wanted.why) if isinstance(wanted, Hold) and wanted.why else None
