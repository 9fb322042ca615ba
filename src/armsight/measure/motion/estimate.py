"""From named spots of single views to poses and velocities: causal, or smoothed over a whole recording.

The strength of the jerk that drives the motion is taken from the data: filters of several levels run side by side, and
a hidden Markov chain tells how likely each is at each moment: by the views before one, and smoothed by all others.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy  # loads its ndimage where it is used
from numpy.typing import NDArray

from armsight.arrays import Array, Mask
from armsight.errors import Inconsistent
from armsight.measure.motion.kernels import levels, smoothing
from armsight.measure.motion.kernels.state import STATE, N, P, R, V
from armsight.measure.motion.states import (
    NO_TIMING,
    MotionState,
    TimingEstimate,
    TimingPrior,
    View,
    estimate_timing,
    state_of,
)
from armsight.optics import PackedRig
from armsight.records import for_kernels, frozen_array, trusted

JERK_LEVELS = 10.0 ** np.arange(-3.0, 4.1)
"""m^2/s^5: from a target at rest to one that is knocked."""
ANGULAR_RATIO = 30.0
"""Angular jerk (rad^2/s^5) over jerk: a hand turns a target about a point some 0.2 m away."""
LEVEL_CHANGE = 0.02
"""Chance that the level changes from one view to the next."""
MOTION = (JERK_LEVELS, ANGULAR_RATIO, LEVEL_CHANGE)
"""The three as kernels take them."""
ONSET_VIEWS = 4
"""Views before and after one whose level it shares at the least: a start is not seen in the view it happens in."""
TIMING_ROUNDS = 4
TIMING_SETTLED_S = 3e-6
"""A change of the timing that no longer counts: 3 um at 1 m/s."""
MAX_GAP_S = 0.5
"""Beyond this nothing is said of where the target went."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Start:
    """A pose T (4, 4) with covariance (6, 6) from which a track begins with the view of this number."""

    view: int
    T: Array
    covariance: Array


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Smoothed:
    """States at the times asked for, None where no track is near; the views' timing, where a prior of it was given.

    jerk (n,): of each view, m^2/s^5.
    """

    states: Sequence[MotionState | None]
    jerk: Array
    timing: TimingEstimate | None = None


def smooth(
    packed: PackedRig,
    positions_m: Array,
    views: Sequence[View],
    starts: Sequence[Start],
    at_s: Array,
    prior: TimingPrior | None = None,
) -> Smoothed:
    """Return the states at times at_s (k,), growing, from all views before and after.

    positions_m (m, 3): of the lights in the target's frame. views: in the order of time. starts: in the order of views;
    the first one is of the first view. prior: of the timing, which is then estimated as well.
    Raises Inconsistent for views out of order.
    """
    t = np.array([view.t_s for view in views])
    if len(starts) == 0 or starts[0].view != 0 or np.any(np.diff(t) < 0.0):
        raise Inconsistent("views come in the order of time, and a track begins with the first of them")
    rig, X = packed.arrays, for_kernels(positions_m)
    seen, order = _columns(views, t, np.zeros(0))
    jerk = _strength(seen, rig, X, _begin(len(t), order, starts, t))
    rows, order = _columns(views, t, at_s)
    begin = _begin(len(rows.t), order, starts, t)
    lead = int(order[0])  # times before the first view are told backwards from it
    rows = rows.after(lead)
    begin = (begin[0][lead:], begin[1][lead:], begin[2][lead:])
    lines = np.zeros((len(rows.tau), 0)) if prior is None else prior.lines(views)
    track, timing = _track(rows, rig, X, np.interp(rows.t, t, jerk), begin, lines, prior)
    states = [track.answer(int(row), t, time) for row, time in zip(rows.asked, at_s, strict=True)]
    return Smoothed(states=states, jerk=jerk, timing=timing)


_Rig = tuple[Array, Array, Array]
"""Both cameras as kernels take them: k, R, t."""

_Begin = tuple[Array, Array, Mask]
"""States (n, 24) and covariances (n, 18, 18) with which rows begin anew, and which rows (n,) do."""


def _begin(n: int, order: NDArray[np.int64], starts: Sequence[Start], t: Array) -> _Begin:
    """Return where the n rows begin anew; order: the rows of the views, of times t."""
    x, C, fresh = np.zeros((n, STATE)), np.zeros((n, N, N)), np.zeros(n, np.bool_)
    for start in starts:
        row = order[start.view]
        x[row], C[row] = state_of(t[start.view], start.T, start.covariance)
        fresh[row] = True
    return x, C, fresh


def _strength(seen: _Columns, rig: _Rig, X: Array, begin: _Begin) -> Array:
    """Return the jerk's level (n,) at each view, such that the others predict it as well as they claim.

    The level by which views follow from those before is that of the motion's slow part, which has most of its power: a
    hand's tremor, or a break in its motion, is smoothed away under it, beyond what the states then claim. So it is the
    least, and what the other views, before and after, say of one decides how much more there is (of smoothing splines:
    Wahba 1983, Nychka 1988).
    """
    n, K = len(seen.t), len(JERK_LEVELS)
    logs, post = np.empty((n, K)), np.empty((n, K))
    levels.run_filters(seen.views, seen.spots, rig, X, MOTION, begin, logs)
    levels.levels_of_all(logs, begin[2], LEVEL_CHANGE, post)
    least = scipy.ndimage.maximum_filter1d(post @ JERK_LEVELS, 2 * ONSET_VIEWS + 1)
    for m, level in enumerate(JERK_LEVELS):
        if m and level <= least.min():
            logs[:, m] = logs[:, m - 1]
            continue
        track, _ = _track(seen, rig, X, np.maximum(least, level), begin, np.zeros((len(seen.tau), 0)), None)
        levels.left_out(track.xs, track.Cs, seen.views, seen.spots, rig, X, logs[:, m])
    levels.levels_of_all(logs, begin[2], LEVEL_CHANGE, post)
    return np.asarray(scipy.ndimage.maximum_filter1d(np.maximum(least, post @ JERK_LEVELS), 2 * ONSET_VIEWS + 1))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Track:
    """Smoothed states of all rows, and how they depend on the timing's unknowns: xs, Cs, ds; with jerk, of times t."""

    t: Array
    xs: Array
    Cs: Array
    ds: Array
    jerk: Array

    def answer(self, row: int, seen_s: Array, t_s: float) -> MotionState | None:
        """Return the state of a row, or (negative) that at a time before the first one; None far from all views."""
        if np.abs(seen_s[np.searchsorted(seen_s, t_s).clip(1, len(seen_s) - 1) - [1, 0]] - t_s).min() > MAX_GAP_S:
            return None
        k = max(row, 0)
        state = MotionState(
            t_s=float(self.t[k]), x=self.xs[k], C=self.Cs[k], jerk=float(self.jerk[k]), by_timing=self.ds[k]
        )
        return state if row >= 0 else state.at(t_s, ANGULAR_RATIO)


def _track(
    rows: _Columns,
    rig: _Rig,
    X: Array,
    jerk: Array,
    begin: _Begin,
    lines: Array,
    prior: TimingPrior | None,
) -> tuple[_Track, TimingEstimate | None]:
    """Filter and smooth with a given jerk, and with the timing that this itself finds where there is a prior of it."""
    q = lines.shape[1]
    run, (ds, dp) = Filtered.empty(rows, rig, X, jerk), (np.empty((len(rows.t), N, q)) for _ in range(2))
    change, timing = np.zeros(q), None
    for _ in range(TIMING_ROUNDS):
        L, g = np.zeros((q, q)), np.zeros(q)
        run.fill(begin, (lines, change), (ds, dp), (L, g))
        if prior is None:
            break
        timing = estimate_timing(prior, L, g, change)
        moved = timing.change - change
        change = np.array(timing.change)
        if np.abs(lines @ moved).max(initial=0.0) < TIMING_SETTLED_S:
            break
    run.smooth(ds, dp)
    return _Track(t=rows.t, xs=run.xs, Cs=run.Cs, ds=ds, jerk=jerk), timing


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Filtered:
    """What one filter over n rows leaves, as smooth wants it: states xs (n, 24), Cs, predictions xp, Cp, and Fs.

    jerk (n,): the strength of the motion that it is for.
    """

    rows: _Columns
    rig: _Rig
    positions_m: Array
    xs: Array
    xp: Array
    Cs: Array
    Cp: Array
    Fs: Array
    jerk: Array

    @classmethod
    def of(
        cls, packed: PackedRig, positions_m: Array, views: Sequence[View], starts: Sequence[Start], jerk: Array
    ) -> Filtered:
        """Return the filter of a motion of strength jerk (n,) over n views. See smooth."""
        t = np.array([view.t_s for view in views])
        rows, order = _columns(views, t, np.zeros(0))
        run, none = cls.empty(rows, packed.arrays, for_kernels(positions_m), jerk), np.zeros((len(t), N, 0))
        lines = np.zeros((len(rows.tau), 0)), np.zeros(0)
        run.fill(_begin(len(t), order, starts, t), lines, (none, none), (np.zeros((0, 0)), np.zeros(0)))
        return run

    @classmethod
    def empty(cls, rows: _Columns, rig: _Rig, positions_m: Array, jerk: Array) -> Filtered:
        """Return room for the filter of these rows."""
        n = len(rows.t)
        xs, xp = (np.empty((n, STATE)) for _ in range(2))
        Cs, Cp, Fs = (np.empty((n, N, N)) for _ in range(3))
        return cls(rows=rows, rig=rig, positions_m=positions_m, xs=xs, xp=xp, Cs=Cs, Cp=Cp, Fs=Fs, jerk=jerk)

    def states(self, ds: Array, dp: Array) -> tuple[tuple[Array, ...], tuple[Array, ...]]:
        """Return filtered and predicted states as kernels take them; ds, dp: how they depend on unknowns."""
        return (self.xs, self.Cs, ds), (self.xp, self.Cp, dp, self.Fs)

    def fill(
        self,
        begin: _Begin,
        late: tuple[Array, Array],
        by_timing: tuple[Array, Array],
        sums: tuple[Array, Array],
    ) -> None:
        """Run the filter. late: lines (m, q) and change (q,) of the timing; by_timing, sums: its ds, dp and L, g."""
        lines, change = late
        light, uv, cov, tau = self.rows.spots
        late_s = frozen_array("late_s", tau + lines @ change, (None,))
        spots, motion = (light, uv, cov, late_s), (self.jerk, ANGULAR_RATIO)
        at = self.rig, self.positions_m
        smoothing.run_filter(self.rows.views, spots, lines, *at, motion, begin, *self.states(*by_timing), sums)

    def smooth(self, ds: Array, dp: Array) -> None:
        """Smooth xs and Cs in place, and how they depend on unknowns: ds of filtered and dp of predicted states."""
        smoothing.smooth(self.rows.t, (self.jerk, ANGULAR_RATIO), *self.states(ds, dp))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Columns:
    """Views and asked times together, in the order of time, as the kernels want them. asked: rows of at_s."""

    t: Array
    side: NDArray[np.int64]
    first: NDArray[np.int64]
    light: NDArray[np.int64]
    uv: Array
    cov: Array
    tau: Array
    asked: NDArray[np.int64]

    @property
    def views(self) -> tuple[Array, NDArray[np.int64], NDArray[np.int64]]:
        """Time, side and first spot of each, and the number of spots behind the last first one."""
        return self.t, self.side, self.first

    @property
    def spots(self) -> tuple[NDArray[np.int64], Array, Array, Array]:
        """Light, pixel, covariance and lateness of each."""
        return self.light, self.uv, self.cov, self.tau

    def after(self, lead: int) -> _Columns:
        """Return the rows from lead on."""
        return _Columns(
            t=self.t[lead:],
            side=self.side[lead:],
            first=self.first[lead:],
            light=self.light,
            uv=self.uv,
            cov=self.cov,
            tau=self.tau,
            asked=self.asked - lead,
        )


def _columns(views: Sequence[View], t: Array, at_s: Array) -> tuple[_Columns, NDArray[np.int64]]:
    """Return the columns, and the row of each view."""
    times = np.concatenate([t, at_s])
    rank = np.argsort(times, kind="stable")
    row = np.empty(len(times), np.int64)
    row[rank] = np.arange(len(times))
    counts = np.zeros(len(times), np.int64)
    counts[row[: len(t)]] = [len(view.lights) for view in views]
    side = np.zeros(len(times), np.int64)
    side[row[: len(t)]] = [view.side for view in views]
    columns = _Columns(
        t=times[rank],
        side=side,
        first=np.concatenate([[0], np.cumsum(counts)]).astype(np.int64),
        light=np.concatenate([view.lights for view in views]).astype(np.int64),
        # read-only as in each view, which kernels take by itself, too
        uv=frozen_array("uv_px", np.concatenate([view.uv_px for view in views]), (None, 2)),
        cov=frozen_array("cov_px2", np.concatenate([view.cov_px2 for view in views]), (None, 2, 2)),
        tau=frozen_array("tau_s", np.concatenate([view.tau_s for view in views]), (None,)),
        asked=row[len(t) :],
    )
    return columns, row[: len(t)]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MotionFilter:
    """Follows a target view by view: the state so far, and where it will be. Each view gives a new one.

    t_s: of the latest view; seen_s: of the latest in which something was seen. xs (K, 24), Cs (K, 18, 18) and
    weights (K,): states under each level of jerk, and the levels' probabilities; best: the likeliest level's row.
    """

    packed: PackedRig
    positions_m: Array
    t_s: float
    seen_s: float
    xs: Array
    Cs: Array
    weights: Array
    best: int

    @classmethod
    def begin(cls, packed: PackedRig, positions_m: Array, t_s: float, T: Array, covariance: Array) -> MotionFilter:
        """Return the filter of lights at positions_m (m, 3) in the target, which is at T (4, 4) with covariance (6,
        6)."""
        K = len(JERK_LEVELS)
        x, C = state_of(t_s, T, covariance)
        return cls(
            packed=packed,
            positions_m=np.ascontiguousarray(positions_m, dtype=np.float64),
            t_s=t_s,
            seen_s=t_s,
            xs=np.tile(x, (K, 1)),
            Cs=np.tile(C, (K, 1, 1)),
            weights=np.full(K, 1.0 / K),
            best=K - 1,
        )

    @property
    def state(self) -> MotionState:
        """The state at the time of the latest view."""
        x, C, jerk = self.xs[self.best], self.Cs[self.best], float(JERK_LEVELS[self.best])
        return trusted(MotionState, t_s=self.t_s, x=x, C=C, jerk=jerk, by_timing=NO_TIMING)

    def at(self, t_s: float) -> MotionState:
        """Return the state expected at t_s."""
        return self.state.at(t_s, ANGULAR_RATIO)

    def after_a_knock(self, t_s: float) -> MotionState:
        """Return the state expected at t_s if the target was knocked just now."""
        return replace(self.state, jerk=float(JERK_LEVELS[-1])).at(t_s, ANGULAR_RATIO)

    def add_pose(self, t_s: float, T: Array, covariance: Array) -> tuple[MotionFilter, float, float]:
        """Bring in a pose T (4, 4), covariance (6, 6), measured at t_s, after the latest view.

        Returns the filter with it, and the squares of how far it was from where the motion before, and where a knock
        just now, would put it, over their uncertainty (6 degrees of freedom).
        """
        seen = np.zeros(STATE)
        seen[P:R], seen[R:V] = T[:3, 3], T[:3, :3].ravel()
        xs, Cs, weights = np.empty_like(self.xs), np.empty_like(self.Cs), np.empty_like(self.weights)
        best, mahalanobis2, knocked = levels.step_poses(
            (self.xs, self.Cs, self.weights),
            self.best,
            t_s - self.t_s,
            MOTION,
            seen,
            for_kernels(covariance),
            (xs, Cs, weights),
        )
        after = replace(self, t_s=t_s, seen_s=t_s, xs=xs, Cs=Cs, weights=weights, best=best)
        return after, mahalanobis2, knocked

    def add(self, *views: View) -> MotionFilter:
        """Bring in a view, or some of one time. Raises Inconsistent where they are older than the last one."""
        t_s = views[0].t_s
        if not t_s >= self.t_s:
            raise Inconsistent(
                f"a view of {t_s:g} s comes after one of {self.t_s:g} s", cure="Give views in the order of time"
            )
        xs, Cs, weights = self.xs.copy(), self.Cs.copy(), self.weights.copy()
        rows, _ = _columns(views, np.array([view.t_s for view in views]), np.zeros(0))
        rig, log = self.packed.arrays, np.empty(len(JERK_LEVELS))
        step = t_s - self.t_s, MOTION, rig, for_kernels(self.positions_m), rows.views[1:], rows.spots, log
        best = levels.step_filters((xs, Cs, weights), *step)
        seen_s = t_s if len(rows.tau) else self.seen_s
        return replace(self, t_s=t_s, seen_s=seen_s, xs=xs, Cs=Cs, weights=weights, best=best)
