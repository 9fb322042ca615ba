"""Frames in, poses with their uncertainty out."""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass
from functools import partial
from itertools import islice
from pathlib import Path
from typing import TypeVar

from armsight.drivers import Ahead, MomentSource, Views, moments_of, pairs_of
from armsight.errors import ArmsightError, Cancelled, Inconsistent, NotEnoughData
from armsight.measure.consistency.check import RunCheck, advice, sentence
from armsight.measure.consistency.findings import Consistency
from armsight.measure.consistency.run_of_cameras import CamerasCheck
from armsight.measure.poses.moments import TargetTracker
from armsight.measure.poses.pipeline import Measured, Setup
from armsight.measure.results import MeasureResult, ZoomAt, grounds_of
from armsight.ops.measurement.collector import About, Collector, Zoomed
from armsight.ops.measurement.outputs import Outputs
from armsight.ops.measurement.streams import FrameSources
from armsight.ops.measurement.warm_up import prepare
from armsight.ops.sources.bags import origin_ns
from armsight.ops.sources.frames import FrameTimes, recordings_in
from armsight.optics import Rig, at_zoom
from armsight.records import Frame, PoseStatus, Progress, Target
from armsight.records.checks import wide_rig
from armsight.store import World, parse_board, read_target, read_zoom_rig

T = TypeVar("T")
Frames = Sequence[Frame | None]
"""Those of one moment, by camera; of a pair both are there."""

SWAPPED_ENOUGH = 3
"""Pairs at the start of a run that look exchanged before it is refused: one may do so by a reflection."""

MEASURING = "measuring"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Step:
    """One moment, what was measured, the milliseconds it took; swapped: why left and right look exchanged."""

    frames: Frames
    measured: Measured
    ms: float
    swapped: Inconsistent | None = None


def target_of(named: Path) -> Target:
    """Return the target of a target.yaml, or the board of a text such as checkerboard:9x6:0.025."""
    return parse_board(str(named)) if ":" in named.name and not named.exists() else read_target(named)


def run(
    setup: Setup,
    pairs: MomentSource,
    out: Path | None,
    *,
    progress: Progress,
    world: World | None = None,
    limit: int | None = None,
    about: About | None = None,
) -> MeasureResult:
    """Measure the pairs, or moments of other cameras, of a source not yet open, into the folder out where there is one.

    What was measured before a failure or a cancel is in the files when the error is raised. Raises UsageError,
    DataRefused or DeviceFailed, Cancelled.
    """
    about, pair, report = about or About(), setup.rig.is_pair, Collector(setup, world)
    check = RunCheck(setup) if pair else CamerasCheck(setup)
    outputs, tracker = Outputs(out, world=world, names=setup.rig.names), TargetTracker(setup)
    alone = about.stills or setup.target.is_board
    with pairs:
        moments = iter(pairs)  # files are read while kernels are loaded
        prepare(progress, views=not pair)
        steps = _steps(setup, moments, progress, _total(pairs.total, limit), limit, None if alone else tracker)
        with outputs:
            failure = _taken(steps, check, outputs, report, tracker)
    if outputs.n_frames == 0 and failure is not None:
        raise failure
    consistency = _judged(check, outputs, report, getattr(pairs, "n_late", 0))
    failure = failure or _nothing_seen(outputs, consistency, setup)
    done = outputs.summary(
        setup,
        report.poses,
        consistency,
        grounds_of(report.poses, report.truth(about)),
        skew=pairs.skew,
        error=str(failure) if failure else None,
        assumed_fps=about.assumed_fps,
        zoom=zooms_of(about.zoomed),
        by_camera=None if pair else report.by_camera(consistency),
    )
    if out is not None:
        report.write(out, done, about, progress)
    if failure is not None:
        raise failure if out is None else _with_path(failure, outputs, out)
    return done


def _judged(check: RunCheck | CamerasCheck, outputs: Outputs, report: Collector, late: int) -> Consistency:
    """Return the verdict over the whole run, and give its status, and what is left out, to all that is written.

    late: live frames that were displaced because measuring takes longer than they last; the rate it keeps is said.
    """
    times_s = [pose.t_s for pose in report.poses[:1] + report.poses[-1:]]
    if late and times_s and times_s[-1] > times_s[0]:
        rate_hz = (len(report.poses) - 1) / (times_s[-1] - times_s[0])
        warnings.warn(
            f"{late} frames came faster than they could be measured, and have no pose: this machine kept up with "
            f"{rate_hz:.1f} {outputs.units} a second. Lower the cameras' rate; or record with armsight record, and "
            "measure the recording, of which every frame is measured",
            stacklevel=3,
        )
    consistency = check.finish()
    if isinstance(check, CamerasCheck) and check.without:
        with outputs.again():
            report.again(check.again(), outputs)
    outputs.settle(report.poses, inconsistent=consistency.verdict == "inconsistent")
    return consistency


def _taken(
    steps: Iterable[Step], check: RunCheck | CamerasCheck, outputs: Outputs, report: Collector, tracker: TargetTracker
) -> ArmsightError | None:
    """Check, write and keep each step, and tell a camera that is wrong; return what ended them early."""
    try:
        for step in steps:
            start_s = time.perf_counter()
            measured = check.add(step.measured)
            if isinstance(check, CamerasCheck):
                for left_out in check.left_out[check.n_told :]:
                    warnings.warn(f"{left_out.told} {left_out.cure}", stacklevel=2)
                check.n_told = len(check.left_out)
                tracker.without, tracker.track = check.without, measured.track
            pose = outputs.add(measured)
            report.add(step.frames, measured, pose)
            outputs.took(step.ms + (time.perf_counter() - start_s) * 1e3)
    except ArmsightError as error:
        return error
    return None


def _steps(
    setup: Setup,
    seen: Iterator[Views],
    progress: Progress,
    total: int,
    limit: int | None,
    tracker: TargetTracker | None,
) -> Generator[Step, None, None]:
    """Yield each moment measured, in order, by the tracker, or each by itself without one.

    Raises Cancelled, and Inconsistent for swapped or wrongly sized views.
    """
    measure_all = _singly(setup) if tracker is None else partial(map, partial(_one, tracker))
    done = n_seen = 0
    swapped: list[Inconsistent] = []
    moments = pairs_of(seen) if setup.rig.is_pair else moments_of(seen)
    with closing(moments) as source, closing(_generator(measure_all(islice(source, limit)))) as steps:
        for step in steps:
            yield step
            done += 1
            n_seen += step.measured.pose.status is not PoseStatus.LOST
            swapped += [step.swapped] if step.swapped else []
            if not n_seen and len(swapped) >= SWAPPED_ENOUGH:
                raise swapped[0]
            progress.update(done, total, MEASURING)
            if progress.cancelled():
                raise Cancelled(f"stopped after {done} {units(setup)}")
    if not n_seen and swapped:
        raise swapped[0]


def _singly(setup: Setup) -> Callable[[Iterable[Frames]], Iterable[Step]]:
    """Measure moments in threads, each by itself: a board, or single shots, which tell nothing of each other."""
    return partial(Ahead, lambda frames: _one(TargetTracker(setup), frames))


def units(setup: Setup) -> str:
    """Return what the moments of these cameras are called."""
    return "pairs" if setup.rig.is_pair else "moments"


def _one(tracker: TargetTracker, frames: Frames) -> Step:
    start_s = time.perf_counter()
    measured = tracker.take(*frames)
    return Step(frames=frames, measured=measured, ms=(time.perf_counter() - start_s) * 1e3, swapped=tracker.swapped)


LIGHTS_ON = (
    "the lights must be on, in the cameras' views, and brighter than what is round them. Where they are: --rig and "
    "--target must be theirs, and left be left. --inverted is for dark spots, --mask blackens what is not to be looked "
    "at"
)
WHOLE_BOARD = "the board must be whole, sharp and evenly lit in the views, and its counts and kind those of --target"


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
    first, all_of = outputs.commonest, f"{outputs.n_frames} {units(setup)}"
    wide = wide_rig(setup.rig.baseline_m) if setup.rig.is_pair else ""
    if consistency.refused > 0.0 or consistency.instead or consistency.left_out:
        return NotEnoughData(
            f"the target is seen in the {all_of} and fits in none of them. {sentence(consistency)}",
            consequence="There is no pose",
            cure=advice(consistency),
        )
    return NotEnoughData(
        f"the target was found in none of the {all_of}" + (f"; most often: {first}" if first else ""),
        consequence="There is no pose",
        cure=f"{wide} Look at the report, which shows what was seen: "
        f"{WHOLE_BOARD if setup.target.is_board else LIGHTS_ON}".strip(),
    )


def _with_path(failure: ArmsightError, outputs: Outputs, out: Path) -> ArmsightError:
    """Add to an error what was measured until it came, and where it is."""
    kept = f"What was measured until then ({outputs.n_seen} poses of {outputs.n_frames} {outputs.units}) is in {out}"
    failure.consequence = ". ".join(part.rstrip(".") for part in (failure.consequence, kept) if part)
    return failure


def _total(total: int | None, limit: int | None) -> int:
    """Return how many pairs there will be, 0 where that is not known."""
    return min((n for n in (total, limit) if n is not None), default=0)


def _generator(all_of: Iterable[T]) -> Generator[T, None, None]:
    yield from all_of


def about_pairs(
    frames: FrameSources,
    name: str,
    times: FrameTimes,
    facts: Sequence[tuple[str, str]],
    zoomed: Zoomed,
    *,
    stills: bool,
) -> About:
    """Return what a report says beside the measurement of pairs of frames, which are called by this name."""
    timed = [("time of the frames", times.source)] if times.source and not stills else []
    zero_ns = origin_ns(next(iter(frames.named), None))
    if zero_ns is not None:
        timed.append(("t_s = 0 is the bag's start, Unix time in s", f"{zero_ns / 1e9:.6f}"))
    return About(
        facts=[("frames", name), *facts, *_zoom_facts(zoomed), *timed],
        assumed_fps=None if stills else times.assumed_fps,
        stills=stills,
        recordings=recordings_in(*frames.named),
        zoomed=zoomed,
    )


def zoomed_rig(path: Path, zoom: tuple[float | None, float | None]) -> tuple[Rig, Zoomed]:
    """Return the rig in a file at these zooms. Raises as store.read_rig."""
    found = at_zoom(read_zoom_rig(path), zoom)
    states = zip(found.rig.names, found.states, strict=True)
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


def zooms_of(zoomed: Zoomed) -> dict[str, ZoomAt] | None:
    """Return the figures of the zoom lenses; None where there are none."""
    found = {
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
    return found or None
