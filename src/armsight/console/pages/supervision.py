"""Live supervision on the page Verify: how far the target is from where the joints say it is, and alarms."""

from __future__ import annotations

from nicegui import ui

from armsight.app.operator.supervise import StationSupervisor, SupervisedState, limits_of
from armsight.console import texts
from armsight.console.fields import number
from armsight.console.layout import TICK_S, button, card, set_attribute, set_text, text_of
from armsight.console.plots import Plot
from armsight.console.state import Console
from armsight.errors import ArmsightError
from armsight.verify.supervision import Level

LEVELS = {Level.GOOD: "good", Level.WARN: "warn", Level.STOP: "bad"}
SLOW_S = 0.5


def supervision_card(console: Console) -> None:
    """Build the card; nothing where the cell has no robot or no cameras."""
    try:
        console.require_robot()
        console.require_station()
    except ArmsightError:
        return
    _Supervision(console)


class _Supervision:
    """The card of a cell with robot and cameras; what runs is found again by a page loaded anew."""

    def __init__(self, console: Console) -> None:
        self._console = console
        with card(texts.SUPERVISION):
            text_of("p", texts.SUPERVISION_HELP).classes("hint")
            with ui.element("div").classes("row"):
                self._warn = ui.number(texts.SUPERVISION_WARN, value=2.0, min=0.0, step=0.5)
                self._stop = ui.number(texts.SUPERVISION_STOP, value=5.0, min=0.0, step=0.5)
                self._begin = button(texts.SUPERVISE, self._toggle, testid="supervise")
            self._said = text_of("p", role="status", testid="supervision").style("font-size: 1.3rem; font-weight: 700")
            self._told = text_of("p", role="alert").classes("hint")
            self._plot = Plot(texts.SUPERVISION_PLOT, ("mm",), testid="plot-supervision", along="{value} s")
            self._report = ui.element("div")
        ui.timer(TICK_S, self._tick)
        ui.timer(SLOW_S, self._draw)

    def _toggle(self) -> None:
        try:
            if self._console.supervisor is None:
                self._console.supervisor = StationSupervisor(
                    self._console.folder,
                    self._console.cell,
                    self._console.require_robot(),
                    lambda: self._console.station,
                    limits_of(number(self._warn), number(self._stop)),
                )
                self._tell("", "good")
            else:
                self._end(self._console.supervisor)
        except ArmsightError as error:
            self._tell(str(error), "bad")

    def _end(self, running: StationSupervisor) -> None:
        self._console.supervisor = None
        done = running.end()
        self._tell(" ".join([done.verdict, *(f"{doubt[0].upper()}{doubt[1:]}." for doubt in done.doubts)]), "good")
        self._report.clear()
        with self._report:
            text_of("a", texts.REPORT, href=f"/console/files/{running.out.name}/report.html", target="_blank")

    def _tell(self, words: str, level: str) -> None:
        set_text(self._told, words)
        set_attribute(self._told, "data-level", level)

    def _tick(self) -> None:
        running = self._console.supervisor
        set_text(self._begin, texts.SUPERVISE if running is None else texts.SUPERVISE_END)
        if running is None:
            set_text(self._said, "")
            return
        state = running.state
        set_text(self._said, _words(state))
        set_attribute(self._said, "data-level", LEVELS[state.level])

    def _draw(self) -> None:
        running = self._console.supervisor
        if running is None or not running.curve:
            return
        curve = list(running.curve)
        self._plot.show([[(t_s - curve[-1][0], mm) for t_s, mm, _ in curve]])


def _words(state: SupervisedState) -> str:
    level = texts.SUPERVISION_LEVELS[state.level.word]
    if state.error_mm is None:
        return f"{level}. {texts.SUPERVISION_BLIND.format(why=state.why)}"
    told = texts.SUPERVISION_AT.format(mm=state.error_mm, std=state.std_mm, deg=state.error_deg)
    return f"{level}. {told} {state.why}".strip()
