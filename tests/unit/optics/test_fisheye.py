"""A fisheye lens: against OpenCV's own, by finite differences, and where it ends."""

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import RigidTransform

from armsight.optics import Camera, Rig, RigKind, epipolar_distance, triangulate
from armsight.optics.kernels.camera import intrinsics_jacobian, project_point, undistort_point
from armsight.optics.triangulate import epipolar_curve
from armsight_sim.lens import Lens

D = (-0.012, 0.02, -0.015, 0.004)
CAMERA = Camera.fisheye(1280, 1024, 420.0, 415.0, 640.3, 511.2, skew=0.3, distortion=D)
FOLDING = (0.05, -0.4, 0.0, 0.0)


def points(n: int = 200, widest_deg: float = 84.0) -> np.ndarray:
    rng = np.random.default_rng(0)
    theta, phi = rng.uniform(0.0, np.radians(widest_deg), n), rng.uniform(0.0, 2.0 * np.pi, n)
    theta[:3] = (0.0, 1e-9, 1e-6)
    z = rng.uniform(0.2, 3.0, n)
    return np.stack([np.tan(theta) * np.cos(phi) * z, np.tan(theta) * np.sin(phi) * z, z], axis=1)


def test_rays_and_the_simulated_lens_agree() -> None:
    X = points()
    uv = CAMERA.project(X)
    np.testing.assert_allclose(CAMERA.rays(uv), X[:, :2] / X[:, 2:], rtol=1e-10, atol=1e-12)
    lens = Lens(
        width=1280,
        height=1024,
        focal_px=(420.0, 415.0),
        centre_px=(640.3, 511.2),
        skew_px=0.3,
        distortion=(*D, 0.0),
        fisheye=True,
    )
    np.testing.assert_allclose(lens.project(X), uv, rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(lens.rays(uv), CAMERA.rays(uv), rtol=1e-9, atol=1e-9)


def test_derivatives_are_finite_differences() -> None:
    k, h = CAMERA.packed, 1e-6
    for X in points(25, 80.0)[2:]:
        uv, J, K = np.empty(2), np.empty((2, 3)), np.empty((2, 10))
        assert project_point(k, *X, uv, J)
        intrinsics_jacobian(k, *X, K)
        by_point = np.stack(
            [(CAMERA.project(X + e)[0] - CAMERA.project(X - e)[0]) / (2 * h) for e in h * np.eye(3)], axis=1
        )
        np.testing.assert_allclose(J, by_point, rtol=1e-5, atol=2e-3)
        for i in range(9):
            step = h * np.eye(10)[i]
            moved = [replace(CAMERA, intrinsics=CAMERA.intrinsics + s * step).project(X)[0] for s in (1.0, -1.0)]
            np.testing.assert_allclose(K[:, i], (moved[0] - moved[1]) / (2 * h), rtol=1e-5, atol=1e-4)
        assert not K[:, 9].any()
        ray, by_pixel = np.empty(2), np.empty((2, 2))
        assert undistort_point(k, *uv, ray, by_pixel)
        differences = np.stack(
            [(CAMERA.rays(uv + e)[0] - CAMERA.rays(uv - e)[0]) / 2e-4 for e in 1e-4 * np.eye(2)], axis=1
        )
        np.testing.assert_allclose(by_pixel, differences, rtol=1e-4, atol=1e-8)


def test_beyond_85_degrees_there_is_neither_image_nor_ray() -> None:
    inside, outside = np.tan(np.radians([84.9, 85.1]))
    assert np.isfinite(CAMERA.project([[inside, 0.0, 1.0]])).all()
    assert np.isnan(CAMERA.project([[outside, 0.0, 1.0], [1.0, 0.0, 0.0], [0.1, 0.0, -1.0]])).all()
    at_the_edge = CAMERA.project([[inside, 0.0, 1.0]])
    assert np.isfinite(CAMERA.rays(at_the_edge)).all()
    assert np.isnan(CAMERA.rays(at_the_edge + np.array([3.0, 0.0]))).all()


def test_a_lens_that_folds_ends_where_it_folds() -> None:
    camera = Camera.fisheye(1280, 1024, 420.0, 420.0, 640.0, 512.0, distortion=FOLDING)
    assert np.radians(40.0) < camera.widest_rad < np.radians(60.0)
    before, beyond = np.tan(camera.widest_rad + np.array([-0.01, 0.01]))
    uv = camera.project([[before, 0.0, 1.0], [beyond, 0.0, 1.0]])
    assert np.isfinite(uv[0]).all()
    assert np.isnan(uv[1]).all()
    np.testing.assert_allclose(camera.rays(uv[:1])[0], [before, 0.0], rtol=1e-6, atol=1e-9)


def test_points_are_triangulated_and_epipolar_curves_meet_their_partners() -> None:
    rig = Rig(
        kind=RigKind.STEREO,
        left=CAMERA,
        right=CAMERA,
        T_rig_left=RigidTransform.identity(),
        T_rig_right=RigidTransform.from_translation([0.2, 0.01, -0.02]),
    )
    X = points(60, 70.0)
    left, right = rig.project(X)
    seen = np.isfinite(right).all(axis=1)
    X, left, right = X[seen], left[seen], right[seen]
    cov = np.tile(0.01 * np.eye(2), (len(X), 1, 1))
    np.testing.assert_allclose(triangulate(rig, left, right, cov, cov).xyz_m, X, rtol=1e-6, atol=1e-7)
    assert np.abs(epipolar_distance(rig, left, right)).max() < 1e-7
    i = int(np.argmax(np.linalg.norm(left - [640.0, 512.0], axis=1)))
    curve = epipolar_curve(rig, "left", left[i], X[i, 2] * np.array([0.5, 1.0, 3.0]))
    np.testing.assert_allclose(curve[1], right[i], atol=1e-6)
    a, b = curve[1] - curve[0], curve[2] - curve[0]
    assert abs(a[0] * b[1] - a[1] * b[0]) / np.linalg.norm(b) > 1.0  # px: no straight line
