"""How what an action is given becomes what it takes: an object as it is, arrays checked, a file read.

Each takes (name, value, given, undo), see `armsight.ops.action.Input`.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from os import PathLike, fspath
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import RigidTransform

from armsight._files import arm_source
from armsight.arrays import Array
from armsight.calibrate.arm import ArmPoints
from armsight.calibrate.identify import Sweeps
from armsight.clock import SystemClock
from armsight.control.guard import Limits
from armsight.drivers import Robot, RobotState
from armsight.drivers.images import read_image
from armsight.errors import NotEnoughData, UsageError
from armsight.kinematics import Arm
from armsight.ops.action import Given
from armsight.ops.arrays import as_images, as_joint_numbers, as_poses, as_rotations
from armsight.ops.compare.run import GivenResult
from armsight.ops.given import Given as Folder
from armsight.ops.given import as_arm, as_text
from armsight.ops.requests.motion import RobotJob
from armsight.ops.robot.opening import ClockedRobot
from armsight.optics import Camera, Rig, ZoomLens
from armsight.records import (
    Frame,
    NoiseModel,
    PoseStatus,
    SpotTrack,
    Target,
    TargetPose,
    TaughtPath,
    checked_array,
    require_kind,
    require_texts,
)
from armsight.records.measured import covariances_of
from armsight.store import (
    World,
    read_camera,
    read_poses,
    read_rig,
    read_spot_track,
    read_target,
    read_world,
    read_zoom_camera,
)
from armsight.store.arm_points import read_arm_points, read_sweeps
from armsight.store.covariances import uncorrelated_note
from armsight.store.handeye_file import read_tip
from armsight.store.interpret import OURS
from armsight.store.limits_file import read_limits
from armsight.store.path_file import read_path
from armsight.store.targets import parse_board


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class GivenPoses:
    """T: poses (n,), m; where a file brings them covariances (n, 6, 6), m and rad, and times (n,), s; what to know."""

    T: RigidTransform
    covariances: Array | None = None
    t_s: Array | None = None
    remark: str = ""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class GivenPath:
    """A path, and what errors call it: its file, or "the path"."""

    taught: TaughtPath
    where: str


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


def camera(name: str, value: Any, given: Given, undo: ExitStack) -> Camera:
    """Return a camera, or that of a camera.yaml. Raises BadFile."""
    path = _path(value)
    if path is None:
        require_kind(name, value, Camera, cure="Give a record or a file")
        return value  # type: ignore[no-any-return]  # a Camera
    return read_camera(path)


def target(name: str, value: Any, given: Given, undo: ExitStack) -> Target:
    """Return a target, that of a target.yaml, or the board of a text such as checkerboard:9x6:0.025. Raises BadFile."""
    path = _path(value)
    if path is None:
        require_kind(name, value, Target, cure="Give a record or a file")
        return value  # type: ignore[no-any-return]  # a Target
    return parse_board(str(path)) if ":" in path.name and not path.exists() else read_target(path)


def world(name: str, value: Any, given: Given, undo: ExitStack) -> World:
    """Return where a rig stands: a World, that of a world.yaml, or of a pose in the base. Raises BadFile."""
    path = _path(value)
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


def points(name: str, value: Any, given: Given, undo: ExitStack) -> ArmPoints:
    """Return the measurements of a table of points, or of joint readings (m, n) with `xyz_m` and more beside them."""
    model = _arm_of(given)
    path = _path(value)
    if path is None:
        return _points(model, value, given.get("xyz_m"), given.get("rotation"), given.get("point", ()))
    if given.get("xyz_m") is not None:
        raise UsageError(f"xyz_m is given beside the table {path}, which has positions", cure="Give one of them")
    found = read_arm_points(path, (given.get("table") or OURS).of_arm(model))
    coupled = model.couplings and found.q.shape[1] == model.n
    return replace(found, q=found.q @ model.gearing.T) if coupled else found


def held_points(name: str, value: Any, given: Given, undo: ExitStack) -> ArmPoints:
    """Return further measurements: of a table of points, or of (q, xyz_m)."""
    if _path(value) is not None:
        return points(name, value, {**given, "xyz_m": None}, undo)
    require_kind(name, value, tuple, cure="Give (q, xyz_m)")
    if len(value) != 2:
        raise UsageError(f"{name} has {len(value)} entries", cure="Give (q, xyz_m)")
    return _points(_arm_of(given), *value)


def _points(
    model: Arm, q: ArrayLike, xyz_m: Any, rotation: ArrayLike | None = None, point: Sequence[str] = ()
) -> ArmPoints:
    positions, readings = checked_array("xyz_m", xyz_m, (None, 3)), checked_array("q", q, (None, model.n))
    names = require_texts("point", point)
    turned = None if rotation is None else as_rotations(rotation, "rotation", len(positions))
    return ArmPoints(q=readings @ model.gearing.T, xyz_m=positions, rotation=turned, point=tuple(names))


def _arm_of(given: Given) -> Arm:
    """Return the arm that an action was given, which stands before what is measured of it."""
    return next(one for one in given.values() if isinstance(one, Arm))


def sweeps(name: str, value: Any, given: Given, undo: ExitStack) -> Sweeps:
    """Return the sweeps of a table, or of which joint moves in each row, with `q`, `xyz_m` and more beside it."""
    path, rig = _path(value), given.get("rig")
    if path is not None:
        found = read_sweeps(path, given.get("table") or OURS)
        if rig is None and found.uv_px is not None and not found.xyz_m.any():
            raise UsageError(f"{path} has pixels only", cure="Give the rig that saw them (--rig)")
        return found
    rows: tuple[Any, ...] = tuple(given.get(one) for one in ("q", "xyz_m", "uv_px"))
    q, positions, uv_px = checked_array("q", rows[0], (None, None)), checked_array("xyz_m", rows[1], (None, 3)), rows[2]
    moving = as_joint_numbers(value, len(positions))
    if (rig is None) != (uv_px is None):
        raise UsageError(
            "of rig and uv_px only one is given",
            consequence="Pixels say nothing without their cameras",
            cure="Give both, or neither",
        )
    pixels = None if uv_px is None else checked_array("uv_px", uv_px, (len(positions), 2, 2))
    return Sweeps(joint=moving - 1, q=q, xyz_m=positions, uv_px=pixels)


def taught(name: str, value: Any, given: Given, undo: ExitStack) -> GivenPath:
    """Return a path, or that of a path.csv, in the frame that is said beside it. Raises UsageError, BadFile."""
    path = _path(value)
    if path is None:
        require_kind(name, value, TaughtPath, cure="Give a TaughtPath: read_path(file), or teach(...).taught")
        return GivenPath(taught=value, where="the path")
    return GivenPath(taught=read_path(path, parent=given.get("frame") or "world"), where=str(path))


def taught_paths(name: str, value: Any, given: Given, undo: ExitStack) -> list[GivenPath]:
    """Return one path or several, see taught."""
    return [taught(name, one, given, undo) for one in (value if isinstance(value, list | tuple) else [value])]


def tip(name: str, value: Any, given: Given, undo: ExitStack) -> Array:
    """Return a tool's tip (3,) in flange axes, m, of a result or a tip.yaml. Raises UsageError, BadFile."""
    path = _path(value)
    if path is None and not hasattr(value, "tip_m"):
        raise UsageError(
            f"{name} is of type {type(value).__name__}",
            consequence="It cannot be used",
            cure="Give a record or a file",
        )
    return np.asarray((value if path is None else read_tip(path)).tip_m)


def limits(name: str, value: Any, given: Given, undo: ExitStack) -> Limits:
    """Return limits, or those of a limits.yaml. Raises UsageError, BadFile."""
    path = _path(value)
    if path is None:
        require_kind(name, value, Limits, cure="Give a record or a file")
        return value  # type: ignore[no-any-return]  # Limits
    return read_limits(path)


ROBOT_MEMBERS = ("__enter__", "__exit__", *(name for name in vars(Robot) if not name.startswith("_")))
"""What a driver of one's own has to have."""


def robot(name: str, value: Any, given: Given, undo: ExitStack) -> RobotJob:
    """Return a robot that is named DRIVER:DEVICE, or a driver of one's own, with what its driver is told beside it."""
    settings, config = given.get("robot_settings"), given.get("rsi_config")
    config = None if config is None else undo.enter_context(Folder()).file("rsi_config", config)
    if isinstance(value, RobotJob):
        return value
    if isinstance(value, str):
        return RobotJob(robot=value, robot_settings=settings, rsi_config=config)
    device = value if isinstance(value, ClockedRobot) else ClockedRobot(robot=value, clock=SystemClock())
    return RobotJob(robot=device.called or _name_of(device.robot, settings, config), device=device)


def _name_of(robot: Any, *told: object) -> str:
    """Return DRIVER:DEVICE, or the name of a driver of one's own.

    told: settings for the driver, None where there are none. Raises UsageError where a driver of one's own is not
    complete, or told something: it was made with its settings.
    """
    if not hasattr(robot, "step_joints"):
        return as_text("robot", robot)
    lacking = [name for name in ROBOT_MEMBERS if not hasattr(robot, name)]
    if isinstance(robot, type):
        what = "is a class: it has to be called first"
    elif lacking:
        what = f"has no {', '.join(lacking)}"
    elif not isinstance(robot.state, RobotState):
        what = f"has the state {robot.state!r}, which is no RobotState"
    elif any(one is not None for one in told):
        raise UsageError(
            f"robot_settings and rsi_config are for robots that are named DRIVER:DEVICE, and {robot.name} is an object",
            consequence="They would not be used, and nothing is opened",
            cure="Make the object with its settings",
        )
    else:
        return str(robot.name)
    raise UsageError(
        f"the robot {getattr(robot, 'name', type(robot).__name__)!r} {what}",
        consequence="It cannot be driven",
        cure="Give an object with all that help(armsight.Robot) lists; its state is such as RobotState.READY",
    )


def readings(name: str, value: Any, given: Given, undo: ExitStack) -> str:
    """Return joint readings as text: a file's path, or the numbers, which are read with the arm that they are of."""
    if isinstance(value, str | PathLike):
        return fspath(value)
    return ",".join(map(repr, checked_array(name, value, (None,)).tolist()))


def file(name: str, value: Any, given: Given, undo: ExitStack) -> Path:
    """Return the path of a file with the value: its own where it is one, else one that goes with the action."""
    return undo.enter_context(Folder()).file(name, value)


def each_file(name: str, value: Any, given: Given, undo: ExitStack) -> list[Path]:
    """Return the paths of one file or of several, see file."""
    return [file(name, one, given, undo) for one in (value if isinstance(value, list | tuple) else [value])]


def result(name: str, value: Any, given: Given, undo: ExitStack) -> GivenResult:
    """Return a result's file or folder, and what it is called: its path, or the parameter."""
    path = _path(value)
    if path is None:
        return GivenResult(undo.enter_context(Folder()).file(name, value), name)
    return GivenResult(path, str(path))


def picture(name: str, value: Any, given: Given, undo: ExitStack) -> NDArray[np.uint8]:
    """Return an image, or that of a file. Raises BadImage."""
    return read_image(undo.enter_context(Folder()).picture(name, value))


def frames(name: str, value: Any, given: Given, undo: ExitStack) -> str:
    """Return frames as the command line names them; images of a program are written to a folder that goes again."""
    return undo.enter_context(Folder(limit=given.get("limit", given.get("frames")))).source(name, value)


def images(name: str, value: Any, given: Given, undo: ExitStack) -> str | list[Frame]:
    """Return images as the command line names them, or those of a program as frames. Raises UsageError, BadImage."""
    if isinstance(value, str | PathLike):
        return fspath(value)
    return as_images(value, name.replace("_", " ").removesuffix("s"), given.get("bits"))


def noise(name: str, value: Any, given: Given, undo: ExitStack) -> NoiseModel | str:
    """Return a camera's noise, or the still frames or the file that tell it."""
    return value if isinstance(value, NoiseModel) else frames(name, value, given, undo)


def zoom_lens(name: str, value: Any, given: Given, undo: ExitStack) -> ZoomLens:
    """Return a lens's settings, or those of a camera.yaml. Raises BadFile."""
    path = _path(value)
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


def table(name: str, value: Any, given: Given, undo: ExitStack) -> Path:
    """Return the file of a table; of columns, or of (t_s, T), one that goes again. Raises UsageError, Inconsistent."""
    return undo.enter_context(Folder()).file(name, value)


def _path(value: Any) -> Path | None:
    return Path(fspath(value)) if isinstance(value, str | PathLike) else None
