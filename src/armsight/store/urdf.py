"""URDF, as far as a serial arm needs it: links, joints, fixed joints, origins, axes, limits."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from armsight.errors import BadFile, Inconsistent
from armsight.kinematics import Arm, JointType
from armsight.kinematics.axes import AxisJoint, arm_from_axes, axes_of
from armsight.store.atomic import disk_errors, read_bytes, write_text
from armsight.store.codec import named
from armsight.store.urdf_elements import Mass, masses, numbers, origin_of, together

Array = NDArray[np.float64]

MAX_BYTES = 5_000_000
"""Larger than any arm's description; meshes are kept in files of their own."""

NO_LIMIT = 1e9
"""What a limit without end is written as: URDF has no word for it on one side."""

MOVING = {"revolute": JointType.REVOLUTE, "continuous": JointType.REVOLUTE, "prismatic": JointType.PRISMATIC}


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class UrdfJoint:
    """One joint element: links by name, T_parent_joint (4, 4), and its element for the rest."""

    name: str
    type: str
    parent: str
    child: str
    T_parent_joint: Array
    element: ElementTree.Element


OURS = re.compile(rb'<joint name="world_base" .*<joint name="to_flange" .*<joint name="to_tool" ', re.DOTALL)
"""What every URDF of urdf_text holds, in this order."""

MOST_TOLD = 20
"""Links named in a message; a robot's description can have hundreds."""


def read_urdf(path: Path, *, tip: str | None = None, base: str | None = None) -> Arm:
    """Return the arm in a URDF file; see arm_from_urdf."""
    data = read_bytes(path, limit=MAX_BYTES)
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise BadFile(f"{path}: is not UTF-8 text", consequence="It is not read") from error
    return arm_from_urdf(text, str(path), tip=tip, base=base)


def arm_from_urdf(text: str, where: str = "URDF", *, tip: str | None = None, base: str | None = None) -> Arm:
    """Return the serial arm from the link base (the root) to the link tip, in standard Denavit-Hartenberg form.

    With a base named, its frame is the world's. Without tip the chain must not branch, but for fixed branches beside
    it; after the last joint the longest fixed chain is the tool. Fixed joints are folded in; joints outside the chain
    matter only by the masses of their links, which count as standing at zero. Raises BadFile that names the joint: in
    the chain floating, planar and unknown types, mimicking joints, axes not of unit length, limits swapped; branches,
    with the links to choose from; loops; masses below zero.
    """
    root = _parsed(text, where)
    joints = [_joint(element, where) for element in root.findall("joint")]
    links = {_name(link, "link", where) for link in root.findall("link")}
    if not links:
        raise BadFile(
            f"{where}: has no link", consequence="There is no arm in it", cure="A xacro file must be expanded first"
        )
    tree = _tree(joints, links, where)
    chain = _chain(tree, where, base, tip)
    for joint in chain:
        _check_kind(joint, where)
    before, moving, after = _folded(chain, where)
    moving = _loaded(moving, chain, tree, masses(root, where))
    with named(where):
        return arm_from_axes(root.get("name") or "arm", before, moving, *after)


def _parsed(text: str, where: str) -> ElementTree.Element:
    """Return the robot element. Document types, and with them entities, are refused before the parser sees them."""
    if re.search(r"<!\s*(DOCTYPE|ENTITY)|\0", text, re.IGNORECASE):  # zeros: the parser would take it for UTF-16
        raise BadFile(
            f"{where}: holds a document type or entities",
            consequence="It is not read: they could expand without end",
            cure="Remove the <!DOCTYPE ...> part",
        )
    try:
        root = ElementTree.fromstring(text)
    except (ElementTree.ParseError, ValueError) as error:
        raise BadFile(
            f"{where}: is not XML ({error})", consequence="It is not read", cure="A xacro file must be expanded first"
        ) from error
    if root.tag != "robot":
        raise BadFile(f"{where}: its root is <{str(root.tag)[:40]}>, not <robot>", cure="Give a URDF file")
    return root


def _name(element: ElementTree.Element, kind: str, where: str) -> str:
    name = element.get("name")
    if not name:
        raise BadFile(f"{where}: a {kind} has no name")
    return name


def _joint(element: ElementTree.Element, where: str) -> UrdfJoint:
    """Return one joint's place and kind."""
    name = _name(element, "joint", where)
    at = f"{where}: joint {name}"
    links = {}
    for role in ("parent", "child"):
        link = element.find(role)
        links[role] = link.get("link") if link is not None else None
        if not links[role]:
            raise BadFile(f"{at}: has no {role} link", consequence="The arm cannot be put together")
    return UrdfJoint(
        name=name,
        type=element.get("type") or "",
        parent=str(links["parent"]),
        child=str(links["child"]),
        T_parent_joint=origin_of(element, at),
        element=element,
    )


def _check_kind(joint: UrdfJoint, where: str) -> None:
    """Raise BadFile where a joint of the chain is none that an arm has, or has no value of its own."""
    at = f"{where}: joint {joint.name}"
    if joint.type not in (*MOVING, "fixed"):
        what = "leaves the arm free to float" if joint.type == "floating" else "is not a joint of an arm"
        raise BadFile(
            f"{at}: type {joint.type[:30]!r} {what}",
            consequence="The arm cannot be modelled",
            cure="Known are revolute, continuous, prismatic and fixed; --base or --tip can leave this joint out",
        )
    mimic = joint.element.find("mimic")
    if mimic is not None and joint.type != "fixed":
        raise BadFile(
            f"{at}: mimics the joint {mimic.get('joint')!r}, and is in the chain itself",
            consequence="It has no reading of its own, and the arm's model needs one for each joint",
            cure="Choose a chain without it (--tip, --base); or, where the controller tells its value, remove <mimic>",
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Tree:
    """The links, the joint above each link, and the joints below it."""

    links: frozenset[str]
    above: Mapping[str, UrdfJoint]
    below: Mapping[str, list[UrdfJoint]]

    def to(self, link: str, base: str | None, where: str) -> list[UrdfJoint]:
        """Return the joints from base (the root) to a link, in order."""
        chain: list[UrdfJoint] = []
        at = link
        while at in self.above and at != base:
            chain.append(self.above[at])
            at = self.above[at].parent
            if len(chain) > len(self.above):
                raise BadFile(f"{where}: its joints form a loop", consequence="It is not a serial arm")
        if base is not None and at != base:
            raise BadFile(
                f"{where}: the link {link} does not hang on the link {base}",
                consequence="There is no chain from the one to the other",
                cure="Name as base a link between the root and the tip",
            )
        return chain[::-1]


def _tree(joints: list[UrdfJoint], links: set[str], where: str) -> _Tree:
    """Return how links hang on each other; BadFile where a link is missing or hangs on two joints."""
    above: dict[str, UrdfJoint] = {}
    below: dict[str, list[UrdfJoint]] = {}
    for joint in joints:
        for link in (joint.parent, joint.child):
            if link not in links:
                raise BadFile(f"{where}: joint {joint.name} names the link {link!r}, which is not there")
        if joint.child in above:
            raise BadFile(
                f"{where}: the link {joint.child} hangs on two joints, {above[joint.child].name} and {joint.name}",
                consequence="The chain is closed, not serial",
            )
        above[joint.child] = joint
        below.setdefault(joint.parent, []).append(joint)
    return _Tree(links=frozenset(links), above=above, below=below)


def _chain(tree: _Tree, where: str, base: str | None, tip: str | None) -> list[UrdfJoint]:
    """Return the joints from the base (or root) to the tip, in order."""
    for link in (base, tip):
        if link is not None and link not in tree.links:
            raise BadFile(f"{where}: has no link {link!r}", cure=f"Use one of {_listed(sorted(tree.links))}")
    roots = sorted(tree.links - set(tree.above))
    if base is None and len(roots) != 1:
        what = f"{len(roots)} root links ({_listed(roots)})" if roots else "no root link: its joints form a loop"
        raise BadFile(f"{where}: has {what}", consequence="It is not one arm")
    start = base if base is not None else roots[0]
    return tree.to(tip if tip is not None else _end(start, tree, where), base, where)


def _end(start: str, tree: _Tree, where: str) -> str:
    """Return the last link: along the only branch that moves, then along the longest fixed one."""
    moves: dict[str, bool] = {}
    depth: dict[str, int] = {}
    order = [start]
    for link in order:  # grows while it is walked
        order += [joint.child for joint in tree.below.get(link, ())]
        if len(order) > len(tree.links):
            raise BadFile(f"{where}: its joints form a loop", consequence="It is not a serial arm")
    for link in reversed(order):
        children = tree.below.get(link, ())
        moves[link] = any(joint.type != "fixed" or moves[joint.child] for joint in children)
        depth[link] = max((1 + depth[joint.child] for joint in children), default=0)

    def moving(link: str) -> list[UrdfJoint]:
        return [joint for joint in tree.below.get(link, ()) if joint.type != "fixed" or moves[joint.child]]

    link = start
    while children := tree.below.get(link, []):
        onwards = moving(link)
        if len(onwards) > 1:
            tips = [tip for tip in order if tip != start and (tip not in tree.below or len(moving(tip)) > 1)]
            counted = [f"{tip} ({_count(tree.to(tip, start, where))})" for tip in tips]
            raise BadFile(
                f"{where}: branches at the link {link} into {', '.join(joint.name for joint in onwards)}",
                consequence="Which of them is the arm is not known",
                cure=f"Name the last link of the chain you mean with --tip, such as {_listed(counted)}",
            )
        link = onwards[0].child if onwards else max(children, key=lambda joint: depth[joint.child]).child
    return link


def _count(chain: list[UrdfJoint]) -> str:
    count = sum(joint.type != "fixed" for joint in chain)
    return f"{count} joint{'s' * (count != 1)}"


def _listed(names: list[str]) -> str:
    """Return names as text, the first of them where they are many."""
    more = f" and {len(names) - MOST_TOLD} more" if len(names) > MOST_TOLD else ""
    return ", ".join(names[:MOST_TOLD]) + more


def _folded(chain: list[UrdfJoint], where: str) -> tuple[Array, list[AxisJoint], tuple[Array, Array]]:
    """Fold fixed joints: what stands before the first moving joint, the moving joints, and flange and tool behind."""
    at = np.eye(4)
    base = np.eye(4)
    moving: list[AxisJoint] = []
    fixed: list[Array] = []
    for joint in chain:
        if joint.type == "fixed":
            fixed.append(joint.T_parent_joint)
            continue
        for T in fixed:
            at = at @ T
        fixed = []
        if not moving:
            base, at = at, np.eye(4)
        moving.append(_axis_joint(joint, at @ joint.T_parent_joint, where))
        at = np.eye(4)
    if not moving:
        raise BadFile(f"{where}: nothing in it moves", consequence="It is not an arm")
    flange = fixed[0] if fixed else np.eye(4)
    tool = np.eye(4)
    for T in fixed[1:]:
        tool = tool @ T
    return base, moving, (flange, tool)


def _loaded(moving: list[AxisJoint], chain: list[UrdfJoint], tree: _Tree, mass: Mapping[str, Mass]) -> list[AxisJoint]:
    """Return the moving joints with the masses of all that hangs on each of them before the next."""
    own = {joint.child for joint in chain if joint.type != "fixed"}

    def hanging(link: str, T: Array) -> list[tuple[Array, Mass]]:
        found = [(T, mass[link])] if link in mass else []
        for joint in tree.below.get(link, ()):
            if joint.child not in own:
                found += hanging(joint.child, T @ joint.T_parent_joint)
        return found

    links = [joint.child for joint in chain if joint.type != "fixed"]
    loads = [together(hanging(link, np.eye(4))) for link in links]
    return [replace(joint, mass_kg=load.kg, com_m=load.com_m) for joint, load in zip(moving, loads, strict=True)]


def _axis_joint(joint: UrdfJoint, T: Array, where: str) -> AxisJoint:
    """Return a moving joint with its axis and limits."""
    at = f"{where}: joint {joint.name}"
    axis = joint.element.find("axis")
    direction = numbers(axis.get("xyz") if axis is not None else None, "1 0 0", 3, f"{at}: axis")
    limit = joint.element.find("limit")
    lower, upper = -math.inf, math.inf
    if joint.type != "continuous":
        if limit is None:
            raise BadFile(f"{at}: has no <limit>", cure="Give lower and upper, or make it continuous")
        lower = float(numbers(limit.get("lower"), "0", 1, f"{at}: lower limit")[0])
        upper = float(numbers(limit.get("upper"), "0", 1, f"{at}: upper limit")[0])
    values = [
        float(numbers(limit.get(key) if limit is not None else None, "0", 1, f"{at}: {key}")[0])
        for key in ("velocity", "effort")
    ]
    speed, effort = (value if 0.0 < value < NO_LIMIT else None for value in values)
    return AxisJoint(
        name=joint.name,
        type=MOVING[joint.type],
        T_parent_joint=T,
        axis=direction,
        lower=lower if lower > -NO_LIMIT else -math.inf,
        upper=upper if upper < NO_LIMIT else math.inf,
        max_speed=speed,
        stall_effort=effort,
    )


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

    Poses are the same to rounding, also after reading it back. Raises Inconsistent for a joint with a scale, for joints
    that give way and for coupled readings.
    """
    if arm.compliant:
        raise Inconsistent(
            f"the joints {', '.join(joint.name for joint in arm.joints if joint.compliance)} give way under the weight",
            consequence="URDF has no place for it",
            cure="Keep this arm as arm.yaml",
        )
    if arm.couplings:
        raise Inconsistent(
            f"the readings of {', '.join(c.joint for c in arm.couplings)} are coupled to other joints'",
            consequence="URDF has no place for it",
            cure="Keep this arm as arm.yaml",
        )
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
        limit = {"effort": repr(joint.stall_effort or 0.0), "velocity": repr(joint.max_speed or 0.0)}
        if kind != "continuous":
            limit["lower"], limit["upper"] = (
                repr(float(np.clip(end, -NO_LIMIT, NO_LIMIT))) for end in (joint.lower, joint.upper)
            )
        ElementTree.SubElement(element, "limit", limit)
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
