"""armsight calibrate."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, TypeAlias

import typer

from armsight.cli.face import Face
from armsight.cli.options import SRC, AsJson, Board, Every, Limit, Workers
from armsight.cli.tables import camera_tables, stereo_tables

Detector: TypeAlias = Annotated[
    str,
    typer.Option(
        "--detector", metavar="NAME", help="How checkerboards are looked for: auto, classic, sectors, xcorner."
    ),
]

calibrate = typer.Typer(help="Calibrate a camera, or a pair of cameras.", no_args_is_help=True)


@calibrate.command("camera")
def camera(
    source: Annotated[str, typer.Argument(metavar="SRC", help=f"Images of the board: {SRC}.")],
    board: Board,
    out: Annotated[Path, typer.Option("-o", "--out", help="camera.yaml to write.")],
    every: Every = 1,
    frames: Limit = None,
    workers: Workers = None,
    detector: Detector = "auto",
    json: AsJson = False,
) -> None:
    """Find one camera's focal lengths, centre and distortion from images of a printed board."""
    with Face(as_json=json) as face:
        from armsight.app.calibrate import CalibrateJob, calibrate_camera
        from armsight.config import load_settings

        job = CalibrateJob(
            board=board,
            out=out,
            source=source,
            every=every,
            limit=frames,
            workers=workers if workers is not None else load_settings().workers,
            detector=detector,
        )
        content = calibrate_camera(job, face.progress("calibrating"))
        camera_tables(face, content, out)
        face.result(content)


@calibrate.command("stereo")
def stereo(
    left: Annotated[str, typer.Option(metavar="SRC", help=f"Left images of the board: {SRC}.")],
    right: Annotated[str, typer.Option(metavar="SRC", help="Right images, taken at the same moments.")],
    board: Board,
    out: Annotated[Path, typer.Option("-o", "--out", help="rig.yaml to write.")],
    every: Every = 1,
    frames: Limit = None,
    workers: Workers = None,
    detector: Detector = "auto",
    json: AsJson = False,
) -> None:
    """Find both cameras of a pair and where they stand to each other, from pairs of images of a printed board."""
    with Face(as_json=json) as face:
        from armsight.app.calibrate import CalibrateJob, calibrate_stereo
        from armsight.config import load_settings

        job = CalibrateJob(
            board=board,
            out=out,
            left=left,
            right=right,
            every=every,
            limit=frames,
            workers=workers if workers is not None else load_settings().workers,
            detector=detector,
        )
        content = calibrate_stereo(job, face.progress("calibrating"))
        stereo_tables(face, content, out)
        face.result(content)
