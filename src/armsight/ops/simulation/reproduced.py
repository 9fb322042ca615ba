"""What a reproduced paper gives: the printed figures, its method's and armsight's; armsight-sim makes it."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated

from armsight.fields import Doc
from armsight.file_names import REPORT
from armsight.records.output import Output, output
from armsight.shown import Shown, Table, digits

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

    def shown(self) -> Table:
        """Return the table as people read it; a share in brackets is of a figure that is not believed."""
        head = ["m, rad or px", "paper", "its method", "armsight", "truth", "share of print", "of method"]
        return Table(self.title, head, [self._row(name) for name in self.rows])

    def _row(self, name: str) -> list[str]:
        values = (self.paper[name], self.paper_method[name], self.armsight[name], self.truth[name])
        share = "-" if self.share[name] is None else digits(self.share[name], 2)
        told = share if self.credible[name] or share == "-" else f"({share})"
        return [name, *(digits(value, 4) for value in values), told, digits(self.share_of_method[name], 2)]


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

    def summary(self) -> Iterator[Shown]:
        """Yield what a terminal shows of it."""
        yield from (item.shown() for item in self.tables.values())
        yield from (f"- not reproduced: {note}" for note in self.missing)
        if self.n_compared:
            yield (
                f"armsight's error is at most a third of the paper's in {self.n_reached} of {self.n_compared} rows "
                "that can be compared" + (f"; not in {', '.join(self.missed)}" if self.missed else "")
            )
        yield f"Result: open {{out}}/{REPORT}"
