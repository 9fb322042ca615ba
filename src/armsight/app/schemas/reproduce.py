"""reproduce."""

from __future__ import annotations

from pydantic import Field

from armsight.app.schemas.base import Output

Values = dict[str, float | None]


class ReproducedErrors(Output):
    """Sizes of errors by row; null where there is no truth to hold a figure against."""

    paper: Values = Field(description="Of the printed figures, against what the paper holds to be true.")
    paper_method: Values = Field(description="Of the paper's method on the simulated frames, against the truth.")
    armsight: Values = Field(description="Of armsight on the same frames, against the truth.")


class ReproducedTable(Output):
    """A table of the paper, or the figures that stand for a plot of it."""

    title: str = Field(description="What it is.")
    rows: list[str] = Field(description="The rows' names in order; the unit is their ending (_m, _rad, _px).")
    paper: Values = Field(description="As printed; null where the paper gives none.")
    paper_method: Values = Field(description="By the paper's method, from the simulated frames.")
    armsight: Values = Field(description="By armsight, from the same frames.")
    truth: Values = Field(description="The truth of the simulation; 0 for figures that are errors themselves.")
    paper_truth: Values = Field(description="What the paper holds to be true; null where it gives none.")
    errors: ReproducedErrors = Field(description="Sizes of the errors.")
    credible: dict[str, bool] = Field(description="Whether the printed figure can be believed as what it is called.")
    share: Values = Field(description="armsight's error over the paper's printed one.")
    share_of_method: Values = Field(description="armsight's error over that of the paper's method on the same frames.")
    notes: dict[str, str] = Field(description="What to know about a row, where there is something.")


class ReproduceOutput(Output):
    """armsight reproduce."""

    paper: str = Field(description="Which paper.")
    seed: int = Field(description="Seed of the simulated frames' noise.")
    scenarios: list[str] = Field(description="The emulated hardware.")
    tables: dict[str, ReproducedTable] = Field(description="Tables by name.")
    figures: list[str] = Field(description="The paper's figures that the report draws anew.")
    n_compared: int = Field(description="Rows whose printed figure is credible and has an error.")
    n_reached: int = Field(description="Those of them in which armsight's error is at most a third of the paper's.")
    missed: list[str] = Field(description="The others, as table.row.")
    assumptions: list[str] = Field(description="What the paper does not say, and what was chosen.")
    doubts: list[str] = Field(description="Known doubts about the printed figures.")
    missing: list[str] = Field(description="Parts of the paper that are not reproduced, and why.")
    seconds_s: float = Field(description="How long it took, s.")
