"""armsight calibrate target."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from armsight.cli.camera_options import NONE_GIVEN, CameraOptions, takes_cameras
from armsight.cli.command_ui import CommandUI
from armsight.cli.options import SRC, AsJson, Inverted, Limit, Threshold
from armsight.cli.tables import figure
from armsight.units import MM

if TYPE_CHECKING:
    from armsight.calibrate.light_target import TargetCalibration


SHOWN = 8
"""Frames left out that are listed; the rest is in --json."""


@takes_cameras
def target(
    rig: Annotated[Path, typer.Option(help="rig.yaml of the two cameras, from `armsight calibrate stereo`.")],
    out: Annotated[Path, typer.Option("-o", "--out", help="target.yaml to write.")],
    left: Annotated[str | None, typer.Option(metavar="SRC", help=f"Left frames: {SRC}.")] = None,
    right: Annotated[str | None, typer.Option(metavar="SRC", help="Right frames, in step with the left ones.")] = None,
    image: Annotated[str | None, typer.Option(metavar="SRC", help="Images that hold both views of the rig.")] = None,
    lights: Annotated[int, typer.Option(min=2, max=6, help="How many lights the target has.")] = 3,
    frames: Limit = None,
    threshold: Threshold = None,
    inverted: Inverted = False,
    json: AsJson = False,
    camera_options: CameraOptions = NONE_GIVEN,
) -> None:
    """Find where the lights of a target are, from frames of it turned to several sides before a calibrated rig."""
    with CommandUI(as_json=json) as face:
        from armsight.app.calibrate.light_target import TargetJob, calibrate_lit_target

        job = TargetJob(
            rig=rig,
            out=out,
            left=left,
            image=image,
            right=right,
            lights=lights,
            limit=frames,
            threshold=threshold,
            inverted=inverted,
            camera_settings=camera_options.settings(),
        )
        done = calibrate_lit_target(job, face.progress("calibrating"))
        target_tables(face, done, out)
        face.result(done)


def target_tables(face: CommandUI, done: TargetCalibration, out: Path) -> None:
    """Print a target's geometry."""
    rows = [
        [name, *(figure(x / MM, 6) for x in xyz), " ".join(figure(s / MM, 2) for s in done.std[name])]
        for name, xyz in done.spots_m.items()
    ]
    face.table("Lights in the target's frame", ["", "x mm", "y mm", "z mm", "+- mm"], rows)
    rows = [[name, figure(d.value_m / MM, 6), figure(d.std_m / MM, 2)] for name, d in done.distances_m.items()]
    face.table("Distances", ["", "mm", "+-"], rows)
    face.say(
        f"{done.n_used} of {done.n_frames} frames, residual {figure(done.residual_rms_px)} px RMS, "
        f"left-out frames {figure(done.loo_rms_px)} px"
    )
    for item in done.rejected[:SHOWN]:
        face.say(f"  left out: {item.frame}: {item.why}")
    for text in done.advice:
        face.say(f"- {text}")
    face.say(f"Result: {out}")


def add_to(calibrate: typer.Typer) -> None:
    """Add the command to `armsight calibrate`."""
    calibrate.command("target")(target)
