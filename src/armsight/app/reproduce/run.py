"""One paper's experiment from frames to tables and report."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Annotated

from armsight.app.reproduce.kapucu2005 import reproduce_kapucu
from armsight.app.reproduce.korayem2018 import reproduce_korayem
from armsight.app.reproduce.pachidis2005 import reproduce_pachidis
from armsight.app.reproduce.stage import Stage
from armsight.errors import UsageError
from armsight.fields import Doc
from armsight.records import Progress, Silent
from armsight.records.output import Output, output
from armsight.report.reproduce import ComparedRow, ComparisonTable, Reproduction, reproduce_report
from armsight.store import write_text
from armsight.store.atomic import write_json

PAPERS: Mapping[str, Callable[[Stage], Reproduction]] = MappingProxyType(
    {
        "korayem2018": reproduce_korayem,
        "pachidis2005": reproduce_pachidis,
        "kapucu2005": reproduce_kapucu,
    }
)


Values = dict[str, float | None]


@output
class ReproducedErrors(Output):
    """Sizes of errors by row; null where there is no truth to hold a figure against."""

    paper: Annotated[Values, Doc("Of the printed figures, against what the paper holds to be true.")]
    paper_method: Annotated[Values, Doc("Of the paper's method on the simulated frames, against the truth.")]
    armsight: Annotated[Values, Doc("Of armsight on the same frames, against the truth.")]


@output
class ReproducedTable(Output):
    """A table of the paper, or the figures that stand for a plot of it."""

    title: Annotated[str, Doc("What it is.")]
    rows: Annotated[list[str], Doc("The rows' names in order; the unit is their ending (_m, _rad, _px).")]
    paper: Annotated[Values, Doc("As printed; null where the paper gives none.")]
    paper_method: Annotated[Values, Doc("By the paper's method, from the simulated frames.")]
    armsight: Annotated[Values, Doc("By armsight, from the same frames.")]
    truth: Annotated[Values, Doc("The truth of the simulation; 0 for figures that are errors themselves.")]
    paper_truth: Annotated[Values, Doc("What the paper holds to be true; null where it gives none.")]
    errors: Annotated[ReproducedErrors, Doc("Sizes of the errors.")]
    credible: Annotated[dict[str, bool], Doc("Whether the printed figure can be believed as what it is called.")]
    share: Annotated[Values, Doc("armsight's error over the paper's printed one.")]
    share_of_method: Annotated[Values, Doc("armsight's error over that of the paper's method on the same frames.")]
    notes: Annotated[dict[str, str], Doc("What to know about a row, where there is something.")]


@output
class ReproduceOutput(Output):
    """armsight reproduce."""

    paper: Annotated[str, Doc("Which paper.")]
    seed: Annotated[int, Doc("Seed of the simulated frames' noise.")]
    scenarios: Annotated[list[str], Doc("The emulated hardware.")]
    tables: Annotated[dict[str, ReproducedTable], Doc("Tables by name.")]
    figures: Annotated[list[str], Doc("The paper's figures that the report draws anew.")]
    n_compared: Annotated[int, Doc("Rows whose printed figure is credible and has an error.")]
    n_reached: Annotated[int, Doc("Those of them in which armsight's error is at most a third of the paper's.")]
    missed: Annotated[list[str], Doc("The others, as table.row.")]
    assumptions: Annotated[list[str], Doc("What the paper does not say, and what was chosen.")]
    doubts: Annotated[list[str], Doc("Known doubts about the printed figures.")]
    missing: Annotated[list[str], Doc("Parts of the paper that are not reproduced, and why.")]
    seconds_s: Annotated[float, Doc("How long it took, s.")]


def reproduce(
    paper: str, out: Path, *, seed: int = 1, frames: int | None = None, progress: Progress | None = None
) -> ReproduceOutput:
    """Reproduce a paper's experiment into the folder out; return the tables.

    Writes the simulated frames and all results, reproduce.json and report.html. seed: of the frames' noise. frames:
    fewer than the paper took, to try it out. Raises UsageError for an unknown paper or too few frames, what measuring
    and identifying raise, and Cancelled.
    """
    start_s = time.perf_counter()
    if paper not in PAPERS:
        raise UsageError(
            f"there is no paper {paper!r}", consequence="Nothing is reproduced", cure=f"Give one of {', '.join(PAPERS)}"
        )
    stage = Stage(out=out, seed=seed, frames=frames, progress=progress or Silent())
    done = PAPERS[paper](stage)
    write_text(out / "report.html", reproduce_report(done))
    result = _output(done, stage.scenarios, time.perf_counter() - start_s)
    write_json(out / "reproduce.json", result.to_dict())
    return result


def _output(done: Reproduction, scenarios: list[str], seconds_s: float) -> ReproduceOutput:
    compared = done.compared
    return ReproduceOutput(
        paper=done.paper,
        seed=done.seed,
        scenarios=scenarios,
        tables={item.name: _table(item) for item in done.tables},
        figures=[figure.name for figure in done.figures],
        n_compared=len(compared),
        n_reached=sum(row.reached for row in compared),
        missed=[
            f"{item.name}.{row.name}" for item in done.tables for row in item.rows if row.compared and not row.reached
        ],
        assumptions=list(done.assumptions),
        doubts=list(done.doubts),
        missing=list(done.missing),
        seconds_s=seconds_s,
    )


def _table(item: ComparisonTable) -> ReproducedTable:
    def each(get: Callable[[ComparedRow], float | None]) -> dict[str, float | None]:
        return {row.name: get(row) for row in item.rows}

    return ReproducedTable(
        title=item.title,
        rows=[row.name for row in item.rows],
        paper=each(lambda row: row.paper),
        paper_method=each(lambda row: row.paper_method),
        armsight=each(lambda row: row.armsight),
        truth=each(lambda row: row.truth),
        paper_truth=each(lambda row: row.paper_truth),
        errors=ReproducedErrors(
            paper=each(lambda row: row.errors[0]),
            paper_method=each(lambda row: row.errors[1]),
            armsight=each(lambda row: row.errors[2]),
        ),
        credible={row.name: row.credible for row in item.rows},
        share=each(lambda row: row.share),
        share_of_method=each(lambda row: row.share_of_method),
        notes={row.name: row.note for row in item.rows if row.note},
    )
