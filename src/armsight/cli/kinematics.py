"""armsight kinematics, and armsight convert arm."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, TypeAlias

import typer

from armsight.cli.command_ui import CommandUI
from armsight.cli.options import KNOWN_ARM, AsJson, Base, Tip
from armsight.cli.table_options import NOTHING_STATED, TableOptions, takes_tables

kinematics = typer.Typer(help="Joints to poses and back, for any serial arm.", no_args_is_help=True)

ArmFile: TypeAlias = Annotated[str, typer.Option("--arm", metavar="ARM", help=f"{KNOWN_ARM}.")]
Joints: TypeAlias = Annotated[Path, typer.Option(help="joints.csv: t_s, q1 .. qn in rad and m; or bag:FILE:/topic.")]
Poses: TypeAlias = Annotated[Path, typer.Option(help="poses.csv of the tool in world.")]
Out: TypeAlias = Annotated[Path, typer.Option("-o", "--out", help="File to write.")]
TaskName: TypeAlias = Annotated[
    str | None, typer.Option("--task", help="pose or position. [default: pose from six joints on]")
]


@kinematics.command("fk")
@takes_tables
def fk(
    arm: ArmFile,
    joints: Joints,
    out: Out,
    tip: Tip = None,
    base: Base = None,
    json: AsJson = False,
    table_options: TableOptions = NOTHING_STATED,
) -> None:
    """Write the tool's pose at each row of joint values."""
    with CommandUI(as_json=json) as face:
        from armsight.app.arm_files import arm_source
        from armsight.app.kinematics import write_poses_of_joints as run

        done = run(arm_source(arm, tip=tip, base=base), joints, out, table_options.format(face))
        beyond = f", {done.n_beyond_limits} of them beyond limits" if done.n_beyond_limits else ""
        face.say(f"{done.n} poses of {done.arm}{beyond}: {out}")
        face.result(done)


@kinematics.command("ik")
@takes_tables
def ik(
    arm: ArmFile,
    poses: Poses,
    out: Out,
    near: Annotated[Path | None, typer.Option(help="joints.csv to be near to: one row, or one per pose.")] = None,
    every: Annotated[bool, typer.Option("--all", help="Write every solution, not the nearest alone.")] = False,
    task: TaskName = None,
    tip: Tip = None,
    base: Base = None,
    json: AsJson = False,
    table_options: TableOptions = NOTHING_STATED,
) -> None:
    """Write the joint values that bring the tool to each pose."""
    with CommandUI(as_json=json) as face:
        from armsight.app.arm_files import arm_source
        from armsight.app.kinematics import write_joints_of_poses as run

        source = arm_source(arm, tip=tip, base=base)
        done = run(source, poses, out, near=near, every=every, task=task, format_=table_options.format(face))
        counts = ", ".join(f"{count} {status}" for status, count in done.status.items())
        face.say(f"{done.n} poses of {done.arm} ({counts}): {out}")
        for entry in done.unsolved[:5]:
            face.say(f"  pose {entry.pose}: {entry.status}, {entry.why}")
        face.result(done)


@kinematics.command("jacobian")
@takes_tables
def jacobian(
    arm: ArmFile,
    joints: Joints,
    out: Out,
    axes: Annotated[str, typer.Option(help="world, base or tool.")] = "world",
    tip: Tip = None,
    base: Base = None,
    json: AsJson = False,
    table_options: TableOptions = NOTHING_STATED,
) -> None:
    """Write the Jacobian at each row of joint values: t_s, J11 .. J6n."""
    with CommandUI(as_json=json) as face:
        from armsight.app.arm_files import arm_source
        from armsight.app.kinematics import write_jacobians as run

        source = arm_source(arm, tip=tip, base=base)
        done = run(source, joints, out, axes=axes, format_=table_options.format(face))
        face.say(f"{done.n} Jacobians of {done.arm} in {done.axes} axes: {out}")
        face.result(done)


@kinematics.command("path")
@takes_tables
def path(
    arm: ArmFile,
    poses: Poses,
    out: Out,
    start: Annotated[Path | None, typer.Option(help="joints.csv; its first row is where the arm stands.")] = None,
    task: TaskName = None,
    tip: Tip = None,
    base: Base = None,
    json: AsJson = False,
    table_options: TableOptions = NOTHING_STATED,
) -> None:
    """Write a continuous joint track along a path, and tell jumps, speeds, limits and singular passages."""
    with CommandUI(as_json=json) as face:
        from armsight.app.arm_files import arm_source
        from armsight.app.kinematics import write_joint_path as run

        source = arm_source(arm, tip=tip, base=base)
        done = run(source, poses, out, start=start, task=task, format_=table_options.format(face))
        branch = f" on the branch {', '.join(done.branch)}" if done.branch else ""
        face.say(f"{done.n_reached} of {done.n} poses of {done.arm} reached{branch}: {out}")
        for issue in done.issues:
            face.say(f"  {issue.text}")
        face.result(done)


@kinematics.command("formulas")
def formulas(arm: ArmFile, out: Out, tip: Tip = None, base: Base = None, json: AsJson = False) -> None:
    """Write forward kinematics and Jacobian as Python (.py) or LaTeX (.tex)."""
    with CommandUI(as_json=json) as face:
        from armsight.app.arm_files import arm_source
        from armsight.app.kinematics import write_formulas

        done = write_formulas(arm_source(arm, tip=tip, base=base), out)
        face.say(f"formulas of {done.arm}: {out}")
        face.result(done)


@kinematics.command("show")
def show(
    arm: ArmFile,
    out: Out = Path("arm.html"),
    joints: Annotated[
        str | None, typer.Option(help="joints.csv, or values as 0,-1.2,0.4. [default: middle of the ranges]")
    ] = None,
    tip: Tip = None,
    base: Base = None,
    json: AsJson = False,
) -> None:
    """Write a page with the arm in three dimensions."""
    with CommandUI(as_json=json) as face:
        from armsight.app.arm_files import arm_source
        from armsight.app.kinematics import draw_arm as run

        done = run(arm_source(arm, tip=tip, base=base), out, joints=joints)
        face.say(f"{done.arm}: {out}")
        face.result(done)


def convert_arm(
    source: Annotated[str, typer.Argument(metavar="FILE", help=f"{KNOWN_ARM}.")],
    out: Annotated[Path, typer.Option("-o", "--out", help="File to write: .yaml or .urdf.")],
    convention: Annotated[str | None, typer.Option(help="standard or craig, for arm.yaml.")] = None,
    tip: Tip = None,
    base: Base = None,
    json: AsJson = False,
) -> None:
    """Convert an arm between arm.yaml and URDF, and between the two Denavit-Hartenberg conventions."""
    with CommandUI(as_json=json) as face:
        from armsight.app.arm_files import arm_source
        from armsight.app.arm_files import convert_arm as run

        done = run(arm_source(source, tip=tip, base=base), out, convention=convention)
        face.say(f"{done.arm}, {done.joints} joints: {out}")
        face.result(done)
