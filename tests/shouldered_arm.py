"""An arm whose first joint stands aside from its base link, turned; where its links are, by the URDF's own products."""

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

BASE = ((0.4, -0.7, 0.9), (0.2, -0.5, 1.9))
"""Of base_link in the root link `world`, metres and roll, pitch, yaw."""

JOINTS = (
    ((0.15, 0.1, 0.3), (0.3, -0.2, 0.7), (0, 0, 1)),
    ((0.1, 0.0, 0.1), (-np.pi / 2, 0, 0), (0, 0, 1)),
    ((0.4, 0.0, 0.0), (0, 0, 0), (0, 0, -1)),
    ((0.05, 0.35, 0.0), (-np.pi / 2, 0, 0), (0, 0, 1)),
    ((0.0, 0.0, 0.0), (np.pi / 2, 0, 0), (0, 0, 1)),
    ((0.0, 0.0, 0.0), (-np.pi / 2, 0, 0), (0, 0, 1)),
)
"""xyz, rpy and axis of each turning joint."""

FLANGE = ((0.0, 0.0, 0.08), (0.1, 0.2, 0.3))
TOOL = ((0.02, 0.03, 0.1), (0.0, -np.pi / 2, 0.4))
"""Of the flange in the last joint's link, and of tool0 on the flange."""

EE = ((0.0, 0.0, 0.1), (0.0, 2.0, 0.0))
"""Of ee_link, beside the flange."""


def placed(xyz: tuple[float, ...], rpy: tuple[float, ...]) -> RigidTransform:
    """Return the pose of a URDF's origin."""
    return RigidTransform.from_components(xyz, Rotation.from_euler("xyz", rpy))


def origin(xyz: tuple[float, ...], rpy: tuple[float, ...]) -> str:
    return f'<origin xyz="{" ".join(map(repr, xyz))}" rpy="{" ".join(map(repr, rpy))}"/>'


def shouldered_urdf(*, world: bool = True, ee: bool = True) -> str:
    """Return the arm as URDF; its base link hangs on a link world or is the root; with a second link for tools."""
    links = ["base_link", *(f"l{i}" for i in range(1, 7)), "flange", "tool0"]
    text = "".join(f'<link name="{name}"/>' for name in links + ["world"] * world + ["ee_link"] * ee)
    fixed = '<joint name="{0}" type="fixed"><parent link="{1}"/><child link="{2}"/>{3}</joint>'
    text += fixed.format("stand", "world", "base_link", origin(*BASE)) if world else ""
    for i, (xyz, rpy, axis) in enumerate(JOINTS):
        text += (
            f'<joint name="j{i + 1}" type="revolute"><parent link="{links[i]}"/><child link="{links[i + 1]}"/>'
            f'{origin(xyz, rpy)}<axis xyz="{" ".join(map(str, axis))}"/>'
            '<limit lower="-2.9" upper="2.9" velocity="2" effort="50"/></joint>'
        )
    text += fixed.format("e", "l6", "ee_link", origin(*EE)) if ee else ""
    text += fixed.format("f", "l6", "flange", origin(*FLANGE)) + fixed.format("t", "flange", "tool0", origin(*TOOL))
    return f'<robot name="shouldered">{text}</robot>'


def base_flange(q: np.ndarray) -> RigidTransform:
    """Return T_base_flange, base the URDF's base_link, at joint values q (6,)."""
    T = RigidTransform.identity()
    for value, (xyz, rpy, axis) in zip(q, JOINTS, strict=True):
        T = T * placed(xyz, rpy) * RigidTransform.from_rotation(Rotation.from_rotvec(value * np.array(axis)))
    return T * placed(*FLANGE)


def base_tool(q: np.ndarray) -> RigidTransform:
    """Return T_base_tool, the tool tool0."""
    return base_flange(q) * placed(*TOOL)


def drawn(n: int, seed: int = 0) -> np.ndarray:
    """Return joint values (n, 6) well within the limits."""
    return np.random.default_rng(seed).uniform(-1.2, 1.2, (n, 6)) + np.array([0.0, -0.5, 0.5, 0.0, 0.9, 0.0])
