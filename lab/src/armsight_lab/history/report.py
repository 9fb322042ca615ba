"""The page of a cell's history: what has drifted, and the control charts of each figure."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime

import numpy as np
from numpy.typing import NDArray

from armsight.arrays import Array
from armsight.records.result_parts import Verdict
from armsight.report.figures import BLUE, GREEN, GREY, INK, ORANGE, RED, Figure, Plot, axis, layout, subplot, thinned
from armsight.report.html import Card, Page, bullets, in_degrees, table
from armsight.units import figure_of, with_deviation
from armsight_lab.history.drift import SMALLEST_STEP, Chart, Limits

MOST_DRAWN = 24
"""Figures that are drawn; further ones stand in the table."""
STATES = {"steady": "steady", "drift": "drifted", "jump": "jumped", "few": "too few runs"}
HEADER = (
    *("", "state", "runs", "one run ±", "scatter over told", "smallest step"),
    *("change", "±", "unit", "since", ""),
)
EXPLAINED = (
    "Change: the last run less the mean of the runs before the change, with its standard deviation. Smallest step: "
    f"the lasting change that the sum is made for, {SMALLEST_STEP:g} deviations of one run; it is found within some "
    "runs, a larger one sooner."
)
ABOUT = (
    "Above: each run less the mean of those before the change, with the deviation it tells; beyond the dotted lines "
    "one run alone is called a jump. Below: the sums of deviations up and down, and where a drift is called."
)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Charted:
    """A figure with its chart. created, runs, values, std: of n runs, in SI; scale: of the unit people read, in SI.

    start, noticed: positions of the run where the change began and was noticed; latest: the last run less mean, the
    mean of the runs before.
    """

    name: str
    command: str
    state: str
    unit: str
    scale: float
    created: Sequence[str]
    runs: Sequence[int]
    values: Array
    std: Array
    chart: Chart
    limits: Limits
    apart: Sequence[int]
    start: int | None
    noticed: int | None
    latest: float | None
    latest_std: float | None
    mean: float
    run_std: float | None
    to_do: str


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TrendPage:
    """What the page tells. few: no figure has enough runs. every_days: between two runs, the median."""

    cell: str
    verdict: Verdict
    n_runs: int
    apart_years: float
    every_days: float
    notes: Sequence[str]
    figures: Sequence[Charted]


def trend_report(run: TrendPage, *, created: datetime | None = None) -> str:
    """Return the page as HTML text that needs no other file."""
    changed = sum(one.start is not None for one in run.figures)
    page = Page(
        title=f"History of {run.cell}",
        subtitle=f"{run.n_runs} runs, {_dates(run)}",
        verdict=run.verdict,
        cards=[
            Card(name="figures judged", value=str(len(run.figures))),
            Card(name="of these changed", value=str(changed)),
            Card(
                name="false alarms", value=f"1 in {run.apart_years:.4g}", note="cell-years, over all figures together"
            ),
            Card(name="a run every", value=_interval(run.every_days), note="on average"),
        ],
    )
    rows = [_row(one) for one in run.figures]
    page.add("Figures", EXPLAINED, table(HEADER, rows, numbers=(2, 3, 4, 5, 6, 7)))
    for one in run.figures[:MOST_DRAWN]:
        page.add(f"{one.name}, {one.command}", _lead(one), page.plot(_figure(one)))
    if run.notes:
        page.add("What to know", "", bullets([in_degrees(note) for note in run.notes]))
    page.add("How it is judged", "", bullets(_method(run)))
    return page.html(created=created or datetime.now())


def _dates(run: TrendPage) -> str:
    days = [one.created[i][:10] for one in run.figures for i in (0, -1)]
    return f"{min(days)} to {max(days)}"


def _interval(days: float) -> str:
    return f"{days:.1f} days" if days >= 1.0 else f"{24.0 * days:.1f} h"


def _row(one: Charted) -> list[str]:
    at = len(one.runs) - 1 if one.start is None else one.start
    factor = one.chart.factor[at, 0] if np.isfinite(one.std).any() else None
    change, std = ("", "")
    if one.latest is not None and one.latest_std is not None:
        change, std = with_deviation(one.latest / one.scale, one.latest_std / one.scale)
    own = None if one.run_std is None else one.run_std / one.scale
    return [
        f"{one.name}, {one.command}",
        STATES[one.state],
        str(len(one.runs)),
        figure_of(own, digits=2),
        figure_of(factor, digits=2),
        figure_of(None if own is None else SMALLEST_STEP * own, digits=2),
        change,
        std,
        one.unit,
        "" if one.start is None else f"{one.created[one.start][:10]}, run {one.runs[one.start]}",
        one.to_do,
    ]


def _lead(one: Charted) -> str:
    if one.noticed is None or one.start is None:
        return ABOUT
    return f"Began with run {one.runs[one.start]}, noticed with run {one.runs[one.noticed]}. {ABOUT}"


def _figure(one: Charted) -> Figure:
    """Return values over time above the two sums."""
    y = (one.values - one.mean) / one.scale
    at = thinned(y)
    when = [one.created[i] for i in at]
    names = [f"run {one.runs[i]}" for i in at]
    chart, limits = one.chart, one.limits
    upper, lower = subplot(1), subplot(2)
    allowed = limits.jump * chart.std[at, 0] / one.scale
    middle = (chart.mean[at, 0] - one.mean) / one.scale
    data = [
        _line("limit of a jump", when, middle + allowed, GREY, upper, dash="dot"),
        {**_line("", when, middle - allowed, GREY, upper, dash="dot"), "showlegend": False},
        _runs(one, "run", at[_normal(one, at)], BLUE, y),
    ]
    changed = at[at >= one.start] if one.start is not None else at[:0]
    for label, chosen, colour in (("since the change", changed, RED), ("left out", np.array(one.apart, int), ORANGE)):
        if len(chosen):
            data.append(_runs(one, label, chosen, colour, y))
    data += [
        _line("sum upwards", when, chart.up[at, 0], GREEN, lower, text=names),
        _line("sum downwards", when, -chart.down[at, 0], INK, lower, text=names),
        _line("limit of a drift", when, np.full(len(at), limits.drift), GREY, lower, dash="dash"),
        {**_line("", when, np.full(len(at), -limits.drift), GREY, lower, dash="dash"), "showlegend": False},
    ]
    shape = layout(
        xaxis=axis("", type="date", matches="x2", showticklabels=False, anchor="y"),
        yaxis=axis(f"off, {one.unit}" if one.unit else "off", domain=[0.46, 1.0], anchor="x"),
        xaxis2=axis("", type="date", anchor="y2"),
        yaxis2=axis("sum", domain=[0.0, 0.36], anchor="x2"),
    )
    shape["legend"] = {**shape["legend"], "y": 1.02}
    return Figure(data=data, layout=shape, height_px=440)


def _normal(one: Charted, at: NDArray[np.intp]) -> NDArray[np.bool_]:
    """Return which positions are neither of the change nor left out."""
    end = len(one.runs) if one.start is None else one.start
    return np.array([i < end and i not in one.apart for i in at.tolist()], dtype=bool)


def _runs(one: Charted, name: str, at: NDArray[np.intp], colour: str, y: Array) -> Plot:
    error = {"error_y": {"type": "data", "array": one.std[at] / one.scale, "color": colour, "thickness": 1, "width": 0}}
    return {
        "type": "scatter",
        "mode": "markers",
        "name": name,
        "x": [one.created[i] for i in at],
        "y": y[at],
        "marker": {"size": 6, "color": colour},
        "text": [f"run {one.runs[i]}" for i in at],
        "hovertemplate": "%{text}: %{y:.4g}<extra></extra>",
        **(error if np.isfinite(one.std[at]).any() else {}),
        **subplot(1),
    }


def _line(
    name: str,
    x: Sequence[str],
    y: Array,
    colour: str,
    on: dict[str, str],
    *,
    dash: str = "solid",
    text: Sequence[str] = (),
) -> Plot:
    hover: Plot = (
        {"text": list(text), "hovertemplate": "%{text}: %{y:.2f}<extra></extra>"} if text else {"hoverinfo": "skip"}
    )
    style = {"color": colour, "width": 1.3, "dash": dash}
    return {"type": "scatter", "mode": "lines", "name": name, "x": list(x), "y": y, "line": style, **hover, **on}


def _method(run: TrendPage) -> list[str]:
    return [
        "Each run is held against the weighted mean of the runs before it, and the scatter between runs is estimated "
        "from the runs themselves: deviations told up to 1.5 times too small bring no more false alarms than stated.",
        f"One false alarm is to be expected in {run.apart_years:.4g} years of this cell, over all figures together: at "
        f"a run every {_interval(run.every_days)} in {run.apart_years * 365.25 / run.every_days:.3g} runs.",
        "A jump is a run beyond its limit (Shewhart); a drift is a sum of deviations beyond its own (CUSUM). A run "
        "beyond the limit whose next is back again is left out as a run gone wrong.",
        "After a re-mastering, a new camera or another nominal arm, judge the runs since: --since.",
    ]
