"""Whether a figure of a cell has drifted: what, since when, by how much, at a stated rate of false alarms."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np

from armsight.errors import Inconsistent, NotEnoughData
from armsight.fields import Doc
from armsight.records.output import Output, figure, output
from armsight.records.result_parts import MEANING, Verdict
from armsight.store.atomic import write_json, write_text
from armsight.units import displayed, displayed_name
from armsight_lab.history.database import reading
from armsight_lab.history.drift import SMALLEST_STEP, Change, Judged, Kind, Limits, judged_together, limits_for
from armsight_lab.history.entry import day_of, optional_moment
from armsight_lab.history.looking import known_cell, known_command
from armsight_lab.history.place import place_of
from armsight_lab.history.queries import Filter
from armsight_lab.history.report import trend_report
from armsight_lab.history.request import TrendJob
from armsight_lab.history.series import (
    YEAR_DAYS,
    Course,
    Found,
    changed_inputs,
    clock_notes,
    courses,
    found_in,
    never_measured,
    require_one_arm,
)

SUMMARY, REPORT = "trend.json", "report.html"
FEW = 5
"""Runs below which nothing is called steady: so few tell neither mean nor scatter."""
FEW_UNTOLD = 8
"""The same of figures whose deviation nobody tells: the first run that their scatter alone can judge."""
SHORT = 8
"""Runs before a change below which chance, where runs tell far too small deviations, looks like one."""
OFTEN = 24.0 * YEAR_DAYS
"""Runs a year at the most: many results of one afternoon are no reason for limits as wide as a year of such days'."""
MOST_SAID = 3
"""Changes that the verdict tells, the surest first."""
KEEP_ON = "File each calibration with --cell, and look again after the next one."
ASK_MORE = "File further runs of the cell with --cell; nothing is known of drifts before that."
TO_DO = {
    "joint-zeros": "Check that joint's mastering (armsight verify --mastering); master it, or take the calibrated arm",
    "hand-eye": "Check that camera and holder sit tight, calibrate hand-eye again, and use the new handeye.yaml",
    "rig": "Check that cameras, mirrors and their beam sit tight, calibrate the rig again, and use the new rig.yaml",
    "tool-tip": "Look for a bent, worn or exchanged tool, find its tip again, and use the new tip.yaml",
    "world": "Check that neither rig nor base has moved, run calibrate robot-world again, and use the new world.yaml",
}
OTHERWISE = "Look for what was changed in the cell at that time"


@output
class TrendFigure(Output):
    """A figure over the runs."""

    name: Annotated[str, Doc("Its name; of a pose one of its numbers against that of the first run.")]
    command: Annotated[str, Doc("The command whose runs tell it.")]
    unit: Annotated[str, Doc("m, rad, px ...; empty of a plain number.")]
    state: Annotated[str, Doc("steady, drift, jump, or few: too few runs to call it steady.")]
    n: Annotated[int, Doc("Runs that tell it.")]
    runs_a_year: Annotated[float, Doc("How often there was such a run.")]
    first_run: Annotated[int, Doc("The first of them, by its number.")]
    last_run: Annotated[int, Doc("The last of them.")]
    mean: Annotated[float, Doc("Weighted mean of the runs before the change, or of all.", unit="as unit says")]
    run_std: Annotated[
        float | None,
        Doc("Deviation of one more run from that mean to expect; null of a single run.", unit="as unit says"),
    ]
    scatter_factor: Annotated[
        float | None, Doc("Scatter between runs over the deviations that they tell; null where they tell none.")
    ]
    correlation: Annotated[float, Doc("Of each run's error with that of the one before, 0 where none is seen.")]
    smallest_step: Annotated[
        float | None, Doc("The smallest lasting change that the CUSUM is made for.", unit="as unit says")
    ]
    jump_limit: Annotated[float, Doc("Of a single run, in its deviations (Shewhart).")]
    drift_limit: Annotated[float, Doc("Of the sum of deviations (CUSUM).")]
    since: Annotated[
        str | None, Doc("When the change began, UTC: the date of since_run; left out where nothing changed.")
    ] = None
    since_run: Annotated[int | None, Doc("The first run that is no longer as those before it.")] = None
    noticed_run: Annotated[int | None, Doc("The run at which it was beyond the limit.")] = None
    change: Annotated[float | None, Doc("Mean since then less that before.", unit="as unit says")] = None
    change_std: Annotated[float | None, Doc("Standard deviation of that.", unit="as unit says")] = None
    latest: Annotated[float | None, Doc("The last run less the mean before.", unit="as unit says")] = None
    latest_std: Annotated[float | None, Doc("Standard deviation of that.", unit="as unit says")] = None
    apart: Annotated[list[int], Doc("Runs that stand apart alone and were left out.")]
    silent: Annotated[int, Doc("Runs of the command that hold it as given, not as measured, or hold no number.")]
    to_do: Annotated[str, Doc("What to do where it has changed; else empty.")]


@output
class TrendOutput(Output):
    """armsight history trend."""

    cell: Annotated[str, Doc("The cell.")]
    changed: Annotated[bool, Doc("Whether any figure has drifted or jumped.")]
    verdict: Annotated[str, Doc("What it comes to, in words.")]
    figures: Annotated[list[TrendFigure], Doc("The figures, those that have changed first.")]
    n_runs: Annotated[int, Doc("Runs looked at.")]
    n_doubted: Annotated[int, Doc("Of these left out: runs that say of themselves that they cannot be trusted.")]
    false_alarms_apart_years: Annotated[float, Doc("Years of a cell in which one false alarm is to be expected.")]
    notes: Annotated[list[str], Doc("What to know.")]
    report: Annotated[str, Doc("The report.")]

    @figure(MEANING, optional=True)
    def verdict_(self) -> Verdict:
        few = all(one.state == "few" for one in self.figures)
        todo = next((one.to_do for one in self.figures if one.to_do), ASK_MORE if few else KEEP_ON)
        level, headline = ("bad", "Drift") if self.changed else ("care", "Too few runs") if few else ("good", "Steady")
        return Verdict(level=level, headline=headline, reasons=[self.verdict], next=[todo])


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Judgement:
    """A figure over the runs, and what its chart says of it within the limits."""

    course: Course
    limits: Limits
    found: Judged
    runs_a_year: float


def trend(job: TrendJob) -> TrendOutput:
    """Judge a cell's figures; write trend.json and report.html into job.out; return what --json gives.

    Raises UsageError for a cell, command or figure that is none, NotEnoughData, Inconsistent for two arms, BadFile,
    DeviceFailed.
    """
    since, until = optional_moment(job.since), optional_moment(job.until)
    with reading(place_of(job.history)) as connection:
        cell = known_cell(connection, job.cell)
        command = None if job.command is None else known_command(connection, job.command, cell)
        wanted = Filter(cell=cell, command=command, since=since, until=until)
        found = found_in(connection, wanted, figures=bool(job.figure))
    _require_runs(found, cell)
    chosen = courses(found, job.figure)
    require_one_arm(found, chosen)
    if not chosen:
        raise NotEnoughData(
            f"no run of cell {cell!r} that can be trusted tells a joint zero, hand-eye, baseline, tool tip or world",
            consequence="Nothing is judged",
            cure="Name other figures with --figure (all, or as armsight history show prints them)",
        )
    judgements = _judgements(chosen, job.false_alarms)
    judgements.sort(key=lambda one: one.found.change is None)
    figures = [_figure(one) for one in judgements]
    doubted = sum(not run.trusted for run in found.runs)
    report = job.out / REPORT
    done = TrendOutput(
        cell=cell,
        changed=any(one.found.change is not None for one in judgements),
        verdict=_verdict(judgements, figures, len(found.runs)),
        figures=figures,
        n_runs=len(found.runs),
        n_doubted=doubted,
        false_alarms_apart_years=job.false_alarms,
        notes=[*_notes(figures, doubted), *_short(judgements), *_of_runs(found)],
        report=str(report),
    )
    job.out.mkdir(parents=True, exist_ok=True)
    write_json(job.out / SUMMARY, done.to_dict())
    write_text(report, trend_report(done, judgements))
    return done


def _require_runs(found: Found, cell: str) -> None:
    if not found.runs:
        raise NotEnoughData(
            f"cell {cell!r} has no such run in that time",
            consequence="Nothing is judged",
            cure="Ask for more with --since and --until; armsight history list shows its runs",
        )


def _judgements(chosen: Sequence[Course], apart_years: float) -> list[Judgement]:
    """Return what the courses come to; those of the same runs are charted together."""
    together: dict[tuple[int, ...], list[Course]] = {}
    for course in chosen:
        together.setdefault(course.runs, []).append(course)
    out = []
    for courses_ in together.values():
        rate = runs_a_year(courses_[0])
        limits = limits_for(apart_years, rate, len(chosen))
        x, told = (np.stack([getattr(one, key) for one in courses_], axis=1) for key in ("values", "std"))
        found = judged_together(x, told, limits)
        _require_charted(courses_, found)
        out += [
            Judgement(course=course, limits=limits, found=one, runs_a_year=rate)
            for course, one in zip(courses_, found, strict=True)
        ]
    return out


def _require_charted(courses_: Sequence[Course], found: Sequence[Judged]) -> None:
    """Raise Inconsistent for a figure that no chart was made of, as it could change and none would tell."""
    for course, one in zip(courses_, found, strict=True):
        if len(course.runs) >= _wanted(course) and not np.isfinite(one.chart.std[-1, 0]):
            raise Inconsistent(
                f"{course.name}: its numbers and deviations ({course.values[-1]:.3g} +- {course.std[-1]:.3g}) are so "
                "far from each other, or so large, that they cannot be reckoned with",
                consequence="Nothing is judged",
                cure="Look at them with armsight history show; name the other figures with --figure",
            )


def _wanted(course: Course) -> int:
    """Return below how many runs a figure is not called steady."""
    return FEW if np.isfinite(course.std).any() else FEW_UNTOLD


def runs_a_year(course: Course) -> float:
    """Return how often there is a run; one a year where a single one tells nothing of it."""
    if len(course.runs) < 2:
        return 1.0
    years = (day_of(course.created[-1]) - day_of(course.created[0])) / YEAR_DAYS
    return float(np.clip((len(course.runs) - 1) / max(years, 1e-9), 1.0, OFTEN))


def _figure(one: Judgement) -> TrendFigure:
    course, chart, change = one.course, one.found.chart, one.found.change
    at = len(course.runs) - 1 if change is None else change.start  # the last run that the reference speaks of
    std = _known(chart.std[at, 0])
    told = bool(np.isfinite(course.std).any())
    mean = _known(chart.mean[at, 0])
    state = str(change.kind) if change else "few" if len(course.runs) < _wanted(course) else "steady"
    held = TrendFigure(
        name=course.name,
        command=course.command,
        unit=course.unit,
        state=state,
        n=len(course.runs),
        runs_a_year=one.runs_a_year,
        first_run=course.runs[0],
        last_run=course.runs[-1],
        mean=float(course.values[0]) if mean is None else mean,
        run_std=std,
        scatter_factor=_known(chart.factor[at, 0]) if told else None,
        correlation=float(chart.correlation[at, 0]),
        smallest_step=None if std is None else SMALLEST_STEP * std,
        jump_limit=one.limits.jump,
        drift_limit=one.limits.drift,
        apart=[course.runs[i] for i in one.found.apart],
        silent=course.silent,
        to_do=TO_DO.get(course.group, OTHERWISE) if change else "",
    )
    return held if change is None else _changed(held, course, change)


def _changed(held: TrendFigure, course: Course, change: Change) -> TrendFigure:
    return replace(
        held,
        since=course.created[change.start],
        since_run=course.runs[change.start],
        noticed_run=course.runs[change.noticed],
        change=change.size,
        change_std=change.size_std,
        latest=change.latest,
        latest_std=change.latest_std,
    )


def _known(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def _verdict(judgements: Sequence[Judgement], figures: Sequence[TrendFigure], runs: int) -> str:
    changed = [one for one in figures if one.since_run is not None]
    if not changed:
        steady = sum(one.state == "steady" for one in figures)
        if not steady:
            least = min((one.course for one in judgements), key=lambda one: len(one.runs) - _wanted(one))
            n, wanted = len(least.runs), _wanted(least)
            return f"Too few runs to say ({n}, {wanted} are wanted): so far nothing has changed beyond chance."
        return f"Nothing has drifted: {steady} of {len(figures)} figures are steady over {runs} runs."
    changed.sort(key=lambda one: -abs(one.latest or 0.0) / (one.latest_std or 1.0))
    more = f" {len(changed)} of {len(figures)} figures have changed." if len(changed) > MOST_SAID else ""
    return " ".join(map(said, changed[:MOST_SAID])) + more


def said(one: TrendFigure) -> str:
    """Return what has changed, since when and by how much, in words."""
    unit, factor = displayed(one.unit)
    size, std = (one.latest or 0.0) / factor, (one.latest_std or 0.0) / factor
    verb = "has jumped" if one.state == Kind.JUMP else "has drifted"
    when = (one.since or "")[:10]
    last = " The last run alone says so: repeat it." if one.since_run == one.last_run else ""
    by = f"{size:+.3g} +- {std:.2g} {unit}"
    return f"{displayed_name(one.name)[0]} ({one.command}) {verb} by {by} since run {one.since_run} ({when}).{last}"


def _notes(figures: Sequence[TrendFigure], doubted: int) -> list[str]:
    notes = []
    changed = [one for one in figures if one.since_run is not None]
    if len({one.since_run for one in changed}) < len(changed):
        notes.append(
            "Several figures changed with the same run: look for one cause of all (another nominal arm, rig or target, "
            "a collision) before you correct each."
        )
    wide = [one for one in figures if one.scatter_factor is not None and one.scatter_factor > 2.0 and one.n >= FEW]
    if wide:
        worst = max(wide, key=lambda one: one.scatter_factor or 0.0)
        notes.append(
            f"{worst.name}: runs scatter {worst.scatter_factor:.1f} times as much as they tell. Something changes from "
            "run to run that a run does not see, such as warmth or how the target is clamped."
        )
    notes += [
        f"{one.name}: run {', '.join(map(str, one.apart))} stood apart alone and was left out."
        for one in figures
        if one.apart
    ]
    silent = [one for one in figures if one.silent]
    if silent:
        most = max(silent, key=lambda one: one.silent)
        notes.append(
            f"{most.name}: {most.silent} runs hold it as it was given, as they could not tell it; give each run the "
            "same nominal arm and enough poses."
        )
    if doubted:
        notes.append(f"{doubted} runs say of themselves that they cannot be trusted, and are left out.")
    return notes


def _short(judgements: Sequence[Judgement]) -> list[str]:
    """Return that a change was called by few runs, whose scatter is not known yet."""
    before = [(one.found.change.start, one.course.name) for one in judgements if one.found.change]
    n, name = min(before, default=(SHORT, ""))
    if n >= SHORT:
        return []
    return [
        f"{name}: only {n} {'run' if n == 1 else 'runs'} came before the change. Where runs scatter more than three "
        "times as much as they tell, chance looks like this: repeat the run before you correct anything."
    ]


def _of_runs(found: Found) -> list[str]:
    names = never_measured(found)
    silent = f"No run measures {', '.join(names)}: a drift there does not show here, or shows as one of another figure."
    return [*([silent] if names else []), *changed_inputs(found), *clock_notes(found)]
