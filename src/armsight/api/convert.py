"""Files of one kind as those of another; recordings opened, cut and exported."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from os import fspath
from pathlib import Path
from typing import Any, Literal

from armsight.api.files import image_size
from armsight.api.tracks import TUM_SUFFIXES, PoseTrack
from armsight.app.convert import (
    convert_camera,
    convert_handeye,
    convert_poses,
    convert_rig,
)
from armsight.app.record.export import ExportOutput, export
from armsight.app.tables import convert_table
from armsight.errors import UsageError
from armsight.ops.arm_files import convert_arm
from armsight.ops.arrays import as_path
from armsight.ops.checks import speaks_python
from armsight.ops.flags import FileUnits
from armsight.ops.given import Given, PathText
from armsight.optics import Rig
from armsight.records import Progress
from armsight.records.output import Output
from armsight.store.foreign import FrameNames
from armsight.store.interpret import OURS, TableFormat
from armsight.store.recording import Recording, Repaired, cut
from armsight.store.saving import file_to_write
from armsight.store.yamls import read_yaml

Kind = Literal["camera", "rig", "handeye", "arm", "poses", "table", "recording"]

RIG_KEYS = {"cam1", "cameraMatrix2", "M2", "K2", "R", "T"}
"""Of these each says that a file of another program is of two cameras."""


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
def export_recording(
    path: PathText, out: PathText, *, to: Literal["files", "rosbag2"] = "files", progress: Progress | None = None
) -> ExportOutput:
    """Write a recording's content as PNG folders and tables, its poses as .csv or .tum, or all as a bag of ROS 2.

    out: a folder, or a .csv or .tum. Raises BadFile, NotEnoughData, UsageError.

    Examples
    --------
    >>> done = armsight.record(folder / "run.mcap", cell="hand-cell", frames=2)
    >>> armsight.export_recording(folder / "run.mcap", folder / "run").n["left"]
    2
    """
    return export(as_path(path), as_path(out, "out"), to=to, progress=progress)


@speaks_python(FileUnits)
def convert(
    source: Any,
    out: PathText | list[PathText] | tuple[PathText, ...],
    *,
    to: str | None = None,
    kind: Kind | None = None,
    size: tuple[int, int] | None = None,
    unit_m: float | None = FileUnits.unit_m,
    convention: Literal["standard", "craig"] | None = None,
    names: FrameNames | None = None,
    table: TableFormat = OURS,
) -> Output:
    """Write a record or a file of one kind as a file of another program, or the other way round.

    Parameters
    ----------
    source
        A Camera, Rig, Arm, PoseTrack or hand-eye result; or a file, or the two files of ROS or OpenCV.
    out
        The file; for a rig of ROS left, right, and maybe a launch file of TF.
    to
        Cameras and rigs: armsight, ros, opencv, kalibr, colmap; hand-eye: easy_handeye, easy_handeye2, tf;
        recordings: files, rosbag2. Arms, poses and tables by the name's ending.
    kind
        What it is, where the file does not tell.
    size, unit_m
        Of an OpenCV file that leaves them open.
    convention
        Of an arm.yaml.
    names
        Of frames in TF.
    table
        What a foreign table leaves open.

    Raises
    ------
    BadFile, UsageError
        Not a file of this kind, or no such conversion.

    Examples
    --------
    >>> camera = armsight.Camera.pinhole(640, 480, 500.0, 500.0, 320.0, 240.0)
    >>> armsight.convert(camera, folder / "info.yaml", to="ros").target
    'ros'
    >>> armsight.read_camera(folder / "info.yaml").width
    640
    """
    with Given() as given:
        many = isinstance(source, list | tuple)
        sources = [given.file("source", one) for one in (source if many else [source])]
        outs = [as_path(one, "out") for one in (out if isinstance(out, list | tuple) else [out])]
        chosen = kind or _kind(source, sources)
        if chosen == "rig":
            return convert_rig(sources, outs, to=to, size=image_size(size), unit_m=unit_m)
        if chosen == "camera":
            return convert_camera(sources[0], outs[0], to=to, size=image_size(size))
        if chosen == "arm":
            return convert_arm(fspath(sources[0]), outs[0], convention=convention)
        if chosen == "handeye":
            return convert_handeye(sources[0], outs[0], to=to or "", names=names or FrameNames())
        if chosen == "recording":
            return export(sources[0], outs[0], to=to or "files")
        if chosen == "poses" and {path.suffix.lower() for path in (sources[0], outs[0])} & set(TUM_SUFFIXES):
            return convert_poses(sources[0], outs[0])
        return convert_table(sources[0], outs[0], kind=None if chosen == "table" else chosen, format_=table)


def _kind(source: object, files: Sequence[Path]) -> str:
    """Return which kind of thing is converted, by its content."""
    if isinstance(source, Rig) or len(files) > 1:
        return "rig"
    suffix = files[0].suffix.lower()
    if suffix == ".mcap":
        return "recording"
    if suffix == ".urdf":
        return "arm"
    if suffix not in (".yaml", ".yml"):
        return "poses" if suffix in TUM_SUFFIXES or isinstance(source, PoseTrack) else "table"
    content = read_yaml(files[0])
    if not isinstance(content, Mapping):
        return "table"
    name = str(content.get("format", "")).removeprefix("armsight/")
    return name if name in ("camera", "rig", "handeye", "arm") else "rig" if RIG_KEYS & set(content) else "camera"
