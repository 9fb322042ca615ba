"""How close an arm is to a pose in which it loses a direction of motion."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from armsight.arrays import Array
from armsight.kinematics.arm import Arm
from armsight.kinematics.closed_form import Wrist, family_of
from armsight.kinematics.forward_kinematics import jacobian, link_frames
from armsight.kinematics.target import Task, task_of

NEAR = 0.035
"""Sine (or share of the reach) below which a singularity counts as near: two degrees, where joint speeds have grown
thirtyfold."""

DRAWN = 16
"""Positions at which it is looked for in how many directions an arm moves."""

ANY_MOTION = 1e-6
"""Share of the fastest motion below which there is none: rounding."""

UNNAMED = "singular"
"""The name given where the arm belongs to no family with names of its own."""


def scaled_jacobian(arm: Arm, q: ArrayLike, task: Task | str | None = None) -> Array:
    """Return the Jacobian (..., 6 or 3, n) of the task with lengths divided by the arm's characteristic length."""
    J = jacobian(arm, q).copy()
    J[..., :3, :] /= arm.length_m
    return J if task_of(arm, task) is Task.POSE else J[..., :3, :]


def singularity_distance(arm: Arm, q: ArrayLike, task: Task | str | None = None) -> Array:
    """Return the smallest singular value of the scaled Jacobian, shape () or (m,), of the motions that the arm has.

    It is the distance, in the 2-norm, from the Jacobian to the nearest singular one: the slowest direction of the tool
    per unit of joint speed. Directions in which too few joints never move it do not count.
    """
    return np.asarray(singular_values(arm, q, task)[..., motions(arm, task) - 1])


def motions(arm: Arm, task: Task | str | None = None) -> int:
    """Return in how many directions of the task the arm moves its tool where it is not singular."""
    task = task_of(arm, task)
    known = arm.found.get(f"motions {task}")
    if isinstance(known, int):
        return known
    rng = np.random.default_rng(0)
    low, high = np.maximum(arm.lower, -3.0), np.minimum(arm.upper, 3.0)
    q = rng.uniform(np.minimum(low, high), np.maximum(low, high), (DRAWN, arm.n))
    values = singular_values(arm, q, task)
    found = int((values > ANY_MOTION * values[:, :1]).sum(axis=1).max(initial=1))
    arm.found[f"motions {task}"] = found = max(found, 1)
    return found


def singular_values(arm: Arm, q: ArrayLike, task: Task | str | None = None) -> Array:
    """Return the singular values of the scaled Jacobian, largest first; zeros where joints are too few."""
    J = scaled_jacobian(arm, q, task)
    values = np.linalg.svd(J, compute_uv=False)
    missing = J.shape[-2] - values.shape[-1]
    if missing > 0:
        values = np.concatenate([values, np.zeros((*values.shape[:-1], missing))], axis=-1)
    return np.asarray(values)


def singularity_measures(arm: Arm, q: ArrayLike) -> dict[str, float]:
    """Return by name a signed measure that is zero in that singularity; empty where the arm has no named ones.

    wrist: sine of joint 5. elbow: sine between upper arm and forearm. shoulder: distance of the wrist from axis 1 along
    x1 over the arm's size. Their product is det J up to a constant (MATH 2.1).
    """
    family = family_of(arm)
    if family is None:
        return {}
    values = arm.checked(q)
    rows = arm.chain[1:-1]
    theta = rows[:, 1] * values + rows[:, 2]
    k = family.numbers
    frames = link_frames(arm, values)
    base = frames[0]
    wrist = base[:3, :3].T @ (frames[5][:3, 3] - base[:3, 3])
    bend = k[2] * theta[2] + (k[10] if family.wrist is Wrist.SPHERICAL else 0.0)
    return {
        "shoulder": float((np.cos(theta[0]) * wrist[0] + np.sin(theta[0]) * wrist[1]) / k[26]),
        "elbow": float(np.sin(bend)),
        "wrist": float(np.sin(theta[4])),
    }


def near_singularities(arm: Arm, q: ArrayLike, within: float = NEAR, task: Task | str | None = None) -> tuple[str, ...]:
    """Return the names of the singularities that q (n,) is in or close to: shoulder, elbow, wrist, or 'singular'."""
    measures = singularity_measures(arm, q)
    if measures:
        return tuple(name for name, value in measures.items() if abs(value) < within)
    values = singular_values(arm, q, task)
    return (UNNAMED,) if values[motions(arm, task) - 1] < within * values[0] else ()
