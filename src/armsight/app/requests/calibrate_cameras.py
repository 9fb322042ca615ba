"""What the commands of `armsight calibrate` are told."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from armsight.app.requests.shared import (
    A_SRC,
    OUT,
    SRC,
    ABoard,
    Cameras,
    Every,
    Limit,
    Workers,
    automatic,
)
from armsight.defaults import FOLDS, GLASS, MIRROR_GAP_M, PLATE_NEAR_M
from armsight.fields import Bounds, Doc, Flag
from armsight.units import MM

if TYPE_CHECKING:
    from armsight.drivers import CameraSettings, ImageReading


def image_reading(bits: int | None, *, strict: bool) -> ImageReading:
    """Return how image files are read."""
    from armsight.drivers import ImageReading

    return ImageReading(bits=bits, strict=strict)


@dataclass(frozen=True, kw_only=True)
class NoiseJob:
    """Still frames (a source as on the command line), or a camera.yaml or rig.yaml that holds the noise; where it goes.

    out: the camera.yaml or rig.yaml. side: which camera of a rig. every, limit: of the frames.
    """

    frames: str
    out: Path
    side: str | None = None
    every: Every = 1
    limit: Limit = None
    camera_settings: CameraSettings = field(default_factory=automatic)


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
