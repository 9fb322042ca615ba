"""URDF of a serial arm: links, fixed and moving joints, origins, axes, limits; written: world, base, link1 .., tool."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from armsight.arrays import Array
from armsight.errors import BadFile
from armsight.kinematics import Arm, Coupling, JointType
from armsight.kinematics.axes import AxisJoint, arm_from_axes, axes_of
from armsight.kinematics.rigid import followers, require_rigid
from armsight.store.atomic import disk_errors, read_bytes, write_text
from armsight.store.codec import named
from armsight.store.interpret import looks_like_mm
from armsight.store.urdf_elements import Mass, inertials, mass_of, numbers, root_of, text_of, together
from armsight.store.urdf_tree import NO_LIMIT, WORLD, Tree, UrdfJoint, chain_of, limits_of, tree_of

MAX_BYTES = 5_000_000
"""Larger than any arm's description; meshes are kept in files of their own."""

MOVING = {"revolute": JointType.REVOLUTE, "continuous": JointType.REVOLUTE, "prismatic": JointType.PRISMATIC}

LENGTH_OFF = 0.01
"""Length of a slide's axis that is rounding of its numbers, two digits and more: (0.71, 0.71, 0) has 1.004."""


def read_urdf(path: Path, *, tip: str | None = None, base: str | None = None) -> Arm:
    """Return the arm in a URDF file; see arm_from_urdf."""
    return arm_from_urdf(text_of(read_bytes(path, limit=MAX_BYTES), str(path)), str(path), tip=tip, base=base)


def arm_from_urdf(text: str, where: str = "URDF", *, tip: str | None = None, base: str | None = None) -> Arm:
    """Return the serial arm from the link base (the root) to the link tip, in standard Denavit-Hartenberg form.

    The frame `base` is that link's; it is the world's as well, but where the root is called world. Without tip the
    chain must not branch, but for fixed branches beside it; of several links fixed to the last one `tool0` or `flange`
    is the tool. Fixed joints are folded in; links outside the chain matter only by what they weigh, and count as
    standing at zero. A joint that mimics an earlier one has no reading of its own. What was taken otherwise than it is
    written stands in `source`.

    Raises BadFile that names the joint: in the chain floating, planar and unknown types, axes without length, limits
    swapped or in degrees, lengths in mm; branches and tools, with the links to choose from; loops.
    """
    root = root_of(text, where)
    links = {_name(link, "link", where) for link in root.findall("link")}
    if not links:
        raise BadFile(
            f"{where}: has no link", consequence="There is no arm in it", cure="Give the file that xacro has expanded"
        )
    tree = tree_of([_joint(element, where) for element in root.findall("joint")], links, where)
    base_link, before, chain = chain_of(tree, base, tip)
    for joint in chain:
        _check_kind(joint)
    T_world_base = np.eye(4)
    if base is None and base_link == WORLD and chain and chain[0].type == "fixed":
        base_link, T_world_base, chain = chain[0].child, chain[0].T_parent_joint, chain[1:]
    moving, last = _folded(before, chain, where)
    moving, notes = _limited(moving, chain)
    moving, couplings = _mimicking(moving, chain)
    moving, heavy = _loaded(moving, chain, tree, inertials(root))
    with named(where):
        arm = arm_from_axes(root.get("name") or "arm", T_world_base, moving, *last)
        told = "; ".join([*notes, *heavy])
        following = {coupling.joint for coupling in couplings}
        arm = replace(
            arm,
            joints=tuple(replace(joint, driven=joint.name not in following) for joint in arm.joints),
            base_link=base_link,
            tool_link=chain[-1].child,
            couplings=couplings,
            source=f"URDF; {told}" if told else "",
        )
    _check_lengths(arm, chain)
    return arm


def _name(element: ElementTree.Element, kind: str, where: str) -> str:
    name = element.get("name")
    if not name:
        raise BadFile(f"{where}: a {kind} has no name", cure="Give it a name")
    return name


def _joint(element: ElementTree.Element, where: str) -> UrdfJoint:
    name = _name(element, "joint", where)
    at = f"{where}: joint {name}"
    links = {}
    for role in ("parent", "child"):
        link = element.find(role)
        links[role] = link.get("link") if link is not None else None
        if not links[role]:
            raise BadFile(
                f"{at}: has no {role} link",
                consequence="The arm cannot be put together",
                cure=f'Give it one: <{role} link="..."/>, or remove the joint',
            )
    return UrdfJoint(
        name=name,
        type=element.get("type") or "",
        parent=str(links["parent"]),
        child=str(links["child"]),
        element=element,
        at=at,
    )


def _check_kind(joint: UrdfJoint) -> None:
    """Raise BadFile where a joint of the chain is none that an arm has."""
    if joint.type not in (*MOVING, "fixed"):
        what = "leaves the arm free to float" if joint.type == "floating" else "is not a joint of an arm"
        raise BadFile(
            f"{joint.at}: type {joint.type[:30]!r} {what}",
            consequence="The arm cannot be modelled",
            cure="Known are revolute, continuous, prismatic and fixed; --base or --tip can leave this joint out",
        )


def _folded(before: Array, chain: list[UrdfJoint], where: str) -> tuple[list[AxisJoint], tuple[Array, Array]]:
    """Fold fixed joints: the moving ones in base axes, from before (4, 4) on, and flange and tool behind the last."""
    at = before
    moving: list[AxisJoint] = []
    fixed: list[Array] = []
    for joint in chain:
        if joint.type == "fixed":
            fixed.append(joint.T_parent_joint)
            continue
        for T in fixed:
            at = at @ T
        moving.append(_axis_joint(joint, at @ joint.T_parent_joint))
        fixed, at = [], np.eye(4)
    if not moving:
        raise BadFile(
            f"{where}: nothing in it moves",
            consequence="It is not an arm",
            cure="Name the last link of the arm with --tip, or give another file",
        )
    flange = fixed[0] if fixed else np.eye(4)
    tool = np.eye(4)
    for T in fixed[1:]:
        tool = tool @ T
    return moving, (flange, tool)


def _check_lengths(arm: Arm, chain: Sequence[UrdfJoint]) -> None:
    """Raise BadFile where the arm from its first joint on, wherever that stands, is as long as in millimetres."""
    rows = arm.chain[1:-1]
    total_m = float(np.hypot(rows[:, 3], rows[:, 4]).sum() + np.linalg.norm(arm.T_flange_tool.translation))
    if not looks_like_mm(total_m):
        return
    longest = max(chain, key=lambda joint: float(np.linalg.norm(joint.T_parent_joint[:3, 3])))
    xyz = longest.T_parent_joint[:3, 3]
    raise BadFile(
        f"{longest.at}: origin xyz {' '.join(f'{x:g}' for x in xyz)} looks like millimetres: the arm would be "
        f"{total_m:.4g} m long",
        consequence="Taken as URDF means it the arm would be a thousand times its size",
        cure=f"Write metres here ({' '.join(f'{1e-3 * x:.9g}' for x in xyz)}) and where else the file has millimetres",
    )


def _axis_joint(joint: UrdfJoint, T: Array) -> AxisJoint:
    """Return a moving joint with its axis, its largest speed and effort, without limits."""
    axis = joint.element.find("axis")
    direction = numbers(axis.get("xyz") if axis is not None else None, "1 0 0", 3, f"{joint.at}: axis")
    length = float(np.linalg.norm(direction))
    slides = MOVING[joint.type] is JointType.PRISMATIC
    if length == 0.0 or (slides and abs(length - 1.0) > LENGTH_OFF):
        raise BadFile(
            f"{joint.at}: its axis, {direction.tolist()}, has length {length:.6g}, not 1",
            consequence="Where it goes is not known" if length == 0.0 else "Whether it moves as much more is not known",
            cure="Write it with length 1"
            + (f": {' '.join(f'{value:.9g}' for value in direction / length)}" if length else ", such as 0 0 1"),
        )
    limit = joint.element.find("limit")
    if joint.type != "continuous" and limit is None:
        raise BadFile(
            f"{joint.at}: has no <limit>",
            consequence="How far it moves is not known",
            cure="Give lower and upper, or, where it turns without end, make it continuous",
        )
    speed, effort = (_positive(None if limit is None else limit.get(key)) for key in ("velocity", "effort"))
    return AxisJoint(
        name=joint.name,
        type=MOVING[joint.type],
        T_parent_joint=T,
        axis=direction / length,
        max_speed=speed,
        stall_effort=effort,
    )


def _positive(text: str | None) -> float | None:
    """Return a positive number of an attribute; None for what says nothing, such as 0, infinite or no number."""
    try:
        value = float(text or 0.0)
    except ValueError:
        return None
    return value if 0.0 < value < NO_LIMIT else None


def _limited(moving: list[AxisJoint], chain: list[UrdfJoint]) -> tuple[list[AxisJoint], list[str]]:
    """Return the joints with their limits, and what of those was taken otherwise than it is written."""
    found, notes = limits_of([joint for joint in chain if joint.type != "fixed"])
    return [replace(one, lower=low, upper=high) for one, (low, high) in zip(moving, found, strict=True)], notes


def _mimicking(moving: list[AxisJoint], chain: list[UrdfJoint]) -> tuple[list[AxisJoint], tuple[Coupling, ...]]:
    """Return the joints, those that mimic with their offset as zero, and how these follow others."""
    out, couplings = [], []
    elements = [joint for joint in chain if joint.type != "fixed"]
    for k, (axis_joint, joint) in enumerate(zip(moving, elements, strict=True)):
        mimic = joint.element.find("mimic")
        if mimic is None or not mimic.get("joint"):
            out.append(axis_joint)
            continue
        by = str(mimic.get("joint"))
        if by not in [one.name for one in elements[:k]]:
            raise BadFile(
                f"{joint.at}: mimics the joint {by!r}, which is not before it in the chain",
                consequence="Its value is not known from the readings of the chain",
                cure="Choose a chain without it (--tip, --base); or, where the controller tells its value, remove "
                "<mimic>",
            )
        share = float(numbers(mimic.get("multiplier"), "1", 1, f"{joint.at}: multiplier of its mimic")[0])
        offset = float(numbers(mimic.get("offset"), "0", 1, f"{joint.at}: offset of its mimic")[0])
        couplings.append(Coupling(joint=joint.name, by=by, share=share))
        out.append(axis_joint.started_at(offset))
    return out, tuple(couplings)


def _loaded(
    moving: list[AxisJoint], chain: list[UrdfJoint], tree: Tree, inertial: Mapping[str, ElementTree.Element]
) -> tuple[list[AxisJoint], list[str]]:
    """Return the moving joints with the masses of all that hangs on each of them before the next, and what to know.

    Masses of the chain's own links are to be right; where those of others are not, the arm has none.
    """
    own, heavy = {joint.child for joint in chain}, tree.uphill(inertial)
    ends = {joint.child for joint in chain if joint.type != "fixed"}

    def hanging(start: str) -> list[tuple[Array, Mass]]:
        found: list[tuple[Array, Mass]] = []
        waiting = [(start, np.eye(4))]
        while waiting:
            link, T = waiting.pop()
            if link in inertial and (mass := mass_of(inertial[link], f"{tree.where}: link {link}: its inertial")):
                found.append((T, mass))
            below = [joint for joint in tree.below.get(link, ()) if joint.child in heavy and joint.child not in ends]
            waiting += [(joint.child, T @ joint.T_parent_joint) for joint in below]
        return found

    try:
        loads = [together(hanging(joint.child)) for joint in chain if joint.type != "fixed"]
    except BadFile as error:
        for link in own & set(inertial):
            mass_of(inertial[link], f"{tree.where}: link {link}: its inertial")
        return moving, [f"without masses: {error.cause.removeprefix(tree.where + ': ')}"]
    return [replace(joint, mass_kg=load.kg, com_m=load.com_m) for joint, load in zip(moving, loads, strict=True)], []


OURS = re.compile(rb'<joint name="world_base" .*<joint name="to_flange" .*<joint name="to_tool" ', re.DOTALL)
"""What every URDF of urdf_text holds, in this order."""


def write_urdf(path: Path, arm: Arm) -> None:
    """Write the arm's kinematics as URDF; see urdf_text."""
    write_text(path, urdf_text(arm))


def delete_urdf(path: Path) -> None:
    """Delete a URDF that write_urdf wrote; one of another program stays. Raises DeviceFailed where the disk refuses."""
    with disk_errors(path):
        if path.is_file() and OURS.search(path.read_bytes()[:MAX_BYTES]):
            path.unlink()


def urdf_text(arm: Arm) -> str:
    """Return the arm's kinematics as URDF: links world, base, link1.., flange, tool; no shapes, no masses.

    Poses are the same to rounding, also after reading it back. A joint without a drive mimics the one it follows.
    Raises Inconsistent for an arm that is not rigid (as_rigid), and for a joint that follows several.
    """
    require_rigid(arm, "URDF")
    leads = followers(arm, "URDF")
    base, joints, flange, tool = axes_of(arm)
    robot = ElementTree.Element("robot", name=arm.name)
    links = ["world", "base", *(f"link{i + 1}" for i in range(arm.n)), "flange", "tool"]
    for link in links:
        ElementTree.SubElement(robot, "link", name=link)
    _add_joint(robot, "world_base", "fixed", "world", "base", base)
    for joint, parent, child in zip(joints, links[1:], links[2:], strict=False):
        endless = math.isinf(joint.lower) and math.isinf(joint.upper)
        turns = joint.type is JointType.REVOLUTE
        kind = "continuous" if turns and endless else str(joint.type.value)
        element = _add_joint(robot, joint.name, kind, parent, child, joint.T_parent_joint)
        ElementTree.SubElement(element, "axis", xyz=_text(joint.axis))
        # a simulator takes 0 for a joint that cannot move: what is not known is no limit
        limit = {"effort": repr(joint.stall_effort or NO_LIMIT), "velocity": repr(joint.max_speed or NO_LIMIT)}
        if kind != "continuous":
            limit["lower"], limit["upper"] = (
                repr(float(np.clip(end, -NO_LIMIT, NO_LIMIT))) for end in (joint.lower, joint.upper)
            )
        ElementTree.SubElement(element, "limit", limit)
        if joint.name in leads:
            follows = leads[joint.name]
            ElementTree.SubElement(element, "mimic", joint=follows.by, multiplier=repr(float(follows.share)))
    _add_joint(robot, "to_flange", "fixed", links[-3], "flange", flange)
    _add_joint(robot, "to_tool", "fixed", "flange", "tool", tool)
    ElementTree.indent(robot)
    return '<?xml version="1.0"?>\n' + ElementTree.tostring(robot, encoding="unicode") + "\n"


def _add_joint(
    robot: ElementTree.Element, name: str, kind: str, parent: str, child: str, T: Array
) -> ElementTree.Element:
    element = ElementTree.SubElement(robot, "joint", name=name, type=kind)
    ElementTree.SubElement(element, "parent", link=parent)
    ElementTree.SubElement(element, "child", link=child)
    ElementTree.SubElement(element, "origin", xyz=_text(T[:3, 3]), rpy=_text(_rpy(T[:3, :3])))
    return element


def _text(values: Array) -> str:
    return " ".join(repr(float(value)) for value in values)


def _rpy(R: Array) -> Array:
    """Return roll, pitch, yaw with R = Rz Ry Rx, to rounding everywhere: the others are read with the yaw taken out."""
    yaw = math.atan2(R[1, 0], R[0, 0])
    c, s = math.cos(yaw), math.sin(yaw)
    M = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]]) @ R  # Ry Rx
    return np.array([math.atan2(-M[1, 2], M[1, 1]), math.atan2(-M[2, 0], M[0, 0]), yaw])
