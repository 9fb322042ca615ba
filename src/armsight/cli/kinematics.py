"""armsight kinematics, and armsight convert arm."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, TypeAlias

from armsight.app.requests.shared import AN_ARM, KNOWN_ARM, OUT, Base, Table, Tip
from armsight.cli.command import command, convert, kinematics
from armsight.cli.command_ui import CommandUI
from armsight.fields import Doc, Flag

ArmFile: TypeAlias = Annotated[str, Doc(f"{KNOWN_ARM}."), AN_ARM]
Joints: TypeAlias = Annotated[Path, Doc("joints.csv: t_s, q1 .. qn in rad and m; or bag:FILE:/topic.")]
Poses: TypeAlias = Annotated[Path, Doc("poses.csv of the tool in world.")]
Out: TypeAlias = Annotated[Path, Doc("File to write."), OUT]
TaskName: TypeAlias = Annotated[str | None, Doc("pose or position. [default: pose from six joints on]")]
Near: TypeAlias = Annotated[Path | None, Doc("joints.csv to be near to: one row, or one per pose.")]
Start: TypeAlias = Annotated[Path | None, Doc("joints.csv; its first row is where the arm stands.")]
Every: TypeAlias = Annotated[bool, Doc("Write every solution, not the nearest alone."), Flag("--all")]


def _say_notes(face: CommandUI, notes: Sequence[str]) -> None:
    """Say what to know of the arm."""
    for note in notes:
        face.say(f"  {note}")


@command(kinematics, streamed=True)
def fk(
    face: CommandUI, *, arm: ArmFile, joints: Joints, out: Out, tip: Tip = None, base: Base = None, table: Table
) -> None:
    """Write the tool's pose at each row of joint values."""
    from armsight.app.arm_files import arm_source
    from armsight.app.kinematics import write_poses_of_joints as run

    done = run(arm_source(arm, tip=tip, base=base), joints, out, table)
    beyond = f", {done.n_beyond_limits} of them beyond limits" if done.n_beyond_limits else ""
    face.say(f"{done.n} poses of {done.arm}{beyond}: {out}")
    _say_notes(face, done.notes)
    face.result(done)


@command(kinematics, streamed=True)
def ik(
    face: CommandUI,
    *,
    arm: ArmFile,
    poses: Poses,
    out: Out,
    near: Near = None,
    every: Every = False,
    task: TaskName = None,
    tip: Tip = None,
    base: Base = None,
    table: Table,
) -> None:
    """Write the joint values that bring the tool to each pose."""
    from armsight.app.arm_files import arm_source
    from armsight.app.kinematics import write_joints_of_poses as run

    done = run(arm_source(arm, tip=tip, base=base), poses, out, near=near, every=every, task=task, format_=table)
    counts = ", ".join(f"{count} {status}" for status, count in done.status.items())
    face.say(f"{done.n} poses of {done.arm} ({counts}): {out}")
    if every:
        left = f", {done.n_beyond_limits} more beyond limits are left out" if done.n_beyond_limits else ""
        more = "" if done.complete else "; found by search: there may be further ones"
        face.say(f"  {done.n_solutions} solutions{left}{more}")
    _say_notes(face, done.notes)
    for entry in done.unsolved[:5]:
        face.say(f"  pose {entry.pose}: {entry.status}, {entry.why}")
    face.result(done)


@command(kinematics, streamed=True)
def jacobian(
    face: CommandUI,
    *,
    arm: ArmFile,
    joints: Joints,
    out: Out,
    axes: Annotated[str, Doc("world, base or tool.")] = "world",
    tip: Tip = None,
    base: Base = None,
    table: Table,
) -> None:
    """Write the Jacobian at each row of joint values: t_s, J11 .. J6n."""
    from armsight.app.arm_files import arm_source
    from armsight.app.kinematics import write_jacobians as run

    done = run(arm_source(arm, tip=tip, base=base), joints, out, axes=axes, format_=table)
    face.say(f"{done.n} Jacobians of {done.arm} in {done.axes} axes: {out}")
    _say_notes(face, done.notes)
    face.result(done)


@command(kinematics, streamed=True)
def path(
    face: CommandUI,
    *,
    arm: ArmFile,
    poses: Poses,
    out: Out,
    start: Start = None,
    task: TaskName = None,
    tip: Tip = None,
    base: Base = None,
    table: Table,
) -> None:
    """Write a continuous joint track along a path, and tell jumps, speeds, limits and singular passages."""
    from armsight.app.arm_files import arm_source
    from armsight.app.kinematics import write_joint_path as run

    done = run(arm_source(arm, tip=tip, base=base), poses, out, start=start, task=task, format_=table)
    branch = f" on the branch {', '.join(done.branch)}" if done.branch else ""
    face.say(f"{done.n_reached} of {done.n} poses of {done.arm} reached{branch}: {out}")
    _say_notes(face, done.notes)
    for issue in done.issues:
        face.say(f"  {issue.text}")
    face.result(done)


@command(kinematics)
def formulas(face: CommandUI, arm: ArmFile, out: Out, tip: Tip = None, base: Base = None) -> None:
    """Write forward kinematics and Jacobian as Python (.py) or LaTeX (.tex)."""
    from armsight.app.arm_files import arm_source
    from armsight.app.kinematics import write_formulas

    done = write_formulas(arm_source(arm, tip=tip, base=base), out)
    face.say(f"formulas of {done.arm}: {out}")
    face.result(done)


@command(kinematics)
def show(
    face: CommandUI,
    arm: ArmFile,
    out: Out = Path("arm.html"),
    joints: Annotated[str | None, Doc("joints.csv, or values as 0,-1.2,0.4. [default: middle of the ranges]")] = None,
    tip: Tip = None,
    base: Base = None,
) -> None:
    """Write a page with the arm in three dimensions."""
    from armsight.app.arm_files import arm_source
    from armsight.app.kinematics import draw_arm

    done = draw_arm(arm_source(arm, tip=tip, base=base), out, joints=joints)
    face.say(f"{done.arm}: {out}")
    _say_notes(face, done.notes)
    face.result(done)


@command(convert, "arm")
def convert_arm(
    face: CommandUI,
    source: Annotated[str, Doc(f"{KNOWN_ARM}."), Flag(positional=True, metavar="FILE")],
    out: Annotated[Path, Doc("File to write: .yaml or .urdf."), OUT],
    convention: Annotated[str | None, Doc("standard or craig, for arm.yaml.")] = None,
    tip: Tip = None,
    base: Base = None,
) -> None:
    """Convert an arm between arm.yaml and URDF, and between the two Denavit-Hartenberg conventions."""
    from armsight.app.arm_files import arm_source
    from armsight.app.arm_files import convert_arm as run

    done = run(arm_source(source, tip=tip, base=base), out, convention=convention)
    face.say(f"{done.arm}, {done.joints} joints: {out}")
    _say_notes(face, done.notes)
    face.result(done)
