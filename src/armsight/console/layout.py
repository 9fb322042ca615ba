"""The frame of every page and the parts that several have: fields, lamps, tables, lines that tell of refusals."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import astuple, dataclass
from pathlib import Path
from typing import Any

from nicegui import ui
from nicegui.element import Element
from nicegui.elements.mixins.text_element import TextElement

from armsight.app.operator.robot_cell import RobotCell
from armsight.console import texts
from armsight.console.routes import LARGEST_BYTES, logged_in, page_name
from armsight.console.state import Console
from armsight.errors import ArmsightError, UsageError
from armsight.fields import DIGITS, Bounds, bounds_of, known_hints
from armsight.optics import SIDES

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


def picture_title(name: str) -> str:
    """Return what a camera's picture is called."""
    return texts.PICTURES.get(name) or texts.PICTURE.format(name=name)


def canvas_of(side: str, *, testid: str = "", plain: bool = False) -> Element:
    """Return a camera's picture, which the browser's script draws; plain: without what nobody named."""
    canvas = ui.element("canvas")
    canvas.props.update({"data-side": side, "role": "img", "aria-label": picture_title(side)})
    canvas.props.update({f"data-mark-{view}": mark for view, mark in texts.VIEW_MARKS.items()})
    canvas.props["width"], canvas.props["height"] = 1280, 720
    if testid:
        canvas.props["data-testid"] = testid
    if plain:
        canvas.props["data-plain"] = "true"
    return canvas


def named_canvas(side: str, pictures: tuple[str, ...], *, plain: bool = False) -> Element:
    """Return a camera's picture, under its name where there are other cameras than left and right."""
    if len(pictures) > 1 and pictures != SIDES:
        text_of("h3", picture_title(side))
    return canvas_of(side, plain=plain)


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
    away = [name for name, view in station.shown.view.cameras.items() if view.lost or view.left_out]
    if status == "ok" and away:
        return Level("warn", texts.WITHOUT.format(names=", ".join(away)))
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
    ui.timer(TICK_S, lambda: show_level(lamp, *astuple(level_of(console))))


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


def set_text(label: TextElement, text: str) -> None:
    """Change a label's text; nothing is sent where it is the same."""
    if label.text != text:
        label.text = text


def set_attribute(element: Element, name: str, value: str) -> None:
    """Change an element's attribute; nothing is sent where it is the same."""
    if element.props.get(name) != value:
        element.props[name] = value


def show_level(lamp: TextElement, level: str, words: str) -> None:
    """Show a state with its sign; level: good, warn, bad or idle."""
    say(lamp, f"{SIGNS[level]} {words}", level)


def say(line: TextElement, words: str, level: str = "good") -> None:
    """Tell something in a line of the page."""
    set_text(line, words)
    set_attribute(line, "data-level", level)


@contextmanager
def refusals_in(line: TextElement) -> Iterator[None]:
    """Tell in a line of the page why what follows was refused."""
    try:
        yield
    except ArmsightError as error:
        say(line, str(error), "bad")


def notice(words: str) -> None:
    """Put a line onto the page that says why something is not there."""
    text_of("p", words).classes("notice")


def table(head: Iterable[str], rows: Iterable[Iterable[str]]) -> None:
    """Put a plain table onto the page that is being built; head: empty for none."""
    with ui.element("table").classes("plain"):
        for kind, cells in (*((("th", head),) if head else ()), *(("td", row) for row in rows)):
            with ui.element("tr"):
                for words in cells:
                    text_of(kind, words)


def report_link(file: str) -> None:
    """Put a link to a report onto the page that is being built; file: in the cell's folder."""
    text_of("a", texts.REPORT, href=f"/console/files/{file}", target="_blank")


LARGEST = 1e6
"""Of any figure of a page, in its unit: mm, deg, mm/s, a count."""
LONGEST = 1000
"""Characters of a text: a source of frames is a path, of which systems take 4096 bytes."""


def number_field(label: str, of: Any, name: str, unit: float = 1.0, *, step: float | None = None) -> ui.number:
    """Return a field for a number of a request or an action, which says its default and bounds.

    unit: what one of it is in SI.
    """
    done = vars(of).get("action")
    hints, value = (known_hints(of), getattr(of, name)) if done is None else (done.hints, done.parameters[name].default)
    bounds = (bounds_of(hints[name]) or Bounds()).per(unit)
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
