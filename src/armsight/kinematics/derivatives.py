"""How the tool's pose moves with every geometric parameter, and arms with changed parameters."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.arrays import Array
from armsight.columns import DH_ROW, POSE6
from armsight.errors import UsageError
from armsight.kinematics.arm import Arm
from armsight.kinematics.joints import Convention
from armsight.kinematics.kernels.derivatives import PER_JOINT, many_parameter_columns


def parameter_names(arm: Arm) -> tuple[str, ...]:
    """Return the 5 n + 12 names: '<joint>.a_m' .. '<joint>.beta_rad', 'base.x_m' .., 'tool.x_m' ..

    base: T_world_base by (dt, dw) in world axes. tool: T_flange_tool by (dt, dw) in flange axes.
    """
    joints = tuple(f"{joint.name}.{key}" for joint in arm.joints for key in DH_ROW)
    return joints + tuple(f"{part}.{key}" for part in ("base", "tool") for key in POSE6)


def parameter_jacobian(arm: Arm, q: ArrayLike) -> tuple[Array, Array]:
    """Return T_world_tool (m, 4, 4) and its derivative (m, 6, 5 n + 12) by `parameter_names` for q (m, n).

    For a single q (n,) the first axis is left out. A derivative is (dt, dw) in world axes per m or rad. For a joint's
    scale multiply its theta (sliding: d) column by q. Of a prismatic joint d_m is the offset of the slide. Raises as
    `fk`.
    """
    values = arm.checked(q)
    rows = np.atleast_2d(values)
    T = np.empty((len(rows), 4, 4))
    J = np.empty((len(rows), 6, PER_JOINT * arm.n + 12))
    many_parameter_columns(arm.chain, rows, T, J)
    if arm.convention is Convention.CRAIG:
        J = _craig_columns(arm, T, J)
    lever = arm.chain[0, [3, 7, 11]] - arm.T_world_base.translation
    if lever.any():  # columns turn about the chain's first frame, and the base about its own origin
        J[:, :3, -9:-6] += np.cross(np.eye(3), lever).T
    return (T, J) if values.ndim == 2 else (T[0], J[0])


def _craig_columns(arm: Arm, T: Array, J: Array) -> Array:
    """Return the columns in the order of a Craig arm: a, alpha, beta belong to the joint behind them."""
    out = J.copy()
    n = arm.n
    for source, key in ((0, 0), (1, 1), (4, 4)):
        for i in range(1, n):
            out[:, :, PER_JOINT * i + key] = J[:, :, PER_JOINT * (i - 1) + source]
    base = arm.T_world_frame0  # the first link stands on it
    first = arm.joints[0]
    x = base[:3, 0]
    y = base[:3, :3] @ Rotation.from_rotvec([first.alpha_rad, 0.0, 0.0]).as_matrix()[:, 1]
    at_x = base[:3, 3]
    at_y = base[:3, 3] + first.a_m * x
    p = T[:, :3, 3]
    out[:, :3, 0], out[:, 3:, 0] = x, 0.0
    out[:, :3, 1], out[:, 3:, 1] = np.cross(x, p - at_x), x
    out[:, :3, 4], out[:, 3:, 4] = np.cross(y, p - at_y), y
    return out


def moved(arm: Arm, changes: Mapping[str, float]) -> Arm:
    """Return the arm with named parameters changed (m, rad), without covariance. Raises UsageError for others."""
    unknown = set(changes) - set(parameter_names(arm))
    if unknown:
        raise UsageError(
            f"{arm.name} has no parameter {', '.join(sorted(unknown))}",
            cure=f"Use one of: {', '.join(parameter_names(arm))}",
        )
    joints = []
    for joint in arm.joints:
        own = {key: changes[f"{joint.name}.{key}"] for key in DH_ROW if f"{joint.name}.{key}" in changes}
        values = {key: getattr(joint, key) + step for key, step in own.items()}
        joints.append(dataclasses.replace(joint, **values) if own else joint)
    return dataclasses.replace(
        arm,
        joints=tuple(joints),
        T_world_base=_moved_pose(arm.T_world_base, [changes.get(f"base.{key}", 0.0) for key in POSE6]),
        T_flange_tool=_moved_pose(arm.T_flange_tool, [changes.get(f"tool.{key}", 0.0) for key in POSE6]),
        covariance=None,
    )


def _moved_pose(T: RigidTransform, step: list[float]) -> RigidTransform:
    """Return the pose moved by (dt, dw) in its parent's axes."""
    if not any(step):
        return T
    return RigidTransform.from_components(
        np.asarray(T.translation) + step[:3], Rotation.from_rotvec(step[3:]) * T.rotation
    )
