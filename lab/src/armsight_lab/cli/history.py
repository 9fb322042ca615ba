"""armsight history."""

from __future__ import annotations

from typing import TYPE_CHECKING

from armsight.cli.command import declared
from armsight.cli.command_ui import CommandUI
from armsight.cli.tables import figure
from armsight.units import DISPLAY, displayed
from armsight_lab.history.request import AddJob, CompareRunsJob, ExportRunsJob, ListJob, ShowJob, TrendJob

if TYPE_CHECKING:
    from armsight_lab.history.entry import Quantity
    from armsight_lab.history.looking import RunDifference
    from armsight_lab.history.trend import TrendFigure

MOST_FIGURES = 200
"""Numbers of a run that are printed; --json gives all."""
REPORTS = ("trend.json", "report.html")


def _name(one: Quantity | RunDifference | TrendFigure) -> str:
    """Return a number's name without its unit, which stands beside it as people read it."""
    return one.name.removesuffix("_rad").removesuffix("_m") if one.unit in DISPLAY else one.name


def _unit(one: Quantity | RunDifference | TrendFigure) -> str:
    return displayed(one.unit)[0]


def _shown(unit: str, *values: float | None, digits: int = 3) -> list[str]:
    """Return numbers in the unit that people read."""
    size = displayed(unit)[1]
    return [figure(None if value is None else value / size, digits) for value in values]


@declared()
def add(face: CommandUI, job: AddJob) -> None:
    """File the result of an earlier run, or of one that could not be filed."""
    from armsight_lab.history.adding import add as run

    done = run(job)
    said = "Filed as" if done.new else "It is"
    face.say(
        f"{said} run {done.run} of cell {done.cell!r}: {done.command}, {done.created[:16]} UTC, "
        f"{done.n_figures} numbers, {done.n_parameters} parameters"
    )
    for note in done.notes:
        face.say(f"- {note}")
    face.result(done)


@declared()
def list_(face: CommandUI, job: ListJob) -> None:
    """List runs, the newest first."""
    from armsight_lab.history.looking import list_runs

    done = list_runs(job)
    rows = [
        [str(one.id), one.created[:16].replace("T", " "), one.cell, one.command, "" if one.trusted else "NOT TRUSTED"]
        for one in done.runs
    ]
    if rows:
        face.table(f"Runs in {done.history} (UTC)", ["run", "created", "cell", "command", ""], rows)
    listed = f"{len(done.runs)} of {done.n} runs" if done.n > len(done.runs) else f"{done.n} runs"
    face.say(f"{listed}." + (" --most lists more." if done.n > len(done.runs) else ""))
    face.result(done)


@declared()
def show(face: CommandUI, job: ShowJob) -> None:
    """Show a run: what it was given, what it found, every number with its deviation."""
    from armsight_lab.history.looking import show_run

    done = show_run(job)
    run = done.run
    face.say(f"Run {run.id} of cell {run.cell!r}: {run.command}, {run.created[:19]} UTC, {run.software}")
    if run.arm or run.joints:
        face.say(f"Arm: {run.arm or 'of no name'}, joints {run.joints}")
    if run.verdict:
        face.say(run.verdict)
    if not run.trusted:
        face.say(f"NOT TO BE TRUSTED (exit code {run.exit_code}): {run.reason}")
    if done.inputs:
        given = [[one.flag, one.path, (one.sha256 or "")[:16]] for one in done.inputs]
        face.table("Given", ["flag", "path", "hash begins"], given)
    for title, numbers in (("Calibrated", done.parameters), ("Numbers", done.figures[:MOST_FIGURES])):
        rows = [[_name(one), *_shown(one.unit, one.value, digits=7), *_shown(one.unit, one.std)] for one in numbers]
        rows = [[*row, _unit(one)] for row, one in zip(rows, numbers, strict=True)]
        if rows:
            face.table(title, ["", "value", "+-", "unit"], rows)
    face.result(done)


@declared()
def compare(face: CommandUI, job: CompareRunsJob) -> None:
    """Hold two runs side by side: every number, its difference and deviation, and whether it exceeds that."""
    from armsight_lab.history.looking import compare_runs

    done = compare_runs(job)
    rows = [
        [
            _name(one),
            *_shown(one.unit, one.difference, one.std),
            _unit(one),
            "BEYOND" if one.exceeds else "",
        ]
        for one in done.parameters
    ]
    if rows:
        face.table("Calibrated, B less A", ["", "by", "+-", "unit", "3 sigma"], rows)
    rows = [[_name(one), *_shown(one.unit, one.a, one.b, one.difference), _unit(one)] for one in done.figures]
    if rows:
        face.table("Numbers", ["", "A", "B", "B less A", "unit"], rows[:MOST_FIGURES])
    for note in done.notes:
        face.say(f"- {note}")
    beyond = sum(bool(one.exceeds) for one in done.parameters)
    known = sum(one.exceeds is not None for one in done.parameters)
    face.say(f"{beyond} of {known} calibrated numbers with deviations differ by more than three of them.")
    face.result(done)


@declared()
def export(face: CommandUI, job: ExportRunsJob) -> None:
    """Write every number of every run as a table: CSV, Parquet, or JSON line by line."""
    from armsight_lab.history.looking import export_runs

    done = export_runs(job)
    face.say(f"{done.n_rows} numbers of {done.n_runs} runs: {done.file}")
    for note in done.notes:
        face.say(f"- {note}")
    face.result(done)


@declared(keeps=REPORTS, own="trend.json", judged=True)
def trend(face: CommandUI, job: TrendJob) -> None:
    """Say whether a joint zero, hand-eye, baseline or tool tip has drifted: what, since when, by how much.

    Writes trend.json and report.html.
    """
    from armsight_lab.history.trend import trend as run

    done = run(job)
    for command_ in dict.fromkeys(one.command for one in done.figures):
        rows = []
        for one in done.figures:
            if one.command == command_:
                since = "" if one.since_run is None else f"run {one.since_run}"
                sizes = _shown(one.unit, one.run_std, one.latest, one.latest_std)
                state = one.state.upper() if since else one.state
                rows.append([_name(one), state, str(one.n), *sizes, _unit(one), since])
        head = ["", "state", "runs", "a run +-", "change", "+-", "unit", "since"]
        face.table(f"Cell {done.cell}, {command_}", head, rows)
    for note in done.notes:
        face.say(f"- {note}")
    face.say(done.verdict)
    for text in dict.fromkeys(one.to_do for one in done.figures if one.to_do):
        face.say(f"To do: {text}.")
    face.say(f"One false alarm in {done.false_alarms_apart_years:g} cell-years is accepted. Open {done.report}")
    face.result(done)
