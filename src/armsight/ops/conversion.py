"""Between our files and those of other programs."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Annotated

from armsight.calibrate.handeye import Setup
from armsight.errors import BadFile, UsageError
from armsight.fields import Doc
from armsight.optics import Camera, Rig
from armsight.optics.mirrors import pinhole_pair
from armsight.records.output import Output, output
from armsight.shown import Shown
from armsight.store import (
    read_camera,
    read_poses,
    read_rig,
    read_tum,
    write_camera,
    write_poses,
    write_rig,
    write_tum,
)
from armsight.store.foreign import (
    FrameNames,
    Transform,
    camera_from_kalibr,
    camera_from_opencv,
    camera_from_ros,
    camera_to_kalibr,
    camera_to_opencv,
    camera_to_ros,
    cameras_to_colmap,
    kind_of,
    rig_from_kalibr,
    rig_from_opencv,
    rig_from_ros,
    rig_to_kalibr,
    rig_to_opencv,
    rig_to_ros,
    write_easy_handeye,
    write_easy_handeye2,
    write_tf_launch,
)
from armsight.store.handeye_file import read_handeye

KINDS = ("armsight", "ros", "opencv", "kalibr")
WRITTEN = (*KINDS, "colmap")
"""Kinds that can be converted to."""
HANDEYE_KINDS = ("easy_handeye", "easy_handeye2", "tf")
TUM_SUFFIXES = (".tum", ".txt")


@output
class ConvertOutput(Output):
    """armsight convert camera, convert rig, convert handeye, convert poses."""

    source: Annotated[str, Doc("Kind of the file read: armsight, ros, opencv, kalibr; or of poses.", key="from")]
    target: Annotated[str, Doc("Kind of the files written.", key="to")]
    files: Annotated[list[str], Doc("The files written.")]
    n: Annotated[int | None, Doc("Poses; null for cameras and rigs.")]
    note: Annotated[str, Doc("What the new kind could not carry, or which zoom it is of; may be empty.")]

    def summary(self) -> Iterator[Shown]:
        """Yield what a terminal shows of it."""
        poses = f", {self.n} poses" if self.n is not None else ""
        yield f"{self.source} to {self.target}{poses}: {', '.join(self.files)}"
        if self.note:
            yield f"- {self.note}"


def convert_camera(
    source: Path, out: Path, *, to: str | None = None, size: tuple[int, int] | None = None
) -> ConvertOutput:
    """Convert a camera's file; to: one of WRITTEN, default armsight. Raises DataRefused or UsageError."""
    kind = _kind(source, "armsight/camera")
    to = _wanted(kind, to)
    told: list[str] = []
    camera = load_camera(source, size=size, told=told)
    write: Mapping[str, Callable[[], None]] = {
        "armsight": lambda: write_camera(out, camera, inputs=[source]),
        "ros": lambda: camera_to_ros(out, camera),
        "opencv": lambda: camera_to_opencv(out, camera),
        "kalibr": lambda: camera_to_kalibr(out, camera),
        "colmap": lambda: cameras_to_colmap(out, [camera]),
    }
    write[to]()
    return _done(kind, to, [out], note="; ".join(told))


def load_camera(source: Path, *, size: tuple[int, int] | None = None, told: list[str] | None = None) -> Camera:
    """Return the camera in a file of ours or of one of KINDS; told: takes what is to be said. Raises BadFile."""
    read: Mapping[str, Callable[[Path], Camera]] = {
        "armsight": read_camera,
        "ros": lambda path: camera_from_ros(path, told=told),
        "opencv": lambda path: camera_from_opencv(path, size=size, told=told),
        "kalibr": camera_from_kalibr,
    }
    return read[_kind(source, "armsight/camera")](source)


def load_rig(
    sources: Sequence[Path],
    *,
    size: tuple[int, int] | None = None,
    unit_m: float | None = None,
    told: list[str] | None = None,
) -> Rig:
    """Return the rig in a file, or in the two files, of ours or of one of KINDS; told: takes what is to be said.

    Raises BadFile, UsageError.
    """
    kind = _kind(sources[0], "armsight/rig")
    _count("input", sources, kind, {"armsight": (1,), "ros": (2,), "opencv": (1, 2), "kalibr": (1,)}[kind])
    read: Mapping[str, Callable[[], Rig]] = {
        "armsight": lambda: read_rig(sources[0], any_cameras=True),
        "ros": lambda: rig_from_ros(sources[0], sources[1], unit_m=unit_m, told=told),
        "opencv": lambda: rig_from_opencv(sources, size=size, unit_m=unit_m, told=told),
        "kalibr": lambda: rig_from_kalibr(sources[0], unit_m=unit_m),
    }
    return read[kind]()


def convert_rig(
    sources: Sequence[Path],
    outs: Sequence[Path],
    *,
    to: str | None = None,
    size: tuple[int, int] | None = None,
    unit_m: float | None = None,
) -> ConvertOutput:
    """Convert a rig's file, or its two files (ROS: left, right; OpenCV: intrinsics, extrinsics).

    to: one of WRITTEN, default armsight; ROS wants two outs, and may take a third for a launch file with the transforms
    (TF) between the cameras; the others want one. size (width, height): of OpenCV's
    files, which may leave it out. unit_m: the length of their unit in metres, where it is not the metre. Raises
    DataRefused or UsageError.
    """
    kind = _kind(sources[0], "armsight/rig")
    to = _wanted(kind, to)
    told: list[str] = []
    rig = load_rig(sources, size=size, unit_m=unit_m, told=told)
    _count("output", outs, to, (2, 3) if to == "ros" else (1,))
    if to in ("ros", "opencv"):
        rig.require_pair(f"a file of {to}")
    if to != "armsight" and rig.is_pair and rig.left.plate is not None:
        rig, rms_px = pinhole_pair(rig)
        told.append(f"{to} knows no glass plate: written is the nearest pair of pinholes, {rms_px:.3f} px RMS off")
    write: Mapping[str, Callable[[], None]] = {
        "armsight": lambda: write_rig(outs[0], rig, inputs=sources),
        "ros": lambda: _rig_to_ros(outs, rig),
        "opencv": lambda: rig_to_opencv(outs[0], rig),
        "kalibr": lambda: rig_to_kalibr(outs[0], rig),
        "colmap": lambda: cameras_to_colmap(outs[0], [one.camera for one in rig.cameras]),
    }
    if to == "kalibr" and not rig.is_pair:
        told.append(f"Kalibr has no names: cam0 ... are {', '.join(rig.names)}")
    write[to]()
    return _done(kind, to, outs, note="; ".join(told))


def _rig_to_ros(outs: Sequence[Path], rig: Rig) -> None:
    """Write the two camera_info files, and the transforms to both cameras where a third file is named."""
    rig_to_ros(outs[0], outs[1], rig)
    if len(outs) > 2:
        sides = (("left", rig.T_rig_left), ("right", rig.T_rig_right))
        write_tf_launch(outs[2], [Transform(parent="rig", child=name, T_parent_child=T) for name, T in sides])


def convert_handeye(source: Path, out: Path, *, to: str, names: FrameNames) -> ConvertOutput:
    """Write a handeye.yaml for ROS: as easy_handeye or easy_handeye2 keep theirs, or as a launch file of transforms.

    Raises UsageError, DataRefused.
    """
    if to not in HANDEYE_KINDS:
        raise UsageError(
            f"{to!r} is not a kind to convert to", cure=f"Give --to with one of {', '.join(HANDEYE_KINDS)}"
        )
    found = read_handeye(source)
    in_hand = found.setup is Setup.EYE_IN_HAND
    if to == "tf":
        camera, target = (names.flange, names.base) if in_hand else (names.base, names.flange)
        write_tf_launch(
            out,
            [
                Transform(parent=camera, child=names.camera, T_parent_child=found.T_parent_camera),
                Transform(parent=target, child=names.target, T_parent_child=found.T_parent_target),
            ],
        )
    else:
        write = write_easy_handeye if to == "easy_handeye" else write_easy_handeye2
        write(out, found.T_parent_camera, names, in_hand=in_hand)
    return _done("armsight", to, [out])


def convert_poses(source: Path, out: Path) -> ConvertOutput:
    """Convert poses.csv to TUM (.tum, .txt) or TUM to poses.csv, by the names' endings."""
    from_tum, to_tum = (path.suffix.lower() in TUM_SUFFIXES for path in (source, out))
    if from_tum == to_tum or not all(path.suffix.lower() in (*TUM_SUFFIXES, ".csv") for path in (source, out)):
        raise UsageError(
            f"{source.name} to {out.name} is no conversion of poses",
            cure="One name must end in .csv, the other in .tum or .txt",
        )
    if to_tum:
        return _done("poses.csv", "tum", [out], rows=write_tum(out, read_poses(source, measured=False)))
    poses = read_tum(source)
    write_poses(out, poses)
    return _done("tum", "poses.csv", [out], rows=len(poses))


def _done(source: str, target: str, files: Sequence[Path], *, rows: int | None = None, note: str = "") -> ConvertOutput:
    return ConvertOutput(source=source, target=target, files=[str(path) for path in files], n=rows, note=note)


def _kind(path: Path, own: str) -> str:
    kind = kind_of(path)
    if kind == own:
        return "armsight"
    if kind in KINDS:
        return kind
    raise BadFile(
        f"{path} is {kind}, not {own}" if kind else f"{path} is no calibration of a known kind",
        consequence="It cannot be converted",
        cure=f"Known are {own}, ROS camera_info, OpenCV FileStorage and Kalibr camchain, all in YAML",
    )


def _wanted(kind: str, to: str | None) -> str:
    to = to or ("armsight" if kind != "armsight" else None)
    if to is None or to not in WRITTEN:
        raise UsageError(
            f"{to!r} is not a kind to convert to" if to else "the file is armsight's own, and --to says nothing",
            cure=f"Give --to with one of {', '.join(WRITTEN)}",
        )
    return to


def _count(what: str, paths: Sequence[Path], kind: str, allowed: tuple[int, ...]) -> None:
    if len(paths) not in allowed:
        wanted = " or ".join(str(count) for count in allowed)
        raise UsageError(
            f"{len(paths)} {what} files are given, {kind} takes {wanted}",
            cure="For ROS give both cameras, the left one first" if kind == "ros" else "",
        )
