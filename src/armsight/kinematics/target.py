"""What an inverse problem asks for, checked before it is solved."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import RigidTransform

from armsight.arrays import Array
from armsight.errors import Inconsistent, UsageError
from armsight.kinematics.arm import Arm
from armsight.kinematics.kernels.numeric import NO_ROTATION, NOT_FINITE, check_poses, farthest
from armsight.records import for_kernels, real_array

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
