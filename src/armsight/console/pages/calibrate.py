"""Calibrate: guided steps; what to do next, coverage, live standard deviations, accept or drop, verdict, save."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path

from nicegui import run, ui
from nicegui.elements.mixins.text_element import TextElement

from armsight.app.guided.charts import figures_of
from armsight.app.guided.step import Guided, Hint, Verdict
from armsight.app.live.measurement import COMPLEX
from armsight.console import texts
from armsight.console.jog import jog_card
from armsight.console.layout import button, canvas_of, card, set_attribute, set_text, text_of
from armsight.console.pages.mirrors import alignment_card, built_card
from armsight.console.plots import Plot
from armsight.console.state import Console, steps_of
from armsight.errors import ArmsightError
from armsight.records import Silent

CELLS = 9
"""Of a picture's coverage."""


def calibrate_page(console: Console) -> None:
    """Build the page."""

    def choose(name: str) -> None:
        body.clear()
        with body:
            _step(console, name)

    if console.robot is not None:
        jog_card(console.robot)
    with card(texts.STEP), ui.element("div").classes("row"):
        for name in steps_of(console):
            title = step_title(console, name)
            button(title, partial(choose, name), kind="act quiet", testid=f"step-{name}")
    body = ui.element("div").style("display: contents")
    choose("stereo" if "stereo" in steps_of(console) else "mirrors")


def step_title(console: Console, name: str) -> str:
    """Return what a step is called in a cell; one camera is neither the left nor the right one."""
    return texts.ONE_CAMERA if console.pictures == (COMPLEX,) and name == "camera-left" else texts.STEPS[name]


def _step(console: Console, name: str) -> None:
    try:
        step = console.step(name)
    except ArmsightError as error:
        text_of("p", str(error)).classes("notice")
        return
    if name != "mirrors":
        _Step(console, step, step_title(console, name))
        return
    alignment_card(console)
    body = ui.element("div").style("display: contents")

    def begin() -> None:
        body.clear()
        with body:
            _Step(console, console.step(name), texts.STEPS[name])

    begin()
    built_card(console, begin)


class _Step:
    """One guided calibration on the page."""

    def __init__(self, console: Console, step: Guided, title: str) -> None:
        self._console, self._guided, self._busy = console, step, False
        self._spread_rows: tuple[tuple[str, str], ...] = ()
        with card(title):
            text_of("h3", texts.WHAT_NEXT)
            self._hint = text_of("p", testid="hint", role="status").style("font-size: 1.3rem; font-weight: 600")
            self._pictures()
            with ui.element("div").classes("row"):
                self._accept = button(texts.ACCEPT, self._on_accept, testid="accept")
                self._run = button(texts.CALIBRATE, self._on_run, kind="act quiet", testid="calibrate")
            self._said = text_of("p", role="alert").classes("hint")
        with ui.element("div").classes("columns"):
            with card(texts.SAMPLES):
                self._samples = ui.element("div").classes("scroll")
            with card(texts.SO_FAR):
                self._spread = ui.element("div").classes("scroll")
        with card(texts.SO_FAR_PLOT):
            self._plots = ui.element("div").classes("plots")
        self._verdict = ui.element("div")
        self._show()
        ui.timer(0.1, self._begin, once=True)

    def _pictures(self) -> None:
        """Both pictures as they are, with the coverage beneath."""
        self._cells: dict[str, list[TextElement]] = {}
        with ui.element("div").classes("columns"):
            for side in self._console.pictures:
                with ui.element("div"):
                    canvas_of(side, plain=True)
                    if side in self._guided.coverage():
                        with ui.element("div").classes("coverage"):
                            self._cells[side] = [text_of("span", "0") for _ in range(CELLS)]

    async def _on_accept(self) -> None:
        def accept() -> None:
            self._guided.accept(self._console.require_station())

        await self._do(accept)

    async def _on_run(self) -> None:
        set_text(self._said, texts.RUNNING)
        verdict: list[Verdict] = []

        def calibrate() -> None:
            verdict.append(self._guided.run(Silent()))

        await self._do(calibrate)
        self._verdict.clear()
        if verdict:
            with self._verdict:
                _show_verdict(self._console, self._guided, verdict[0])

    async def _do(self, act: Callable[[], None]) -> None:
        """Do what may take a second in a thread, one thing at a time; what is refused is told in words."""
        if self._busy:
            return
        self._busy = True
        set_attribute(self._said, "data-level", "good")
        for pressed in (self._accept, self._run):
            pressed.props["disabled"] = "true"
        try:
            await run.io_bound(act)
            await run.io_bound(self._reckon)
            set_text(self._said, "")
        except ArmsightError as error:
            set_text(self._said, str(error))
            set_attribute(self._said, "data-level", "bad")
        finally:
            self._busy = False
            for pressed in (self._accept, self._run):
                pressed.props.pop("disabled", None)
        self._show()

    async def _begin(self) -> None:
        """Show what an earlier visit of the page left."""
        await run.io_bound(self._reckon)
        self._show()

    def _reckon(self) -> None:
        """Work out what may take a second, away from the page."""
        self._spread_rows = self._guided.spread()
        chart = self._console.chart(self._guided.name)
        chart.remember(len(self._guided.samples), figures_of(self._guided))

    async def _drop(self, index: int) -> None:
        await self._do(partial(self._guided.drop, index))

    def _show(self) -> None:
        set_text(self._hint, hint_text(self._guided.hint()))
        for side, cells in self._cells.items():
            for i, (cell, n) in enumerate(zip(cells, self._guided.coverage()[side], strict=True)):
                set_text(cell, str(n))
                set_attribute(cell, "data-level", "good" if n else "idle")
                place = texts.PLACES[i // 3][i % 3]
                cell.props["aria-label"] = texts.COVERED.format(side=texts.SIDES[side], place=place, n=n)
        self._samples.clear()
        with self._samples:
            table = ui.element("table").classes("plain")
            with table:
                for i, sample in enumerate(self._guided.samples):
                    with ui.element("tr"):
                        text_of("td", sample.name)
                        text_of("td", sample.detail)
                        with ui.element("td"):
                            what = f"{texts.DROP} {sample.name}"
                            button(texts.DROP, partial(self._drop, i), kind="act quiet", help_=what)
        self._spread.clear()
        with self._spread, ui.element("table").classes("plain"):
            for name, value in self._spread_rows:
                with ui.element("tr"):
                    text_of("td", texts.ROW_NAMES.get(name, name))
                    text_of("td", value)
        self._show_plots()

    def _show_plots(self) -> None:
        """Plot residual, standard deviations and coverage against the number of samples."""
        curves = self._console.chart(self._guided.name).curves()
        self._plots.clear()
        with self._plots:
            if not curves:
                text_of("p", texts.NO_PLOT_YET).classes("hint")
            for i, ((name, unit), points) in enumerate(curves.items()):
                words = texts.ROW_NAMES.get(name, name)
                title = f"{words} ({unit})" if unit else words
                Plot(title, (words,), testid=f"chart-{i}", dots=True, first=i).show([points])


def hint_text(hint: Hint) -> str:
    """Return a hint in words."""
    place = "" if hint.cell is None else texts.PLACES[hint.cell[1]][hint.cell[0]]
    return texts.NEXT[hint.what.value].format(place=place, side=texts.SIDES.get(hint.side, ""), why=hint.why)


def _show_verdict(console: Console, step: Guided, verdict: Verdict) -> None:
    with card(texts.VERDICT):
        level = "good" if verdict.good else "bad"
        sign = "●" if verdict.good else "■"
        words = texts.GOOD if verdict.good else texts.NOT_GOOD
        lamp = text_of("p", f"{sign} {words}", testid="verdict").classes("lamp")
        lamp.props["data-level"] = level
        text_of("p", verdict.words)
        with ui.element("table").classes("plain"):
            for name, value in verdict.rows:
                with ui.element("tr"):
                    text_of("td", texts.ROW_NAMES.get(name, name))
                    text_of("td", value)
        text_of("p", texts.SAVED.format(file=verdict.file.name))
        with ui.element("div").classes("row"):
            if verdict.report is not None:
                text_of("a", texts.REPORT, href=f"/console/files/{verdict.report.name}", target="_blank")
            if verdict.good and step.name in USED_AS:
                words = texts.USE_LENS if step.name in LENSES else texts.USE_IT
                button(words, partial(_use, console, step, verdict.file), testid="use")


LENSES = ("camera-left",)
USED_AS = {
    "camera-left": "camera",
    "stereo": "rig",
    "mirrors": "rig",
    "tooltip": "tip",
    "handeye": "handeye",
    "arm": "arm",
    "timing": "rig",
}
"""Under which key of the cell a step's file stands."""


def _use(console: Console, step: Guided, file: Path) -> None:
    try:
        console.apply(console.cell.model_copy(update={USED_AS[step.name]: file.name}))
        ui.notify(texts.APPLIED, type="positive")
    except ArmsightError as error:
        ui.notify(str(error), type="negative", multi_line=True)
