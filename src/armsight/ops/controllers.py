"""What a calibrated arm becomes in its controller: zeros, base and tool, a Universal Robot's table; and what is lost.

A zero is by how much more an axis has to show than it shows now, at the same posture: of the angle theta = sign q +
theta_rad of the nominal model, (calibrated - nominal) / sign. What a controller holds of it, and where that is written
down, stands in CONTROLLERS; what it holds nothing of is fitted into what it does, and the rest is the loss.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from scipy.spatial.transform import RigidTransform

from armsight.arrays import Array
from armsight.control.paths.exports import krl_frame, rapid_pose, ur_pose
from armsight.control.paths.program import decimals
from armsight.errors import Inconsistent, not_one_of
from armsight.kinematics import Arm, JointType, fk, parameter_names
from armsight.kinematics.axes import in_plain_rows
from armsight.kinematics.rigid import as_rigid, drawn_postures, fitted
from armsight.units import DEG, MM

MOST_ZERO_RAD = 0.35
"""A zero further off is of another arm, or of a joint that counts the other way."""
ZEROS: Mapping[JointType, str] = {JointType.REVOLUTE: "theta_rad", JointType.PRISMATIC: "d_m"}
"""What a zero of a joint is in its row."""
MOST_LOST_M = 0.05
"""An arm further from its nominal one than this is another arm."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Controller:
    """What a controller holds: title; axis: the name of an axis by its number; tool, frame: what they are called there.

    pose: a pose as text. whole: all of its table, not the zeros alone. zeros: what is done with them, and its source;
    lengths: what is known of lengths and twists.
    """

    title: str
    axis: str
    tool: str
    frame: str
    pose: Callable[[RigidTransform], str]
    zeros: tuple[str, ...]
    lengths: str
    whole: bool = False


def _numbers_of(T: RigidTransform, order: Literal["xyz", "XYZ"]) -> list[str]:
    """Return x, y, z in mm and three angles in degrees."""
    values = [*(T.translation / MM).tolist(), *np.rad2deg(T.rotation.as_euler(order)).tolist()]
    return [decimals(value, 4) for value in values]


def _fanuc_pose(T: RigidTransform) -> str:
    return ", ".join(f"{name} = {value}" for name, value in zip("XYZWPR", _numbers_of(T, "xyz"), strict=True))


def _val3_pose(T: RigidTransform) -> str:
    names = ("x", "y", "z", "rx", "ry", "rz")
    return " ".join(f'{name}="{value}"' for name, value in zip(names, _numbers_of(T, "XYZ"), strict=True))


NO_SOURCE = (
    "Where the controller keeps a zero no source known here says: master the axes by the maker's procedure so that",
    "each shows that much more at the same posture; where a procedure sets axes to 0, do it with each axis at minus",
    "its number.",
)
NO_LENGTHS = "no source is known that says where lengths and twists would be typed: they stay nominal"
CONTROLLERS: Mapping[str, Controller] = {
    "kuka": Controller(
        title="KUKA",
        axis="A{}",
        tool="TOOL_DATA[n] =",
        frame="BASE_DATA[n] =",
        pose=krl_frame,
        zeros=(
            "$MAMES[i] in $machine.dat is what the counter of axis i is set to at the mechanical zero (KR C2, machine",
            "data, 2.1.7: offset in degrees): add the number to it, and master the axis at its mark again.",
        ),
        lengths="lengths and twists of an absolutely accurate robot are written by KUKA alone: they stay nominal here",
    ),
    "ur": Controller(
        title="Universal Robots",
        axis="joint {}",
        tool="set_tcp:",
        frame="feature (installation):",
        pose=ur_pose,
        zeros=(
            "The lists replace those of the same names in [mounting] of .urcontrol/calibration.conf; all other lines",
            "stay as they are there (checksums tie it to the joints built in). They are added to the nominal table",
            "(ros-industrial/universal_robot #357). Whether a controller takes a changed file no source says: keep the",
            "old one, and check one pose before anything else moves.",
        ),
        lengths="the lists hold all of them",
        whole=True,
    ),
    "fanuc": Controller(
        title="FANUC",
        axis="J{}",
        tool="UTOOL[n]:",
        frame="UFRAME[n]:",
        pose=_fanuc_pose,
        zeros=NO_SOURCE,
        lengths=(
            "$PARAM_GROUP[1].$DH_A and $DH_D change lengths as one user reports (robot-forum 23503), no manual says "
            "so: they stay nominal here"
        ),
    ),
    "abb": Controller(
        title="ABB",
        axis="axis {}",
        tool="tooldata, tframe:",
        frame="wobjdata, uframe:",
        pose=lambda T: f"[{rapid_pose(T)}]",
        zeros=NO_SOURCE,
        lengths="Absolute Accuracy is written by ABB alone: lengths and twists stay nominal here",
    ),
    "staubli": Controller(
        title="Staubli (VAL 3)",
        axis="j{}",
        tool="tool on flange[0]:",
        frame="frame on world[0]:",
        pose=_val3_pose,
        zeros=NO_SOURCE,
        lengths=NO_LENGTHS,
    ),
}
"""By the name that `convert arm --to` takes."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Held:
    """What a controller holds of an arm: zeros (n,) of its readings, rad or m; arm: the one it will compute with.

    rms_m, most_m: how far its tool is from the calibrated one's over the ranges; before_m: most_m of the nominal arm
    with the same base and tool.
    """

    arm: Arm
    zeros: Array
    rms_m: float
    most_m: float
    before_m: float


def held_by(model: Arm, nominal: Arm, controller: Controller) -> Held:
    """Return what a controller that has the nominal arm can hold of the calibrated one. Raises Inconsistent."""
    if model.n != nominal.n or [one.type for one in model.joints] != [one.type for one in nominal.joints]:
        raise Inconsistent(
            f"{model.name} has {model.n} joints, and not those of {nominal.name}",
            consequence="Nothing can be said of one by the other",
            cure="Give --nominal with the arm that the controller has",
        )
    readings = drawn_postures(nominal)
    wanted = fk(model, model.values(readings))
    start = replace(nominal, T_world_base=model.T_world_base, T_flange_tool=model.T_flange_tool, covariance=None)
    own, placed = start.values(readings), parameter_names(start)[-12:]
    before = _off(fitted(start, wanted, own, placed), own, wanted)
    if controller.whole:
        arm, zeros = _whole(model, nominal), np.zeros(model.n)
    else:
        free = [f"{joint.name}.{ZEROS[joint.type]}" for joint in start.joints[:-1]]  # the last one is the tool's turn
        arm = fitted(fitted(start, wanted, own, [*free, *placed[6:]]), wanted, own, [*free, *placed])
        moved = [
            (getattr(after, key) - getattr(drawn, key)) / drawn.sign
            for after, drawn in zip(arm.joints, nominal.joints, strict=True)
            for key in (ZEROS[drawn.type],)
        ]
        zeros = np.asarray(nominal.gearing_back @ moved) if nominal.couplings else np.array(moved)
    off = _off(arm, own, wanted)
    rms_m = float(np.sqrt(np.mean(off**2)))
    found = Held(arm=arm, zeros=zeros, rms_m=rms_m, most_m=float(off.max()), before_m=float(before.max()))
    _require_same(model, nominal, found)
    return found


def _whole(model: Arm, nominal: Arm) -> Arm:
    """Return the arm in the nominal one's kind of rows: rigid, each joint counting whole turns. Raises Inconsistent."""
    if min(joint.sign for joint in (*model.joints, *nominal.joints)) <= 0.0 or model.couplings:
        raise Inconsistent(
            f"joints of {model.name} count backwards, or are coupled",
            consequence="The controller's table has no place for that",
            cure="Calibrate the arm by its own readings, from the nominal arm that the controller has",
        )
    rigid = as_rigid(model).arm
    turning = tuple(replace(joint, sign=1.0) for joint in rigid.joints)
    return in_plain_rows(replace(rigid, joints=turning, covariance=None), nominal)


def _off(arm: Arm, q: Array, wanted: Array) -> Array:
    return np.asarray(np.linalg.norm(fk(arm, q)[:, :3, 3] - wanted[:, :3, 3], axis=1))


def _require_same(model: Arm, nominal: Arm, found: Held) -> None:
    turned = np.where(nominal.revolute, np.abs(found.zeros), 0.0)
    joint = int(np.argmax(turned))
    if found.before_m <= MOST_LOST_M and turned[joint] <= MOST_ZERO_RAD:
        return
    what = f"its tool is up to {found.before_m / MM:.3g} mm off"
    if turned[joint] > MOST_ZERO_RAD:
        what = f"the zero of joint {joint + 1} is {found.zeros[joint] / DEG:.3g} deg off"
    raise Inconsistent(
        f"{model.name} is no calibration of {nominal.name}: {what}",
        consequence="Numbers for that controller would send the arm elsewhere",
        cure="Give --nominal with the arm that the controller has, and check the sense of its joints",
    )


def controller_sheet(model: Arm, nominal: Arm, name: str) -> tuple[str, Held]:
    """Return what is typed into a controller, as text, and what it holds. Raises UsageError, Inconsistent."""
    if name not in CONTROLLERS:
        raise not_one_of("to", name, tuple(CONTROLLERS))
    controller = CONTROLLERS[name]
    found = held_by(model, nominal, controller)
    lines = [
        f"# {controller.title}: {model.name}, by its nominal arm {nominal.name}",
        "",
        *(f"# {line}" for line in controller.zeros),
        "",
    ]
    lines += _ur_lists(found.arm, nominal) if controller.whole else _zeros(found, nominal, controller)
    lines += [
        "",
        f"# Lengths: {controller.lengths}.",
        "",
        f"{controller.tool} {controller.pose(found.arm.T_flange_tool)}",
        "",
        "# The world in which the arm was measured, seen from its base:",
        f"{controller.frame} {controller.pose(found.arm.T_world_base.inv())}",
        "",
        f"# {loss(found)}",
        "",
    ]
    return "\n".join(lines), found


def loss(found: Held) -> str:
    """Return what a controller loses of an arm, in words."""
    return (
        f"With these its tool is where the calibrated arm says to {found.rms_m / MM:.3f} mm RMS, "
        f"{found.most_m / MM:.3f} mm at most over the joints' ranges; with base and tool alone to "
        f"{found.before_m / MM:.3f} mm at most"
    )


def _zeros(found: Held, nominal: Arm, controller: Controller) -> list[str]:
    lines = []
    for k, (zero, joint) in enumerate(zip(found.zeros.tolist(), nominal.joints, strict=True), 1):
        scale, unit = (DEG, "deg") if joint.type is JointType.REVOLUTE else (MM, "mm")
        lines.append(f"{controller.axis.format(k)}: {round(zero / scale, 5) + 0.0:+.5f} {unit}")
    return lines


def _ur_lists(arm: Arm, nominal: Arm) -> list[str]:
    keys = {"delta_theta": "theta_rad", "delta_a": "a_m", "delta_d": "d_m", "delta_alpha": "alpha_rad"}
    lines = []
    for name, key in keys.items():
        deltas = [getattr(a, key) - getattr(b, key) for a, b in zip(arm.joints, nominal.joints, strict=True)]
        if key.endswith("_rad"):
            deltas = [float(np.arctan2(np.sin(delta), np.cos(delta))) for delta in deltas]
        lines.append(f"{name} = [ {', '.join(repr(delta) for delta in deltas)}]")
    return lines
