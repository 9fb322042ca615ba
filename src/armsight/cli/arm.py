"""armsight calibrate arm, armsight calibrate robot-world."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from armsight.cli.command_ui import CommandUI
from armsight.cli.options import KNOWN_ARM, AsJson, Base, Tip
from armsight.cli.table_options import NOTHING_STATED, TableOptions, takes_tables
from armsight.cli.tables import figure, parameter, pose_rows
from armsight.units import DEG, MM

if TYPE_CHECKING:
    from armsight.app.calibrate.arm import ArmOutput

TOLERANCE_MM, TOLERANCE_DEG = 2.0, 1.72


@takes_tables
def arm(
    model: Annotated[str, typer.Option(metavar="ARM", help=f"The nominal arm: {KNOWN_ARM}.")],
    points: Annotated[Path, typer.Option(help="points.csv: q1..qn,x_m,y_m,z_m[,qx,qy,qz,qw][,point][,t_s].")],
    out: Annotated[Path, typer.Option("-o", "--out", help="arm.yaml to write.")],
    holdout: Annotated[Path | None, typer.Option(help="Further points, only for judging.")] = None,
    scale: Annotated[bool, typer.Option("--scale/--no-scale", help="Try joint scales too.")] = True,
    tolerance_mm: Annotated[
        float, typer.Option(min=1e-6, help="Standard deviation of nominal lengths.")
    ] = TOLERANCE_MM,
    tolerance_deg: Annotated[
        float, typer.Option(min=1e-6, help="Standard deviation of nominal angles.")
    ] = TOLERANCE_DEG,
    propose: Annotated[int, typer.Option(min=0, help="Propose so many further joint positions.")] = 0,
    rig: Annotated[Path | None, typer.Option(help="rig.yaml, for proposals both cameras see; with --world.")] = None,
    world: Annotated[Path | None, typer.Option(help="world.yaml: where that rig stands.")] = None,
    tip: Tip = None,
    base: Base = None,
    json: AsJson = False,
    table_options: TableOptions = NOTHING_STATED,
) -> None:
    """Correct a known arm's geometry from measured positions, where a gain can be proved."""
    with CommandUI(as_json=json) as face:
        from armsight.app.arm_files import arm_source
        from armsight.app.calibrate.arm import ArmJob, run_calibrate_arm

        job = ArmJob(
            model=arm_source(model, tip=tip, base=base),
            points=points,
            out=out,
            holdout=holdout,
            scale=scale,
            tolerance_m=tolerance_mm * MM,
            tolerance_rad=tolerance_deg * DEG,
            propose=propose,
            rig=rig,
            world=world,
            table=table_options.format(face),
        )
        done = run_calibrate_arm(job)
        arm_tables(face, done, out)
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


@takes_tables
def robot_world(
    arm: Annotated[str, typer.Option(metavar="ARM", help=f"{KNOWN_ARM}, its tool the beacon.")],
    points: Annotated[Path, typer.Option(help="observed.csv: q1..qn,x_m,y_m,z_m in rig axes.")],
    out: Annotated[Path, typer.Option("-o", "--out", help="world.yaml to write.")],
    tip: Tip = None,
    base: Base = None,
    json: AsJson = False,
    table_options: TableOptions = NOTHING_STATED,
) -> None:
    """Find where the rig stands to the arm's base, from observed points at joint readings."""
    with CommandUI(as_json=json) as face:
        from armsight.app.arm_files import arm_source
        from armsight.app.calibrate.arm import run_calibrate_world

        done = run_calibrate_world(arm_source(arm, tip=tip, base=base), points, out, table_options.format(face))
        face.table("T_base_rig", ["", "value", "+-"], pose_rows(done.T_base_rig, done.std))
        face.say(f"{done.n_used} points, residual {figure(done.residual_rms_m / MM)} mm RMS. Result: {out}")
        for item in done.rejected[:8]:
            face.say(f"  left out: row {item.row}: {item.why}")
        for note in done.notes:
            face.say(f"- {note}")
        face.result(done)


def add_to(calibrate: typer.Typer) -> None:
    """Add the two commands to `armsight calibrate`."""
    calibrate.command("arm")(arm)
    calibrate.command("robot-world")(robot_world)
