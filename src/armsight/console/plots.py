"""A small plot: a title with the unit, curves in colours that colour-blind people tell apart, readable in the dark."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from nicegui import ui

GREY = "#7b8794"
"""Readable on light and dark paper."""
LINES = ("#0072B2", "#D55E00", "#009E73")
"""Okabe and Ito's blue, vermillion and green."""
SMALL_REM = 10

Curve = Sequence[tuple[float, float | None]]


class Plot:
    """Curves over one axis; `show` draws them anew."""

    def __init__(
        self,
        title: str,
        names: Sequence[str],
        *,
        testid: str = "",
        along: str = "{value}",
        dots: bool = False,
        first: int = 0,
    ) -> None:
        """names: of the curves; one alone has no legend. along: how values along are written. first: a colour."""
        legend = len(names) > 1
        options: dict[str, Any] = {
            "animation": False,
            "title": {"text": title, "textStyle": {"color": GREY, "fontSize": 14}, "top": 0},
            "grid": {"left": 62, "right": 20, "top": 55 if legend else 30, "bottom": 25},
            "xAxis": {
                "axisLine": {"onZero": False},
                "type": "value",
                "min": "dataMin",
                "max": "dataMax",
                "axisLabel": {"formatter": along, "color": GREY, "showMinLabel": False},
                "splitLine": {"lineStyle": {"color": GREY, "opacity": 0.25}},
                "splitNumber": 3,
            },
            "yAxis": {
                "type": "value",
                "scale": True,
                "splitNumber": 3,
                "axisLabel": {"color": GREY},
                "splitLine": {"lineStyle": {"color": GREY, "opacity": 0.25}},
            },
            "series": [_line(name, first + i, dots=dots) for i, name in enumerate(names)],
        }
        if legend:
            options["legend"] = {"data": list(names), "top": 24, "textStyle": {"color": GREY}}
        self._chart = ui.echart(options).classes("w-full").style(f"height: {SMALL_REM + 2 * legend}rem")
        if testid:
            self._chart.props["data-testid"] = testid

    def show(self, curves: Sequence[Curve]) -> None:
        """Draw each curve's points (along, value); a value of None leaves a gap."""
        for line, points in zip(self._chart.options["series"], curves, strict=True):
            line["data"] = [[x, y] for x, y in points]
        self._chart.update()


def _line(name: str, number: int, *, dots: bool) -> dict[str, Any]:
    colour = LINES[number % len(LINES)]
    return {
        "name": name,
        "type": "line",
        "showSymbol": dots,
        "data": [],
        "lineStyle": {"color": colour, "type": "solid"},
        "itemStyle": {"color": colour},
    }
