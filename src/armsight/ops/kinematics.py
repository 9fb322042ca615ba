"""What a person does with an arm: poses of joints, joints of poses, Jacobians, tracks, formulas, pictures."""

from __future__ import annotations

from os import fspath
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeAlias

from armsight.fields import Doc, Flag
from armsight.ops.action import action
from armsight.ops.flags import AN_ARM, KNOWN_ARM, OUT, Base, Table, Tip
from armsight.ops.kinds import CHAIN, AsFile, Readings

if TYPE_CHECKING:
    from armsight.ops.kinematics_results import (
        FkOutput,
        FormulasOutput,
        IkOutput,
        JacobianOutput,
        PathOutput,
        ShowOutput,
    )

__all__ = ["show_arm", "write_formulas"]

ArmChain: TypeAlias = Annotated[Any, Doc(f"{KNOWN_ARM}."), CHAIN, AN_ARM]
Joints: TypeAlias = Annotated[AsFile, Doc("joints.csv: t_s, q1 .. qn in rad and m; or bag:FILE:/topic.")]
Poses: TypeAlias = Annotated[AsFile, Doc("poses.csv of the tool in world.")]
Out: TypeAlias = Annotated[Path, Doc("File to write."), OUT]
TaskName: TypeAlias = Annotated[str | None, Doc("pose or position. [default: pose from six joints on]")]


@action("kinematics fk", examples=("--arm arm.yaml --joints joints.csv -o poses.csv",), streamed=True)
def fk(
    arm: ArmChain, joints: Joints, out: Out, *, tip: Tip = None, base: Base = None, table: Table | None = None
) -> FkOutput:
    """Write the tool's pose at each row of joint values."""
    from armsight.ops.arm_files import arm_notes
    from armsight.ops.kinematics_results import FkOutput, read_values

    motion = read_values(arm, joints, table)
    n, beyond = len(motion.t_s), int((~arm.within_limits(motion.q)).sum())
    return FkOutput(
        arm=arm.name,
        notes=arm_notes(arm),
        headline=f"{n} poses of {arm.name}{f', {beyond} of them beyond limits' if beyond else ''}: {out}",
        n=n,
        n_beyond_limits=beyond,
        model=arm,
        motion=motion,
    )


@action("kinematics ik", examples=("--arm ur10e --poses poses.csv -o joints.csv",), streamed=True)
def ik(
    arm: ArmChain,
    poses: Poses,
    out: Out,
    *,
    near: Annotated[AsFile, Doc("joints.csv to be near to: one row, or one per pose.")] = None,
    every: Annotated[bool, Doc("Write every solution, not the nearest alone."), Flag("--all")] = False,
    task: TaskName = None,
    tip: Tip = None,
    base: Base = None,
    table: Table | None = None,
) -> IkOutput:
    """Write the joint values that bring the tool to each pose."""
    from armsight.ops.kinematics_results import solved, starts_of
    from armsight.store import read_poses
    from armsight.store.interpret import OURS

    targets = read_poses(poses, parent="world", format_=table or OURS, timed=False, measured=False)
    return solved(arm, targets, starts_of(arm, near, len(targets)), every=every, task=task, saved=str(out))


@action("kinematics jacobian", examples=("--arm arm.yaml --joints joints.csv -o jacobians.csv",), streamed=True)
def jacobian(
    arm: ArmChain,
    joints: Joints,
    out: Out,
    *,
    axes: Annotated[str, Doc("world, base or tool.")] = "world",
    tip: Tip = None,
    base: Base = None,
    table: Table | None = None,
) -> JacobianOutput:
    """Write the Jacobian at each row of joint values: t_s, J11 .. J6n."""
    from armsight.ops.arm_files import arm_notes
    from armsight.ops.kinematics_results import JacobianOutput, jacobian_table, read_values

    motion = read_values(arm, joints, table)
    return JacobianOutput(
        arm=arm.name,
        notes=arm_notes(arm),
        headline=f"{len(motion.t_s)} Jacobians of {arm.name} in {axes} axes: {out}",
        n=len(motion.t_s),
        axes=axes,
        content=jacobian_table(arm, motion, axes),
    )


@action("kinematics path", examples=("--arm arm.yaml --poses poses.csv -o joints.csv",), streamed=True)
def path(
    arm: ArmChain,
    poses: Poses,
    out: Out,
    *,
    start: Annotated[AsFile, Doc("joints.csv; its first row is where the arm stands.")] = None,
    task: TaskName = None,
    tip: Tip = None,
    base: Base = None,
    table: Table | None = None,
) -> PathOutput:
    """Write a continuous joint track along a path, and tell jumps, speeds, limits and singular passages."""
    import numpy as np

    from armsight.kinematics import track_path
    from armsight.ops.arm_files import arm_notes
    from armsight.ops.kinematics_results import PathOutput, read_values, require_whole, turned
    from armsight.records import Motion
    from armsight.store import read_poses
    from armsight.store.interpret import OURS

    targets = read_poses(poses, parent="world", format_=table or OURS, stream=True, measured=False)
    require_whole(poses, targets)
    t_s = np.array([target.t_s for target in targets])
    T = np.array([target.pose.as_matrix() for target in targets if target.pose is not None])
    first = None if start is None else read_values(arm, start).q[0]
    track = track_path(arm, T, t_s=t_s, start=first, task=task)
    reached, branch = len(track.q), f" on the branch {', '.join(track.branch)}" if track.branch else ""
    return PathOutput(
        arm=arm.name,
        notes=(*arm_notes(arm), *turned(arm, track.q, T, task)),
        headline=f"{reached} of {len(targets)} poses of {arm.name} reached{branch}: {out}",
        n=len(targets),
        n_reached=reached,
        branch=list(track.branch),
        issues=track.issues,
        motion=Motion(t_s=t_s[:reached], q=arm.readings(track.q)) if reached else None,
    )


@action("kinematics formulas", examples=("--arm arm.yaml -o formulas.tex",))
def write_formulas(arm: ArmChain, out: Out, *, tip: Tip = None, base: Base = None) -> FormulasOutput:
    """Write forward kinematics and Jacobian as Python (.py) or LaTeX (.tex).

    Raises
    ------
    UsageError
        Another ending.
    Inconsistent
        The joints are not where the controller shows them.

    Examples
    --------
    >>> armsight.write_formulas("stanford-rrp", folder / "arm.py").arm
    'stanford-rrp'
    """
    from armsight.ops.kinematics_results import FormulasOutput, formulas_of

    return FormulasOutput(arm=arm.name, file=fspath(out), content=formulas_of(arm, Path(out).name))


@action("kinematics show", examples=("--arm ur10e -o arm.html",))
def show_arm(
    arm: ArmChain,
    out: Out = Path("arm.html"),
    *,
    q: Annotated[
        Readings, Doc("joints.csv, or values as 0,-1.2,0.4. [default: middle of the ranges]"), Flag("--joints")
    ] = None,
    tip: Tip = None,
    base: Base = None,
) -> ShowOutput:
    """Write a page with the arm in three dimensions.

    Parameters
    ----------
    q
        Readings (n,), else the middle of the ranges.

    Examples
    --------
    >>> armsight.show_arm(armsight.presets.ur10(), folder / "arm.html").arm
    'ur10'
    """
    import numpy as np

    from armsight.kinematics import fk as forward
    from armsight.kinematics.numeric import start_values
    from armsight.ops.arm_files import arm_notes
    from armsight.ops.kinematics_results import ShowOutput, joint_values
    from armsight.report.arm_view import arm_report

    values = start_values(arm, None) if q is None else joint_values(arm, q)
    xyz = forward(arm, np.atleast_2d(values)[0])[:3, 3].tolist()
    return ShowOutput(
        arm=arm.name,
        notes=arm_notes(arm),
        headline=f"{arm.name}: {out}",
        file=fspath(out),
        tool_xyz_m=xyz,
        content=arm_report(arm, values),
    )
