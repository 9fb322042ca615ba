"""Files by path: what is in them as records, and records into them; the name's ending and the content decide."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from types import NoneType
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from armsight import store
from armsight.arrays import Array
from armsight.control.guard import Limits
from armsight.errors import UsageError
from armsight.kinematics import Arm
from armsight.measure.track import PoseTrack
from armsight.ops.arrays import as_path, as_size
from armsight.ops.checks import speaks_python
from armsight.ops.conversion import TUM_SUFFIXES, load_camera, load_rig
from armsight.ops.flags import UnitLength
from armsight.ops.given import PathText, as_table
from armsight.ops.recording.record import mend
from armsight.ops.tables import convert_table
from armsight.optics import Camera, Rig, at_zoom
from armsight.records import Motion, Target, TaughtPath, require_kind, require_number
from armsight.store import arm_file, limits_file, path_file, read_zoom_camera, read_zoom_rig, write_text
from armsight.store.foreign import Asked
from armsight.store.handeye_file import HandEyeFile, TipFile, read_handeye, read_tip
from armsight.store.interpret import OURS, TableFormat
from armsight.store.recording import Recording, Repaired, cut
from armsight.store.rigs import World
from armsight.store.saving import file_to_write
from armsight.store.tables import Columns, read_columns
from armsight.store.urdf import read_urdf

FRAMES = ("world", "base")
"""Frames that a path.csv may be said to be in."""


@speaks_python()
def read_rig(
    path: PathText | list[PathText] | tuple[PathText, ...],
    *,
    size: tuple[int, int] | None = None,
    unit_m: UnitLength = None,
    names: Sequence[str] = (),
    approximate: bool = False,
    zoom_left: float | None = None,
    zoom_right: float | None = None,
) -> Rig:
    """Return the rig in a rig.yaml, in a file of a kind of `armsight convert --list`, or in two of ROS or OpenCV.

    size (width, height) and unit_m (length of its unit): where the file leaves them open. names: the cameras of a file
    that holds more, the first one first. approximate: take the nearest lens, however far it is. zoom_left, zoom_right:
    of a rig with zoom lenses, where they stand. Warns of a lens that is read as the nearest one. Raises BadFile, naming
    the key.

    Examples
    --------
    >>> rig = armsight.simulate("hand-cell", frames=1).rig
    >>> print(f"{armsight.read_rig(rig.save(folder / 'rig.yaml')).baseline_m:.4f} m")
    0.1200 m
    """
    files = [as_path(one) for one in (path if isinstance(path, list | tuple) else [path])]
    require_kind("names", names, list, tuple, cure="Give a tuple of the cameras' names")
    if zoom_left is None and zoom_right is None:
        asked = Asked(size=as_size(size), unit_m=unit_m, names=tuple(names), approximate=approximate)
        rig = load_rig(files, asked)
        _warn(asked.told)
        return rig
    return at_zoom(read_zoom_rig(files[0]), (zoom_left, zoom_right)).rig


def _warn(told: list[str]) -> None:
    """Tell the caller of a function of this module what is to be said of its file."""
    for text in told:
        warnings.warn(text, stacklevel=4)  # past the function and what speaks_python wraps it in


@speaks_python()
def read_camera(
    path: PathText,
    *,
    size: tuple[int, int] | None = None,
    name: str | None = None,
    approximate: bool = False,
    zoom: float | None = None,
) -> Camera:
    """Return the camera in a camera.yaml, or in a file of a kind of `armsight convert --list`.

    size (width, height): where the file leaves it open. name: of a file that holds several. approximate: take the
    nearest lens, however far it is. zoom: of a zoom lens, where it stands. Raises BadFile, naming the key.

    Examples
    --------
    >>> camera = armsight.Camera.pinhole(640, 480, 500.0, 500.0, 320.0, 240.0)
    >>> armsight.read_camera(camera.save(folder / "camera.yaml")).width
    640
    """
    if zoom is None:
        asked = Asked(size=as_size(size), names=() if name is None else (name,), approximate=approximate)
        camera = load_camera(as_path(path), asked)
        _warn(asked.told)
        return camera
    require_number("zoom", zoom)
    return read_zoom_camera(as_path(path)).lens.at(zoom).camera


def read_target(path: PathText) -> Target:
    """Return the target in a target.yaml. Raises BadFile, naming the key.

    Examples
    --------
    >>> target = armsight.LightTarget({"A": (0, 0, 0), "B": (0.1, 0, 0), "C": (0, 0.07, 0)})
    >>> armsight.read_target(target.save(folder / "target.yaml")).names
    ('A', 'B', 'C')
    """
    return store.read_target(as_path(path))


@speaks_python()
def read_arm(path: PathText, *, tip: str | None = None, base: str | None = None) -> Arm:
    """Return the arm in an arm.yaml or a URDF. Raises BadFile, naming the key or the element.

    tip, base: of a URDF, the last and the first link of the arm's chain, where the file holds more than one chain.

    Examples
    --------
    >>> armsight.read_arm(armsight.presets.ur10().save(folder / "arm.urdf")).n
    6
    """
    file = as_path(path)
    for name, link in (("tip", tip), ("base", base)):
        require_kind(name, link, str, NoneType)
    if file.suffix.lower() == ".urdf":
        return read_urdf(file, tip=tip, base=base)
    if tip is not None or base is not None:
        raise UsageError(f"a tip or a base was named, but {file} is no URDF", cure="Leave them away")
    return arm_file.read_arm(file)


@speaks_python()
def read_poses(path: PathText, *, table: TableFormat = OURS) -> PoseTrack:
    """Return the poses in a poses.csv, in TUM (.tum, .txt), or in a table that says what its columns are.

    table: what a foreign table leaves open. Raises BadFile, naming line and column.

    Examples
    --------
    >>> T = armsight.simulate("hand-cell", frames=3).T_rig_target
    >>> file = armsight.write_table(folder / "poses.csv", (np.arange(3.0), T))
    >>> armsight.read_poses(armsight.read_poses(file).save(folder / "poses.tum")).T_parent_target.shape
    (3, 4, 4)
    """
    require_kind("table", table, TableFormat)
    file = as_path(path)
    if file.suffix.lower() in TUM_SUFFIXES and table is OURS:
        return PoseTrack(poses=store.read_tum(file))
    return PoseTrack(poses=store.read_poses(file, format_=table))


@speaks_python()
def read_path(path: PathText, *, frame: Literal["world", "base"] = "world") -> TaughtPath:
    """Return the path in a path.csv, its poses in frame world or base. Raises BadFile, naming line and column.

    Examples
    --------
    >>> T = np.tile(np.eye(4), (3, 1, 1))
    >>> T[:, 0, 3] = [0.0, 0.1, 0.2]
    >>> len(armsight.read_path(armsight.TaughtPath.of_poses(T).save(folder / "path.csv")))
    3
    """
    if frame not in FRAMES:
        raise UsageError(
            f"there is no frame {frame!r}", consequence="No path is read", cure=f"Use {' or '.join(FRAMES)}"
        )
    return path_file.read_path(as_path(path), parent=frame)


@speaks_python()
def read_joints(path: PathText, *, measured: bool = False, table: TableFormat = OURS) -> tuple[Array, Array]:
    """Return times (n,) in s and joint values (n, m) in rad and m of a joints.csv. Raises BadFile.

    measured: it is the log of an arm: rows in which nothing was measured are left out, which a warning tells; else
    every row was asked for, and counts. table: what a foreign table leaves open.

    Examples
    --------
    >>> t_s, q = armsight.read_joints(armsight.write_joints(folder / "joints.csv", [0.0, 0.1], np.zeros((2, 6))))
    >>> q.shape
    (2, 6)
    """
    require_kind("table", table, TableFormat)
    require_kind("measured", measured, bool)
    told: list[str] = []
    motion = store.read_joints(as_path(path), replace(table, notify=told.append), measured=measured)
    _warn(told)
    return np.asarray(motion.t_s), np.asarray(motion.q)


def write_joints(path: PathText, t_s: ArrayLike, q: ArrayLike) -> Path:
    """Write joints.csv of times (n,) and values (n, m), and return its path. Raises UsageError, Inconsistent.

    Examples
    --------
    >>> armsight.write_joints(folder / "joints.csv", [0.0, 0.1], np.zeros((2, 6))).name
    'joints.csv'
    """
    file = file_to_write(path, ".csv")
    store.write_joints(file, Motion(t_s=t_s, q=q))  # type: ignore[arg-type]  # the record makes arrays of them
    return file


@speaks_python()
def read_table(path: PathText, *, kind: str | None = None, table: TableFormat = OURS) -> Columns:
    """Return any table (points, spots, pairs, sweeps, a robot's log) as columns by name, in our names and units.

    kind: joints, poses, points, pairs, robot_poses or sweep; else that which the columns can be. table: what it leaves
    open. Raises UsageError, BadFile.

    Examples
    --------
    >>> file = folder / "tracker.csv"
    >>> file.write_text("time [s],X [mm],Y [mm],Z [mm],rx [deg],ry [deg],rz [deg]\\n0,100,200,300,0,0,90\\n")
    78
    >>> armsight.read_table(file, kind="poses", table=armsight.TableFormat(euler="xyz-fixed"))["x_m"]
    array([0.1])
    """
    require_kind("kind", kind, str, NoneType)
    require_kind("table", table, TableFormat)
    return read_columns(convert_table(as_path(path), kind=kind, format_=table).content.encode())


def write_table(path: PathText, columns: Mapping[str, Any] | ArrayLike) -> Path:
    """Write columns by name (a DataFrame), (t_s, q), (t_s, T), q or T as CSV, and return its path.

    Examples
    --------
    >>> armsight.write_table(folder / "points.csv", {"x_m": [0.1, 0.2], "point": ["A", "B"]}).read_text()
    'x_m,point\\n0.1,A\\n0.2,B\\n'
    """
    file = file_to_write(path, ".csv")
    write_text(file, as_table("columns", columns))
    return file


def read_world(path: PathText) -> World:
    """Return where a rig stands, from a world.yaml. Raises BadFile, naming the key.

    Examples
    --------
    >>> done = armsight.write_simulation("webcam-cell", folder / "cell", frames=1)
    >>> armsight.read_world(folder / "cell" / "world.yaml").parent
    'world'
    """
    return store.read_world(as_path(path))


def read_hand_eye(path: PathText) -> HandEyeFile:
    """Return where a camera and its target are, from a handeye.yaml. Raises BadFile, naming the key.

    Examples
    --------
    >>> done = armsight.write_simulation("webcam-cell", folder / "cell", frames=1)
    >>> armsight.read_hand_eye(folder / "cell" / "handeye.yaml").setup
    <Setup.EYE_TO_HAND: 'eye-to-hand'>
    """
    return read_handeye(as_path(path))


def read_tool_tip(path: PathText) -> TipFile:
    """Return where a tool's tip is, from a tip.yaml. Raises BadFile, naming the key.

    Examples
    --------
    >>> turn = Rotation.from_rotvec(np.random.default_rng(1).normal(0.0, 0.4, (20, 3)))
    >>> poses = RigidTransform.from_components(-turn.apply([0.0, 0.0, 0.2]), turn)
    >>> file = armsight.calibrate_tool_tip(poses).save(folder / "tip.yaml")
    >>> armsight.read_tool_tip(file).tip_m.round(6) + 0.0
    array([0. , 0. , 0.2])
    """
    return read_tip(as_path(path))


def read_limits(path: PathText) -> Limits:
    """Return what the guard keeps, from a limits.yaml. Raises BadFile, naming the key.

    Examples
    --------
    >>> armsight.read_limits(armsight.Limits(speed_m_s=0.05).save(folder / "limits.yaml")).speed_m_s
    0.05
    """
    return limits_file.read_limits(as_path(path))


def open_recording(path: PathText) -> Recording:
    """Return a recording (.mcap) open for reading: use it as a context manager. Raises BadFile.

    `cameras` names its cameras, `frames(camera)` yields frames with image and t_s, `poses()` and `joints()` the rest;
    `rig` and `target` are those recorded with it.

    Examples
    --------
    >>> done = armsight.record(folder / "run.mcap", cell="hand-cell", frames=2)
    >>> with armsight.open_recording(folder / "run.mcap") as recording:
    ...     recording.cameras, [frame.image.shape for frame in recording.frames("left")]
    (('left', 'right'), [(720, 1280), (720, 1280)])
    """
    return Recording(as_path(path))


@speaks_python()
def cut_recording(path: PathText, out: PathText, start_s: float, end_s: float, *, overwrite: bool = False) -> Repaired:
    """Copy what was recorded from start_s to end_s, with rig and target, into a new recording.

    Raises BadFile, NotEnoughData where nothing was recorded then, UsageError.

    Examples
    --------
    >>> done = armsight.record(folder / "run.mcap", cell="hand-cell", frames=4)
    >>> cut = armsight.cut_recording(folder / "run.mcap", folder / "part.mcap", 0.02, 0.08)
    >>> with armsight.open_recording(cut.file) as part:
    ...     len(list(part.frames("left"))), part.rig.kind
    (2, <RigKind.STEREO: 'stereo'>)
    """
    source, file = as_path(path), file_to_write(out, ".mcap")
    if end_s < start_s:
        raise UsageError(
            f"end_s is {end_s:g}, before start_s, {start_s:g}", consequence="Nothing is cut", cure="Exchange them"
        )
    with Recording(source) as recording:
        ends = [recording.origin_ns + round(1e9 * t_s) for t_s in (start_s, end_s)]
    return cut(source, file, ends[0], ends[1], overwrite=overwrite)


@speaks_python()
def repair_recording(path: PathText, out: PathText | None = None, *, overwrite: bool = False) -> Repaired:
    """Make a readable recording of one that was cut off: as out, or in its place with the broken one kept beside it.

    Raises BadFile for what is no recording, UsageError where a file would be lost.

    Examples
    --------
    >>> done = armsight.record(folder / "run.mcap", cell="hand-cell", frames=2)
    >>> armsight.repair_recording(folder / "run.mcap", folder / "whole.mcap").lost_bytes
    0
    """
    return mend(as_path(path), None if out is None else as_path(out, "out"), overwrite=overwrite)
