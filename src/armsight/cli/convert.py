"""armsight convert; `convert recording` stands beside record."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TypeAlias

from armsight.cli.command import command, convert
from armsight.cli.command_ui import CommandUI
from armsight.cli.tables import figure
from armsight.errors import UsageError
from armsight.fields import Doc, Flag
from armsight.ops.flags import AN_ARM, KNOWN_ARM, OUT, Base, FileUnits, Table, Tip, UnitLength, size_of

if TYPE_CHECKING:
    from armsight.app.convert import ConvertOutput

ARGUMENT = Flag(positional=True)
To: TypeAlias = Annotated[str | None, Doc("armsight, ros, opencv, kalibr, colmap. [armsight]")]
Size: TypeAlias = Annotated[
    tuple[int, int] | None, Doc("WIDTHxHEIGHT, where an OpenCV file does not say it."), Flag(read=size_of)
]
Out: TypeAlias = Annotated[Path, Doc("File to write."), OUT]


@command(convert)
def camera(
    face: CommandUI,
    source: Annotated[Path, Doc("camera.yaml, ROS camera_info, OpenCV FileStorage or Kalibr camchain."), ARGUMENT],
    out: Out,
    to: To = None,
    size: Size = None,
    zoom: Annotated[float | None, Doc("Of a zoom lens's camera.yaml: the camera at this setting.")] = None,
) -> None:
    """Convert the calibration of one camera; or take one setting out of a zoom lens's."""
    from armsight.app.calibrate.zoom import fix_camera
    from armsight.app.convert import convert_camera

    if zoom is not None:
        _require_ours(to, size)
        _print_written(face, fix_camera(source, out, zoom))
        return
    _print_written(face, convert_camera(source, out, to=to, size=size))


@command(convert)
def rig(
    face: CommandUI,
    source: Annotated[list[Path], Doc("rig.yaml, OpenCV stereo, Kalibr; two files of ROS or OpenCV."), ARGUMENT],
    out: Annotated[list[Path], Doc("File; for ROS left, right, maybe a launch file of TF."), OUT],
    to: To = None,
    size: Size = None,
    unit_m: UnitLength = FileUnits.unit_m,
    zoom_left: Annotated[float | None, Doc("Of a rig with zoom lenses: at this setting.")] = None,
    zoom_right: Annotated[float | None, Doc("... of the right lens.")] = None,
) -> None:
    """Convert the calibration of a pair of cameras; or take one setting out of a rig with zoom lenses."""
    from armsight.app.calibrate.zoom import fix_rig
    from armsight.app.convert import convert_rig

    if zoom_left is not None or zoom_right is not None:
        _require_ours(to, size)
        if len(source) != 1 or len(out) != 1:
            raise UsageError("one rig.yaml goes into one", cure="Give one file and one -o with --zoom-left")
        _print_written(face, fix_rig(source[0], out[0], (zoom_left, zoom_right)))
        return
    _print_written(face, convert_rig(source, out, to=to, size=size, unit_m=unit_m))


@command(convert)
def poses(
    face: CommandUI,
    source: Annotated[Path, Doc("poses.csv, or a TUM file (.tum, .txt)."), ARGUMENT],
    out: Annotated[Path, Doc("File to write: .csv, .tum or .txt."), OUT],
) -> None:
    """Convert poses between poses.csv and TUM, which evo reads."""
    from armsight.app.convert import convert_poses

    _print_written(face, convert_poses(source, out))


@command(convert)
def table(
    face: CommandUI,
    *,
    source: Annotated[Path, Doc("CSV, TXT, YAML, JSON, .mat, or a folder with one file per pose."), ARGUMENT],
    out: Annotated[Path | None, Doc("File to write. [default: only tell]"), OUT] = None,
    kind: Annotated[
        str | None, Doc("joints, poses, points, pairs, robot_poses or sweep. [default: tell]"), Flag("--as")
    ] = None,
    arm: Annotated[str | None, Doc("Where columns carry the names of an arm's joints."), AN_ARM] = None,
    table: Table,
) -> None:
    """Show what is understood of a table, and write it in armsight's columns and units."""
    from armsight.app.tables import convert_table

    done = convert_table(source, out, kind=kind, format_=table, arm=arm)
    rows = [
        [name, "" if found is None else figure(found[0], 5), "" if found is None else figure(found[1], 5)]
        for name, found in done.ranges.items()
    ]
    face.table(f"{done.kind}: {done.n} rows", ["column", "smallest", "largest"], rows)
    for note in done.notes:
        face.say(f"- {note}")
    face.say(f"Written: {done.file}" if done.file else "Nothing was written; -o FILE writes it")
    face.result(done)


@command(convert)
def handeye(
    face: CommandUI,
    source: Annotated[Path, Doc("handeye.yaml."), ARGUMENT],
    out: Out,
    to: Annotated[str, Doc("easy_handeye, easy_handeye2, or tf: a launch file of ROS 2.")],
    base: Annotated[str, Doc("The base's frame in TF.")] = "base_link",
    flange: Annotated[str, Doc("The flange's frame in TF.")] = "tool0",
    camera_frame: Annotated[str, Doc("The camera's optical frame in TF.")] = "camera_optical_frame",
    target: Annotated[str, Doc("The target's frame in TF.")] = "calibration_target",
) -> None:
    """Write a hand-eye calibration for ROS."""
    from armsight.app.convert import convert_handeye
    from armsight.store.foreign import FrameNames

    names = FrameNames(base=base, flange=flange, camera=camera_frame, target=target)
    _print_written(face, convert_handeye(source, out, to=to, names=names))


@command(convert)
def arm(
    face: CommandUI,
    source: Annotated[str, Doc(f"{KNOWN_ARM}."), Flag(positional=True, metavar="FILE")],
    out: Annotated[Path, Doc("File to write: .yaml or .urdf."), OUT],
    convention: Annotated[str | None, Doc("standard or craig, for arm.yaml.")] = None,
    tip: Tip = None,
    base: Base = None,
) -> None:
    """Convert an arm between arm.yaml and URDF, and between the two Denavit-Hartenberg conventions."""
    from armsight._files import arm_source
    from armsight.ops.arm_files import convert_arm as run

    done = run(arm_source(source, tip=tip, base=base), out, convention=convention)
    face.say(f"{done.arm}, {done.joints} joints: {out}")
    for note in done.notes:
        face.say(f"  {note}")
    face.result(done)


def _require_ours(to: str | None, size: tuple[int, int] | None) -> None:
    """Raise UsageError where a setting is to be taken and converted at once."""
    if to not in (None, "armsight") or size is not None:
        raise UsageError(
            "a setting is taken out of armsight's own file into another one",
            cure="Leave --to and --size away, and convert the file that is written",
        )


def _print_written(face: CommandUI, done: ConvertOutput) -> None:
    poses = f", {done.n} poses" if done.n is not None else ""
    face.say(f"{done.source} to {done.target}{poses}: {', '.join(done.files)}")
    if done.note:
        face.say(f"- {done.note}")
    face.result(done)
