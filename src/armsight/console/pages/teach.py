"""Teach and play: record a path, change it in the table and on the 3-D view, check it for the arm, play it."""

from __future__ import annotations

from functools import partial
from typing import Any

from nicegui import run, ui

from armsight.app.operator import path_editor as path_desk
from armsight.app.operator.job_runner import BackgroundJob
from armsight.app.operator.path_editor import JOB_NAME, TOOLS, PathEditor, PlayRequest
from armsight.app.operator.teach_controller import TeachController
from armsight.console import texts
from armsight.console.layout import (
    TICK_S,
    button,
    card,
    notice,
    number,
    number_field,
    refusals_in,
    report_link,
    say,
    set_text,
    text,
    text_of,
    ticked,
)
from armsight.console.routes import page_name
from armsight.console.scene import Scene
from armsight.console.state import Console
from armsight.console.work import Working, jog_card
from armsight.defaults import SMOOTHING_M
from armsight.errors import ArmsightError
from armsight.ops.path.check import PathCheckOutput
from armsight.ops.play.play_path import PlayOutput
from armsight.records import TaughtPath
from armsight.units import MM

SLOW_S = 0.5
"""Time between two drawings of the tracks."""
FIGURE = 2.0
"""Of a tool for paths, mm or deg, where the command has no default of its own."""
FIGURES = {"smooth": SMOOTHING_M / MM}
LISTED = 100
"""Rows of a path that a page lists."""


def teach_page(console: Console) -> None:
    """Build the page."""
    try:
        robot = console.require_robot()
        console.require_station()
        recorder, editor = console.teaching(), console.path_editor()
    except ArmsightError as error:
        notice(str(error))
        return
    said = text_of("p", role="alert", testid="told").classes("hint")
    with ui.element("div").classes("columns"):
        with ui.element("div").classes("stack"):
            above = ui.element("div")
            path = _Path(console, editor, said)
            with above:
                _Recording(recorder, editor, path, said)
        with card(texts.PATHS_SCENE):
            path.scene = _scene(console, path)
            if path.scene is not None:
                _look(path.scene)
    _Play(console, editor)
    path.show()
    jog_card(robot)


def _scene(console: Console, path: _Path) -> Scene | None:
    try:
        made = Scene(console, picked=path.pick)
    except ArmsightError as error:
        notice(str(error))
        return None

    def tick() -> None:
        shown = console.remember()
        made.show(shown.view if shown is not None and console.current else None)

    ui.timer(TICK_S, tick)
    ui.timer(SLOW_S, made.show_track)
    return made


def _look(scene: Scene) -> None:
    with ui.element("ul").classes("legend").props("data-testid=scene-legend"):
        for name, words in texts.PATHS_LEGEND.items():
            text_of("li", words, data_curve=name)
    with ui.element("div").classes("row"):
        button(texts.LOOK_AT_PATHS, lambda: look_near(), kind="act quiet", testid="look-paths")
        button(texts.LOOK_AT_CELL, scene.look_at_cell, kind="act quiet", testid="look-cell")
    text_of("p", texts.SCENE_HELP).classes("hint")
    said = text_of("p", role="status").classes("hint")

    def look_near() -> None:
        set_text(said, "" if scene.look_at_paths() else texts.NO_PATHS)


class _Recording:
    def __init__(self, recorder: TeachController, editor: PathEditor, path: _Path, said: Any) -> None:
        self._recorder, self._editor, self._path, self._said = recorder, editor, path, said
        with card(texts.TEACH):
            text_of("p", texts.TEACH_HELP).classes("hint")
            with ui.element("div").classes("row"):
                self._record = button(texts.TEACH_RECORD, self._toggle, testid="record")
                button(texts.TEACH_POINT, recorder.point, kind="act quiet", testid="point")
                button(texts.TEACH_UNDO, recorder.recorder.undo, kind="act quiet", testid="undo")
                button(texts.TEACH_SAVE, self._save, kind="act quiet", testid="save")
            with ui.element("div").classes("row"):
                self._tag = ui.input(texts.TEACH_TAG)
                button(texts.TEACH_MARK, self._mark, kind="act quiet")
            self._state = text_of("p", role="status", testid="taught").classes("hint")
        ui.timer(TICK_S, self._tick)

    def _toggle(self) -> None:
        (self._recorder.pause if self._recorder.recording else self._recorder.start)()

    def _mark(self) -> None:
        with refusals_in(self._said):
            self._recorder.recorder.tag(text(self._tag))

    def _save(self) -> None:
        with refusals_in(self._said):
            self._editor.load(self._recorder.save())
            say(self._said, "")
        self._path.show()

    def _tick(self) -> None:
        path, recording = self._recorder.recorder, self._recorder.recording
        words = texts.TEACH_STATE.format(n=len(path), stretches=path.stretches, lost=self._recorder.lost)
        set_text(self._state, (texts.TEACH_RECORDING if recording else "") + words)
        set_text(self._record, texts.TEACH_PAUSE if recording else texts.TEACH_RECORD)


class _Path:
    """The path in a table and in the scene; positions are chosen in both."""

    scene: Scene | None = None

    def __init__(self, console: Console, editor: PathEditor, said: Any) -> None:
        self._console, self._editor, self._said = console, editor, said
        self._chosen: set[int] = set()
        with card(texts.PATH):
            self._words = text_of("p", testid="path")
            self._table = ui.element("div").classes("scroll tall")
            with ui.element("div").classes("row"):
                button(texts.PATH_DELETE, self._delete, kind="act quiet", testid="delete")
                button(texts.PATH_BACK, self._undo, kind="act quiet", testid="path-undo")
            with ui.element("div").classes("row"):
                names = {name: texts.PATH_TOOLS[name] for name in TOOLS}
                self._tool = ui.select(names, value="resample", label=texts.PATH_TOOL).style("min-width: 14rem")
                self._figure = figure = ui.number(texts.PATH_FIGURE, value=FIGURE)
                self._tool.on_value_change(lambda event: figure.set_value(FIGURES.get(event.value, FIGURE)))
                button(texts.PATH_USE, self._change, kind="act quiet", testid="change")

    def pick(self, row: int) -> None:
        """Choose a position, or choose it no more; a row that the path has not is none."""
        if self._editor.path is None or row >= len(self._editor.path):
            return
        self._chosen ^= {row}
        self.show()

    def show(self) -> None:
        """Show the path as it stands."""
        path = self._editor.path
        self._table.clear()
        set_text(self._words, texts.NO_PATH if path is None else format_path(path))
        if path is None:
            return
        with self._table:
            self._rows(path)
        if self.scene is not None:
            self.scene.show_path(path.xyz_m, self._chosen)

    def _rows(self, path: TaughtPath) -> None:
        with ui.element("table").classes("plain"):
            with ui.element("tr"):
                for head in texts.PATH_HEAD:
                    text_of("th", head)
            for row, (xyz_m, speed, tag) in enumerate(
                zip(path.xyz_m[:LISTED], path.speed_m_s, path.tags, strict=False)
            ):
                with ui.element("tr"):
                    with ui.element("td"):
                        box = ui.element("input").on("change", partial(self.pick, row))
                        box.props.update({"type": "checkbox", "aria-label": texts.PATH_PICK.format(n=row + 1)})
                        if row in self._chosen:
                            box.props["checked"] = "true"
                    text_of("td", str(row + 1))
                    for value in (*(xyz_m / MM), speed / MM):
                        text_of("td", f"{value:.1f}" if value == value else texts.NO_VALUE)
                    text_of("td", tag)
        if len(path) > LISTED:
            text_of("p", texts.PATH_MORE.format(n=len(path) - LISTED)).classes("hint")

    def _delete(self) -> None:
        if self._chosen:
            self._do(partial(self._editor.delete, sorted(self._chosen)))

    def _undo(self) -> None:
        self._do(self._editor.undo)

    def _change(self) -> None:
        tool = str(self._tool.value)
        self._do(lambda: self._editor.change(tool, number(self._figure) if TOOLS.get(tool) else 0.0))

    def _do(self, act: Any) -> None:
        with refusals_in(self._said):
            act()
            self._chosen.clear()
            say(self._said, "")
        self.show()


def format_path(path: TaughtPath) -> str:
    """Return how many rows a path has, and how long it is."""
    return texts.PATH_TOLD.format(n=len(path), length=float(path.length_m[-1]) / MM)


class _Play:
    """Check and play; what runs is found again by a page loaded anew."""

    def __init__(self, console: Console, editor: PathEditor) -> None:
        self._console, self._editor = console, editor
        self._robot = console.require_robot()
        self._browser = page_name()
        with card(texts.PLAY_CARD):
            with ui.element("div").classes("row"):
                self._speed = number_field(texts.PLAY_SPEED, PlayRequest, "speed_m_s", MM)
                self._keep = ui.checkbox(texts.PLAY_KEEP, value=PlayRequest.keep_rotation)
            with ui.element("div").classes("row"):
                button(texts.PATH_CHECK, self._check, kind="act quiet", testid="check")
                button(texts.PLAY, self._play, testid="play")
                self._pause = button(texts.PAUSE, self._toggle, kind="act quiet", testid="pause")
            self._said = text_of("p", role="status", testid="verdict").classes("hint")
            self._issues = ui.element("div")
            self._at = text_of("p", testid="play-at").style("font-size: 1.3rem; font-weight: 700")
            Working(self._robot.jobs, JOB_NAME, self._ended)
        ui.timer(TICK_S, self._tick)

    def _asked(self) -> PlayRequest:
        return PlayRequest(
            folder=self._console.folder,
            cell=self._console.cell,
            speed_m_s=number(self._speed) * MM,
            keep_rotation=ticked(self._keep),
        )

    async def _check(self) -> None:
        self._issues.clear()
        with refusals_in(self._said):
            self._editor.require()
            found = await run.io_bound(partial(path_desk.check_path, self._asked(), self._robot, self._editor))
            if found is not None:  # None: the server is ending
                self._show_check(found)

    def _show_check(self, found: PathCheckOutput) -> None:
        if found.ok:
            figures = {"n": found.n, "length": found.length_m / MM, "time": found.play_s}
            say(self._said, texts.PATH_OK.format(**figures))
        else:
            say(self._said, texts.PATH_NOT_OK.format(why=found.refused), "bad")
        with self._issues:
            for issue in found.issues[:5]:
                text_of("p", issue.text)
            report_link("path-check.html")

    def _play(self) -> None:
        with refusals_in(self._said):
            act = partial(path_desk.play_path, self._asked(), self._robot, self._editor, self._console.station)
            self._robot.jobs.begin(JOB_NAME, self._browser, act)
            say(self._said, "")

    def _toggle(self) -> None:
        source = self._editor.source
        if source is not None:
            (source.resume if source.progress.paused else source.pause)()

    def _tick(self) -> None:
        source = self._editor.source
        if source is None:
            set_text(self._at, "")
            return
        at = source.progress
        set_text(self._pause, texts.RESUME if at.paused else texts.PAUSE)
        stage = texts.PLAY_STAGES[at.stage]
        figures = {"s": at.s_m / MM, "length": at.length_m / MM, "speed": at.speed_m_s / MM}
        set_text(self._at, texts.PLAY_AT.format(stage=stage, **figures))

    def _ended(self, job: BackgroundJob) -> None:
        done: PlayOutput = job.result
        why = texts.PLAY_END if done.finished else done.stopped_by
        words = texts.PLAY_DONE.format(share=done.share, length=done.length_m / MM, time=done.took_s, why=why)
        kept = texts.PLAY_KEPT.format(folder=done.recording)
        say(self._said, f"{words} {_watched(done)} {kept}", "good" if done.finished else "bad")


def _watched(done: PlayOutput) -> str:
    seen = done.measured
    if seen is None or seen.rms_m is None or seen.max_m is None:
        return texts.PLAY_UNSEEN
    return texts.PLAY_SEEN.format(n=seen.n, rms=seen.rms_m / MM, largest=seen.max_m / MM)
