"""What a reproduced paper gives: the printed figures, its method's and armsight's; armsight-sim makes it."""

from __future__ import annotations

from typing import Annotated

from armsight.fields import Doc
from armsight.records.output import Output, output

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
