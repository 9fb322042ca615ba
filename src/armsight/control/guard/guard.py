"""The guard: every motion passes it, and what it lets through can always come to rest within the limits."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from armsight.control.guard.decision import Decision, GuardEvent, GuardState, Inputs
from armsight.control.guard.limits import Limits, joint_bounds
from armsight.control.guard.motion import Ceiling, Course, Planner, State
from armsight.control.guard.space import Breach, Sight, Space, pose_difference
from armsight.control.guard.watch import Fault, Watch, hold_reason
from armsight.control.setpoints import (
    CycleState,
    Finished,
    Hold,
    JointGoal,
    JointVelocity,
    SetPoint,
    ToolPose,
    ToolTwist,
)
from armsight.errors import UsageError
from armsight.kinematics import Arm
from armsight.records import JointReading

Array = NDArray[np.float64]

BRAKE_SAMPLES = 16
"""Places along the way to rest that are checked."""
SHARES = (1.0, 0.5, 0.2)
"""Of the speed asked for, tried one after the other before the arm is brought to rest."""
BELOW = 0.97
"""Share of a limit of speed that is aimed at: the Jacobian turns under way, and the real arm is not quite the model."""
BELOW_ACCELERATION = 0.85
"""The same of acceleration and jerk, which the turning Jacobian adds to."""
CUT_SHARE = 0.1
"""Share of the following tolerance by which a robot may round a command; more is a command that was cut."""
SEVERITY = {GuardState.STOPPED: 3, GuardState.DISABLED: 2, GuardState.HOLDING: 1}


@dataclass(frozen=True, slots=True, eq=False)
class Move:
    """The next state, how it comes to rest from there, and what limited it."""

    state: State
    brake: Course
    sight: Sight
    limited: tuple[str, ...]


class Refused(Exception):  # noqa: N818 - not an error: the set point's answer within this module
    """A set point that is not followed, with the fault that says why."""

    def __init__(self, fault: Fault) -> None:
        super().__init__(fault.why)
        self.fault = fault


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
        self._space = Space(arm, limits, self.bounds)
        self._planner = Planner(arm.n, cycle_s)
        self._watch = Watch(limits, self.bounds, cycle_s)
        self._begun = False
        self._set(np.zeros(arm.n))
        self.state, self.why = GuardState.DISABLED, ""
        self._kind = ""
        self._limited: tuple[str, ...] = ()
        self._wait_release = False
        self._cut: Fault | None = None
        self._stop_sent = False

    def begin(self, q: Array, now_s: float) -> None:
        """Take over a robot that was told to stand at readings q (n,). Raises UsageError, Inconsistent for such q."""
        self._set(self.arm.checked(q))
        self._watch.begin(self._now.q, now_s)
        self.state, self.why, self._kind = GuardState.DISABLED, "", ""
        self._cut, self._stop_sent, self._begun = None, False, True

    def reset(self, q: Array, now_s: float) -> None:
        """Leave STOPPED; the robot stands at q (n,). The enable must be let go of and given anew before it moves."""
        self.begin(q, now_s)
        self._wait_release = True

    def cycle_state(self, now_s: float, reading: JointReading | None) -> CycleState:
        """Return what the source is told at now_s."""
        return CycleState(
            t_s=now_s,
            cycle_s=self.cycle_s,
            q=self._now.q if reading is None else reading.q,
            q_sent=self._now.q,
            qd_sent=self._now.qd,
            T_base_tool=self._pose(),
            running=self.state is GuardState.RUNNING,
        )

    def step(self, wanted: SetPoint, reading: JointReading | None, inputs: Inputs) -> Decision:
        """Decide what is sent this cycle. Raises UsageError before begin(); no set point, reading or input raises."""
        if not self._begun:
            raise UsageError("the guard was not told where the robot stands", cure="Call begin() first")
        if inputs.late_s >= self.cycle_s:
            self._set(self._now.q)  # told nothing for a cycle, the robot came to rest by itself
        fault = self._worst(wanted, reading, inputs)
        move: Move | None = None
        retreating = False
        if fault is None:
            move, fault = self._tried(wanted, 1.0)
        elif self._retreats(fault, inputs):
            move, refused = self._tried(JointGoal(q=self.limits.retreat), self.limits.retreat_speed)  # type: ignore[arg-type]  # it is there
            retreating, fault = refused is None, refused or fault
        events = self._enter(fault, retreating, inputs.now_s, move)
        return self._sent(move, fault, events)

    def acknowledge(self, q: Array, limited: tuple[str, ...] = ()) -> None:
        """Take note of where the robot says it was really told to go (n,); a command that it cut is a fault."""
        off = np.abs(q - self._now.q) - CUT_SHARE * self.bounds.following
        if off.max() > 0.0 or not np.isfinite(q).all():
            told = f": {', '.join(limited)}" if limited else ""
            why = f"the robot cut the command for joint {int(np.argmax(off)) + 1}{told}"
            self._cut = Fault(GuardState.STOPPED, "cut", why)
        if np.isfinite(q).all():
            self._now = State(np.array(q, dtype=float), self._now.qd, self._now.qdd)
            self._watch.sent(self._now.q)

    def warm_up(self) -> None:
        """Run all that a cycle may run once, on another guard, so that no cycle waits for the compiler."""
        other, still = Guard(self.arm, self.limits, self.cycle_s), np.zeros(3)
        other.begin(self._now.q, 0.0)
        for wanted in (
            JointVelocity(qd=np.zeros(self.arm.n)),
            ToolTwist(velocity_m_s=still, angular_rad_s=still),
            JointGoal(q=self._now.q + 1e-3),
            ToolPose(T_base_tool=self._pose()),
            Hold(),
        ):
            reading = JointReading(q=self._now.q, t_s=0.0, sequence=0, source="warm-up")
            other.step(wanted, reading, Inputs(now_s=0.0, enabled=True))
            other.acknowledge(other._now.q)

    def _set(self, q: Array) -> None:
        """Be at rest at q (n,)."""
        self._now = State.rest(q)
        self._brake: Course | None = None
        self._braked_s = 0.0
        self._steps = np.zeros((2, self.arm.n))
        self._ways = np.zeros((2, 6))
        self._goal: Array | None = None
        self._sight = self._space.look(self._now.q[None])

    def _pose(self) -> RigidTransform:
        return RigidTransform.from_matrix(self._sight.T[0])

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

    def _retreats(self, fault: Fault, inputs: Inputs) -> bool:
        """Tell whether the target has been away for so long that the arm goes back to its set pose."""
        if self.limits.retreat is None or not fault.kind.startswith("target"):
            return False
        return self._watch.away_s(inputs.now_s) >= self.limits.retreat_after_s

    def _tried(self, wanted: SetPoint, share: float) -> tuple[Move | None, Fault | None]:
        """Return the move of a set point, or why it is refused; no move where the arm comes to rest within limits."""
        try:
            return self._move(wanted, share), hold_reason(wanted)
        except Refused as refused:
            return None, refused.fault

    def _move(self, wanted: SetPoint, share: float) -> Move | None:
        match wanted:
            case JointVelocity(qd=qd):
                return self._with_velocity(qd, (), in_space=False)
            case ToolTwist(velocity_m_s=v, angular_rad_s=w):
                qd = self._space.inverse_twist(self._sight.J[0], v, w)
                return self._with_velocity(qd, (), in_space=True)
            case JointGoal(q=q):
                self._check_goal(q, in_space=False)
                return self._to_goal(q, np.zeros(self.arm.n), share, (), in_space=False)
            case ToolPose(T_base_tool=T):
                return self._to_pose(T.as_matrix())
            case Hold() | Finished():
                return None

    def _with_velocity(self, qd: Array, limited: tuple[str, ...], *, in_space: bool) -> Move | None:
        """Return the move towards joint velocities, scaled down to the limits of speed."""
        self._goal = None
        share, cut = self._speed_share(qd)
        limited += cut if share < 1.0 else ()
        ceiling = self._ceiling(self._sight.J[0])
        before = self._breach_now(in_space)
        for part in SHARES:
            course = self._planner.to_velocity(self._now, part * share * qd, ceiling)
            move, broken = self._checked(course, ceiling, before, limited, in_space=in_space)
            if move is not None:
                return move
            limited += tuple(name for name in broken if name not in limited)
        return self._nowhere(limited)

    def _to_goal(
        self, q: Array, qd: Array, slow: float, limited: tuple[str, ...], *, in_space: bool
    ) -> Move | None:
        """Return the move towards joint values, passed at velocities qd; slow: share of all speeds."""
        way = q - self._now.q
        ceiling = self._ceiling(self._sight.J[0])
        before = self._breach_now(in_space)
        fast = self._speed_share(way)[0] if np.abs(way).max() <= 0.0 else self._fastest(way)
        for part in SHARES:
            speed = np.minimum(np.abs(way) * fast, self.bounds.speed) * part * slow + np.abs(qd)
            slower = dataclasses.replace(ceiling, speed=np.minimum(speed, BELOW * self.bounds.speed))
            course = self._planner.to_position(self._now, q, qd, slower)
            move, broken = self._checked(course, ceiling, before, limited, in_space=in_space)
            if move is not None:
                return move
            limited += tuple(name for name in broken if name not in limited)
        return self._nowhere(limited)

    def _to_pose(self, T: Array) -> Move | None:
        """Return the move to a pose for the end of this cycle: just so where that keeps the limits, else towards it."""
        limits = self.limits
        way, turn = pose_difference(T, self._sight.T[0])
        if np.linalg.norm(way) > limits.jump_m or (self.arm.n >= 6 and np.linalg.norm(turn) > limits.jump_rad):
            raise Refused(
                Fault(
                    GuardState.STOPPED,
                    "discontinuous",
                    f"the next pose is {np.linalg.norm(way) * 1e3:.1f} mm and {np.degrees(np.linalg.norm(turn)):.1f} deg "
                    "from the tool: the path jumps, or is faster than the limits",
                )
            )
        q = self._space.inverse_pose(T, self._sight)
        if q is None:
            raise Refused(Fault(GuardState.HOLDING, "reach", "the next pose is out of reach or singular"))
        self._check_goal(q, in_space=True)
        ahead = np.zeros(self.arm.n) if self._goal is None else (q - self._goal) / self.cycle_s
        self._goal = q
        just_so = self._just_so(q, np.concatenate([way, turn]))
        if just_so is not None:
            return just_so
        return self._to_goal(q, ahead, 1.0, ("faster than the limits",), in_space=True)

    def _just_so(self, q: Array, way: Array) -> Move | None:
        """Return the move that ends at q exactly, where differences over cycles keep every limit; None elsewhere."""
        T, bounds, limits = self.cycle_s, self.bounds, self.limits
        step = q - self._now.q
        speed, change = step / T, (step - self._steps[0]) / T**2
        jerk = (step - 2.0 * self._steps[0] + self._steps[1]) / T**3
        tool = (way / T, (way - self._ways[0]) / T**2, (way - 2.0 * self._ways[0] + self._ways[1]) / T**3)
        kept = (
            (np.abs(speed) <= BELOW * bounds.speed).all()
            and (np.abs(change) <= bounds.acceleration).all()
            and (np.abs(jerk) <= bounds.jerk).all()
            and all(
                np.linalg.norm(value[:3]) <= BELOW * straight and np.linalg.norm(value[3:]) <= BELOW * turned
                for value, straight, turned in zip(
                    tool,
                    (limits.speed_m_s, limits.acceleration_m_s2, limits.jerk_m_s3),
                    (limits.turn_rad_s, limits.turn_acceleration_rad_s2, limits.turn_jerk_rad_s3),
                    strict=True,
                )
            )
        )
        if not kept:
            return None
        state = State(q, speed + 0.5 * T * change, change)
        ceiling = self._ceiling(self._sight.J[0])
        return self._accepted(state, ceiling, self._breach_now(True), (), in_space=True)[0]

    def _check_goal(self, q: Array, *, in_space: bool) -> None:
        """Raise Refused for joint values that may not be gone to at all, and are not a way back into the limits."""
        sight = self._space.look(q[None])
        broken = self._space.breach(sight, np.zeros((1, self.arm.n)), in_space=in_space)
        worse = broken.worse_than(self._breach_now(in_space))
        if worse:
            raise Refused(Fault(GuardState.HOLDING, worse[0], f"where it shall go is beyond a limit: {worse[0]}"))

    def _nowhere(self, limited: tuple[str, ...]) -> Move | None:
        """Refuse a set point that no speed is slow enough for."""
        told = ", ".join(limited) or "no motion keeps all limits"
        raise Refused(Fault(GuardState.HOLDING, limited[-1] if limited else "limits", f"at a limit: {told}"))

    def _checked(
        self, course: Course | None, ceiling: Ceiling, before: Breach, limited: tuple[str, ...], *, in_space: bool
    ) -> tuple[Move | None, tuple[str, ...]]:
        """Return the move one cycle along a course, or the limits that it would break on the way to rest behind it."""
        if course is None:
            return None, ("no motion keeps the limits of the joints",)
        return self._accepted(course.at(self.cycle_s), ceiling, before, limited, in_space=in_space)

    def _accepted(
        self, state: State, ceiling: Ceiling, before: Breach, limited: tuple[str, ...], *, in_space: bool
    ) -> tuple[Move | None, tuple[str, ...]]:
        brake = self._planner.to_rest(state, ceiling)
        if brake is None:
            return None, ("no way to rest",)
        q, qd, _ = brake.sampled(np.linspace(0.0, brake.duration_s, BRAKE_SAMPLES).tolist())
        sight = self._space.look(q)
        worse = self._space.breach(sight, qd, in_space=in_space).worse_than(before)
        if worse:
            return None, worse
        return Move(state, brake, Sight(q[:1], sight.T[:1], sight.J[:1]), limited), ()

    def _breach_now(self, in_space: bool) -> Breach:
        return self._space.breach(self._sight, self._now.qd[None], in_space=in_space)

    def _ceiling(self, J: Array) -> Ceiling:
        """Return what the joints may do so that the tool keeps its limits whatever signs their motions have."""
        straight, turned = np.sqrt(np.square(J[:3]).sum(axis=0)), np.sqrt(np.square(J[3:]).sum(axis=0))

        def shared(joints: Array, tool: float, tool_turn: float) -> Array:
            worst = max(float(straight @ joints) / tool, float(turned @ joints) / tool_turn)
            return np.asarray(joints * min(1.0, BELOW_ACCELERATION / max(worst, 1e-12)))

        limits, bounds = self.limits, self.bounds
        return Ceiling(
            BELOW * bounds.speed,
            shared(bounds.acceleration, limits.acceleration_m_s2, limits.turn_acceleration_rad_s2),
            shared(bounds.jerk, limits.jerk_m_s3, limits.turn_jerk_rad_s3),
        )

    def _speed_share(self, qd: Array) -> tuple[float, tuple[str, ...]]:
        """Return the share of joint velocities that keeps the limits of speed, at most 1, and those that bind."""
        velocity, turning = self._space.twist(self._sight.J, qd[None])
        used = {
            "speed of the tool": float(np.linalg.norm(velocity)) / self.limits.speed_m_s,
            "turning of the tool": float(np.linalg.norm(turning)) / self.limits.turn_rad_s,
            "speed of a joint": float((np.abs(qd) / self.bounds.speed).max()),
        }
        most = max(used.values())
        return min(1.0, BELOW / max(most, 1e-12)), tuple(name for name, part in used.items() if part > BELOW)

    def _fastest(self, way: Array) -> float:
        """Return how often a second the way (n,) may be gone at the limits of speed."""
        small = way * (1e-3 / np.abs(way).max())
        large = 1e6 * small
        return self._speed_share(large)[0] * 1e6 * 1e-3 / float(np.abs(way).max())

    def _enter(
        self, fault: Fault | None, retreating: bool, now_s: float, move: Move | None
    ) -> tuple[GuardEvent, ...]:
        """Take the state that the fault leads to, and return what the recording is told of it."""
        state = GuardState.RETREATING if retreating else GuardState.RUNNING if fault is None else fault.state
        kind, why = ("", "") if fault is None else (fault.kind, fault.why)
        limited = move.limited if move is not None else ()
        events = []
        if (state, kind) != (self.state, self._kind):
            level = {GuardState.STOPPED: "error", GuardState.RUNNING: "info"}.get(state, "warning")
            events.append(GuardEvent(now_s, level, f"{state}: {why}" if why else str(state)))
        for name in limited:
            if name not in self._limited:
                events.append(GuardEvent(now_s, "info", f"limited: {name}"))
        self.state, self.why, self._kind, self._limited = state, why, kind, limited
        return tuple(events)

    def _sent(self, move: Move | None, fault: Fault | None, events: tuple[GuardEvent, ...]) -> Decision:
        """Move on by the move, or along the way to rest, and say what is sent."""
        before = self._now
        if fault is not None and fault.without_robot:
            self._set(before.q)
            return self._decision(None, events, stop_robot=self._first_stop())
        if move is not None:
            self._now, self._brake, self._braked_s, sight = move.state, move.brake, 0.0, move.sight
        else:
            self._goal = None
            sight = self._braked()
        step = self._now.q - before.q
        way, turn = pose_difference(sight.T[0], self._sight.T[0])
        self._sight = sight
        self._steps = np.array([step, self._steps[0]])
        self._ways = np.array([np.concatenate([way, turn]), self._ways[0]])
        stopped = self.state is GuardState.STOPPED and self._now.at_rest and not step.any()
        return self._decision(None if stopped else step, events, stop_robot=stopped and self._first_stop())

    def _braked(self) -> Sight:
        """Go on for a cycle along the way to rest that was checked when the last move was let through."""
        if self._brake is None:
            return self._sight
        start = self._brake.at(self._braked_s)
        self._braked_s += self.cycle_s
        done = self._braked_s >= self._brake.duration_s
        end = self._brake.at(min(self._braked_s, self._brake.duration_s))
        q = self._now.q + (end.q - start.q)
        self._now = State.rest(q) if done else State(q, end.qd, end.qdd)
        if done:
            self._brake = None
        return self._space.look(q[None])

    def _first_stop(self) -> bool:
        first, self._stop_sent = not self._stop_sent, True
        return first

    def _decision(self, step: Array | None, events: tuple[GuardEvent, ...], *, stop_robot: bool) -> Decision:
        return Decision(
            step=step,
            q=self._now.q,
            qd=self._now.qd,
            T_base_tool=self._pose(),
            state=self.state,
            why=self.why,
            limited=self._limited,
            at_rest=self._now.at_rest,
            stop_robot=stop_robot,
            events=events,
        )
