"""Triangulation: claimed covariances against the spread, and every degenerate case by name."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from scipy.stats import chi2 as chi2_law

from armsight.errors import Degenerate
from armsight.optics import Camera, Rig, Verdict, converged_rig, parallel_rig, triangulate, triangulate_closed
from refusals import refuses

CAMERA = Camera.pinhole(1280, 720, 1131.0, 1127.0, 643.5, 352.25, distortion=(-0.28, 0.09, 8e-4, -5e-4, -0.012))
METHODS = [triangulate, triangulate_closed]
COV = 0.01 * np.eye(2)


def rig() -> Rig:
    return converged_rig(CAMERA, CAMERA, 0.12, 0.1, -0.07)


def seen(points: np.ndarray) -> list[np.ndarray]:
    out = []
    for T in (rig().T_rig_left.inv(), rig().T_rig_right.inv()):
        uv, _ = cv2.projectPoints(
            np.ascontiguousarray(points), T.rotation.as_rotvec(), T.translation, CAMERA.matrix, CAMERA.distortion
        )
        out.append(uv[:, 0])
    return out


@pytest.mark.parametrize("method", METHODS)
def test_errors_are_as_large_as_claimed(method) -> None:
    """4,000 points with correlated, unequal noise: Mahalanobis distances follow chi-square with 3 degrees."""
    rng, n = np.random.default_rng(1), 4000
    points = rng.uniform([-0.12, -0.08, 0.45], [0.12, 0.08, 0.9], (n, 3))
    covs = [np.array([[0.02, 0.008], [0.008, 0.01]]), np.array([[0.005, 0.0], [0.0, 0.03]])]
    noisy = [uv + rng.multivariate_normal([0, 0], C, n) for uv, C in zip(seen(points), covs, strict=True)]
    found = method(rig(), *noisy, *covs).require_all()
    d = found.xyz_m - points
    q = np.einsum("ni,nij,nj->n", d, np.linalg.inv(found.covariance_m2), d)
    assert abs(q.mean() / 3.0 - 1.0) < 5.0 * np.sqrt(
        2.0 / (3.0 * n)
    )  # 5 standard deviations of a mean of n chi-squares
    assert 0.935 < (q < chi2_law.ppf(0.95, 3)).mean() < 0.965


def test_likelihood_uses_unequal_noise_where_the_closed_form_cannot() -> None:
    rng, n = np.random.default_rng(2), 1000
    points = rng.uniform([-0.1, -0.08, 0.45], [0.1, 0.08, 0.9], (n, 3))
    left, right = seen(points)
    good, bad = 1e-4 * np.eye(2), 0.25 * np.eye(2)
    left, right = left + rng.normal(0, 0.01, left.shape), right + rng.normal(0, 0.5, right.shape)
    errors = [np.linalg.norm(m(rig(), left, right, good, bad).xyz_m - points, axis=1) for m in METHODS]
    assert np.median(errors[0]) <= np.median(errors[1])
    lateral = [np.abs((m(rig(), left, right, good, bad).xyz_m - points)[:, 1]).mean() for m in METHODS]
    assert lateral[0] < 0.6 * lateral[1]


@pytest.mark.parametrize("method", METHODS)
def test_behind_the_cameras(method) -> None:
    pair = parallel_rig(CAMERA, 0.1)
    left, right = pair.project(np.array([[0.0, 0.0, 0.6], [0.02, 0.01, 0.7]]))
    swapped = method(pair, right, left, COV, COV)
    assert (swapped.verdict == Verdict.BEHIND).all()
    assert np.isnan(swapped.xyz_m).all()
    with refuses(Degenerate, "behind"):
        swapped.require_all()


@pytest.mark.parametrize("method", METHODS)
def test_parallel_rays(method) -> None:
    pair = parallel_rig(CAMERA, 0.1)
    at = np.array([[700.0, 300.0], [900.0, 200.0]])
    assert (method(pair, at, at, COV, COV).verdict == Verdict.PARALLEL).all()


@pytest.mark.parametrize("method", METHODS)
def test_too_far_for_the_noise(method) -> None:
    """At 100 m a disparity of 1.1 px +- 1 px: infinity is within three standard deviations, so there is no distance."""
    pair = parallel_rig(Camera.pinhole(1280, 720, 1130.0, 1130.0, 640.0, 360.0), 0.1)
    left, right = pair.project([0.0, 0.0, 100.0])
    assert method(pair, left, right, np.eye(2), np.eye(2)).verdict[0] == Verdict.PARALLEL
    assert method(pair, left, right, 1e-4 * np.eye(2), 1e-4 * np.eye(2)).verdict[0] == Verdict.FOUND


@pytest.mark.parametrize("method", METHODS)
def test_one_bad_row_spoils_no_other(method) -> None:
    left, right = seen(np.array([[0.0, 0.0, 0.6], [0.02, 0.01, 0.7], [0.05, 0.0, 0.8]]))
    left[1] = np.nan
    out = method(rig(), left, right, COV, COV)
    assert out.verdict.tolist() == [Verdict.FOUND, Verdict.NO_RAY, Verdict.FOUND]
    np.testing.assert_allclose(out.xyz_m[[0, 2]], [[0.0, 0.0, 0.6], [0.05, 0.0, 0.8]], atol=1e-9)
    assert np.isnan(out.xyz_m[1]).all() and np.isnan(out.covariance_m2[1]).all()


def test_a_covariance_that_is_not_one_gives_no_likelihood() -> None:
    left, right = seen(np.array([[0.0, 0.0, 0.6]]))
    assert triangulate(rig(), left, right, np.zeros((2, 2)), COV).verdict[0] == Verdict.NO_RAY
