"""From joint values to the tool's pose, to every link's frame, and to its derivatives by joints and geometry."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.arrays import Array
from armsight.columns import DH_ROW, POSE6
from armsight.errors import UsageError
from armsight.kinematics.arm import Arm
from armsight.kinematics.joints import Convention, distal_rows, proximal_rows
from armsight.kinematics.kernels.chain import (
    joint_frames,
    many_poses,
    many_poses_jacobians,
    one_pose,
    one_pose_jacobian,
)
from armsight.kinematics.kernels.derivatives import PER_JOINT, many_parameter_columns

Axes = Literal["world", "base", "tool"]

ALL_CORES_FROM = 16_384
"""Batches from this size (about a millisecond of work) are spread over the cores."""


def fk(arm: Arm, q: ArrayLike, *, all_cores: bool = True) -> Array:
    """Return T_world_tool as (4, 4) for q (n,), or (m, 4, 4) for q (m, n), in rad and m.

    Big batches run on all cores unless all_cores is False. Raises UsageError for a wrong number of joints and
    Inconsistent for values that are not finite. Korayem 2018 section 4 with MATH 2.1.
    """
    values = arm.checked(q)
    if values.ndim == 1:
        T = np.empty((4, 4))
        one_pose(arm.chain, values, T)
        return T
    T = np.empty((len(values), 4, 4))
    if all_cores and len(values) >= ALL_CORES_FROM:
        from armsight.kinematics.kernels.chain import many_poses_on_all_cores

        many_poses_on_all_cores(arm.chain, values, T)
    else:
        many_poses(arm.chain, values, T)
    return T


def pose(arm: Arm, q: ArrayLike) -> RigidTransform:
    """Return T_world_tool as a RigidTransform, one or many; `fk` gives the same as a matrix, faster."""
    return RigidTransform(fk(arm, q), normalize=False, copy=False)


def jacobian(arm: Arm, q: ArrayLike, *, axes: Axes = "world") -> Array:
    """Return the geometric Jacobian (6, n) or (m, 6, n): velocity of the tool's origin, then angular velocity.

    axes: the axes in which both are given: world, base or tool. Units: m or 1 and rad per unit of the joint.
    Korayem 2018 section 4 (A4, A5 in MATH).
    """
    return fk_jacobian(arm, q, axes=axes)[1]


def fk_jacobian(
    arm: Arm, q: ArrayLike, *, axes: Axes = "world", all_cores: bool = True, out: tuple[Array, Array] | None = None
) -> tuple[Array, Array]:
    """Return T_world_tool (4, 4) and Jacobian (6, n), for q (m, n) of each row; out: arrays to fill instead."""
    if axes not in ("world", "base", "tool"):
        raise UsageError(f"the axes {axes!r} are not known", cure="Use world, base or tool")
    values = arm.checked(q)
    shape = values.shape[:-1]
    T, J = (np.empty((*shape, 4, 4)), np.empty((*shape, 6, arm.n))) if out is None else out
    if out is not None and (T.shape != (*shape, 4, 4) or J.shape != (*shape, 6, arm.n)):
        raise UsageError(
            f"out has shapes {T.shape} and {J.shape}",
            consequence="It would be written to beyond its end",
            cure=f"Give {(*shape, 4, 4)} and {(*shape, 6, arm.n)}",
        )
    if values.ndim == 1:
        one_pose_jacobian(arm.chain, values, T, J)
    elif all_cores and len(values) >= ALL_CORES_FROM:
        from armsight.kinematics.kernels.chain import many_poses_jacobians_on_all_cores

        many_poses_jacobians_on_all_cores(arm.chain, values, T, J)
    else:
        many_poses_jacobians(arm.chain, values, T, J)
    if axes != "world":
        R = T[..., :3, :3] if axes == "tool" else arm.T_world_base.rotation.as_matrix()
        Rt = np.swapaxes(R, -1, -2)
        J[..., :3, :] = Rt @ J[..., :3, :]
        J[..., 3:, :] = Rt @ J[..., 3:, :]
    return T, J


def link_frames(arm: Arm, q: ArrayLike) -> Array:
    """Return (n + 2, 4, 4) in world: frame 0, the frame behind each joint in standard convention, the tool."""
    values = arm.checked(q)
    if values.ndim != 1:
        raise UsageError("link frames are computed for one joint vector at a time")
    F = np.empty((arm.n + 2, 12))
    joint_frames(arm.chain, values, F)
    T = np.tile(np.eye(4), (arm.n + 2, 1, 1))
    T[:, :3, :] = F.reshape(-1, 4, 3).transpose(0, 2, 1)
    return T


def in_convention(arm: Arm, convention: Convention | str) -> Arm:
    """Return the same arm written in the other convention; its poses stay the same, its covariance is dropped.

    A link length or twist that the new convention cannot hold at its end goes into frame 0 or the tool; the base stays.
    """
    wanted = Convention(convention)
    if wanted is arm.convention:
        return arm
    move = distal_rows if wanted is Convention.STANDARD else proximal_rows
    links = [(joint.a_m, joint.alpha_rad, joint.beta_rad) for joint in arm.joints]
    frame0, rows, tool = move(arm.convention, arm.T_base_frame0.as_matrix(), links, arm.T_flange_tool.as_matrix())
    joints = tuple(
        dataclasses.replace(joint, a_m=a, alpha_rad=alpha, beta_rad=beta)
        for joint, (a, alpha, beta) in zip(arm.joints, rows, strict=True)
    )
    T_flange_tool = RigidTransform.from_matrix(tool)
    T_new_old = T_flange_tool * arm.T_flange_tool.inv()  # of the flange
    last = joints[-1]
    return dataclasses.replace(
        arm,
        joints=(*joints[:-1], dataclasses.replace(last, com_m=tuple(T_new_old.apply(last.com_m).tolist()))),
        convention=wanted,
        T_base_frame0=RigidTransform.from_matrix(frame0),
        T_flange_tool=T_flange_tool,
        covariance=None,
        tool_points=tuple(point.seen_from(T_new_old) for point in arm.tool_points),
    )


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
