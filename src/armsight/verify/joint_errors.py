"""Errors of the task carried into the joints: the readings that would explain each measured pose, near the reported."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from armsight.kinematics import Arm, fk, fk_jacobian, solve_numeric_many
from armsight.verify.model import Mounts
from armsight.verify.records import Measured

Array = NDArray[np.float64]

NEAREST_SINGULAR = 0.02
"""Least singular value of the Jacobian (lengths by the arm's own) below which a joint error is a multiple of noise."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class JointErrors:
    """Errors dq (m, n) of the joints, measured minus reported, in rad or m, and their standard deviations std (m, n),
    as far as the measurement's are known; NaN in rows where `why` says so. why: in words, how many rows have none."""

    dq: Array
    std: Array
    why: tuple[str, ...]

    @property
    def known(self) -> NDArray[np.bool_]:
        """Which rows (m,) have joint errors."""
        return np.asarray(np.isfinite(self.dq).all(axis=1))


def joint_errors(arm: Arm, q: Array, measured: Measured, mounts: Mounts, sigma: Array) -> JointErrors | None:
    """Return the joint errors by inverse kinematics from the reported joints q (m, n); None where poses leave it open.

    sigma (m, 2): standard deviations of a coordinate in m and a turn in rad. Positions alone do for arms of three
    joints or fewer. Rows close to a singularity and rows without a solution have none.
    """
    turned = measured.rotation is not None
    if arm.n > (6 if turned else 3) or len(mounts.tools) > 1:
        return None
    flange = measured_flange(measured, mounts)
    bare_T = np.tile(np.eye(4), (len(q), 1, 1))
    bare_T[:, :3, :] = flange[:, :3, :]
    if not turned:
        bare_T[:, :3, :3] = fk(arm, q)[:, :3, :3]
    found, solved, _ = solve_numeric_many(arm, bare_T, q, task="pose" if turned and arm.n == 6 else "position")
    _, J = fk_jacobian(arm, q)
    J = J[:, : 6 if turned and arm.n == 6 else 3]
    singular = _least_singular(J, arm) < NEAREST_SINGULAR
    bad = singular | ~solved
    dq, std = found - q, np.full(q.shape, np.nan)
    weights = np.repeat(sigma, 3, axis=1)[:, : J.shape[1]] ** 2
    inverse = np.linalg.pinv(J[~bad])
    std[~bad] = np.sqrt(np.einsum("mij,mj,mij->mi", inverse, weights[~bad], inverse))
    dq[bad] = np.nan
    return JointErrors(dq=dq, std=std, why=_why(int(singular.sum()), int((~solved & ~singular).sum()), len(q)))


def measured_flange(measured: Measured, mounts: Mounts) -> Array:
    """Return T_base_flange (m, 4, 4) as measured; of positions only the place of the tool's point, in base axes."""
    R, t = mounts.base.rotation.as_matrix(), mounts.base.translation
    T = np.tile(np.eye(4), (len(measured), 1, 1))
    T[:, :3, 3] = (measured.xyz_m - t) @ R
    if measured.rotation is not None:
        T[:, :3, :3] = R.T @ measured.rotation
    tool = mounts.tools[0].inv().as_matrix() if measured.rotation is not None else np.eye(4)
    return np.asarray(T @ tool)


def _least_singular(J: Array, arm: Arm) -> Array:
    scaled = J.copy()
    scaled[:, :3] /= arm.length_m
    columns = np.where(arm.revolute, 1.0, arm.length_m)
    return np.asarray(np.linalg.svd(scaled * columns, compute_uv=False)[:, -1])


def _why(singular: int, unsolved: int, m: int) -> tuple[str, ...]:
    told = []
    if singular:
        told.append(
            f"{singular} of {m} rows are close to a singularity, where joint errors are a multiple of the noise"
        )
    if unsolved:
        told.append(f"{unsolved} of {m} rows have no joint values near the reported ones that reach the measured pose")
    return tuple(told)
