"""A whole path checked for an arm before anything moves."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import Annotated, SupportsInt

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.arrays import Array
from armsight.control.guard.limits import Limits, joint_bounds
from armsight.control.paths.outliers import path_jumps
from armsight.errors import NotEnoughData, UsageError
from armsight.fields import Doc
from armsight.kinematics import Arm, JointPath, track_path
from armsight.kinematics.closed_form import singularity_distance
from armsight.kinematics.path import JUMP
from armsight.records import TaughtPath, freeze
from armsight.records.output import Output, output

SLACK = 1e-9
"""What is beyond a limit by less (rad, m, or per s) is at it."""


class PathTrouble(StrEnum):
    """What can keep an arm from a path."""

    UNREACHED = "unreached"
    LIMITS = "limits"
    JUMP = "jump"
    SPEED = "speed"
    TURN = "turn"
    JOINT_SPEED = "joint_speed"
    SINGULAR = "singular"
    BRANCH = "branch"
    WORKSPACE = "workspace"
    FORBIDDEN = "forbidden"


SLOWED = frozenset({PathTrouble.SPEED, PathTrouble.TURN, PathTrouble.JOINT_SPEED})
"""What keeps no arm from its path: play goes slower there."""


@output
class PathIssue(Output):
    """Trouble at a row of a path, or on the way to it; value and limit: NaN where there is none."""

    row: Annotated[int, Doc("The row, from 0.")]
    trouble: Annotated[
        PathTrouble,
        Doc("unreached, limits, jump, speed, turn, joint_speed, singular, branch, workspace or forbidden."),
    ]
    value: Annotated[float, Doc("How much there, rad, m, or per s; of a singularity its distance.", nullable=True)]
    limit: Annotated[float, Doc("What is allowed, in the same unit.", nullable=True)]
    text: Annotated[str, Doc("The same in words.")]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PathCheck:
    """What a path asks of an arm: readings q (k, n) of its first k of rows poses at t_s (rows,), and all trouble.

    t_s: from the path's speeds, 0 at the first row. joint_speed (k - 1, n): of the steps between rows.
    """

    rows: int
    q: Array
    t_s: Array
    joint_speed: Array
    issues: tuple[PathIssue, ...]

    def __post_init__(self) -> None:
        freeze(self, q=self.q.shape, t_s=self.t_s.shape, joint_speed=self.joint_speed.shape)

    @property
    def ok(self) -> bool:
        """Whether every row is reached without trouble, but for speeds that play lowers."""
        return len(self.q) == self.rows and all(issue.trouble in SLOWED for issue in self.issues)


def check_path(
    path: TaughtPath,
    arm: Arm,
    limits: Limits,
    *,
    T_base_world: RigidTransform | None = None,
    speed_m_s: float | None = None,
    start: ArrayLike | None = None,
    taught: bool = True,
) -> PathCheck:
    """Return what is wrong with a path for an arm, row by row, before any motion; ok where nothing is.

    Checked at the rows: reach, the joints' ranges, singularity, boxes of tool and flange; between rows: jumps, speeds
    of tool and joints. Boxes are also checked along straight tool ways between rows. T_base_world: of a path in world;
    None: the arm's own base. speed_m_s: where the path leaves it open, the limits' where None. start (n,): readings
    where the arm stands, for the branch. taught: whether the rows are a path's own, in which outliers and steps that
    nobody led are jumps too, and not samples. Raises NotEnoughData for an empty path, UsageError for a speed that is
    none or a frame that is neither world nor base.
    """
    if not len(path):
        raise NotEnoughData("the path has no rows", consequence="It is not checked")
    T_base_tip = _in_base(path, arm, T_base_world)
    t_s, speed = _times(path, limits, speed_m_s)
    bounds = joint_bounds(arm, limits)
    values = None if start is None else arm.values(np.asarray(start, dtype=np.float64))
    track = track_path(arm, arm.T_world_base.as_matrix() @ T_base_tip, start=values)
    q = np.asarray(arm.readings(track.q))
    joint_speed = np.abs(np.diff(q, axis=0)) / np.diff(t_s[: len(q)])[:, None] if len(q) > 1 else np.empty((0, arm.n))
    issues = [
        *_tracked(track),
        *_tool(T_base_tip, t_s, speed, limits),
        *_joints(arm, q, joint_speed, bounds.lower, bounds.upper, bounds.speed),
        *_singular(arm, track.q, limits),
        *_boxes(arm, T_base_tip, limits),
        *(_issue(jump.row, PathTrouble.JUMP, jump.text, jump.size) for jump in (path_jumps(path) if taught else ())),
    ]
    ordered = tuple(sorted(issues, key=lambda issue: issue.row))
    return PathCheck(rows=len(path), q=q, t_s=t_s, joint_speed=joint_speed, issues=ordered)


def _in_base(path: TaughtPath, arm: Arm, T_base_world: RigidTransform | None) -> Array:
    if path.parent == "base":
        return path.T_world_tip
    if path.parent != "world":
        raise UsageError(
            f"the path is in the frame {path.parent!r}",
            consequence="Nobody can tell where the arm would go",
            cure="Give it in world or base",
        )
    T = arm.T_world_base.inv() if T_base_world is None else T_base_world
    return np.asarray(T.as_matrix() @ path.T_world_tip)


def _times(path: TaughtPath, limits: Limits, speed_m_s: float | None) -> tuple[Array, Array]:
    """Return the times (n,) of the rows and the speed (n - 1,) of each step; turns in place take what limits allow."""
    open_speed = limits.speed_m_s if speed_m_s is None else speed_m_s
    if not (np.isfinite(open_speed) and open_speed > 0.0):
        raise UsageError(f"the speed {open_speed:g} m/s is not positive")
    speed = np.where(np.isfinite(path.speed_m_s), path.speed_m_s, open_speed)[:-1]
    took = np.diff(path.length_m) / speed
    turn = _turns(path.T_world_tip)
    took = np.where(took > 0.0, took, np.maximum(turn / limits.turn_rad_s, 1e-3))
    return np.concatenate([[0.0], np.cumsum(took)]), speed


def _turns(T: Array) -> Array:
    """Return the angle (n - 1,) of each step in rad."""
    R = Rotation.from_matrix(T[:, :3, :3])
    return np.asarray((R[1:] * R[:-1].inv()).magnitude()) if len(T) > 1 else np.empty(0)


def _tracked(track: JointPath) -> list[PathIssue]:
    kinds = ("unreached", "jump", "branch", "singular")
    issues = []
    for found in track.issues:
        if found.trouble.value not in kinds:
            continue
        rows = range(found.first, found.last + 1)
        for row in rows:
            text = found.text if row in (found.worst, found.first) else f"{found.trouble.value} as at row {found.worst}"
            issues.append(
                PathIssue(
                    row=row,
                    trouble=PathTrouble(found.trouble.value),
                    text=text,
                    value=found.value,
                    limit=found.limit,
                )
            )
    return issues


def _tool(T: Array, t_s: Array, speed: Array, limits: Limits) -> list[PathIssue]:
    """Return where the tool would go or turn too fast, and neighbours that are far apart in rotation."""
    issues = []
    turn = _turns(T)
    took = np.diff(t_s)
    for row in np.flatnonzero(speed > limits.speed_m_s + SLACK):
        text = f"row {row + 1}: the tool would go at {speed[row]:.4g} m/s; {limits.speed_m_s:.4g} is allowed"
        issues.append(_issue(row + 1, PathTrouble.SPEED, text, speed[row], limits.speed_m_s))
    for row in np.flatnonzero(turn / took > limits.turn_rad_s + SLACK):
        rate = turn[row] / took[row]
        text = f"row {row + 1}: the tool would turn at {rate:.4g} rad/s; {limits.turn_rad_s:.4g} is allowed"
        issues.append(_issue(row + 1, PathTrouble.TURN, text, rate, limits.turn_rad_s))
    for row in np.flatnonzero(turn > JUMP):
        text = f"row {row + 1}: the tool turns by {turn[row]:.3g} rad in one step"
        issues.append(_issue(row + 1, PathTrouble.JUMP, text, turn[row], JUMP))
    return issues


def _joints(arm: Arm, q: Array, rate: Array, lower: Array, upper: Array, fastest: Array) -> list[PathIssue]:
    issues = []
    own = arm.values(q) if len(q) else q
    low, high = np.maximum(lower - q, arm.lower - own), np.maximum(q - upper, own - arm.upper)
    for row, i in np.argwhere(np.maximum(low, high) > SLACK):
        limit = lower[i] if low[row, i] > high[row, i] else upper[i]
        text = f"row {row}: {arm.joints[i].name} would stand at {q[row, i]:.4g}, beyond {limit:.4g}"
        issues.append(_issue(row, PathTrouble.LIMITS, text, q[row, i], limit))
    for row, i in np.argwhere(rate > fastest + SLACK):
        text = f"row {row + 1}: {arm.joints[i].name} would run at {rate[row, i]:.4g} per s; {fastest[i]:.4g} is allowed"
        issues.append(_issue(row + 1, PathTrouble.JOINT_SPEED, text, rate[row, i], fastest[i]))
    return issues


def _singular(arm: Arm, values: Array, limits: Limits) -> list[PathIssue]:
    if not len(values):
        return []
    near = np.atleast_1d(singularity_distance(arm, values))
    return [
        _issue(
            row,
            PathTrouble.SINGULAR,
            f"row {row}: {near[row]:.3g} from a singularity; {limits.singularity:.3g} is kept",
            near[row],
            limits.singularity,
        )
        for row in np.flatnonzero(near < limits.singularity)
    ]


def _boxes(arm: Arm, T_base_tip: Array, limits: Limits) -> list[PathIssue]:
    T_base_flange = T_base_tip @ arm.T_flange_tool.inv().as_matrix()
    issues = []
    for name, xyz in (("tool", T_base_tip[:, :3, 3]), ("flange", T_base_flange[:, :3, 3])):
        before = np.concatenate([xyz[:1], xyz[:-1]])
        if limits.workspace is not None:
            space = limits.workspace
            out = np.maximum(space.lower_m + limits.margin_m - xyz, xyz - space.upper_m + limits.margin_m).max(axis=1)
            for row in np.flatnonzero(out > SLACK):
                text = f"row {row}: the {name} is outside the workspace {space.name} by {out[row]:.4g} m"
                issues.append(_issue(row, PathTrouble.WORKSPACE, text, out[row], 0.0))
        for box in limits.forbidden:
            lower, upper = box.lower_m - limits.margin_m, box.upper_m + limits.margin_m
            for row in np.flatnonzero(_through(before, xyz, lower, upper)):
                text = f"row {row}: the {name} is in the forbidden box {box.name}, or passes it on the way there"
                issues.append(_issue(row, PathTrouble.FORBIDDEN, text))
    return issues


def _through(a: Array, b: Array, lower: Array, upper: Array) -> NDArray[np.bool_]:
    """Tell which segments from a to b (n, 3) meet a box, by slabs (Kay, Kajiya 1986)."""
    way = b - a
    flat = way == 0.0
    safe = np.where(flat, 1.0, way)
    one, other = (lower - a) / safe, (upper - a) / safe
    inside = (a > lower) & (a < upper)
    enter = np.where(flat, np.where(inside, -np.inf, np.inf), np.minimum(one, other)).max(axis=1)
    leave = np.where(flat, np.where(inside, np.inf, -np.inf), np.maximum(one, other)).min(axis=1)
    return np.asarray((enter < leave) & (leave > 0.0) & (enter < 1.0))


def _issue(
    row: SupportsInt, trouble: PathTrouble, text: str, value: float = np.nan, limit: float = np.nan
) -> PathIssue:
    return PathIssue(row=int(row), trouble=trouble, text=text, value=float(value), limit=float(limit))
