"""armsight convert."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TypeAlias

import typer

from armsight.cli.command_ui import CommandUI
from armsight.cli.options import AsJson, parse_size
from armsight.cli.record import recording

if TYPE_CHECKING:
    from armsight.app.schemas.files import ConvertOutput

convert = typer.Typer(help="Convert between armsight's files and those of other programs.", no_args_is_help=True)
convert.command("recording")(recording)

To: TypeAlias = Annotated[str | None, typer.Option("--to", help="armsight, ros, opencv or kalibr. [default: armsight]")]
Size: TypeAlias = Annotated[str | None, typer.Option(help="WIDTHxHEIGHT, where an OpenCV file does not say it.")]


@convert.command("camera")
def camera(
    source: Annotated[
        Path, typer.Argument(help="camera.yaml, ROS camera_info, OpenCV FileStorage or Kalibr camchain.")
    ],
    out: Annotated[Path, typer.Option("-o", "--out", help="File to write.")],
    to: To = None,
    size: Size = None,
    json: AsJson = False,
) -> None:
    """Convert the calibration of one camera."""
    with CommandUI(as_json=json) as face:
        from armsight.app.convert import convert_camera

        _tell(face, convert_camera(source, out, to=to, size=parse_size(size)))


@convert.command("rig")
def rig(
    source: Annotated[list[Path], typer.Argument(help="rig.yaml, OpenCV stereo, Kalibr; two files of ROS or OpenCV.")],
    out: Annotated[list[Path], typer.Option("-o", "--out", help="File to write; twice for ROS: left, then right.")],
    to: To = None,
    size: Size = None,
    unit: Annotated[float, typer.Option(min=1e-9, help="Length of an OpenCV file's unit in m.")] = 1.0,
    json: AsJson = False,
) -> None:
    """Convert the calibration of a pair of cameras."""
    with CommandUI(as_json=json) as face:
        from armsight.app.convert import convert_rig

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


def _tell(face: CommandUI, done: ConvertOutput) -> None:
    poses = f", {done.n} poses" if done.n is not None else ""
    face.say(f"{done.source} to {done.target}{poses}: {', '.join(done.files)}")
    if done.note:
        face.say(f"- {done.note}")
    face.result(done)
