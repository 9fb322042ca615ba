"""Calibrate: guided steps; what to do next, coverage, live standard deviations, accept or drop, verdict, save."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path

from nicegui import run, ui
from nicegui.elements.mixins.text_element import TextElement

from armsight.app.guided.step import Guided, Hint, Verdict
from armsight.console import texts
from armsight.console.jog import jog_card
from armsight.console.layout import button, canvas_of, card, set_attribute, set_text, text_of
from armsight.console.state import STEPS, Console
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
        for name in STEPS:
            button(texts.STEPS[name], partial(choose, name), kind="act quiet", testid=f"step-{name}")
    body = ui.element("div").style("display: contents")
    choose("stereo")


def _step(console: Console, name: str) -> None:
    try:
        step = console.step(name)
    except ArmsightError as error:
        text_of("p", str(error)).classes("notice")
        return
    _Step(console, step, texts.STEPS[name])


class _Step:
    """One guided calibration on the page."""

    def __init__(self, console: Console, step: Guided, title: str) -> None:
        self._console, self._guided, self._busy = console, step, False
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
        self._verdict = ui.element("div")
        self._show()

    def _pictures(self) -> None:
        """Both pictures as they are, with the coverage beneath."""
        self._cells: dict[str, list[TextElement]] = {}
        with ui.element("div").classes("columns"):
            for side in ("left", "right"):
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
            set_text(self._said, "")
        except ArmsightError as error:
            set_text(self._said, str(error))
            set_attribute(self._said, "data-level", "bad")
        finally:
            self._busy = False
            for pressed in (self._accept, self._run):
                pressed.props.pop("disabled", None)
        self._show()

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
            for name, value in self._guided.spread():
                with ui.element("tr"):
                    text_of("td", name)
                    text_of("td", value)


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
                    text_of("td", name)
                    text_of("td", value)
        text_of("p", texts.SAVED.format(file=verdict.file.name))
        with ui.element("div").classes("row"):
            if verdict.report is not None:
                text_of("a", texts.REPORT, href=f"/console/files/{verdict.report.name}", target="_blank")
            if verdict.good and step.name in USED_AS:
                button(texts.USE_IT, partial(_use, console, step, verdict.file), testid="use")


USED_AS = {"stereo": "rig", "tooltip": "tip", "handeye": "handeye", "arm": "arm", "timing": "rig"}
"""Under which key of the cell a step's file stands."""


def _use(console: Console, step: Guided, file: Path) -> None:
    try:
        console.apply(console.cell.model_copy(update={USED_AS[step.name]: file.name}))
        ui.notify(texts.APPLIED, type="positive")
    except ArmsightError as error:
        ui.notify(str(error), type="negative", multi_line=True)
