"""What a supervision saw: row by row, as figures, and as the report draws it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from armsight.arrays import Array
from armsight.columns import POSE6
from armsight.records import PoseStatus, TargetPose
from armsight.report.live_report import LiveSeries
from armsight.store.tables import cells, number, word
from armsight.units import DEG, MM, figure_of
from armsight.verify.results import DecisionTime, LiveAlarm, LiveErrors, VerifyLiveOutput
from armsight.verify.supervision import Alarm, Compared, Level, Limits

ERROR_COLUMNS = (*POSE6, "error_m", "error_rad", "std_m", "std_rad")
HEADER = ("t_s", "level", *ERROR_COLUMNS, "decision_ms", "lost")


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

    def raised(self, alarm: Alarm) -> None:
        """Add an alarm."""
        self.alarms.append(alarm)

    def csv(self) -> str:
        """Return errors.csv; lost rows have no numbers."""
        lines = [",".join(HEADER)]
        for row in self.rows:
            sizes = np.linalg.norm(row.error.reshape(2, 3), axis=1)
            figures = cells([*row.error, *sizes, *row.std, row.ms])
            lines.append(f"{number(row.t_s)},{row.level.word if not row.lost else 'lost'},{figures},{word(row.lost)}")
        return "\n".join(lines) + "\n"

    def series(self) -> LiveSeries:
        """Return the rows as columns."""
        return LiveSeries(
            t_s=np.array([row.t_s for row in self.rows]),
            error=np.array([row.error for row in self.rows]).reshape(-1, 6),
            std=np.array([row.std for row in self.rows]).reshape(-1, 2),
        )


def live_output(log: LiveLog, *, recording: str, doubts: Sequence[str]) -> VerifyLiveOutput:
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
