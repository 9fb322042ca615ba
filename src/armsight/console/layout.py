"""The frame of every page and the parts that several have: fields, progress of a job, keys that jog the robot."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from nicegui import ui
from nicegui.element import Element
from nicegui.elements.mixins.text_element import TextElement

from armsight.app.operator.job_runner import BackgroundJob, JobRunner
from armsight.app.operator.robot_cell import RobotCell
from armsight.console import texts
from armsight.console.routes import LARGEST_BYTES, logged_in, page_name
from armsight.console.state import Console
from armsight.errors import ArmsightError, UsageError
from armsight.fields import DIGITS, Bounds, bounds_of, known_hints
from armsight.units import DEG, MM

STATIC = "/console/static"
TICK_S = 0.1
"""Time between two updates of a page's figures."""
SIGNS = {"good": "●", "warn": "▲", "bad": "■", "idle": "○"}


@dataclass(frozen=True, slots=True)
class Level:
    """A state as a person reads it: level (good, warn, bad, idle) and words."""

    level: str
    words: str


def text_of(name: str, text: str = "", *, testid: str = "", **attributes: str) -> TextElement:
    """Return an element that holds nothing but a text, which can be set."""
    label = TextElement(tag=name, text=text)
    for key, value in attributes.items():
        label.props[key.rstrip("_").replace("_", "-")] = value
    if testid:
        label.props["data-testid"] = testid
    return label


def button(
    text: str, act: Callable[[], object], *, kind: str = "act", testid: str = "", help_: str = ""
) -> TextElement:
    """Return a button of plain HTML."""
    made = text_of("button", text, testid=testid, type="button").classes(kind)
    if help_:
        made.props["aria-label"] = help_
    made.on("click", lambda: act())
    return made


def canvas_of(side: str, *, testid: str = "", plain: bool = False) -> Element:
    """Return a camera's picture, which the browser's script draws; plain: without what nobody named."""
    canvas = ui.element("canvas")
    canvas.props.update({"data-side": side, "role": "img", "aria-label": texts.PICTURES[side]})
    canvas.props.update({f"data-mark-{view}": mark for view, mark in texts.VIEW_MARKS.items()})
    canvas.props["width"], canvas.props["height"] = 1280, 720
    if testid:
        canvas.props["data-testid"] = testid
    if plain:
        canvas.props["data-plain"] = "true"
    return canvas


@contextmanager
def card(title: str) -> Iterator[None]:
    """Put what follows into a titled card."""
    with ui.element("section").classes("card"):
        text_of("h2", title)
        yield


def level_of(console: Console) -> Level:
    """Return what the measuring does just now, in words."""
    station = console.station
    if station is None:
        refused = Level("bad", f"{texts.FAILED}: {console.refusal}")
        return refused if console.refusal else Level("idle", texts.NO_CAMERAS)
    if station.failure:
        return Level("bad", f"{texts.FAILED}: {station.failure}")
    if station.shown is None:
        return Level("idle", texts.STARTING)
    if station.ended:
        return Level("idle", texts.ENDED)
    if station.silent_s > 0.0:
        return Level("bad", texts.SILENT.format(seconds=station.silent_s))
    status = station.shown.view.status
    if status == "ok":
        return Level("good", texts.MEASURING)
    if status == "doubtful":
        return Level("bad", texts.DOUBTFUL)
    return Level("warn", texts.POSITION_ONLY) if status == "position_only" else Level("bad", texts.LOST)


@contextmanager
def page(name: str, console: Console) -> Iterator[None]:
    """Put what follows onto a page of this name."""
    ui.page_title(f"{texts.PAGES[name]} · {texts.TITLE}")
    ui.add_head_html(f'<link rel="stylesheet" href="{STATIC}/console.css">')
    ui.add_head_html('<script>document.documentElement.lang = "en"</script>')
    for script in ("pictures.js", "page.js", *(("robot.js",) if console.robot is not None else ())):
        ui.add_head_html(f'<script defer src="{STATIC}/{script}"></script>')
    ui.dark_mode(None)
    with ui.header(fixed=True), ui.element("div").classes("bar"):
        _navigation(name)
        lamp = text_of("span", testid="state", role="status").classes("lamp")
        ui.element("span").classes("space")
        if console.robot is not None:
            _robot_bar(console.robot)
        if logged_in(ui.context.client.request):
            with ui.element("form").props("method=post action=/logout"):
                text_of("button", texts.LOG_OUT, testid="log-out", type="submit").classes("act quiet")
    with ui.element("main").style("display: contents"):
        text_of("h1", texts.PAGES[name])
        yield
    ui.timer(TICK_S, lambda: _show_level(lamp, level_of(console)))


def _navigation(here: str) -> None:
    nav = ui.element("nav")
    nav.props["aria-label"] = texts.NAVIGATION
    with nav:
        for name, title in texts.PAGES.items():
            link = text_of("a", title, href=f"/{name}")
            if name == here:
                link.props["aria-current"] = "page"


def _robot_bar(robot: RobotCell) -> None:
    """The robot's lamp, speed, enable and stop; the browser's script does what they do."""
    bar = ui.element("div").classes("robot")
    bar.props.update(
        {
            "data-robot": page_name(),
            "data-instance": robot.service.authority.instance,
            "data-gone": texts.GONE,
            "data-stale": texts.STALE,
            "data-shared": texts.SHARED,
        }
    )
    with bar:
        text_of("span", testid="robot-state", role="status").classes("lamp")
        text_of("span", id="robot-refused", role="alert").classes("hint refused")
        with ui.element("label").classes("speed"):
            text_of("span", texts.OVERRIDE)
            slider = ui.element("input")
            slider.props.update({"type": "range", "min": "1", "max": "100", "data-testid": "override"})
            text_of("span", id="override-told")
        text_of("button", texts.RESET, testid="reset", type="button", hidden="true").classes("act quiet")
        enable = text_of("button", texts.ENABLE, testid="enable", type="button").classes("enable")
        enable.props.update({"aria-label": texts.ENABLE_HELP, "aria-pressed": "false"})
        stop = text_of("button", texts.STOP, testid="stop", type="button").classes("stop")
        stop.props["aria-label"] = texts.STOP_HELP


def _show_level(lamp: TextElement, level: Level) -> None:
    set_text(lamp, f"{SIGNS[level.level]} {level.words}")
    set_attribute(lamp, "data-level", level.level)


def set_text(label: TextElement, text: str) -> None:
    """Change a label's text; nothing is sent where it is the same."""
    if label.text != text:
        label.text = text


def set_attribute(element: Element, name: str, value: str) -> None:
    """Change an element's attribute; nothing is sent where it is the same."""
    if element.props.get(name) != value:
        element.props[name] = value


LARGEST = 1e6
"""Of any figure of a page, in its unit: mm, deg, mm/s, a count."""
LONGEST = 1000
"""Characters of a text: a source of frames is a path, of which systems take 4096 bytes."""


def number_field(label: str, of: type, name: str, unit: float = 1.0, *, step: float | None = None) -> ui.number:
    """Return a field for a number of a request, which says its default and bounds; unit: what one of it is in SI."""
    bounds, value = (bounds_of(known_hints(of)[name]) or Bounds()).per(unit), getattr(of, name)
    shown = value if value is None or isinstance(value, int) else round(value / unit, DIGITS)
    least = bounds.above if bounds.least is None else bounds.least
    return ui.number(label, value=shown, min=least, max=bounds.most, step=step)


def number(field: ui.number, *, of: str = "", empty: float | None = None) -> float:
    """Return a field's number; empty: what an empty field means, None where it means nothing. of: whose field it is.

    Raises UsageError for what is no number, or not within the field's limits.
    """
    value = field.value
    name = " ".join(part for part in (of, str(field.props.get("label", ""))) if part)
    if value is None or value == "":
        if empty is None:
            raise _refused(texts.FIELD_EMPTY.format(field=name))
        return empty
    try:
        figure = math.nan if isinstance(value, bool) else float(value)
    except (TypeError, ValueError, OverflowError):
        raise _refused(texts.FIELD_NO_NUMBER.format(field=name, value=str(value)[:40])) from None
    low, high = max(float(field.min), -LARGEST), min(float(field.max), LARGEST)
    if not (math.isfinite(figure) and low <= figure <= high):
        raise _refused(texts.FIELD_BEYOND.format(field=name, value=figure, low=low, high=high))
    return figure


def whole_number(field: ui.number, *, of: str = "") -> int:
    """Return a field's whole number. Raises UsageError for another, and as number."""
    figure = number(field, of=of)
    if not figure.is_integer():
        raise _refused(texts.FIELD_NOT_WHOLE.format(field=str(field.props.get("label", "")), value=figure))
    return int(figure)


def text(field: Any) -> str:
    """Return a field's text without blanks about it, empty where it holds none.

    Raises UsageError for what is no text, is too long, or has signs in it that cannot be seen.
    """
    value = "" if field.value is None else field.value
    if not isinstance(value, str) or len(value) > LONGEST or not value.isprintable():
        raise _refused(texts.FIELD_NO_TEXT.format(field=field.props.get("label", "")))
    return value.strip()


def file_name(field: Any, kept: str = "") -> str:
    """Return the name of a file in the cell's folder, or below it; kept: what stands there already stays.

    Raises UsageError for a name that leads out of it, and as text.
    """
    name = text(field)
    path = Path(os.path.normpath(name))  # without following links, of which the folder may hold some
    if name != kept and (path.is_absolute() or os.pardir in path.parts):
        raise _refused(texts.FIELD_OUTSIDE.format(field=field.props.get("label", ""), value=name[:40]))
    return name


def ticked(box: Any) -> bool:
    """Return whether a box is ticked: true alone is."""
    return box.value is True


def _refused(cause: str) -> UsageError:
    return UsageError(cause, consequence=texts.FIELD_CONSEQUENCE, cure=texts.FIELD_CURE)


class Working:
    """The line of one kind of work; `ended` is called once its result is there, also of work found on loading."""

    def __init__(self, jobs: JobRunner, name: str, ended: Callable[[BackgroundJob], None]) -> None:
        """Put it onto the page that is being built; name: of the work."""
        self._jobs, self._name, self._ended = jobs, name, ended
        self._shown: BackgroundJob | None = None
        self._browser = page_name()
        self._said = text_of("p", role="status", testid="work").classes("hint")
        with ui.element("div").classes("row") as self._asking:
            self._question = text_of("p")
            button(texts.YES, lambda: self._answer(yes=True), testid="yes")
            button(texts.NO, lambda: self._answer(yes=False), kind="act quiet")
        with ui.element("div").classes("row") as self._ending:
            button(texts.END_WORK, self._end, kind="act quiet", testid="end-work")
        ui.timer(TICK_S, self._tick)
        self._tick()

    def _job(self) -> BackgroundJob | None:
        return self._jobs.named(self._name)

    def _answer(self, *, yes: bool) -> None:
        job = self._job()
        if job is not None:
            job.answer(yes, self._browser)

    def _end(self) -> None:
        job = self._job()
        if job is not None:
            job.cancel()

    def _tick(self) -> None:
        job = self._job()
        state = None if job is None else job.state
        self._asking.set_visibility(bool(state and state.question))
        self._ending.set_visibility(bool(state and state.running))
        if job is None or state is None:
            return
        set_text(self._question, state.question)
        if state.failure:
            set_text(self._said, texts.ENDED_WORK.format(why=state.failure))
        elif state.running and not state.question:
            progress = texts.UNDER_WAY.format(note=state.note)
            if state.total:
                progress = texts.WORKING.format(note=state.note, done=state.done, total=state.total)
            set_text(self._said, f"{progress}. {texts.HOLD_TO_MOVE}")
        else:
            set_text(self._said, "")
        set_attribute(self._said, "data-level", "bad" if state.failure else "good")
        if not state.running and job.result is not None and self._shown is not job:
            self._shown = job
            self._ended(job)


def jog_card(robot: RobotCell) -> None:
    """Put the jog keys onto the page that is being built."""
    keys = ui.element("div").classes("jog")
    joints: list[TextElement] = []

    def choose(frame: str) -> None:
        keys.clear()
        joints.clear()
        with keys:
            joints.extend(_keys(robot, frame))

    with card(texts.JOG):
        text_of("p", texts.JOG_HELP).classes("hint")
        with ui.element("div").classes("row"):
            for frame, title in texts.JOG_FRAMES.items():
                button(title, partial(choose, frame), kind="act quiet", testid=f"jog-{frame}")
        keys.move(ui.context.slot.parent)
    choose("joints")
    ui.timer(TICK_S, lambda: _show(robot, joints))


def _keys(robot: RobotCell, frame: str) -> list[TextElement]:
    """Return the labels that tell the joints' values; none where the tool is led."""
    description = robot.service.authority.robot
    joints = frame == "joints"
    names = [texts.JOG_JOINT.format(n=i + 1) for i in range(description.n_joints)] if joints else texts.JOG_AXES
    labels = []
    for axis, name in enumerate(names):
        with ui.element("div").classes("axis"):
            label = text_of("span", name)
            for sense, sign in ((-1, "−"), (1, "+")):
                key = text_of("button", sign, type="button").classes("key")
                said = texts.JOG_KEY.format(axis=name, sense=texts.JOG_SENSES[sense])
                key.props.update({"data-jog": f"{frame}:{axis}:{sense}", "aria-label": said, "aria-pressed": "false"})
            labels.append(label)
    return labels if joints else []


def _show(robot: RobotCell, labels: list[TextElement]) -> None:
    try:
        q = robot.joints() if labels else ()
    except ArmsightError:
        return
    arm = robot.session.arm
    for axis, (label, value) in enumerate(zip(labels, q, strict=True)):
        slides = arm is not None and not arm.revolute[axis]
        now = texts.SLIDE_NOW.format(value=value / MM) if slides else texts.JOINT_NOW.format(value=value / DEG)
        set_text(label, f"{texts.JOG_JOINT.format(n=axis + 1)}  {now}")


def uploader() -> None:
    """Choose a file of this machine and bring it into the cell's folder; the browser sends it by itself."""
    with ui.element("label"):
        text_of("span", texts.UPLOAD.format(mb=LARGEST_BYTES // 1_000_000))
        chooser = ui.element("input")
        chooser.props.update(
            {
                "type": "file",
                "data-upload": "/console/files/",
                "data-largest": str(LARGEST_BYTES),
                "data-too-big": texts.TOO_BIG.format(mb=LARGEST_BYTES // 1_000_000),
                "data-not-sent": texts.NOT_SENT,
                "data-testid": "upload",
            }
        )
    text_of("p", role="alert", id="uploaded").classes("hint")
