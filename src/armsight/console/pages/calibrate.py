"""Calibrate: guided steps; what to do next, coverage, live standard deviations, accept or drop, verdict, save."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import partial
from pathlib import Path

from nicegui import run, ui
from nicegui.elements.mixins.text_element import TextElement

from armsight.app.guided.step import Hint, Sample
from armsight.app.guided.step_runner import GuidedStepRunner, GuidedStepState
from armsight.console import texts, texts_cell
from armsight.console.layout import (
    TICK_S,
    button,
    card,
    named_canvas,
    notice,
    report_link,
    say,
    set_attribute,
    set_text,
    show_level,
    table,
    text_of,
)
from armsight.console.pages.mirrors import alignment_card, built_card
from armsight.console.plots import Plot
from armsight.console.state import Console, lenses_of, steps_of
from armsight.console.work import jog_card
from armsight.errors import ArmsightError
from armsight.optics import SIDES
from armsight.records import Silent
from armsight.store.cell_file import COMPLEX

CELLS = 9
"""Of a picture's coverage."""
ROW_NAMES = texts.ROW_NAMES | texts_cell.ROWS


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
        if COMPLEX not in console.pictures:
            text_of("a", texts.WHOLE_CELL, href="/cell")
    body = ui.element("div").style("display: contents")
    choose(next((name for name in steps_of(console) if name in OF_PLACES), steps_of(console)[0]))


def step_title(console: Console, name: str) -> str:
    """Return what a step is called in a cell; one camera is neither the left nor the right one."""
    if name in (lenses := lenses_of(console)) and (COMPLEX in console.pictures or name not in texts.STEPS):
        return texts.ONE_CAMERA if len(lenses) == 1 else texts.LENS_OF.format(name=lenses[name])
    return texts.STEPS[name]


def _step(console: Console, name: str) -> None:
    try:
        step = console.step(name)
    except ArmsightError as error:
        notice(str(error))
        return
    if name != "mirrors":
        _Step(console, step, step_title(console, name))
        return
    body = ui.element("div").style("display: contents")

    def begin() -> None:
        """Build what depends on how the mirrors were built."""
        body.clear()
        with body:
            alignment_card(console)
            _Step(console, console.step(name), texts.STEPS[name])

    begin()
    built_card(console, begin)


class _Step:
    """One guided calibration on the page; what several pages do to it, and what a page loaded anew finds, is shown."""

    def __init__(self, console: Console, runner: GuidedStepRunner, title: str) -> None:
        self._console, self._runner = console, runner
        self._shown: GuidedStepState | None = None
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
        with card(texts.SO_FAR_PLOT):
            self._plots = ui.element("div").classes("plots")
        self._verdict = ui.element("div").props("aria-live=polite")
        self._tick()
        ui.timer(TICK_S, self._tick)

    def _pictures(self) -> None:
        self._cells: dict[str, list[TextElement]] = {}
        with ui.element("div").classes("columns" if len(self._console.pictures) <= len(SIDES) else "pictures"):
            for side in self._console.pictures:
                with ui.element("div"):
                    named_canvas(side, self._console.pictures, plain=True)
                    if side in self._runner.state.coverage:
                        with ui.element("div").classes("coverage"):
                            self._cells[side] = [text_of("span", "0") for _ in range(CELLS)]

    async def _on_accept(self) -> None:
        if not self._runner.state.busy:  # pressed twice
            await run.io_bound(self._runner.accept, self._console.require_station)

    async def _on_run(self) -> None:
        if self._runner.state.busy != "run":
            await run.io_bound(self._runner.run, Silent())

    async def _drop(self, index: int, sample: Sample) -> None:
        if sample in self._runner.state.samples[index : index + 1]:  # else it was dropped on another page
            await run.io_bound(self._runner.drop, index)

    def _tick(self) -> None:
        state, before = self._runner.state, self._shown
        if state is before:
            return
        self._shown = state
        for pressed in (self._accept, self._run):
            pressed.props.set_bool("disabled", bool(state.busy))
        say(self._said, texts.RUNNING if state.busy == "run" else state.refused, "bad" if state.refused else "good")
        set_attribute(self._said, "data-count", str(state.count))
        if before is None or state.samples != before.samples:
            self._show(state)
        if before is None or (state.result, state.not_done) != (before.result, before.not_done):
            self._verdict.clear()
            with self._verdict:
                show_verdict(self._console, self._runner.name, state)

    def _show(self, state: GuidedStepState) -> None:
        set_text(self._hint, hint_text(state.hint))
        for side, cells in self._cells.items():
            for i, (cell, n) in enumerate(zip(cells, state.coverage[side], strict=True)):
                set_text(cell, str(n))
                set_attribute(cell, "data-level", "good" if n else "idle")
                cell_name = texts.PLACES[i // 3][i % 3]
                cell.props["aria-label"] = texts.COVERED.format(side=texts.SIDES.get(side, side), place=cell_name, n=n)
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
            rows_table(state.spread)
        self._plots.clear()
        with self._plots:
            _plots(state)


def hint_text(hint: Hint) -> str:
    """Return a hint in words."""
    cell_name = "" if hint.cell is None else texts.PLACES[hint.cell[1]][hint.cell[0]]
    figures = {"place": cell_name, "side": texts.SIDES.get(hint.side, hint.side), "why": hint.why}
    return texts.NEXT[hint.what.value].format(**figures, axis=hint.axis, share=hint.share)


def rows_table(rows: Iterable[tuple[str, str]]) -> None:
    """Put names and values as a table onto the page that is being built."""
    table((), ((ROW_NAMES.get(name, name), value) for name, value in rows))


def _plots(state: GuidedStepState) -> None:
    """Plot residual, standard deviations and coverage against the number of samples."""
    if not state.curves:
        text_of("p", texts.NO_PLOT_YET).classes("hint")
    for i, ((name, unit), points) in enumerate(state.curves.items()):
        words = ROW_NAMES.get(name, name)
        title = f"{words} ({unit})" if unit else words
        Plot(title, (words,), testid=f"chart-{i}", dots=True, first=i).show([points])


def show_verdict(console: Console, name: str, state: GuidedStepState) -> None:
    """Put the verdict of a step onto the page, or why there is none; nothing before it was asked for."""
    done = state.result
    if done is None and not state.not_done:
        return
    with card(texts.VERDICT):
        lamp = text_of("p", testid="verdict").classes("lamp")
        if done is None:
            show_level(lamp, "bad", texts.NOT_CALIBRATED)
            text_of("p", state.not_done)
            return
        verdict = done.verdict
        show_level(lamp, "warn" if verdict.level == "care" else verdict.level, verdict.headline)
        text_of("p", " ".join((*verdict.reasons, *verdict.next)))
        rows_table(done.rows)
        text_of("p", texts.SAVED.format(file=_inside(console, done.file)))
        with ui.element("div").classes("row"):
            if done.report is not None:
                report_link(_inside(console, done.report))
            used = done.use or (((USED_AS[name], done.file),) if name in USED_AS else ())
            if verdict.level != "bad" and used:
                words = texts.USE_LENS if name in LENSES else texts.USE_IT
                button(words, partial(_use, console, used), testid="use")
        for title, lines in done.lists:
            text_of("h3", title)
            with ui.element("ul").classes("lines"):
                for line in lines:
                    text_of("li", line)


OF_PLACES = ("stereo", "cameras", "mirrors")
LENSES = ("camera-left",)
USED_AS = {
    "camera-left": "camera",
    "stereo": "rig",
    "cameras": "rig",
    "mirrors": "rig",
    "tooltip": "tip",
    "handeye": "handeye",
    "arm": "arm",
    "timing": "rig",
}
"""Under which key of the cell a step's file stands."""


def _inside(console: Console, file: Path) -> str:
    return file.relative_to(console.folder).as_posix()


async def _use(console: Console, used: Sequence[tuple[str, Path | None]]) -> None:
    changed = {key: "" if file is None else _inside(console, file) for key, file in used}
    try:
        await run.io_bound(console.apply, console.cell.model_copy(update=changed))
        ui.notify(texts.APPLIED, type="positive")
    except ArmsightError as error:
        ui.notify(str(error), type="negative", multi_line=True)
