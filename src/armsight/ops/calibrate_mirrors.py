"""A rig of one camera and four mirrors: calibrated from a board or the lit target, and its mirrors checked."""

from __future__ import annotations

from pathlib import Path
from types import NoneType
from typing import TYPE_CHECKING, Annotated, Any, TypeAlias

from armsight.defaults import GLASS, MIRROR_GAP_M, PLATE_NEAR_M
from armsight.fields import Bounds, Doc, Flag
from armsight.ops.action import action
from armsight.ops.calibrate_cameras import camera_asked, threads
from armsight.ops.flags import SRC, Cameras, Every, Limit, Workers
from armsight.ops.kinds import CAMERA, FRAMES, IMAGES, LIGHTS, BoardLike, RigLike
from armsight.units import MM

if TYPE_CHECKING:
    from collections.abc import Sequence

    from armsight.calibrate.cameras import BoardOptions
    from armsight.calibrate.mirrors.result import MirrorCheckOutput, MirrorsOutput
    from armsight.drivers import CameraSettings
    from armsight.ops.calibration.board_pictures import BoardPictures
    from armsight.optics import Camera
    from armsight.records import Frame, Progress, Target
    from armsight.store.cell_file import CellMirrors

    Images = str | Sequence[Frame] | None

__all__ = ["calibrate_mirrors", "check_mirrors"]

ComplexImages: TypeAlias = Annotated[
    Any, Doc(f"Complex images, both views in one: {SRC}."), IMAGES, Flag("--image", metavar="SRC")
]
LeftOnly: TypeAlias = Annotated[
    Any, Doc("Images of the left view, the other path covered."), IMAGES, Flag(metavar="SRC")
]
RightOnly: TypeAlias = Annotated[
    Any, Doc("Images of the right view, of the same places of the board."), IMAGES, Flag(metavar="SRC")
]
LensCamera: TypeAlias = Annotated[
    Any, Doc("With --target, or with --check in place of --rig: camera.yaml of the lens."), CAMERA
]
Lights: TypeAlias = Annotated[Any, Doc("Instead of a board: target.yaml of the lit target in the images."), LIGHTS]
Thickness: TypeAlias = Annotated[
    float | None,
    Doc("Thickness of the plate; found from the views where not given."),
    Bounds(least=0.0),
    Flag("--plate-mm", unit=MM),
]
Index: TypeAlias = Annotated[float, Doc("Refractive index of the plate."), Bounds(least=1.0, most=3.0)]
Baseline: TypeAlias = Annotated[float | None, Doc("Baseline as designed."), Bounds(least=1.0 * MM), Flag(unit=MM)]
Near: TypeAlias = Annotated[
    float, Doc("From the lens to the plate, along the axis."), Bounds(least=1.0 * MM), Flag(unit=MM)
]
Gap: TypeAlias = Annotated[float, Doc("From the plate to the mirror behind it."), Bounds(least=1.0 * MM), Flag(unit=MM)]


@action(
    "calibrate mirrors",
    working="calibrating",
    examples=(
        "--image board/ --board circles:7x11:0.02 -o rig.yaml",
        "--check --image board/ --rig rig.yaml --board circles:7x11:0.02 -o checked.yaml",
    ),
    filed=True,
    writes="write_rig_of",
)
def calibrate_mirrors(
    images: ComplexImages = None,
    board: BoardLike = None,
    *,
    left_only: LeftOnly = None,
    right_only: RightOnly = None,
    thickness_m: Thickness = None,
    index: Index = GLASS,
    baseline_m: Baseline = None,
    near_m: Near = PLATE_NEAR_M,
    gap_m: Gap = MIRROR_GAP_M,
    camera: LensCamera = None,
    target: Lights = None,
    options: BoardOptions | None = None,
    every: Every = 1,
    frames: Limit = None,
    workers: Workers = None,
    camera_settings: Cameras | None = None,
    out: Annotated[Path | None, Doc("rig.yaml to write."), Flag("-o --out")] = None,
    progress: Progress | None = None,
) -> MirrorsOutput:
    """Calibrate a rig of one camera and four mirrors, or check that its mirrors still stand as they did.

    Parameters
    ----------
    images
        As calibrate_camera takes them, each of both views over each other.
    board
        As calibrate_camera takes it.
    left_only, right_only
        Images of one view, the other path covered, of the same places of the board.
    thickness_m, index
        Of the glass plate: thickness in m, None to find it, 0 for none; refractive index.
    target, camera, baseline_m, near_m, gap_m
        In place of a board the lit target, with the lens as it was calibrated and the mirrors as designed, m.
    options
        What is held fixed, and how outliers are rejected.
    every, frames
        Take every n-th image, and so many at most.
    out
        rig.yaml to write, its report beside it.

    Raises
    ------
    NotEnoughData
        The board is seen twice in too few images; else as calibrate_camera.
    """
    from armsight.ops.calibration.board_pictures import BoardPictures
    from armsight.ops.calibration.mirrors import require_shown
    from armsight.ops.calibration.reports import write_mirrors_report
    from armsight.store.cell_file import CellMirrors

    require_shown(board, target, images, left_only, right_only)
    built = CellMirrors(baseline_m=baseline_m, near_m=near_m, gap_m=gap_m, plate_m=thickness_m, index=index)
    pictures, settings = BoardPictures(), camera_asked(camera_settings)
    if target is not None:
        done = _from_lights(images, target, camera, built, settings, every, frames, progress)
    else:
        sources = (images, left_only, right_only)
        search = (every, frames, threads(workers))
        done = _from_board(sources, board, pictures, built, options, settings, search, progress)
    if out is not None:
        write_mirrors_report(out, done, target or board, pictures, built)
    return done


@action("calibrate mirrors", working="checking")
def check_mirrors(
    image: Annotated[Any, FRAMES],
    board: BoardLike,
    *,
    rig: Annotated[RigLike, Doc("With --check: rig.yaml as it was calibrated.")] = None,
    parallel: Annotated[bool, Doc("With --check --rig: tell the turns that make the axes parallel.")] = False,
    thickness_m: Thickness = None,
    index: Index = GLASS,
    baseline_m: Baseline = None,
    near_m: Near = PLATE_NEAR_M,
    gap_m: Gap = MIRROR_GAP_M,
    camera: LensCamera = None,
    every: Every = 1,
    frames: Limit = None,
    workers: Workers = None,
    camera_settings: Cameras | None = None,
    progress: Progress | None = None,
) -> MirrorCheckOutput:
    """Tell whether a rig's mirrors stand as they did, from complex images of a printed board.

    Parameters
    ----------
    image
        As `measure` takes it; a live camera is watched until it is stopped.
    board
        As calibrate_camera takes it.
    rig
        As it was calibrated; else the lens `camera` and `baseline_m` as designed, for parallel axes.
    parallel
        Hold the mirrors of a rig against parallel axes all the same.
    thickness_m, index, near_m, gap_m
        Of the plate, and where the mirrors stand, as designed, m.

    Raises
    ------
    UsageError
        There is nothing to hold the mirrors against.
    NotEnoughData
        The board is seen twice in none of the images.
    """
    from armsight.calibrate.mirrors.result import check_output
    from armsight.drivers import is_live
    from armsight.ops.calibration import mirrors as app
    from armsight.ops.calibration.board_pictures import BoardPictures
    from armsight.ops.calibration.cameras import open_images
    from armsight.records import Silent
    from armsight.store.cell_file import CellMirrors

    built = CellMirrors(baseline_m=baseline_m, near_m=near_m, gap_m=gap_m, plate_m=thickness_m, index=index)
    reference = app.reference_of(built, rig, camera, parallel=parallel)
    watch = app.AlignmentWatch(reference=reference, board=board, back=app.KEPT if is_live(image) else None)
    with open_images(image, settings=camera_asked(camera_settings)) as source:
        seen = app.complex_views(source, board, BoardPictures(), every, frames, threads(workers))
        found, missed = app.watched(watch, seen, frames, progress or Silent())
    return check_output(found, missed)


def _from_board(
    sources: tuple[Images, Images, Images],
    board: Target,
    pictures: BoardPictures,
    built: CellMirrors,
    options: BoardOptions | None,
    settings: CameraSettings,
    search: tuple[int, int | None, int | None],
    progress: Progress | None,
) -> MirrorsOutput:
    """Calibrate from a board. sources: complex images, left and right ones; search: every, limit and workers."""
    from armsight.calibrate.cameras import BoardOptions
    from armsight.calibrate.mirrors.calibration import calibrate_mirrors
    from armsight.calibrate.mirrors.result import mirrors_output
    from armsight.ops.calibration.mirrors import board_views
    from armsight.records import require_kind
    from armsight.records.result_parts import RejectedFile

    require_kind("options", options, BoardOptions, NoneType, cure="Give BoardOptions(...)")
    views, missed = board_views(sources, board, pictures, settings, search, progress)
    if progress is not None:
        progress.update(0, 0, "solving")
    done = calibrate_mirrors(
        [left for left, _ in views],
        [right for _, right in views],
        board,
        thickness_m=built.plate_m,
        index=built.index,
        options=options,
        progress=progress,
    )
    return mirrors_output(done, [RejectedFile(source, seen.why) for source, seen in missed])


def _from_lights(
    images: Images,
    target: Target,
    camera: Camera | None,
    built: CellMirrors,
    settings: CameraSettings,
    every: int,
    limit: int | None,
    progress: Progress | None,
) -> MirrorsOutput:
    from armsight.calibrate.mirrors.result import mirrors_output
    from armsight.ops.calibration.cameras import open_images
    from armsight.ops.calibration.mirrors import lit_design
    from armsight.ops.calibration.mirrors_lit_target import calibrate_lit, require_lights
    from armsight.records import Silent

    design = lit_design(built, camera, image=images is not None)
    require_lights(target)
    with open_images(images or "", settings=settings, colour=target.colour is not None) as source:
        done, missed = calibrate_lit(design, target, source, every=every, limit=limit, progress=progress or Silent())
    return mirrors_output(done, missed, lit=True)
