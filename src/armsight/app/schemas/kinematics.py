"""kinematics fk, ik, jacobian, path, formulas, show; convert arm."""

from __future__ import annotations

from typing import Annotated

from armsight.records.fields import Doc
from armsight.records.output import Output, output


@output
class FkOutput(Output):
    """armsight kinematics fk."""

    arm: Annotated[str, Doc("The arm's name.")]
    n: Annotated[int, Doc("Rows.")]
    n_beyond_limits: Annotated[int, Doc("Rows with a joint beyond its limits.")]


@output
class JacobianOutput(Output):
    """armsight kinematics jacobian."""

    arm: Annotated[str, Doc("The arm's name.")]
    n: Annotated[int, Doc("Rows.")]
    axes: Annotated[str, Doc("Axes of the Jacobian: world, base or tool.")]


@output
class UnsolvedPose(Output):
    """A pose without a solution."""

    pose: Annotated[int, Doc("The pose, from 0.")]
    status: Annotated[str, Doc("out_of_reach, limits or no_solution.")]
    why: Annotated[str, Doc("Why, in words.")]


@output
class IkOutput(Output):
    """armsight kinematics ik."""

    arm: Annotated[str, Doc("The arm's name.")]
    n: Annotated[int, Doc("Poses.")]
    status: Annotated[dict[str, int], Doc("Poses by status: ok, out_of_reach, singular, limits, no_solution.")]
    unsolved: Annotated[list[UnsolvedPose], Doc("Poses without a solution.")]


@output
class PathIssue(Output):
    """Something wrong with a joint path."""

    kind: Annotated[str, Doc("jump, speed, limits, singular, branch or unreached.")]
    first: Annotated[int, Doc("Where it begins, row from 0.")]
    last: Annotated[int, Doc("Where it ends, row from 0.")]
    worst: Annotated[int, Doc("Where it is worst, row from 0.")]
    joint: Annotated[str, Doc("The joint's name; empty where it concerns the arm.")]
    value: Annotated[float, Doc("How much there, rad, m, rad/s or m/s; of a singular passage its measure.")]
    limit: Annotated[float, Doc("What is allowed, in the same unit.")]
    text: Annotated[str, Doc("The same in words.")]


@output
class PathOutput(Output):
    """armsight kinematics path."""

    arm: Annotated[str, Doc("The arm's name.")]
    n: Annotated[int, Doc("Poses of the path.")]
    n_reached: Annotated[int, Doc("Poses from the start that were reached.")]
    branch: Annotated[list[str], Doc("The branch of the solution; empty without a closed form.")]
    issues: Annotated[list[PathIssue], Doc("What is wrong with the path.")]


@output
class FormulasOutput(Output):
    """armsight kinematics formulas."""

    arm: Annotated[str, Doc("The arm's name.")]
    file: Annotated[str, Doc("The file written.")]


@output
class ShowOutput(Output):
    """armsight kinematics show."""

    arm: Annotated[str, Doc("The arm's name.")]
    file: Annotated[str, Doc("The page written.")]
    tool_xyz_m: Annotated[tuple[float, float, float], Doc("Where the tool is, in world axes, m.")]


@output
class ConvertArmOutput(Output):
    """armsight convert arm."""

    arm: Annotated[str, Doc("The arm's name.")]
    file: Annotated[str, Doc("The file written.")]
    joints: Annotated[int, Doc("How many joints.")]
    convention: Annotated[str, Doc("standard or craig.")]
