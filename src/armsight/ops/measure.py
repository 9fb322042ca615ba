"""Frames in, poses out; frames into a recording."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeAlias

from armsight.errors import UsageError
from armsight.fields import Bounds, Doc, Flag, Flags
from armsight.file_names import MEASURED
from armsight.ops.action import Input, action
from armsight.ops.flags import Bits, CameraFlags, Cameras, Fps, Inverted, Limit, MaxSkew, Strict, Threshold
from armsight.ops.kinds import FRAMES, READERS, AsFile, CamerasLike, Left, Right

if TYPE_CHECKING:
    from armsight.drivers import PairSettings
    from armsight.measure.results import MeasureResult
    from armsight.ops.recording.record import RecordOutput
    from armsight.records import Progress
    from armsight.store.recording import ImageFormat

__all__ = ["measure", "record"]

Out: TypeAlias = Annotated[Path | None, Doc("Where the results go."), Flag("-o --out", metavar="FOLDER", needed=True)]


@action(
    "measure",
    working="measuring",
    keeps=MEASURED,
    writes=True,
    examples=(
        "--left frames/left --right frames/right --rig rig.yaml --target target.yaml -o measured",
        "--left camera:0 --right camera:1 --rig rig.yaml --target target.yaml -o measured",
        "--camera a=run.mcap --camera b=run.mcap --camera c=run.mcap --rig rig.yaml --target target.yaml -o measured",
    ),
    judged=True,
)
def measure(
    rig: Annotated[AsFile, Doc("rig.yaml of the cameras, from `armsight calibrate stereo` or `cameras`.")],
    target: Annotated[
        AsFile,
        Doc("target.yaml: the lights or the board that is looked for; or a board as checkerboard:9x6:0.025."),
    ],
    left: Left = None,
    right: Right = None,
    *,
    cameras: CamerasLike = None,
    out: Out = None,
    image: Annotated[
        Any,
        Doc("Images that hold both views: side by side, or one upon the other (mirror rig)."),
        FRAMES,
        Flag(metavar="SRC"),
    ] = None,
    times: Annotated[AsFile, Doc("times.csv with a column t_s, one row per frame.")] = None,
    world: Annotated[AsFile, Doc("world.yaml: give the poses in this frame.")] = None,
    fps: Fps = None,
    frames: Limit = None,
    threshold: Threshold = None,
    inverted: Inverted = False,
    stills: Annotated[bool, Doc("The frames are single shots, not a motion: measure each by itself.")] = False,
    bits: Bits = None,
    strict: Strict = False,
    mask: Annotated[
        Any, Doc("Image that is black where no light may be looked for."), Input(f"{READERS}:picture")
    ] = None,
    max_skew_s: MaxSkew = None,
    method: Annotated[
        Literal["likelihood", "seed"],
        Doc("likelihood (a light's model is fitted) or seed (Pachidis 2005: threshold, cross, mean)."),
        Flag(read=str),
    ] = "likelihood",
    timing: Annotated[
        Literal["auto", "pairs", "free"],
        Doc(
            "pairs: the views of a pair are of one moment. free: each view at its own time, for cameras that no "
            "wire joins. auto: free where rig.yaml has `timing`."
        ),
        Flag(read=str),
    ] = "auto",
    rate_hz: Annotated[
        float | None, Doc("With free cameras: poses a second. [default: the left frames]"), Bounds(least=1e-3)
    ] = None,
    at: Annotated[AsFile, Doc("With free cameras: poses at the t_s of this joints.csv, or of bag:FILE:/topic.")] = None,
    left_spots: Annotated[
        AsFile, Doc("t_s,u_px,v_px[,su_px,sv_px][,spot]: spots of the left camera found elsewhere.")
    ] = None,
    right_spots: Annotated[AsFile, Doc("The same of the right camera.")] = None,
    zoom_left: Annotated[float | None, Doc("Where the left zoom lens stands, of a rig with them.")] = None,
    zoom_right: Annotated[float | None, Doc("Where the right zoom lens stands.")] = None,
    camera_settings: Annotated[PairSettings | None, Flags(CameraFlags)] = None,
    set_zoom: Annotated[bool, Doc("Set live cameras to these first.")] = False,
    progress: Progress | None = None,
) -> MeasureResult:
    """Measure the target's pose in every pair of frames, or by all cameras of a rig of one to eight.

    Writes poses.csv, points.csv, spots.csv, poses.tum, measure.json and report.html. Exit code 3, with all of them
    written, where the run is inconsistent: its poses are doubtful.

    Parameters
    ----------
    rig, target
        Records, or their files; of a printed board also 'checkerboard:9x6:0.025'.
    left, right
        Folders, patterns, videos, one recording as left, 'camera:NAME', lists of images, or iterables of Frame.
    out
        A folder; None writes nothing.
    cameras
        Instead: these by the cameras' names in the rig, {'left': ..., 'top': ...}.
    image
        Instead: images that hold both views of a mirror rig.
    times
        t_s of the frames, {'t_s': [...]}; else counted by fps.
    world
        T_base_rig (4, 4) or world.yaml: poses are then in this frame.
    stills
        The frames are single shots, not a motion.
    bits
        Of the light in 16-bit images.

    Returns
    -------
    MeasureResult
        The figures of measure.json, and `poses`, the track.

    Raises
    ------
    DataRefused
        Frames of another size, left and right swapped, nothing found at all.
    UsageError
        Parameters that mean nothing together.

    Examples
    --------
    >>> cell = armsight.simulate("hand-cell", frames=3)
    >>> done = armsight.measure(cell.rig, cell.target, [f.left for f in cell], [f.right for f in cell])
    >>> done.n_ok, done.poses.T_parent_target.shape
    (3, (3, 4, 4))
    """
    from armsight.drivers import AUTOMATIC, ImageReading, MomentSource
    from armsight.measure.poses.moments import require_views
    from armsight.measure.poses.setup import SLACK_PX, Setup, rig_slack_px
    from armsight.measure.settings import SpotSettings
    from armsight.ops.measurement.run import about_pairs, run, target_of, zoomed_rig
    from armsight.ops.measurement.streams import FrameSources
    from armsight.ops.sources.bags import read_motion
    from armsight.ops.sources.cameras import cameras_of, named_cameras
    from armsight.ops.sources.frames import frame_times
    from armsight.records import Silent
    from armsight.store import read_world

    settings, zoom, progress = camera_settings or AUTOMATIC, (zoom_left, zoom_right), progress or Silent()
    wanted, (seen_by, zoomed) = target_of(target), zoomed_rig(rig, zoom)
    pair, given = seen_by.is_pair, dict[str, str]()
    if cameras or not pair:
        given = cameras_of(seen_by.names, named_cameras(cameras or {}, left, right))
        left, right = given.values() if pair else (None, None)
    sources = FrameSources(
        left=left,
        right=right,
        cameras={} if pair else given,
        image=image,
        left_spots=left_spots,
        right_spots=right_spots,
        times=times,
        fps=fps,
        limit=frames,
        max_skew_s=max_skew_s,
        settings=_with_zoom(settings, zoom) if set_zoom else settings,
        reading=ImageReading(bits=bits, strict=strict),
    )
    place, colour = None if world is None else read_world(world), wanted.colour
    seen = None if mask is None else mask > 0
    spots = SpotSettings(threshold=threshold, inverted=inverted, mask=seen, colour=colour, method=method)
    setup = partial(
        Setup,
        rig=seen_by,
        target=wanted,
        settings=spots,
        slack_px=rig_slack_px(seen_by) if zoomed or not pair else SLACK_PX,
    )
    facts = [("rig's file", str(rig)), ("target's file", str(target))]
    if sources.run_free(seen_by, timing, stills=stills, rate_hz=rate_hz, at=at):
        from armsight.ops.measurement.free_output import measure_free

        when = rate_hz if at is None else read_motion(at, origin_of=left or right).t_s
        return measure_free(
            setup(), sources, out, when=when, progress=progress, world=place, facts=facts, zoomed=zoomed
        )
    facts += [("place of the rig", str(world))] if place else []
    told = frame_times(next(iter(sources.named), None), times, fps)
    pairs: MomentSource
    pairs, overlaid = sources.of_rig(seen_by, told.times_s, colour=colour is not None)
    made = setup(rig=seen_by.with_each(timing=(None,) * len(seen_by.cameras)), overlaid=overlaid)
    if not pair:
        require_views(made, len(seen_by.cameras))
    about = about_pairs(sources, pairs.name, told, facts, zoomed, stills=stills)
    return run(made, pairs, out, world=place, limit=frames, progress=progress, about=about)


def _with_zoom(settings: PairSettings, zoom: tuple[float | None, float | None]) -> PairSettings:
    """Return what is asked of the cameras with the zoom to set of each. Raises UsageError where there is none."""
    from armsight.drivers import by_side

    if zoom == (None, None):
        raise UsageError(
            "--set-zoom is given, and no zoom to set", cure="Give --zoom-left and --zoom-right, or one of them"
        )
    left, right = by_side(settings)
    return replace(left, zoom=zoom[0]), replace(right, zoom=zoom[1])


@action(
    "record",
    working="recording",
    writes=True,
    examples=(
        "--left camera:0 --right camera:1 --seconds 60 -o recording.mcap",
        "--camera left=camera:0 --camera right=camera:2 --camera top=camera:4 -o recording.mcap",
        "--repair recording.mcap -o mended.mcap",
    ),
)
def record(
    out: Annotated[Path | None, Doc("The recording."), Flag("-o --out", metavar="FILE.mcap")] = None,
    left: Left = None,
    right: Right = None,
    *,
    cameras: CamerasLike = None,
    cell: Annotated[str | None, Doc("A simulated cell in place of cameras, such as hand-cell.")] = None,
    seed: Annotated[int, Doc("The same seed gives the same frames."), Bounds(least=0)] = 0,
    rig: Annotated[AsFile, Doc("rig.yaml: its calibration goes into the recording.")] = None,
    target: Annotated[AsFile, Doc("target.yaml that goes into the recording.")] = None,
    format: Annotated[
        Literal["png", "raw", "jpeg"] | ImageFormat,
        Doc("png (bit for bit, small), raw (bit for bit, quick) or jpeg (smallest)."),
        Flag(read=str),
    ] = "png",
    colour: Annotated[bool, Doc("Keep the colours; else grey is recorded.")] = False,
    fps: Fps = None,
    frames: Limit = None,
    seconds_s: Annotated[float | None, Doc("Stop after so many seconds."), Bounds(above=0.0)] = None,
    max_skew_s: MaxSkew = None,
    overwrite: Annotated[bool, Doc("Replace a file of this name.")] = False,
    camera_settings: Cameras | None = None,
    progress: Progress | None = None,
) -> RecordOutput:
    """Record one to eight cameras into an MCAP file, or mend one that was cut off.

    Of three and more a camera that is lost is told, and the others go on. Stop with Ctrl-C. Whatever happens to the
    program or the disk, all but the last second is readable.

    Parameters
    ----------
    out
        FILE.mcap.
    left, right, cameras
        As `measure` takes them; or cell, a simulated one such as 'hand-cell', in their place.
    frames, seconds_s
        When to stop; else with the frames.

    Raises
    ------
    UsageError
        The file is there already and overwrite is False, or there is nothing to record.
    DeviceFailed
        A camera or the disk; what was recorded until then is readable.

    Examples
    --------
    >>> cell = armsight.simulate("hand-cell", frames=2)
    >>> sides = [f.left for f in cell], [f.right for f in cell]
    >>> armsight.record(folder / "run.mcap", *sides, rig=cell.rig, target=cell.target).n_pairs
    2
    """
    from armsight.drivers import AUTOMATIC
    from armsight.ops.recording.record import RecordJob, image_format
    from armsight.ops.recording.record import record as run
    from armsight.ops.sources.cameras import named_cameras

    if out is None:
        raise UsageError("the recording has no name", cure="Give -o FILE.mcap")
    job = RecordJob(
        out=out,
        cameras=named_cameras(cameras or {}, left, right),
        cell=cell,
        seed=seed,
        rig=rig,
        target=target,
        kind=image_format(format),
        colour=colour,
        fps=fps,
        limit=frames,
        seconds_s=seconds_s,
        max_skew_s=max_skew_s,
        overwrite=overwrite,
        camera_settings=camera_settings or AUTOMATIC,
    )
    return run(job, progress)
