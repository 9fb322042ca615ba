"""Rigs of some cameras, and what belongs to them beside: noise, a target's lights, when free-running cameras expose."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeAlias

from armsight.defaults import LIT_LIGHTS
from armsight.errors import DataRefused, UsageError
from armsight.fields import Bounds, Doc, Flag
from armsight.ops.action import action
from armsight.ops.calibrate_cameras import Detector, RigOut
from armsight.ops.flags import SRC, Bits, Cameras, Every, Fps, Inverted, Limit, Strict, Threshold, Workers
from armsight.ops.kinds import (
    FRAMES,
    NAMED_IMAGES,
    NAMED_LENSES,
    AnyRigLike,
    BoardLike,
    BothViews,
    CamerasLike,
    Left,
    NamedSpotsLike,
    Right,
    SpotsLike,
    TargetLike,
)

if TYPE_CHECKING:
    from armsight.calibrate.camera_noise.photon_transfer import NoiseResult
    from armsight.calibrate.cameras import BoardOptions, CamerasCalibration
    from armsight.calibrate.light_target import TargetResult
    from armsight.calibrate.timing import CamerasTiming, TimingResult
    from armsight.records import Progress

__all__ = ["calibrate_cameras", "calibrate_noise", "calibrate_target", "calibrate_timing"]

NamedImages: TypeAlias = Annotated[
    Any,
    Doc(f"A camera's name and its images of the board, moment by moment, repeated for each. SRC is {SRC}."),
    NAMED_IMAGES,
    Flag("--camera", metavar="NAME=SRC", repeated=True),
]
Lenses: TypeAlias = Annotated[
    Any,
    Doc(
        "camera.yaml of a lens calibrated before, which moves within its covariance; repeated. The kind of all others, "
        "pinhole, rational, fisheye or auto, without a name. [default: pinhole]"
    ),
    NAMED_LENSES,
    Flag("--lens", metavar="NAME=FILE|KIND", repeated=True),
]
Added: TypeAlias = Annotated[
    Any,
    Doc("With --rig: the camera that joins it, and its images of the same moments."),
    NAMED_IMAGES,
    Flag("--add", metavar="NAME=SRC", repeated=True),
]

SPOTS = "table t_s,u_px,v_px[,su_px,sv_px][,spot]"


@action(
    "calibrate cameras",
    working="calibrating",
    in_place="rig",
    examples=(
        "--camera left=left.mp4 --camera right=right.mp4 --camera top=top.mp4 --lens top=top.yaml "
        "--board charuco:7x5:0.04:0.03:DICT_4X4_50 -o rig.yaml",
    ),
    filed=True,
    judged=True,
    writes="write_rig_of",
)
def calibrate_cameras(
    cameras: NamedImages,
    board: BoardLike = None,
    *,
    back: Annotated[
        BoardLike,
        Doc("Board printed on the other side of the plate, with markers of another dictionary. [default: none]"),
        Flag(metavar="BOARD"),
    ] = None,
    target: Annotated[
        TargetLike, Doc("In place of a board: target.yaml of four and more lights, which one waves. Needs --lens.")
    ] = None,
    lenses: Lenses = None,
    hold_lenses: Annotated[bool, Doc("Hold the lenses of --lens as they are.")] = False,
    rig: Annotated[AnyRigLike, Doc("rig.yaml that is extended or mended; its other cameras and its axes stay.")] = None,
    add: Added = None,
    again: Annotated[
        str | None, Doc("With --rig: the camera that was knocked and is placed anew."), Flag(metavar="NAME")
    ] = None,
    options: BoardOptions | None = None,
    fps: Annotated[
        float | None, Doc("The images in folders are of films of so many frames a second."), Bounds(least=1e-6)
    ] = None,
    every: Every = 1,
    frames: Limit = None,
    workers: Workers = None,
    detector: Detector = "auto",
    bits: Bits = None,
    strict: Strict = False,
    threshold: Threshold = None,
    inverted: Inverted = False,
    out: RigOut = None,
    progress: Progress | None = None,
) -> CamerasCalibration:
    """Find up to eight cameras and where they stand to each other, from a board that never all of them need to see.

    Films tell by the board's motion how late each camera's clock is.

    Parameters
    ----------
    cameras
        Images by the camera's name, each as calibrate_camera takes them: as many of each camera, in the same order.
    board, back, target
        As calibrate_camera takes it, with another one on its back; or a target of lights.
    lenses, hold_lenses
        By the camera's name: a camera.yaml, a Camera, or what calibrate_camera returns. Or the kind of all lenses.
    rig, add, again
        A rig that gets one more camera (its images by its name), or one of whose cameras is placed anew.
    options, every, frames, detector, bits, threshold, inverted
        As calibrate_camera and calibrate_target take them.
    fps
        Of images in folders, where they are a film's.
    out
        rig.yaml to write, its report beside it.

    Raises
    ------
    NotEnoughData
        Too few moments show the board, or no moment connects some cameras; they are named.
    Inconsistent
        Lists out of step, mirrored images, a lens or a rig that no longer fits; else as calibrate_camera.
    """
    from armsight.measure.settings import SpotSettings
    from armsight.ops.calibrate_cameras import board_options, threads
    from armsight.ops.calibration.board_pictures import BoardPictures
    from armsight.ops.calibration.many_cameras import Reading, Wanted, see_all, solved
    from armsight.ops.calibration.reports import write_cameras_report
    from armsight.ops.calibration.shown import shown_of

    shown = shown_of(board, back, target)
    given = dict(lenses or {})
    kind = given.pop("", "pinhole")
    wanted = Wanted(rig=rig, cameras=cameras, add=add, again=again, lenses=given, hold_lenses=hold_lenses)
    wanted.require()
    options, pictures = board_options(options, kind, most=1), BoardPictures()
    spots = SpotSettings(threshold=threshold, inverted=inverted)
    reading = Reading(fps, every, frames, threads(workers), bits, strict, detector, spots)
    seen = see_all(wanted, shown, reading, pictures, progress)
    done = solved(wanted, seen, shown, options, progress)
    if out is not None:
        write_cameras_report(out, done, shown, pictures)
    return done


@action(
    "calibrate target",
    working="calibrating",
    examples=(
        "--rig rig.yaml --left frames/left --right frames/right --lights 3 -o target.yaml",
        "--rig rig.yaml --camera left=left --camera right=right --camera top=top --lights 3 -o target.yaml",
    ),
    judged=True,
    writes="write_lights",
)
def calibrate_target(
    rig: Annotated[AnyRigLike, Doc("rig.yaml of the cameras, from `armsight calibrate stereo` or `cameras`.")],
    left: Left = None,
    right: Right = None,
    *,
    cameras: CamerasLike = None,
    image: BothViews = None,
    lights: Annotated[int, Doc("How many lights the target has."), Bounds(least=2, most=6)] = LIT_LIGHTS,
    frames: Limit = None,
    threshold: Threshold = None,
    inverted: Inverted = False,
    camera_settings: Cameras | None = None,
    out: Annotated[Path | None, Doc("target.yaml to write."), Flag("-o --out", needed=True)] = None,
    progress: Progress | None = None,
) -> TargetResult:
    """Find where the lights of a target are, from frames of it turned to several sides before a calibrated rig.

    Parameters
    ----------
    rig, left, right, cameras, image
        As `measure` takes them. Of more cameras than two every sight of a light counts, also that of one camera alone.
        No two need see all lights together: each is then to be seen beside three others, whichever moments show it.
    lights
        How many there are.
    frames
        Pairs to read at most, or moments.
    out
        target.yaml to write.

    Raises
    ------
    NotEnoughData, Inconsistent, Degenerate
        The frames do not tell the lights' positions.
    """
    from functools import partial

    from armsight.calibrate.light_target import calibrate_lights
    from armsight.drivers import AUTOMATIC
    from armsight.measure.settings import SpotSettings
    from armsight.ops.calibration.spots_of_frames import lights_of_pairs, lit_moments, lit_pairs, naming, paired
    from armsight.ops.sources.cameras import open_rig
    from armsight.ops.sources.frames import complex_pairs, open_source
    from armsight.records import Silent

    settings, each = SpotSettings(threshold=threshold, inverted=inverted), camera_settings or AUTOMATIC
    if not rig.is_pair and image is None:
        with open_rig(rig.names, left, right, cameras or {}, settings=each) as moments:
            views = lit_moments(rig, moments, settings, frames, progress or Silent())
        return calibrate_lights(rig, views, lights, paired=paired, naming=naming)
    if (image is None) == (left is None and not cameras):
        raise UsageError("which frames?", cure="Give --left and --right, or --image with both views in one image")
    if image is None:
        source, overlaid = open_rig(rig.names, left, right, cameras or {}, settings=each), False
    else:
        source, overlaid = complex_pairs(partial(open_source, image, settings=each), rig)
    with source as pairs:
        seen = lit_pairs(rig, pairs, settings, frames, progress or Silent())
    return lights_of_pairs(rig, seen, lights, overlaid=overlaid)


@action(
    "calibrate timing",
    working="calibrating",
    in_place="rig",
    examples=(
        "--left camera:0 --right camera:1 --rig rig.yaml --target target.yaml -o rig-timed.yaml",
        "--camera left=camera:0 --camera right=camera:1 --camera top=camera:2 --rig rig.yaml -o rig-timed.yaml",
    ),
    judged=True,
    writes="write_rig_of",
)
def calibrate_timing(
    rig: Annotated[AnyRigLike, Doc("rig.yaml of the cameras, from `armsight calibrate stereo` or `cameras`.")],
    target: Annotated[TargetLike, Doc("target.yaml of the lights, where they are named in tables.")] = None,
    left: Left = None,
    right: Annotated[Right, Doc("Right frames, each with its camera's stamp."), FRAMES, Flag(metavar="SRC")] = None,
    *,
    cameras: CamerasLike = None,
    left_spots: Annotated[SpotsLike, Doc(f"Instead of frames: {SPOTS}."), Flag(metavar="CSV")] = None,
    right_spots: Annotated[SpotsLike, Doc("The same of the right camera."), Flag(metavar="CSV")] = None,
    spots: Annotated[NamedSpotsLike, Doc("The same of a camera by its name in rig.yaml; repeated.")] = None,
    fps: Fps = None,
    frames: Limit = None,
    threshold: Threshold = None,
    inverted: Inverted = False,
    camera_settings: Cameras | None = None,
    out: Annotated[Path | None, Doc("rig.yaml to write, with the timing."), Flag("-o --out", needed=True)] = None,
    progress: Progress | None = None,
) -> TimingResult | CamerasTiming:
    """Find delay, drift, read-outs and jitter of free-running cameras from lights waved before them for 10-20 s.

    Parameters
    ----------
    rig, target, left, right
        As `measure` takes them.
    cameras
        Instead: frames by the cameras' names, {'left': ..., 'top': ...}, of rigs of up to eight. Each is timed against
        the rig's first one, by one fit to what all see.
    left_spots, right_spots, spots
        Instead of frames: columns t_s, u_px, v_px of each camera; spots: by the cameras' names.
    fps
        Frames a second, where none brings its time.
    frames
        Frames of each camera to read at most.
    out
        rig.yaml to write.

    Raises
    ------
    NotEnoughData, Inconsistent
        The wave does not tell the timing. Where some cameras never see the light with others, those that do are
        written all the same.
    """
    from armsight.calibrate.timing import calibrate_clocks, calibrate_timing
    from armsight.drivers import AUTOMATIC
    from armsight.ops.calibration.spots_of_frames import SpotSearch, refuse_swapped, seen_tracks
    from armsight.ops.sources.cameras import named_cameras
    from armsight.records import Silent

    search = SpotSearch(
        threshold=threshold,
        inverted=inverted,
        fps=fps,
        limit=frames,
        settings=camera_settings or AUTOMATIC,
    )
    texts, tables = ({"left": left, "right": right}, {"left": left_spots, "right": right_spots})
    sources = {name: text for name, text in texts.items() if text is not None}
    if cameras:
        sources = named_cameras(cameras, left, right)
    told = {name: table for name, table in tables.items() if table is not None} | dict(spots or {})
    tracks = seen_tracks(rig, sources, told, search, progress or Silent())
    known = target is not None and target.model_known
    positions = dict(zip(target.names, target.xyz_m, strict=True)) if known else None
    if rig.is_pair:
        try:
            return calibrate_timing(rig, tracks["left"], tracks["right"], positions)
        except DataRefused:
            refuse_swapped(lambda: calibrate_timing(rig, tracks["right"], tracks["left"], positions))
            raise
    return calibrate_clocks(rig, tracks, positions)


@action("calibrate camera", working="calibrating")
def calibrate_noise(
    frames: Annotated[Any, Doc("4 to 50 still frames of any scene; or a file with the noise."), FRAMES],
    *,
    side: Literal["left", "right"] | None = None,
    every: Every = 1,
    limit: Limit = None,
    camera_settings: Cameras | None = None,
    progress: Progress | None = None,
) -> NoiseResult:
    """Find a camera's noise, from 4 to 50 still frames of any scene; `armsight calibrate camera --noise` files it.

    Parameters
    ----------
    frames
        Images, or as `measure` takes them; or a camera.yaml or rig.yaml that holds the noise.
    side
        Of such a rig.yaml.
    every, limit
        Of the frames.

    Raises
    ------
    NotEnoughData, Inconsistent
        The frames are not still.

    Examples
    --------
    >>> rng = np.random.default_rng(1)
    >>> scene = np.linspace(20, 200, 320 * 240).reshape(240, 320)
    >>> still = [np.uint8(scene + rng.normal(0, 2, scene.shape)) for _ in range(8)]
    >>> armsight.calibrate_noise(still).noise.n_given
    8
    """
    from armsight.drivers import AUTOMATIC
    from armsight.ops.calibration.camera_noise import find_noise

    settings = camera_settings or AUTOMATIC
    return find_noise(frames, side=side, every=every, limit=limit, settings=settings, progress=progress)
