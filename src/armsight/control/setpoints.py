"""What may be asked of a robot, set points and a driver's commands; and who asks, one at a time, with its enable."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import RigidTransform

from armsight.arrays import Array
from armsight.clock import Clock
from armsight.errors import UsageError
from armsight.geometry import xyz_quat
from armsight.records import frozen_array
from armsight.units import DEG, MS


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class JointGoal:
    """Joint values q (n,) in rad or m to be reached as fast as the limits allow."""

    q: Array

    def __post_init__(self) -> None:
        object.__setattr__(self, "q", frozen_array("q", self.q, (None,)))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class JointVelocity:
    """Joint velocities qd (n,) in rad/s or m/s."""

    qd: Array

    def __post_init__(self) -> None:
        object.__setattr__(self, "qd", frozen_array("qd", self.qd, (None,)))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class JointStep:
    """A step (n,) in rad or m from where the robot was last told to go; no further than one cycle allows."""

    step: Array

    def __post_init__(self) -> None:
        object.__setattr__(self, "step", frozen_array("step", self.step, (None,)))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FlangePose:
    """T_base_flange towards which the flange moves, as far as one cycle allows."""

    T_base_flange: RigidTransform


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ToolPose:
    """T_base_tool for the end of this cycle: a point of a path that is already timed."""

    T_base_tool: RigidTransform


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ToolTwist:
    """Velocity of the tool's origin (3,) in m/s and its angular velocity (3,) in rad/s, both in base axes."""

    velocity_m_s: Array
    angular_rad_s: Array

    def __post_init__(self) -> None:
        object.__setattr__(self, "velocity_m_s", frozen_array("velocity_m_s", self.velocity_m_s, (3,)))
        object.__setattr__(self, "angular_rad_s", frozen_array("angular_rad_s", self.angular_rad_s, (3,)))


@dataclass(frozen=True, slots=True, kw_only=True)
class Hold:
    """Come to rest and stay there; why: in words, empty where that is what was wanted."""

    why: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class Finished:
    """The source has nothing more to ask: the robot rests where it is."""


SetPoint = JointGoal | JointVelocity | ToolPose | ToolTwist | Hold | Finished
"""What a source asks for, cycle by cycle."""

Motion = JointGoal | JointVelocity | JointStep | FlangePose | ToolTwist
"""What a driver asks for, over a network or from a page; steps and poses become goals of the joints."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CycleState:
    """What a source is told at the beginning of a cycle.

    t_s: now, on the loop's clock. cycle_s: until the next cycle. q (n,): the newest reading, of q_s; None where none
    came yet. q_sent (n,): where the robot was last told to go. qd_sent (n,): at which velocity. T_base_tool: of q_sent
    by the arm's model. running: whether the guard followed the last set point; where it did not, a path waits. refused:
    that it did not for the set point's own sake, nor would at a second try; else the enable or a reading is missing.
    enabled: whether the operator's enable was held in the last cycle.
    """

    t_s: float
    cycle_s: float
    q: Array
    q_sent: Array
    qd_sent: Array
    T_base_tool: RigidTransform
    running: bool = True
    refused: bool = False
    q_s: float | None = None
    enabled: bool = True


class SetPointSource(Protocol):
    """Asks for motion, once a cycle; everything it asks passes the guard."""

    @property
    def name(self) -> str:
        """What events and screens call it: servo, path, jog, client."""

    def next(self, now: CycleState) -> SetPoint:
        """Return what is wanted for this cycle; never blocks, and raises nothing: troubles are a Hold with its why."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Heartbeat:
    """The driver is alive. enable: motion is allowed. number: of the beat; one that was overtaken does not count."""

    enable: bool
    number: int | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Stop:
    """Come to rest and take nothing until a reset."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Reset:
    """Take commands again after a stop; the enable has to be let go of and given anew."""


Command = Motion | Hold | Heartbeat | Stop | Reset


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Taken:
    """A command that was taken.

    t_s: when, on the loop's clock. cycle: the loop's cycle then. q (n,): where it takes the joints, in rad or m; None
    where it has no goal. T_base_flange: the flange's pose there; None where it is not known. limited: the limits that
    cut the command, in words.
    """

    t_s: float
    cycle: int
    q: NDArray[np.float64] | None = None
    T_base_flange: RigidTransform | None = None
    limited: tuple[str, ...] = ()


def logged(command: Motion | Hold | Stop | Reset) -> tuple[str, dict[str, Any]]:
    """Return a command's kind and values as the log has them."""
    match command:
        case JointGoal(q=q):
            return "joint_goal", {"q": q.tolist()}
        case JointVelocity(qd=qd):
            return "joint_velocity", {"qd": qd.tolist()}
        case JointStep(step=step):
            return "joint_step", {"step": step.tolist()}
        case FlangePose(T_base_flange=T):
            xyz, quat = xyz_quat(T)
            return "flange_pose", {"T_base_flange": {"xyz_m": xyz.tolist(), "quat_xyzw": quat.tolist()}}
        case ToolTwist(velocity_m_s=v, angular_rad_s=w):
            return "tool_twist", {"velocity_m_s": v.tolist(), "angular_rad_s": w.tolist()}
        case Hold():
            return "hold", {}
        case Stop():
            return "stop", {}
        case Reset():
            return "reset", {}


ENABLE_S = 0.25
"""An enable that nobody renewed for so long is gone: some key repeats, or a client's heartbeats, one of them lost."""


class Enable:
    """A deadman: keep() renews it, release() ends it at once. Any thread may call each of them at any time."""

    def __init__(self, clock: Clock, timeout_s: float = ENABLE_S) -> None:
        self._clock = clock
        self._timeout_s = timeout_s
        self._until_s = -math.inf

    def keep(self) -> None:
        """Say that the operator is there."""
        self._until_s = self._clock.now_s() + self._timeout_s

    def release(self) -> None:
        """Say that the operator let go."""
        self._until_s = -math.inf

    def alive(self) -> bool:
        """Tell whether it was renewed within its time."""
        return self._clock.now_s() <= self._until_s


ARRIVED = 1e-6
"""A joint sent nearer to its goal than this (rad or m) and slower than this per s has arrived."""


class GoalSource:
    """Goes to joint values q (n,) in rad or m as fast as the guard lets it, and has then finished."""

    def __init__(self, q: ArrayLike, name: str = "goal") -> None:
        """Raises Inconsistent for values that are not finite."""
        self.name = name
        self._goal = JointGoal(q=frozen_array("q", q, (None,)))

    def next(self, now: CycleState) -> SetPoint:
        """Return the goal until the robot was sent there and rests."""
        goal = self._goal.q
        if len(goal) != len(now.q_sent):
            return self._goal  # the guard refuses it, and says why
        away = float(np.abs(goal - now.q_sent).max())
        return Finished() if max(away, float(np.abs(now.qd_sent).max())) < ARRIVED else self._goal


LONGEST_S = 0.25
"""A set point older than this is followed no longer: a client that falls silent is a stop."""


class ClientSource:
    """Holds the newest set point of a client; whoever receives it calls post, from any thread."""

    name = "client"

    def __init__(self, longest_s: float = LONGEST_S) -> None:
        self._longest_s = longest_s
        self._posted: tuple[float, SetPoint] | None = None

    def post(self, wanted: SetPoint, t_s: float) -> None:
        """Take a set point that was received at t_s, on the loop's clock, in place of the one before."""
        self._posted = (t_s, wanted)

    def clear(self) -> None:
        """Forget the set point: the client is gone."""
        self._posted = None

    def next(self, now: CycleState) -> SetPoint:
        """Return the newest set point while it is fresh; else Hold, with why."""
        posted = self._posted
        if posted is None:
            return Hold()
        age_s = now.t_s - posted[0]
        if age_s > self._longest_s:
            return Hold(why=f"no set point from the client for more than {self._longest_s / MS:.0f} ms")
        return posted[1]


AXES_S = 0.25
"""Axes older than this are let go of: a keyboard repeats a key about thirty times a second after its first pause."""
SPEED_M_S = 0.05
TURN_RAD_S = 20.0 * DEG
JOINT_SPEED = 10.0 * DEG
DEAD_ZONE = 0.05
"""A stick nearer to its middle than this share of its way is let go of."""


class JogFrame(StrEnum):
    """What the axes move: each joint, or the tool along and about the axes of the base or its own."""

    JOINTS = "joints"
    BASE = "base"
    TOOL = "tool"


class JogSource:
    """Turns axes of -1 to 1 into velocities. It reads no keys: whoever does calls push.

    n: joints of the robot. Axes are n joints, or x, y, z, rx, ry, rz of the frame. speed_m_s, turn_rad_s, joint_speed
    (rad/s or m/s): at a full axis; the guard cuts what is too fast.
    """

    name = "jog"

    def __init__(
        self,
        n: int,
        frame: JogFrame | str = JogFrame.JOINTS,
        *,
        speed_m_s: float = SPEED_M_S,
        turn_rad_s: float = TURN_RAD_S,
        joint_speed: float = JOINT_SPEED,
        timeout_s: float = AXES_S,
    ) -> None:
        self.frame = JogFrame(frame)
        self._n = n if self.frame is JogFrame.JOINTS else 6
        self._most = np.full(n, joint_speed) if self.frame is JogFrame.JOINTS else np.repeat([speed_m_s, turn_rad_s], 3)
        self._timeout_s = timeout_s
        self._axes: tuple[float, NDArray[np.float64]] | None = None

    def push(self, axes: Sequence[float], t_s: float) -> None:
        """Take the axes' values at t_s, on the loop's clock; legal from any thread.

        Raises UsageError for another number of axes; what is no number between -1 and 1 is cut, or let go of.
        """
        values = np.asarray(axes, dtype=float)
        if values.shape != (self._n,):
            raise UsageError(
                f"{len(axes)} axes were pushed, {self.frame} has {self._n}",
                cure=f"Push {self._n} values between -1 and 1",
            )
        values = np.clip(np.where(np.isfinite(values), values, 0.0), -1.0, 1.0)
        self._axes = (t_s, np.where(np.abs(values) < DEAD_ZONE, 0.0, values))

    def release(self) -> None:
        """Let go of all axes."""
        self._axes = None

    def next(self, now: CycleState) -> SetPoint:
        """Return the velocity that the axes ask for; Hold where none is pushed, or longer ago than the time-out."""
        pushed = self._axes
        if pushed is None or now.t_s - pushed[0] > self._timeout_s or not pushed[1].any():
            return Hold()
        velocity = self._most * pushed[1]
        if self.frame is JogFrame.JOINTS:
            return JointVelocity(qd=velocity)
        if self.frame is JogFrame.TOOL:
            turn = now.T_base_tool.rotation
            return ToolTwist(velocity_m_s=turn.apply(velocity[:3]), angular_rad_s=turn.apply(velocity[3:]))
        return ToolTwist(velocity_m_s=velocity[:3], angular_rad_s=velocity[3:])
