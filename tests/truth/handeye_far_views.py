"""Hand-eye pairs whose camera poses are known unequally well: far and oblique views worse, place tied to turn.

Four lights on a stick, seen by a pinhole camera of this file's own; the target's origin lies beside them, so that a
turn moves it. The covariance of each pose is that of a least-squares fit to the lights' noise, by differences.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

DEG, MM = np.pi / 180, 1e-3
LIGHTS = np.array([[0.20, -0.05, 0.0], [0.30, -0.05, 0.02], [0.30, 0.05, 0.0], [0.20, 0.05, -0.02]])
FOCAL_PX, PIXEL = 1100.0, 0.15


@dataclass(frozen=True, kw_only=True)
class FarViews:
    """True T_flange_camera and T_base_target; what robot and camera said (n); covariance (n, 6, 6) of the latter."""

    X: RigidTransform
    Z: RigidTransform
    robot: RigidTransform
    camera: RigidTransform
    covariance: np.ndarray


def pixels(R: np.ndarray, t: np.ndarray) -> np.ndarray:
    p = LIGHTS @ R.T + t
    return (FOCAL_PX * p[:, :2] / p[:, 2:]).ravel()


def covariance_of(R: np.ndarray, t: np.ndarray) -> np.ndarray:
    """Return (6, 6): of (dt, dw), t + dt and Exp(dw) R, from noise of PIXEL in each light's image."""
    J = np.empty((2 * len(LIGHTS), 6))
    for k in range(6):
        ends = []
        for sign in (1.0, -1.0):
            d = np.zeros(6)
            d[k] = sign * 1e-6
            ends.append(pixels(Rotation.from_rotvec(d[3:]).as_matrix() @ R, t + d[:3]))
        J[:, k] = (ends[0] - ends[1]) / 2e-6
    return PIXEL**2 * np.linalg.inv(J.T @ J)


def far_views(seed: int, n: int, *, robot_m: float = 0.05 * MM, robot_rad: float = 0.01 * DEG) -> FarViews:
    """Draw places and n pairs from 0.4 to 1.8 m."""
    rng = np.random.default_rng([n, seed, 77])
    X = RigidTransform.from_components(
        np.array([0.03, -0.06, 0.09]) + rng.normal(0, 0.02, 3), Rotation.from_rotvec(rng.normal(0, 0.4, 3))
    )
    Z = RigidTransform.from_components(
        np.array([0.6, 0.1, 0.0]) + rng.normal(0, 0.1, 3), Rotation.from_rotvec(rng.normal(0, 0.4, 3))
    )
    R = (Rotation.from_rotvec([np.pi, 0, 0]) * Rotation.from_rotvec(rng.uniform(-0.5, 0.5, (n, 3)))).as_matrix()
    z = np.exp(rng.uniform(np.log(0.4), np.log(1.8), n))
    t = np.stack([0.25 * z * rng.uniform(-1, 1, n) - 0.2, 0.2 * z * rng.uniform(-1, 1, n), z], axis=1)
    B = RigidTransform.from_components(t, Rotation.from_matrix(R))
    A = Z * B.inv() * X.inv()
    C = np.array([covariance_of(r, p) for r, p in zip(R, t, strict=True)])
    off = np.einsum("nij,nj->ni", np.linalg.cholesky(C), rng.normal(size=(n, 6)))
    seen = RigidTransform.from_components(t + off[:, :3], Rotation.from_rotvec(off[:, 3:]) * B.rotation)
    moved = A.translation + robot_m * rng.normal(size=(n, 3))
    told = RigidTransform.from_components(moved, Rotation.from_rotvec(robot_rad * rng.normal(size=(n, 3))) * A.rotation)
    return FarViews(X=X, Z=Z, robot=told, camera=seen, covariance=C)
