"""armsight calibrate handeye, cell, tooltip, pivot, arm and robot-world."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from armsight.app import requests
from armsight.app.requests.shared import AN_ARM, KNOWN_ARM, OUT, Base, Table, Tip
from armsight.cli.actions import add_action
from armsight.cli.command import calibrate, command
from armsight.cli.command_ui import CommandUI
from armsight.cli.tables import figure, parameter, pose_rows
from armsight.fields import Doc
from armsight.file_names import CELL
from armsight.ops.calibrate_cell import calibrate_cell
from armsight.ops.calibrate_hand_eye import calibrate_hand_eye
from armsight.ops.calibrate_robot import calibrate_pivot, calibrate_tool_tip
from armsight.units import MM

if TYPE_CHECKING:
    from armsight.app.calibrate.arm import ArmOutput


add_action(calibrate, calibrate_hand_eye, filed="calibrate handeye", judged=True)
add_action(calibrate, calibrate_cell, own=CELL, filed="calibrate cell", judged=True)
add_action(calibrate, calibrate_tool_tip, filed="calibrate tooltip", judged=True)
add_action(calibrate, calibrate_pivot, filed="calibrate pivot", judged=True)


@command(calibrate, filed="calibrate arm", judged=True)
def arm(face: CommandUI, job: requests.calibrate_robot.ArmJob, tip: Tip = None, base: Base = None) -> None:
    """Correct a known arm's geometry from measured positions, where a gain can be proved."""
    from armsight.app.arm_files import arm_source
    from armsight.app.calibrate.arm import run_calibrate_arm

    done = run_calibrate_arm(replace(job, model=arm_source(job.model, tip=tip, base=base)))
    arm_tables(face, done, job.out)
    face.result(done)


def arm_tables(face: CommandUI, done: ArmOutput, out: Path) -> None:
    """Print an arm's calibration."""
    named = [("rows used", done.before, done.after)]
    named += [("rows left out by cross-validation", done.crossval.before, done.crossval.after)]
    named += [("rows of the holdout", done.holdout.before, done.holdout.after)] if done.holdout is not None else []
    rows = [
        [name, *(figure(value / MM, 4) for part in (before, after) for value in (part.mean_m, part.max_m))]
        for name, before, after in named
    ]
    face.table("Error at the tool's point, mm", ["", "before: mean", "max", "after: mean", "max"], rows)
    freed = [parameter(name, done.corrections[name], done.deviations[name]) for name in done.free]
    if freed:
        face.table("Corrections", ["", "by", "+-"], freed)
    face.say(done.verdict)
    for note in done.notes:
        if note not in done.verdict:
            face.say(f"  {note}.")
    if done.still:
        face.say("Did not move: " + ", ".join(done.still) + ". Nothing of them is corrected by these rows.")
    for item in done.outliers[:8]:
        face.say(f"  row {item.row} misses by {figure(item.error_m / MM)} mm")
    for q in done.proposals or ():
        face.say("  measure at " + ", ".join(f"{value:.4f}" for value in q))
    if done.expected_std is not None:
        expected = [parameter(name, value) for name, value in done.expected_std.items()]
        face.table("Standard deviations to expect with those measured too", ["", "+-"], expected)
    face.say(f"Result: {out}; open {out.with_suffix('.report.html')}")


@command(calibrate, filed="calibrate robot-world", judged=True)
def robot_world(
    face: CommandUI,
    *,
    arm: Annotated[str, Doc(f"{KNOWN_ARM}, its tool the beacon."), AN_ARM],
    points: Annotated[Path, Doc("observed.csv: q1..qn,x_m,y_m,z_m in rig axes.")],
    out: Annotated[Path, Doc("world.yaml to write."), OUT],
    tip: Tip = None,
    base: Base = None,
    table: Table,
) -> None:
    """Find where the rig stands to the arm's base, from observed points at joint readings."""
    from armsight.app.arm_files import arm_source
    from armsight.app.calibrate.arm import run_calibrate_world

    done = run_calibrate_world(arm_source(arm, tip=tip, base=base), points, out, table)
    face.table("T_base_rig", ["", "value", "+-"], pose_rows(done.T_base_rig, done.std))
    face.say(f"{done.n_used} points, residual {figure(done.residual_rms_m / MM)} mm RMS. Result: {out}")
    for item in done.rejected[:8]:
        face.say(f"  left out: row {item.row}: {item.why}")
    for note in done.notes:
        face.say(f"- {note}")
    face.result(done)
