"""The page of a cell's history: what has drifted, and the control charts of each figure."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from armsight.arrays import Array
from armsight.report.figures import (
    BLUE,
    GREEN,
    GREY,
    INK,
    ORANGE,
    RED,
    Figure,
    Plot,
    axis,
    layout,
    subplot,
    thinned,
    trace,
)
from armsight.report.html import Card, Page, bullets, in_degrees, page_unit, table
from armsight.units import displayed, displayed_name, figure_of, with_deviation
from armsight_lab.history.drift import SMALLEST_STEP
from armsight_lab.history.series import YEAR_DAYS, Course

if TYPE_CHECKING:
    from armsight_lab.history.trend import Judgement, TrendFigure, TrendOutput


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


def trend_report(done: TrendOutput, judgements: Sequence[Judgement]) -> str:
    """Return the page as HTML text that needs no other file; judgements: of done's figures, in their order."""
    days = [one.course.created[i][:10] for one in judgements for i in (0, -1)]
    every_days = YEAR_DAYS / float(np.median([one.runs_a_year for one in judgements]))
    apart_years = done.false_alarms_apart_years
    page = Page(
        title=f"History of {done.cell}",
        subtitle=f"{done.n_runs} runs, {min(days)} to {max(days)}",
        verdict=done.verdict_,
        cards=[
            Card("figures judged", str(len(judgements))),
            Card("of these changed", str(sum(one.found.change is not None for one in judgements))),
            Card("false alarms", f"1 in {apart_years:.4g}", "cell-years, over all figures together"),
            Card("a run every", _interval(every_days), "on average"),
        ],
    )
    rows = [_row(row, one) for row, one in zip(done.figures, judgements, strict=True)]
    page.add("Figures", EXPLAINED, table(HEADER, rows, numbers=(2, 3, 4, 5, 6, 7)))
    for row, one in zip(done.figures[:MOST_DRAWN], judgements, strict=False):
        page.add(_name(row), _lead(one), page.plot(_figure(row, one)))
    if done.notes:
        page.add("What to know", "", bullets([in_degrees(note) for note in done.notes]))
    page.add("How it is judged", "", bullets(_method(apart_years, every_days)))
    return page.html()


def _name(row: TrendFigure) -> str:
    return f"{displayed_name(row.name)[0]}, {row.command}"


def _interval(days: float) -> str:
    return f"{days:.1f} days" if days >= 1.0 else f"{24.0 * days:.1f} h"


def _row(row: TrendFigure, one: Judgement) -> list[str]:
    course, chart, moved = one.course, one.found.chart, one.found.change
    unit, scale = displayed(row.unit)
    at = row.n - 1 if moved is None else moved.start
    factor = chart.factor[at, 0] if np.isfinite(course.std).any() else None
    change, std = ("", "") if moved is None else with_deviation(moved.latest / scale, moved.latest_std / scale)
    own = None if row.run_std is None else row.run_std / scale
    return [
        _name(row),
        STATES[row.state],
        str(row.n),
        figure_of(own, digits=2),
        figure_of(factor, digits=2),
        figure_of(None if own is None else SMALLEST_STEP * own, digits=2),
        change,
        std,
        page_unit(unit),
        "" if moved is None else f"{course.created[moved.start][:10]}, run {course.runs[moved.start]}",
        row.to_do,
    ]


def _lead(one: Judgement) -> str:
    runs, change = one.course.runs, one.found.change
    return (
        ABOUT
        if change is None
        else f"Began with run {runs[change.start]}, noticed with run {runs[change.noticed]}. {ABOUT}"
    )


def _figure(row: TrendFigure, one: Judgement) -> Figure:
    """Return values over time above the two sums."""
    course, chart, limits = one.course, one.found.chart, one.limits
    unit, scale = displayed(row.unit)
    y = (course.values - row.mean) / scale
    at = thinned(y)
    when = [course.created[i] for i in at]
    names = [f"run {course.runs[i]}" for i in at]
    upper, lower = subplot(1), subplot(2)
    allowed = limits.jump * chart.std[at, 0] / scale
    middle = (chart.mean[at, 0] - row.mean) / scale
    start, apart = one.found.change.start if one.found.change else row.n, one.found.apart
    normal = np.array([i for i in at.tolist() if i < start and i not in apart], int)
    data = [
        _line("limit of a jump", when, middle + allowed, GREY, upper, dash="dot"),
        {**_line("", when, middle - allowed, GREY, upper, dash="dot"), "showlegend": False},
        _runs(course, "run", normal, BLUE, y, scale),
    ]
    for label, chosen, colour in (
        ("since the change", at[at >= start], RED),
        ("left out", np.array(apart, int), ORANGE),
    ):
        if len(chosen):
            data.append(_runs(course, label, chosen, colour, y, scale))
    data += [
        _line("sum upwards", when, chart.up[at, 0], GREEN, lower, text=names),
        _line("sum downwards", when, -chart.down[at, 0], INK, lower, text=names),
        _line("limit of a drift", when, np.full(len(at), limits.drift), GREY, lower, dash="dash"),
        {**_line("", when, np.full(len(at), -limits.drift), GREY, lower, dash="dash"), "showlegend": False},
    ]
    shown = page_unit(unit)
    shape = layout(
        xaxis=axis("", type="date", matches="x2", showticklabels=False, anchor="y"),
        yaxis=axis(f"off, {shown}" if shown else "off", domain=[0.46, 1.0], anchor="x"),
        xaxis2=axis("", type="date", anchor="y2"),
        yaxis2=axis("sum", domain=[0.0, 0.36], anchor="x2"),
    )
    shape["legend"] = {**shape["legend"], "y": 1.02}
    return Figure(data=data, layout=shape, height_px=440)


def _runs(course: Course, name: str, at: NDArray[np.intp], colour: str, y: Array, scale: float) -> Plot:
    error = {"error_y": {"type": "data", "array": course.std[at] / scale, "color": colour, "thickness": 1, "width": 0}}
    more = {
        "marker": {"size": 6, "color": colour},
        "text": [f"run {course.runs[i]}" for i in at],
        "hovertemplate": "%{text}: %{y:.4g}<extra></extra>",
        **(error if np.isfinite(course.std[at]).any() else {}),
    }
    return trace("markers", name, [course.created[i] for i in at], y[at], **more, **subplot(1))


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
    return trace("lines", name, list(x), y, line=style, **hover, **on)


def _method(apart_years: float, every_days: float) -> list[str]:
    return [
        "Each run is held against the weighted mean of the runs before it, and the scatter between runs is estimated "
        "from the runs themselves: deviations told up to 1.5 times too small bring no more false alarms than stated.",
        f"One false alarm is to be expected in {apart_years:.4g} years of this cell, over all figures together: at "
        f"a run every {_interval(every_days)} in {apart_years * YEAR_DAYS / every_days:.3g} runs.",
        "A jump is a run beyond its limit (Shewhart); a drift is a sum of deviations beyond its own (CUSUM). A run "
        "beyond the limit whose next is back again is left out as a run gone wrong.",
        "After a re-mastering, a new camera or another nominal arm, judge the runs since: --since.",
    ]
