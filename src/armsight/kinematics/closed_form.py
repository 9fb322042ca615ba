"""Which closed form solves an arm, found from its Denavit-Hartenberg table, and where the arm is singular."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from math import atan2, hypot

import numpy as np
from numpy.typing import ArrayLike

from armsight.arrays import Array
from armsight.kinematics.arm import Arm
from armsight.kinematics.forward_kinematics import jacobian, link_frames
from armsight.kinematics.joints import link_matrix
from armsight.kinematics.numeric import Task, task_of

EXACT = 1e-10
"""A twist (rad) or offset (m) this close to the family's is the family's: an error of 0.1 nm at a metre's reach."""

NEARLY = 0.1
"""Twists within 0.1 rad and offsets within a tenth of the mean link of the family's make its closed form a good start
for the numeric solver: a calibrated arm has every parameter a little off."""


class Wrist(StrEnum):
    """How the last three axes stand."""

    OFFSET = "offset wrist"
    SPHERICAL = "spherical wrist"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Family:
    """A closed form, exact or close, with numbers (29,), T_base_world (12,), T_tool_six (12,) for kernels.closed."""

    wrist: Wrist
    exact: bool
    numbers: Array
    T_base_world: Array
    T_tool_six: Array


def family_of(arm: Arm) -> Family | None:
    """Return the closed form for the arm, exact if there is one, else the one it is close to, else None."""
    if "family" not in arm.found:
        arm.found["family"] = _search(arm)
    family = arm.found["family"]
    return family if isinstance(family, Family) else None


def _search(arm: Arm) -> Family | None:
    """Return the first family whose conditions hold, exactly before nearly."""
    rows = arm.chain[1:-1]
    if len(rows) != 6 or rows[:, 0].any():
        return None
    for tolerance in (EXACT, NEARLY):
        for wrist in Wrist:
            family = _recognise(arm, wrist, tolerance)
            if family is not None:
                return family
    return None


def _recognise(arm: Arm, wrist: Wrist, tolerance: float) -> Family | None:
    """Return the family with the arm's numbers where every condition holds within the tolerance."""
    rows = arm.chain[1:-1]
    d, a, ca, sa, beta = rows[:, 3], rows[:, 4], rows[:, 5], rows[:, 6], rows[:, 8]
    square = [0, 3, 4] if wrist is Wrist.OFFSET else [0, 2, 3, 4]  # quarter turns
    parallel = [1, 2] if wrist is Wrist.OFFSET else [1]
    zero = [a[4]] if wrist is Wrist.OFFSET else [a[3], a[4], d[4]]
    length = 1.0 if tolerance == EXACT else arm.length_m
    twists = np.concatenate([np.abs(ca[square]), np.abs(sa[parallel]), np.abs(beta[:5])])
    if (twists > tolerance).any() or (np.abs(zero) > tolerance * length).any():
        return None
    numbers = np.zeros(29)
    numbers[0] = 1.0 if wrist is Wrist.OFFSET else 2.0
    k2 = np.sign(ca[1])
    numbers[1:6] = np.sign([sa[0], ca[1], ca[2] if wrist is Wrist.OFFSET else sa[2], sa[3], sa[4]])
    numbers[6:9] = a[0], d[0], a[1]
    if wrist is Wrist.OFFSET:
        numbers[9:12] = a[2], 0.0, d[1] + k2 * d[2] + k2 * numbers[3] * d[3]
        numbers[12:14] = a[3], d[4]
    else:
        numbers[9:12] = hypot(a[2], d[3]), atan2(-k2 * numbers[3] * d[3], a[2]), d[1] + k2 * d[2]
    if min(abs(numbers[8]), abs(numbers[9])) < EXACT:
        return None
    numbers[14:20] = rows[:, 2]
    numbers[20:26] = 1.0 / rows[:, 1]
    numbers[26] = np.abs(a).sum() + np.abs(d).sum()
    base, tool = _outside(arm)
    numbers[27] = np.array_equal(base, np.eye(4))
    numbers[28] = np.array_equal(tool, np.eye(4))
    return Family(
        wrist=wrist,
        exact=tolerance == EXACT,
        numbers=numbers,
        T_base_world=base[:3].ravel(),
        T_tool_six=tool[:3].ravel(),
    )


def _outside(arm: Arm) -> tuple[Array, Array]:
    """Return (4, 4): inverse of frame 0's pose in world, and of all that comes after the turn of joint 6."""
    base, tool = np.eye(4), np.eye(4)
    base[:3], tool[:3] = arm.chain[0].reshape(3, 4), arm.chain[-1].reshape(3, 4)
    row = arm.chain[-2]
    shift = np.eye(4)
    shift[2, 3] = row[3]
    after = shift @ link_matrix(row[4], row[11], atan2(row[8], row[7])) @ tool
    return _inverse(base), _inverse(after)


def _inverse(T: Array) -> Array:
    out = np.eye(4)
    out[:3, :3] = T[:3, :3].T
    out[:3, 3] = -T[:3, :3].T @ T[:3, 3]
    return out


# How close an arm is to a pose in which it loses a direction of motion.

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
