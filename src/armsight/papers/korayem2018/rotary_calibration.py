"""The axis of a rig's rotary base, from poses of one fixed target seen at several angles (Korayem 2018)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.errors import Degenerate, Inconsistent, NotEnoughData
from armsight.fitting import Evaluation, Fit, Problem, Settings, solve
from armsight.geometry import pose_difference
from armsight.geometry.poses import skew
from armsight.papers.korayem2018.rotary_base import RotaryBase
from armsight.records import NamedCovariance, PoseStatus, TargetPose

Array = NDArray[np.float64]

LEAST_ANGLES = 3
"""Two angles fix the axis without a check; the third shows whether the base turns as it says."""

LEAST_SPAN_RAD = np.radians(10.0)
"""Below this span the axis' place is a lever arm of more than six times the target's motion."""

SAME_ANGLE_RAD = 1e-3
"""Angles closer than this are one place of the base."""

TURN_TOLERANCE = 0.2
"""The measured turn may differ from the stated one by this share before unit or sense of the angles is doubted."""

LARGEST_STEP_RAD = np.radians(160.0)
"""A turn near half a circle reads as its complement."""

PASSES = 4
"""The axis is re-expressed about its last value; the second pass changes it by 1e-9 rad already."""

NAMES = (
    "axis.tilt1",
    "axis.tilt2",
    "axis.p1",
    "axis.p2",
    "target.tx",
    "target.ty",
    "target.tz",
    "target.rx",
    "target.ry",
    "target.rz",
)
"""tilt (rad) and p (m) along the two directions e1, e2 square to the axis; the target's pose at angle 0."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RotaryCalibration:
    """The base (axis in rig axes of angle 0; T_world_home is the identity) and the target at angle 0.

    e1, e2: (3,) directions of axis.tilt1, axis.p1 and axis.tilt2, axis.p2. covariance: named. std: by name, with
    axis.direction_rad (largest) and axis.place_m (largest). scale: standard deviation of the whitened residuals, 1
    where poses and angles are as uncertain as they say. rms_m, rms_rad: of target positions and rotations left over.
    """

    base: RotaryBase
    T_home_target: RigidTransform
    e1: Array
    e2: Array
    covariance: NamedCovariance
    std: dict[str, float]
    scale: float
    dof: int
    rms_m: float
    rms_rad: float
    n_used: int
    span_rad: float
    angles_rad: tuple[float, ...]


def calibrate_rotary(
    angles_rad: ArrayLike, poses: Sequence[TargetPose], *, sigma_angle_rad: float = 0.0
) -> RotaryCalibration:
    """Fit axis and target from T_rig_target of one fixed target seen at the base's angles (n,), by maximum likelihood.

    sigma_angle_rad: standard deviation of a stated angle. Poses that are not complete are left out. Raises
    NotEnoughData for fewer than LEAST_ANGLES different angles, Degenerate where they span less than LEAST_SPAN_RAD,
    Inconsistent where the target does not turn as the angles say (sense, unit, or a target that moved).
    """
    angles = np.asarray(angles_rad, float)
    if angles.shape != (len(poses),) or not np.isfinite(angles).all():
        raise Inconsistent(f"{len(poses)} poses need as many finite angles, not an array of shape {angles.shape}")
    whole = [i for i, pose in enumerate(poses) if pose.status is PoseStatus.OK]
    angles, kept = angles[whole], [poses[i] for i in whole]
    seen = [T for T in (pose.pose for pose in kept) if T is not None]
    _check_angles(angles)
    base, target = _start(angles, seen)
    covariances = _covariances(base, angles, kept, seen, sigma_angle_rad)
    roots = [np.linalg.inv(np.linalg.cholesky(C)) for C in covariances]  # whitening, (6, 6) each
    fit: Fit | None = None
    for _ in range(PASSES):
        e1, e2 = _square_to(base.direction)
        fit = solve(_problem(base, target, e1, e2, angles, seen, roots), Settings())
        base, target = _moved(base, target, e1, e2, fit.shared)
    if fit is None or fit.covariance is None:
        raise Degenerate("the poses leave the axis open")
    return _result(fit, base, target, e1, e2, angles, seen)


def _check_angles(angles: Array) -> None:
    ordered = np.sort(angles)
    distinct = 1 + int((np.diff(ordered) > SAME_ANGLE_RAD).sum()) if len(ordered) else 0
    if distinct < LEAST_ANGLES:
        raise NotEnoughData(
            f"the target was measured at {distinct} different angles of the base",
            consequence="The axis cannot be fitted and checked",
            cure=f"Measure it at {LEAST_ANGLES} or more, over 60 degrees if it stays in view",
        )
    span = float(ordered[-1] - ordered[0])
    if span < LEAST_SPAN_RAD:
        raise Degenerate(
            f"the angles span {np.degrees(span):.2f} degrees",
            consequence="The axis' place would be guessed from a sliver of its circle",
            cure=f"Turn the base over {np.degrees(LEAST_SPAN_RAD):.0f} degrees at least",
        )


def _start(angles: Array, seen: list[RigidTransform]) -> tuple[RotaryBase, RigidTransform]:
    """Return axis and target in closed form: turns from view to view, then their common fixed line."""
    order = np.argsort(angles)
    a = np.diff(angles[order])  # (n - 1,)
    motions = [seen[j] * seen[i].inv() for i, j in pairwise(order)]  # the target moves against the rig
    w = -np.array([motion.rotation.as_rotvec() for motion in motions])  # (n - 1, 3)
    toward = a @ w / (a @ a)  # of unit length where the angles are true
    length = float(np.linalg.norm(toward))
    toward = toward / length if length > 0.0 else toward
    off = np.linalg.norm(w - a[:, None] * toward, axis=1)
    if a.max() > LARGEST_STEP_RAD or (off > TURN_TOLERANCE * np.maximum(a, LEAST_SPAN_RAD)).any():
        raise Inconsistent(
            f"the target turned by {length:.3g} times the base's angles, and by up to {np.degrees(off.max()):.3g} "
            f"degrees otherwise, in steps of up to {np.degrees(a.max()):.3g} degrees",
            consequence="The views do not belong to these angles",
            cure="Give the angles in rad, one for each view, less than half a turn apart, with the target at rest",
        )
    A = np.vstack([np.eye(3) - m.rotation.as_matrix() for m in motions] + [toward[None]])
    b = np.concatenate([np.asarray(m.translation) for m in motions] + [np.zeros(1)])
    point = np.linalg.lstsq(A, b, rcond=None)[0]
    base = RotaryBase(direction=toward, point_m=point, T_world_home=RigidTransform.identity())
    return base, base.T_home_rig(float(angles[order[0]])) * seen[order[0]]


def _covariances(
    base: RotaryBase, angles: Array, poses: list[TargetPose], seen: list[RigidTransform], sigma_angle_rad: float
) -> list[Array]:
    """Return the covariance (6, 6) of each measured pose with the angle's own uncertainty added."""
    out = []
    for pose, T in zip(poses, seen, strict=True):
        if pose.covariance is None:
            raise Inconsistent("a complete pose without covariance cannot be weighed")
        lever = np.cross(base.direction, np.asarray(T.translation) - base.point_m)
        g = -np.concatenate([lever, base.direction])  # d (t, w) / d angle
        out.append(pose.covariance + sigma_angle_rad**2 * np.outer(g, g))
    return out


def _problem(
    base: RotaryBase,
    target: RigidTransform,
    e1: Array,
    e2: Array,
    angles: Array,
    seen: list[RigidTransform],
    roots: list[Array],
) -> Problem:
    """Return the fit of the ten parameters as steps from base and target."""

    def evaluate(shared: Array, local: Array) -> Evaluation:
        b, t = _moved(base, target, e1, e2, shared)
        rows, slopes = [], []
        for angle, T, root in zip(angles, seen, roots, strict=True):
            predicted = b.T_home_rig(float(angle)).inv() * t
            rows.append(root @ pose_difference(predicted, T))
            slopes.append(root @ _slope(b, predicted, float(angle), e1, e2))
        n = len(angles)
        return Evaluation(
            residuals=np.array(rows).reshape(1, 6 * n),
            shared=np.array(slopes).reshape(1, 6 * n, 10),
            local=np.zeros((1, 6 * n, 0)),
        )

    return Problem(names=NAMES, guess=np.zeros(10), evaluate=evaluate, n_residuals=6 * len(angles))


def _slope(base: RotaryBase, predicted: RigidTransform, angle: float, e1: Array, e2: Array) -> Array:
    """Return (6, 10): derivative of the predicted T_rig_target (t, left rotation) by the ten parameters.

    The rig sees the world turned by Q = Exp(-angle n) about the axis' point p: t = p + Q (t0 - p), R = Q R0.
    """
    Q = Rotation.from_rotvec(-angle * base.direction).as_matrix()
    D = np.eye(3) - Q
    E = np.column_stack([e1, e2])  # (3, 2)
    J = np.zeros((6, 10))
    turns = D @ np.column_stack([np.cross(base.direction, e1), np.cross(base.direction, e2)])
    arm = np.asarray(predicted.translation) - base.point_m
    J[:3, :2] = -skew(arm) @ turns
    J[3:, :2] = turns
    J[:3, 2:4] = D @ E
    J[:3, 4:7] = Q
    J[3:, 7:10] = Q
    return J


def _moved(
    base: RotaryBase, target: RigidTransform, e1: Array, e2: Array, step: Array
) -> tuple[RotaryBase, RigidTransform]:
    """Return base and target moved by the ten parameters."""
    step = np.array(step)  # scipy takes no read-only arrays
    turn = Rotation.from_rotvec(np.cross(base.direction, step[0] * e1 + step[1] * e2))
    moved = RotaryBase(
        direction=turn.as_matrix() @ base.direction,
        point_m=base.point_m + step[2] * e1 + step[3] * e2,
        T_world_home=base.T_world_home,
    )
    t = np.asarray(target.translation) + step[4:7]
    return moved, RigidTransform.from_components(t, Rotation.from_rotvec(step[7:10]) * target.rotation)


def _square_to(direction: Array) -> tuple[Array, Array]:
    """Return two unit vectors (3,) square to the direction and to each other."""
    helper = np.eye(3)[int(np.argmin(np.abs(direction)))]
    e1 = np.cross(direction, helper)
    e1 /= np.linalg.norm(e1)
    return e1, np.cross(direction, e1)


def _result(
    fit: Fit,
    base: RotaryBase,
    target: RigidTransform,
    e1: Array,
    e2: Array,
    angles: Array,
    seen: list[RigidTransform],
) -> RotaryCalibration:
    left = np.array(
        [pose_difference(T, base.T_home_rig(float(a)).inv() * target) for a, T in zip(angles, seen, strict=True)]
    )
    if fit.covariance is None:
        raise Degenerate("the poses leave the axis open")
    C = fit.covariance.matrix
    std = fit.std()
    std["axis.direction_rad"] = float(np.sqrt(np.linalg.eigvalsh(C[:2, :2])[-1]))
    std["axis.place_m"] = float(np.sqrt(np.linalg.eigvalsh(C[2:4, 2:4])[-1]))
    return RotaryCalibration(
        base=base,
        T_home_target=target,
        e1=e1,
        e2=e2,
        covariance=fit.covariance,
        std=std,
        scale=fit.scale,
        dof=fit.dof,
        rms_m=float(np.sqrt((left[:, :3] ** 2).sum(axis=1).mean())),
        rms_rad=float(np.sqrt((left[:, 3:] ** 2).sum(axis=1).mean())),
        n_used=len(angles),
        span_rad=float(np.ptp(angles)),
        angles_rad=tuple(angles.tolist()),
    )
