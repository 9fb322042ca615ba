"""Between our files and those of other programs."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import numpy as np

from armsight.calibrate.handeye import Setup
from armsight.errors import BadFile, UsageError
from armsight.fields import Doc
from armsight.ops.file_kinds import unknown
from armsight.optics import SIDES, Camera, Rig
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
    FORMATS,
    READ,
    WRITTEN,
    Asked,
    FrameNames,
    Transform,
    kind_of,
    read_foreign_camera,
    read_foreign_rig,
    write_easy_handeye,
    write_easy_handeye2,
    write_tf_launch,
)
from armsight.store.handeye_file import read_handeye

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
    baseline_m: Annotated[float | None, Doc("Between the first two cameras of a rig; null for others.")] = None

    def summary(self) -> Iterator[Shown]:
        """Yield what a terminal shows of it."""
        poses = f", {self.n} poses" if self.n is not None else ""
        yield f"{self.source} to {self.target}{poses}: {', '.join(self.files)}"
        if self.baseline_m is not None:
            yield f"baseline {1e3 * self.baseline_m:.2f} mm"
        if self.note:
            yield f"- {self.note}"


def convert_camera(source: Path, out: Path, *, to: str | None = None, asked: Asked | None = None) -> ConvertOutput:
    """Convert a camera's file; to: a kind that is written, default armsight. Raises DataRefused or UsageError."""
    asked = asked or Asked()
    kind = _kind(source, "armsight/camera")
    to = _wanted(kind, to)
    camera = load_camera(source, asked)
    if to == "armsight":
        write_camera(out, camera, inputs=[source])
    else:
        write = FORMATS[to].write_camera
        if write is None:
            raise UsageError(f"{to} keeps rigs, not single cameras", cure="Use armsight convert rig")
        write(out, camera)
    return _done(kind, to, [out], note="; ".join(asked.told))


def load_camera(source: Path, asked: Asked | None = None) -> Camera:
    """Return the camera in a file of ours or of one of FORMATS; asked.told takes what is to be said. Raises BadFile."""
    kind = _kind(source, "armsight/camera")
    return read_camera(source) if kind == "armsight" else read_foreign_camera(kind, source, asked or Asked())


def load_rig(sources: Sequence[Path], asked: Asked | None = None) -> Rig:
    """Return the rig in a file, or in the two files, of ours or of one of FORMATS; asked.told takes what is to be said.

    Raises BadFile, UsageError.
    """
    kind = _kind(sources[0], "armsight/rig")
    _count("input", sources, kind, FORMATS[kind].files if kind in FORMATS else (1,))
    if kind == "armsight":
        rig = read_rig(sources[0], any_cameras=True)
        return _of_names(rig, asked) if asked is not None and asked.names else rig
    return read_foreign_rig(kind, sources, asked or Asked())


def _of_names(rig: Rig, asked: Asked) -> Rig:
    """Return the rig of some of a rig's cameras with its covariance; two of them are left and right from then on."""
    part = rig.only(*asked.names)
    if len(part.cameras) != len(SIDES) or set(part.names) == set(SIDES):
        return part
    asked.told.append(f"the cameras {part.names[0]} and {part.names[1]} are called left and right here")
    sides, known = dict(zip(part.names, SIDES, strict=True)), part.covariance
    if known is not None:
        split = [name.partition(".") for name in known.names]
        known = replace(known, names=tuple(f"{sides[camera]}.{rest}" for camera, _, rest in split))
    cameras = [replace(one, name=sides[one.name]) for one in part.cameras]
    return Rig(cameras=cameras, covariance=known, rms_px=part.rms_px)


def convert_rig(
    sources: Sequence[Path], outs: Sequence[Path], *, to: str | None = None, asked: Asked | None = None
) -> ConvertOutput:
    """Convert a rig's file, or its two files (ROS: left, right; OpenCV: intrinsics, extrinsics).

    to: a kind that is written, default armsight; ROS wants two outs, and may take a third for a launch file with the
    transforms (TF) between the cameras; the others want one. Raises DataRefused or UsageError.
    """
    asked = asked or Asked()
    kind = _kind(sources[0], "armsight/rig")
    to = _wanted(kind, to or ("armsight" if asked.names else None))
    rig = load_rig(sources, asked)
    _count("output", outs, to, FORMATS[to].outs if to in FORMATS else (1,))
    if to in ("ros", "opencv"):
        rig.require_pair(f"a file of {to}")
    baseline_m = _apart_m(rig)
    if to != "armsight" and rig.is_pair and rig.left.plate is not None:
        rig, rms_px = pinhole_pair(rig)
        asked.told.append(
            f"{to} knows no glass plate: written is the nearest pair of pinholes, {rms_px:.3f} px RMS off"
        )
    if to == "kalibr" and not rig.is_pair:
        asked.told.append(f"Kalibr has no names: cam0 ... are {', '.join(rig.names)}")
    write = FORMATS[to].write_rig if to in FORMATS else None
    if write is None:
        write_rig(outs[0], rig, inputs=sources)
    else:
        write(outs, rig)
    return _done(kind, to, outs, note="; ".join(asked.told), baseline_m=baseline_m)


def _apart_m(rig: Rig) -> float | None:
    """Return the distance of the first two cameras, None of one alone."""
    if len(rig.cameras) < 2:
        return None
    a, b = (one.T_rig_camera.translation for one in rig.cameras[:2])
    return float(np.linalg.norm(b - a))


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


def _done(
    source: str,
    target: str,
    files: Sequence[Path],
    *,
    rows: int | None = None,
    note: str = "",
    baseline_m: float | None = None,
) -> ConvertOutput:
    names = [str(path) for path in files]
    return ConvertOutput(source=source, target=target, files=names, n=rows, note=note, baseline_m=baseline_m)


def _kind(path: Path, own: str) -> str:
    command = f"convert {own.removeprefix('armsight/')}"
    try:
        kind = kind_of(path)
    except BadFile as error:
        if not path.is_file():
            raise
        raise unknown(path, command, error) from error
    if kind == own:
        return "armsight"
    if kind in READ:
        return kind
    if kind is None:
        raise unknown(path, command)
    raise BadFile(
        f"{path} is {kind}, not {own}",
        consequence="It cannot be converted",
        cure=f"Give a file of {own}, or one that another program wrote of its cameras",
    )


def _wanted(kind: str, to: str | None) -> str:
    to = to or ("armsight" if kind != "armsight" else None)
    known = ("armsight", *WRITTEN)
    if to not in known:
        raise UsageError(
            f"{to!r} is not a kind to convert to" if to else "the file is armsight's own, and --to says nothing",
            cure=f"Give --to with one of {', '.join(known)}",
        )
    return to


def _count(what: str, paths: Sequence[Path], kind: str, allowed: tuple[int, ...]) -> None:
    if len(paths) not in allowed:
        wanted = " or ".join(str(count) for count in allowed)
        raise UsageError(
            f"{len(paths)} {what} files are given, {kind} takes {wanted}",
            cure="For ROS give both cameras, the left one first" if kind == "ros" else "",
        )
