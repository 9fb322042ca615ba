"""armsight calibrate cell-plan: a motion that calibrates a cell, planned."""

from __future__ import annotations

from typing import TYPE_CHECKING

from armsight.cli.command import declared
from armsight.cli.command_ui import CommandUI
from armsight.cli.tables import figure
from armsight.units import MM
from armsight_lab.cell_plan.request import KNOWN, MOTION, CellPlanJob

if TYPE_CHECKING:
    from armsight_lab.cell_plan.run import CellPlanOutput

MOST_M = 0.1
"""A tip known no better than this is not known."""


@declared(panels=(KNOWN, MOTION))
def cell_plan(face: CommandUI, job: CellPlanJob) -> None:
    """Plan the motion that calibrates a cell best: two minutes that tell most of the tip over a volume.

    Within the limits, in view of both cameras, clear of the boxes. Run it with armsight robot run. `calibrate cell
    --plan` is the same.
    """
    from armsight_lab.cell_plan.run import run_cell_plan

    done = run_cell_plan(job, face.progress("planning"))
    plan_tables(face, done)
    face.result(done)


def plan_tables(face: CommandUI, done: CellPlanOutput) -> None:
    """Print what a motion leads to."""
    moved = ", ".join(figure(value, 3) for value in done.moved)
    face.say(f"{done.kind}: {done.duration_s:.0f} s, {done.n_rows} rows; joints over {moved} (rad or m)")
    if done.kinds:
        rows = [[one.name, _before(one.before_m), figure(one.after_m / MM), ""] for one in done.kinds]
        for name, *values in (
            ("tip, cameras", done.measured_before_m, done.measured_after_m, done.measured_least_m),
            ("tip, joints", done.commanded_before_m, done.commanded_after_m, done.commanded_least_m),
        ):
            rows.append([name, _before(values[0]), *(figure(None if v is None else v / MM) for v in values[1:])])
        title = "Deviation of the tip over the volume, mm RMS"
        face.table(title, ["", "before", "after", "not to be told by motion"], rows)
    if done.seen is not None:
        face.say(f"both cameras see all lights in {100.0 * done.seen:.0f} % of the time")
    if done.untold:
        face.say("Not told by it: " + ", ".join(done.untold))
    for note in done.notes:
        face.say(f"- {note}")
    face.say(f"Motion: {done.file}")


def _before(value_m: float | None) -> str:
    """Return what is known beforehand in mm; that it is nothing, where it is far beyond what is linear."""
    return "unknown" if value_m is None or value_m > MOST_M else figure(value_m / MM)
