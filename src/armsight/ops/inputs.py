"""How what an action is given becomes what it takes: an object as it is, arrays checked, a file read.

Each takes (name, value, given, undo), see `armsight.ops.action.Input`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial
from os import PathLike, fspath
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from armsight._files import arm_source
from armsight.arrays import Array
from armsight.drivers.images import read_image
from armsight.errors import NotEnoughData, UsageError
from armsight.kinematics import Arm
from armsight.ops.action import Given
from armsight.ops.arrays import as_images, as_poses
from armsight.ops.given import Given as Folder
from armsight.ops.given import as_arm, as_text, path_of, record_of
from armsight.optics import Camera, Rig, ZoomLens
from armsight.records import (
    Frame,
    NoiseModel,
    PoseStatus,
    SpotTrack,
    Target,
    TargetPose,
    checked_array,
    require_kind,
)
from armsight.records.measured import covariances_of
from armsight.store import (
    CameraFile,
    World,
    read_camera,
    read_camera_file,
    read_poses,
    read_rig,
    read_spot_track,
    read_target,
    read_world,
    read_zoom_camera,
)
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
    path = path_of(value)
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
    """Return a pair of cameras, or that of a rig.yaml. Raises BadFile; UsageError for another rig."""
    return record_of(name, value, Rig, read_rig).require_pair(name)


def any_rig(name: str, value: Any, given: Given, undo: ExitStack) -> Rig:
    """Return a rig of any cameras, or that of a rig.yaml. Raises BadFile."""
    return record_of(name, value, Rig, partial(read_rig, any_cameras=True))


def camera(name: str, value: Any, given: Given, undo: ExitStack) -> Camera:
    """Return a camera, or that of a camera.yaml. Raises BadFile."""
    return record_of(name, value, Camera, read_camera)


def target(name: str, value: Any, given: Given, undo: ExitStack) -> Target:
    """Return a target, that of a target.yaml, or the board of a text such as checkerboard:9x6:0.025. Raises BadFile."""
    return record_of(name, value, Target, _lights)


def _lights(path: Path) -> Target:
    return parse_board(str(path)) if ":" in path.name and not path.exists() else read_target(path)


def world(name: str, value: Any, given: Given, undo: ExitStack) -> World:
    """Return where a rig stands: a World, that of a world.yaml, or of a pose in the base. Raises BadFile."""
    path = path_of(value)
    if path is not None:
        return read_world(path)
    return value if isinstance(value, World) else World(parent="base", T_parent_rig=as_poses(value, name)[0])


def arm(name: str, value: Any, given: Given, undo: ExitStack) -> Arm:
    """Return an arm, that of a file, or the one known by that name. Raises UsageError, BadFile."""
    return as_arm(name, value)


def chain(name: str, value: Any, given: Given, undo: ExitStack) -> Arm:
    """Return an arm, see arm; of a file the chain between the links that are said beside it. Raises UsageError."""
    links = {which: given.get(which) for which in ("tip", "base")}
    whole = isinstance(value, Arm) or set(links.values()) == {None}
    return as_arm(name, value if whole else arm_source(as_text(name, value, Arm), **links))


def readings(name: str, value: Any, given: Given, undo: ExitStack) -> str | None:
    """Return joint readings as text: a file's path, or the numbers, which are read with the arm that they are of.

    None as it is: the action says when it needs them.
    """
    if value is None:
        return None
    if isinstance(value, str | PathLike):
        return fspath(value)
    return ",".join(map(repr, checked_array(name, value, (None,)).tolist()))


def file(name: str, value: Any, given: Given, undo: ExitStack) -> Path | None:
    """Return the path of a file with the value: its own where it is one, else one that goes with the action.

    None as it is: the action says when it needs a file.
    """
    if value is None:
        return None
    return undo.enter_context(Folder()).file(name, value)


def each_file(name: str, value: Any, given: Given, undo: ExitStack) -> list[Path]:
    """Return the paths of one file or of several, see file."""
    folder = undo.enter_context(Folder())
    return [folder.file(name, one) for one in (value if isinstance(value, list | tuple) else [value])]


def picture(name: str, value: Any, given: Given, undo: ExitStack) -> NDArray[np.uint8]:
    """Return an image, or that of a file. Raises BadImage."""
    return read_image(undo.enter_context(Folder()).picture(name, value))


def frames(name: str, value: Any, given: Given, undo: ExitStack) -> str:
    """Return frames as the command line names them; images of a program are written to a folder that goes again."""
    return undo.enter_context(Folder(limit=given.get("limit", given.get("frames")))).source(name, value)


def cameras(name: str, value: Any, given: Given, undo: ExitStack) -> dict[str, str]:
    """Return frames by camera, each as the command line names them. Raises UsageError."""
    require_kind(name, value, Mapping, cure="Give {'left': ..., 'top': ...}, frames by the camera's name in the rig")
    return {camera: frames(camera, each, given, undo) for camera, each in value.items()}


def images(name: str, value: Any, given: Given, undo: ExitStack) -> str | list[Frame]:
    """Return images as the command line names them, or those of a program as frames. Raises UsageError, BadImage."""
    if isinstance(value, str | PathLike):
        return fspath(value)
    return as_images(value, name.replace("_", " ").removesuffix("s"), given.get("bits"))


def named_images(name: str, value: Any, given: Given, undo: ExitStack) -> dict[str, str | list[Frame]]:
    """Return images by the cameras' names, of NAME=SRC texts or of a mapping. Raises UsageError, BadImage."""
    return {camera: images(f"{camera} images", one, given, undo) for camera, one in by_name(name, value).items()}


def named_lenses(name: str, value: Any, given: Given, undo: ExitStack) -> dict[str, CameraFile | str]:
    """Return what camera.yaml files say by the cameras' names, of NAME=FILE texts or of a mapping; the kind of all
    others by '', of a text without a name. Raises BadFile, UsageError."""
    found: dict[str, CameraFile | str] = {}
    texts = [value] if isinstance(value, str) else value
    require_kind(name, texts, Mapping, list, tuple, cure="Give {'top': 'top.yaml'}, lenses by the camera's name")
    kinds = [] if isinstance(texts, Mapping) else [one for one in texts if "=" not in str(one)]
    if kinds:
        found[""] = kinds[-1]
        texts = [one for one in texts if one not in kinds]
    for camera, one in by_name(name, texts).items():
        path = path_of(one)
        if path is not None:
            found[camera] = read_camera_file(path)
            continue
        lens: Any = getattr(one, "camera", one)  # of what calibrate_camera returns
        require_kind(f"the lens of {camera}", lens, Camera, cure="Give its camera.yaml, a Camera or a CameraResult")
        found[camera] = CameraFile(camera=lens, covariance=getattr(one, "covariance", None))
    return found


def by_name(name: str, value: Any) -> dict[str, object]:
    """Return a mapping as it is, and NAME=VALUE texts as one. Raises UsageError for a name given twice."""
    require_kind(name, value, Mapping, list, tuple, cure="Give {'left': ..., 'top': ...}, each by the camera's name")
    if isinstance(value, Mapping):
        return dict(value)
    found: dict[str, object] = {}
    for text in value:
        camera, given, rest = str(text).partition("=")
        if not given or not rest:
            raise UsageError(
                f"{text!r} does not say which camera it is of", cure="Write NAME=SRC, such as left=images/left"
            )
        if camera in found:
            raise UsageError(
                f"the camera {camera} is given twice",
                consequence="It is open which is meant",
                cure="Give every camera a name of its own",
            )
        found[camera] = rest
    return found


def named_files(text: str) -> Sequence[Path]:
    """Return the files behind NAME=SRC, whose hashes go into the result."""
    from armsight.ops.calibration.camera_noise import input_files

    return input_files(text.partition("=")[2])


def noise(name: str, value: Any, given: Given, undo: ExitStack) -> NoiseModel | str:
    """Return a camera's noise, or the still frames or the file that tell it."""
    return value if isinstance(value, NoiseModel) else frames(name, value, given, undo)


def zoom_lens(name: str, value: Any, given: Given, undo: ExitStack) -> ZoomLens:
    """Return a lens's settings, or those of a camera.yaml. Raises BadFile."""
    path = path_of(value)
    if path is None:
        require_kind(name, value, ZoomLens, cure="Give the file with the lens's settings")
        return value  # type: ignore[no-any-return]  # a ZoomLens
    return read_zoom_camera(path).lens


def board(name: str, value: Any, given: Given, undo: ExitStack) -> Target:
    """Return a printed board, that of a file, or of a text as checkerboard:9x6:0.025. Raises UsageError, BadFile."""
    require_kind(name, value, str, PathLike, Target, cure="Give 'checkerboard:9x6:0.025', a Target or a file")
    found = value if isinstance(value, Target) else parse_board(fspath(value))
    if not found.is_board:
        raise UsageError(
            "the board is a target of lights", consequence="It is in no image", cure="Give a printed board"
        )
    return found


def spots(name: str, value: Any, given: Given, undo: ExitStack) -> SpotTrack:
    """Return the spots of one camera of a table, or of columns t_s, u_px, v_px. Raises BadFile."""
    return read_spot_track(undo.enter_context(Folder()).file(name, value))


def named_spots(name: str, value: Any, given: Given, undo: ExitStack) -> dict[str, SpotTrack]:
    """Return spots by the cameras' names, of NAME=CSV texts or of a mapping. Raises UsageError, BadFile."""
    return {camera: spots(f"{camera} spots", one, given, undo) for camera, one in by_name(name, value).items()}


def table(name: str, value: Any, given: Given, undo: ExitStack) -> Path:
    """Return the file of a table; of columns, or of (t_s, T), one that goes again. Raises UsageError, Inconsistent."""
    return undo.enter_context(Folder()).file(name, value)
