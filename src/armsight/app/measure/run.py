"""Frames in, poses with their uncertainty out."""

from __future__ import annotations

import time
from collections.abc import Generator, Iterable, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from functools import partial
from itertools import islice
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from armsight.app.measure.collector import About, Collector
from armsight.app.measure.free_output import measure_free
from armsight.app.measure.outputs import Outputs, made_with
from armsight.app.measure.streams import require_timing, runs_free
from armsight.app.measure.warm_up import prepare
from armsight.app.requests.measure import MeasureJob
from armsight.drivers import (
    CameraSettings,
    PairSettings,
    PairSource,
    by_side,
    ordered_map,
    read_image,
)
from armsight.drivers.live import MAX_SKEW_S
from armsight.errors import ArmsightError, Cancelled, Inconsistent, NotEnoughData, UsageError
from armsight.file_names import MEASURE, REPORT
from armsight.measure.consistency.check import RunCheck, advice, sentence
from armsight.measure.consistency.diagnosis import Consistency
from armsight.measure.poses.pipeline import Measured, Setup, TargetTracker
from armsight.measure.poses.setup import SLACK_PX, rig_slack_px
from armsight.measure.results import MeasureOutput, ZoomAt, grounds_of
from armsight.measure.settings import SpotSettings
from armsight.ops.sources.bags import origin_ns
from armsight.ops.sources.frames import (
    complex_pairs,
    frame_times,
    is_recording,
    open_pairs,
    open_source,
    recordings_in,
)
from armsight.optics import SIDES, Rig, RigKind, ZoomState, at_zoom
from armsight.records import Frame, PoseStatus, Progress, Silent, Target, TargetPose
from armsight.records.checks import wide_rig
from armsight.store import World, parse_board, read_target, read_world, read_zoom_rig
from armsight.store.atomic import write_json

Pair = tuple[Frame, Frame]

SWAPPED_ENOUGH = 3
"""Pairs at the start of a run that look exchanged before it is refused: one may do so by a reflection."""

Zoomed = dict[str, ZoomState]
"""The state of each camera that zooms, by left and right."""

MEASURING = "measuring"
TIMINGS = ("auto", "pairs", "free")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Step:
    """One pair, what was measured, the milliseconds it took; swapped: why left and right look exchanged."""

    pair: Pair
    measured: Measured
    ms: float
    swapped: Inconsistent | None = None


def target_of(named: Path) -> Target:
    """Return the target of a target.yaml, or the board of a text such as checkerboard:9x6:0.025."""
    return parse_board(str(named)) if ":" in named.name and not named.exists() else read_target(named)


def measure(job: MeasureJob, progress: Progress | None = None) -> MeasureOutput:
    """Measure every pair of frames; write poses.csv, points.csv, spots.csv, poses.tum, measure.json, report.html.

    What was measured before a failure or a cancel is in the files when the error is raised. Raises UsageError,
    DataRefused or DeviceFailed, Cancelled.
    """
    target, (rig, zoomed) = target_of(job.target), _zoomed_rig(job.rig, job.zoom)
    world = read_world(job.world) if job.world else None
    settings, slack_px = _settings(job, target), rig_slack_px(rig) if zoomed else SLACK_PX
    if _free(job, rig):
        if job.bits is not None:
            raise UsageError("--bits is for frames in pairs, and these cameras run free", cure="Give --timing pairs")
        setup = Setup(rig=rig, target=target, settings=settings, slack_px=slack_px)
        return _with_zoom(measure_free(job, setup, world, progress or Silent()), zoomed, job.out)
    times = frame_times(job.left or job.image, job.times, job.fps)
    pairs, overlaid = _pairs(job, rig, target, times.times_s)
    setup = Setup(rig=rig, target=target, settings=settings, overlaid=overlaid, slack_px=slack_px)
    facts = [("frames", pairs.name), ("rig's file", str(job.rig)), ("target's file", str(job.target))]
    facts += ([("place of the rig", str(job.world))] if job.world else []) + _zoom_facts(zoomed)
    facts += [("time of the frames", times.source)] if times.source and not job.stills else []
    zero_ns = origin_ns(job.left or job.image)
    facts += [("t_s = 0 is the bag's start, Unix time in s", f"{zero_ns / 1e9:.6f}")] if zero_ns is not None else []
    fps, recorded = None if job.stills else times.assumed_fps, recordings_in(job.left, job.right, job.image)
    summary, _ = run(
        setup,
        pairs,
        job.out,
        world=world,
        limit=job.limit,
        progress=progress or Silent(),
        about=About(facts=facts, assumed_fps=fps, stills=job.stills, recordings=recorded),
        stills=job.stills,
    )
    return _with_zoom(summary, zoomed, job.out)


def run(
    setup: Setup,
    pairs: PairSource,
    out: Path,
    *,
    progress: Progress,
    world: World | None = None,
    limit: int | None = None,
    about: About | None = None,
    stills: bool = False,
) -> tuple[MeasureOutput, Sequence[TargetPose]]:
    """Measure the pairs of a source not yet open into the folder out; return the figures and all poses. See measure."""
    parent, T_parent_rig = (world.parent, world.T_parent_rig) if world else ("rig", None)
    report, check = Collector(setup, parent, T_parent_rig), RunCheck(setup)
    failure: ArmsightError | None = None
    with pairs:
        prepare(progress)
        with Outputs(out, T_parent_rig=T_parent_rig, parent=parent) as outputs:
            try:
                for step in _steps(setup, pairs, limit, progress, alone=stills or setup.target.is_board):
                    start_s = time.perf_counter()
                    measured = check.add(step.measured)
                    pose = outputs.add(measured)
                    report.add(*step.pair, measured, pose)
                    outputs.took(step.ms + (time.perf_counter() - start_s) * 1e3)
            except ArmsightError as error:
                failure = error
    if outputs.n_frames == 0 and failure is not None:
        raise failure
    consistency = check.finish()
    outputs.settle(report.poses, inconsistent=consistency.verdict == "inconsistent")
    failure, about = failure or _nothing_seen(outputs, consistency, setup), about or About()
    grounds, broken = grounds_of(report.poses, report.truth(about)), str(failure) if failure else ""
    summary = outputs.summary(grounds, skew=pairs.skew, error=broken, consistency=consistency)
    summary = replace(summary, assumed_fps=about.assumed_fps, made_with=made_with(setup.rig, setup.target))
    progress.update(0, 0, "writing the report")
    report.write(out / REPORT, summary, about)
    write_json(out / MEASURE, summary.to_dict())
    if failure is not None:
        raise _with_path(failure, outputs, out)
    return summary, report.poses


def _steps(
    setup: Setup, pairs: PairSource, limit: int | None, progress: Progress, *, alone: bool
) -> Generator[Step, None, None]:
    """Yield each pair measured, in order. Raises Cancelled, and Inconsistent for swapped or wrongly sized views."""
    total = _total(pairs.total, limit)
    measure_all = _singly if alone else _tracked
    done = seen = 0
    swapped: list[Inconsistent] = []
    with closing(_generator(pairs)) as source, closing(measure_all(setup, islice(source, limit))) as steps:
        for step in steps:
            yield step
            done += 1
            seen += step.measured.pose.status is not PoseStatus.LOST
            swapped += [step.swapped] if step.swapped else []
            if not seen and len(swapped) >= SWAPPED_ENOUGH:
                raise swapped[0]
            progress.update(done, total, MEASURING)
            if progress.cancelled():
                raise Cancelled(f"stopped after {done} pairs")
    if not seen and swapped:
        raise swapped[0]


def _tracked(setup: Setup, pairs: Iterable[Pair]) -> Generator[Step, None, None]:
    """Measure one pair after the other: each tells the next where to look, so that few are searched as a whole."""
    tracker = TargetTracker(setup)
    for pair in pairs:
        yield _one(tracker, pair)


def _singly(setup: Setup, pairs: Iterable[Pair]) -> Generator[Step, None, None]:
    """Measure pairs in threads, each by itself: a board, or single shots, which tell nothing of each other."""
    return ordered_map(lambda pair: _one(TargetTracker(setup), pair), pairs)


def _one(tracker: TargetTracker, pair: Pair) -> Step:
    start_s = time.perf_counter()
    measured = tracker.take(*pair)
    return Step(pair=pair, measured=measured, ms=(time.perf_counter() - start_s) * 1e3, swapped=tracker.swapped)


def _free(job: MeasureJob, rig: Rig) -> bool:
    """Tell whether each view is to be taken at its own time. Raises UsageError where that cannot be."""
    if job.timing not in TIMINGS:
        raise UsageError(f"--timing {job.timing}", cure=f"Give one of {', '.join(TIMINGS)}")
    tables = job.left_spots is not None or job.right_spots is not None
    one_exposure = job.image is not None or rig.kind is RigKind.MIRROR
    apart = not (one_exposure or job.stills or job.times is not None)
    free = job.timing == "free" or (job.timing == "auto" and apart and (tables or runs_free(rig)))
    if free and not apart:
        raise UsageError(
            "both views are one exposure"
            if one_exposure
            else "--stills and --times are for frames that belong in pairs",
            cure="Leave --timing free away",
        )
    if free:
        require_timing(rig)
    elif tables or job.rate_hz is not None or job.at is not None:
        raise UsageError(
            "--left-spots, --right-spots, --rate and --at are for cameras that run free",
            cure="Run armsight calibrate timing, and measure with the rig.yaml it writes",
        )
    if job.rate_hz is not None and job.at is not None:
        raise UsageError("--rate and --at both say at which times poses are wanted", cure="Give one of them")
    return free


def _settings(job: MeasureJob, target: Target) -> SpotSettings:
    mask: NDArray[np.bool_] | None = None
    if job.mask is not None:
        mask = read_image(job.mask) > 0
    return SpotSettings(
        threshold=job.threshold, inverted=job.inverted, mask=mask, colour=target.colour, method=job.method
    )


def _pairs(job: MeasureJob, rig: Rig, target: Target, times_s: list[float] | None) -> tuple[PairSource, bool]:
    """Return the source of pairs, and whether both views are in one image, one upon the other."""
    colour = target.colour is not None
    if job.image is not None:
        if job.left is not None or job.right is not None:
            raise UsageError("--image goes with neither --left nor --right", cure="Give the one or the others")
        asked = _settings_of_one(job.camera_settings, job.image)
        source = partial(
            open_source, job.image, colour=colour, fps=job.fps, times_s=times_s, settings=asked, reading=job.reading
        )
        return complex_pairs(source, rig)
    if rig.kind is RigKind.MIRROR and job.left is not None and job.left == job.right:
        raise UsageError(
            f"left and right are both {job.left}, and the rig has mirrors: both of its views are in one image",
            cure=f"Give --image {job.left} in place of --left and --right",
        )
    alone = (job.left or job.right) if job.left is None or job.right is None else None
    if job.left is job.right is None or (alone is not None and not is_recording(alone)):
        raise UsageError(
            "there are no frames to measure", cure="Give --left and --right, one recording as --left, or --image"
        )
    pairs = open_pairs(
        job.left,
        job.right,
        colour=colour,
        fps=job.fps,
        times_s=times_s,
        max_skew_s=MAX_SKEW_S if job.max_skew_s is None else job.max_skew_s,
        settings=job.camera_settings,
        reading=job.reading,
    )
    return pairs, False


def _settings_of_one(settings: PairSettings, image: str) -> CameraSettings:
    """Return what is asked of the camera whose images hold both views. Raises UsageError for two different zooms."""
    left, right = by_side(settings)
    if left != right:
        raise UsageError(
            f"{image} is one camera, and two different zooms are to be set",
            cure="Give --zoom-left and --zoom-right the same value; or leave --set-zoom away, and set the lenses first",
        )
    return left


LIGHTS_ON = (
    "the lights must be on, in both views, and brighter than what is round them. Where they are: --rig and --target "
    "must be theirs, and left be left. --inverted is for dark spots, --mask blackens what is not to be looked at"
)
WHOLE_BOARD = "the board must be whole, sharp and evenly lit in both views, and its counts and kind those of --target"


def _nothing_seen(outputs: Outputs, consistency: Consistency, setup: Setup) -> NotEnoughData | None:
    """Return the error for a run in which no frame gave even a position, or in which there was none."""
    if outputs.n_seen:
        return None
    if not outputs.n_frames:
        return NotEnoughData(
            "one of the two views has no frames",
            consequence="There is no pair, so no pose",
            cure="Give frames of both cameras",
        )
    first = outputs.commonest
    if consistency.refused > 0.0 or consistency.instead:
        return NotEnoughData(
            f"the target is seen in the {outputs.n_frames} pairs and fits in none of them. {sentence(consistency)}",
            consequence="There is no pose",
            cure=advice(consistency),
        )
    return NotEnoughData(
        f"the target was found in none of the {outputs.n_frames} pairs" + (f"; most often: {first}" if first else ""),
        consequence="There is no pose",
        cure=f"{wide_rig(setup.rig.baseline_m)} Look at the report, which shows what was seen: "
        f"{WHOLE_BOARD if setup.target.is_board else LIGHTS_ON}".strip(),
    )


def _with_path(failure: ArmsightError, outputs: Outputs, out: Path) -> ArmsightError:
    """Add to an error what was measured until it came, and where it is."""
    kept = f"What was measured until then ({outputs.n_seen} poses of {outputs.n_frames} pairs) is in {out}"
    failure.consequence = ". ".join(part.rstrip(".") for part in (failure.consequence, kept) if part)
    return failure


def _total(total: int | None, limit: int | None) -> int:
    """Return how many pairs there will be, 0 where that is not known."""
    return min((n for n in (total, limit) if n is not None), default=0)


def _generator(pairs: PairSource) -> Generator[Pair, None, None]:
    yield from pairs


def _zoomed_rig(path: Path, zoom: tuple[float | None, float | None]) -> tuple[Rig, Zoomed]:
    """Return the rig in a file at these zooms. Raises as store.read_rig."""
    found = at_zoom(read_zoom_rig(path), zoom)
    states = zip(SIDES, found.states, strict=True)
    return found.rig, {side: state for side, state in states if state is not None}


def _zoom_facts(zoomed: Zoomed) -> list[tuple[str, str]]:
    return [
        (
            f"zoom, {side}",
            f"{state.zoom:g}, {'between settings' if state.interpolated else 'as calibrated'}: focal length "
            f"{state.camera.intrinsics[0]:.2f} +- {state.covariance.std()['fx']:.2g} px",
        )
        for side, state in zoomed.items()
    ]


def _with_zoom(summary: MeasureOutput, zoomed: Zoomed, out: Path) -> MeasureOutput:
    """Return the figures of a run with those of its zoom lenses, and write them; as they are where there are none."""
    if not zoomed:
        return summary
    cameras = {
        side: ZoomAt(
            zoom=state.zoom,
            interpolated=state.interpolated,
            fx_px=float(state.camera.intrinsics[0]),
            fx_std_px=state.covariance.std()["fx"],
            fx_interpolation_px=state.interpolation["fx"],
            pupil_m=state.pupil_m,
        )
        for side, state in zoomed.items()
    }
    extended = replace(summary, zoom=cameras)
    write_json(out / MEASURE, extended.to_dict())
    return extended
