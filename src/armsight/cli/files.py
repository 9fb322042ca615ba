"""armsight compare, join, report and reproduce: what is made of results."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from armsight.app import requests
from armsight.cli.actions import add_action
from armsight.cli.command import app, command
from armsight.cli.command_ui import CommandUI
from armsight.cli.tables import figure
from armsight.errors import UsageError
from armsight.fields import Doc, Flag
from armsight.file_names import COMPARED
from armsight.ops.files import compare, join

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


add_action(app, join, streamed=True)


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


add_action(app, compare, keeps=COMPARED, judged=True)
