"""What a supervision saw: row by row, as figures, and in words."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from armsight.arrays import Array
from armsight.columns import POSE6
from armsight.fields import Doc
from armsight.records import PoseStatus, TargetPose
from armsight.records.output import Output, figure, output
from armsight.records.result_parts import MEANING, Verdict
from armsight.shown import RESULTS, Shown, digits
from armsight.units import DEG, MM, figure_of
from armsight.verify.records import Columns
from armsight.verify.supervision import Alarm, Compared, Level, Limits
from armsight.verify.verdicts import live_verdict

ERROR_COLUMNS = (*POSE6, "error_m", "error_rad", "std_m", "std_rad")


@output
class LiveAlarm(Output):
    """A level that was raised, or something that supervision lost."""

    t_s: Annotated[float, Doc("When, on the cameras' clock, s: the middle of the exposure that told it.")]
    level: Annotated[str, Doc("warn, stop, or blind: nothing could be compared for a while.")]
    why: Annotated[str, Doc("What was off and by how much, or what was lost.")]


@output
class LiveErrors(Output):
    """Errors of the poses compared."""

    rms_m: Annotated[float | None, Doc("Of the place, root mean square, m; null where nothing was compared.")]
    max_m: Annotated[float | None, Doc("Largest error of the place, m.")]
    rms_rad: Annotated[float | None, Doc("Of the rotation, root mean square, rad.")]
    max_rad: Annotated[float | None, Doc("Largest error of the rotation, rad.")]
    std_m: Annotated[
        float | None, Doc("What measurement and expectation may be off along the error, RMS of standard deviations, m.")
    ]
    std_rad: Annotated[float | None, Doc("The same of the rotation, rad.")]


@output
class DecisionTime(Output):
    """Time from a pair of frames in memory to the decision on it, ms."""

    median: Annotated[float, Doc("Median, ms.")]
    p99: Annotated[float, Doc("99 of 100 took less, ms.")]


@output
class VerifyLiveOutput(Output):
    """armsight verify --live."""

    n: Annotated[int, Doc("Moments seen; of two cameras pairs of frames.")]
    n_compared: Annotated[int, Doc("Moments that were compared.")]
    n_lost: Annotated[int, Doc("Moments in which the target was not seen whole.")]
    n_stale: Annotated[int, Doc("Moments for which the joints were not known.")]
    duration_s: Annotated[float, Doc("From the first moment to the last, s.")]
    rate_hz: Annotated[float | None, Doc("Moments a second; null for fewer than two.")]
    missed: Annotated[int, Doc("Frames of the left camera that never arrived, by their numbers.")]
    level: Annotated[str, Doc("The gravest level raised: good, warn or stop; unknown where nothing was compared.")]
    stopped: Annotated[bool, Doc("Whether the robot was told to stop.")]
    alarms: Annotated[list[LiveAlarm], Doc("What was raised, in the order of time.")]
    errors: Annotated[LiveErrors, Doc("Measured minus expected.")]
    levels: Annotated[Limits, Doc("The levels of alarm.")]
    blind_s: Annotated[float, Doc("Longest time in which nothing could be compared, s.")]
    decision_ms: Annotated[DecisionTime | None, Doc("How long a decision took; null without one.")]
    recording: Annotated[str | None, Doc("The recording; null where none was made.")]
    doubts: Annotated[list[str], Doc("What to know before believing it.")]
    verdict: Annotated[str, Doc("What it comes to, in words.")]
    log: LiveLog
    of_pair: bool = True

    @figure(MEANING, optional=True)
    def verdict_(self) -> Verdict:
        return live_verdict(self)

    @property
    def table(self) -> Columns:
        """The columns of errors.csv, row by row; lost rows have no numbers."""
        return self.log.columns()

    def summary(self) -> Iterator[Shown]:
        """Yield what a terminal shows of it."""
        for alarm in self.alarms:
            yield f"  {alarm.t_s:.3f} s: {alarm.why}"
        rate = "-" if self.rate_hz is None else f"{self.rate_hz:.1f} a second"
        ms = "" if self.decision_ms is None else f"; decided in {digits(self.decision_ms.median)} ms (median)"
        yield (
            f"{self.n} {'pairs' if self.of_pair else 'moments'}, {rate}: {self.n_compared} compared, {self.n_lost} "
            f"without the target, {self.n_stale} without joints, {self.missed} never came{ms}"
        )
        if self.errors.rms_m is not None and self.errors.std_m is not None:
            yield (
                f"Error of place {digits(self.errors.rms_m / MM)} mm RMS, of which noise explains "
                f"{digits(self.errors.std_m / MM)} mm; the decision's clock begins with a frame in memory"
            )
        yield from (f"  {text}" for text in self.doubts)
        yield self.verdict
        yield RESULTS


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LiveSeries:
    """Rows over time t_s (m,): error (m, 6) in m and rad, std (m, 2) along it; NaN where nothing was compared."""

    t_s: Array
    error: Array
    std: Array

    @property
    def place_m(self) -> Array:
        """Length of the error of place (m,)."""
        return np.asarray(np.linalg.norm(self.error[:, :3], axis=1))

    @property
    def turn_rad(self) -> Array:
        """Angle of the error of rotation (m,)."""
        return np.asarray(np.linalg.norm(self.error[:, 3:], axis=1))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LiveRow:
    """One pair: t_s on the cameras' clock, the level after it, the error (6,) in m and rad with standard deviations
    along it (2,), NaN where nothing was compared, why that was, and ms from frame to decision."""

    t_s: float
    level: Level
    error: Array
    std: Array
    lost: str
    seen: bool
    ms: float


@dataclass(slots=True, kw_only=True)
class LiveLog:
    """All rows, alarms, frames that never came."""

    limits: Limits
    rows: list[LiveRow] = field(default_factory=list)
    alarms: list[Alarm] = field(default_factory=list)
    missed: int = 0
    stopped: bool = False
    last_number: int = 0

    @property
    def duration_s(self) -> float:
        """From the first row to the last, in s."""
        return self.rows[-1].t_s - self.rows[0].t_s if self.rows else 0.0

    def add(self, number: int, pose: TargetPose, compared: Compared | None, level: Level, lost: str, ms: float) -> None:
        """Add the pair of this number."""
        if self.rows:
            self.missed += max(0, number - self.last_number - 1)
        self.last_number = number
        known = compared is not None
        self.rows.append(
            LiveRow(
                t_s=pose.t_s,
                level=level,
                error=compared.error if compared is not None else np.full(6, np.nan),
                std=np.array([compared.std_m, compared.std_rad]) if compared is not None else np.full(2, np.nan),
                lost=lost,
                seen=known or pose.status is PoseStatus.OK,
                ms=ms,
            )
        )

    def columns(self) -> Columns:
        """Return the rows as the columns of errors.csv; lost ones have no numbers."""
        series = self.series()
        numbers = np.column_stack([series.error, series.place_m, series.turn_rad, series.std])
        return {
            "t_s": series.t_s,
            "level": [row.level.word if not row.lost else "lost" for row in self.rows],
            **dict(zip(ERROR_COLUMNS, numbers.T, strict=True)),
            "decision_ms": np.array([row.ms for row in self.rows]),
            "lost": [row.lost for row in self.rows],
        }

    def series(self) -> LiveSeries:
        """Return the rows as columns."""
        return LiveSeries(
            t_s=np.array([row.t_s for row in self.rows]),
            error=np.array([row.error for row in self.rows]).reshape(-1, 6),
            std=np.array([row.std for row in self.rows]).reshape(-1, 2),
        )


def live_output(log: LiveLog, *, recording: str, doubts: Sequence[str], of_pair: bool = True) -> VerifyLiveOutput:
    """Return the figures of a supervision as --json gives them."""
    series = log.series()
    known = np.isfinite(series.place_m)
    grave = max((alarm.level for alarm in log.alarms), default=Level.GOOD)
    n, span_s = len(log.rows), log.duration_s
    ms = np.array([row.ms for row in log.rows])
    limits = log.limits
    return VerifyLiveOutput(
        n=n,
        n_compared=int(known.sum()),
        n_lost=sum(not row.seen for row in log.rows),
        n_stale=sum(row.seen and bool(row.lost) for row in log.rows),
        duration_s=span_s,
        rate_hz=(n - 1) / span_s if span_s > 0.0 else None,
        missed=log.missed,
        level="unknown" if grave is Level.GOOD and not known.any() else grave.word,
        stopped=log.stopped,
        alarms=[
            LiveAlarm(t_s=alarm.t_s, level="blind" if alarm.level is Level.GOOD else alarm.level.word, why=alarm.why)
            for alarm in log.alarms
        ],
        errors=_errors(series, known),
        levels=limits,
        blind_s=_blind_s(series.t_s, known),
        decision_ms=DecisionTime(median=float(np.median(ms)), p99=float(np.quantile(ms, 0.99))) if n else None,
        recording=recording,
        doubts=list(doubts),
        verdict=_verdict(log, series, known, grave),
        log=log,
        of_pair=of_pair,
    )


def _errors(series: LiveSeries, known: NDArray[np.bool_]) -> LiveErrors:
    if not known.any():
        return LiveErrors(rms_m=None, max_m=None, rms_rad=None, max_rad=None, std_m=None, std_rad=None)
    distance, turn = series.place_m[known], series.turn_rad[known]
    std = np.sqrt(np.mean(series.std[known] ** 2, axis=0))
    return LiveErrors(
        rms_m=float(np.sqrt(np.mean(distance**2))),
        max_m=float(distance.max()),
        rms_rad=float(np.sqrt(np.mean(turn**2))),
        max_rad=float(turn.max()),
        std_m=float(std[0]),
        std_rad=float(std[1]),
    )


def _blind_s(t_s: Array, known: NDArray[np.bool_]) -> float:
    """Return the longest time without a comparison; the whole run where there was none."""
    if not len(t_s):
        return 0.0
    marks = np.concatenate([t_s[:1], t_s[known], t_s[-1:]])
    return float(np.diff(marks).max())


def _verdict(log: LiveLog, series: LiveSeries, known: NDArray[np.bool_], grave: Level) -> str:
    if not known.any():
        return "Nothing could be compared: whether the arm is where it says it is, is not known."
    lost = len(log.rows) - int(known.sum())
    distance_mm, turn_deg = series.place_m[known].max() / MM, series.turn_rad[known].max() / DEG
    largest = f"{figure_of(distance_mm, 'mm')} and {figure_of(turn_deg, 'deg')}"
    dark = f" {lost} of {len(log.rows)} pairs could not be compared." if lost else ""
    if grave is Level.GOOD:
        passed = "No level was set" if not log.limits.all else "No level was passed"
        return f"{passed}; the tool was at most {largest} from where it should be, noise included.{dark}"
    first = next(alarm for alarm in log.alarms if alarm.level is grave)
    return f"At {first.t_s:.3f} s {first.why}.{' The robot was stopped.' if log.stopped else ''}{dark}"
