"""A continuous joint track along a path of poses, and what is wrong with it, with the place."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from enum import StrEnum
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import RigidTransform

from armsight.arrays import Array, Mask
from armsight.errors import NotConverged, UsageError
from armsight.fields import Doc
from armsight.kinematics import closed_form
from armsight.kinematics.arm import LIMIT_SLACK, Arm
from armsight.kinematics.inverse_kinematics import branch_names, ik, in_range
from armsight.kinematics.kernels.closed import DOWN, FLIP, LEFT, solve_closed
from armsight.kinematics.numeric import (
    FROM_START_ONLY,
    Task,
    Tolerance,
    solve_numeric,
    start_values,
    target_matrices,
    task_of,
)
from armsight.records import Motion, freeze, frozen_array
from armsight.records.output import Output, output

JUMP = 0.35
"""A joint that moves more than this (20 degrees, 0.35 m) in one step has jumped, or the path is too coarse to tell."""

BRANCH = LEFT | DOWN | FLIP


class Trouble(StrEnum):
    """What can be wrong with a track."""

    JUMP = "jump"
    SPEED = "speed"
    LIMITS = "limits"
    SINGULAR = "singular"
    BRANCH = "branch"
    UNREACHED = "unreached"


@output
class Issue(Output):
    """Something wrong with a joint path; of a singular passage value and limit are `singularity_measures`' and NEAR."""

    trouble: Annotated[Trouble, Doc("jump, speed, limits, singular, branch or unreached.", key="kind")]
    first: Annotated[int, Doc("Where it begins, row from 0.")]
    last: Annotated[int, Doc("Where it ends, row from 0.")]
    worst: Annotated[int, Doc("Where it is worst, row from 0.")]
    joint: Annotated[str, Doc("The joint's name; empty where it concerns the arm.")]
    value: Annotated[float, Doc("How much there, rad, m, rad/s or m/s; of a singular passage its measure.")]
    limit: Annotated[float, Doc("What is allowed, in the same unit.")]
    text: Annotated[str, Doc("The same in words.")]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class JointPath:
    """Joint values q (k, n) for the first k of m poses; k < m where a pose could not be reached.

    branch: the branch on which it starts, empty without a closed form. motion: the whole track with its times; raises
    NotConverged where the track is not complete.
    """

    q: Array
    t_s: Array | None
    poses: int
    branch: tuple[str, ...]
    issues: tuple[Issue, ...]

    def __post_init__(self) -> None:
        freeze(self, q=(None, None))

    @property
    def complete(self) -> bool:
        """Whether every pose is reached."""
        return len(self.q) == self.poses

    @property
    def motion(self) -> Motion:
        """The track with its times (the row number where none were given)."""
        if not self.complete:
            raise NotConverged(
                f"pose {len(self.q)} of {self.poses} is not reached",
                consequence="There is no track along the whole path",
                cure="Move the path into reach, or start on another branch",
            )
        t = np.arange(self.poses, dtype=float) if self.t_s is None else self.t_s
        return Motion(t_s=t, q=self.q)


def track_path(
    arm: Arm,
    poses: RigidTransform | ArrayLike,
    *,
    t_s: ArrayLike | None = None,
    start: ArrayLike | None = None,
    task: Task | str | None = None,
    tolerance: Tolerance | None = None,
) -> JointPath:
    """Return a joint track along poses T_world_tool (m, 4, 4), each next to the one before.

    start (n,): where the arm stands; the track begins with the solution nearest to it. Without it every branch of the
    first pose is tried and the one with the least trouble is kept. t_s (m,): times, for the joints' speeds. Jumps,
    speeds beyond max_speed, limits, changes of branch, passages near singularities and poses out of reach are reported
    with their rows.
    """
    T = target_matrices(arm, poses)
    times = None if t_s is None else frozen_array("t_s", t_s, (len(T),))
    if not len(T):
        raise UsageError("a path needs at least one pose")
    if times is not None and (np.diff(times) <= 0.0).any():
        raise UsageError("the times of a path must increase", cure="Sort the rows and drop repeated ones")
    tolerance = tolerance or Tolerance()
    q_seed = start_values(arm, start)
    if task is None and arm.n < 6:  # the whole poses where so few joints hold them, else their positions
        whole = _best_track(arm, T, times, q_seed, Task.POSE, tolerance, begun=start is not None)
        if whole.complete:
            return whole
    return _best_track(arm, T, times, q_seed, task_of(arm, task), tolerance, begun=start is not None)


def _best_track(
    arm: Arm, T: Array, times: Array | None, q_seed: Array, task: Task, tolerance: Tolerance, *, begun: bool
) -> JointPath:
    """Return the track with the least trouble of those from each solution of the first pose; begun: the nearest one."""
    first = ik(arm, T[0], q_seed, task=task, tolerance=tolerance)
    if not first.solutions:
        issue = _issue(Trouble.UNREACHED, 0, 0, 0, "", np.nan, np.nan, f"pose 0: {first.status}, {first.why}")
        return JointPath(q=np.empty((0, arm.n)), t_s=times, poses=len(T), branch=(), issues=(issue,))
    options = first.solutions[:1] if begun else first.solutions
    tracks = [_track(arm, T, option.q, times, task, tolerance) for option in options]
    return max(tracks, key=lambda track: (len(track.q), -sum(_weight(issue) for issue in track.issues)))


def _track(arm: Arm, T: Array, q0: Array, times: Array | None, task: Task, tolerance: Tolerance) -> JointPath:
    family = closed_form.family_of(arm) if task is Task.POSE else None
    rows, codes, why = [np.array(q0)], [-1], ""
    if family is not None and family.exact:
        codes = [_nearest_closed(arm, family, T[0], q0)[1]]
    for target in T[1:]:
        q, code = None, -1
        if family is not None and family.exact:
            q, code = _nearest_closed(arm, family, target, rows[-1])
        else:
            attempt = solve_numeric(arm, target, rows[-1], task=task, tolerance=tolerance, effort=FROM_START_ONLY)
            if not attempt.converged:
                attempt = solve_numeric(arm, target, rows[-1], task=task, tolerance=tolerance)
            q = attempt.q if attempt.converged else None
        if q is None:
            answer = ik(arm, target, rows[-1], task=task, tolerance=tolerance)
            why = f"pose {len(rows)}: {answer.status}, {answer.why}"
            break
        rows.append(q)
        codes.append(code)
    q_all = np.array(rows)
    issues = [*_steps(arm, q_all, times), *_beyond(arm, q_all), *_branches(codes), *_singular(arm, q_all, task)]
    if why:
        k = len(rows)
        issues.append(_issue(Trouble.UNREACHED, k, len(T) - 1, k, "", np.nan, np.nan, why))
    branch = branch_names(codes[0]) if codes[0] >= 0 else ()
    return JointPath(q=q_all, t_s=times, poses=len(T), branch=branch, issues=tuple(issues))


def _nearest_closed(arm: Arm, family: closed_form.Family, T: Array, q_seed: Array) -> tuple[Array | None, int]:
    """Return the closed-form solution whose largest joint step from here is least, and its code."""
    Q, code = np.empty((8, 6)), np.zeros(8, dtype=np.int64)
    count = solve_closed(arm.chain, family.numbers, family.T_base_world, family.T_tool_six, T, q_seed, Q, code)
    best, best_code, best_step = None, -1, np.inf
    for k in range(count):
        q = in_range(arm, Q[k], q_seed)
        step = float(np.abs(q - q_seed).max())
        step += 0.0 if arm.within_limits(q) else 100.0  # only where nothing else is left
        if step < best_step:
            best, best_code, best_step = q, int(code[k]), step
    return best, best_code


def _issue(
    trouble: Trouble, first: int, last: int, worst: int, joint: str, value: float, limit: float, text: str
) -> Issue:
    return Issue(trouble=trouble, first=first, last=last, worst=worst, joint=joint, value=value, limit=limit, text=text)


def _weight(issue: Issue) -> float:
    """Return how much an issue counts in the choice of a branch: jumps and limits first, then speed, then closeness."""
    return {Trouble.JUMP: 100.0, Trouble.LIMITS: 100.0, Trouble.BRANCH: 10.0, Trouble.SPEED: 10.0}.get(
        issue.trouble, 1.0
    )


def _runs(bad: Mask) -> Iterable[tuple[int, int]]:
    edges = np.flatnonzero(np.diff(np.concatenate([[False], bad, [False]]).astype(int)))
    return [(int(a), int(b) - 1) for a, b in zip(edges[::2], edges[1::2], strict=True)]


def _steps(arm: Arm, q: Array, times: Array | None) -> list[Issue]:
    """Return jumps, and speeds beyond the joints' own, by row of the pose in which the step ends."""
    if len(q) < 2:
        return []
    step = np.abs(np.diff(q, axis=0))
    issues = []
    for i, joint in enumerate(arm.joints):
        unit = "rad" if arm.revolute[i] else "m"
        for a, b in _runs(step[:, i] > JUMP):
            worst = a + int(step[a : b + 1, i].argmax())
            text = f"{joint.name} jumps by {step[worst, i]:.3g} {unit} before pose {worst + 1}"
            issues.append(_issue(Trouble.JUMP, a + 1, b + 1, worst + 1, joint.name, float(step[worst, i]), JUMP, text))
        if times is None or joint.max_speed is None:
            continue
        speed = step[:, i] / np.diff(times[: len(q)])
        for a, b in _runs(speed > joint.max_speed):
            worst = a + int(speed[a : b + 1].argmax())
            text = (
                f"{joint.name} would run at {speed[worst]:.3g} {unit}/s before pose {worst + 1}; "
                f"it can do {joint.max_speed:.3g}"
            )
            issues.append(
                _issue(Trouble.SPEED, a + 1, b + 1, worst + 1, joint.name, float(speed[worst]), joint.max_speed, text)
            )
    return issues


def _beyond(arm: Arm, q: Array) -> list[Issue]:
    issues = []
    for i, joint in enumerate(arm.joints):
        excess = np.maximum(joint.lower - q[:, i], q[:, i] - joint.upper)
        for a, b in _runs(excess > LIMIT_SLACK):
            worst = a + int(excess[a : b + 1].argmax())
            value = float(q[worst, i])
            limit = joint.lower if value < joint.lower else joint.upper
            text = f"{joint.name} would stand at {value:.4g} at pose {worst}; its limit is {limit:.4g}"
            issues.append(_issue(Trouble.LIMITS, a, b, worst, joint.name, value, limit, text))
    return issues


def _branches(codes: list[int]) -> list[Issue]:
    """Return where the branch changes, told against the last pose at which it was clear (no singular bits)."""
    issues = []
    known = codes[0] & BRANCH
    for row, code in enumerate(codes):
        if code < 0 or code & ~BRANCH:
            continue
        if code & BRANCH != known:
            before, after = branch_names(known), branch_names(code)
            change = ", ".join(f"{a} to {b}" for a, b in zip(before, after, strict=True) if a != b)
            issues.append(_issue(Trouble.BRANCH, row, row, row, "", np.nan, np.nan, f"{change} at pose {row}"))
            known = code & BRANCH
    return issues


def _singular(arm: Arm, q: Array, task: Task) -> list[Issue]:
    """Return passages through or close to singularities, by name."""
    measures: dict[str, Array] = {}
    if task is Task.POSE and closed_form.singularity_measures(arm, q[0]):
        rows = [closed_form.singularity_measures(arm, row) for row in q]
        measures = {name: np.array([row[name] for row in rows]) for name in rows[0]}
    else:
        values = closed_form.singular_values(arm, q, task)
        measures = {closed_form.UNNAMED: values[:, closed_form.motions(arm, task) - 1] / values[:, 0]}
    issues = []
    for name, value in measures.items():
        crossed = np.concatenate([[False], np.sign(value[1:]) * np.sign(value[:-1]) < 0.0])
        for a, b in _runs((np.abs(value) < closed_form.NEAR) | crossed):
            worst = a + int(np.abs(value[a : b + 1]).argmin())
            how = "passes through" if crossed[a : b + 1].any() or abs(value[worst]) < 1e-9 else "comes close to"
            text = f"the track {how} the {name} singularity at pose {worst} (measure {abs(value[worst]):.2g})"
            issues.append(_issue(Trouble.SINGULAR, a, b, worst, "", float(abs(value[worst])), closed_form.NEAR, text))
    return issues
