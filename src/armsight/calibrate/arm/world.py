"""Where the rig stands to the arm's base (Kapucu and Baysec 2005, section 2: the displacement matrix)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform, Rotation
from scipy.stats import chi2

from armsight.calibrate.arm.fit import MEDIAN_3
from armsight.calibrate.arm.points import ArmPoints, check_points
from armsight.errors import Degenerate, NotEnoughData
from armsight.fitting import Evaluation, Loss, LossKind, Problem, Settings, solve
from armsight.geometry import align_points
from armsight.kinematics import Arm, forward
from armsight.records import NamedCovariance

Array = NDArray[np.float64]

NAMES = ("x_m", "y_m", "z_m", "rx_rad", "ry_rad", "rz_rad")
GROSS = float(np.sqrt(chi2.ppf(1.0 - 1e-7, 3)))
"""Errors beyond so many deviations are gross, and left out."""
LEAST_LEFT = 4
"""Rows that must be left: six unknowns, and something to judge them by."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class WorldCalibration:
    """T_base_rig with its covariance (dt, dw in base axes), residuals (m,) in m and the rows left out, from 0."""

    T_base_rig: RigidTransform
    covariance: NamedCovariance
    residual_m: Array
    rejected: tuple[tuple[int, str], ...]

    @property
    def residual_rms_m(self) -> float:
        """RMS of the residuals of the rows used."""
        used = np.delete(self.residual_m, [row for row, _ in self.rejected])
        return float(np.sqrt(np.mean(used**2)))


def calibrate_world(arm: Arm, points: ArmPoints) -> WorldCalibration:
    """Return where the rig stands in base axes, from the tool's places in rig axes at joint readings.

    Kabsch on the arm's forward kinematics, then robust least squares with the noise estimated. Raises as check_points,
    NotEnoughData where too few agree, Degenerate where the places lie on one line.
    """
    check_points(arm, points)
    local = forward(arm, points.q)[:, :3, 3]
    base = np.asarray(arm.T_world_base.inv().apply(local))
    kept = np.arange(len(points))
    T = align_points(base, points.xyz_m).T_a_b
    for _ in range(10):
        size = np.linalg.norm(T.apply(points.xyz_m) - base, axis=1)
        sigma = max(float(np.median(size[kept]) / np.sqrt(MEDIAN_3)), 1e-9)
        good = np.flatnonzero(size <= GROSS * sigma)
        if len(good) < LEAST_LEFT:
            raise NotEnoughData(
                f"only {len(good)} of {len(points)} places agree with the arm",
                consequence="Where the rig stands is not given",
                cure="Check that arm, joint readings and places belong together, row by row",
            )
        T = align_points(base[good], points.xyz_m[good]).T_a_b
        if np.array_equal(good, kept):
            break
        kept = good
    T, covariance = _refine(T, points.xyz_m[kept], base[kept])
    size = np.linalg.norm(T.apply(points.xyz_m) - base, axis=1)
    out = sorted(set(range(len(points))) - set(kept.tolist()))
    rejected = tuple((row, f"misses the others' rig by {1e3 * size[row]:.3g} mm") for row in out)
    return WorldCalibration(T_base_rig=T, covariance=covariance, residual_m=size, rejected=rejected)


def _refine(T: RigidTransform, rig_m: Array, base_m: Array) -> tuple[RigidTransform, NamedCovariance]:
    sigma = max(float(np.sqrt(np.mean((T.apply(rig_m) - base_m) ** 2))), 1e-9)

    def evaluate(p: Array, _: Array) -> Evaluation:
        turned = rig_m @ Rotation.from_rotvec(np.array(p[3:])).as_matrix().T
        J = np.zeros((len(rig_m), 3, 6))
        J[:, :, :3] = np.eye(3)
        J[:, :, 3:] = np.cross(np.eye(3), turned[:, None, :]).transpose(0, 2, 1)
        r = (turned + p[:3] - base_m) / sigma
        return Evaluation(
            residuals=r.reshape(1, -1), shared=J.reshape(1, -1, 6) / sigma, local=np.empty((1, r.size, 0))
        )

    def retract(p: Array, local: Array, step: Array, step_local: Array) -> tuple[Array, Array]:
        turn = Rotation.from_rotvec(np.array(step[3:])) * Rotation.from_rotvec(np.array(p[3:]))
        return np.append(p[:3] + step[:3], turn.as_rotvec()), local + step_local

    problem = Problem(
        names=NAMES, guess=np.append(T.translation, T.rotation.as_rotvec()), evaluate=evaluate, retract=retract,
        n_residuals=3 * len(rig_m), loss=Loss(kind=LossKind.HUBER, scale=3.0, block=3),
    )  # fmt: skip
    fit = solve(problem, Settings(estimate_noise=True))
    if fit.covariance is None:
        raise Degenerate("the places leave the rig's pose open", cure="Move at least two joints")
    p = np.array(fit.shared)
    return RigidTransform.from_components(p[:3], Rotation.from_rotvec(p[3:])), fit.covariance
