"""What is only written for other programs: poses as TF takes them, and as easy_handeye does."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.sax.saxutils import quoteattr

from scipy.spatial.transform import RigidTransform

from armsight.columns import QUATERNION
from armsight.errors import UsageError
from armsight.geometry import xyz_quat
from armsight.store.atomic import write_text
from armsight.store.tables import number
from armsight.store.yamls import dump_yaml

FRAME_NAME = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_./-]*")
"""Names that TF takes; a space in one would be a further argument of the publisher."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Transform:
    """The pose of the frame child in the frame parent."""

    parent: str
    child: str
    T_parent_child: RigidTransform


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameNames:
    """What frames are called in a robot's TF tree."""

    base: str = "base_link"
    flange: str = "tool0"
    camera: str = "camera_optical_frame"
    target: str = "calibration_target"

    def __post_init__(self) -> None:
        names = (self.base, self.flange, self.camera, self.target)
        bad = [name for name in names if FRAME_NAME.fullmatch(name) is None]
        if bad or len(set(names)) < len(names):
            what = f"{bad[0][:40]!r} is no name of a frame" if bad else "two frames have one name"
            raise UsageError(
                f"{what}: base {self.base[:40]!r}, flange {self.flange[:40]!r}, camera {self.camera[:40]!r}, "
                f"target {self.target[:40]!r}",
                consequence="TF would take another tree, or none; nothing is written",
                cure="Give each frame a name of its own, of letters, digits, '_', '-', '.' and '/'",
            )


def write_tf_launch(path: Path, transforms: Sequence[Transform]) -> None:
    """Write a launch file of ROS 2 (XML) with a static_transform_publisher for each pose."""
    lines = ["<launch>"]
    for one in transforms:
        values = _values(one.T_parent_child)
        args = " ".join(f"--{name} {number(value)}" for name, value in values.items())
        args += f" --frame-id {one.parent} --child-frame-id {one.child}"
        name = f"{one.parent}_to_{one.child}".replace("/", "_")
        lines.append(
            f'  <node pkg="tf2_ros" exec="static_transform_publisher" name={quoteattr(name)} args={quoteattr(args)}/>'
        )
    write_text(path, "\n".join([*lines, "</launch>"]) + "\n")


def write_easy_handeye(path: Path, T_parent_camera: RigidTransform, names: FrameNames, *, in_hand: bool) -> None:
    """Write the file that easy_handeye (ROS 1) keeps under ~/.ros/easy_handeye and publishes.

    in_hand: T_parent_camera is T_flange_camera, else T_base_camera.
    """
    values = _values(T_parent_camera)
    parameters = {"eye_on_hand": in_hand, **_frames(names), "freehand_robot_movement": True}
    write_text(path, dump_yaml({"parameters": parameters, "transformation": values}))


def write_easy_handeye2(path: Path, T_parent_camera: RigidTransform, names: FrameNames, *, in_hand: bool) -> None:
    """Write the file that easy_handeye2 (ROS 2) keeps under ~/.ros2/easy_handeye2; see write_easy_handeye."""
    xyz, quat = xyz_quat(T_parent_camera)
    transform = {
        "translation": dict(zip("xyz", xyz.tolist(), strict=True)),
        "rotation": dict(zip("xyzw", quat.tolist(), strict=True)),
    }
    kind = "eye_in_hand" if in_hand else "eye_on_base"
    parameters = {"name": path.stem, "calibration_type": kind, **_frames(names), "freehand_robot_movement": True}
    write_text(path, dump_yaml({"parameters": parameters, "transform": transform}))


def _values(T: RigidTransform) -> dict[str, float]:
    xyz, quat = xyz_quat(T)
    return dict(zip(("x", "y", "z", *QUATERNION), [*xyz.tolist(), *quat.tolist()], strict=True))


def _frames(names: FrameNames) -> dict[str, Any]:
    return {
        "robot_base_frame": names.base,
        "robot_effector_frame": names.flange,
        "tracking_base_frame": names.camera,
        "tracking_marker_frame": names.target,
    }
