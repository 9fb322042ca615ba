"""Poses as scipy RigidTransform, and first-order propagation of their 6x6 covariances.

A pose T_a_b maps coordinates of frame b into frame a. Its covariance (6, 6) belongs to the perturbation
(dt, dw): translation t + dt and rotation Exp(dw) R, both in the axes of the parent frame a.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.arrays import Array
from armsight.errors import Degenerate, Inconsistent, NotEnoughData

QUAT_NORM_TOLERANCE = 1e-3
"""Quaternions further from unit length than this are refused: typing errors, not rounding."""


def pose_from_quat(xyz_m: ArrayLike, quat_xyzw: ArrayLike) -> RigidTransform:
    """Return the pose at xyz_m (3,) with the scalar-last quaternion (4,).

    Raises Inconsistent where the quaternion's length is off by more than QUAT_NORM_TOLERANCE or anything
    is not finite; smaller deviations are rounding and are renormalised.
    """
    t, q = np.asarray(xyz_m, float), np.asarray(quat_xyzw, float)
    if t.shape != (3,) or q.shape != (4,) or not (np.isfinite(t).all() and np.isfinite(q).all()):
        raise Inconsistent(
            f"a pose needs 3 finite coordinates and 4 finite quaternion entries, not {t.tolist()}, {q.tolist()}"
        )
    with np.errstate(over="ignore"):  # an entry of 1e200 is refused below like any other wrong length
        norm = float(np.linalg.norm(q))
    if abs(norm - 1.0) > QUAT_NORM_TOLERANCE:
        raise Inconsistent(
            f"the quaternion {q.tolist()} has length {norm:.6g}, not 1",
            consequence="It does not say a rotation",
            cure="Check the order of the columns (x, y, z, w) and their precision",
        )
    return RigidTransform.from_components(t, Rotation.from_quat(q))


def pose_from_rotvec(xyz_m: ArrayLike, rotvec_rad: ArrayLike) -> RigidTransform:
    """Return the pose at xyz_m (3,) turned by the rotation vector (3,) in radians."""
    return RigidTransform.from_components(np.asarray(xyz_m, float), Rotation.from_rotvec(np.asarray(rotvec_rad, float)))


def pose_from_euler(xyz_m: ArrayLike, rx_ry_rz_rad: ArrayLike) -> RigidTransform:
    """Return the pose at xyz_m (3,) with R = Rz Ry Rx (the papers' yaw, pitch, roll; MATH 3.2)."""
    return RigidTransform.from_components(
        np.asarray(xyz_m, float), Rotation.from_euler("xyz", np.asarray(rx_ry_rz_rad, float))
    )


def pose_from_matrix(R: ArrayLike, t_m: ArrayLike) -> RigidTransform:
    """Return the pose of a proper rotation matrix (3, 3) and a translation (3,)."""
    return RigidTransform.from_components(np.asarray(t_m, float), Rotation.from_matrix(np.asarray(R, float)))


def xyz_quat(pose: RigidTransform) -> tuple[Array, Array]:
    """Return xyz (3,) in m and the scalar-last quaternion (4,) with w >= 0."""
    return np.asarray(pose.translation, float), np.asarray(pose.rotation.as_quat(canonical=True), float)


def quat_of_matrix(T: Array) -> tuple[float, float, float, float]:
    """Return the scalar-last quaternion, w >= 0, of a pose's matrix (4, 4) or of a rotation's (3, 3).

    By the largest of the four (Shepperd 1978); plain Python, for a single pose a tenth of scipy's time.
    """
    (a, b, c), (d, e, f), (g, h, i) = T[:3, :3].tolist()
    w, x, y, z = 1.0 + a + e + i, 1.0 + a - e - i, 1.0 - a + e - i, 1.0 - a - e + i  # four times their squares
    largest = max(w, x, y, z)
    if largest == w:
        q = (h - f, c - g, d - b, w)
    elif largest == x:
        q = (x, b + d, c + g, h - f)
    elif largest == y:
        q = (b + d, y, f + h, c - g)
    else:
        q = (c + g, f + h, z, d - b)
    scale = math.copysign(1.0 / math.sqrt(q[0] ** 2 + q[1] ** 2 + q[2] ** 2 + q[3] ** 2), q[3])
    return q[0] * scale, q[1] * scale, q[2] * scale, q[3] * scale


def euler_rad(rotation: Rotation) -> Array:
    """Return (rx, ry, rz), angles about x, y, z with R = Rz Ry Rx, shape (3,) or (n, 3)."""
    return np.asarray(rotation.as_euler("xyz", suppress_warnings=True), float)


def pose_difference(measured: RigidTransform, reference: RigidTransform) -> Array:
    """Return (dt, dw) (6,) in the parent's axes that carries reference into measured."""
    dt = np.asarray(measured.translation) - np.asarray(reference.translation)
    dw = (measured.rotation * reference.rotation.inv()).as_rotvec()
    return np.concatenate([dt, dw])


def is_close(a: RigidTransform, b: RigidTransform, *, tol_m: float, tol_rad: float) -> bool:
    """Tell whether two poses agree in position within tol_m and in angle within tol_rad."""
    difference = pose_difference(a, b)
    return bool(np.linalg.norm(difference[:3]) <= tol_m and np.linalg.norm(difference[3:]) <= tol_rad)


def moved_parent_covariance(T_a_b: RigidTransform, covariance_b_c: Array) -> Array:
    """Return the covariance (6, 6) of T_a_c = T_a_b * T_b_c for an exact T_a_b."""
    A = np.kron(np.eye(2), T_a_b.rotation.as_matrix())  # (6, 6)
    return np.asarray(A @ covariance_b_c @ A.T)


def compose_covariance(
    T_a_b: RigidTransform, covariance_a_b: Array, T_b_c: RigidTransform, covariance_b_c: Array
) -> Array:
    """Return the covariance (6, 6) of T_a_c = T_a_b * T_b_c, first order, both factors independent."""
    R = T_a_b.rotation.as_matrix()  # (3, 3)
    lever = np.eye(6)
    lever[:3, 3:] = -skew(R @ np.asarray(T_b_c.translation))  # dw x (R t)
    return np.asarray(lever @ covariance_a_b @ lever.T) + moved_parent_covariance(T_a_b, covariance_b_c)


def inverse_covariance(T_a_b: RigidTransform, covariance_a_b: Array) -> Array:
    """Return the covariance (6, 6) of T_b_a, first order."""
    Rt = T_a_b.rotation.as_matrix().T  # (3, 3)
    A = np.zeros((6, 6))
    A[:3, :3] = -Rt
    A[:3, 3:] = -Rt @ skew(np.asarray(T_a_b.translation))
    A[3:, 3:] = -Rt
    return np.asarray(A @ covariance_a_b @ A.T)


# The algebra of rotations: what a small turn does to a vector, and the matrix of the cross product.


def skew(v: ArrayLike) -> NDArray[np.float64]:
    """Return the matrices (..., 3, 3) that take the cross product with v (..., 3) from the left: skew(v) w = v x w."""
    x, y, z = np.moveaxis(np.asarray(v, float), -1, 0)
    o = np.zeros_like(x)
    return np.moveaxis(np.array([[o, -z, y], [z, o, -x], [-y, x, o]]), (0, 1), (-2, -1))


def stepped(p: Array, step: Array, rotvecs_at: Iterable[int]) -> Array:
    """Return parameters (k,) after a step (k,): rotation vectors, which begin at those places, turn as Exp(dw) R in the
    parent's axes, all else moves by addition."""
    out = p + step
    for k in rotvecs_at:
        turn, before = Rotation.from_rotvec(np.array(step[k : k + 3])), Rotation.from_rotvec(np.array(p[k : k + 3]))
        out[k : k + 3] = (turn * before).as_rotvec()
    return out


# The rigid motion that best carries one set of points onto another (Kabsch, weighted).

COLLINEAR_RATIO = 1e-6
"""Points whose second principal spread is below this share of the first lie on one line."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Alignment:
    """The rigid motion that carries one set of points onto another.

    T_a_b: p_a = T_a_b.apply(p_b). rms_m: root mean square of the 3-D residual norms.
    """

    T_a_b: RigidTransform
    rms_m: float


def align_points(points_a: ArrayLike, points_b: ArrayLike, weights: ArrayLike | None = None) -> Alignment:
    """Return the rigid motion from frame b to frame a that minimises the weighted squared distances.

    points_a, points_b: (n, 3) in m, n >= 3, same order. weights: (n,) positive. Kabsch 1976 with the
    reflection excluded. Raises NotEnoughData below three points, Degenerate where they lie on one line.
    """
    a, b = np.asarray(points_a, float), np.asarray(points_b, float)
    if a.shape != b.shape or a.ndim != 2 or a.shape[1] != 3:
        raise ValueError(f"need two (n, 3) arrays of the same shape, not {a.shape} and {b.shape}")
    if len(a) < 3:
        raise NotEnoughData(
            f"{len(a)} points do not fix a pose", consequence="No orientation can be given", cure="Show three"
        )
    w = np.ones(len(a)) if weights is None else np.asarray(weights, float)
    w = w / w.sum()
    mean_a, mean_b = w @ a, w @ b  # (3,)
    da, db = a - mean_a, b - mean_b
    for centred in (da, db):
        spread = np.linalg.svd(centred, compute_uv=False)
        if spread[1] <= COLLINEAR_RATIO * spread[0] or spread[0] == 0.0:
            raise Degenerate(
                "the points lie on one line",
                consequence="The turn about that line cannot be known",
                cure="Use a target whose spots form a triangle",
            )
    U, _, Vt = np.linalg.svd(da.T @ (w[:, None] * db))  # (3, 3)
    D = np.diag([1.0, 1.0, np.sign(np.linalg.det(U @ Vt))])
    R = U @ D @ Vt
    residual = da - db @ R.T
    rms = float(np.sqrt(w @ (residual**2).sum(axis=1)))
    return Alignment(T_a_b=pose_from_matrix(R, mean_a - R @ mean_b), rms_m=rms)
