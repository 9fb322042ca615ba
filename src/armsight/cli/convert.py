"""armsight convert."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TypeAlias

import typer

from armsight.cli.command_ui import CommandUI
from armsight.cli.options import AsJson, parse_size
from armsight.cli.record import recording
from armsight.cli.table_options import NOTHING_STATED, TableOptions, takes_tables
from armsight.cli.tables import figure
from armsight.errors import UsageError

if TYPE_CHECKING:
    from armsight.app.convert import ConvertOutput

convert = typer.Typer(help="Convert between armsight's files and those of other programs.", no_args_is_help=True)
convert.command("recording")(recording)

To: TypeAlias = Annotated[str | None, typer.Option("--to", help="armsight, ros, opencv, kalibr, colmap. [armsight]")]
Size: TypeAlias = Annotated[str | None, typer.Option(help="WIDTHxHEIGHT, where an OpenCV file does not say it.")]


@convert.command("camera")
def camera(
    source: Annotated[
        Path, typer.Argument(help="camera.yaml, ROS camera_info, OpenCV FileStorage or Kalibr camchain.")
    ],
    out: Annotated[Path, typer.Option("-o", "--out", help="File to write.")],
    to: To = None,
    size: Size = None,
    zoom: Annotated[
        float | None, typer.Option(help="Of a zoom lens's camera.yaml: the camera at this setting.")
    ] = None,
    json: AsJson = False,
) -> None:
    """Convert the calibration of one camera; or take one setting out of a zoom lens's."""
    with CommandUI(as_json=json) as face:
        from armsight.app.calibrate.zoom import fix_camera
        from armsight.app.convert import convert_camera

        if zoom is not None:
            _require_ours(to, size)
            _tell(face, fix_camera(source, out, zoom))
            return
        _tell(face, convert_camera(source, out, to=to, size=parse_size(size)))


@convert.command("rig")
def rig(
    source: Annotated[list[Path], typer.Argument(help="rig.yaml, OpenCV stereo, Kalibr; two files of ROS or OpenCV.")],
    out: Annotated[
        list[Path],
        typer.Option("-o", "--out", help="File; for ROS left, right, maybe a launch file of TF."),
    ],
    to: To = None,
    size: Size = None,
    unit: Annotated[float, typer.Option(min=1e-9, help="Length of an OpenCV file's unit in m.")] = 1.0,
    zoom_left: Annotated[float | None, typer.Option(help="Of a rig with zoom lenses: at this setting.")] = None,
    zoom_right: Annotated[float | None, typer.Option(help="... of the right lens.")] = None,
    json: AsJson = False,
) -> None:
    """Convert the calibration of a pair of cameras; or take one setting out of a rig with zoom lenses."""
    with CommandUI(as_json=json) as face:
        from armsight.app.calibrate.zoom import fix_rig
        from armsight.app.convert import convert_rig

        if zoom_left is not None or zoom_right is not None:
            _require_ours(to, size)
            if len(source) != 1 or len(out) != 1:
                raise UsageError("one rig.yaml goes into one", cure="Give one file and one -o with --zoom-left")
            _tell(face, fix_rig(source[0], out[0], (zoom_left, zoom_right)))
            return
        _tell(face, convert_rig(source, out, to=to, size=parse_size(size), unit_m=unit))


@convert.command("poses")
def poses(
    source: Annotated[Path, typer.Argument(help="poses.csv, or a TUM file (.tum, .txt).")],
    out: Annotated[Path, typer.Option("-o", "--out", help="File to write: .csv, .tum or .txt.")],
    json: AsJson = False,
) -> None:
    """Convert poses between poses.csv and TUM, which evo reads."""
    with CommandUI(as_json=json) as face:
        from armsight.app.convert import convert_poses

        _tell(face, convert_poses(source, out))


@convert.command("table")
@takes_tables
def table(
    source: Annotated[Path, typer.Argument(help="CSV, TXT, YAML, JSON, .mat, or a folder with one file per pose.")],
    out: Annotated[Path | None, typer.Option("-o", "--out", help="File to write. [default: only tell]")] = None,
    kind: Annotated[
        str | None, typer.Option("--as", help="joints, poses, points, pairs, robot_poses or sweep. [default: tell]")
    ] = None,
    arm: Annotated[
        str | None, typer.Option(metavar="ARM", help="Where columns carry the names of an arm's joints.")
    ] = None,
    json: AsJson = False,
    table_options: TableOptions = NOTHING_STATED,
) -> None:
    """Show what is understood of a table, and write it in armsight's columns and units."""
    with CommandUI(as_json=json) as face:
        from armsight.app.tables import convert_table

        done = convert_table(source, out, kind=kind, format_=table_options.format(face), arm=arm)
        rows = [
            [name, "" if found is None else figure(found[0], 5), "" if found is None else figure(found[1], 5)]
            for name, found in done.ranges.items()
        ]
        face.table(f"{done.kind}: {done.n} rows", ["column", "smallest", "largest"], rows)
        for note in done.notes:
            face.say(f"- {note}")
        face.say(f"Written: {done.file}" if done.file else "Nothing was written; -o FILE writes it")
        face.result(done)


@convert.command("handeye")
def handeye(
    source: Annotated[Path, typer.Argument(help="handeye.yaml.")],
    out: Annotated[Path, typer.Option("-o", "--out", help="File to write.")],
    to: Annotated[str, typer.Option("--to", help="easy_handeye, easy_handeye2, or tf: a launch file of ROS 2.")],
    base: Annotated[str, typer.Option(help="The base's frame in TF.")] = "base_link",
    flange: Annotated[str, typer.Option(help="The flange's frame in TF.")] = "tool0",
    camera_frame: Annotated[str, typer.Option(help="The camera's optical frame in TF.")] = "camera_optical_frame",
    target: Annotated[str, typer.Option(help="The target's frame in TF.")] = "calibration_target",
    json: AsJson = False,
) -> None:
    """Write a hand-eye calibration for ROS."""
    with CommandUI(as_json=json) as face:
        from armsight.app.convert import convert_handeye
        from armsight.store.foreign import FrameNames

        names = FrameNames(base=base, flange=flange, camera=camera_frame, target=target)
        _tell(face, convert_handeye(source, out, to=to, names=names))


def _require_ours(to: str | None, size: str | None) -> None:
    """Raise UsageError where a setting is to be taken and converted at once."""
    if to not in (None, "armsight") or size is not None:
        raise UsageError(
            "a setting is taken out of armsight's own file into another one",
            cure="Leave --to and --size away, and convert the file that is written",
        )


def _tell(face: CommandUI, done: ConvertOutput) -> None:
    poses = f", {done.n} poses" if done.n is not None else ""
    face.say(f"{done.source} to {done.target}{poses}: {', '.join(done.files)}")
    if done.note:
        face.say(f"- {done.note}")
    face.result(done)
