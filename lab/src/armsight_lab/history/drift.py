"""Whether a figure of a cell has changed from run to run: control charts that need no known mean or spread.

The first runs of a cell are few, and what their deviations claim may be too small. Charts that take an estimated mean
and spread for the true ones give false alarms many times as often as they say (Jensen et al., Effects of parameter
estimation on control chart properties, J. Quality Technology 38, 2006). Here each run is held against those before it:

- `scores`: the recursive residual of run i from the weighted mean of the runs before it, over what both are uncertain
  by, is Student's t; as a normal score it is N(0, 1) and independent of those before, whatever mean and spread are
  (Quesenberry, SPC Q charts for start-up processes, J. Quality Technology 23, 1991; Hawkins, Self-starting CUSUM charts
  for location and scale, The Statistician 36, 1987). Runs are weighed by the deviations they tell; how much larger the
  scatter between runs is than these, one factor, is estimated with them.
- a jump is a score beyond a limit (Shewhart, Economic Control of Quality of Manufactured Product, 1931);
- a drift is a sum of scores beyond another (CUSUM; Page, Continuous inspection schemes, Biometrika 41, 1954).

Both limits follow from how often a false alarm may come.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

# not armsight.fitting.quantiles: its package takes longer to load than a history to be judged
from scipy.special import ndtr, ndtri, stdtr, stdtrit

from armsight.arrays import Array

SLACK = 1.0
"""Of the CUSUM, in deviations of one run, taken off each score: half of SMALLEST_STEP."""
SMALLEST_STEP = 2.0 * SLACK
"""Deviations of one run: the smallest lasting change that the CUSUM is made for. For a change of the mean by d the
fastest CUSUM has the slack d/2 (Moustakides, Optimal stopping times for detecting changes in distributions, Annals of
Statistics 14, 1986)."""
TOLD_FACTOR = 1.5
"""What told deviations are taken to be too small by until the runs themselves say more: rigs, light and temperature
change between runs, which no single run sees."""
TOLD_WORTH = 6.0
"""How many runs that counts for."""
WILD = 2.0
"""Scores beyond it count as that much in mean and spread: one wild run must not hide the next."""
CUT_SQUARE = float(
    1.0 - 2.0 * WILD * np.exp(-0.5 * WILD**2) / np.sqrt(2.0 * np.pi) - 2.0 * (1.0 - WILD**2) * ndtr(-WILD)
)
"""Mean square of a normal score so cut: what the sum of squares is divided by (Huber, Robust Statistics, 1981, 6.7)."""
FEWEST_OF_A_SLOPE = 4
"""Runs since a change from which on it is told whether it goes on."""
LEAST_DOF = 6.0
"""Degrees of freedom below which nothing is judged: of figures whose deviation nobody tells, the first runs."""
SURE_DOF = 15.0
"""Degrees of freedom of the scatter below which every run is learned at once: one that is guessed is not held on to."""
FAR = 3.0
"""Scores beyond it count as that much in the correlation."""
MOST_CORRELATED = 0.8
"""Correlation of a run's error with that of the one before, at the most."""
RESERVE = 4.0
"""By how much longer the CUSUM's run length is made than that of exact scores: the scatter is estimated, and not
learned on while a sum is above zero. With it simulated cells give fewer false alarms than said
(benchmarks/history.py)."""
OVERSHOOT = 1.166
"""2 rho, by which a random walk of normal steps passes a limit (Siegmund, Sequential Analysis, 1985, section 2.5)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Limits:
    """Of a chart, in deviations: a score beyond jump, a sum beyond drift."""

    jump: float
    drift: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Chart:
    """Charts of p figures over n runs, all (n, p): scores, NaN where a run has no such figure or nothing before it; the
    sums upwards and downwards. mean, std: what the runs before each let expect of it, in the figure's unit. factor: how
    much larger the scatter between runs is than they tell, correlation: of each with the one before, as those before
    say.
    """

    score: Array
    up: Array
    down: Array
    mean: Array
    std: Array
    factor: Array
    correlation: Array

    def column(self, k: int) -> Chart:
        """Return the chart of one figure, (n, 1)."""
        return Chart(**{one.name: getattr(self, one.name)[:, k : k + 1] for one in fields(self)})

    def alarms(self, limits: Limits) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """Return where a score is beyond its limit, and where a sum is, (n, p) each."""
        with np.errstate(invalid="ignore"):
            return np.abs(self.score) > limits.jump, np.maximum(self.up, self.down) > limits.drift


def limits_for(false_alarms_apart_years: float, runs_a_year: float, figures: int) -> Limits:
    """Return the limits of a figure's two charts: all charts of so many figures together give one false alarm in so
    many years of a cell. Each has its even share, as if none hung together (Bonferroni).
    """
    runs = 2.0 * figures * runs_a_year * false_alarms_apart_years
    return Limits(jump=jump_limit(runs), drift=drift_limit(RESERVE * runs))


def jump_limit(average_run_length: float) -> float:
    """Return the limit of normal scores that chance passes, up or down, once in so many runs."""
    return float(-ndtri(0.5 / average_run_length))


def drift_limit(average_run_length: float, slack: float = SLACK) -> float:
    """Return the limit of a two-sided CUSUM that chance passes once in so many runs: Siegmund's run length, solved.

    One side alone then takes twice as long (both hardly ever pass in one excursion).
    """
    low, high = 0.0, 100.0
    for _ in range(60):  # bisection: the run length grows with the limit
        middle = 0.5 * (low + high)
        low, high = (middle, high) if run_length(middle, slack) < 2.0 * average_run_length else (low, middle)
    return high


def run_length(limit: float, slack: float, mean: float = 0.0) -> float:
    """Return the average run length of a one-sided CUSUM of normal scores with this mean.

    Siegmund's approximation: (exp(-2 D b) + 2 D b - 1) / (2 D^2), D = mean - slack, b = limit + 1.166 (Siegmund,
    Sequential Analysis, 1985, eq. 2.57); within 7 % of the exact one for slacks up to 1.
    """
    off, b = mean - slack, limit + OVERSHOOT
    if abs(off) < 1e-9:
        return b * b
    return float((np.exp(-2.0 * off * b) + 2.0 * off * b - 1.0) / (2.0 * off * off))


@np.errstate(over="ignore", invalid="ignore")  # what cannot be reckoned with has no expected deviation: NaN
def charted(x: Array, told: Array, *, slack: float = SLACK) -> Chart:
    """Return the charts of figures x (n, p) in the order of time with the deviations that they tell (n, p).

    NaN in x: the run has no such figure. A column of told that is NaN throughout tells none: all runs weigh alike.
    """
    n, p = x.shape
    silent = ~np.isfinite(told).any(axis=0)
    s = np.where(silent, 1.0, told)
    state = _State.empty(p, np.where(silent, 0.0, TOLD_WORTH))
    out = [np.full((n, p), np.nan) for _ in range(7)]
    score, up, down, mean, std, factor, correlation = out
    above, below = np.zeros(p), np.zeros(p)
    for i in range(n):
        known = np.isfinite(x[i]) & np.isfinite(s[i]) & (s[i] > 0.0)
        mean[i], std[i], factor[i] = state.expected(s[i])
        correlation[i] = state.correlation()
        score[i] = state.take(x[i], s[i], known)
        heard = np.isfinite(score[i])
        # the sum of an autoregressive course scatters more than one of independent steps, by this factor
        step = np.where(heard, score[i], 0.0) * np.sqrt((1.0 - correlation[i]) / (1.0 + correlation[i]))
        above = np.where(heard, np.maximum(0.0, above + step - slack), above)
        below = np.where(heard, np.maximum(0.0, below - step - slack), below)
        up[i], down[i] = above, below
        state.learn((above == 0.0) & (below == 0.0))
    return Chart(score=score, up=up, down=down, mean=mean, std=std, factor=factor, correlation=correlation)


@dataclass(slots=True, kw_only=True, eq=False)
class _State:
    """What the runs so far say of p figures: weight, their sum of weights; mean, the weighted one; worth: runs that the
    told deviations count for; last: the last score; steps (2, p): how many scores follow another, and their squared
    differences.

    learned (4, p): how many runs tell the scatter, their sum of squares; how many have a score, and its squares.
    pending (4, p): the same of the runs since a sum last stood at zero. These may be those of a change, which would
    make itself look like scatter: they are learned once both sums are at zero again.
    """

    weight: Array
    mean: Array
    worth: Array
    last: Array
    steps: Array
    learned: Array
    pending: Array

    @classmethod
    def empty(cls, p: int, worth: Array) -> _State:
        zero, four = np.zeros(p), np.zeros((4, p))
        last = np.full(p, np.nan)
        return cls(weight=zero, mean=zero, worth=worth, last=last, steps=np.zeros((2, p)), learned=four, pending=four)

    @property
    def dof(self) -> Array:
        """Degrees of freedom of the scatter, (p,)."""
        dof: Array = self.worth + self.learned[0] - 1.0
        return dof

    def expected(self, s: Array) -> tuple[Array, Array, Array]:
        """Return mean, deviation of a run that tells s, factor on told deviations (p,); NaN where nothing is known."""
        with np.errstate(divide="ignore", invalid="ignore"):
            known = (self.weight > 0.0) & (self.dof >= LEAST_DOF)
            factor = np.sqrt((self.worth * TOLD_FACTOR**2 + self.learned[1]) / self.dof)
            std = factor * np.sqrt(s**2 + 1.0 / self.weight)
        return np.where(known, self.mean, np.nan), np.where(known, std, np.nan), np.where(known, factor, np.nan)

    def take(self, x: Array, s: Array, known: NDArray[np.bool_]) -> Array:
        """Return the normal scores (p,) of a run, and count it in."""
        mean, std, _ = self.expected(s)
        with np.errstate(divide="ignore", invalid="ignore"):
            t = np.where(known, (x - mean) / std, np.nan)
            score = normal_score(t, self.dof)
            cut = np.sign(t) * stdtrit(np.maximum(self.dof, 1.0), ndtr(WILD))
            off = np.where(np.abs(score) > WILD, cut * std, x - self.mean)
            gain = 1.0 / s**2
            spread = np.where(self.weight > 0.0, off**2 / (s**2 + 1.0 / self.weight) / CUT_SQUARE, 0.0)
        kept = np.clip(score, -FAR, FAR)
        step = kept - self.last
        self.steps = self.steps + np.stack([np.isfinite(step), np.nan_to_num(step**2)])
        counted = np.stack([np.ones(len(x)), spread, np.isfinite(kept), np.nan_to_num(kept**2)])
        self.pending = np.where(known, self.pending + counted, self.pending)
        self.mean = np.where(known, self.mean + off * gain / (self.weight + gain), self.mean)
        self.weight = np.where(known, self.weight + gain, self.weight)
        self.last = np.where(np.isfinite(score), kept, self.last)
        return score

    def learn(self, quiet: NDArray[np.bool_]) -> None:
        """Count the pending runs in where both sums stand at zero, or where little is known of the scatter yet."""
        quiet = quiet | (self.dof < SURE_DOF)
        self.learned = np.where(quiet, self.learned + self.pending, self.learned)
        self.pending = np.where(quiet, 0.0, self.pending)

    def correlation(self) -> Array:
        """Return how far each run's error hangs on the one before, as the runs say.

        From the squared steps between scores against their squares (von Neumann's ratio): a change of the mean makes
        one such step, and does not look like correlation. Never below 0: that is chance.
        """
        with np.errstate(divide="ignore", invalid="ignore"):
            r = 1.0 - 0.5 * (self.steps[1] / self.steps[0]) / (self.learned[3] / self.learned[2])
        return np.where(self.learned[2] > FEWEST_OF_A_SLOPE, np.clip(np.nan_to_num(r), 0.0, MOST_CORRELATED), 0.0)


def normal_score(t: Array, dof: Array) -> Array:
    """Return the normal score of Student's t (p,): as far out in N(0, 1), NaN where dof is not positive."""
    tail = stdtr(np.maximum(dof, 1e-9), -np.abs(t))
    with np.errstate(divide="ignore", invalid="ignore"):
        size = -ndtri(np.maximum(tail, np.finfo(float).tiny))
    return np.where(dof > 0.0, np.sign(t) * size, np.nan)


class Kind(StrEnum):
    """How a figure has changed: at once with a run, or over several."""

    JUMP = "jump"
    DRIFT = "drift"


@dataclass(frozen=True, slots=True, kw_only=True)
class Change:
    """A change that was called.

    noticed: the run at which a limit was passed. start: the first run that is no longer as those before it: the CUSUM's
    last stand at zero tells it (Page 1954). size: mean of the runs from start on less that of those before; latest: the
    last run less those before; each with its deviation, widened by the scatter between runs.
    """

    kind: Kind
    noticed: int
    start: int
    size: float
    size_std: float
    latest: float
    latest_std: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Judged:
    """The chart of one figure (n, 1), the change that was called, and runs that stand apart alone and were left out."""

    chart: Chart
    change: Change | None
    apart: tuple[int, ...]


def judged_together(x: Array, told: Array, limits: Limits) -> list[Judged]:
    """Return what runs (n, p) of figures that the same runs tell come to, each by itself as `judged` has it."""
    chart = charted(x, told)  # all at once: a step of one figure takes as long as that of many
    return [judged(x[:, k], told[:, k], limits, chart.column(k)) for k in range(x.shape[1])]


def judged(x: Array, told: Array, limits: Limits, chart: Chart | None = None) -> Judged:
    """Return what runs (n,) with the deviations that they tell (n,) come to.

    A run beyond the limit whose next is back again stands apart: a measurement gone wrong is no change of the cell.
    chart: of these runs, where it is known.
    """
    kept = x.copy()
    apart: list[int] = []
    while True:
        chart = chart or charted(kept[:, None], told[:, None])
        jumps, drifts = (each[:, 0] for each in chart.alarms(limits))
        passed = np.flatnonzero(jumps | drifts)
        if not len(passed):
            return Judged(chart=chart, change=None, apart=tuple(apart))
        noticed = int(passed[0])
        if jumps[noticed] and _came_back(chart.score[:, 0], noticed, limits):
            apart.append(noticed)
            kept[noticed], chart = np.nan, None
            continue
        change = _change(chart, kept, told, _Alarm(noticed, bool(jumps[noticed]), limits))
        return Judged(chart=chart, change=change, apart=tuple(apart))


def _came_back(score: Array, at: int, limits: Limits) -> bool:
    """Tell whether the run after one beyond the limit is on neither half of the way there; False of the last."""
    after = score[at + 1 :]
    after = after[np.isfinite(after)]
    return len(after) > 0 and after[0] * np.sign(score[at]) < 0.5 * limits.jump


@dataclass(frozen=True, slots=True)
class _Alarm:
    """Which run passed a limit, whether by itself, and the limits."""

    noticed: int
    alone: bool
    limits: Limits


def _change(chart: Chart, x: Array, told: Array, alarm: _Alarm) -> Change:
    noticed = alarm.noticed
    sums = (chart.up if chart.up[noticed, 0] >= chart.down[noticed, 0] else chart.down)[:, 0]
    start = int(np.flatnonzero(sums[:noticed] <= 0.0)[-1]) + 1
    # a run far off after some that happened to lie on its side: the change began with it, not with these
    jumped = alarm.alone and (start == noticed or sums[noticed - 1] < 0.5 * alarm.limits.drift)
    start = noticed if jumped else start
    s = told if np.isfinite(told).any() else np.ones(len(x))
    before, mean, weight = _mean(x[:start], s[:start])
    _, later, later_weight = _mean(x[start:], s[start:])
    factor = float(chart.factor[start, 0]) if before > 1 else TOLD_FACTOR
    last = int(np.flatnonzero(np.isfinite(x) & np.isfinite(s))[-1])
    return Change(
        kind=Kind.JUMP if jumped and not _moves_on(x[start:], factor * s[start:]) else Kind.DRIFT,
        noticed=noticed,
        start=start,
        size=later - mean,
        size_std=factor * float(np.sqrt(1.0 / weight + 1.0 / later_weight)),
        latest=float(x[last]) - mean,
        latest_std=factor * float(np.sqrt(1.0 / weight + s[last] ** 2)),
    )


@np.errstate(divide="ignore", invalid="ignore")  # runs that were alike to the last digit have no scatter
def _moves_on(x: Array, s: Array) -> bool:
    """Tell whether runs (n,) with deviations s go on in one direction, beyond three deviations of their slope."""
    known = np.isfinite(x) & np.isfinite(s)
    i, y, w = np.flatnonzero(known).astype(float), x[known], 1.0 / s[known] ** 2
    if len(i) < FEWEST_OF_A_SLOPE:
        return False
    i = i - i @ w / w.sum()
    return bool(abs((i * w) @ y) > 3.0 * np.sqrt((i * w) @ i))


def _mean(x: Array, s: Array) -> tuple[int, float, float]:
    """Return count, weighted mean and sum of weights of what is known."""
    known = np.isfinite(x) & np.isfinite(s)
    w = 1.0 / s[known] ** 2
    return int(known.sum()), float(x[known] @ w / w.sum()), float(w.sum())
