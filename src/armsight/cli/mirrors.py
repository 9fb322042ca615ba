"""armsight calibrate mirrors."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from armsight.cli.camera_options import NONE_GIVEN, CameraOptions, takes_cameras
from armsight.cli.command_ui import CommandUI
from armsight.cli.options import BOARD, SRC, AsJson, Every, Limit, Workers
from armsight.cli.tables import figure, stereo_tables

if TYPE_CHECKING:
    from armsight.app.schemas.cameras import CheckedAlignment, MirrorAlignment, MirrorCheckOutput, MirrorsOutput

MM, MRAD = 1e3, 1e3
REASONS_SHOWN = 8


@takes_cameras
def mirrors(
    image: Annotated[str | None, typer.Option(metavar="SRC", help=f"Complex images, both views in one: {SRC}.")] = None,
    left_only: Annotated[
        str | None, typer.Option(metavar="SRC", help="Images of the left view, the other path covered.")
    ] = None,
    right_only: Annotated[
        str | None, typer.Option(metavar="SRC", help="Images of the right view, of the same places of the board.")
    ] = None,
    board: Annotated[str | None, typer.Option("--board", metavar="BOARD", help=BOARD)] = None,
    out: Annotated[Path | None, typer.Option("-o", "--out", help="rig.yaml to write.")] = None,
    check: Annotated[
        bool, typer.Option("--check", help="Do not calibrate: tell how the mirrors stand, and which to turn.")
    ] = False,
    rig: Annotated[Path | None, typer.Option(help="With --check: rig.yaml as it was calibrated.")] = None,
    parallel: Annotated[
        bool, typer.Option("--parallel", help="With --check --rig: tell the turns that make the axes parallel.")
    ] = False,
    plate_mm: Annotated[
        float | None, typer.Option(min=0.0, help="Thickness of the plate; found from the views where not given.")
    ] = None,
    index: Annotated[float, typer.Option(min=1.0, max=3.0, help="Refractive index of the plate.")] = 1.5,
    baseline_mm: Annotated[float | None, typer.Option(min=1.0, help="Baseline as designed.")] = None,
    near_mm: Annotated[float, typer.Option(min=1.0, help="From the lens to the plate, along the axis.")] = 60.0,
    gap_mm: Annotated[float, typer.Option(min=1.0, help="From the plate to the mirror behind it.")] = 40.0,
    target: Annotated[
        Path | None, typer.Option(help="Instead of a board: target.yaml of the lit target in the images.")
    ] = None,
    camera: Annotated[
        Path | None, typer.Option(help="With --target, or with --check in place of --rig: camera.yaml of the lens.")
    ] = None,
    every: Every = 1,
    frames: Limit = None,
    workers: Workers = None,
    json: AsJson = False,
    camera_options: CameraOptions = NONE_GIVEN,
) -> None:
    """Calibrate a rig of one camera and four mirrors, or check that its mirrors still stand as they did."""
    with CommandUI(as_json=json) as face:
        from armsight.app.calibrate.cameras import report_path
        from armsight.app.calibrate.mirrors import MirrorsJob, run_mirrors
        from armsight.app.calibrate.mirrors_check import run_check
        from armsight.config import load_settings

        job = MirrorsJob(
            out=out,
            board=board or "",
            image=image,
            left_only=left_only,
            right_only=right_only,
            thickness_m=None if plate_mm is None else plate_mm / MM,
            index=index,
            baseline_m=None if baseline_mm is None else baseline_mm / MM,
            near_m=near_mm / MM,
            gap_m=gap_mm / MM,
            rig=rig,
            parallel=parallel,
            target=target,
            camera=camera,
            every=every,
            limit=frames,
            workers=workers if workers is not None else load_settings().workers,
            camera_settings=camera_options.settings(),
        )
        if check:
            found = run_check(job, face.progress("checking"))
            check_tables(face, found)
            face.result(found)
            return
        done = run_mirrors(job, face.progress("calibrating"))
        if out is not None:
            stereo_tables(face, done, out) if target is None else lit_table(face, done)
            alignment_tables(face, done)
            face.say(f"Written: {out}; open {report_path(out)}")
        face.result(done)


def lit_table(face: CommandUI, done: MirrorsOutput) -> None:
    """Print a rig's calibration from the lit target, with the commonest reasons of images left out."""
    from armsight.app.calibrate.mirrors_lit_target import reasons
    from armsight.records import NotSeen

    rows = [
        ["baseline, mm", figure(MM * done.baseline_m, 6)],
        ["baseline +-, mm", figure(MM * done.std["baseline_m"], 2)],
        ["reprojection, px RMS", figure(done.rms_px)],
        ["epipolar, px RMS", figure(done.epipolar_rms_px)],
    ]
    face.table(f"Rig, {done.n_used} of {done.n_pairs} images", ["", ""], rows)
    for seen, count in reasons([NotSeen(one.why) for one in done.rejected])[:REASONS_SHOWN]:
        face.say(f"  {count} left out: {seen.why}")


def alignment_tables(face: CommandUI, done: MirrorsOutput) -> None:
    """Print how the virtual cameras of a calibrated rig stand to each other, its plate, and what to do."""
    plate = done.alignment.plate
    rows = [
        *_alignment_rows(done.alignment),
        ["plate, mm", figure(MM * plate.thickness_m)],
        ["its shift m = l, mm", figure(MM * plate.m_m)],
    ]
    face.table("Alignment", ["", ""], rows)
    for line in done.advice:
        face.say(f"- {line}")


def check_tables(face: CommandUI, found: MirrorCheckOutput) -> None:
    """Print how the virtual cameras stand to each other now, and which mirror to turn."""
    face.table("Alignment", ["", ""], _alignment_rows(found.alignment))
    if found.turns:
        rows = [
            [f"mirror {one.mirror}", figure(MRAD * one.turn_rad), figure(MRAD * one.tilt_rad)] for one in found.turns
        ]
        face.table("Turns that make the axes parallel", ["", "about the vertical, mrad", "across, mrad"], rows)
    if found.suspects:
        rows = [
            [f"mirror {one.mirror}", figure(MRAD * one.turn_rad), figure(MRAD * one.tilt_rad), figure(one.chi2)]
            for one in found.suspects
        ]
        face.table("Which mirror has moved", ["", "about the vertical, mrad", "across, mrad", "chi-square left"], rows)
    for line in found.advice:
        face.say(f"- {line}")


def _alignment_rows(found: MirrorAlignment | CheckedAlignment) -> list[list[str]]:
    return [
        ["axes turn towards each other, mrad", figure(MRAD * found.convergence_rad)],
        ["right image lower, px", figure(found.vertical_px)],
        ["right image turned, mrad", figure(MRAD * found.roll_rad)],
    ]


def add_to(calibrate: typer.Typer) -> None:
    """Add this command to `armsight calibrate`."""
    calibrate.command("mirrors")(mirrors)
