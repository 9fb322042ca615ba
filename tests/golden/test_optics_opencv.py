"""Camera, rays, triangulation and epipolar geometry against OpenCV, which shares none of the code."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.optics import Camera, Rig, RigKind, epipolar_distance, triangulate, triangulate_closed

EXACT = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 200, 1e-14)
DISTORTION = (-0.28, 0.09, 8e-4, -5e-4, -0.012)


def camera(skew: float = 0.0) -> Camera:
    return Camera.pinhole(1280, 720, 1131.0, 1127.0, 643.5, 352.25, skew=skew, distortion=DISTORTION)


def rig() -> Rig:
    T = RigidTransform.from_components([0.12, -0.004, 0.01], Rotation.from_rotvec([0.01, -0.15, 0.02]))
    left = RigidTransform.from_components([0.3, 0.2, -0.1], Rotation.from_rotvec([0.1, 0.2, -0.3]))
    other = Camera.pinhole(1280, 720, 1090.0, 1093.0, 655.0, 361.0, distortion=(-0.2, 0.05, -3e-4, 6e-4, 0.0))
    return Rig(kind=RigKind.STEREO, left=camera(), right=other, T_rig_left=left, T_rig_right=left * T)


def seen_by_opencv(rig: Rig, points: np.ndarray) -> list[np.ndarray]:
    out = []
    for cam, T in ((rig.left, rig.T_rig_left.inv()), (rig.right, rig.T_rig_right.inv())):
        uv, _ = cv2.projectPoints(
            np.ascontiguousarray(points), T.rotation.as_rotvec(), T.translation, cam.matrix, cam.distortion
        )
        out.append(uv[:, 0])
    return out


def points_in_front(rig: Rig, n: int, seed: int) -> np.ndarray:
    local = np.random.default_rng(seed).uniform([-0.15, -0.1, 0.4], [0.2, 0.1, 1.2], (n, 3))
    return rig.T_rig_left.apply(local)


def test_projection_is_opencvs() -> None:
    points = np.random.default_rng(1).uniform([-0.3, -0.2, 0.5], [0.3, 0.2, 2.0], (200, 3))
    uv, _ = cv2.projectPoints(points, np.zeros(3), np.zeros(3), camera().matrix, camera().distortion)
    np.testing.assert_allclose(camera().project(points), uv[:, 0], atol=1e-9)


def test_rays_are_opencvs_and_invert_the_projection() -> None:
    uv = np.random.default_rng(2).uniform([20, 20], [1260, 700], (200, 2))
    theirs = cv2.undistortPointsIter(uv[:, None], camera().matrix, camera().distortion, None, None, EXACT)
    ours = camera().rays(uv)
    np.testing.assert_allclose(ours, theirs[:, 0], atol=1e-9)
    np.testing.assert_allclose(camera().project(np.column_stack([ours, np.ones(len(ours))])), uv, atol=1e-9)


@pytest.mark.parametrize("method", [triangulate, triangulate_closed])
def test_exact_pixels_of_opencv_triangulate_to_the_point(method) -> None:
    points = points_in_front(rig(), 100, 3)
    left, right = seen_by_opencv(rig(), points)
    seen = method(rig(), left, right, np.eye(2), np.eye(2)).require_all()
    np.testing.assert_allclose(seen.xyz_m, points, atol=1e-9)


def test_noisy_points_beat_opencvs_triangulation_in_likelihood() -> None:
    """The maximum of likelihood has no larger reprojection error than the algebraic solution, for every point."""
    r, rng = rig(), np.random.default_rng(4)
    points = points_in_front(r, 200, 5)
    left, right = (uv + rng.normal(0.0, 0.5, uv.shape) for uv in seen_by_opencv(r, points))
    P = [np.hstack([T.rotation.as_matrix(), T.translation[:, None]]) for T in (r.T_rig_left.inv(), r.T_rig_right.inv())]
    flat = [cv2.undistortPoints(uv, c.matrix, c.distortion)[:, 0] for uv, c in ((left, r.left), (right, r.right))]
    X = cv2.triangulatePoints(P[0], P[1], flat[0].T, flat[1].T)
    theirs = (X[:3] / X[3]).T
    ours = triangulate(r, left, right, 0.25 * np.eye(2), 0.25 * np.eye(2)).require_all()

    def chi2(points: np.ndarray) -> np.ndarray:
        seen = seen_by_opencv(r, points)
        return ((seen[0] - left) ** 2 + (seen[1] - right) ** 2).sum(axis=1) / 0.25

    np.testing.assert_allclose(chi2(ours.xyz_m), ours.chi2, atol=1e-7)
    assert (ours.chi2 <= chi2(theirs) + 1e-8).all()
    assert 0.7 < ours.chi2.mean() < 1.3  # one degree of freedom each


def test_epipolar_distance_is_measured_in_the_distorted_image() -> None:
    """A pixel pushed off its epipolar curve by 0.4 px is 0.4 px away from it, wherever in the image."""
    points = points_in_front(rig(), 50, 7)
    left, right = seen_by_opencv(rig(), points)
    assert np.abs(epipolar_distance(rig(), left, right)).max() < 1e-6
    depths = rig().T_rig_left.apply(rig().T_rig_left.inv().apply(points) * 1.001)  # along the left ray
    along = seen_by_opencv(rig(), depths)[1] - right
    across = np.column_stack([-along[:, 1], along[:, 0]]) / np.linalg.norm(along, axis=1)[:, None]
    off = epipolar_distance(rig(), left, right + 0.4 * across)[:, 1]
    np.testing.assert_allclose(np.abs(off), 0.4, atol=2e-3)
