"""kinematics fk, ik, jacobian, path, formulas, show; convert arm."""

from __future__ import annotations

from pydantic import Field

from armsight.app.schemas.base import Output


class FkOutput(Output):
    """armsight kinematics fk."""

    arm: str = Field(description="The arm's name.")
    n: int = Field(description="Rows.")
    n_beyond_limits: int = Field(description="Rows with a joint beyond its limits.")


class JacobianOutput(Output):
    """armsight kinematics jacobian."""

    arm: str = Field(description="The arm's name.")
    n: int = Field(description="Rows.")
    axes: str = Field(description="Axes of the Jacobian: world, base or tool.")


class UnsolvedPose(Output):
    """A pose without a solution."""

    pose: int = Field(description="The pose, from 0.")
    status: str = Field(description="out_of_reach, limits or no_solution.")
    why: str = Field(description="Why, in words.")


class IkOutput(Output):
    """armsight kinematics ik."""

    arm: str = Field(description="The arm's name.")
    n: int = Field(description="Poses.")
    status: dict[str, int] = Field(description="Poses by status: ok, out_of_reach, singular, limits, no_solution.")
    unsolved: list[UnsolvedPose] = Field(description="Poses without a solution.")


class PathIssue(Output):
    """Something wrong with a joint path."""

    kind: str = Field(description="jump, speed, limits, singular, branch or unreached.")
    first: int = Field(description="Where it begins, row from 0.")
    last: int = Field(description="Where it ends, row from 0.")
    worst: int = Field(description="Where it is worst, row from 0.")
    joint: str = Field(description="The joint's name; empty where it concerns the arm.")
    value: float = Field(description="How much there, rad, m, rad/s or m/s; of a singular passage its measure.")
    limit: float = Field(description="What is allowed, in the same unit.")
    text: str = Field(description="The same in words.")


class PathOutput(Output):
    """armsight kinematics path."""

    arm: str = Field(description="The arm's name.")
    n: int = Field(description="Poses of the path.")
    n_reached: int = Field(description="Poses from the start that were reached.")
    branch: list[str] = Field(description="The branch of the solution; empty without a closed form.")
    issues: list[PathIssue] = Field(description="What is wrong with the path.")


class FormulasOutput(Output):
    """armsight kinematics formulas."""

    arm: str = Field(description="The arm's name.")
    file: str = Field(description="The file written.")


class ShowOutput(Output):
    """armsight kinematics show."""

    arm: str = Field(description="The arm's name.")
    file: str = Field(description="The page written.")
    tool_xyz_m: tuple[float, float, float] = Field(description="Where the tool is, in world axes, m.")


class ConvertArmOutput(Output):
    """armsight convert arm."""

    arm: str = Field(description="The arm's name.")
    file: str = Field(description="The file written.")
    joints: int = Field(description="How many joints.")
    convention: str = Field(description="standard or craig.")
