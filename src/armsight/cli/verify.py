"""armsight verify."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from armsight.cli.command_ui import CommandUI
from armsight.cli.options import KNOWN_ARM, AsJson, Base, OutFolder, Tip, quantity
from armsight.cli.table_options import NOTHING_STATED, TableOptions, takes_tables
from armsight.cli.tables import REJECTED_SHOWN, figure
from armsight.errors import UsageError
from armsight.units import DEG, MM, MS

if TYPE_CHECKING:
    from armsight.app.verify.plan import VerifyPlanOutput
    from armsight.verify.results import VerifyJoint, VerifyOutput


@takes_tables
def verify(
    out: OutFolder,
    part: Annotated[
        str | None,
        typer.Argument(metavar="[cube|poses|paths]", help="With --plan: which part of the test. [default: cube, all]"),
    ] = None,
    measured: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Measured poses or points: poses.csv, points.csv, a tracker's table (x_m,y_m,z_m), TUM. With columns "
            "pose and visit, or run, the figures of ISO 9283.",
        ),
    ] = None,
    arm: Annotated[str | None, typer.Option(metavar="ARM", help=f"{KNOWN_ARM}.")] = None,
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
    band: Annotated[
        float | None,
        typer.Option(
            help="For rows with a column arrival: the limit band that the arm settles into. [default: the pose "
            "repeatability of the same pose]",
            **quantity("m"),
        ),
    ] = None,
    plan: Annotated[
        bool, typer.Option("--plan", help="Instead of verifying, plan the test of ISO 9283 for --arm.")
    ] = False,
    side: Annotated[
        float | None,
        typer.Option(help="With --plan: the cube's side. [default: the largest that fits]", **quantity("m")),
    ] = None,
    speed: Annotated[
        float | None, typer.Option(help="With --plan: the speed along the paths.", **quantity("m/s"))
    ] = None,
    tip: Tip = None,
    base: Base = None,
    json: AsJson = False,
    table_options: TableOptions = NOTHING_STATED,
) -> None:
    """Compare measured poses with where the arm says it is, say what the difference comes from; figures of ISO 9283.

    Writes verify.json, errors.csv and report.html; with --plan plan.csv and plan.json.
    """
    with CommandUI(as_json=json) as face:
        _check_plan(plan, part, side, speed, [measured, joints, commanded, world, align, compare, band])
        if tip is not None or base is not None:
            from armsight.app.arm_files import arm_source

            arm = arm_source(_given(arm), tip=tip, base=base)
        if plan:
            from armsight.app.verify.plan import PlanJob, run_plan

            planned = run_plan(PlanJob(arm=arm, out=out, what=part or "cube", side_m=side, speed_m_s=speed))
            plan_table(face, planned, out)
            face.result(planned)
            return
        from armsight.app.verify.run import VerifyJob, run_verify

        if measured is None:
            raise UsageError("no measurements were given", cure="Give --measured FILE, or --plan with --arm")
        job = VerifyJob(
            measured=measured,
            out=out,
            arm=arm,
            joints=joints,
            commanded=commanded,
            world=world,
            align=align,
            compare=compare,
            band_m=band,
            table=table_options.format(face),
        )
        done = run_verify(job)
        verify_tables(face, done, out)
        face.result(done)


def _given(arm: str | None) -> str:
    """Return the arm; UsageError where --tip or --base is of none."""
    if arm is None:
        raise UsageError("--tip and --base choose a chain of an arm, and none was given", cure="Give --arm FILE.urdf")
    return arm


def _check_plan(plan: bool, part: str | None, side: float | None, speed: float | None, files: list[Any]) -> None:
    """Raise UsageError where options of a plan and of a verification are mixed."""
    if not plan and (part is not None or side is not None or speed is not None):
        name = "--side" if side is not None else "--speed" if speed is not None else repr(part)
        raise UsageError(f"{name} goes with --plan", cure="Add --plan, or leave it out")
    if plan and any(item is not None for item in files):
        raise UsageError(
            "--plan plans a test, and files to verify were given too",
            consequence="Nothing is planned or verified",
            cure="Plan with --plan, --arm and -o alone; verify without --plan",
        )


def plan_table(face: CommandUI, done: VerifyPlanOutput, out: Path) -> None:
    """Print a plan."""
    centre = ", ".join(f"{value:.3f}" for value in done.cube.centre_m)
    face.say(f"Cube of {done.cube.side_m / MM:.0f} mm about ({centre}) m in the base frame, {', '.join(done.branch)}")
    for text in done.refused:
        face.say(f"  not {text}")
    rows = [[motion.test, ", ".join(motion.figures), str(motion.repeats), str(motion.n)] for motion in done.motions]
    face.table("Motions", ["tag", "figures", "repeats", "rows"], rows)
    face.say(f"Speed {done.speed_m_s:.3g} m/s. The arm's body and the cell are not checked: run it slowly first.")
    face.say(f"Results: {out / 'plan.csv'}")


def verify_tables(face: CommandUI, done: VerifyOutput, out: Path) -> None:
    """Print a verification."""
    rows = []
    for name, item in done.task.items():
        factor, unit = (DEG, "deg") if name.endswith("_rad") else (MM, "mm")
        own = done.measurement_std.get(name)
        values = (item.me, item.mae, item.max, item.sd, own)
        shown = [figure(None if value is None else value / factor) for value in values]
        rows.append([f"{name.rsplit('_', 1)[0]} {unit}", *shown])
    if rows:
        face.table("Measured minus expected", ["", "mean", "mean abs.", "largest", "sd", "measurement +-"], rows)
    _joints_and_frames(face, done)
    for text in done.doubts:
        face.say(f"  {text}")
    for left in done.rejected[:REJECTED_SHOWN]:
        face.say(f"  left out: row {left.row}: {left.why}")
    if len(done.rejected) > REJECTED_SHOWN:
        face.say(f"  ... and {len(done.rejected) - REJECTED_SHOWN} more, see verify.json")
    _iso_table(face, done)
    if done.compared is not None and done.compared.after is not None and done.after is not None:
        before, after = done.compared.after.rms_m / MM, done.after.rms_m / MM
        face.say(f"Beside {done.compared.folder}: {figure(before)} mm RMS there, {figure(after)} here")
    face.say(f"Cause: {done.cause}. {done.verdict}" if done.task else done.verdict)
    for q in done.decide_by or ():
        face.say("  measure at " + ", ".join(f"{value:.4f}" for value in q))
    face.say(f"Results: {out}; open {out / 'report.html'}")


def _joints_and_frames(face: CommandUI, done: VerifyOutput) -> None:
    """Print the joints, the time offset, and what is left open."""
    if done.joints:
        header = ["joint", "mean deg", "mean abs.", "largest", "zero deg", "+-", "alone explains"]
        face.table("Joints", header, [_joint_row(joint) for joint in done.joints])
    if done.time.offset_s is not None and done.time.std_s is not None:
        face.say(f"Time offset {done.time.offset_s:.6f} s +- {figure(done.time.std_s / MS, 2)} ms")
    if done.alignment.undetermined:
        face.say(f"Not determined by these rows: {', '.join(done.alignment.undetermined)}")


def _iso_table(face: CommandUI, done: VerifyOutput) -> None:
    """Print the figures of ISO 9283 that are given, and why others are not."""
    given = {name: item for name, item in done.iso9283.items() if " " not in name and item.n}
    rows = []
    for name, item in given.items():
        if item.value is not None:
            repeats = f"{item.n} of {item.wanted}" if item.n < item.wanted else str(item.n)
            rows.append([name, f"{item.value:.4g}", "-" if item.std is None else f"{item.std:.2g}", repeats])
    if rows:
        face.table("ISO 9283, the worst place, SI units", ["figure", "value", "+-", "repeats"], rows)
    why: dict[str, list[str]] = {}
    for name, item in given.items():
        if item.withheld is not None:
            why.setdefault(item.withheld, []).append(name)
    for text, names in why.items():
        face.say(f"  withheld: {', '.join(names)}: {text}")


def _joint_row(joint: VerifyJoint) -> list[str]:
    values = (joint.me, joint.mae, joint.max, joint.offset_rad, joint.std_rad)
    shown = [figure(None if value is None else value / DEG) for value in values]
    gain = "-" if joint.gain_heldout is None else f"{100.0 * joint.gain_heldout:.1f} %"
    return [f"{joint.index} {joint.name}", *shown, gain if joint.judged else "not judged"]
