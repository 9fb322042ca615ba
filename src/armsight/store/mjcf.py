"""MJCF of a serial arm, MuJoCo's own format: bodies, joints, weights; sites at flange, tool and measured points.

Poses of the site `tool` are those of the arm to rounding, and what its weight does to the joints too.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
from scipy.spatial.transform import Rotation

from armsight.arrays import Array
from armsight.kinematics import Arm, JointType, link_frames
from armsight.kinematics.arm import GRAVITY_M_S2
from armsight.kinematics.axes import axes_of
from armsight.kinematics.rigid import followers, require_rigid
from armsight.store.atomic import write_text

LEAST_KG, LEAST_KG_M2 = "1e-6", "1e-9"
"""MuJoCo takes no moving body without mass and inertia: what is not known is so small."""


def write_mjcf(path: Path, arm: Arm) -> None:
    """Write the arm as MJCF; see mjcf_text."""
    write_text(path, mjcf_text(arm))


def mjcf_lacks(arm: Arm) -> Iterator[str]:
    """Yield what a simulator would need that the arm's model does not hold, or MJCF."""
    yield "no inertias are known, so that it stands and hangs as the arm does, but does not move as it does"
    if any(joint.max_speed for joint in arm.joints):
        yield "MJCF has no place for the joints' largest speeds"


def mjcf_text(arm: Arm) -> str:
    """Return the arm as MJCF: lengths in m, angles in rad, MuJoCo's joint values are the controller's readings.

    A joint without a drive follows by an equality. Raises Inconsistent for an arm that is not rigid (as_rigid), and for
    a joint that follows several.
    """
    require_rigid(arm, "MJCF")
    base, joints, flange, tool = axes_of(arm)
    behind = link_frames(arm, np.zeros(arm.n))[1:-1]
    root = ElementTree.Element("mujoco", model=arm.name)
    limits = {"angle": "radian", "autolimits": "true", "boundmass": LEAST_KG, "boundinertia": LEAST_KG_M2}
    ElementTree.SubElement(root, "compiler", limits)
    ElementTree.SubElement(root, "option", gravity=_row(GRAVITY_M_S2 * arm.down))
    body = _body(ElementTree.SubElement(root, "worldbody"), "base", base)
    here = base
    for axis, joint, T_world_link in zip(joints, arm.joints, behind, strict=True):
        here = here @ axis.T_parent_joint
        body = _body(body, f"link_{joint.name}", axis.T_parent_joint)
        kind = "hinge" if joint.type is JointType.REVOLUTE else "slide"
        element = ElementTree.SubElement(body, "joint", name=joint.name, type=kind, axis=_row(axis.axis))
        if np.isfinite([joint.lower, joint.upper]).all():
            element.set("range", _row(np.array([joint.lower, joint.upper])))
        if joint.stall_effort is not None:
            element.set("actuatorfrcrange", _row(joint.stall_effort * np.array([-1.0, 1.0])))
        com_m = (np.linalg.solve(here, T_world_link) @ [*joint.com_m, 1.0])[:3]
        ElementTree.SubElement(body, "inertial", pos=_row(com_m), mass=repr(float(joint.mass_kg)))
    _placed(ElementTree.SubElement(body, "site", name="flange"), flange)
    _placed(ElementTree.SubElement(body, "site", name="tool"), flange @ tool)
    for point in arm.tool_points:
        at = flange @ [*point.xyz_m, 1.0]
        ElementTree.SubElement(body, "site", name=f"point_{point.name}", pos=_row(at[:3]))
    equality = ElementTree.SubElement(root, "equality")
    for name, one in followers(arm, "MJCF").items():
        share = _row(np.array([0.0, one.share, 0.0, 0.0, 0.0]))
        ElementTree.SubElement(equality, "joint", joint1=name, joint2=one.by, polycoef=share)
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode") + "\n"


def _body(parent: ElementTree.Element, name: str, T: Array) -> ElementTree.Element:
    return _placed(ElementTree.SubElement(parent, "body", name=name), T)


def _placed(element: ElementTree.Element, T: Array) -> ElementTree.Element:
    element.set("pos", _row(T[:3, 3]))
    element.set("quat", _row(np.asarray(Rotation.from_matrix(T[:3, :3]).as_quat(scalar_first=True))))
    return element


def _row(values: Array) -> str:
    return " ".join(repr(float(value)) for value in values)
