"""armsight identify."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from armsight.app import requests
from armsight.cli.command import app, command
from armsight.cli.command_ui import CommandUI, agreed
from armsight.cli.flags import PartialRequest
from armsight.cli.tables import figure
from armsight.errors import UsageError
from armsight.fields import Doc
from armsight.ops.flags import CAMERAS, TABLES
from armsight.units import DEG, MM

if TYPE_CHECKING:
    from armsight.app.identify.results import IdentifiedJoint, IdentifyOutput, JointStd, PlanOutput

UNITS = (MM, DEG, MM, DEG)
"""How people read a, alpha, d and theta: millimetres and degrees."""


@command(app, panels=(CAMERAS, TABLES), filed="identify", judged=True)
def identify(
    face: CommandUI,
    out: requests.identify.Result,
    swept: PartialRequest[requests.identify.IdentifyJob],
    live: PartialRequest[requests.identify.LiveJob],
    yes: Annotated[bool, Doc("With --live: move without asking.")] = False,
) -> None:
    """Find an unknown arm's joints, axes and table from a beacon's positions while one joint after the other moves."""
    if live.value("robot") is not None:
        if live.missing:
            raise UsageError(
                "--live lacks something", cure="Give --rig, --target, --left, --right and --limits with it"
            )
        if {"--sweep", "--joints", "--increments"} & set(swept.given):
            raise UsageError(
                "--live makes its own sweeps, of known values",
                cure="Leave --sweep, --joints and --increments away, or --live",
            )
        _live(live.made(), face, yes)
        return
    from armsight.app.identify.sweep_files import run_identify

    live.value("camera_settings").require_none("a sweep without --live")
    given = [one for one in live.given if one not in swept.given] + (["--yes"] if yes else [])
    if given:
        raise UsageError(
            f"{', '.join(given)} only means something with --live", cure="Add --live ROBOT, or leave it out"
        )
    _print_identified(run_identify(swept.made(), face.progress("identifying")), out, face)


def _live(job: requests.identify.LiveJob, face: CommandUI, yes: bool) -> None:
    from armsight.app.identify.live import OperatorCallbacks, run_identify_live
    from armsight.app.identify.results import IdentifyOutput

    def confirm(question: str) -> bool:
        return yes or agreed(question)

    def show(plan: PlanOutput) -> None:
        _tell_plan(plan, face)

    done = run_identify_live(job, OperatorCallbacks(confirm=confirm, show=show), face.progress("identifying"))
    if isinstance(done, IdentifyOutput):
        _print_identified(done, job.out, face)
    else:
        face.result(done)


def _tell_plan(plan: PlanOutput, face: CommandUI) -> None:
    rows = []
    slides = {sweep.joint for sweep in plan.sweeps if sweep.radius_m == 0.0}
    for sweep in plan.sweeps:
        rest = ", ".join(_shown(value, k in slides) for k, value in enumerate(sweep.rest, 1) if k != sweep.joint)
        ends = [_shown(value, sweep.joint in slides) for value in (sweep.start, sweep.end)]
        rows.append([f"{sweep.joint}", *ends, f"{sweep.readings}", rest])
    face.table("Sweeps", ["joint", "from", "to", "readings", "others rest at"], rows)
    rows = []
    for number, std in enumerate(plan.expected_std, 1):
        shown = zip(_entries(std), UNITS, strict=True)
        rows.append([f"{number}", *("" if value is None else f"+- {figure(value / unit, 2)}" for value, unit in shown)])
    face.table("Accuracy to expect, mm and degrees", ["joint", "a", "alpha", "d", "theta"], rows)
    for note in plan.notes:
        face.say(f"- {note}")


def _shown(value: float, slides: bool) -> str:
    return f"{value / MM:.1f} mm" if slides else f"{value / DEG:.1f} deg"


def _print_identified(done: IdentifyOutput, out: Path, face: CommandUI) -> None:
    rows = []
    for joint in done.joints:
        cells = [f"{joint.index}", joint.type]
        for unit, value, std in zip(UNITS, _entries(joint), _entries(joint.std), strict=True):
            shown = figure(None if value is None else value / unit, 5)
            cells.append(shown if std is None else f"{shown} +- {figure(std / unit, 2)}")
        rows.append([*cells, figure(joint.residual_rms_m / MM)])
    face.table("Arm, mm and degrees", ["joint", "type", "a", "alpha", "d", "theta", "residual"], rows)
    if any(std is not None for joint in done.joints for std in (*_entries(joint.std), joint.std.beta_rad)):
        face.say("Entries without a standard deviation are chosen, not measured.")
    for note in done.notes:
        face.say(f"- {note}")
    face.say(f"Result: {out}; open {out.with_suffix('.report.html')}")
    face.result(done)


def _entries(row: IdentifiedJoint | JointStd) -> tuple[float | None, float | None, float | None, float | None]:
    """Return a, alpha, d and theta of a joint, or their standard deviations, in the order of UNITS."""
    return row.a_m, row.alpha_rad, row.d_m, row.theta_rad
