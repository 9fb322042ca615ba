"""Closed forms of hand-eye calibration: Park-Martin, dual quaternions, Shah, Zhuang.

All solve F_i X B_i = Z (RF, tF, RB, tB: arrays over n pairs) without noise exactly; with noise each weighs it in its
own way. The fit starts from Shah's (kernels.closed_forms); the others are there to be compared with it. Each returns
(RX, tX, RZ, tZ) and raises Degenerate where the motions leave the rotation open.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.spatial.transform import Rotation

from armsight.arrays import Array
from armsight.calibrate.handeye.kernels import closed_forms as kernels
from armsight.calibrate.handeye.pairs import Arrays
from armsight.errors import Degenerate

ClosedForm = tuple[Array, Array, Array, Array]

SECOND_AXIS = 1e-6
"""Share of the second over the first singular value of the motions below which they turn about one axis only."""


def shah(arrays: Arrays) -> ClosedForm:
    """Return Shah's solution 2013: rotations from the dominant singular vectors of the sum of RF (x) RB'."""
    keep = np.ones(len(arrays[0]), bool)
    RX, _ = kernels.shah_rotations(arrays[0], arrays[2], keep)
    return _complete(RX, arrays)


def park_martin(arrays: Arrays) -> ClosedForm:
    """Return Park and Martin's solution 1994: rotation vectors of all motions turned onto each other."""
    alpha, beta = _motions(arrays)
    M = beta.T @ alpha  # (3, 3)
    U, s, Vt = np.linalg.svd(M)
    _require_two_axes(s)
    D = np.diag([1.0, 1.0, np.linalg.det(Vt.T @ U.T)])
    return _complete(Vt.T @ D @ U.T, arrays)


def dual_quaternion(arrays: Arrays) -> ClosedForm:
    """Return Daniilidis' solution 1999: rotation and translation together from the screws of all motions."""
    RF, tF, RB, tB = arrays
    i, j = np.triu_indices(len(RF), 1)
    # F_j^-1 F_i X = X B_j B_i^-1
    RA = RF[j].transpose(0, 2, 1) @ RF[i]
    tA = np.einsum("nji,nj->ni", RF[j], tF[i] - tF[j])
    RM = RB[j] @ RB[i].transpose(0, 2, 1)
    tM = tB[j] - np.einsum("nij,nj->ni", RM, tB[i])
    a, a2 = _dual(RA, tA)
    b, b2 = _dual(RM, tM)
    T = np.zeros((len(a), 6, 8))
    T[:, :3, 0] = T[:, 3:, 4] = a[:, :3] - b[:, :3]
    T[:, :3, 1:4] = T[:, 3:, 5:8] = _cross(a[:, :3] + b[:, :3])
    T[:, 3:, 0] = a2[:, :3] - b2[:, :3]
    T[:, 3:, 1:4] = _cross(a2[:, :3] + b2[:, :3])
    _, s, Vt = np.linalg.svd(T.reshape(-1, 8), full_matrices=False)
    if s[5] <= SECOND_AXIS * s[0]:
        raise _one_axis()
    u, v = Vt[6].reshape(2, 4), Vt[7].reshape(2, 4)  # dual quaternion = l1 u + l2 v
    options = []
    c = (u[0] @ u[1], u[0] @ v[1] + v[0] @ u[1], v[0] @ v[1])
    for ratio in np.roots(c) if abs(c[0]) > 1e-15 else np.array([-c[2] / c[1], np.inf]):
        l1, l2 = (float(np.real(ratio)), 1.0) if np.isfinite(ratio) else (1.0, 0.0)
        q = l1 * u + l2 * v
        options.append((float(q[0] @ q[0]) / (l1 * l1 + l2 * l2), q))
    real, dual = max(options, key=lambda option: option[0])[1]
    size = np.linalg.norm(real)
    real, dual = real / size, dual / size
    R = Rotation.from_quat(np.roll(real, -1))
    t = _translation(real, dual)
    return R.as_matrix(), t, *_target(R.as_matrix(), t, arrays)


def zhuang(arrays: Arrays) -> ClosedForm:
    """Return the solution of AX = YB linear in both quaternions (Zhuang, Roth, Sudhakar 1994; Pachidis 2005 section 4).

    F X = Z B^-1 is qF qX = qZ qB^-1: eight homogeneous unknowns.
    """
    RF, _, RB, _ = arrays
    qf = Rotation.from_matrix(RF).as_quat()
    qb = Rotation.from_matrix(RB).inv().as_quat()
    # one sign per pair is free: turn every pair by less than half a turn from the first, on both sides
    for q in (qf, qb):
        q[q @ q[0] < 0.0] *= -1.0
    best = None
    for sign in (1.0, -1.0):
        rows = np.concatenate([_left(qf), -sign * _right(qb)], axis=2).reshape(-1, 8)
        _, s, Vt = np.linalg.svd(rows, full_matrices=False)
        if best is None or s[7] < best[0]:
            best = (s[7], s, Vt[7])
    if best is None or best[1][6] <= SECOND_AXIS * best[1][0]:
        raise _one_axis()
    RX = Rotation.from_quat(best[2][:4]).as_matrix()
    return _complete(RX, arrays)


CLOSED_FORMS: dict[str, Callable[[Arrays], ClosedForm]] = {
    "shah": shah,
    "park-martin": park_martin,
    "dual quaternion": dual_quaternion,
    "zhuang": zhuang,
}


def _complete(RX: Array, arrays: Arrays) -> ClosedForm:
    """Return the rotation with what follows from it by linear least squares."""
    RF, tF, RB, tB = arrays
    keep = np.ones(len(RF), bool)
    ok, tX, tZ, _ = kernels.translations(np.ascontiguousarray(RX), RF, tF, tB, keep, False)
    if not ok:
        raise _one_axis()
    return RX, tX, kernels.mean_target(np.ascontiguousarray(RX), RF, RB, keep), tZ


def _target(RX: Array, tX: Array, arrays: Arrays) -> tuple[Array, Array]:
    RF, tF, RB, tB = arrays
    keep = np.ones(len(RF), bool)
    RZ = kernels.mean_target(np.ascontiguousarray(RX), RF, RB, keep)
    tZ = (np.einsum("nij,nj->ni", RF, tB @ RX.T + tX) + tF).mean(axis=0)
    return RZ, tZ


def _motions(arrays: Arrays) -> tuple[Array, Array]:
    """Return rotation vectors of the motions between all pairs: of the robot and of the camera."""
    RF, _, RB, _ = arrays
    i, j = np.triu_indices(len(RF), 1)
    alpha = Rotation.from_matrix(RF[j].transpose(0, 2, 1) @ RF[i]).as_rotvec()
    beta = Rotation.from_matrix(RB[j] @ RB[i].transpose(0, 2, 1)).as_rotvec()
    return alpha, beta


def _dual(R: Array, t: Array) -> tuple[Array, Array]:
    """Return real and dual quaternions, vector first, of motions, real scalar >= 0."""
    q = Rotation.from_matrix(R).as_quat(canonical=True)
    v, w = q[:, :3], q[:, 3:]
    dual = np.concatenate([0.5 * (w * t + np.cross(t, v)), -0.5 * (t * v).sum(axis=1, keepdims=True)], axis=1)
    return q, dual


def _translation(real: Array, dual: Array) -> Array:
    """Return t = 2 dual conj(real), quaternions scalar first."""
    w, v = real[0], real[1:]
    return np.asarray(2.0 * (-dual[0] * v + w * dual[1:] - np.cross(dual[1:], v)))


def _cross(v: Array) -> Array:
    """Return (n, 3, 3) cross-product matrices."""
    out = np.zeros((len(v), 3, 3))
    out[:, 0, 1], out[:, 0, 2], out[:, 1, 2] = -v[:, 2], v[:, 1], -v[:, 0]
    return out - out.transpose(0, 2, 1)


def _left(q: Array) -> Array:
    """Return (n, 4, 4): multiplication by scalar-last quaternions from the left."""
    x, y, z, w = q.T
    return np.array([[w, -z, y, x], [z, w, -x, y], [-y, x, w, z], [-x, -y, -z, w]]).transpose(2, 0, 1)


def _right(q: Array) -> Array:
    """Return (n, 4, 4): multiplication by scalar-last quaternions from the right."""
    x, y, z, w = q.T
    return np.array([[w, z, -y, x], [-z, w, x, y], [y, -x, w, z], [-x, -y, -z, w]]).transpose(2, 0, 1)


def _require_two_axes(singular: Array) -> None:
    if singular[1] <= SECOND_AXIS * singular[0]:
        raise _one_axis()


def _one_axis() -> Degenerate:
    return Degenerate(
        "the hand turns about one axis only",
        consequence="The camera's place cannot be known",
        cure="Add poses that turn the hand about a second axis",
    )
