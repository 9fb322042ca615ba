"""The page of a paper that is reproduced: its tables and figures beside the paper's method and armsight's."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from armsight.arrays import Array
from armsight.records.result_parts import Verdict
from armsight.report.figures import BLUE, GREY, INK, ORANGE, Figure, Plot, axis, layout, subplot
from armsight.report.html import Card, Page, bullets, page_unit, table
from armsight.units import displayed, figure_of

WANTED_SHARE = 1.0 / 3.0
"""armsight's error over the paper's that is wanted in each row where the paper's figure can be believed."""

TRUTH, METHOD, OURS = GREY, ORANGE, BLUE
PANEL_PX = 330
READ = "Nothing; before you quote a figure, read the doubts about the printed ones and the assumptions below."
LOOK_UP = "Look up the rows named in the tables below, with their notes, before you rely on what they measure."


@dataclass(frozen=True, slots=True, kw_only=True)
class ComparedRow:
    """One figure of a table in SI: as printed, by the paper's method on simulated frames, by armsight on the same.

    truth: in the simulation; paper_truth: what the paper holds to be true; with neither there is no error. paper_error:
    instead of the difference, where the paper tells its error otherwise. credible: whether the printed figure can be
    believed as what it is called, so that armsight's error is held against it.
    """

    name: str
    label: str
    unit: str
    paper: float | None
    paper_method: float | None
    armsight: float | None
    truth: float | None = None
    paper_truth: float | None = None
    paper_error: float | None = None
    credible: bool = True
    note: str = ""

    @property
    def errors(self) -> tuple[float | None, float | None, float | None]:
        """Sizes of the errors of paper, paper's method and armsight."""
        printed = self.paper_error
        if printed is None:
            printed = _off(self.paper, self.paper_truth)
        return printed, _off(self.paper_method, self.truth), _off(self.armsight, self.truth)

    @property
    def share(self) -> float | None:
        """armsight's error over the paper's printed one; None without either."""
        printed, _, ours = self.errors
        return None if printed is None or ours is None or printed == 0.0 else ours / printed

    @property
    def share_of_method(self) -> float | None:
        """armsight's error over that of the paper's method on the same frames; None without either."""
        _, method, ours = self.errors
        return None if method is None or ours is None or method == 0.0 else ours / method

    @property
    def compared(self) -> bool:
        """Whether armsight's error is held against the paper's."""
        return self.credible and self.share is not None

    @property
    def reached(self) -> bool:
        """Whether armsight's error is small enough beside the paper's."""
        return self.share is not None and self.share <= WANTED_SHARE


def _off(value: float | None, truth: float | None) -> float | None:
    return None if value is None or truth is None else abs(value - truth)


@dataclass(frozen=True, slots=True, kw_only=True)
class ComparisonTable:
    """A table of the paper, or what stands for a figure's content; name: its key; text: what it is."""

    name: str
    title: str
    text: str
    rows: tuple[ComparedRow, ...]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Curve:
    """One curve of a panel; mode: lines, markers or lines+markers; who: truth, method or ours (its colour)."""

    name: str
    x: Array
    y: Array
    who: str
    mode: str = "markers"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Panel:
    """One plot; equal: both axes in the same scale; downward: y grows down, as rows of an image do."""

    x_title: str
    y_title: str
    curves: tuple[Curve, ...]
    equal: bool = False
    downward: bool = False


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PaperFigure:
    """A figure of the paper, drawn anew; name: as the paper numbers it."""

    name: str
    text: str
    panels: tuple[Panel, ...]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Reproduction:
    """All that a reproduced paper's page tells. settings: (key, value, where it is from) of the emulated hardware."""

    paper: str
    title: str
    source: str
    seed: int
    tables: tuple[ComparisonTable, ...]
    figures: tuple[PaperFigure, ...]
    assumptions: tuple[str, ...]
    doubts: tuple[str, ...]
    missing: tuple[str, ...]
    settings: tuple[tuple[str, str, str], ...] = field(default=())

    @property
    def compared(self) -> list[ComparedRow]:
        """The rows in which the paper's figure can be believed and has an error."""
        return [row for item in self.tables for row in item.rows if row.compared]


def reproduce_report(done: Reproduction) -> str:
    """Return the page as HTML text that needs no other file."""
    page = Page(
        title=done.title, subtitle=f"{done.source}; seed {done.seed}", verdict=_verdict(done), cards=_cards(done)
    )
    for item in done.tables:
        page.add(item.title, item.text, _table(item), _notes(item))
    for figure in done.figures:
        page.add(figure.name, figure.text, page.plot(panels_figure(figure.panels)))
    if done.missing:
        page.add("Not reproduced", "", bullets(done.missing))
    page.add("Doubts about the printed figures", "Where the paper contradicts itself or chance.", bullets(done.doubts))
    page.add(
        "Assumptions of the methods", "What the paper does not say, and what was chosen.", bullets(done.assumptions)
    )
    if done.settings:
        page.add(
            "Emulated hardware",
            "Every number of the scenario and where it is from: the paper, derived from it, or chosen.",
            table(["setting", "value", "from"], done.settings),
        )
    return page.html()


def _verdict(done: Reproduction) -> Verdict:
    compared = done.compared
    reached = sum(row.reached for row in compared)
    if not compared:
        shares = [row.share_of_method for item in done.tables for row in item.rows if row.share_of_method is not None]
        small = sum(share <= WANTED_SHARE for share in shares)
        return Verdict(
            level="good",
            headline="No printed figure to hold against",
            reasons=[
                (
                    "The paper prints curves only. armsight's error is at most a third of its method's on the "
                    f"same frames in {small} of {len(shares)} rows."
                )
            ],
            next=[READ],
        )
    missed = [
        f"{item.title.partition(':')[0]}: {'; '.join(labels)}"
        for item in done.tables
        if (labels := [row.label for row in item.rows if row.compared and not row.reached])
    ]
    text = (
        f"armsight's error is at most a third of the paper's in {reached} of {len(compared)} rows that can be compared"
    )
    return Verdict(
        level="care" if missed else "good",
        headline="Reached in part" if missed else "Reached",
        reasons=[text + (f". Not in {'. '.join(missed)}." if missed else ".")],
        next=[LOOK_UP if missed else READ],
    )


def _cards(done: Reproduction) -> list[Card]:
    shares = [row.share for row in done.compared if row.share is not None]
    methods = [row.share_of_method for item in done.tables for row in item.rows if row.share_of_method is not None]
    of_print = figure_of(float(np.median(shares)) if shares else None, digits=2)
    of_method = figure_of(float(np.median(methods)) if methods else None, digits=2)
    printed = [
        Card("compared with print", str(len(shares)), "rows whose printed figure can be believed"),
        Card("error over the printed one", of_print, "median over those rows"),
    ]
    return [
        Card("rows", str(sum(len(item.rows) for item in done.tables)), "in all tables"),
        *(printed if shares else ()),
        Card("error over its method's", of_method, "the paper's method on the same frames, median"),
    ]


def _table(item: ComparisonTable) -> str:
    head = [
        "",
        "paper",
        "its method",
        "armsight",
        "truth",
        "error: paper",
        "error: its method",
        "error: armsight",
        "share of paper",
        "share of method",
    ]
    rows = []
    for row in item.rows:
        unit, scale = displayed(row.unit)
        values = (row.paper, row.paper_method, row.armsight, row.truth, *row.errors)
        shown = [figure_of(None if value is None else value / scale, digits=4) for value in values]
        share = "–" if row.share is None else f"{row.share:.3f}" if row.credible else f"({row.share:.3f})"
        of_method = "–" if row.share_of_method is None else f"{row.share_of_method:.3f}"
        rows.append([f"{row.label}, {page_unit(unit)}" if unit else row.label, *shown, share, of_method])
    kept = [k for k in range(len(head)) if any(row[k] != "–" for row in rows)]
    cells = [[row[k] for k in kept] for row in rows]
    return table([head[k] for k in kept], cells, numbers=tuple(range(1, len(kept))))


def _notes(item: ComparisonTable) -> str:
    notes: dict[str, list[str]] = {}
    for row in item.rows:
        if row.note:
            notes.setdefault(row.note, []).append(row.label)
    return bullets([f"{'; '.join(labels)}: {note}" for note, labels in notes.items()]) if notes else ""


def panels_figure(panels: Sequence[Panel]) -> Figure:
    """Return panels in rows of up to three, the curves' names told once."""
    columns = min(3, len(panels))
    n_rows = math.ceil(len(panels) / columns)
    traces: list[Plot] = []
    axes: Plot = {}
    shown: set[str] = set()
    for k, panel in enumerate(panels, 1):
        row, column = divmod(k - 1, columns)
        width, height = 1.0 / columns, 1.0 / n_rows
        across = [(column + (0.2 if column else 0.0)) * width, (column + 0.98) * width]
        up = [1.0 - (row + 1) * height + (0.16 if n_rows > 1 else 0.02) * height, 1.0 - row * height - 0.03 * height]
        where = subplot(k)
        mark = "" if k == 1 else str(k)
        same = {"scaleanchor": f"x{mark}", "scaleratio": 1} if panel.equal else {}
        down = {"autorange": "reversed"} if panel.downward else {}
        axes[f"xaxis{mark}"] = axis(panel.x_title, domain=across, anchor=where["yaxis"])
        axes[f"yaxis{mark}"] = axis(panel.y_title, domain=up, anchor=where["xaxis"], **same, **down)
        traces += [_trace(curve, shown) | where for curve in panel.curves]
    return Figure(data=traces, layout=layout(**axes), height_px=40 + PANEL_PX * n_rows)


def _trace(curve: Curve, shown: set[str]) -> Plot:
    colour = {"truth": TRUTH, "method": METHOD, "ours": OURS}.get(curve.who, INK)
    symbol = {"method": "x", "ours": "circle-open"}.get(curve.who, "circle")
    new = curve.name not in shown
    shown.add(curve.name)
    return {
        "type": "scatter",
        "mode": curve.mode,
        "name": curve.name,
        "legendgroup": curve.name,
        "showlegend": new,
        "x": np.asarray(curve.x, float),
        "y": np.asarray(curve.y, float),
        "marker": {"color": colour, "symbol": symbol, "size": 6},
        "line": {"color": colour, "width": 1.6},
    }
