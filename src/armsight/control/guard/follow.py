"""Finds the next step towards a set point, and with it a way to rest that keeps every limit."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import RigidTransform

from armsight.arrays import Array
from armsight.control.guard.decision import GuardState
from armsight.control.guard.faults import Fault, hold_reason
from armsight.control.guard.kernels import ceilings
from armsight.control.guard.limits import JointBounds, Limits
from armsight.control.guard.motion import Ceiling, Course, Planner, State
from armsight.control.guard.space import HAIR, Breach, Sight, Space, pose_difference
from armsight.control.setpoints import Finished, Hold, JointGoal, JointVelocity, SetPoint, ToolPose, ToolTwist
from armsight.errors import Inconsistent
from armsight.kinematics import Arm
from armsight.units import DEG, MM

BRAKE_SAMPLES = 16
"""Positions along the way to rest that are checked."""
TOO_FAST = 1e3
"""Joint speed (rad/s or m/s) beyond every limit."""
SHARES = (1.0, 0.5, 0.2)
"""Of the speed asked for, tried one after the other before the arm is brought to rest."""
BELOW = 0.97
"""Share of a limit of speed that is aimed at: the Jacobian turns under way, and the real arm is not quite the model."""


@dataclass(frozen=True, slots=True, eq=False)
class Move:
    """The next state, how it comes to rest from there, and what limited it."""

    state: State
    brake: Course
    sight: Sight
    limited: tuple[str, ...]


class Refused(Exception):
    """A set point that is not followed, with the fault that says why."""

    def __init__(self, fault: Fault) -> None:
        super().__init__(fault.why)
        self.fault = fault


class Follower:
    """Where the robot was last told to go, and how it goes on from there.

    At every moment it holds a way to rest that keeps all limits, found and checked one cycle before; a set point is
    followed only as far as such a way exists behind it.
    """

    def __init__(self, arm: Arm, limits: Limits, bounds: JointBounds, cycle_s: float) -> None:
        self.arm, self.limits, self.bounds, self.cycle_s = arm, limits, bounds, cycle_s
        self._space = Space(arm, limits, bounds)
        self._planner = Planner(arm.n, cycle_s)
        self._joints = np.array([bounds.acceleration, bounds.jerk])
        self._tool = np.array(
            [
                [limits.acceleration_m_s2, limits.turn_acceleration_rad_s2],
                [limits.jerk_m_s3, limits.turn_jerk_rad_s3],
            ]
        )
        self._apart = np.zeros(arm.n)
        self._tool_of: Sight | None = None
        self._before: dict[bool, Breach] = {}
        self._allowed: Array | None = None
        self.stand(np.zeros(arm.n))

    @property
    def now(self) -> State:
        """Where the robot was last told to go."""
        return self._now

    @property
    def T_base_tool(self) -> RigidTransform:
        """The tool there; made once for all who ask in a cycle, which costs as much as a tenth of the decision."""
        if self._tool_of is not self._sight:
            self._tool_of, self._T_base_tool = self._sight, RigidTransform(self._sight.T, normalize=False, copy=False)
        return self._T_base_tool

    def stand(self, q: Array) -> None:
        """Be at rest at q (n,)."""
        self._now = State.rest(q)
        self._brake: Course | None = None
        self._braked_s = 0.0
        self._steps = np.zeros((2, self.arm.n))
        self._ways = np.zeros((2, 6))
        self._goal: Array | None = None
        self._sight = self._space.look(self._now.q)
        self._before.clear()
        self._allowed = None

    def outside(self) -> str:
        """Return which limits it stands outside of and the way back, in words; empty inside."""
        return self._breach_now(in_space=False).describe()

    def correct(self, q: Array) -> None:
        """Take note that the robot was really sent to q (n,), near where it was told."""
        if np.abs(q - self._now.q).max() > HAIR:
            self._before.clear()
            self._allowed = None
        self._now = State(np.array(q, dtype=float), self._now.qd, self._now.qdd)

    def tried(self, wanted: SetPoint, share: float) -> tuple[Move | None, Fault | None]:
        """Return the move of a set point, or why it is refused; no move where the arm comes to rest within limits."""
        try:
            return self._move(wanted, share), hold_reason(wanted)
        except Refused as refused:
            return None, refused.fault
        except Inconsistent as error:  # joint values that the arm cannot have, such as a goal in degrees
            return None, Fault(GuardState.HOLDING, "reach", error.cause)

    def advance(self, move: Move | None) -> Array:
        """Go on by a move, or along the way to rest where there is none; return the step (n,)."""
        before = self._now
        if move is not None:
            self._now, self._brake, self._braked_s, sight = move.state, move.brake, 0.0, move.sight
        else:
            self._goal = None
            sight = self._braked()
        step = self._now.q - before.q
        way, turn = pose_difference(sight.T, self._sight.T)
        self._sight = sight
        self._steps = np.array([step, self._steps[0]])
        self._ways = np.array([np.concatenate([way, turn]), self._ways[0]])
        self._before.clear()
        return step

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
        return self._space.look(q)

    def _move(self, wanted: SetPoint, share: float) -> Move | None:
        match wanted:
            case JointVelocity(qd=qd):
                return self._with_velocity(qd, in_space=False)
            case ToolTwist(velocity_m_s=v, angular_rad_s=w):
                qd = self._space.inverse_twist(self._sight.J, v, w)
                return self._with_velocity(qd, in_space=True)
            case JointGoal(q=q):
                self._check_goal(q, in_space=False)
                return self._to_goal(q, np.zeros(self.arm.n), share, (), in_space=False)
            case ToolPose(T_base_tool=T):
                return self._to_pose(T.as_matrix())
            case Hold() | Finished():
                return None

    def _with_velocity(self, qd: Array, *, in_space: bool) -> Move | None:
        """Return the move towards joint velocities, scaled down to the limits of speed."""
        self._goal = None
        share, limited = self._speed_share(qd)
        for part, ceiling in self._attempts(share * qd - self._now.qd):
            course = self._planner.to_velocity(self._now, part * share * qd, ceiling)
            move, broken = self._checked(course, limited, in_space=in_space)
            if move is not None:
                return move
            limited += tuple(name for name in broken if name not in limited and part < 1.0)
        self._nowhere(broken)
        return None

    def _to_goal(self, q: Array, qd: Array, slow: float, limited: tuple[str, ...], *, in_space: bool) -> Move | None:
        """Return the move towards joint values, passed at velocities qd; slow: share of all speeds."""
        way = q - self._now.q
        often = self._fastest(way)
        for part, ceiling in self._attempts(way):
            speed = np.minimum(np.abs(way) * often, self.bounds.speed) * part * slow + np.abs(qd)
            slower = dataclasses.replace(ceiling, speed=np.minimum(speed, BELOW * self.bounds.speed))
            course = self._planner.to_position(self._now, q, qd, slower)
            move, broken = self._checked(course, limited, in_space=in_space)
            if move is not None:
                return move
            limited += tuple(name for name in broken if name not in limited and part < 1.0)
        self._nowhere(broken)
        return None

    def _attempts(self, way: Array) -> Iterator[tuple[float, Ceiling]]:
        """Yield shares of the speed with what the joints may do, boldest first, for a change of motion along way."""
        J = self._sight.J
        yield 1.0, self._ceiling(J, way)
        for share in SHARES:
            yield share, self._ceiling(J)

    def _to_pose(self, T: Array) -> Move | None:
        """Return the move to a pose for the end of this cycle: just so where that keeps the limits, else towards it."""
        way, turn = pose_difference(T, self._sight.T)
        self._check_jump(float(np.linalg.norm(way)), float(np.linalg.norm(turn)))
        q = self._space.inverse_pose(T, self._sight)
        if q is None:
            raise Refused(Fault(GuardState.HOLDING, "reach", "the next pose is out of reach or singular"))
        ahead = np.zeros(self.arm.n) if self._goal is None else (q - self._goal) / self.cycle_s
        self._goal = q
        just_so = self._just_so(q, np.concatenate([way, turn]))
        if just_so is not None:
            return just_so
        self._check_goal(q, in_space=True)
        return self._to_goal(q, ahead, 1.0, ("faster than the limits",), in_space=True)

    def _check_jump(self, way_m: float, turn_rad: float) -> None:
        """Raise Refused for a pose so far from the tool that it is no next step of a path."""
        turns = self.arm.n >= 6 and turn_rad > self.limits.jump_rad
        if way_m > self.limits.jump_m or turns:
            why = f"the next pose is {way_m / MM:.1f} mm and {turn_rad / DEG:.1f} deg from the tool"
            why += ": the path jumps, or is faster than the limits"
            raise Refused(Fault(GuardState.STOPPED, "discontinuous", why))

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
        return self._accepted(state, (), in_space=True)[0]

    def _check_goal(self, q: Array, *, in_space: bool) -> None:
        """Raise Refused for joint values that may not be gone to at all, and are not a way back into the limits."""
        still = np.zeros(self.arm.n)
        there, before = self._space.at(q, still, still, in_space=in_space), self._breach_now(in_space)
        worse = there.worse_than(self._allow(before))
        if worse:
            raise Refused(Fault(GuardState.HOLDING, worse[0], f"where it shall go is beyond a limit: {worse[0]}"))
        self._check_way_back(there, before, q)

    def _nowhere(self, broken: tuple[str, ...]) -> None:
        """Slow down for a cycle where that is enough, between two fast motions; else refuse the set point."""
        if self._space.names.only_motion(broken):
            return
        raise Refused(Fault(GuardState.HOLDING, broken[0], f"at a limit: {', '.join(broken)}"))

    def _checked(
        self, course: Course | None, limited: tuple[str, ...], *, in_space: bool
    ) -> tuple[Move | None, tuple[str, ...]]:
        """Return the move one cycle along a course, or the limits that it would break on the way to rest behind it."""
        if course is None:
            return None, ("joints too fast to be guided",)
        return self._accepted(course.at(self.cycle_s), limited, in_space=in_space)

    def _accepted(
        self, state: State, limited: tuple[str, ...], *, in_space: bool
    ) -> tuple[Move | None, tuple[str, ...]]:
        """Return the move to a state with a way to rest behind it, or the limits that each way to rest breaks."""
        before = self._breach_now(in_space)
        broken: tuple[str, ...] = ("no way to rest",)
        for ceiling in (self._ceiling(self._sight.J, state.qd), self._ceiling(self._sight.J)):
            brake = self._planner.to_rest(state, ceiling)
            if brake is None:
                continue
            dt_s = brake.duration_s / (BRAKE_SAMPLES - 1)
            q, qd, qdd = brake.sampled([i * dt_s for i in range(BRAKE_SAMPLES)])
            found, sight = self._space.along(q, qd, qdd, dt_s, before, in_space=in_space)
            broken = found.worse_than(self._allow(before))
            if not broken:
                self._check_way_back(found, before, q[-1])
                return Move(state, brake, sight, limited), ()
        return None, broken

    def _check_way_back(self, there: Breach, before: Breach, q: Array) -> None:
        """Raise Refused where the arm stands outside and would not, at rest at q (n,), be nearer to any such limit."""
        if not there.lessens(before, float(np.abs(q - self._now.q).max())):
            raise Refused(Fault(GuardState.HOLDING, "outside", f"the arm stands {before.describe()}"))

    def _allow(self, before: Breach) -> Array:
        """Return by how much each limit may be broken: no more than ever since the arm was stood here.

        Compared with the cycle before, rounding might lead it outwards a hair at a time.
        """
        if self._allowed is None or len(self._allowed) != len(before.depths):
            self._allowed = np.where(before.limits.of_position, np.inf, before.depths)
        position = before.limits.of_position
        self._allowed = np.where(position, np.minimum(self._allowed, np.maximum(before.depths, 0.0)), before.depths)
        return self._allowed

    def _breach_now(self, in_space: bool) -> Breach:
        """Return what is broken where the arm was last sent; worked out once a cycle."""
        if in_space not in self._before:
            now = self._now
            self._before[in_space] = self._space.at(now.q, now.qd, now.qdd, in_space=in_space)
        return self._before[in_space]

    def _ceiling(self, J: Array, way: Array | None = None) -> Ceiling:
        """Return what the joints may do so that the tool keeps its limits (kernels.ceilings).

        way (n,): where all joints change their motion along it together; whether they really do is left to the check.
        """
        out = np.empty_like(self._joints)
        ceilings(J, self._apart if way is None else way, self._joints, self._tool, out)
        return Ceiling(BELOW * self.bounds.speed, out[0], out[1])

    def _speed_share(self, qd: Array) -> tuple[float, tuple[str, ...]]:
        """Return the share of joint velocities that keeps the limits of speed, at most 1, and those that bind."""
        velocity, turning = self._space.twist(self._sight.J, qd)
        used = {
            "speed of the tool": float(np.linalg.norm(velocity)) / self.limits.speed_m_s,
            "turning of the tool": float(np.linalg.norm(turning)) / self.limits.turn_rad_s,
            "speed of a joint": float((np.abs(qd) / self.bounds.speed).max()),
        }
        most = max(used.values())
        return min(1.0, BELOW / max(most, 1e-12)), tuple(name for name, part in used.items() if part > BELOW)

    def _fastest(self, way: Array) -> float:
        """Return how often a second the way (n,) may be gone at the limits of speed."""
        far = float(np.abs(way).max())
        if far <= 0.0:
            return 0.0
        return self._speed_share(way * (TOO_FAST / far))[0] * TOO_FAST / far
