"""Identify: ranges of the joints, the accuracy to expect, the sweeps, and the table of what was found."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
from nicegui import run, ui

from armsight.app.operator import identify_run as sweeps
from armsight.app.operator.identify_run import FOLDER, JOB_NAME, Entry, IdentifyRequest, Range, SweepFit
from armsight.app.operator.job_runner import BackgroundJob
from armsight.calibrate.identify import Identification
from armsight.calibrate.identify.result import JointStd, PlanOutput
from armsight.console import texts
from armsight.console.layout import (
    button,
    card,
    notice,
    number,
    number_field,
    refusals_in,
    report_link,
    say,
    table,
    text_of,
    ticked,
    whole_number,
)
from armsight.console.routes import page_name
from armsight.console.scene import Scene
from armsight.console.state import Console
from armsight.console.work import Working, jog_card
from armsight.errors import ArmsightError
from armsight.ops.identification.live import LiveSweeps
from armsight.units import DEG, MM


def identify_page(console: Console) -> None:
    """Build the page."""
    try:
        robot = console.require_robot()
        ranges = sweeps.proposed_ranges(robot)
        console.require_station()
    except ArmsightError as error:
        notice(str(error))
        return
    _Identify(console, ranges)
    jog_card(robot)


class _Identify:
    def __init__(self, console: Console, ranges: tuple[Range, ...]) -> None:
        self._console, self._ranges = console, ranges
        self._robot = console.require_robot()
        self._browser = page_name()
        with card(texts.JOINT_RANGES):
            text_of("p", texts.JOINT_RANGES_HELP.format(light=sweeps.light_of(console.folder, console.cell))).classes(
                "hint"
            )
            self._fields = [self._row(one) for one in ranges]
            with ui.element("div").classes("row"):
                self._readings = number_field(texts.READINGS, LiveSweeps, "readings", step=1)
                button(texts.EXPECT, self._expect, kind="act quiet", testid="expect")
                button(texts.IDENTIFY_RUN, self._run, testid="identify-run")
            self._said = text_of("p", role="alert", testid="identify-said").classes("hint")
            self._plan = ui.element("div").classes("scroll")
        with card(texts.FOUND):
            self._found = ui.element("div").classes("scroll")
        with card(texts.FITS):
            self._fitted = ui.element("div").classes("scroll")
            self._scene = self._made_scene()
        with self._found:
            self._table = ui.element("div")
            Working(self._robot.jobs, JOB_NAME, self._show)

    def _made_scene(self) -> Scene | None:
        try:
            return Scene(self._console)
        except ArmsightError as error:
            notice(str(error))
            return None

    def _row(self, one: Range) -> tuple[ui.number, ui.number, ui.checkbox]:
        unit = "mm" if one.slides else "deg"
        with ui.element("div").classes("row"):
            swept = ui.checkbox(texts.SWEEP_JOINT.format(joint=one.joint, name=one.name), value=True)
            swept.style("flex: 0 0 12rem; font-weight: 600").props["data-testid"] = f"sweep-{one.joint}"
            swept.on_value_change(self._ticked)
            low = ui.number(f"{texts.LOWER} ({unit})", value=one.lower, step=1.0)
            high = ui.number(f"{texts.UPPER} ({unit})", value=one.upper, step=1.0)
            for field, end in ((low, "lower"), (high, "upper")):
                field.props["data-testid"] = f"range-{one.joint}-{end}"
        swept.on_value_change(lambda: [field.set_enabled(ticked(swept)) for field in (low, high)])
        return low, high, swept

    def _ticked(self) -> None:
        self._plan.clear()
        self._show_left_out()

    def _show_left_out(self) -> None:
        """Tell what leaving joints out means, or why it cannot be."""
        with refusals_in(self._said):
            words = self._asked().consequence()
            say(self._said, words, "warn" if words else "good")

    def _asked(self) -> IdentifyRequest:
        pairs = zip(self._ranges, self._fields, strict=True)
        ranges = tuple(
            replace(one, lower=_limit(one, low), upper=_limit(one, high), swept=True)
            if ticked(swept)
            else replace(one, swept=False)
            for one, (low, high, swept) in pairs
        )
        return IdentifyRequest(
            folder=self._console.folder,
            cell=self._console.cell,
            ranges=ranges,
            readings=whole_number(self._readings),
        )

    async def _expect(self) -> None:
        self._plan.clear()
        with refusals_in(self._said):
            asked = self._asked()
            plan = await run.io_bound(partial(sweeps.expected, asked, self._robot, self._console.require_station()))
            if plan is None:  # the server is ending
                return
            self._show_left_out()
            with self._plan:
                _plan_table(plan)

    def _run(self) -> None:
        with refusals_in(self._said):
            asked, station = self._asked(), self._console.require_station()
            self._robot.jobs.begin(JOB_NAME, self._browser, partial(sweeps.run, asked, self._robot, station))
            self._show_left_out()

    def _show(self, job: BackgroundJob) -> None:
        done: Identification = job.result
        self._table.clear()
        with self._table:
            _entries_table(sweeps.entries(done, self._robot.session.arm))
            for note in done.notes:
                text_of("p", note).classes("hint")
            text_of("p", texts.SAVED_ARM.format(file=f"{FOLDER}/arm.yaml"), testid="verdict")
            report_link(f"{FOLDER}/arm.report.html")
        fits = sweeps.fits(self._console.folder)
        self._fitted.clear()
        with self._fitted:
            _fits_table(done, fits)
        if self._scene is not None:
            self._scene.show_fits(fits, placed=(self._console.folder / FOLDER / "world.yaml").exists())


def _limit(one: Range, field: ui.number) -> float:
    """Return an end of a joint's range; an empty field is no zero, to which the joint would go."""
    return number(field, of=texts.SWEEP_JOINT.format(joint=one.joint, name=one.name))


def _plan_table(plan: PlanOutput) -> None:
    text_of("h3", texts.EXPECTED)
    text_of("p", texts.PLANNED.format(n=len(plan.sweeps), readings=sum(one.readings for one in plan.sweeps)))
    rows = ((str(n), *_std_words(std)) for n, std in enumerate(plan.expected_std, start=1))
    table((texts.JOINT, "a", "alpha", "d", "theta"), rows)
    for note in plan.notes:
        text_of("p", note).classes("hint")


def _fits_table(done: Identification, fits: tuple[SweepFit, ...]) -> None:
    """What was fitted to each joint's sweep: an arc about its axis, or a line along it."""
    off_m, rows = {fit.joint: fit.off_m for fit in fits}, []
    for joint in done.joints:
        turns = joint.type == "revolute"
        shape = texts.FIT_ARC.format(radius=joint.radius_m / MM) if turns else texts.FIT_LINE
        rows.append(
            (
                str(joint.index),
                shape if joint.decided else f"{shape}; {texts.FIT_OPEN}",
                f"{joint.n - len(joint.discarded)} / {joint.n}",
                f"{joint.residual_rms_m / MM:.3f} mm",
                f"{off_m[joint.index] / MM:.3f} mm" if joint.index in off_m else texts.NO_VALUE,
            )
        )
    table(texts.FITS_HEAD, rows)


def _std_words(std: JointStd) -> tuple[str, ...]:
    def words(value: float | None, scale: float, unit: str, digits: int) -> str:
        return texts.NO_VALUE if value is None else f"± {value / scale:.{digits}f} {unit}"

    return (
        words(std.a_m, MM, "mm", 2),
        words(std.alpha_rad, DEG, "deg", 3),
        words(std.d_m, MM, "mm", 2),
        words(std.theta_rad, DEG, "deg", 3),
    )


def _entries_table(entries: tuple[Entry, ...]) -> None:
    def words(value: float, unit: str) -> str:
        return texts.NO_VALUE if np.isnan(value) else f"{value:.3f} {unit}"

    rows = (
        (str(one.joint), one.name, *(words(value, one.unit) for value in (one.value, one.std, one.deviation)))
        for one in entries
    )
    table(texts.FOUND_HEAD, rows)
