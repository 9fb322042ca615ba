"""How what an action is given becomes what it takes: an object as it is, arrays checked, a file read.

Each takes (name, value, given, undo), see `armsight.ops.action.Input`.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from os import PathLike, fspath
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import RigidTransform

from armsight.arrays import Array
from armsight.errors import NotEnoughData
from armsight.ops.action import Given
from armsight.ops.arrays import as_poses
from armsight.ops.given import Given as Folder
from armsight.optics import Rig
from armsight.records import PoseStatus, SpotTrack, Target, TargetPose, require_kind
from armsight.records.measured import covariances_of
from armsight.store import read_poses, read_rig, read_spot_track, read_target
from armsight.store.covariances import uncorrelated_note
from armsight.store.interpret import OURS
from armsight.store.targets import parse_board


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class GivenPoses:
    """T: poses (n,), m; where a file brings them covariances (n, 6, 6), m and rad, and times (n,), s; what to know."""

    T: RigidTransform
    covariances: Array | None = None
    t_s: Array | None = None
    remark: str = ""


def poses(name: str, value: Any, given: Given, undo: ExitStack) -> GivenPoses:
    """Return the complete poses of a table, or those of an array. Raises BadFile, NotEnoughData, Inconsistent."""
    path = _path(value)
    if path is None:
        return GivenPoses(T=as_poses(value, name))
    found = read_poses(path, parent="world", format_=given.get("table") or OURS, timed=False)
    used = [pose for pose in found if pose.status is PoseStatus.OK]
    if not used:
        raise NotEnoughData(
            f"{path}: no pose of status ok", consequence="Nothing is calibrated", cure="Record the target again"
        )
    covariances = covariances_of(used)
    return GivenPoses(
        T=RigidTransform.from_matrix(np.array([pose.T_parent_target for pose in used])),
        covariances=covariances,
        t_s=_times(found, used),
        remark=uncorrelated_note(path, covariances),
    )


def _times(found: Sequence[TargetPose], used: Sequence[TargetPose]) -> Array | None:
    """Return the times (n,) of the poses used; None where the file has none: all alike, or its rows only counted."""
    t_s = np.array([pose.t_s for pose in found])
    if not np.ptp(t_s) > 0.0 or (t_s == np.arange(len(t_s))).all():
        return None
    return np.array([pose.t_s for pose in used])


def rig(name: str, value: Any, given: Given, undo: ExitStack) -> Rig:
    """Return a rig, or that of a rig.yaml. Raises BadFile."""
    path = _path(value)
    if path is None:
        require_kind(name, value, Rig, cure="Give a record or a file")
        return value  # type: ignore[no-any-return]  # a Rig
    return read_rig(path)


def target(name: str, value: Any, given: Given, undo: ExitStack) -> Target:
    """Return a target, that of a target.yaml, or the board of a text such as checkerboard:9x6:0.025. Raises BadFile."""
    path = _path(value)
    if path is None:
        require_kind(name, value, Target, cure="Give a record or a file")
        return value  # type: ignore[no-any-return]  # a Target
    return parse_board(str(path)) if ":" in path.name and not path.exists() else read_target(path)


def frames(name: str, value: Any, given: Given, undo: ExitStack) -> str:
    """Return frames as the command line names them; images of a program are written to a folder that goes again."""
    return undo.enter_context(Folder()).source(name, value)


def spots(name: str, value: Any, given: Given, undo: ExitStack) -> SpotTrack:
    """Return the spots of one camera of a table, or of columns t_s, u_px, v_px. Raises BadFile."""
    return read_spot_track(undo.enter_context(Folder()).file(name, value))


def _path(value: Any) -> Path | None:
    return Path(fspath(value)) if isinstance(value, str | PathLike) else None
