"""An arm's kinematics as URDF: links world, base, link1 .., flange, tool."""

from __future__ import annotations

import math
import re
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from armsight.arrays import Array
from armsight.errors import Inconsistent
from armsight.kinematics import Arm, JointType
from armsight.kinematics.axes import axes_of
from armsight.store.atomic import disk_errors, write_text
from armsight.store.urdf import MAX_BYTES
from armsight.store.urdf_limits import NO_LIMIT

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

    Poses are the same to rounding, also after reading it back. Raises Inconsistent for a joint with a scale, for joints
    that give way and for coupled readings.
    """
    if arm.compliant:
        raise Inconsistent(
            f"the joints {', '.join(joint.name for joint in arm.joints if joint.compliance)} give way under the weight",
            consequence="URDF has no place for it",
            cure="Write the nearest rigid arm: armsight convert arm FILE -o arm.urdf",
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
        # a simulator takes 0 for a joint that cannot move: what is not known is no limit
        limit = {"effort": repr(joint.stall_effort or NO_LIMIT), "velocity": repr(joint.max_speed or NO_LIMIT)}
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
