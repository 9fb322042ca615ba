"""Curves for a page, tracks of target and tool, and the axes round them."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
from nicegui import ui
from nicegui.elements.scene.scene_object3d import Object3D

from armsight.arrays import Array
from armsight.units import MM

Point = tuple[float, float, float]

POINTS = 1500
"""Positions of a track that are kept: 12 m of a path at 80 mm/s, at ten a second."""
APART_M = 5e-4
"""What is seen so near to its track's end is at rest: the track goes on beyond it."""
DIGITS = 5
"""Of positions in m as they are sent."""
TICKS = 8
"""Of the longest axis at most."""


@dataclass(slots=True)
class Tracks:
    """Where the target was measured, with its standard deviation in m, and where the arm's tool was; all pages add to
    them and show the same."""

    measured: deque[tuple[Point, float]] = field(default_factory=lambda: deque(maxlen=POINTS))
    tool: deque[Point] = field(default_factory=lambda: deque(maxlen=POINTS))

    def add_measured(self, xyz_m: Array, std_m: float) -> None:
        """Add where the target is (3,) where it has gone on."""
        if not self.measured or _apart(xyz_m, self.measured[-1][0]):
            self.measured.append((_rounded(xyz_m), std_m))

    def add_tool(self, xyz_m: Array) -> None:
        """Add where the tool is (3,) where it has gone on."""
        if not self.tool or _apart(xyz_m, self.tool[-1]):
            self.tool.append(_rounded(xyz_m))

    def clear(self) -> None:
        """Begin anew."""
        self.measured.clear()
        self.tool.clear()


def _rounded(xyz_m: Array) -> Point:
    x, y, z = (round(float(value), DIGITS) for value in xyz_m)
    return x, y, z


def _apart(one: Array, other: Point) -> bool:
    return bool(np.linalg.norm(one - np.array(other)) > APART_M)


@dataclass(frozen=True, slots=True)
class Ticks:
    """Of the axes about curves, in whole mm: from, to (3,) and the step between two, the same on all axes."""

    low_mm: tuple[int, int, int]
    high_mm: tuple[int, int, int]
    step_mm: int

    @classmethod
    def about(cls, positions: Array) -> Ticks:
        """Return those about positions (n, 3) in m."""
        low, high = positions.min(axis=0) / MM, positions.max(axis=0) / MM
        wanted = max(float((high - low).max()) / (TICKS - 1), 1.0)
        size = 10 ** int(np.floor(np.log10(wanted)))
        step = next(n * size for n in (1, 2, 5, 10) if n * size >= wanted)
        first = np.floor(low / step).astype(int) * step
        last = np.maximum(np.ceil(high / step).astype(int) * step, first + step)
        return cls(tuple(first.tolist()), tuple(last.tolist()), step)

    @property
    def centre_m(self) -> Array:
        """The middle (3,) of what they hold."""
        return np.asarray(0.5 * MM * (np.array(self.low_mm) + np.array(self.high_mm)))

    @property
    def span_m(self) -> float:
        """The diagonal of what they hold."""
        return MM * float(np.linalg.norm(np.array(self.high_mm) - np.array(self.low_mm)))


GREY = "#737f8c"
"""Of lines; words, which no one grey is plain enough for on light and dark paper, are as the page's: console.css."""
LINES = ("#0072B2", "#D55E00", "#009E73")
"""Okabe and Ito's blue, vermillion and green."""
SMALL_REM = 10

CurvePoints = Sequence[tuple[float, float | None]]


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
            "title": {"text": title, "textStyle": {"fontSize": 14}, "top": 0},
            "grid": {"left": 62, "right": 20, "top": 55 if legend else 30, "bottom": 25},
            "xAxis": {
                "axisLine": {"onZero": False},
                "type": "value",
                "min": "dataMin",
                "max": "dataMax",
                "axisLabel": {"formatter": along, "showMinLabel": False},
                "splitLine": {"lineStyle": {"color": GREY, "opacity": 0.25}},
                "splitNumber": 3,
            },
            "yAxis": {
                "type": "value",
                "scale": True,
                "splitNumber": 3,
                "splitLine": {"lineStyle": {"color": GREY, "opacity": 0.25}},
            },
            "series": [_line(name, first + i, dots=dots) for i, name in enumerate(names)],
        }
        if legend:
            options["legend"] = {"data": list(names), "top": 24}
        self._chart = (
            ui.echart(options, renderer="svg").classes("w-full plot").style(f"height: {SMALL_REM + 2 * legend}rem")
        )
        if testid:
            self._chart.props["data-testid"] = testid

    def show(self, curves: Sequence[CurvePoints]) -> None:
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


DASH_M = 0.003
INK = "#14181c"


class Curve(Object3D, component=Path(str(files("armsight") / "console" / "static" / "curve.js"))):
    """A curve through positions; line: solid, dashed or none; marks of mark_px, none for 0; layer: higher is before."""

    def __init__(self, name: str, *, line: str, mark_px: float, layer: int) -> None:
        super().__init__([], [], line, mark_px, DASH_M, layer)
        self.with_name(f"curve-{name}")
        self.positions: Sequence[Point] = ()

    def show(self, positions: Sequence[Point], colours: Sequence[Sequence[float]]) -> None:
        """Draw it; colours: r, g, b in 0 to 1 of each position. Nothing is sent where it is the same."""
        sent = [[list(position) for position in positions], [list(colour) for colour in colours]]
        if sent == self.args[:2]:
            return
        self.positions = tuple(positions)
        self.args[:2] = sent
        self.scene.run_method("run_method_on_component", self.id, "set_points", *sent)


class Ruler:
    """Axes in mm about the curves, their corner and ends named; they grow with them."""

    def __init__(self, scene: ui.scene) -> None:
        self._scene = scene
        self._ticks: Ticks | None = None
        self._drawn = scene.group()

    def show(self, ticks: Ticks | None) -> None:
        """Draw these axes, none for None. Nothing is sent where they are the same."""
        if ticks == self._ticks:
            return
        self._ticks = ticks
        self._drawn.delete()
        with self._scene, self._scene.group() as self._drawn:
            if ticks is not None:
                low = np.array(ticks.low_mm, dtype=float)
                for axis, high in enumerate(ticks.high_mm):
                    self._axis(low, axis, range(ticks.low_mm[axis], high + 1, ticks.step_mm))
                self._name("({}, {}, {}) mm".format(*ticks.low_mm), low - 0.8 * ticks.step_mm * np.eye(3)[2])

    def _axis(self, low: Array, axis: int, marks: range) -> None:
        """Draw one from the corner low (3,) in mm, with its ticks; named at its end."""
        along, tick = np.eye(3)[axis], np.eye(3)[1 if axis == 0 else 0] * -0.3 * marks.step
        end = low + (marks[-1] - marks[0]) * along
        self._line(low, end)
        for mark in marks:
            at = low + (mark - marks[0]) * along
            self._line(at, at + tick)
        self._name(f"{'xyz'[axis]} {marks[-1]} mm", end + 0.6 * marks.step * along)

    def _line(self, one_mm: Array, next_mm: Array) -> None:
        self._scene.line((MM * one_mm).tolist(), (MM * next_mm).tolist()).material(INK)

    def _name(self, words: str, at_mm: Array) -> None:
        self._scene.text(words, f"font-size: 12px; font-weight: 600; color: {INK}").move(*(MM * at_mm).tolist())
