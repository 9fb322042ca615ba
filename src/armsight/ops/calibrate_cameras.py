"""Cameras and pairs of them from images of a printed board, and rigs whose lenses zoom."""

from __future__ import annotations

from pathlib import Path
from types import NoneType
from typing import TYPE_CHECKING, Annotated, Any, TypeAlias

from armsight.errors import UsageError
from armsight.fields import Bounds, Doc, Flag
from armsight.ops.action import action
from armsight.ops.flags import (
    SRC,
    Bits,
    Cameras,
    Every,
    Limit,
    Strict,
    Workers,
)
from armsight.ops.kinds import (
    IMAGES,
    NOISE,
    ZOOM_LENS,
    BoardLike,
    RigLike,
)

if TYPE_CHECKING:
    from armsight.calibrate.cameras import BoardOptions, CameraCalibration, StereoCalibration
    from armsight.calibrate.cameras.zoom import ZoomRigResult
    from armsight.drivers import CameraSettings
    from armsight.records import Progress

__all__ = ["calibrate_camera", "calibrate_stereo", "calibrate_zoom_rig"]

Images: TypeAlias = Annotated[Any, Doc(f"Images of the board: {SRC}."), IMAGES, Flag(positional=True, metavar="[SRC]")]
LeftImages: TypeAlias = Annotated[Any, Doc(f"Left images of the board: {SRC}."), IMAGES, Flag("--left", metavar="SRC")]
RightImages: TypeAlias = Annotated[
    Any, Doc("Right images, taken at the same moments."), IMAGES, Flag("--right", metavar="SRC")
]
StillFrames: TypeAlias = Annotated[
    Any,
    Doc("4 to 50 still frames of any scene, as SRC, for the camera's noise; or a file with it."),
    NOISE,
    Flag(metavar="FRAMES"),
]
Side: TypeAlias = Annotated[
    str | None, Doc("With --noise and a rig.yaml: left or right, the frames' camera."), Flag(metavar="SIDE")
]
Zoom: TypeAlias = Annotated[
    float | None, Doc("A zoom lens's setting at which the images were taken: -o keeps its other settings.")
]
Pupil: TypeAlias = Annotated[
    float | None,
    Doc("With --zoom: where the centre of projection stands along the axis, forward."),
    Flag(quantity="m"),
]
PupilStd: TypeAlias = Annotated[float, Doc("Its standard deviation."), Bounds(least=0.0), Flag(quantity="m")]
Detector: TypeAlias = Annotated[
    str, Doc("How checkerboards are looked for: auto, quick, classic, sectors, xcorner."), Flag(metavar="NAME")
]
Lens: TypeAlias = Annotated[
    str,
    Doc(
        "pinhole, rational (OpenCV's, with k1 to k6), or fisheye (OpenCV's fisheye, Kalibr's equidistant); of a pair "
        "also two: fisheye,pinhole. auto: the one that leaves least on images left out."
    ),
    Flag(metavar="NAME"),
]
CameraOut: TypeAlias = Annotated[
    Path | None, Doc("camera.yaml to write; with --noise alone, to add to."), Flag("-o --out", needed=True)
]
RigOut: TypeAlias = Annotated[Path | None, Doc("rig.yaml to write."), Flag("-o --out", needed=True)]


AUTO = "auto"
"""--lens where the kind that leaves least is to be taken."""


@action(
    "calibrate camera",
    working="calibrating",
    examples=("images/ --board checkerboard:9x6:0.025 -o camera.yaml",),
    filed=True,
    judged=True,
    writes="write_calibrated_camera",
)
def calibrate_camera(
    images: Images = None,
    board: BoardLike = None,
    *,
    options: BoardOptions | None = None,
    noise: StillFrames = None,
    side: Side = None,
    zoom: Zoom = None,
    pupil_m: Pupil = None,
    pupil_std_m: PupilStd = 0.0,
    set_zoom: Annotated[bool, Doc("Set the live camera SRC to --zoom first.")] = False,
    every: Every = 1,
    frames: Limit = None,
    workers: Workers = None,
    detector: Detector = "auto",
    lens: Lens = "pinhole",
    bits: Bits = None,
    strict: Strict = False,
    camera_settings: Cameras | None = None,
    out: CameraOut = None,
    progress: Progress | None = None,
) -> CameraCalibration:
    """Find one camera's focal lengths, centre and distortion from images of a printed board, and its noise.

    --every and --frames are of the board's images; without them of the still frames.

    Parameters
    ----------
    images
        uint8 arrays (h, w) or (h, w, 3), paths, or frames as `measure` takes them; ten or more, the board tilted
        differently in each.
    board
        'checkerboard:9x6:0.025' (inner corners, side of a square in m), 'circles:CxR:PITCH', 'acircles:CxR:PITCH',
        'charuco:CxR:SQUARE:MARKER:DICTIONARY', 'aprilgrid:CxR:TAG:SPACING', a file (Kalibr's too), or a Target.
    options
        What is held fixed, the kind of lens, and how outliers are rejected; without them the lens is `lens`.
    noise
        Still frames, a file that holds the camera's noise, or a NoiseModel.
    zoom, pupil_m, pupil_std_m
        Of a zoom lens, the setting at which the images were taken, and where the centre of projection stands along the
        axis in m, forward; the file `out` keeps the lens's other settings.
    every, frames
        Take every n-th image, and so many at most.
    detector
        How checkerboards are looked for.
    bits
        Of the light in 16-bit images, such as 12.
    out
        camera.yaml to write, its report beside it.

    Raises
    ------
    NotEnoughData
        The board is seen in too few images.
    Degenerate, Undetermined
        The views leave something open; the message names it.
    Inconsistent
        Images of different sizes.
    NotConverged
        The fit found no answer.
    BadImage
        One of them is no image.
    """
    from armsight.ops.calibration import cameras as app
    from armsight.ops.calibration.board_pictures import BoardPictures
    from armsight.ops.calibration.reports import write_camera_report

    _require_board(images, board, side)
    _require_zoom(zoom, pupil_m, pupil_std_m, set_zoom, out)
    options, pictures = board_options(options, lens, most=1, zoom=zoom), BoardPictures()
    settings = camera_asked(camera_settings, zoom if set_zoom else None)
    known = app.noise_of(noise, settings, progress)
    with app.open_images(images, settings=settings, bits=bits, strict=strict) as source:
        seen = app.find_boards(source, board, pictures, progress, detector, every, frames, threads(workers))
    done = app.solved_camera(seen, board, options, progress, known)
    if zoom is not None:
        done = app.with_zoom(done, zoom, pupil_m, pupil_std_m, out)
    if out is not None:
        write_camera_report(out, done, board, pictures)
    return done


@action(
    "calibrate stereo",
    working="calibrating",
    examples=("--left images/left --right images/right --board checkerboard:9x6:0.025 -o rig.yaml",),
    filed=True,
    judged=True,
    writes="write_rig_of",
)
def calibrate_stereo(
    left_images: LeftImages,
    right_images: RightImages,
    board: BoardLike,
    *,
    options: BoardOptions | None = None,
    every: Every = 1,
    frames: Limit = None,
    workers: Workers = None,
    detector: Detector = "auto",
    lens: Lens = "pinhole",
    bits: Bits = None,
    strict: Strict = False,
    camera_settings: Cameras | None = None,
    out: RigOut = None,
    progress: Progress | None = None,
) -> StereoCalibration:
    """Find both cameras of a pair and where they stand to each other, from pairs of images of a printed board.

    Parameters
    ----------
    left_images
        As calibrate_camera takes them.
    right_images
        As many, in the same order.
    board
        As calibrate_camera takes it.
    options, every, frames, detector, bits
        As calibrate_camera takes them; a pair may have two lenses.
    out
        rig.yaml to write, its report beside it.

    Raises
    ------
    Inconsistent
        Not as many left as right images; else as calibrate_camera.
    """
    from armsight.ops.calibration import cameras as app
    from armsight.ops.calibration.board_pictures import BoardPictures
    from armsight.ops.calibration.reports import write_stereo_report

    options, settings, pictures = board_options(options, lens, most=2), camera_asked(camera_settings), BoardPictures()
    with app.open_images(left_images, right_images, settings=settings, bits=bits, strict=strict) as source:
        seen = app.find_boards(source, board, pictures, progress, detector, every, frames, threads(workers))
    done = app.solved_pair(seen, board, options, progress)
    if out is not None:
        write_stereo_report(out, done, board, pictures)
    return done


@action(
    "calibrate zoom-rig",
    examples=("--rig rig.yaml --left left-zoom.yaml --zoom-left 35 --zoom-right 35 -o zoomed.yaml",),
    writes="write_rig_of",
)
def calibrate_zoom_rig(
    rig: Annotated[RigLike, Doc("rig.yaml from `armsight calibrate stereo`, at one setting of each lens.")],
    left: Annotated[Any, Doc("camera.yaml with the left lens's settings."), ZOOM_LENS] = None,
    right: Annotated[Any, Doc("The same of the right lens."), ZOOM_LENS] = None,
    *,
    zoom_left: Annotated[float | None, Doc("Where the left lens stood for the rig.")] = None,
    zoom_right: Annotated[float | None, Doc("Where the right lens stood.")] = None,
    out: RigOut = None,
) -> ZoomRigResult:
    """Give a calibrated rig the settings of its zoom lenses: `measure --zoom-left --zoom-right` then takes any of them.

    The right camera's place, found at one setting of each lens, holds for all of them.

    Parameters
    ----------
    rig
        As calibrated at one setting of each lens.
    left, right
        camera.yaml with a lens's settings, as `calibrate_camera(zoom, out)` gathers them.
    zoom_left, zoom_right
        Where the lenses stood for the rig.
    out
        rig.yaml to write.

    Raises
    ------
    UsageError, Inconsistent
        No lens is given, or one that is not the rig's.
    """
    from armsight.calibrate.cameras.zoom import rig_with_lenses

    return rig_with_lenses(rig, (left, right), (zoom_left, zoom_right))


def _require_board(images: object, board: object, side: str | None) -> None:
    """Raise UsageError where a camera is to be calibrated from half of what that takes."""
    if images is None or board is None:
        raise UsageError(
            "the images of the board, SRC, are not given" if images is None else "the board, --board, is not given",
            cure="Give SRC and --board; or --noise FRAMES alone, with the file to add to as -o",
        )
    if side is not None:
        raise UsageError("--side is of a rig.yaml, and a board's images make a camera.yaml", cure="Leave --side away")


def _require_zoom(
    zoom: float | None, pupil_m: float | None, pupil_std_m: float, set_zoom: bool, out: Path | None
) -> None:
    """Raise UsageError for what is said about a zoom without one, BadFile where `out` is no zoom lens's file."""
    if zoom is None:
        if pupil_m is not None or pupil_std_m > 0.0 or set_zoom:
            raise UsageError(
                "--pupil, --pupil-std and --set-zoom belong to a setting of a zoom lens, and --zoom is not given",
                cure="Give --zoom with the value that the lens stands at",
            )
        return
    if pupil_m is None and pupil_std_m > 0.0:
        raise UsageError("--pupil-std is the standard deviation of --pupil, which is not given", cure="Give --pupil")
    if out is not None and out.exists():
        from armsight.store import read_zoom_camera

        read_zoom_camera(out)  # before all work: nobody should wait for a result that has no place


def camera_asked(given: CameraSettings | None, zoom: float | None = None) -> CameraSettings:
    """Return what is asked of a live camera, its zoom with it where that is to be set."""
    from dataclasses import replace

    from armsight.drivers import AUTOMATIC

    settings = given or AUTOMATIC
    return settings if zoom is None else replace(settings, zoom=zoom)


def board_options(given: BoardOptions | None, lens: str, *, most: int, zoom: float | None = None) -> BoardOptions:
    """Return the options, those of one kind of lens where none are given, or of a pair with two. Raises UsageError."""
    from armsight.calibrate.cameras import BoardOptions
    from armsight.optics import LensKind
    from armsight.records import require_kind

    require_kind("options", given, BoardOptions, NoneType, cure="Give BoardOptions(...)")
    names = ["pinhole"] if lens == AUTO else lens.split(",")
    for name in names:
        if name not in list(LensKind):
            raise UsageError(
                f"{name[:40]!r} is not a kind of lens", cure=f"Give --lens with one of {', '.join(LensKind)}, or auto"
            )
    if len(names) > most:
        raise UsageError(
            f"{len(names)} kinds of lens are given", cure="Give one, or for a pair left and right: fisheye,pinhole"
        )
    options = given or BoardOptions(lens=LensKind(names[0]), right_lens=LensKind(names[-1]), choose_lens=lens == AUTO)
    if zoom is not None and (options.choose_lens or {*options.lenses} != {LensKind.PINHOLE}):
        raise UsageError(f"--lens {lens} with --zoom", cure="Settings of a zoom lens are pinholes: leave one away")
    return options


def threads(given: int | None) -> int | None:
    """Return how many threads read images: as given, else as the settings have it."""
    from armsight.config import load_settings

    return load_settings().workers if given is None else given
