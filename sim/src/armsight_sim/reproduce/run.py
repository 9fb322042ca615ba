"""One paper's experiment from frames to tables and report."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from pathlib import Path
from types import MappingProxyType

from armsight.errors import UsageError
from armsight.ops.simulation.reproduced import ReproducedErrors, ReproducedTable, ReproduceOutput
from armsight.records import Progress, Silent
from armsight.store import write_text
from armsight.store.atomic import write_json
from armsight_sim.reproduce.kapucu2005 import reproduce_kapucu
from armsight_sim.reproduce.korayem2018 import reproduce_korayem
from armsight_sim.reproduce.pachidis2005 import reproduce_pachidis
from armsight_sim.reproduce.page import ComparedRow, ComparisonTable, Reproduction, reproduce_report
from armsight_sim.reproduce.stage import Stage

PAPERS: Mapping[str, Callable[[Stage], Reproduction]] = MappingProxyType(
    {
        "korayem2018": reproduce_korayem,
        "pachidis2005": reproduce_pachidis,
        "kapucu2005": reproduce_kapucu,
    }
)


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
