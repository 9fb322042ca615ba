"""Frames or spots of cameras that no wire joins -> poses of a moving target at any times, smoothed."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from heapq import merge

import numpy as np
from numpy.typing import NDArray

from armsight.arrays import Array
from armsight.errors import Cancelled, Inconsistent, NotEnoughData, Unseen, UsageError
from armsight.fitting.quantiles import chi2_isf
from armsight.measure.begin import AnyFrame
from armsight.measure.consistency.cameras import AGREEING, again
from armsight.measure.consistency.check import DOUBT, MovingCheck, check_motion, finalise
from armsight.measure.consistency.diagnosis import INCONSISTENT_M, INCONSISTENT_RAD
from armsight.measure.consistency.findings import Consistency, LeftOut
from armsight.measure.consistency.run_of_cameras import accused_in
from armsight.measure.follow import MAX_WITHOUT_WHOLE_S, Follower, systematic_covariance
from armsight.measure.motion.estimate import Start, smooth
from armsight.measure.motion.residuals import MotionResiduals, fitting_stretches, motion_residuals, without_outliers
from armsight.measure.motion.states import MotionState, TimingEstimate, TimingPrior, View
from armsight.measure.poses.setup import Setup
from armsight.measure.results import CameraClock, FreeRunning
from armsight.ops.measurement.streams import Stream, timing_of
from armsight.records import CameraTiming, PoseStatus, Progress, TargetPose
from armsight.records.camera import PPM
from armsight.records.result_parts import BothCounts, BothSeconds
from armsight.units import MS

FOLLOWING = "measuring"
MAX_POSITION_STD_M, MAX_ROTATION_STD_RAD = 0.05, 0.3
"""A position or a rotation less certain than this is none."""
DOUBTFUL_CHI2, MOST_CHI2 = 1.5, 4.0
"""Chi-square per degree of freedom of the spots about the motion from which it is doubted, and refused: cameras' noise
is off by up to a factor of two."""
MOST_JERK = 8000.0
"""m^2/s^5: a target that is knocked all the time is none; cameras that are out of step look like it."""
MOST_UNFIT, FEW_UNFIT = 0.5, 20
"""Share of one camera's frames with lights near the target that do not fit its motion, and how many of them say
nothing."""
DOUBTFUL = (
    "the spots lie further from the target's motion than their noise: the timing, the rig or the target's measures are "
    "off, and the poses may be by more than they claim"
)
OTHER_TIMING = (
    "the delay between the cameras is no longer what was calibrated, and the poses may be off by more than they claim; "
    "calibrate the timing anew: this recording's own differs"
)
CLOCK_FIRST = "Calibrate its timing anew with `armsight calibrate timing`; where it does not fit then, it was knocked"
TIMING_CHANCE = 1e-5
"""Chance below which what a recording says of its timing is not what was calibrated."""
SURPRISING = 0.01
"""Chance from which on what is left open of the timing is as much wider as the recording's own is surprising."""
MISFIT_S = 0.1
"""Nothing is said of the target this near to a view that does not fit its motion, when all that is left does."""
BEFORE_S = 0.05
"""How long before its first view something is said of the target."""
TOO_LITTLE = "too few lights were seen about that time to say where the target was"
GONE = "the target was lost or not found yet, no camera saw three of its lights, or its spots left its motion"
OLD = "no view for so long that only the position is known"
KINDS = {TOO_LITTLE: Unseen.LIGHTS_MISSING, GONE: Unseen.GAP, OLD: Unseen.GAP, DOUBT: Unseen.INCONSISTENT}
"""Kind of each reason, as files count them."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MovingPose:
    """A pose with the velocity (6,) of the target and its standard deviations; None where there is no whole pose."""

    pose: TargetPose
    velocity: Array | None = None
    velocity_std: Array | None = None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FreeRun:
    """Poses at the times asked for, the views they come from, their residuals by camera (m, 3): view, u, v in px."""

    poses: Sequence[MovingPose]
    views: Sequence[View]
    residuals: dict[str, Array]
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
            wrong = None if setup.rig.is_pair else accused_in(done.consistency)
        except Inconsistent:
            wrong = _misfit(setup, streams, left_out, progress)
            if wrong is None:
                raise
        if wrong is None or not _enough_without(names, [*left_out, wrong]):
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


def _misfit(setup: Setup, streams: Sequence[Stream], left_out: Sequence[LeftOut], progress: Progress) -> LeftOut | None:
    """Return the one camera without which all the others' views fit a motion; None where that is not one alone."""
    names, found = setup.rig.names, list[LeftOut]()
    for name, stream in zip(names, _without(names, left_out, streams), strict=True):
        wrong = LeftOut(
            names=(name,),
            words=f"The views of the camera {name} fit no motion that the others see",
            cure=f"{CLOCK_FIRST}. {again(name)}",
        )
        if not len(stream.t_s):
            continue
        if not _enough_without(names, [*left_out, wrong]):
            return None
        with suppress(Inconsistent, NotEnoughData):
            _measured(setup, _without(names, [*left_out, wrong], streams), None, None, progress)
            found.append(wrong)
    return found[0] if len(found) == 1 else None


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
    made = _PoseBuilder(
        setup=setup,
        wider=max(chi2 or 1.0, 1.0),
        timing=smoothed.timing,
        first_clock=streams[0].clock_covariance,
        check=check,
        seen_s=seen_s,
        doubted=check.verdict.verdict == "inconsistent" or _contradicts(smoothed.timing, asked),
    )
    poses = [
        made.pose(float(t), state, _names(setup, views, seen_s, float(t))) for t, state in zip(at_s, asked, strict=True)
    ]
    figures = _figures(setup, smoothed.timing, views, len(starts), chi2, asked, times)
    residuals = _by_camera(setup.rig.names, found)
    return FreeRun(poses=poses, views=views, residuals=residuals, figures=figures, consistency=check.verdict)


def _by_camera(names: Sequence[str], found: MotionResiduals) -> dict[str, Array]:
    return {
        name: np.column_stack([found.view[found.side == side], found.residual_px[found.side == side]])
        for side, name in enumerate(names)
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
            cure="Begin with the target at rest, before a background that is darker than its lights",
        )
    for side, name in enumerate(setup.rig.names):
        unfit, seen = follower.unfit[side], follower.unfit[side] + _of_side(views, side)
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


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _PoseBuilder:
    """Turns states into poses: their uncertainty widened by what the spots do not fit the motion, and with what rig,
    target and timing leave open, and may have wrong by the check of the views, which are of seen_s.

    first_clock: covariance of the clock that the poses' times are of. doubted: the run does not fit its claims.
    """

    setup: Setup
    wider: float
    timing: TimingEstimate | None
    first_clock: Callable[[float], Array]
    check: MovingCheck
    seen_s: Array
    doubted: bool

    def pose(self, t_s: float, state: MotionState | None, names: tuple[str, ...]) -> MovingPose:
        """Return the pose of a state at t_s, seen by the lights of these names."""
        if state is None:
            return MovingPose(pose=TargetPose(t_s=t_s, status=PoseStatus.LOST, parent="rig", why=GONE))
        systematic = self._systematic(state)
        C = self.wider * state.covariance + systematic
        T = state.T_rig_target
        if np.sqrt(np.trace(C[:3, :3])) > MAX_POSITION_STD_M:
            return MovingPose(pose=TargetPose(t_s=t_s, status=PoseStatus.LOST, parent="rig", why=TOO_LITTLE))
        if np.sqrt(np.trace(C[3:, 3:])) > MAX_ROTATION_STD_RAD:
            T[:3, :3] = np.eye(3)
            return MovingPose(
                pose=TargetPose(
                    t_s=t_s,
                    status=PoseStatus.POSITION_ONLY,
                    parent="rig",
                    spots=names,
                    T_parent_target=T,
                    covariance=C[:3, :3],
                    why=OLD,
                    systematic_covariance=systematic[:3, :3],
                    origin_known=True,
                )
            )
        pose = TargetPose(
            t_s=t_s,
            status=PoseStatus.OK,
            parent="rig",
            spots=names,
            T_parent_target=T,
            covariance=C,
            systematic_covariance=systematic,
        )
        std = np.sqrt(self.wider * np.diag(state.velocity_covariance))
        return MovingPose(pose=finalise(pose, inconsistent=self.doubted), velocity=state.velocity, velocity_std=std)

    def _systematic(self, state: MotionState) -> Array:
        """Return the covariance (6, 6) of what repeats from pose to pose."""
        v = state.velocity
        out = float(self.first_clock(state.t_s)[0, 0]) * np.outer(v, v)
        if self.timing is not None:
            D = state.by_timing[:6]
            excess = self.timing.mahalanobis2 / float(chi2_isf(SURPRISING, len(self.timing.change)))
            out += max(excess, 1.0) * (D @ self.timing.covariance @ D.T)
        fault = self.check.verdict.second_moment
        if fault is not None:
            S = self.check.slopes[np.abs(self.seen_s - state.t_s).argmin()]
            out += S @ fault @ S.T
        fixed = systematic_covariance(self.setup, state)
        return out if fixed is None else out + fixed


def _names(setup: Setup, views: Sequence[View], seen_s: Array, t_s: float) -> tuple[str, ...]:
    """Return the lights seen in the view of each camera nearest in time."""
    k, v = int(np.searchsorted(seen_s, t_s)), len(setup.rig.cameras)
    lights: set[int] = set()
    for side in range(v):
        near = [one for one in views[max(k - 2 * v, 0) : k + 2 * v] if one.side == side]
        if near:
            lights |= set(min(near, key=lambda one: abs(one.t_s - t_s)).lights.tolist())
    return tuple(name for i, name in enumerate(setup.model.names) if i in lights)


def _figures(
    setup: Setup,
    timing: TimingEstimate | None,
    views: Sequence[View],
    n_starts: int,
    chi2: float | None,
    states: Sequence[MotionState | None],
    times: Sequence[Array],
) -> FreeRunning:
    speed = [float(np.linalg.norm(state.velocity[:3])) for state in states if state is not None]
    rms = float(np.sqrt(np.mean(np.square(speed)))) if speed else None
    clocks = dict(zip(setup.rig.names, _clocks(timing_of(setup.rig), timing, views), strict=True))
    note = DOUBTFUL if chi2 is not None and chi2 > DOUBTFUL_CHI2 else None
    if note is None and _contradicts(timing, states):
        late = max(clocks.values(), key=lambda one: abs(one.delay_change_s) / (one.delay_std_s or np.inf))
        note = f"{OTHER_TIMING} by {late.delay_change_s / MS:+.2f} ms"
    pair = clocks if setup.rig.is_pair else {}
    second = pair.get("right")
    first, *others = [one for one in times if len(one)]
    apart = np.concatenate([np.empty(0), *(_nearest(first, other) for other in others)])
    return FreeRunning(
        delay_s=second.delay_s if second else None,
        drift_ppm=second.drift_ppm if second else None,
        readout_s=BothSeconds(**{name: one.readout_s for name, one in pair.items()}) if pair else None,
        delay_change_s=second.delay_change_s if second else None,
        delay_std_s=second.delay_std_s if second else None,
        n_views=BothCounts(**{name: one.n_views for name, one in pair.items()}) if pair else None,
        by_camera=None if pair else clocks,
        n_starts=n_starts,
        note=note,
        chi2_per_dof=chi2,
        speed_m_s=rms,
        nearest_pairs_m=rms * float(np.sqrt(np.mean(apart**2))) if rms is not None and len(apart) else None,
    )


def _clocks(
    cameras: Sequence[CameraTiming], timing: TimingEstimate | None, views: Sequence[View]
) -> Iterator[CameraClock]:
    """Yield what each camera's clock is by its file and by this recording's views."""
    v = len(cameras)
    change, mid_s = (np.zeros(3 * v - 2), 0.0) if timing is None else (timing.change, timing.prior.mid_s)
    for k, one in enumerate(cameras):
        late, drift = change[2 * k - 2 : 2 * k].tolist() if k else (0.0, 0.0)
        known = timing is not None and k > 0
        yield CameraClock(
            delay_s=one.delay_s + late - PPM * drift * mid_s,
            drift_ppm=one.drift_ppm + drift,
            readout_s=one.readout_s + float(change[2 * v - 2 + k]),
            delay_change_s=late,
            delay_std_s=float(np.sqrt(timing.covariance[2 * k - 2, 2 * k - 2])) if known and timing else None,
            n_views=_of_side(views, k),
        )


def _contradicts(timing: TimingEstimate | None, states: Sequence[MotionState | None]) -> bool:
    """Tell whether what a recording says of its timing is beyond chance not what was calibrated, and moves the poses.

    By as much as a fault of rig or target must before a run is called inconsistent.
    """
    moved = [state.by_timing[:6] @ timing.change for state in states if state is not None] if timing else []
    if timing is None or not moved or not timing.mahalanobis2 > chi2_isf(TIMING_CHANCE, len(timing.change)):
        return False
    square = np.mean(np.square(moved), axis=0)
    return bool(square[:3].sum() > INCONSISTENT_M**2 or square[3:].sum() > INCONSISTENT_RAD**2)


def _of_side(views: Iterable[View], side: int) -> int:
    return sum(view.side == side for view in views)


def _nearest(left_s: Array, right_s: Array) -> Array:
    """Return how far each left frame is from the right frame nearest in time, s."""
    after = np.searchsorted(right_s, left_s).clip(1, max(len(right_s) - 1, 1))
    return np.asarray(
        np.minimum(np.abs(right_s[after - 1] - left_s), np.abs(right_s[after.clip(max=len(right_s) - 1)] - left_s))
    )
