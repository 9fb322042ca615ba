"""All joint values that bring the tool to a pose, with their branches; closed form where the arm allows it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from enum import StrEnum
from functools import cache
from itertools import compress
from math import hypot

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import RigidTransform

from armsight.arrays import Array
from armsight.errors import Inconsistent, UsageError
from armsight.kinematics.arm import LIMIT_SLACK, Arm
from armsight.kinematics.closed_form import Family, family_of, motions, near_singularities
from armsight.kinematics.kernels import closed
from armsight.kinematics.kernels.numeric import solve_damped_least_squares
from armsight.kinematics.numeric import (
    MAX_STEPS,
    Attempt,
    Stop,
    Task,
    Tolerance,
    attempt_from,
    search_starts,
    start_values,
    target_matrices,
    task_of,
)
from armsight.records import freeze

SAME_SOLUTION = 1e-5
"""Numeric solutions closer than this (rad or m) are one."""

SINGULAR_HERE = 1e-6
"""Measure of a singularity below which a numeric solution stands in it."""

FINE = 1e-11
"""Numeric solutions are run down to this (m and rad) where rounding lets them, so that equal ones are seen as equal."""

SAME_PLACE = 1e-3
"""Solutions of a position alone that are closer (rad or m) are one: they lie where the rotation is missed by least."""

TURNED_AS_WELL = 0.01
"""rad: solutions of a position that turn the tool so much worse than the best come after it, however near they are."""

NUMERIC_SEARCHES = 24
"""Searches from different starts for the several solutions of an arm without a closed form."""

USUAL = Tolerance()


class Status(StrEnum):
    """How an inverse problem ended."""

    OK = "ok"
    OUT_OF_REACH = "out_of_reach"
    SINGULAR = "singular"
    LIMITS = "limits"
    NO_SOLUTION = "no_solution"
    POSITION_ONLY = "position_only"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Solution:
    """Joint values q (n,) that reach the pose within tolerance, or its position: error_rad then says how it is turned.

    branch: ('shoulder right', 'elbow up', 'wrist no flip') for arms with a closed form, else empty. singular: names of
    the singularities it stands in; there the free joints keep the values they were near to.
    """

    q: Array
    branch: tuple[str, ...]
    singular: tuple[str, ...]
    error_m: float
    error_rad: float

    def __post_init__(self) -> None:
        freeze(self, q=(None,))

    @classmethod
    def of_solver(
        cls, q: Array, branch: tuple[str, ...], singular: tuple[str, ...], error_m: float, error_rad: float
    ) -> Solution:
        """Return the record of a read-only q that nobody else writes to, unchecked: eight of them a pose."""
        made = object.__new__(cls)
        _PUT_Q(made, q)
        _PUT_BRANCH(made, branch)
        _PUT_SINGULAR(made, singular)
        _PUT_ERROR_M(made, error_m)
        _PUT_ERROR_RAD(made, error_rad)
        return made


_PUT_Q, _PUT_BRANCH, _PUT_SINGULAR, _PUT_ERROR_M, _PUT_ERROR_RAD = (
    vars(Solution)[name].__set__ for name in ("q", "branch", "singular", "error_m", "error_rad")
)
"""Put a field's value into a new record, in half the time of object.__setattr__."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Inverse:
    """The solutions of one pose, nearest first.

    status ok: at least one within limits. singular: all of them stand in a singularity. position_only: they reach the
    position, but fewer than six joints do not turn the tool as wanted (error_rad says by how much). limits: solutions
    exist, all beyond the limits (in beyond_limits). out_of_reach, no_solution: none; why says the reason. complete: the
    closed form gave them, so there are no others.
    """

    solutions: tuple[Solution, ...]
    beyond_limits: tuple[Solution, ...]
    status: Status
    why: str
    complete: bool

    def __len__(self) -> int:
        return len(self.solutions)

    def __iter__(self) -> Iterator[Solution]:
        return iter(self.solutions)

    def __getitem__(self, i: int) -> Solution:
        """Return the i-th solution; raises IndexError, saying why there are no more."""
        if not -len(self) <= i < len(self):
            raise IndexError(f"solution {i} of {len(self)}" + (f": {self.why}" if self.why else ""))
        return self.solutions[i]


@cache
def branch_names(code: int) -> tuple[str, str, str]:
    """Return the branch of a solution's code (kernels.closed) in words."""
    return (
        "shoulder left" if code & closed.LEFT else "shoulder right",
        "elbow down" if code & closed.DOWN else "elbow up",
        "wrist flip" if code & closed.FLIP else "wrist no flip",
    )


@cache
def singular_names(code: int) -> tuple[str, ...]:
    """Return the names of the singularities in a solution's code."""
    names = ((closed.AT_SHOULDER, "shoulder"), (closed.AT_ELBOW, "elbow"), (closed.AT_WRIST, "wrist"))
    return tuple(name for bit, name in names if code & bit)


def ik(
    arm: Arm,
    T_world_tool: RigidTransform | ArrayLike,
    q_seed: ArrayLike | None = None,
    *,
    task: Task | str | None = None,
    tolerance: Tolerance | None = None,
) -> Inverse:
    """Return every solution found for one pose, nearest to near (n,) first.

    Closed form (MATH 2.2, with its singular cases) where the table has one; refined numerically where the arm is only
    close to such a family; a numeric search from many starts otherwise. Turning joints are moved by whole turns to be
    within limits and nearest to near (default: the middle of the range). In a singular pose the free joint keeps the
    value of near. A result that misses the tolerance is not a solution. Without a task fewer than six joints are asked
    for the whole pose, and where they do not hold it for its position, turned as near as they can. Raises as
    `target_matrices`.
    """
    tolerance = tolerance or USUAL
    T = target_matrices(arm, T_world_tool)
    if len(T) != 1:
        raise UsageError("give one pose; `ik_many` takes many")
    q_seed = start_values(arm, q_seed)
    few = task is None and arm.n < 6
    task = task_of(arm, task)
    (x, y, z), base = T[0, :3, 3].tolist(), arm.chain[0]
    distance = hypot(x - base[3], y - base[7], z - base[11])
    if distance > arm.reach_m + tolerance.m:
        why = f"the pose is {distance:.6g} m from the first joint; the arm reaches {arm.reach_m:.6g} m at most"
        return Inverse(solutions=(), beyond_limits=(), status=Status.OUT_OF_REACH, why=why, complete=True)
    if few:
        return _of_few_joints(arm, T[0], q_seed, tolerance)
    family = family_of(arm) if task is Task.POSE else None
    if family is None:
        return _searched(arm, T[0], q_seed, task, tolerance)
    found, within = _closed(arm, family, T[0], q_seed, tolerance)
    if not family.exact and not found:
        return _searched(arm, T[0], q_seed, task, tolerance)
    return _sorted_out(arm, found, within, family.exact, "no joint values bring the wrist there")


def ik_each(
    arm: Arm, poses: RigidTransform | ArrayLike, q_seed: ArrayLike | None = None, *, task: Task | str | None = None
) -> tuple[Inverse, ...]:
    """Return the solutions of each pose, near (n,), then the one before, or near rows (m, n). Raises as ik."""
    T = target_matrices(arm, poses)
    rows = None if q_seed is None else arm.checked(q_seed)
    if rows is not None and rows.ndim == 2 and len(rows) != len(T):
        raise Inconsistent(
            f"{len(rows)} rows of joint values for {len(T)} poses", cure="Give one row for all, or one for each pose"
        )
    here = start_values(arm, None if rows is None or rows.ndim == 2 else rows)
    found = []
    for i, one in enumerate(T):
        answer = ik(arm, one, here if rows is None or rows.ndim == 1 else rows[i], task=task)
        here = answer[0].q if len(answer) else here
        found.append(answer)
    return tuple(found)


def ik_many(
    arm: Arm, poses: RigidTransform | ArrayLike, q_seed: ArrayLike | None = None
) -> tuple[Array, NDArray[np.int64], NDArray[np.int64]]:
    """Return all closed-form solutions of many poses: q (m, 8, 6), code (m, 8), count (m,).

    Only the first count[i] rows of q[i] are solutions, in radians within a turn; limits are not looked at
    (`Arm.within_limits`). `branch_names` and `singular_names` read the codes. Raises UsageError for an arm without an
    exact closed form.
    """
    family = family_of(arm)
    if family is None or not family.exact:
        raise UsageError(f"{arm.name} has no closed form", cure="Use inverse or solve_numeric_many")
    T = target_matrices(arm, poses)
    Q = np.full((len(T), 8, 6), np.nan)
    code, count = np.zeros((len(T), 8), dtype=np.int64), np.empty(len(T), dtype=np.int64)
    here = start_values(arm, q_seed)
    closed.solve_closed_many(arm.chain, family.numbers, family.T_base_world, family.T_tool_six, T, here, Q, code, count)
    return Q, code, count


def in_range(arm: Arm, q: Array, q_seed: Array) -> Array:
    """Return q (n,) with turning joints moved by whole turns: within the limits where possible, nearest to here."""
    out = q.copy()
    closed.nearest_turns(arm.chain, out, q_seed, LIMIT_SLACK)
    return out


def _closed(
    arm: Arm, family: Family, T: Array, q_seed: Array, tolerance: Tolerance
) -> tuple[list[Solution], list[bool]]:
    """Return the closed form's solutions within the tolerance, refined where not exact, and which keep the limits."""
    Q, code = np.empty((9, 6)), np.zeros(9, dtype=np.int64)
    errors, inside = np.empty((9, 3)), np.empty(9, dtype=np.bool_)
    count = closed.solve_closed(arm.chain, family.numbers, family.T_base_world, family.T_tool_six, T, q_seed, Q, code)
    if not family.exact:
        Q[count], code[count] = q_seed, -1
        count = _refine(arm, T, Q, code, count + 1, tolerance)
    count = closed.settle(
        arm.chain, T, count, q_seed, (LIMIT_SLACK, tolerance.m, tolerance.rad), Q, code, errors, inside
    )
    Q.setflags(write=False)
    found: list[Solution] = []
    for q, bits, (m, rad, _) in zip(Q[:count], code.tolist(), errors.tolist(), strict=False):
        singular = singular_names(bits) if family.exact else near_singularities(arm, q, SINGULAR_HERE)
        found.append(Solution.of_solver(q, branch_names(bits) if bits >= 0 else (), singular, m, rad))
    return found, inside[:count].tolist()


def _refine(arm: Arm, T: Array, Q: Array, code: NDArray[np.int64], count: int, tolerance: Tolerance) -> int:
    """Improve the closed form's guesses of an arm that is only close to the family; return how many are left.

    Limits are not looked at. Those that fail or come together are dropped; singular bits of the guess mean nothing.
    """
    free = arm.chain.copy()
    free[1:-1, 9], free[1:-1, 10] = -np.inf, np.inf
    fine = min(tolerance.m, FINE), min(tolerance.rad, FINE)
    errors, kept = np.empty(2), 0
    for k in range(count):
        q = Q[k].copy()
        solve_damped_least_squares(free, T, 6, arm.length_m**-2, *fine, MAX_STEPS, q, errors)
        if errors[0] > tolerance.m or errors[1] > tolerance.rad:
            continue
        if any(_gap(arm, q, other) < SAME_SOLUTION for other in Q[:kept]):
            continue
        Q[kept], code[kept] = q, code[k] if code[k] < 0 else code[k] & (closed.LEFT | closed.DOWN | closed.FLIP)
        kept += 1
    return kept


def _searched(arm: Arm, T: Array, q_seed: Array, task: Task, tolerance: Tolerance) -> Inverse:
    """Return what a numeric search from several starts finds; one solution where joints are more than needed."""
    fine = Tolerance(m=min(tolerance.m, FINE), rad=min(tolerance.rad, FINE))
    found: list[Solution] = []
    closest: Attempt | None = None
    for start in search_starts(arm, q_seed, NUMERIC_SEARCHES, seed=0):
        attempt = attempt_from(arm, T, start, task, tolerance)
        if not attempt.converged:
            closest = attempt if closest is None or attempt.error_m < closest.error_m else closest
            continue
        if any(_gap(arm, attempt.q, other.q) < SAME_SOLUTION for other in found):
            continue
        finer = attempt_from(arm, T, attempt.q, task, fine)
        turned = task is Task.POSITION or finer.error_rad <= tolerance.rad
        attempt = finer if finer.error_m <= attempt.error_m and turned else attempt
        q = in_range(arm, attempt.closest_q.copy(), q_seed)
        if any(_gap(arm, q, other.q) < SAME_SOLUTION for other in found):
            continue
        singular = near_singularities(arm, q, SINGULAR_HERE, task)
        found.append(Solution(q=q, branch=(), singular=singular, error_m=attempt.error_m, error_rad=attempt.error_rad))
        if arm.n > motions(arm, task):
            break
    if found or closest is None:
        found.sort(key=lambda solution: float(np.abs(solution.q - q_seed).max()))
        within = [bool(arm.within_limits(solution.q)) for solution in found]
        return _sorted_out(arm, found, within, False, "")
    status = Status.LIMITS if closest.stopped is Stop.LIMITS else Status.NO_SOLUTION
    why = f"{closest.stopped}; the closest approach is {closest.error_m:.3g} m and {closest.error_rad:.3g} rad off"
    return Inverse(solutions=(), beyond_limits=(), status=status, why=why, complete=False)


def _of_few_joints(arm: Arm, T: Array, q_seed: Array, tolerance: Tolerance) -> Inverse:
    """Return the solutions of the whole pose where fewer than six joints hold it, else those of its position.

    The latter begin where the whole pose is missed by least, so that the tool is turned as near to it as they can.
    """
    whole = _searched(arm, T, q_seed, Task.POSE, tolerance)
    if whole.solutions:
        return whole
    found: list[Solution] = []
    for start in search_starts(arm, q_seed, NUMERIC_SEARCHES, seed=0):
        nearest = attempt_from(arm, T, start, Task.POSE, tolerance)
        placed = attempt_from(arm, T, nearest.closest_q, Task.POSITION, tolerance)
        if not placed.converged:
            continue
        q = in_range(arm, placed.closest_q.copy(), q_seed)
        if arm.within_limits(q) and all(_gap(arm, q, other.q) >= SAME_PLACE for other in found):
            found.append(Solution(q=q, branch=(), singular=(), error_m=placed.error_m, error_rad=placed.error_rad))
    if not found:
        return whole if whole.beyond_limits else _searched(arm, T, q_seed, Task.POSITION, tolerance)
    least = min(solution.error_rad for solution in found)
    found.sort(key=lambda one: (one.error_rad > least + TURNED_AS_WELL, float(np.abs(one.q - q_seed).max())))
    why = f"the position is reached, but {arm.n} joints turn the tool no nearer than {found[0].error_rad:.3g} rad"
    return Inverse(solutions=tuple(found), beyond_limits=(), status=Status.POSITION_ONLY, why=why, complete=False)


def full_turns(arm: Arm) -> Array:
    """Return by how much each joint value changes in a whole turn (n,); 1, without meaning, for slides."""
    return np.where(arm.revolute, 2.0 * np.pi / np.abs(arm.chain[1:-1, 1]), 1.0)


def _gap(arm: Arm, a: Array, b: Array) -> float:
    """Return the largest difference of two joint vectors, whole turns apart being the same."""
    difference = a - b
    turns = np.where(arm.revolute, np.round(difference / full_turns(arm)), 0.0)
    return float(np.abs(difference - turns * full_turns(arm)).max())


def _sorted_out(arm: Arm, found: list[Solution], within: list[bool], complete: bool, why_none: str) -> Inverse:
    """Return the record: found, nearest first, parted into within limits and beyond, and the status."""
    inside = tuple(found) if all(within) else tuple(compress(found, within))
    beyond = () if len(inside) == len(found) else tuple(s for s, fits in zip(found, within, strict=True) if not fits)
    status, why = Status.OK, ""
    if inside:
        if all(solution.singular for solution in inside):
            names = sorted({name for solution in inside for name in solution.singular})
            status, why = Status.SINGULAR, f"singular: {', '.join(names)}"
    elif beyond:
        wrong = [
            joint.name
            for joint, value in zip(arm.joints, beyond[0].q, strict=True)
            if not joint.lower - LIMIT_SLACK <= value <= joint.upper + LIMIT_SLACK
        ]
        status, why = Status.LIMITS, f"every solution is beyond a limit; the nearest at {', '.join(wrong)}"
    else:
        status, why = Status.OUT_OF_REACH, why_none
    return Inverse(solutions=inside, beyond_limits=beyond, status=status, why=why, complete=complete)
