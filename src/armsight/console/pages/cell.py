"""Cell: one recording of the moving arm calibrates all of it, in three steps: mount, move, result."""

from __future__ import annotations

from pathlib import Path

from nicegui import run, ui
from nicegui.elements.mixins.text_element import TextElement

from armsight.app.guided.cell import CellStep
from armsight.app.guided.step import Next
from armsight.app.guided.step_runner import GuidedStepRunner, GuidedStepState
from armsight.console import texts as shared
from armsight.console import texts_cell as texts
from armsight.console.cell_mount import Lamp, mount_lamps
from armsight.console.layout import (
    SIGNS,
    button,
    file_name,
    named_canvas,
    notice,
    say,
    set_attribute,
    set_text,
    text_of,
    uploader,
)
from armsight.console.pages.calibrate import CELLS, hint_text, rows_table, show_verdict
from armsight.console.state import CELL, Console
from armsight.console.work import jog_card
from armsight.errors import ArmsightError
from armsight.store.cell_file import COMPLEX, cell_path

TICK_S = 0.3
"""Time between two updates: a person who moves an arm looks up now and then."""
GAP_S = 0.2
"""Readings further apart than this are told: between them pictures are not held against the joints."""
LOGS = 4
"""Names of tables that are told as possible logs."""
MOUNT, MOVE, RESULT = range(3)


def cell_page(console: Console) -> None:
    """Build the page."""
    text_of("p", texts.INTRO)
    if COMPLEX in console.pictures or console.cell.on_robot:
        notice(texts.NOT_THIS_CELL)
        return
    runner = console.step(CELL)
    if isinstance(runner.step, CellStep):
        _CellPage(console, runner, runner.step)


class _CellPage:
    """The three steps; what several pages do, and what a page loaded anew finds, is shown."""

    def __init__(self, console: Console, runner: GuidedStepRunner, step: CellStep) -> None:
        self._console, self._runner, self._step = console, runner, step
        self._shown: GuidedStepState | None = None
        self._refused = ""
        with ui.element("ol").classes("steps") as steps:
            steps.props["aria-label"] = texts.STEPS_NAME
            self._places = [self._place(n, title) for n, title in enumerate(texts.STEPS, start=1)]
        self._cards = []
        for n, (title, build) in enumerate(zip(texts.STEPS, (self._mount, self._move, self._result), strict=True), 1):
            with ui.element("section").classes("card step") as made:
                text_of("h2", texts.STEP.format(n=n, title=title), id=f"step-{n}")
                build()
            self._cards.append(made)
            if n - 1 == MOVE and console.robot is not None:
                jog_card(console.robot)
        self._tick()
        ui.timer(TICK_S, self._tick)

    @staticmethod
    def _place(n: int, title: str) -> TextElement:
        with ui.element("li"):
            return text_of("a", texts.STEP.format(n=n, title=title), href=f"#step-{n}", testid=f"place-{n}")

    def _mount(self) -> None:
        with ui.element("div").classes("columns"):
            with ui.element("div"):
                text_of("h3", texts.TOLD)
                with ui.element("ul").classes("lamps"):
                    self._lamps = {key: self._lamp(key) for key in texts.LAMPS}
            with ui.element("div"):
                text_of("h3", texts.CHECK)
                with ui.element("ul").classes("lines"):
                    for line in texts.CHECKS:
                        text_of("li", line)

    @staticmethod
    def _lamp(key: str) -> tuple[TextElement, TextElement]:
        with ui.element("li"):
            return text_of("p", testid=f"lamp-{key}").classes("lamp"), text_of("p").classes("hint")

    def _move(self) -> None:
        text_of("p", texts.MOVE_HELP)
        text_of("h3", shared.WHAT_NEXT)
        self._hint = text_of("p", testid="hint", role="status").classes("todo")
        with ui.element("div").classes("row"):
            self._record = button(texts.RECORD, self._on_record, testid="record-cell")
            self._end = button(texts.END, self._on_end, kind="act quiet", testid="end-cell")
            self._time = text_of("span", testid="recorded").classes("lamp")
        self._said = text_of("p", role="alert", testid="step-said").classes("hint")
        self._cells: dict[str, list[TextElement]] = {}
        with ui.element("div").classes("columns"):
            for side in self._step.sides:
                with ui.element("div"):
                    named_canvas(side, self._step.sides)
                    with ui.element("div").classes("coverage") as grid:
                        name = texts.COVERAGE.format(side=shared.SIDES.get(side, side))
                        grid.props.update({"role": "group", "aria-label": name})
                        self._cells[side] = [text_of("span", "0") for _ in range(CELLS)]
        with ui.element("div").classes("columns"):
            with ui.element("div"):
                text_of("h3", texts.PROGRESS)
                self._spread = ui.element("div").classes("scroll")
            with ui.element("div"):
                self._planned()
        text_of("h3", texts.RECORDED)
        self._samples = ui.element("div").classes("scroll")

    def _planned(self) -> None:
        """How a planned motion is run; a robot that is connected here is not another program's to move."""
        text_of("h3", texts.PLANNED)
        if self._console.robot is not None:
            text_of("p", texts.RUN_HERE)
            return
        folder, cell = self._console.folder, self._console.cell
        text_of("p", texts.PLANNED_HELP)
        names = {
            "folder": folder,
            "arm": folder / (cell.arm or "arm.yaml"),
            "target": folder / (cell.target or "target.yaml"),
            "limits": f" --limits {folder / cell.limits}" if cell.limits else "",
        }
        for command in (texts.PLAN_COMMAND, texts.RUN_COMMAND):
            with ui.element("pre").classes("command"):
                text_of("code", command.format(**names))
        text_of("p", texts.RUN_LOG)

    def _result(self) -> None:
        self._log = None
        if self._console.robot is None:
            text_of("p", texts.LOG_HELP)
            uploader()
            kept = self._step.log
            name = "" if kept is None else kept.relative_to(self._console.folder).as_posix()
            self._log = ui.input(texts.LOG, value=name).classes("w-full")
            self._log.props["data-testid"] = "log"
            self._logs = text_of("p", testid="logs").classes("hint")
        with ui.element("div").classes("row"):
            self._run = button(texts.CALIBRATE, self._on_run, testid="calibrate")
            self._cancel = button(texts.CANCEL, lambda: self._runner.progress.cancel(), kind="act quiet")
        self._working = text_of("p", role="status", testid="working").classes("hint")
        text_of("p", texts.KEPT).classes("hint")
        self._verdict = ui.element("div").props("aria-live=polite")

    async def _on_record(self) -> None:
        step, console = self._step, self._console
        self._refused = ""
        await run.io_bound(self._runner.do, "record", lambda: step.begin(console.require_station()))

    async def _on_end(self) -> None:
        await run.io_bound(self._runner.do, "end", self._step.end)

    async def _on_drop(self) -> None:
        if self._runner.state.samples:  # else it was dropped on another page
            await run.io_bound(self._runner.drop, 0)

    async def _on_run(self) -> None:
        self._refused = ""
        try:
            if self._log is not None and (name := file_name(self._log)):
                self._step.log = cell_path(self._console.folder, name, texts.LOG_OF)
        except ArmsightError as error:
            self._refused = str(error)
            return
        await run.io_bound(self._runner.run_told)

    def _tick(self) -> None:
        self._runner.look()
        state, before = self._runner.state, self._shown
        lamps = mount_lamps(self._console)
        self._show_lamps(lamps)
        self._show_place(place_of(state, lamps, self._step))
        self._show_work(state)
        if self._log is not None:
            there = ", ".join(_logs_in(self._console.folder))
            set_text(self._logs, texts.LOGS.format(names=there) if there else "")
        if state is before:
            return
        self._shown = state
        self._show_progress(state)
        if before is None or state.samples != before.samples:
            self._show_samples(state)
        if before is None or (state.result, state.not_done) != (before.result, before.not_done):
            self._verdict.clear()
            with self._verdict:
                show_verdict(self._console, CELL, state)
                if state.result is not None and state.result.verdict.level == "good":
                    text_of("p", texts.USE_HELP).classes("hint")

    def _show_lamps(self, lamps: tuple[Lamp, ...]) -> None:
        for lamp in lamps:
            light, words = self._lamps[lamp.key]
            named = {"sign": SIGNS[lamp.level], "name": texts.LAMPS[lamp.key], "level": texts.LEVELS[lamp.level]}
            say(light, texts.LAMP.format(**named), lamp.level)
            set_text(words, lamp.words)

    def _show_place(self, here: int) -> None:
        for n, (place, made) in enumerate(zip(self._places, self._cards, strict=True)):
            name = {"n": n + 1, "title": texts.STEPS[n]}
            set_text(place, (texts.NOW if n == here else texts.STEP).format(**name))
            set_attribute(place, "aria-current", "step" if n == here else "false")
            set_attribute(made, "data-current", "true" if n == here else "false")

    def _show_work(self, state: GuidedStepState) -> None:
        recording, busy = self._step.recording, bool(state.busy)
        self._record.props.set_bool("disabled", recording or busy)
        self._end.props.set_bool("disabled", not recording or busy)
        self._run.props.set_bool("disabled", recording or busy)
        self._cancel.set_visibility(state.busy == "run")
        say(self._time, texts.RECORDING.format(seconds=self._step.watch.seconds) if recording else "")
        say(self._said, state.refused or self._doubts(), "bad" if state.refused else "warn")
        set_attribute(self._said, "data-count", str(state.count))
        done, total, note = self._runner.progress.newest
        working = shared.RUNNING
        if total:
            working = texts.WORKING.format(note=note, done=done, total=total)
        running = state.busy == "run"
        say(self._working, working if running else self._refused, "good" if running else "bad")

    def _doubts(self) -> str:
        """Return what is wrong with what was recorded so far, empty where nothing is."""
        recorder = self._step.recorder
        if recorder is None:
            return ""
        if recorder.running and recorder.silent:
            return texts.JOINTS_SILENT.format(why=recorder.silent)
        doubts = [texts.JOINTS_GAP.format(gap=recorder.watch.gap_s)] if recorder.watch.gap_s > GAP_S else []
        doubts += [texts.DROPPED.format(n=recorder.dropped)] if recorder.dropped else []
        return " ".join(doubts)

    def _show_progress(self, state: GuidedStepState) -> None:
        set_text(self._hint, hint_text(state.hint))
        for side, cells in self._cells.items():
            for i, (cell, n) in enumerate(zip(cells, state.coverage[side], strict=True)):
                set_text(cell, str(n))
                set_attribute(cell, "data-level", "good" if n else "idle")
                place = shared.PLACES[i // 3][i % 3]
                set_attribute(
                    cell, "aria-label", texts.COVERED.format(side=shared.SIDES.get(side, side), place=place, n=n)
                )
        self._spread.clear()
        with self._spread:
            rows_table(state.spread)

    def _show_samples(self, state: GuidedStepState) -> None:
        self._samples.clear()
        with self._samples:
            if not state.samples:
                text_of("p", texts.NOTHING_RECORDED).classes("hint")
            for sample in state.samples:
                with ui.element("div").classes("row"):
                    text_of("span", f"{sample.name}: {sample.detail}", testid="sample")
                    what = f"{shared.DROP} {sample.name}"
                    button(shared.DROP, self._on_drop, kind="act quiet", help_=what, testid="drop")


def _logs_in(folder: Path) -> list[str]:
    """Return the newest tables of a cell that may be logs, by their names in it."""
    found = [path for pattern in ("*.csv", "*/joints.csv") for path in folder.glob(pattern) if path.is_file()]
    found.sort(key=lambda path: path.stat().st_mtime, reverse=True)
    return [path.relative_to(folder).as_posix() for path in found[:LOGS]]


def place_of(state: GuidedStepState, lamps: tuple[Lamp, ...], step: CellStep) -> int:
    """Return which of the three steps a person is at."""
    if state.busy == "run" or state.result is not None or state.not_done:
        return RESULT
    if step.recording or state.samples:
        return RESULT if state.samples and state.hint.what in (Next.RUN, Next.BRING_LOG) else MOVE
    ready = all(lamp.level != "bad" and (lamp.key != "cameras" or lamp.level != "idle") for lamp in lamps)
    return MOVE if ready else MOUNT
