"""armsight compare, join, report and reproduce: what is made of results."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from armsight.app import requests
from armsight.cli.command import app, command
from armsight.cli.command_ui import CommandUI
from armsight.cli.tables import figure
from armsight.errors import UsageError
from armsight.fields import Doc, Flag
from armsight.file_names import COMPARED
from armsight.shown import REJECTED_SHOWN
from armsight.units import MS, displayed

if TYPE_CHECKING:
    from armsight.app.simulate.reproduced import ReproducedTable, ReproduceOutput


@command(app, keeps=("reproduce.json", "report.html"))
def reproduce(face: CommandUI, job: requests.simulate.ReproduceJob) -> None:
    """Run a paper's experiment on emulated hardware; put print, the paper's method and armsight side by side."""
    from armsight.drivers import PAPERS, load

    run = load(PAPERS, "reproduce")
    done = run(job.paper, job.out, seed=job.seed, frames=job.frames, progress=face.progress(f"reproducing {job.paper}"))
    _reproduced(done, face)
    face.say(f"Result: open {job.out / 'report.html'}")
    face.result(done)


def _reproduced(done: ReproduceOutput, face: CommandUI) -> None:
    head = ["m, rad or px", "paper", "its method", "armsight", "truth", "share of print", "of method"]
    for item in done.tables.values():
        face.table(item.title, head, [_row(item, name) for name in item.rows])
    for note in done.missing:
        face.say(f"- not reproduced: {note}")
    if done.n_compared:
        face.say(
            f"armsight's error is at most a third of the paper's in {done.n_reached} of {done.n_compared} rows that "
            "can be compared" + (f"; not in {', '.join(done.missed)}" if done.missed else "")
        )


def _row(item: ReproducedTable, name: str) -> list[str]:
    values = (item.paper[name], item.paper_method[name], item.armsight[name], item.truth[name])
    share = "-" if item.share[name] is None else figure(item.share[name], 2)
    shown = share if item.credible[name] or share == "-" else f"({share})"
    return [name, *(figure(value, 4) for value in values), shown, figure(item.share_of_method[name], 2)]


@command(app, streamed=True)
def join(face: CommandUI, job: requests.files.JoinJob) -> None:
    """Join a joint log and measurements on different clocks into points.csv, observed.csv or pairs.csv."""
    from armsight.app.join import join as run

    done = run(job)
    if done.offset_s is not None:
        std = "as stated" if done.offset_std_s is None else f"+- {figure(done.offset_std_s / MS, 2)} ms"
        face.say(f"Measured times {done.offset_s:+.6f} s are the robot's ({std})")
    for text in done.notes:
        face.say(f"- {text}")
    for item in done.rejected[:REJECTED_SHOWN]:
        face.say(f"  left out: row {item.row}: {item.why}")
    face.say(f"{done.n} rows of {done.kind} from {done.n_measured} measured, by {done.by}: {done.file}")
    face.result(done)


@command(app, json=False)
def report(
    face: CommandUI,
    report: Annotated[
        Path, Doc("A report.html, or the folder that it is in."), Flag(positional=True, metavar="REPORT")
    ],
    pdf: Annotated[bool, Doc("Print it as PDF, by a Chromium, Chrome or Edge.")] = False,
    out: Annotated[Path | None, Doc("The PDF. [default: beside the report]"), Flag("-o --out", metavar="FILE")] = None,
) -> None:
    """Print a report as PDF; any browser opens the report itself."""
    from armsight.app.print_report import print_report

    if not pdf:
        raise UsageError("it is not said what becomes of the report", cure="Give --pdf")
    face.say(f"Printed: {print_report(report, out)}")


@command(app, keeps=COMPARED, judged=True)
def compare(face: CommandUI, job: requests.files.CompareJob) -> None:
    """Tell whether two results of one kind agree within their uncertainty, and what the difference comes to."""
    from armsight.app.compare.run import compare as run

    done = run(job)
    rows = []
    for one in done.parameters:
        unit, factor = displayed(one.unit)
        std = None if one.std is None else one.std / factor
        sigmas = "-" if one.sigmas is None else f"{one.sigmas:+.1f}"
        name = one.name.replace("_rad", "").replace("_m_s", "").replace("_m", "")
        rows.append([name, figure(one.a / factor, 6), figure(one.difference / factor), figure(std, 2), sigmas, unit])
    face.say(done.verdict)
    face.table(f"B less A, {done.kind}", ["", "A", "B less A", "+-", "sigma", "unit"], rows)
    for effect in done.effects:
        unit, factor = displayed(effect.unit)
        face.say(f"  {effect.name}: {figure(effect.value / factor)} {unit}".rstrip())
    for text in done.notes:
        face.say(f"Note: {text}")
    if done.report is not None:
        face.say(f"Results: {job.out}; open {done.report}")
    face.result(done)
