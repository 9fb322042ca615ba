"""armsight identify."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from armsight.cli.camera_options import NONE_GIVEN, CameraOptions, takes_cameras
from armsight.cli.command_ui import CommandUI
from armsight.cli.options import KNOWN_ARM, SRC, AsJson
from armsight.cli.table_options import NOTHING_STATED, TableOptions, takes_tables
from armsight.cli.tables import figure
from armsight.errors import UsageError
from armsight.units import DEG, MM

if TYPE_CHECKING:
    from armsight.app.identify.live import LiveJob
    from armsight.app.schemas.arm import IdentifiedJoint, IdentifyOutput, JointStd, PlanOutput

UNITS = (MM, DEG, MM, DEG)
"""How people read a, alpha, d and theta: millimetres and degrees."""


@takes_tables
@takes_cameras
def identify(
    out: Annotated[Path, typer.Option("-o", "--out", help="arm.yaml to write.")],
    sweep: Annotated[
        Path | None, typer.Option(help="sweep.csv: joint,q1..qn and positions (x_m,y_m,z_m), pixels, or both.")
    ] = None,
    target: Annotated[
        Path | None, typer.Option(help="Instead of a sweep: target.yaml of the beacon, with frames.")
    ] = None,
    left: Annotated[str | None, typer.Option(metavar="SRC", help=f"Left frames: {SRC}.")] = None,
    right: Annotated[str | None, typer.Option(metavar="SRC", help="Right frames, in step with the left ones.")] = None,
    joints: Annotated[Path | None, typer.Option(help="sweep_joints.csv: frame,joint,q1..qn of those frames.")] = None,
    rig: Annotated[Path | None, typer.Option(help="rig.yaml: fit pixels instead of positions.")] = None,
    world: Annotated[Path | None, typer.Option(help="world.yaml: where the rig stands to the arm's base.")] = None,
    method: Annotated[str, typer.Option(help="ml (maximum likelihood) or paper (triples, Chauvenet, means).")] = "ml",
    increments: Annotated[
        str, typer.Option(help="known: commanded values are exact; order: only their order.")
    ] = "known",
    sigma: Annotated[
        float | None,
        typer.Option(min=1e-9, help="Noise: px of a pixel with --rig, else m of a place; else it is found."),
    ] = None,
    mask: Annotated[
        Path | None, typer.Option(help="With frames or --live: image that is black where no light may be looked for.")
    ] = None,
    nominal: Annotated[
        str | None, typer.Option(metavar="ARM", help=f"{KNOWN_ARM} to put beside, in the report.")
    ] = None,
    live: Annotated[
        str | None,
        typer.Option(metavar="ROBOT", help="Move this robot: DRIVER[:DEVICE], or sim:SCENARIO with its own cameras."),
    ] = None,
    limits: Annotated[
        str | None,
        typer.Option(
            metavar="LIMITS",
            help="With --live: lo:hi,lo:hi ... in rad or m (or -90deg:90deg,0mm:500mm), or limits.yaml. Never left.",
        ),
    ] = None,
    readings: Annotated[int, typer.Option(min=4, help="With --live: readings of a sweep.")] = 10,
    speed: Annotated[
        float, typer.Option(min=0.001, max=1.0, help="With --live: share of a joint's travel a second.")
    ] = 0.1,
    propose: Annotated[
        bool, typer.Option("--propose", help="With --live: probe and tell the plan only; with --model do not move.")
    ] = False,
    model: Annotated[
        Path | None,
        typer.Option(metavar="ARM", help="With --live: an arm roughly right, its tool the beacon; no probe."),
    ] = None,
    leave_out: Annotated[
        str | None, typer.Option(metavar="5,6", help="With --live: the last joints, not swept but held where they are.")
    ] = None,
    yes: Annotated[bool, typer.Option("--yes", help="With --live: move without asking.")] = False,
    json: AsJson = False,
    camera_options: CameraOptions = NONE_GIVEN,
    table_options: TableOptions = NOTHING_STATED,
) -> None:
    """Find an unknown arm's joints, axes and table from a beacon's positions while one joint after the other moves."""
    with CommandUI(as_json=json) as face:
        if live is not None:
            from armsight.app.identify.live import LiveJob
            from armsight.control.joint_sweep import Pace

            if rig is None or target is None or left is None or right is None or limits is None:
                raise UsageError(
                    "--live lacks something", cure="Give --rig, --target, --left, --right and --limits with it"
                )
            if sweep is not None or joints is not None or increments != "known":
                raise UsageError(
                    "--live makes its own sweeps, of known values",
                    cure="Leave --sweep, --joints and --increments away, or --live",
                )
            _live(
                LiveJob(
                    robot=live,
                    left=left,
                    right=right,
                    rig=rig,
                    target=target,
                    limits=limits,
                    out=out,
                    world=world,
                    model=model,
                    readings=readings,
                    pace=Pace(speed=speed),
                    sigma=sigma,
                    method=method,
                    nominal=nominal,
                    propose=propose,
                    left_out=_numbers(leave_out),
                    camera_settings=camera_options.settings(),
                    mask=mask,
                ),
                face,
                yes,
            )
            return
        from armsight.app.identify.sweep_files import IdentifyJob, run_identify

        given = {"--propose": propose, "--limits": limits, "--model": model, "--leave-out": leave_out, "--yes": yes}
        if any(given.values()):
            raise UsageError(
                f"{', '.join(name for name, value in given.items() if value)} only means something with --live",
                cure="Add --live ROBOT, or leave it out",
            )
        camera_options.settings().require_none("a sweep without --live")
        job = IdentifyJob(
            out=out,
            sweep=sweep,
            target=target,
            left=left,
            right=right,
            joints=joints,
            rig=rig,
            world=world,
            method=method,
            increments=increments,
            sigma=sigma,
            nominal=nominal,
            mask=mask,
            table=table_options.format(face),
        )
        _tell(run_identify(job, face.progress("identifying")), out, face)


def _numbers(text: str | None) -> tuple[int, ...]:
    try:
        return () if text is None else tuple(int(part) for part in text.split(","))
    except ValueError:
        raise UsageError(f"--leave-out {text!r} names no joints", cure="Write their numbers: --leave-out 5,6") from None


def _live(job: LiveJob, face: CommandUI, yes: bool) -> None:
    """Identify online; ask before the robot moves."""
    from armsight.app.identify.live import OperatorCallbacks, run_identify_live
    from armsight.app.schemas.arm import IdentifyOutput

    def confirm(question: str) -> bool:
        try:
            return yes or typer.confirm(question, err=True)
        except typer.Abort:  # nobody there to ask
            return False

    def show(plan: PlanOutput) -> None:
        _tell_plan(plan, face)

    done = run_identify_live(job, OperatorCallbacks(confirm=confirm, show=show), face.progress("identifying"))
    if isinstance(done, IdentifyOutput):
        _tell(done, job.out, face)
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
    """Return a joint's reading as people read it."""
    return f"{value / MM:.1f} mm" if slides else f"{value / DEG:.1f} deg"


def _tell(done: IdentifyOutput, out: Path, face: CommandUI) -> None:
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
