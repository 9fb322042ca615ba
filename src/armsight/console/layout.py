"""The frame of every page: title, navigation, state, the enable and the stop."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from nicegui import ui
from nicegui.element import Element
from nicegui.elements.mixins.text_element import TextElement

from armsight.app.operator.robot_cell import RobotCell
from armsight.console import texts
from armsight.console.state import Console

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
            "data-robot": ui.context.client.id,
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
