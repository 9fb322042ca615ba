"""Files by path: what is in them as records, and records into them."""

from __future__ import annotations

from os import PathLike
from types import NoneType
from typing import TYPE_CHECKING

import numpy as np

from armsight import store
from armsight.api.arrays import Array, as_path
from armsight.api.tracks import PoseTrack
from armsight.errors import UsageError
from armsight.records import require_kind
from armsight.store import arm_file, path_file
from armsight.store.urdf import read_urdf

if TYPE_CHECKING:
    from armsight.kinematics import Arm
    from armsight.optics import Camera, Rig
    from armsight.records import Target, TaughtPath
    from armsight.store.recording import Recording

PathText = str | PathLike[str]

FRAMES = ("world", "base")
"""Frames that a path.csv may be said to be in."""


def read_rig(path: PathText) -> Rig:
    """Return the rig in a rig.yaml. Raises BadFile, naming the key."""
    return store.read_rig(as_path(path))


def read_camera(path: PathText) -> Camera:
    """Return the camera in a camera.yaml. Raises BadFile, naming the key."""
    return store.read_camera(as_path(path))


def read_target(path: PathText) -> Target:
    """Return the target in a target.yaml. Raises BadFile, naming the key."""
    return store.read_target(as_path(path))


def read_arm(path: PathText, *, tip: str | None = None, base: str | None = None) -> Arm:
    """Return the arm in an arm.yaml or a URDF. Raises BadFile, naming the key or the element.

    tip, base: of a URDF, the last and the first link of the arm's chain, where the file holds more than one chain.
    """
    file = as_path(path)
    for name, link in (("tip", tip), ("base", base)):
        require_kind(name, link, str, NoneType)
    if file.suffix.lower() == ".urdf":
        return read_urdf(file, tip=tip, base=base)
    if tip is not None or base is not None:
        raise UsageError(f"a tip or a base was named, but {file} is no URDF", cure="Leave them away")
    return arm_file.read_arm(file)


def read_poses(path: PathText) -> PoseTrack:
    """Return the poses in a poses.csv. Raises BadFile, naming line and column."""
    return PoseTrack(poses=store.read_poses(as_path(path)))


def read_path(path: PathText, *, frame: str = "world") -> TaughtPath:
    """Return the path in a path.csv, its poses in frame world or base. Raises BadFile, naming line and column."""
    if frame not in FRAMES:
        raise UsageError(
            f"there is no frame {frame!r}", consequence="No path is read", cure=f"Use {' or '.join(FRAMES)}"
        )
    return path_file.read_path(as_path(path), parent=frame)


def read_joints(path: PathText) -> tuple[Array, Array]:
    """Return times (n,) in s and joint values (n, m) in rad and m of a joints.csv. Raises BadFile."""
    motion = store.read_joints(as_path(path))
    return np.asarray(motion.t_s), np.asarray(motion.q)


def open_recording(path: PathText) -> Recording:
    """Return a recording (.mcap) open for reading: use it as a context manager. Raises BadFile.

    `cameras` names its cameras, `frames(camera)` yields frames with image and t_s, `poses()` and `joints()` the rest.
    """
    from armsight.store.recording import Recording

    return Recording(as_path(path))
