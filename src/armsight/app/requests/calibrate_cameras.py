"""What the commands of `armsight calibrate` are told."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TypeAlias

from armsight.app.requests.shared import (
    A_SRC,
    OUT,
    SRC,
    ABoard,
    Bits,
    Cameras,
    Every,
    Limit,
    Strict,
    Workers,
    automatic,
)
from armsight.defaults import FOLDS, GLASS, MIRROR_GAP_M, PLATE_NEAR_M
from armsight.errors import UsageError
from armsight.fields import Bounds, Doc, Flag, Flags
from armsight.units import MM

if TYPE_CHECKING:
    from collections.abc import Callable

    from armsight.calibrate.cameras import BoardOptions
    from armsight.drivers import CameraSettings, ImageReading


Detector: TypeAlias = Annotated[
    str, Doc("How checkerboards are looked for: auto, quick, classic, sectors, xcorner."), Flag(metavar="NAME")
]
Lens: TypeAlias = Annotated[
    str,
    Doc("pinhole, or fisheye (OpenCV's fisheye, Kalibr's equidistant); of a pair also both: fisheye,pinhole."),
    Flag(metavar="NAME"),
]


@dataclass(frozen=True, kw_only=True)
class ZoomValue:
    """The zoom that a camera is calibrated at; pupil_m, pupil_std_m: the centre of projection's place, if known."""

    zoom: float
    pupil_m: float | None = None
    pupil_std_m: float = 0.0


@dataclass(frozen=True, kw_only=True)
class ZoomFlags:
    """A setting of a zoom lens, where one is named."""

    zoom: Annotated[
        float | None, Doc("A zoom lens's setting at which the images were taken: -o keeps its other settings.")
    ] = None
    pupil: Annotated[
        float | None,
        Doc("With --zoom: where the centre of projection stands along the axis, forward."),
        Flag(quantity="m"),
    ] = None
    pupil_std: Annotated[float, Doc("Its standard deviation."), Bounds(least=0.0), Flag(quantity="m")] = 0.0

    def made(self, notify: Callable[[str], None]) -> ZoomValue | None:
        """Return the setting. Raises UsageError for what is said about a zoom without one."""
        if self.pupil is None and self.pupil_std > 0.0 and self.zoom is not None:
            raise UsageError(
                "--pupil-std is the standard deviation of --pupil, which is not given", cure="Give --pupil"
            )
        if self.zoom is None:
            if self.pupil is not None or self.pupil_std > 0.0:
                raise zoom_missing()
            return None
        return ZoomValue(zoom=self.zoom, pupil_m=self.pupil, pupil_std_m=self.pupil_std)


def zoom_missing() -> UsageError:
    """Return the refusal of what is said about a zoom without one."""
    return UsageError(
        "--pupil, --pupil-std and --set-zoom belong to a setting of a zoom lens, and --zoom is not given",
        cure="Give --zoom with the value that the lens stands at",
    )


@dataclass(frozen=True, kw_only=True)
class CameraJob:
    """Images of a board, for one camera; or with noise alone its still frames (source and board are then empty).

    zoom: of a zoom lens; out then keeps its other settings. folds: of the left-out error.
    """

    out: Annotated[Path, Doc("camera.yaml to write; with --noise alone, to add to."), OUT]
    source: Annotated[str, Doc(f"Images of the board: {SRC}."), Flag(positional=True, metavar="[SRC]")] = ""
    board: ABoard = ""
    noise: Annotated[
        str | None,
        Doc("4 to 50 still frames of any scene, as SRC, for the camera's noise; or a file with it."),
        Flag(metavar="FRAMES"),
    ] = None
    side: Annotated[
        str | None, Doc("With --noise and a rig.yaml: left or right, the frames' camera."), Flag(metavar="SIDE")
    ] = None
    zoom: Annotated[ZoomValue | None, Flags(ZoomFlags)] = None
    set_zoom: Annotated[bool, Doc("Set the live camera SRC to --zoom first.")] = False
    every: Every = 1
    limit: Limit = None
    workers: Workers = None
    detector: Detector = "auto"
    lens: Lens = "pinhole"
    bits: Bits = None
    strict: Strict = False
    camera_settings: Cameras = field(default_factory=automatic)
    folds: int = FOLDS

    def __post_init__(self) -> None:
        if self.set_zoom and self.zoom is None:
            raise zoom_missing()

    @property
    def asked(self) -> CameraSettings:
        """What is asked of a live camera, its zoom with it."""
        zoomed = self.zoom if self.set_zoom else None
        return self.camera_settings if zoomed is None else replace(self.camera_settings, zoom=zoomed.zoom)

    @property
    def noise_alone(self) -> bool:
        """Whether nothing but still frames was given."""
        return self.noise is not None and not self.source and not self.board and self.zoom is None

    @property
    def options(self) -> BoardOptions:
        """What the calibration is free to do; UsageError for a lens that there is not, or that cannot zoom."""
        made = board_options(self.lens, self.folds, most=1)
        if "fisheye" in self.lens and self.zoom is not None:
            raise UsageError("a fisheye lens with --zoom", cure="Settings of a zoom lens are pinholes: leave one away")
        return made

    @property
    def reading(self) -> ImageReading:
        """How image files are read; one that cannot be is left out unless the job is strict."""
        return image_reading(self.bits, strict=self.strict)


@dataclass(frozen=True, kw_only=True)
class StereoJob:
    """Pairs of images of a board, for both cameras of a rig. folds: of the left-out error."""

    left: Annotated[str, Doc(f"Left images of the board: {SRC}."), A_SRC]
    right: Annotated[str, Doc("Right images, taken at the same moments."), A_SRC]
    board: ABoard
    out: Annotated[Path, Doc("rig.yaml to write."), OUT]
    every: Every = 1
    limit: Limit = None
    workers: Workers = None
    detector: Detector = "auto"
    lens: Lens = "pinhole"
    bits: Bits = None
    strict: Strict = False
    camera_settings: Cameras = field(default_factory=automatic)
    folds: int = FOLDS

    @property
    def options(self) -> BoardOptions:
        """What the calibration is free to do; UsageError for a lens that there is not."""
        return board_options(self.lens, self.folds, most=2)

    @property
    def reading(self) -> ImageReading:
        """How image files are read; one that cannot be is left out unless the job is strict."""
        return image_reading(self.bits, strict=self.strict)


def board_options(lens: str, folds: int, *, most: int) -> BoardOptions:
    """Return the options of a calibration with one kind of lens, or of a pair with two. Raises UsageError."""
    from armsight.calibrate.cameras import BoardOptions
    from armsight.optics import LensKind

    names = lens.split(",")
    for name in names:
        if name not in list(LensKind):
            raise UsageError(
                f"{name[:40]!r} is not a kind of lens", cure=f"Give --lens with one of {', '.join(LensKind)}"
            )
    if len(names) > most:
        raise UsageError(
            f"{len(names)} kinds of lens are given", cure="Give one, or for a pair left and right: fisheye,pinhole"
        )
    return BoardOptions(folds=folds, lens=LensKind(names[0]), right_lens=LensKind(names[-1]))


def image_reading(bits: int | None, *, strict: bool) -> ImageReading:
    """Return how image files are read."""
    from armsight.drivers import ImageReading

    return ImageReading(bits=bits, strict=strict)


@dataclass(frozen=True, kw_only=True)
class ZoomRigJob:
    """A rig, the settings of its lenses, the zooms it was calibrated at, and where the result goes."""

    rig: Annotated[Path, Doc("rig.yaml from `armsight calibrate stereo`, at one setting of each lens.")]
    out: Annotated[Path, Doc("rig.yaml to write."), OUT]
    left: Annotated[Path | None, Doc("camera.yaml with the left lens's settings.")] = None
    right: Annotated[Path | None, Doc("The same of the right lens.")] = None
    zoom_left: Annotated[float | None, Doc("Where the left lens stood for the rig.")] = None
    zoom_right: Annotated[float | None, Doc("Where the right lens stood.")] = None


@dataclass(frozen=True, kw_only=True)
class MirrorsJob:
    """What shows the mirror rig, and how it was built. left_only, right_only: of the same moments.

    thickness_m: None to find it, 0 for no plate. parallel: hold the mirrors against parallel axes all the same. folds:
    of the left-out error.
    """

    image: Annotated[str | None, Doc(f"Complex images, both views in one: {SRC}."), A_SRC] = None
    left_only: Annotated[str | None, Doc("Images of the left view, the other path covered."), A_SRC] = None
    right_only: Annotated[str | None, Doc("Images of the right view, of the same places of the board."), A_SRC] = None
    board: ABoard = ""
    out: Annotated[Path | None, Doc("rig.yaml to write."), OUT] = None
    check: Annotated[bool, Doc("Do not calibrate: tell how the mirrors stand, and which to turn.")] = False
    rig: Annotated[Path | None, Doc("With --check: rig.yaml as it was calibrated.")] = None
    parallel: Annotated[bool, Doc("With --check --rig: tell the turns that make the axes parallel.")] = False
    thickness_m: Annotated[
        float | None,
        Doc("Thickness of the plate; found from the views where not given."),
        Bounds(least=0.0),
        Flag("--plate-mm", unit=MM),
    ] = None
    index: Annotated[float, Doc("Refractive index of the plate."), Bounds(least=1.0, most=3.0)] = GLASS
    baseline_m: Annotated[float | None, Doc("Baseline as designed."), Bounds(least=1.0 * MM), Flag(unit=MM)] = None
    near_m: Annotated[
        float, Doc("From the lens to the plate, along the axis."), Bounds(least=1.0 * MM), Flag(unit=MM)
    ] = PLATE_NEAR_M
    gap_m: Annotated[float, Doc("From the plate to the mirror behind it."), Bounds(least=1.0 * MM), Flag(unit=MM)] = (
        MIRROR_GAP_M
    )
    target: Annotated[Path | None, Doc("Instead of a board: target.yaml of the lit target in the images.")] = None
    camera: Annotated[
        Path | None, Doc("With --target, or with --check in place of --rig: camera.yaml of the lens.")
    ] = None
    every: Every = 1
    limit: Limit = None
    workers: Workers = None
    camera_settings: Cameras = field(default_factory=automatic)
    folds: int = FOLDS
