"""armsight verify."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from armsight.cli.command_ui import CommandUI
from armsight.cli.options import AsJson, OutFolder
from armsight.cli.tables import REJECTED_SHOWN, figure
from armsight.units import DEG, MM, MS

if TYPE_CHECKING:
    from armsight.app.schemas.verify import VerifyJoint, VerifyOutput


def verify(
    measured: Annotated[
        Path,
        typer.Option(
            metavar="FILE",
            help="Measured poses or points: poses.csv, points.csv, a tracker's table (x_m,y_m,z_m), TUM.",
        ),
    ],
    out: OutFolder,
    arm: Annotated[str | None, typer.Option(metavar="ARM", help="arm.yaml, .urdf or a preset's name.")] = None,
    joints: Annotated[
        Path | None, typer.Option(help="joints.csv of the controller. [default: q1 .. qn of the measured file]")
    ] = None,
    commanded: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Instead of an arm: the poses that were commanded.")
    ] = None,
    world: Annotated[Path | None, typer.Option(help="world.yaml: where the measuring rig stands.")] = None,
    align: Annotated[
        str | None,
        typer.Option(
            metavar="none|base|tool|both", help="What is laid where it fits best. [default: both; none with --world]"
        ),
    ] = None,
    compare: Annotated[
        Path | None, typer.Option(metavar="FOLDER", help="An earlier run, to stand beside this one in the report.")
    ] = None,
    json: AsJson = False,
) -> None:
    """Compare measured poses with where the arm says it is, and say what the difference comes from.

    Writes verify.json, errors.csv and report.html.
    """
    with CommandUI(as_json=json) as face:
        from armsight.app.verify.run import VerifyJob, run_verify

        job = VerifyJob(
            measured=measured,
            out=out,
            arm=arm,
            joints=joints,
            commanded=commanded,
            world=world,
            align=align,
            compare=compare,
        )
        done = run_verify(job)
        verify_tables(face, done, out)
        face.result(done)


def verify_tables(face: CommandUI, done: VerifyOutput, out: Path) -> None:
    """Print a verification."""
    rows = []
    for name, item in done.task.items():
        factor, unit = (DEG, "deg") if name.endswith("_rad") else (MM, "mm")
        own = done.measurement_std.get(name)
        values = (item.me, item.mae, item.max, item.sd, own)
        shown = [figure(None if value is None else value / factor) for value in values]
        rows.append([f"{name.rsplit('_', 1)[0]} {unit}", *shown])
    face.table("Measured minus expected", ["", "mean", "mean abs.", "largest", "sd", "measurement +-"], rows)
    if done.joints:
        header = ["joint", "mean deg", "mean abs.", "largest", "zero deg", "+-", "alone explains"]
        face.table("Joints", header, [_joint_row(joint) for joint in done.joints])
    if done.time.offset_s is not None and done.time.std_s is not None:
        face.say(f"Time offset {done.time.offset_s:.6f} s +- {figure(done.time.std_s / MS, 2)} ms")
    if done.alignment.undetermined:
        face.say(f"Not determined by these rows: {', '.join(done.alignment.undetermined)}")
    for text in done.doubts:
        face.say(f"  {text}")
    for left in done.rejected[:REJECTED_SHOWN]:
        face.say(f"  left out: row {left.row}: {left.why}")
    if len(done.rejected) > REJECTED_SHOWN:
        face.say(f"  ... and {len(done.rejected) - REJECTED_SHOWN} more, see verify.json")
    if done.compared is not None:
        before, after = done.compared.after.rms_m / MM, done.after.rms_m / MM
        face.say(f"Beside {done.compared.folder}: {figure(before)} mm RMS there, {figure(after)} here")
    face.say(f"Cause: {done.cause}. {done.verdict}")
    for q in done.decide_by or ():
        face.say("  measure at " + ", ".join(f"{value:.4f}" for value in q))
    face.say(f"Results: {out}; open {out / 'report.html'}")


def _joint_row(joint: VerifyJoint) -> list[str]:
    values = (joint.me, joint.mae, joint.max, joint.offset_rad, joint.std_rad)
    shown = [figure(None if value is None else value / DEG) for value in values]
    gain = "-" if joint.gain_heldout is None else f"{100.0 * joint.gain_heldout:.1f} %"
    return [f"{joint.index} {joint.name}", *shown, gain if joint.judged else "not judged"]
