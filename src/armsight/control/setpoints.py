"""What may be asked of a robot: set points for one control cycle, one source at a time, and a driver's commands."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from armsight.arrays import Array
from armsight.geometry import xyz_quat
from armsight.records import frozen_array


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
        ...

    def next(self, now: CycleState) -> SetPoint:
        """Return what is wanted for this cycle; never blocks, and raises nothing: troubles are a Hold with its why."""
        ...


@dataclass(frozen=True, slots=True, kw_only=True)
class Beat:
    """The driver is alive. enable: whether motion is allowed.

    number: of the beat, which grows; one that came by another way and was overtaken does not count.
    """

    enable: bool
    number: int | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Stop:
    """Come to rest and take nothing until a reset."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Reset:
    """Take commands again after a stop; the enable has to be let go of and given anew."""


Command = Motion | Hold | Beat | Stop | Reset


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
