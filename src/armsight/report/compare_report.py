"""The page of two results side by side."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from armsight.arrays import Array
from armsight.measure.series import SCALE, Series
from armsight.records import PoseStatus
from armsight.records.result_parts import Difference, Verdict
from armsight.report.figures import BLUE, RED, Figure, axis, bars, layout, named_ticks, short_names
from armsight.report.html import Card, Page, table
from armsight.report.track import deviation_figure
from armsight.units import figure_of, with_deviation

CARDS = 4
BEYOND = 3.0
"""Standard deviations beyond which a bar is red."""

KINDS = {
    "camera": "two calibrations of a camera",
    "rig": "two calibrations of a rig",
    "handeye": "two hand-eye calibrations",
    "arm": "two calibrations of an arm",
    "measure": "two measurements",
    "verify": "two verifications",
}


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Course:
    """Differences of poses (n, 6) in m and rad at t_s (n,), with their standard deviations (n, 6)."""

    t_s: Array
    values: Array
    std: Array


def compare_report(
    kind: str,
    names: tuple[str, str],
    verdict: Verdict,
    rows: Sequence[Difference],
    *,
    effects: Sequence[tuple[str, str]],
    notes: Sequence[str],
    course: Course | None = None,
) -> str:
    """Return the page as HTML text that needs no other file.

    names: of the results A and B. effects: what the differences come to and how much, with its unit.
    """
    page = Page(
        title=f"Comparison of {KINDS[kind]}",
        subtitle=f"A is {names[0]}, B is {names[1]}",
        verdict=verdict,
        cards=[Card(name, value) for name, value in effects[:CARDS]],
    )
    if effects:
        cells = [list(item) for item in effects]
        page.add("What the differences come to", "", table(["", "how much"], cells, numbers=(1,)))
    if any(row.sigmas is not None for row in rows):
        page.add(
            "Differences beside their uncertainty",
            f"B less A in standard deviations of the difference, A and B taken as independent; red beyond {BEYOND:g}. "
            "Single bars of numbers that hang together may be long or short for nothing: the verdict counts that.",
            page.plot(_sigmas(rows)),
        )
    if course is not None:
        page.add(
            "Differences over time",
            "B less A, position and rotation, within the 95 % band of the difference.",
            page.plot(_course(course)),
        )
    page.add("Number by number", "", _table(rows))
    page.add_notes(notes)
    return page.html()


def _table(rows: Sequence[Difference]) -> str:
    cells = []
    for row in rows:
        difference, std = with_deviation(row.difference, row.std) if row.difference else ("0", figure_of(row.std))
        values = (figure_of(row.a, digits=7), figure_of(row.b, digits=7))
        sigmas = "–" if row.sigmas is None else f"{row.sigmas:+.1f}"
        cells.append([row.name, *values, difference, std, sigmas, row.unit])
    return table(["", "A", "B", "B less A", "±", "in sigma", "unit"], cells, numbers=(1, 2, 3, 4, 5))


def _sigmas(rows: Sequence[Difference]) -> Figure:
    known = [row for row in rows if row.sigmas is not None]
    names = short_names([row.name for row in known])
    size = np.array([row.sigmas or 0.0 for row in known])
    at = np.arange(1.0, len(known) + 1.0)
    data = []
    for chosen, colour in ((np.abs(size) <= BEYOND, BLUE), (np.abs(size) > BEYOND, RED)):
        hover = {
            "text": [names[i] for i in np.flatnonzero(chosen)],
            "hovertemplate": "%{text}: %{y:.2f}<extra></extra>",
        }
        if chosen.any():
            data.append(bars(at[chosen], size[chosen], 0.7, colour, name="", showlegend=False, **hover))
    shape = layout(xaxis=axis("", **named_ticks(names)), yaxis=axis("B less A, sigma"))
    return Figure(data=data, layout=shape, height_px=320)


def _course(course: Course) -> Figure:
    """Return the differences over time in mm and degrees."""
    values, std = course.values / SCALE, course.std / SCALE
    series = Series(t_s=course.t_s, status=(PoseStatus.OK,) * len(values), values=values, std=std)
    return deviation_figure(series, values, std)
