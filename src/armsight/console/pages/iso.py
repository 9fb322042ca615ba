"""The ISO 9283 run on the page Verify: the cube that fits, the run with the enable held, and its figures."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from nicegui import run, ui

from armsight.app.operator import iso_run
from armsight.app.operator.iso_run import WORK, IsoDone, IsoPlan, IsoRequest
from armsight.app.operator.job_runner import BackgroundJob
from armsight.console import texts
from armsight.console.fields import number, whole_number
from armsight.console.jog import jog_card
from armsight.console.layout import button, card, set_attribute, set_text, text_of
from armsight.console.state import Console
from armsight.console.working import Working
from armsight.errors import ArmsightError
from armsight.units import MM


def iso_card(console: Console, reported: Callable[[], object]) -> None:
    """Build the card, and the jog keys; nothing without robot or cameras. reported: is told of a new report."""
    try:
        robot = console.require_robot()
        console.require_station()
    except ArmsightError:
        return
    _Iso(console, reported)
    jog_card(robot)


class _Iso:
    """The card of a cell with robot and cameras."""

    def __init__(self, console: Console, reported: Callable[[], object]) -> None:
        self._reported = reported
        self._console, self._robot = console, console.require_robot()
        self._browser = ui.context.client.id
        with card(texts.ISO):
            text_of("p", texts.ISO_HELP).classes("hint")
            with ui.element("div").classes("row"):
                self._side = ui.number(texts.ISO_SIDE, value=None, min=10, max=1000, step=10)
                self._cycles = ui.number(texts.ISO_CYCLES, value=10, min=iso_run.FEWEST_VISITS, max=100, step=1)
                self._speed = ui.number(texts.ISO_SPEED, value=100, min=1, max=1000, step=10)
            with ui.element("div").classes("row"):
                button(texts.ISO_PLAN, self._plan, kind="act quiet", testid="iso-plan")
                button(texts.ISO_RUN, self._run, testid="iso-run")
            self._said = text_of("p", role="alert", testid="iso-said").classes("hint")
            self._table = ui.element("div").classes("scroll")
            Working(self._robot.jobs, WORK, self._show)

    def _asked(self) -> IsoRequest:
        return IsoRequest(
            folder=self._console.folder,
            cell=self._console.cell,
            side_mm=number(self._side, empty=0.0),
            cycles=whole_number(self._cycles),
            speed_mm_s=number(self._speed),
        )

    async def _plan(self) -> None:
        try:
            made = await run.io_bound(partial(iso_run.plan, self._asked(), self._robot))
        except ArmsightError as error:
            self._tell(str(error), "bad")
            return
        if made is not None:  # else the server is ending
            self._tell(_told(made), "good")

    def _run(self) -> None:
        try:
            asked, station = self._asked(), self._console.require_station()
            self._robot.jobs.begin(WORK, self._browser, partial(iso_run.run, asked, self._robot, station))
            self._tell("", "good")
        except ArmsightError as error:
            self._tell(str(error), "bad")

    def _tell(self, words: str, level: str) -> None:
        set_text(self._said, words)
        set_attribute(self._said, "data-level", level)

    def _show(self, work: BackgroundJob) -> None:
        """Show the figures of a run that is done."""
        done: IsoDone = work.result
        self._table.clear()
        with self._table:
            text_of("p", texts.ISO_DONE.format(done=done.cycles, wanted=done.wanted), testid="verdict")
            if done.ended:
                text_of("p", texts.ENDED_WORK.format(why=done.ended)).classes("hint")
            with ui.element("table").classes("plain"):
                with ui.element("tr"):
                    for head in texts.ISO_HEAD:
                        text_of("th", head)
                for row in iso_run.figures(done):
                    with ui.element("tr"):
                        for words in row:
                            text_of("td", words)
            for doubt in done.output.doubts:
                text_of("p", doubt).classes("hint")
            text_of("a", texts.REPORT, href=f"/console/files/{done.folder.name}/report.html", target="_blank")
        self._reported()


def _told(made: IsoPlan) -> str:
    places = texts.ISO_PLANNED.format(side=made.test.cube.side_m / MM)
    return " ".join([places, *(f"{note[0].upper()}{note[1:]}." for note in made.notes)])
