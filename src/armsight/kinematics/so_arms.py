"""The SO-100 and the SO-101, home-made arms of five joints and a gripper, from their makers' URDFs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from math import pi

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.arrays import Array
from armsight.kinematics.arm import Arm
from armsight.kinematics.axes import AxisJoint, arm_from_axes
from armsight.kinematics.joints import JointType

NAMES = ("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll")

Row = tuple[tuple[float, float, float], tuple[float, float, float], tuple[int, int, int], tuple[float, float]]
"""Of a joint: its place in the link before, x y z in m and roll pitch yaw in rad; its axis; its range in rad."""

SO101: tuple[Row, ...] = (
    ((0.0388353, 0.0, 0.0624), (pi, 0.0, -pi), (0, 0, 1), (-1.91986, 1.91986)),
    ((-0.0303992, -0.0182778, -0.0542), (-pi / 2, -pi / 2, 0.0), (0, 0, 1), (-1.74533, 1.74533)),
    ((-0.11257, -0.028, 0.0), (0.0, 0.0, pi / 2), (0, 0, 1), (-1.69, 1.69)),
    ((-0.1349, 0.0052, 0.0), (0.0, 0.0, -pi / 2), (0, 0, 1), (-1.65806, 1.65806)),
    ((0.0, -0.0611, 0.0181), (pi / 2, 0.0486795, pi), (0, 0, 1), (-2.74385, 2.84121)),
)
SO101_TOOL = ((-0.0079, -0.000218121, -0.0981274), (0.0, pi, 0.0))

SO100: tuple[Row, ...] = (
    ((0.0, -0.0452, 0.0165), (pi / 2, 0.0, 0.0), (0, 1, 0), (-2.0, 2.0)),
    ((0.0, 0.1025, 0.0306), (-1.8, 0.0, 0.0), (1, 0, 0), (0.0, 3.5)),
    ((0.0, 0.11257, 0.028), (pi / 2, 0.0, 0.0), (1, 0, 0), (-pi, 0.0)),
    ((0.0, 0.0052, 0.1349), (-1.0, 0.0, 0.0), (1, 0, 0), (-2.5, 1.2)),
    ((0.0, -0.0601, 0.0), (0.0, pi / 2, 0.0), (0, 1, 0), (-pi, pi)),
)

MAKERS = "TheRobotStudio, SO-ARM100 (Apache-2.0)"


def so101() -> Arm:
    """Return the SO-101 with its tool between the jaws; zero of every joint is the middle of its range."""
    source = (
        f"{MAKERS}, Simulation/SO101/so101_new_calib.urdf, right angles as such: zero is the middle of each joint's "
        "range, the tool link is gripper_frame_link between the jaws; the ranges are its makers' approximations, no "
        "speeds are known. LeRobot's degrees have their zero in the middle of what was swept by hand: find it with "
        "armsight calibrate arm"
    )
    return _arm("so101", SO101, _place(*SO101_TOOL), ("base_link", "gripper_frame_link"), source)


def so100() -> Arm:
    """Return the SO-100 with its fixed jaw's frame as tool, on the axis of the wrist's roll."""
    source = (
        f"{MAKERS}, Simulation/SO100/so100.urdf, right angles as such: zero of lift and elbow is the end of their "
        "range, where the arm is folded; the tool link is gripper, the fixed jaw's frame on the last joint's axis; no "
        "speeds are known. LeRobot's degrees have another zero: find it with armsight calibrate arm"
    )
    return _arm("so100", SO100, np.eye(4), ("base", "gripper"), source)


def _arm(name: str, rows: Sequence[Row], T_last_tool: Array, links: tuple[str, str], source: str) -> Arm:
    joints = [
        AxisJoint(
            name=called,
            type=JointType.REVOLUTE,
            T_parent_joint=_place(xyz, rpy),
            axis=np.array(axis, dtype=float),
            lower=lower,
            upper=upper,
        )
        for called, (xyz, rpy, axis, (lower, upper)) in zip(NAMES, rows, strict=True)
    ]
    arm = arm_from_axes(name, np.eye(4), joints, T_last_tool, np.eye(4))
    return replace(arm, source=source, base_link=links[0], tool_link=links[1])


def _place(xyz: tuple[float, float, float], rpy: tuple[float, float, float]) -> Array:
    """Return (4, 4) of a URDF's origin: R = Rz(yaw) Ry(pitch) Rx(roll)."""
    return np.asarray(RigidTransform.from_components(np.array(xyz), Rotation.from_euler("xyz", rpy)).as_matrix())
