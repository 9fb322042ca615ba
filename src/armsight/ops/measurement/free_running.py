"""Frames or spots of cameras that no wire joins -> poses of a moving target at any times, smoothed."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from heapq import merge

import numpy as np
from numpy.typing import NDArray

from armsight.arrays import Array
from armsight.errors import Cancelled, Inconsistent, NotEnoughData, UsageError
from armsight.measure.begin import AnyFrame
from armsight.measure.consistency.cameras import AGREEING, again
from armsight.measure.consistency.check import check_motion
from armsight.measure.consistency.findings import Consistency, LeftOut
from armsight.measure.consistency.run_of_cameras import accused_in
from armsight.measure.follow import MAX_WITHOUT_WHOLE_S, Follower
from armsight.measure.motion.estimate import Start, smooth
from armsight.measure.motion.residuals import MotionResiduals, fitting_stretches, motion_residuals, without_outliers
from armsight.measure.motion.states import TimingPrior, View
from armsight.measure.poses.setup import Setup
from armsight.measure.results import FreeRunning
from armsight.ops.measurement.free_poses import MovingPose, PoseBuilder, contradicts, figures_of, lights_near, n_of_side
from armsight.ops.measurement.streams import Stream, timing_of
from armsight.records import CameraTiming, Progress

FOLLOWING = "measuring"
MOST_CHI2 = 4.0
"""Chi-square per degree of freedom of the spots about the motion from which it is refused."""
MOST_JERK = 8000.0
"""m^2/s^5: a target that is knocked all the time is none; cameras that are out of step look like it."""
MOST_UNFIT, FEW_UNFIT = 0.5, 20
"""Share of one camera's frames with lights near the target that do not fit its motion, and how many of them say
nothing."""
CLOCK_FIRST = "Calibrate its timing anew with `armsight calibrate timing`; where it does not fit then, it was knocked"
MISFIT_S = 0.1
"""Nothing is said of the target this near to a view that does not fit its motion, when all that is left does."""
BEFORE_S = 0.05
"""How long before its first view something is said of the target."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FreeRun:
    """Poses at the times asked for, the views they come from, their residuals by camera (m, 3): view, u, v in px,
    of all sights but n_aside, known too badly to judge by."""

    poses: Sequence[MovingPose]
    views: Sequence[View]
    residuals: dict[str, Array]
    n_aside: int
    figures: FreeRunning
    consistency: Consistency


def measure_free_running(
    setup: Setup, streams: Sequence[Stream], at_s: Array | None, rate_hz: float | None, progress: Progress
) -> FreeRun:
    """Return poses at at_s (k,) in the rig's time, at a steady rate, or (both None) at the times of the first camera's
    frames.

    A camera of three and more that the others' views accuse is left out. Raises UsageError for a target that has no
    three known lights, NotEnoughData where it was never found, Inconsistent where the spots fit no motion of it,
    Cancelled.
    """
    if setup.target.is_board or not setup.target.model_known or len(setup.model) < 3:
        raise UsageError(
            "free-running cameras need a target of three or more lights of known positions",
            cure="Measure the target first (armsight calibrate target), or use --timing pairs",
        )
    names, left_out = setup.rig.names, list[LeftOut]()
    while True:
        kept = _without(names, left_out, streams)
        try:
            done = _measured(setup, kept, at_s, rate_hz, progress)
            wrong = None if setup.rig.is_pair else _accused(setup, streams, done, left_out, progress)
        except Inconsistent:
            wrong = _misfit(setup, streams, left_out, progress)
            if wrong is None:
                raise
        if wrong is None:
            break
        left_out.append(wrong)
        warnings.warn(f"{wrong.told} {wrong.cure}", stacklevel=2)
    return replace(done, consistency=replace(done.consistency, left_out=tuple(left_out))) if left_out else done


def _measured(
    setup: Setup, streams: Sequence[Stream], at_s: Array | None, rate_hz: float | None, progress: Progress
) -> FreeRun:
    """See measure_free_running."""
    timing = timing_of(setup.rig)
    times = [timing[side].rig_time(stream.t_s) for side, stream in enumerate(streams)]
    views, starts = _that_fit(setup, *_follow(setup, streams, times, progress))
    if at_s is None:
        first = next(one for one in times if len(one))
        at_s = first if rate_hz is None else np.arange(first[0], first[-1] + 0.5 / rate_hz, 1.0 / rate_hz)
    return _smoothed(setup, streams, times, at_s, views, starts)


def _fits(
    setup: Setup, streams: Sequence[Stream], left_out: Sequence[LeftOut], progress: Progress
) -> list[tuple[LeftOut, FreeRun]]:
    """Return the cameras without which the others' views fit a motion, and these views' run; none where too few would
    be left."""
    names, found = setup.rig.names, list[tuple[LeftOut, FreeRun]]()
    for name, stream in zip(names, _without(names, left_out, streams), strict=True):
        wrong = LeftOut(
            names=(name,),
            words=f"The views of the camera {name} fit no motion that the others see",
            cure=f"{CLOCK_FIRST}. {again(name)}",
        )
        if not len(stream.t_s) or not _enough_without(names, [*left_out, wrong]):
            continue
        with suppress(Inconsistent, NotEnoughData):
            found.append((wrong, _measured(setup, _without(names, [*left_out, wrong], streams), None, None, progress)))
    return found


def _misfit(setup: Setup, streams: Sequence[Stream], left_out: Sequence[LeftOut], progress: Progress) -> LeftOut | None:
    """Return the one camera without which all the others' views fit a motion, or without which alone they agree too: a
    small knock bends a motion that fits. None where that is not one alone."""
    found = _fits(setup, streams, left_out, progress)
    agreeing = [one for one in found if not one[1].consistency.findings]
    named = agreeing if len(agreeing) == 1 else found
    return named[0][0] if len(named) == 1 else None


def _accused(
    setup: Setup, streams: Sequence[Stream], done: FreeRun, left_out: Sequence[LeftOut], progress: Progress
) -> LeftOut | None:
    """Return the camera that the innovations accuse, or, as these mistake one for another where a knock is large, the
    one without which the others fit best. None where none is accused."""
    if done.consistency.open_which:
        return _misfit(setup, streams, left_out, progress)
    told = accused_in(done.consistency)
    if told is None or not _enough_without(setup.rig.names, [*left_out, told]):
        return None
    found = _fits(setup, streams, left_out, progress)
    best, _ = min(found, key=lambda one: one[1].figures.chi2_per_dof or 0.0, default=(told, done))
    return told if set(best.names) <= set(told.names) else best


def _enough_without(names: Sequence[str], left_out: Sequence[LeftOut]) -> bool:
    """Whether enough cameras are left to tell which are right."""
    return len(names) - len({name for one in left_out for name in one.names}) >= AGREEING


def _without(names: Sequence[str], left_out: Sequence[LeftOut], streams: Sequence[Stream]) -> list[Stream]:
    """Return the streams, without frames of the cameras that are left out."""
    out = {name for one in left_out for name in one.names}
    return [stream.first(0) if name in out else stream for name, stream in zip(names, streams, strict=True)]


def _smoothed(
    setup: Setup,
    streams: Sequence[Stream],
    times: Sequence[Array],
    at_s: Array,
    views: Sequence[View],
    starts: Sequence[Start],
) -> FreeRun:
    """Return the poses at at_s (k,) by all views, which fit one motion, and what these say of rig and target."""
    timing = timing_of(setup.rig)
    seen_s = np.array([view.t_s for view in views])
    all_s, rows = np.unique(np.concatenate([at_s, seen_s]), return_inverse=True)
    smoothed = smooth(setup.packed, setup.model.xyz_m, views, starts, all_s, _prior(timing, streams, times))
    views = smoothed.timing.retimed(views) if smoothed.timing else views
    lost = _between(all_s, seen_s, starts)
    states = [None if gone else one for one, gone in zip(smoothed.states, lost, strict=True)]
    found = motion_residuals(setup.packed, setup.model.xyz_m, views, [states[k] for k in rows[len(at_s) :]])
    off = found.outliers(len(views))
    chi2 = found.of_views(~off).chi2_per_dof()
    whole = np.array([len(view.lights) >= 3 for view in views])
    unsure = (_from(seen_s[off], at_s) < MISFIT_S) | (_from(seen_s[whole & ~off], at_s) > MAX_WITHOUT_WHOLE_S)
    asked = [None if refused else states[k] for k, refused in zip(rows[: len(at_s)], unsure, strict=True)]
    check = check_motion(setup, views, starts, smoothed.jerk)
    made = PoseBuilder(
        setup=setup,
        wider=max(chi2 or 1.0, 1.0),
        timing=smoothed.timing,
        first_clock=streams[0].clock_covariance,
        check=check,
        seen_s=seen_s,
        doubted=check.verdict.verdict == "inconsistent" or contradicts(smoothed.timing, asked),
    )
    poses = [
        made.pose(float(t), state, lights_near(setup, views, seen_s, float(t)))
        for t, state in zip(at_s, asked, strict=True)
    ]
    figures = figures_of(setup, smoothed.timing, views, len(starts), chi2, asked, times)
    residuals, n_aside = _by_camera(setup.rig.names, found), int((~found.judged).sum())
    return FreeRun(
        poses=poses, views=views, residuals=residuals, n_aside=n_aside, figures=figures, consistency=check.verdict
    )


def _by_camera(names: Sequence[str], found: MotionResiduals) -> dict[str, Array]:
    return {
        name: np.column_stack([found.view[rows], found.residual_px[rows]])
        for rows, name in ((found.judged & (found.side == side), name) for side, name in enumerate(names))
    }


def _that_fit(setup: Setup, views: list[View], starts: list[Start]) -> tuple[list[View], list[Start]]:
    """Return the stretches that a target's motion explains. Raises Inconsistent where that is less than half."""
    kept, begun = views, starts
    for last in (False, False, True):
        n = len(kept)
        at_s, rows = np.unique([view.t_s for view in kept], return_inverse=True)
        at = smooth(setup.packed, setup.model.xyz_m, kept, begun, at_s).states
        states = [at[k] for k in rows]
        found = motion_residuals(setup.packed, setup.model.xyz_m, kept, states)
        times = np.sqrt(found.chi2_per_dof() or np.inf)
        if not last:
            kept, begun = without_outliers(found, kept, begun, states)
        last |= len(kept) == n
        if last:
            kept, begun = fitting_stretches(found, kept, begun, MOST_CHI2)
        if len(kept) < 0.5 * len(views):
            raise _out_of_step(f"the spots are {times:.1f} times further from the target's motion than their noise")
        if last:
            break
    if np.median([state.jerk for state in states if state is not None] or [0.0]) > MOST_JERK:
        raise _out_of_step("only a target that is knocked all the time would be seen like this")
    return kept, begun


def _out_of_step(cause: str) -> Inconsistent:
    return Inconsistent(
        cause,
        consequence="The poses would be wrong by more than they claim, and none is given",
        cure="Calibrate the timing anew with these cameras, check the target's measures and the rig",
    )


def _follow(
    setup: Setup, streams: Sequence[Stream], times: Sequence[Array], progress: Progress
) -> tuple[list[View], list[Start]]:
    """Return the named views of all frames, and where the target was found. See measure_free_running."""
    follower, total = Follower(setup=setup, timing=timing_of(setup.rig)), sum(len(one) for one in times)
    sides = [_timed(stream, t_s, side) for side, (stream, t_s) in enumerate(zip(streams, times, strict=True))]
    for done, (_, side, frame) in enumerate(merge(*sides, key=_when)):
        follower.add(frame, side)
        progress.update(done + 1, total, FOLLOWING)
        if progress.cancelled():
            raise Cancelled(f"stopped after {done + 1} frames", consequence="Nothing was written")
    views, starts = follower.tracks()
    if not starts:
        raise NotEnoughData(
            f"the target was followed in none of the {total} frames: {follower.why}",
            consequence="There is no pose",
            cure="Begin with the target at rest before a darker background; give each camera its own frames",
        )
    for side, name in enumerate(setup.rig.names):
        unfit, seen = follower.unfit[side], follower.unfit[side] + n_of_side(views, side)
        if unfit > max(FEW_UNFIT, MOST_UNFIT * seen):
            others = "other one sees" if setup.rig.is_pair else "others see"
            raise _out_of_step(
                f"{unfit} of the {seen} frames of the {name} camera show lights that do not fit the motion that the "
                f"{others}"
            )
    return views, starts


def _between(t_s: Array, seen_s: Array, starts: Sequence[Start]) -> NDArray[np.bool_]:
    """Tell of times whether they lie before the target was found, or between a stretch that was lost and the next."""
    out = np.asarray(t_s < seen_s[0] - BEFORE_S)
    for start in starts[1:]:
        out |= (t_s > seen_s[start.view - 1]) & (t_s < seen_s[start.view])
    return out


def _from(seen_s: Array, t_s: Array) -> Array:
    """Return how far each of t_s (k,) is from the nearest of seen_s (n,), growing; infinite where there is none."""
    if not len(seen_s):
        return np.full(len(t_s), np.inf)
    after = np.searchsorted(seen_s, t_s)
    near = np.stack([seen_s[(after - 1).clip(0)], seen_s[after.clip(max=len(seen_s) - 1)]])
    return np.asarray(np.abs(near - t_s).min(axis=0))


def _when(item: tuple[float, int, AnyFrame]) -> tuple[float, int]:
    return item[:2]


def _timed(stream: Stream, t_s: Array, side: int) -> Iterator[tuple[float, int, AnyFrame]]:
    """Yield the rig's time, the side and the frame with its steady stamp."""
    for t, stamp, frame in zip(t_s.tolist(), stream.t_s.tolist(), stream.read(), strict=True):
        yield t, side, replace(frame, t_s=stamp)


def _prior(timing: Sequence[CameraTiming], streams: Sequence[Stream], times: Sequence[Array]) -> TimingPrior:
    """Return what is known of the timing in the middle of what both cameras saw."""
    seen = [t for t in times if len(t)]
    mid_s = 0.5 * (max(t[0] for t in seen) + min(t[-1] for t in seen))
    return TimingPrior.of(timing, mid_s, [stream.clock_covariance(mid_s) for stream in streams])
