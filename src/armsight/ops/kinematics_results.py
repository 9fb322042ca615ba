"""What a person does with an arm: poses of joints, joints of poses, Jacobians, tracks, formulas, pictures."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Annotated

import numpy as np
from scipy.spatial.transform import Rotation

from armsight.arrays import Array
from armsight.errors import Inconsistent, UsageError
from armsight.fields import Doc
from armsight.kinematics import (
    Arm,
    Inverse,
    Status,
    Task,
    fk,
    fk_jacobian,
    ik,
    parameter_jacobian,
    parameter_names,
    pose,
)
from armsight.kinematics.numeric import start_values, task_of
from armsight.kinematics.path import Issue
from armsight.ops.arm_files import NOTES, arm_notes
from armsight.ops.sources.bags import columns_of, joint_states
from armsight.records import Motion, PoseStatus, TargetPose
from armsight.records.output import Output, output
from armsight.shown import Shown
from armsight.store import read_joints, write_joints, write_poses
from armsight.store.atomic import TextOutput
from armsight.store.bags import JointStates, is_bag
from armsight.store.interpret import OURS, TableFormat, largest, looks_like_degrees
from armsight.store.tables import cells, number

ROWS_AT_ONCE = 4096
"""Derivatives by all parameters take some 2 kB a row."""

ROTATION_HELD = 1e-5
"""rad: tracks that turn the tool so near to the path's poses hold them."""


@output
class OfArm(TextOutput):
    """What is said of an arm in every result. headline: what a terminal shows first, with the file that is written."""

    arm: Annotated[str, Doc("The arm's name.")]
    notes: Annotated[tuple[str, ...], NOTES]
    headline: str

    def summary(self) -> Iterator[Shown]:
        """Yield what a terminal shows of it."""
        yield self.headline
        for note in self.notes:
            yield f"  {note}"


@output
class FkOutput(OfArm):
    """armsight kinematics fk."""

    n: Annotated[int, Doc("Rows.")]
    n_beyond_limits: Annotated[int, Doc("Rows with a joint beyond its limits.")]
    model: Arm
    motion: Motion

    def write(self, path: Path) -> None:
        """Write poses.csv: T_world_tool with the deviations that the arm's parameters leave."""
        q = self.motion.q
        rows = zip(self.motion.t_s, pose(self.model, q).as_matrix(), left_open(self.model, q), strict=True)
        write_poses(
            path,
            (
                TargetPose(t_s=float(t), status=PoseStatus.OK, parent="world", T_parent_target=T, covariance=C)
                for t, T, C in rows
            ),
        )


@output
class JacobianOutput(OfArm):
    """armsight kinematics jacobian."""

    n: Annotated[int, Doc("Rows.")]
    axes: Annotated[str, Doc("Axes of the Jacobian: world, base or tool.")]


@output
class UnsolvedPose(Output):
    """A pose without a solution."""

    pose: Annotated[int, Doc("The pose, from 0.")]
    status: Annotated[str, Doc("out_of_reach, limits, no_solution; or position_only, where the rotation is missed.")]
    why: Annotated[str, Doc("Why, in words.")]


@output
class IkOutput(OfArm):
    """armsight kinematics ik."""

    n: Annotated[int, Doc("Poses.")]
    status: Annotated[
        dict[str, int], Doc("Poses by status: ok, position_only, out_of_reach, singular, limits, no_solution.")
    ]
    n_solutions: Annotated[int, Doc("Solutions within limits, of all poses.")]
    n_beyond_limits: Annotated[int, Doc("Solutions left out because a joint would be beyond a limit.")]
    complete: Annotated[bool, Doc("Whether these are all: true where a closed form gives them.")]
    unsolved: Annotated[list[UnsolvedPose], Doc("Poses without a solution.")]
    every: bool

    def summary(self) -> Iterator[Shown]:
        """Yield what a terminal shows of it."""
        first, *notes = OfArm.summary(self)
        yield first
        if self.every:
            left = f", {self.n_beyond_limits} more beyond limits are left out" if self.n_beyond_limits else ""
            more = "" if self.complete else "; found by search: there may be further ones"
            yield f"  {self.n_solutions} solutions{left}{more}"
        yield from notes
        for entry in self.unsolved[:5]:
            yield f"  pose {entry.pose}: {entry.status}, {entry.why}"


@output
class PathOutput(OfArm):
    """armsight kinematics path."""

    n: Annotated[int, Doc("Poses of the path.")]
    n_reached: Annotated[int, Doc("Poses from the start that were reached.")]
    branch: Annotated[list[str], Doc("The branch of the solution; empty without a closed form.")]
    issues: Annotated[tuple[Issue, ...], Doc("What is wrong with the path.")]
    motion: Motion | None

    def summary(self) -> Iterator[Shown]:
        """Yield what a terminal shows of it."""
        yield from OfArm.summary(self)
        for issue in self.issues:
            yield f"  {issue.text}"

    def write(self, path: Path) -> None:
        """Write joints.csv, where a pose was reached."""
        if self.motion is not None:
            write_joints(path, self.motion)


@output
class FormulasOutput(TextOutput):
    """armsight kinematics formulas."""

    arm: Annotated[str, Doc("The arm's name.")]
    file: Annotated[str, Doc("The file written.")]

    def summary(self) -> Iterator[Shown]:
        """Yield what a terminal shows of it."""
        yield f"formulas of {self.arm}: {self.file}"


@output
class ShowOutput(OfArm):
    """armsight kinematics show."""

    file: Annotated[str, Doc("The page written.")]
    tool_xyz_m: Annotated[tuple[float, float, float], Doc("Where the tool is, in world axes, m.")]


def read_values(arm: Arm, path: Path, format_: TableFormat | None = None) -> Motion:
    """Return joints.csv or bag:FILE:/topic, which hold a controller's readings, as the joints' own values.

    Rows without times are counted: none of the commands here asks for the time.
    """
    if is_bag(str(path)):
        motion = _of_arm(arm, joint_states(str(path)))
    else:
        motion = read_joints(path, (format_ or OURS).of_arm(arm), timed=False)
    return Motion(t_s=motion.t_s, q=arm.values(motion.q))


def _of_arm(arm: Arm, states: JointStates) -> Motion:
    """Return joint states in the order of the arm's joints, by name; drivers publish them in any order."""
    read = [i for i, joint in enumerate(arm.joints) if joint.driven or joint.name in states.names]
    q = np.zeros((len(states.motion.t_s), arm.n))
    q[:, read] = states.motion.q[:, columns_of([arm.joints[i].name for i in read], states.names)]
    return Motion(t_s=states.motion.t_s, q=q)


def left_open(arm: Arm, q: Array) -> Iterator[Array]:
    """Yield at each row of q (m, n) the covariance (6, 6) of T_world_tool that the arm's own parameters leave.

    Of a calibrated arm's geometry; zeros where the arm's file tells none. Base and tool count as known.
    """
    names = parameter_names(arm)
    known = () if arm.covariance is None else tuple(name for name in arm.covariance.names if name in names)
    for first in range(0, len(q), ROWS_AT_ONCE):
        rows = q[first : first + ROWS_AT_ONCE]
        if arm.covariance is None or not known:
            yield from np.zeros((len(rows), 6, 6))
            continue
        J = parameter_jacobian(arm, rows)[1][:, :, [names.index(name) for name in known]]
        yield from J @ arm.covariance.block(known) @ np.swapaxes(J, 1, 2)


def jacobian_table(arm: Arm, motion: Motion, axes: str) -> str:
    """Return the geometric Jacobians at rows of joint values, by the readings' rates: t_s, then J11..J6n row by row."""
    if axes not in ("world", "base", "tool"):
        raise UsageError(f"the axes {axes!r} are not known", cure="Use world, base or tool")
    J = fk_jacobian(arm, motion.q, axes=axes)[1] @ arm.gearing  # type: ignore[arg-type]  # checked above
    header = ["t_s", *(f"J{r + 1}{c + 1}" for r in range(6) for c in range(arm.n))]
    rows = (f"{number(t)},{cells(row.ravel().tolist())}" for t, row in zip(motion.t_s, J, strict=True))
    return "\n".join([",".join(header), *rows]) + "\n"


def solved(
    arm: Arm, targets: Sequence[TargetPose], starts: Array | None, *, every: bool, task: str | None, saved: str
) -> IkOutput:
    """Return solutions: pose, solution, q1..qn, error_m, error_rad, status; one row per pose, or all of them.

    Beyond limits none is told; the result counts them, and says whether there may be further ones. starts (m, n): to be
    near to; without them each pose is solved near the one before. Poses without a solution get one row with empty
    joint values; the reason is its status, and in words in the result.
    """
    aim = task_of(arm, task)
    here = start_values(arm, None)
    rows, counts, unsolved = [], Counter[str](), []
    within, beyond, complete = 0, 0, True
    for k, target in enumerate(targets):
        here = starts[k] if starts is not None else here
        answer = _solve(arm, target, here, aim)
        counts[answer.status.value] += 1
        if answer.why and answer.status not in (Status.OK, Status.SINGULAR):
            unsolved.append(UnsolvedPose(pose=k, status=answer.status.value, why=answer.why))
        rows += _rows(arm, k, answer, every)
        within, beyond = within + len(answer.solutions), beyond + len(answer.beyond_limits)
        complete &= answer.complete
        if answer.solutions:
            here = answer.solutions[0].q
    header = ["pose", "solution", *(f"q{i + 1}" for i in range(arm.n)), "error_m", "error_rad", "status"]
    told = ", ".join(f"{count} {status}" for status, count in counts.items())
    return IkOutput(
        arm=arm.name,
        notes=arm_notes(arm),
        headline=f"{len(targets)} poses of {arm.name} ({told}): {saved}",
        content="\n".join([",".join(header), *rows]) + "\n",
        n=len(targets),
        status=dict(counts),
        n_solutions=within,
        n_beyond_limits=beyond,
        complete=complete,
        unsolved=unsolved,
        every=every,
    )


def starts_of(arm: Arm, near: Path | None, poses: int) -> Array | None:
    """Return the joint values that each pose is to be near to (m, n), of a joints.csv with one row or so many."""
    if near is None:
        return None
    q = read_values(arm, near).q
    if len(q) not in (1, poses):
        raise Inconsistent(
            f"{near} has {len(q)} rows for {poses} poses", cure="Give one row for all, or one for each pose"
        )
    return np.broadcast_to(q, (poses, arm.n)) if len(q) == 1 else q


def _solve(arm: Arm, target: TargetPose, here: Array, aim: Task) -> Inverse:
    """Return the solutions of one row of poses.csv; a row that holds too little has none."""
    enough = target.pose is not None and (
        target.status is PoseStatus.OK or (target.status is PoseStatus.POSITION_ONLY and aim is Task.POSITION)
    )
    if not enough or target.pose is None:
        why = f"the pose is {target.status}"
        return Inverse(solutions=(), beyond_limits=(), status=Status.NO_SOLUTION, why=why, complete=False)
    return ik(arm, target.pose, here, task=aim)


def _rows(arm: Arm, k: int, answer: Inverse, every: bool) -> list[str]:
    solutions = answer.solutions if every else answer.solutions[:1]
    out = []
    for i, solution in enumerate(solutions):
        status = Status.SINGULAR if solution.singular else Status.OK
        status = answer.status if answer.status is Status.POSITION_ONLY else status
        values = cells([*arm.readings(solution.q).tolist(), solution.error_m, solution.error_rad])
        out.append(f"{k},{i},{values},{status}")
    return out or [f"{k},," + "," * (arm.n + 2) + answer.status.value]


def require_whole(where: Path, targets: Sequence[TargetPose]) -> None:
    """Raise Inconsistent for a path with a pose that is not known."""
    for k, target in enumerate(targets):
        if target.status is not PoseStatus.OK:
            raise Inconsistent(
                f"{where}: row {k} is {target.status}",
                consequence="The path has a hole there",
                cure="Leave such rows out",
            )


def turned(arm: Arm, q: Array, T: Array, task: str | None) -> tuple[str, ...]:
    """Return by how much a track q (k, n) of few joints turns the tool otherwise than the poses T (m, 4, 4) want."""
    if arm.n >= 6 or task is not None or not len(q):
        return ()
    turned = Rotation.from_matrix(np.swapaxes(T[: len(q), :3, :3], 1, 2) @ fk(arm, q)[:, :3, :3])
    off = float(turned.magnitude().max())
    if off < ROTATION_HELD:
        return ()
    return (
        f"{arm.n} joints hold the path's positions alone: the tool is turned up to {np.rad2deg(off):.3g} deg from it",
    )


def formulas_of(arm: Arm, name: str) -> str:
    """Return forward kinematics and Jacobian as formulas: Python for a name that ends in .py, LaTeX for .tex.

    Raises UsageError, Inconsistent.
    """
    from armsight.kinematics.symbolic import latex_source, python_source  # sympy takes a third of a second to load

    suffix = Path(name).suffix.lower()
    if suffix not in (".py", ".tex"):
        raise UsageError(f"{name} ends in neither .py nor .tex", cure="Choose one of them")
    if not arm.direct:
        raise Inconsistent(
            f"the joints of {arm.name} are not where its controller shows them: readings are coupled, or joints sag",
            consequence="The formulas, which are of the joints' own values, would be taken for those of the readings",
            cure="Leave `coupled` and `compliance` out of a copy of the file; give the formulas the joints' own values",
        )
    return python_source(arm) if suffix == ".py" else latex_source(arm)


def reading_values(arm: Arm, text: str) -> Array:
    """Return readings (n,) written as 0,-1.2,0.4, or those of the first row of a joints.csv; UsageError, BadFile."""
    if re.fullmatch(r"[-+0-9.eE, ]+", text):
        return _numbers(arm, text)
    return np.asarray(arm.readings(read_values(arm, Path(text)).q)[0])


def joint_values(arm: Arm, text: str) -> Array:
    """Return the joints' own values, (n,) of readings written as 0,-1.2,0.4, or (m, n) of a joints.csv."""
    if re.fullmatch(r"[-+0-9.eE, ]+", text):
        return arm.values(_numbers(arm, text))
    return read_values(arm, Path(text)).q


def _numbers(arm: Arm, text: str) -> Array:
    """Return readings written as 0,-1.2,0.4; UsageError where they are none, or look like degrees."""
    try:
        readings = np.array([float(part) for part in text.replace(",", " ").split()])
    except ValueError as error:
        raise UsageError(f"{text!r} are not joint values", cure="Write for instance 0,-1.2,0.4") from error
    turning = arm.revolute if len(arm.revolute) == len(readings) else np.ones(len(readings), bool)
    if looks_like_degrees(readings[None, turning]):
        raise UsageError(
            f"the joint values {text!r} look like degrees: the largest is {largest(readings):g}",
            consequence="They are not used",
            cure="Give radians, for instance 0,-1.2,0.4",
        )
    return readings
