"""What a driver may ask of the control authority, and what they are answered."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from armsight.control.setpoints import FlangePose, Hold, JointGoal, JointStep, JointVelocity, Motion, ToolTwist
from armsight.geometry import xyz_quat


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
