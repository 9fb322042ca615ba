"""Verify: measured poses against the arm's own joints, and all reports of the cell."""

from __future__ import annotations

from collections.abc import Callable
from datetime import datetime
from functools import partial
from pathlib import Path

from nicegui import run, ui

from armsight.app.operator import iso_run
from armsight.app.operator.iso_run import JOB_NAME, IsoDone, IsoPlan, IsoRequest
from armsight.app.operator.job_runner import BackgroundJob
from armsight.app.operator.supervise import Levels, StationSupervisor, SupervisedState
from armsight.console import texts
from armsight.console.layout import (
    TICK_S,
    button,
    card,
    file_name,
    number,
    number_field,
    refusals_in,
    report_link,
    say,
    set_text,
    table,
    text_of,
    whole_number,
)
from armsight.console.plots import Plot
from armsight.console.routes import page_name, reports
from armsight.console.state import Console
from armsight.console.work import Working, jog_card
from armsight.errors import ArmsightError
from armsight.ops.verify import verify
from armsight.store.cell_file import within
from armsight.units import DEG, MM
from armsight.verify.results import VerifyResult
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
                self._warn = number_field(texts.SUPERVISION_WARN, Levels, "warn_m", MM, step=0.5)
                self._stop = number_field(texts.SUPERVISION_STOP, Levels, "stop_m", MM, step=0.5)
                self._begin = button(texts.SUPERVISE, self._toggle, testid="supervise")
            self._said = text_of("p", role="status", testid="supervision").style("font-size: 1.3rem; font-weight: 700")
            self._words = text_of("p", role="alert").classes("hint")
            self._plot = Plot(texts.SUPERVISION_PLOT, ("mm",), testid="plot-supervision", along="{value} s")
            self._report = ui.element("div")
        ui.timer(TICK_S, self._tick)
        ui.timer(SLOW_S, self._draw)

    def _toggle(self) -> None:
        with refusals_in(self._words):
            if self._console.supervisor is None:
                self._console.supervisor = StationSupervisor(
                    self._console.folder,
                    self._console.cell,
                    self._console.require_robot(),
                    lambda: self._console.station,
                    Levels(warn_m=number(self._warn) * MM, stop_m=number(self._stop) * MM).limits,
                )
                say(self._words, "")
            else:
                self._end(self._console.supervisor)

    def _end(self, running: StationSupervisor) -> None:
        self._console.supervisor = None
        done = running.end()
        say(self._words, " ".join([done.verdict, *(f"{doubt[0].upper()}{doubt[1:]}." for doubt in done.doubts)]))
        self._report.clear()
        with self._report:
            report_link(f"{running.out.name}/report.html")

    def _tick(self) -> None:
        running = self._console.supervisor
        set_text(self._begin, texts.SUPERVISE if running is None else texts.SUPERVISE_END)
        if running is None:
            set_text(self._said, "")
            return
        state = running.state
        say(self._said, _words(state), LEVELS[state.level])

    def _draw(self) -> None:
        running = self._console.supervisor
        if running is None or not running.curve:
            return
        curve = list(running.curve)
        self._plot.show([[(t_s - curve[-1][0], mm) for t_s, mm, _ in curve]])


def _words(state: SupervisedState) -> str:
    level = texts.SUPERVISION_LEVELS[state.level.word]
    off = state.compared
    if off is None:
        return f"{level}. {texts.SUPERVISION_BLIND.format(why=state.why)}"
    words = texts.SUPERVISION_AT.format(mm=off.error_m / MM, std=off.std_m / MM, deg=off.error_rad / DEG)
    return f"{level}. {words} {state.why}".strip()


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
    def __init__(self, console: Console, reported: Callable[[], object]) -> None:
        self._reported = reported
        self._console, self._robot = console, console.require_robot()
        self._browser = page_name()
        with card(texts.ISO):
            text_of("p", texts.ISO_HELP).classes("hint")
            with ui.element("div").classes("row"):
                self._side = number_field(texts.ISO_SIDE, IsoRequest, "side_m", MM, step=10)
                self._cycles = number_field(texts.ISO_CYCLES, IsoRequest, "cycles", step=1)
                self._speed = number_field(texts.ISO_SPEED, IsoRequest, "speed_m_s", MM, step=10)
            with ui.element("div").classes("row"):
                button(texts.ISO_PLAN, self._plan, kind="act quiet", testid="iso-plan")
                button(texts.ISO_RUN, self._run, testid="iso-run")
            self._said = text_of("p", role="alert", testid="iso-said").classes("hint")
            self._table = ui.element("div").classes("scroll")
            Working(self._robot.jobs, JOB_NAME, self._show)

    def _asked(self) -> IsoRequest:
        return IsoRequest(
            folder=self._console.folder,
            cell=self._console.cell,
            side_m=number(self._side, empty=0.0) * MM or None,
            cycles=whole_number(self._cycles),
            speed_m_s=number(self._speed) * MM,
        )

    async def _plan(self) -> None:
        with refusals_in(self._said):
            made = await run.io_bound(partial(iso_run.plan, self._asked(), self._robot))
            if made is not None:  # else the server is ending
                say(self._said, format_plan(made))

    def _run(self) -> None:
        with refusals_in(self._said):
            asked, station = self._asked(), self._console.require_station()
            self._robot.jobs.begin(JOB_NAME, self._browser, partial(iso_run.run, asked, self._robot, station))
            say(self._said, "")

    def _show(self, job: BackgroundJob) -> None:
        done: IsoDone = job.result
        self._table.clear()
        with self._table:
            text_of("p", texts.ISO_DONE.format(done=done.cycles, wanted=done.wanted), testid="verdict")
            if done.ended:
                text_of("p", texts.ENDED_WORK.format(why=done.ended)).classes("hint")
            table(texts.ISO_HEAD, iso_run.figures(done))
            for doubt in done.output.doubts:
                text_of("p", doubt).classes("hint")
            report_link(f"{done.folder.name}/report.html")
        self._reported()


def format_plan(made: IsoPlan) -> str:
    """Return the cube of a test that is planned, and what is to be said of it."""
    planned = texts.ISO_PLANNED.format(side=made.test.cube.side_m / MM)
    return " ".join([planned, *(f"{note[0].upper()}{note[1:]}." for note in made.notes)])


FIELDS = ("measured", "joints")


def verify_page(console: Console) -> None:
    """Build the page."""
    with card(texts.VERIFY):
        fields = {name: ui.input(texts.VERIFY_FIELDS[name]).classes("w-full") for name in FIELDS}
        for name, field in fields.items():
            field.props["data-testid"] = f"field-{name}"
        said = text_of("p", role="alert").classes("hint")
        result = ui.element("div").classes("scroll")

        async def begin() -> None:
            say(said, texts.RUNNING_VERIFY)
            result.clear()
            with refusals_in(said):
                done = await run.io_bound(partial(_verify, console, {n: file_name(f) for n, f in fields.items()}))
                if done is None:  # the server is ending
                    return
                set_text(said, done.verdict)
                with result:
                    table((), ((texts.ROWS, str(done.n)), (texts.CAUSE, done.cause)))
                listing.refresh(console)

        button(texts.VERIFY_RUN, begin, testid="verify-run")
    supervision_card(console)
    iso_card(console, lambda: listing.refresh(console))
    listing(console)


def _verify(console: Console, names: dict[str, str]) -> VerifyResult:
    """Verify files of the cell's folder into a folder of their own, named after the time."""
    out = console.folder / f"verify-{datetime.now():%Y%m%d-%H%M%S}"
    measured, joints = (within(console.folder, names[name]) for name in FIELDS)
    arm = console.file("arm") if names["joints"] else None
    return verify(measured, arm=arm, joints=joints if arm else None, out=out)


@ui.refreshable
def listing(console: Console) -> None:
    """List the cell's reports, the newest first."""
    with card(texts.REPORTS):
        found = reports(console.folder)
        if not found:
            text_of("p", texts.NO_REPORTS).classes("hint")
        with ui.element("table").classes("plain"):
            for path in found:
                with ui.element("tr"):
                    with ui.element("td"):
                        text_of("a", str(path), href=f"/console/files/{path}", target="_blank")
                    text_of("td", _when(console.folder / path))


def _when(path: Path) -> str:
    return datetime.fromtimestamp(path.stat().st_mtime).strftime("%Y-%m-%d %H:%M")
