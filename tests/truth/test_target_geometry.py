"""A lit target's geometry against an independent world (OpenCV's projection): truth, deviations, refusals by name."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation
from scipy.stats import chi2 as chi2_law

from armsight.calibrate.target import LitFrame, TargetCalibration, calibrate_target
from armsight.optics import Camera, Rig, converged_rig
from armsight.records import Spots
from armsight.units import DEG

CAMERA = Camera.pinhole(1280, 720, 1131.0, 1127.0, 643.5, 352.25, distortion=(-0.28, 0.09, 8e-4, -5e-4, -0.012))
RIG = converged_rig(CAMERA, CAMERA, 0.12, 0.08, -0.08)
SIGMA_PX = 0.05

# A left, B lower right, C upper right of the camera (x right, y down): the frame's x is u, its z is w
SCALENE = np.array([[-0.045, 0.0, 0.0], [0.03, 0.03, 0.0], [0.015, -0.03, 0.0]])
ISOSCELES = np.array([[-0.05, 0.0, 0.0], [0.025, 0.03, 0.0], [0.025, -0.03, 0.0]])
EQUILATERAL = 0.045 * np.array([[-1.0, 0.0, 0.0], [0.5, np.sqrt(0.75), 0.0], [0.5, -np.sqrt(0.75), 0.0]])
LINE = np.array([[-0.05, 0.0, 0.0], [0.01, 0.0, 0.0], [0.05, 0.0, 0.0]])


def frame_axes(X: np.ndarray) -> np.ndarray:
    """Lights in Pachidis's frame, written once more from eqs. (7)-(8)."""
    G = (X[0] + X[1] + X[2]) / 3.0
    u = (G - X[0]) / np.linalg.norm(G - X[0])
    w = np.cross(X[1] - G, X[0] - G)
    w /= np.linalg.norm(w)
    return (X - G) @ np.array([u, np.cross(w, u), w]).T


def look(points: np.ndarray, rig: Rig = RIG) -> list[np.ndarray]:
    return [
        cv2.projectPoints(
            np.ascontiguousarray(points), T.rotation.as_rotvec(), T.translation, camera.matrix, camera.distortion
        )[0][:, 0]
        for camera, T in ((rig.left, rig.T_rig_left.inv()), (rig.right, rig.T_rig_right.inv()))
    ]


def spots(uv: np.ndarray, sigma_px: float) -> Spots:
    n = len(uv)
    return Spots(
        uv_px=uv,
        covariance_px2=np.tile(sigma_px**2 * np.eye(2), (n, 1, 1)),
        peak=np.full(n, 100.0),
        size_px=np.full(n, 2.0),
        model=("gaussian",) * n,
    )


def poses(rng: np.random.Generator, n: int, tilt_deg: float = 25.0) -> list[RigidTransform]:
    return [
        RigidTransform.from_components(
            rng.uniform([-0.1, -0.08, 0.5], [0.1, 0.08, 0.7]),
            Rotation.from_rotvec(rng.normal(0, tilt_deg * DEG / 1.7, 3)),
        )
        for _ in range(n)
    ]


def see(
    points: np.ndarray, name: str, rng: np.random.Generator, sigma_px: float = SIGMA_PX, rig: Rig = RIG
) -> LitFrame:
    """A frame of points in rig axes, the pairs in an order of its own."""
    order = rng.permutation(len(points))
    left, right = (spots((uv + rng.normal(0, sigma_px, uv.shape))[order], sigma_px) for uv in look(points, rig))
    return LitFrame(name=name, left=left, right=right)


def recording(
    X: np.ndarray, rng: np.random.Generator, n: int = 12, *, sigma_px: float = SIGMA_PX, rig: Rig = RIG
) -> list[LitFrame]:
    return [see(T.apply(X), f"frame {i}", rng, sigma_px, rig) for i, T in enumerate(poses(rng, n))]


def free_chi2(done: TargetCalibration, truth: np.ndarray) -> tuple[float, int]:
    """Whitened squared error in the directions that the frame's convention leaves free."""
    values, vectors = np.linalg.eigh(done.covariance.matrix)
    free = values > 1e-9 * values.max()
    e = vectors[:, free].T @ (done.xyz_m - truth).ravel()
    return float((e**2 / values[free]).sum()), int(free.sum())


def test_exact_spots_give_the_exact_shape_in_pachidis_frame() -> None:
    done = calibrate_target(RIG, recording(SCALENE, np.random.default_rng(1), sigma_px=1e-6))
    np.testing.assert_allclose(done.xyz_m, frame_axes(SCALENE), atol=2e-9)
    assert done.names == ("A", "B", "C") and done.n_used == 12 and not done.rejected
    assert done.loo_rms_px < 1e-4


@pytest.mark.parametrize("shape", [SCALENE, ISOSCELES], ids=["scalene", "isosceles"])
def test_errors_are_as_large_as_the_deviations_say(shape: np.ndarray) -> None:
    total = dof = 0.0
    for seed in range(25):
        done = calibrate_target(RIG, recording(shape, np.random.default_rng([7, seed])))
        chi2, free = free_chi2(done, frame_axes(shape))
        total, dof = total + chi2, dof + free
    assert dof == 75
    assert chi2_law.ppf(1e-4, dof) < total < chi2_law.isf(1e-4, dof)
