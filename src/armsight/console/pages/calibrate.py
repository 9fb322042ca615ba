"""Calibrate: guided steps; what to do next, coverage, live standard deviations, accept or drop, verdict, save."""

from __future__ import annotations

from collections.abc import Iterable
from functools import partial
from pathlib import Path

from nicegui import run, ui
from nicegui.elements.mixins.text_element import TextElement

from armsight.app.guided.desk import DeskState, StepDesk
from armsight.app.guided.step import Hint, Sample
from armsight.console import texts
from armsight.console.jog import jog_card
from armsight.console.layout import SIGNS, TICK_S, button, card, set_attribute, set_text, text_of
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
    """One guided calibration on the page; what several pages do to it, and what a page loaded anew finds, is shown."""

    def __init__(self, console: Console, desk: StepDesk, title: str) -> None:
        self._console, self._desk = console, desk
        self._shown: DeskState | None = None
        with card(title):
            text_of("h3", texts.WHAT_NEXT)
            self._hint = text_of("p", testid="hint", role="status").style("font-size: 1.3rem; font-weight: 600")
            self._pictures()
            with ui.element("div").classes("row"):
                self._accept = button(texts.ACCEPT, self._on_accept, testid="accept")
                self._run = button(texts.CALIBRATE, self._on_run, kind="act quiet", testid="calibrate")
            self._said = text_of("p", role="alert", testid="step-said").classes("hint")
        with ui.element("div").classes("columns"):
            with card(texts.SAMPLES):
                self._samples = ui.element("div").classes("scroll")
            with card(texts.SO_FAR):
                self._spread = ui.element("div").classes("scroll")
        self._verdict = ui.element("div").props("aria-live=polite")
        self._tick()
        ui.timer(TICK_S, self._tick)

    def _pictures(self) -> None:
        """Both pictures as they are, with the coverage beneath."""
        self._cells: dict[str, list[TextElement]] = {}
        with ui.element("div").classes("columns"):
            for side in ("left", "right"):
                with ui.element("div"):
                    canvas = ui.element("canvas")
                    name = {"left": texts.LEFT, "right": texts.RIGHT}[side]
                    canvas.props.update({"data-side": side, "data-plain": "true", "role": "img", "aria-label": name})
                    canvas.props["width"], canvas.props["height"] = 1280, 720
                    if side in self._desk.state.coverage:
                        with ui.element("div").classes("coverage"):
                            self._cells[side] = [text_of("span", "0") for _ in range(CELLS)]

    async def _on_accept(self) -> None:
        if not self._desk.state.busy:  # pressed twice
            await run.io_bound(self._desk.accept, self._console.require_station)

    async def _on_run(self) -> None:
        if self._desk.state.busy != "run":
            await run.io_bound(self._desk.run, Silent())

    async def _drop(self, index: int, sample: Sample) -> None:
        if sample in self._desk.state.samples[index : index + 1]:  # else it was dropped on another page
            await run.io_bound(self._desk.drop, index)

    def _tick(self) -> None:
        state, before = self._desk.state, self._shown
        if state is before:
            return
        self._shown = state
        for pressed in (self._accept, self._run):
            pressed.props.set_bool("disabled", bool(state.busy))
        set_text(self._said, texts.RUNNING if state.busy == "run" else state.refused)
        set_attribute(self._said, "data-level", "bad" if state.refused else "good")
        set_attribute(self._said, "data-count", str(state.count))
        if before is None or state.samples != before.samples:
            self._show(state)
        if before is None or (state.verdict, state.not_done) != (before.verdict, before.not_done):
            self._verdict.clear()
            with self._verdict:
                _show_verdict(self._console, self._desk.name, state)

    def _show(self, state: DeskState) -> None:
        set_text(self._hint, hint_text(state.hint))
        for side, cells in self._cells.items():
            for i, (cell, n) in enumerate(zip(cells, state.coverage[side], strict=True)):
                set_text(cell, str(n))
                set_attribute(cell, "data-level", "good" if n else "idle")
                place = texts.PLACES[i // 3][i % 3]
                cell.props["aria-label"] = texts.COVERED.format(side=texts.SIDES[side], place=place, n=n)
        self._samples.clear()
        with self._samples, ui.element("table").classes("plain"):
            for i, sample in enumerate(state.samples):
                with ui.element("tr"):
                    text_of("td", sample.name)
                    text_of("td", sample.detail)
                    with ui.element("td"):
                        what = f"{texts.DROP} {sample.name}"
                        button(texts.DROP, partial(self._drop, i, sample), kind="act quiet", help_=what)
        self._spread.clear()
        with self._spread:
            _table(state.spread)


def hint_text(hint: Hint) -> str:
    """Return a hint in words."""
    place = "" if hint.cell is None else texts.PLACES[hint.cell[1]][hint.cell[0]]
    figures = {"place": place, "side": texts.SIDES.get(hint.side, ""), "why": hint.why}
    return texts.NEXT[hint.what.value].format(**figures, axis=hint.axis, share=hint.share)


def _table(rows: Iterable[tuple[str, str]]) -> None:
    with ui.element("table").classes("plain"):
        for name, value in rows:
            with ui.element("tr"):
                text_of("td", name)
                text_of("td", value)


def _show_verdict(console: Console, name: str, state: DeskState) -> None:
    verdict = state.verdict
    if verdict is None and not state.not_done:
        return
    with card(texts.VERDICT):
        if verdict is None:
            _lamp("bad", texts.NOT_CALIBRATED)
            text_of("p", state.not_done)
            return
        _lamp("good" if verdict.good else "bad", texts.GOOD if verdict.good else texts.NOT_GOOD)
        text_of("p", verdict.words)
        _table(verdict.rows)
        text_of("p", texts.SAVED.format(file=verdict.file.name))
        with ui.element("div").classes("row"):
            if verdict.report is not None:
                text_of("a", texts.REPORT, href=f"/console/files/{verdict.report.name}", target="_blank")
            if verdict.good and name in USED_AS:
                button(texts.USE_IT, partial(_use, console, name, verdict.file), testid="use")


def _lamp(level: str, words: str) -> None:
    lamp = text_of("p", f"{SIGNS[level]} {words}", testid="verdict").classes("lamp")
    lamp.props["data-level"] = level


USED_AS = {"stereo": "rig", "tooltip": "tip", "handeye": "handeye", "arm": "arm", "timing": "rig"}
"""Under which key of the cell a step's file stands."""


async def _use(console: Console, name: str, file: Path) -> None:
    try:
        await run.io_bound(console.apply, console.cell.model_copy(update={USED_AS[name]: file.name}))
        ui.notify(texts.APPLIED, type="positive")
    except ArmsightError as error:
        ui.notify(str(error), type="negative", multi_line=True)
