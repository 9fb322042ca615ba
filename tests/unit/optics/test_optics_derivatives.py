"""Every analytic derivative of the optics against central differences."""

import numpy as np

from armsight.optics.kernels.camera import intrinsics_jacobian, project_point, undistort_point
from armsight.optics.kernels.triangulation import epipolar_residual, rays_in_rig

K = np.array([1131.0, 1127.0, 643.5, 352.25, 1.5, -0.28, 0.09, 8e-4, -5e-4, -0.012])


def central(function, at: np.ndarray, step: np.ndarray) -> np.ndarray:
    columns = []
    for i, h in enumerate(step):
        d = np.zeros_like(at)
        d[i] = h
        columns.append((function(at + d) - function(at - d)) / (2.0 * h))
    return np.column_stack(columns)


def project(k: np.ndarray, p: np.ndarray) -> np.ndarray:
    uv, J = np.empty(2), np.empty((2, 3))
    assert project_point(k, p[0], p[1], p[2], uv, J)
    return uv


def test_projection_by_the_point_and_by_the_intrinsics() -> None:
    for p in np.random.default_rng(1).uniform([-0.3, -0.2, 0.5], [0.3, 0.2, 1.5], (20, 3)):
        uv, J, D = np.empty(2), np.empty((2, 3)), np.empty((2, 10))
        project_point(K, *p, uv, J)
        intrinsics_jacobian(K, *p, D)
        np.testing.assert_allclose(J, central(lambda q: project(K, q), p, np.full(3, 1e-6)), rtol=1e-6, atol=1e-4)
        steps = np.array([1e-3] * 5 + [1e-6] * 5)
        np.testing.assert_allclose(D, central(lambda k, p=p: project(k, p), K, steps), rtol=1e-6, atol=1e-6)


def test_ray_by_the_pixel() -> None:
    def ray(uv: np.ndarray) -> np.ndarray:
        xy = np.empty(2)
        assert undistort_point(K, uv[0], uv[1], xy, np.empty((2, 2)))
        return xy

    for uv in np.random.default_rng(2).uniform([30, 30], [1250, 690], (20, 2)):
        J = np.empty((2, 2))
        undistort_point(K, uv[0], uv[1], np.empty(2), J)
        np.testing.assert_allclose(J, central(ray, uv, np.full(2, 1e-3)), rtol=1e-6, atol=1e-10)


def test_epipolar_residual_by_both_pixels() -> None:
    R, baseline = np.eye(3), np.array([0.1, 0.003, -0.01])

    def rays(uv: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        d, D = np.empty((1, 3)), np.empty((1, 3, 2))
        rays_in_rig(K, R, uv[None].copy(), d, D, np.empty(1, np.bool_))
        return d[0], D[0]

    def residual(four: np.ndarray) -> np.ndarray:
        g = np.empty(2), np.empty(2)
        return np.array([epipolar_residual(*rays(four[:2]), *rays(four[2:]), baseline, *g)])

    at = np.array([300.0, 420.0, 250.0, 431.0])
    left, right = np.empty(2), np.empty(2)
    epipolar_residual(*rays(at[:2]), *rays(at[2:]), baseline, left, right)
    np.testing.assert_allclose(
        np.concatenate([left, right]), central(residual, at, np.full(4, 1e-3))[0], rtol=1e-6, atol=1e-12
    )


def test_a_pixel_beyond_the_fold_has_no_ray() -> None:
    k = np.array([1000.0, 1000.0, 500.0, 500.0, 0.0, -0.5, 0.0, 0.0, 0.0, 0.0])  # folds at r = 0.816
    assert not undistort_point(k, 500.0 + 700.0, 500.0, np.empty(2), np.empty((2, 2)))
    assert not undistort_point(k, np.nan, 500.0, np.empty(2), np.empty((2, 2)))
