"""What an inverse problem asks for, and its numeric solution for any chain, also with fewer joints than dimensions."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import RigidTransform

from armsight.arrays import Array, Mask
from armsight.errors import Inconsistent, NotConverged, UsageError
from armsight.kinematics.arm import Arm
from armsight.kinematics.kernels.numeric import (
    CONVERGED,
    DIVERGED,
    LIMITS,
    MINIMUM,
    NO_ROTATION,
    NOT_FINITE,
    SINGULAR,
    STEPS,
    check_poses,
    farthest,
    solve_damped_least_squares,
    solve_many,
    solve_newton,
)
from armsight.records import for_kernels, freeze, real_array

TOLERANCE_M = 1e-6
TOLERANCE_RAD = 1e-6
"""An answer further off is not a solution: arms repeat to tens of micrometres."""

FAR_FACTOR = 100.0
"""A pose this many times the arm's size away is not out of reach but in the wrong unit (mm read as m: 1000 times)."""

SMALLEST_M = 1e-3
"""Arms are taken to be at least this big, so that a chain without lengths has a scale."""

ROTATION_TOLERANCE = 1e-6
"""Rotation matrices whose columns differ from unit and square by more were rounded too much for 1 urad."""


class Task(StrEnum):
    """The whole pose, or the position of the tool's origin alone (arms with fewer than six joints)."""

    POSE = "pose"
    POSITION = "position"


@dataclass(frozen=True, slots=True, kw_only=True)
class Tolerance:
    """How far from the pose an answer may be, in m and rad."""

    m: float = TOLERANCE_M
    rad: float = TOLERANCE_RAD


def task_of(arm: Arm, task: Task | str | None) -> Task:
    """Return the task asked for; without one the pose for six joints and more, else the position."""
    if task is None:
        return Task.POSE if arm.n >= 6 else Task.POSITION
    try:
        return Task(task)
    except ValueError:
        raise UsageError(f"the task {task!r} is not known", cure=f"Use one of: {', '.join(Task)}") from None


def size_m(arm: Arm) -> float:
    """Return the arm's size in m: all lengths and offsets with every finite end of a slide, the tool included."""
    found = arm.found.get("size_m")
    if not isinstance(found, float):
        rows = arm.chain[1:-1]
        ends = np.where(np.isfinite(rows[:, 9:11]), rows[:, 9:11], 0.0)
        prismatic = np.where(arm.revolute, 0.0, np.abs(ends).max(axis=1))
        total = np.abs(rows[:, 3]).sum() + np.abs(rows[:, 4]).sum() + prismatic.sum()
        found = arm.found["size_m"] = float(total + np.linalg.norm(arm.chain[-1, [3, 7, 11]]))
    return found


def target_matrices(arm: Arm, poses: RigidTransform | ArrayLike) -> Array:
    """Return the poses T_world_tool as (m, 4, 4), m = 1 for a single one.

    poses: RigidTransform, (4, 4) or (m, 4, 4). Raises Inconsistent for values that are not finite, for matrices that
    are no rigid motion and for poses so far off that their unit must be wrong; the row (from 0) is named; UsageError
    for an arm with joints that follow others, whose values cannot be chosen one by one.
    """
    if arm.undriven:
        raise UsageError(
            f"joint {arm.joints[arm.undriven[0]].name} of {arm.name} has no drive and follows another",
            consequence="No joint values are given for poses: nobody could send that joint where they want it",
            cure="Give each joint that has a drive of its own driven: true and no coupled in the arm's file",
        )
    T = real_array("the pose", poses.as_matrix() if isinstance(poses, RigidTransform) else poses)
    if T.ndim not in (2, 3) or T.shape[-2:] != (4, 4):
        raise UsageError(
            f"a pose is a 4x4 matrix, not an array of shape {T.shape}",
            cure="Give T_world_tool as (4, 4), (n, 4, 4) or a RigidTransform",
        )
    T = for_kernels(T.reshape(-1, 4, 4))
    fault, row, value = check_poses(T, ROTATION_TOLERANCE)
    if fault == NOT_FINITE:
        raise Inconsistent(
            f"pose {row} holds a value that is not finite", consequence="No joint values are given", cure="Leave it out"
        )
    if fault == NO_ROTATION:
        raise Inconsistent(
            f"the orientation of pose {row} is not a rotation (off by {value:.2g})",
            consequence="No joint values are given",
            cure="Check the order of the columns and their precision",
        )
    distance, row = farthest(T, arm.chain)
    size = size_m(arm)
    if distance > FAR_FACTOR * max(size, SMALLEST_M):
        times = distance / max(size, SMALLEST_M)
        raise Inconsistent(
            f"pose {row} is {distance:.4g} m from the base, {times:.0f} times the size of {arm.name}",
            consequence="No joint values are given",
            cure="Give metres: the numbers look like millimetres",
        )
    return T


def start_values(arm: Arm, q_seed: ArrayLike | None) -> Array:
    """Return near (n,) checked, or the middle of each joint's range (zero where it has none)."""
    if q_seed is not None:
        values = arm.checked(q_seed)
        if values.ndim != 1:
            raise UsageError(
                "the joint values to be near have many rows",
                consequence="Nobody knows which are meant",
                cure="Give one row",
            )
        return values
    known = arm.found.get("middle")
    if not isinstance(known, np.ndarray):
        with np.errstate(invalid="ignore"):
            middle = 0.5 * (arm.lower + arm.upper)
        known = arm.found["middle"] = np.where(np.isfinite(middle), middle, np.clip(0.0, arm.lower, arm.upper))
    return known.copy()


MAX_STEPS = 60
"""Damped least squares takes 3 to 10 steps where it succeeds (benchmarks/kinematics.py)."""

RESTARTS = 30
"""Fresh starts before a pose is given up: a 6R arm has up to 16 solutions, each with its own basin."""


class Stop(StrEnum):
    """Why the solver stopped."""

    CONVERGED = "converged"
    STEPS = "out of steps"
    MINIMUM = "local minimum of the error"
    LIMITS = "held by joint limits"
    SINGULAR = "singular Jacobian"
    DIVERGED = "diverged"


STOPS = {
    CONVERGED: Stop.CONVERGED,
    STEPS: Stop.STEPS,
    MINIMUM: Stop.MINIMUM,
    LIMITS: Stop.LIMITS,
    SINGULAR: Stop.SINGULAR,
    DIVERGED: Stop.DIVERGED,
}


class Method(StrEnum):
    """Damped least squares with limits and restarts, or plain Newton-Raphson (Kapucu 2005)."""

    DAMPED = "damped"
    NEWTON = "newton"


@dataclass(frozen=True, slots=True, kw_only=True)
class Effort:
    """How long a search may take: steps from each start, fresh starts after the first; the same seed draws the same."""

    max_steps: int = MAX_STEPS
    restarts: int = RESTARTS
    seed: int = 0


FROM_START_ONLY = Effort(restarts=0)
"""No start but the one that is given."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Attempt:
    """What a numeric run came to: closest_q (n,), where it stopped, with its error; q, only where it is a solution."""

    stopped: Stop
    closest_q: Array
    error_m: float
    error_rad: float
    steps: int
    starts: int

    def __post_init__(self) -> None:
        freeze(self, closest_q=(None,))

    @property
    def converged(self) -> bool:
        """Whether the tolerance was reached."""
        return self.stopped is Stop.CONVERGED

    @property
    def q(self) -> Array:
        """The joint values (n,) of the solution; NotConverged, saying why, where there is none."""
        if not self.converged:
            raise NotConverged(
                f"the inverse kinematics stopped after {self.starts} starts: {self.stopped}",
                consequence=f"The closest approach is {self.error_m:.3g} m and {self.error_rad:.3g} rad off, which is "
                "no solution",
                cure="Check that the pose is within reach and limits, or give a closer start",
            )
        return self.closest_q


def solve_numeric(
    arm: Arm,
    T_world_tool: RigidTransform | ArrayLike,
    start: ArrayLike | None = None,
    *,
    method: Method | str = Method.DAMPED,
    task: Task | str | None = None,
    tolerance: Tolerance | None = None,
    effort: Effort | None = None,
) -> Attempt:
    """Search joint values for one pose, from start (n,) and then from random places within the limits.

    Newton takes full steps from the start alone and knows no limits (Kapucu 2005, sections 1 and 3); the damped method
    keeps to the limits (Levenberg-Marquardt, Sugihara 2011). task: see `task_of`. The same seed gives the same answer.
    """
    tolerance, effort = tolerance or Tolerance(), effort or Effort()
    T = target_matrices(arm, T_world_tool)
    if len(T) != 1:
        raise UsageError("give one pose; `solve_numeric_many` takes many")
    try:
        newton = Method(method) is Method.NEWTON
    except ValueError:
        raise UsageError(f"the method {method!r} is not known", cure=f"Use one of: {', '.join(Method)}") from None
    rows = 6 if task_of(arm, task) is Task.POSE else 3
    weight = arm.length_m**-2
    best: Attempt | None = None
    starts = 0
    for found in _attempts(arm, T[0], start_values(arm, start), newton, rows, tolerance, effort):
        if found.converged:
            return found
        starts = found.starts
        if best is None or _cost(found, weight, rows) < _cost(best, weight, rows):
            best = found
    if best is None:
        raise UsageError("at least one start is needed")
    return replace(best, starts=starts)


def _attempts(
    arm: Arm, T: Array, first: Array, newton: bool, rows: int, tolerance: Tolerance, effort: Effort
) -> Iterator[Attempt]:
    """Yield what the search for T (4, 4) came to from the first start (n,), then from further ones; Newton has none."""
    solver = solve_newton if newton else solve_damped_least_squares
    starts = iter([first]) if newton else search_starts(arm, first, effort.restarts, effort.seed)
    for count, q in enumerate(starts, start=1):
        yield replace(_attempt(arm, T, q, first, solver, rows, tolerance, effort.max_steps), starts=count)


def attempt_from(arm: Arm, T: Array, start: Array, task: Task, tolerance: Tolerance) -> Attempt:
    """Return what damped least squares comes to for T (4, 4) from one start (n,), nothing checked: for searches."""
    rows = 6 if task is Task.POSE else 3
    return _attempt(arm, T, start.copy(), start, solve_damped_least_squares, rows, tolerance, MAX_STEPS)


def _attempt(
    arm: Arm, T: Array, q: Array, first: Array, solver: Any, rows: int, tolerance: Tolerance, max_steps: int
) -> Attempt:
    """Return what a solver comes to from q (n,), which it changes; where that is not finite, first (n,)."""
    errors = np.empty(2)
    reason, steps = solver(arm.chain, T, rows, arm.length_m**-2, tolerance.m, tolerance.rad, max_steps, q, errors)
    closest = np.where(np.isfinite(q), q, first)
    return Attempt(
        stopped=STOPS[reason],
        closest_q=closest,
        error_m=float(errors[0]),
        # where the position alone was asked for, how the tool is turned there is told all the same
        error_rad=float(errors[1]) if rows == 6 else _turned_off(arm, T, closest),
        steps=int(steps),
        starts=1,
    )


def solve_numeric_many(
    arm: Arm,
    poses: RigidTransform | ArrayLike,
    starts: ArrayLike,
    *,
    task: Task | str | None = None,
    tolerance: Tolerance | None = None,
    max_steps: int = MAX_STEPS,
) -> tuple[Array, Mask, Array]:
    """Improve each start (m, n) for its pose by damped least squares, once each: for tracks and warm starts.

    Returns q (m, n), which rows are solutions (m,), and the errors (m, 2) in m and rad. Rows that are no solution hold
    the closest approach.
    """
    tolerance = tolerance or Tolerance()
    T = target_matrices(arm, poses)
    q = arm.checked(starts).copy()
    if q.ndim != 2 or len(q) != len(T):
        raise UsageError(f"{len(T)} poses need as many starts, not an array of shape {q.shape}")
    errors, reasons = np.empty((len(T), 2)), np.empty((len(T), 2), dtype=np.int64)
    rows = 6 if task_of(arm, task) is Task.POSE else 3
    solve_many(arm.chain, T, rows, arm.length_m**-2, tolerance.m, tolerance.rad, max_steps, q, errors, reasons)
    return q, reasons[:, 0] == CONVERGED, errors


def search_starts(arm: Arm, first: Array, more: int, seed: int) -> Iterator[Array]:
    """Yield the first start (n,), then random ones within the limits, or within a turn or the arm's size."""
    yield first.copy()
    rng = np.random.default_rng(seed)
    span = np.where(arm.revolute, np.pi, size_m(arm))
    low = np.where(np.isfinite(arm.lower), arm.lower, np.where(np.isfinite(arm.upper), arm.upper - 2 * span, -span))
    high = np.where(np.isfinite(arm.upper), arm.upper, np.where(np.isfinite(arm.lower), arm.lower + 2 * span, span))
    for _ in range(more):
        yield rng.uniform(low, high)


def _cost(attempt: Attempt, weight: float, rows: int) -> float:
    """Return the scaled squared error of what was asked for: the pose (6 rows) or the position (3)."""
    return weight * attempt.error_m**2 + (attempt.error_rad**2 if rows == 6 else 0.0)


def _turned_off(arm: Arm, T: Array, q: Array) -> float:
    """Return the angle in rad between the tool at q (n,) and the pose T (4, 4)."""
    R = T[:3, :3].T @ arm.fk(q)[:3, :3]
    sine = 0.5 * np.linalg.norm([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
    return float(np.arctan2(sine, 0.5 * (np.trace(R) - 1.0)))
