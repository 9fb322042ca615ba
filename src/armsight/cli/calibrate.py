"""armsight calibrate."""

from __future__ import annotations

from math import isfinite
from pathlib import Path
from typing import Annotated, TypeAlias

import typer

from armsight.cli.camera_options import NONE_GIVEN, CameraOptions, takes_cameras
from armsight.cli.command_ui import CommandUI
from armsight.cli.options import BOARD, SRC, AsJson, Bits, Board, Every, Limit, Strict, Workers, quantity
from armsight.cli.tables import camera_tables, noise_tables, stereo_tables, zoom_rig_tables, zoom_tables
from armsight.errors import UsageError

Detector: TypeAlias = Annotated[
    str,
    typer.Option(
        "--detector", metavar="NAME", help="How checkerboards are looked for: auto, classic, sectors, xcorner."
    ),
]

Lens: TypeAlias = Annotated[
    str,
    typer.Option(
        "--lens",
        metavar="NAME",
        help="pinhole, or fisheye (OpenCV's fisheye, Kalibr's equidistant); of a pair also both: fisheye,pinhole.",
    ),
]

calibrate = typer.Typer(
    help="Calibrate cameras, hand-eye, a tool's tip, an arm (calibrate arm), where the rig stands, targets and clocks.",
    no_args_is_help=True,
)


@calibrate.command("camera")
@takes_cameras
def camera(
    out: Annotated[Path, typer.Option("-o", "--out", help="camera.yaml to write; with --noise alone, to add to.")],
    source: Annotated[str | None, typer.Argument(metavar="[SRC]", help=f"Images of the board: {SRC}.")] = None,
    board: Annotated[str | None, typer.Option("--board", metavar="BOARD", help=BOARD)] = None,
    noise: Annotated[
        str | None,
        typer.Option(
            metavar="FRAMES",
            help="4 to 50 still frames of any scene, as SRC, for the camera's noise; or a file with it.",
        ),
    ] = None,
    side: Annotated[
        str | None, typer.Option(metavar="SIDE", help="With --noise and a rig.yaml: left or right, the frames' camera.")
    ] = None,
    zoom: Annotated[
        float | None,
        typer.Option(help="A zoom lens's setting at which the images were taken: -o keeps its other settings."),
    ] = None,
    pupil: Annotated[
        float | None,
        typer.Option(
            help="With --zoom: where the centre of projection stands along the axis, forward.", **quantity("m")
        ),
    ] = None,
    pupil_std: Annotated[float, typer.Option(help="Its standard deviation.", **quantity("m", 0.0))] = 0.0,
    set_zoom: Annotated[bool, typer.Option("--set-zoom", help="Set the live camera SRC to --zoom first.")] = False,
    every: Every = 1,
    frames: Limit = None,
    workers: Workers = None,
    detector: Detector = "auto",
    lens: Lens = "pinhole",
    bits: Bits = None,
    strict: Strict = False,
    json: AsJson = False,
    camera_options: CameraOptions = NONE_GIVEN,
) -> None:
    """Find one camera's focal lengths, centre and distortion from images of a printed board, and its noise.

    --every and --frames are of the board's images; without them of the still frames.
    """
    with CommandUI(as_json=json) as face:
        from armsight.app.calibrate.camera_noise import NoiseJob, run_noise
        from armsight.app.calibrate.cameras import CalibrateJob, calibrate_camera
        from armsight.app.calibrate.zoom import ZoomValue
        from armsight.config import load_settings

        _require_zoom(zoom, pupil, pupil_std, set_zoom)
        asked = camera_options.settings(zoom=zoom if set_zoom else None)
        if noise is not None and source is None and board is None and zoom is None:
            alone = NoiseJob(frames=noise, out=out, side=side, every=every, limit=frames, camera_settings=asked)
            found = run_noise(alone, face.progress("calibrating"))
            noise_tables(face, found.noise, out)
            face.result(found)
            return
        _require_board(source, board, side)
        job = CalibrateJob(
            board=board or "",
            out=out,
            source=source or "",
            every=every,
            limit=frames,
            workers=workers if workers is not None else load_settings().workers,
            detector=detector,
            noise=noise,
            zoom=None if zoom is None else ZoomValue(zoom=zoom, pupil_m=pupil, pupil_std_m=pupil_std),
            camera_settings=asked,
            bits=bits,
            strict=strict,
            lens=lens,
        )
        done = calibrate_camera(job, face.progress("calibrating"))
        camera_tables(face, done, out)
        if done.zoom is not None:
            zoom_tables(face, done.zoom)
        if done.noise is not None:
            noise_tables(face, done.noise, out)
        face.result(done)


def _require_zoom(zoom: float | None, pupil: float | None, pupil_std: float, set_zoom: bool) -> None:
    """Raise UsageError for what is said about a zoom without one, or that is no number."""
    for name, value in (("zoom", zoom), ("pupil", pupil), ("pupil-std", pupil_std)):
        if value is not None and not isfinite(value):
            raise UsageError(f"--{name} {value} is not a finite number", cure="Give the value as the lens counts it")
    if zoom is None and (pupil is not None or pupil_std > 0.0 or set_zoom):
        raise UsageError(
            "--pupil, --pupil-std and --set-zoom belong to a setting of a zoom lens, and --zoom is not given",
            cure="Give --zoom with the value that the lens stands at",
        )
    if pupil is None and pupil_std > 0.0:
        raise UsageError("--pupil-std is the standard deviation of --pupil, which is not given", cure="Give --pupil")


def _require_board(source: str | None, board: str | None, side: str | None) -> None:
    """Raise UsageError where a camera is to be calibrated from half of what that takes."""
    if source is None or board is None:
        what = "the images of the board, SRC," if source is None else "the board, --board,"
        raise UsageError(
            f"{what} is not given" if source is not None else f"{what} are not given",
            cure="Give SRC and --board; or --noise FRAMES alone, with the file to add to as -o",
        )
    if side is not None:
        raise UsageError("--side is of a rig.yaml, and a board's images make a camera.yaml", cure="Leave --side away")


@calibrate.command("stereo")
@takes_cameras
def stereo(
    left: Annotated[str, typer.Option(metavar="SRC", help=f"Left images of the board: {SRC}.")],
    right: Annotated[str, typer.Option(metavar="SRC", help="Right images, taken at the same moments.")],
    board: Board,
    out: Annotated[Path, typer.Option("-o", "--out", help="rig.yaml to write.")],
    every: Every = 1,
    frames: Limit = None,
    workers: Workers = None,
    detector: Detector = "auto",
    lens: Lens = "pinhole",
    bits: Bits = None,
    strict: Strict = False,
    json: AsJson = False,
    camera_options: CameraOptions = NONE_GIVEN,
) -> None:
    """Find both cameras of a pair and where they stand to each other, from pairs of images of a printed board."""
    with CommandUI(as_json=json) as face:
        from armsight.app.calibrate.cameras import CalibrateJob, calibrate_stereo
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
            camera_settings=camera_options.settings(),
            bits=bits,
            strict=strict,
            lens=lens,
        )
        done = calibrate_stereo(job, face.progress("calibrating"))
        stereo_tables(face, done, out)
        face.result(done)


@calibrate.command("zoom-rig")
def zoom_rig(
    rig: Annotated[Path, typer.Option(help="rig.yaml from `armsight calibrate stereo`, at one setting of each lens.")],
    out: Annotated[Path, typer.Option("-o", "--out", help="rig.yaml to write.")],
    left: Annotated[Path | None, typer.Option(help="camera.yaml with the left lens's settings.")] = None,
    right: Annotated[Path | None, typer.Option(help="The same of the right lens.")] = None,
    zoom_left: Annotated[float | None, typer.Option(help="Where the left lens stood for the rig.")] = None,
    zoom_right: Annotated[float | None, typer.Option(help="Where the right lens stood.")] = None,
    json: AsJson = False,
) -> None:
    """Give a calibrated rig the settings of its zoom lenses: `measure --zoom-left --zoom-right` then takes any of them.

    The right camera's place, found at one setting of each lens, holds for all of them.
    """
    with CommandUI(as_json=json) as face:
        from armsight.app.calibrate.zoom import ZoomRigJob
        from armsight.app.calibrate.zoom import zoom_rig as run

        job = ZoomRigJob(rig=rig, out=out, left=left, right=right, zoom_left=zoom_left, zoom_right=zoom_right)
        done = run(job)
        zoom_rig_tables(face, done, out)
        face.result(done)
