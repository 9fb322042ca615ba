"""Each compiled fit against the engine on the same data: same optimum, same covariance (decision 0001).

The models are written anew here, with derivatives by finite differences.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.special import erf

from armsight.fitting import Evaluation, Fit, Problem, solve
from armsight.fitting.kernels import diagonalise
from armsight.geometry import pose_from_rotvec
from armsight.kinematics import fk, preset, solve_numeric
from armsight.measure.boards.kernels import subpixel
from armsight.measure.poses.kernels import pose as pose_kernels
from armsight.measure.poses.pose import UNKNOWN
from armsight.measure.spots.kernels import light_models
from armsight.measure.spots.kernels.columns import Picture
from armsight.measure.spots.kernels.leastsquares import fit_model
from armsight.measure.spots.kernels.light_models import STREAK, grid_of
from armsight.measure.spots.kernels.patch import Patch
from armsight.measure.spots.kernels.round_gaussian import (
    COV,
    DOF,
    RESULT,
    RSS,
    A,
    B,
    Q,
    U,
    V,
    fit_round,
    new_work,
)
from armsight.optics import Camera, PackedRig, parallel_rig, triangulate

Array = NDArray[np.float64]
RIG = parallel_rig(Camera.pinhole(640, 480, 800.0, 800.0, 319.5, 239.5), 0.1)
ANY = np.empty((0, 0), np.uint8)


def by_engine(residuals: Callable[[Array], Array], start: Array) -> Fit:
    """Return the engine's fit of whitened residuals, with derivatives by central differences."""
    steps = 1e-6 * np.maximum(np.abs(start), 0.1)

    def evaluate(shared: Array, local: Array) -> Evaluation:
        p = np.array(shared)
        h = np.diag(steps)
        J = np.stack([(residuals(p + row) - residuals(p - row)) / (2.0 * row.sum()) for row in h], axis=1)
        r = residuals(p)
        return Evaluation(residuals=r[None], shared=J[None], local=np.zeros((1, len(r), 0)))

    names = tuple(f"p{i}" for i in range(len(start)))
    return solve(Problem(names=names, guess=start, evaluate=evaluate, n_residuals=len(residuals(start))))


def spots_of(points_m: Array, rng: np.random.Generator) -> tuple[Array, Array]:
    """Return noisy spots uv (n, 2, 2) [point, side] of points and covariances, each its own and tilted."""
    L = rng.normal(0.0, 0.1, (len(points_m), 2, 2, 2)) + 0.2 * np.eye(2)
    cov = L @ L.swapaxes(-1, -2)
    uv = np.stack(RIG.project(points_m), axis=1)
    return uv + np.einsum("nsij,nsj->nsi", L, rng.normal(size=uv.shape)), cov


def whitened(points_m: Array, uv: Array, cov: Array) -> Array:
    """Return the whitened residuals of points seen at uv."""
    r = np.stack(RIG.project(points_m), axis=1) - uv
    return np.linalg.solve(np.linalg.cholesky(cov), r[..., None]).ravel()


def test_a_triangulated_point_is_the_engines() -> None:
    rng = np.random.default_rng(1)
    for point in np.array([[0.1, -0.2, 1.0], [-0.3, 0.1, 2.5], [0.0, 0.0, 0.5]]):
        uv, cov = spots_of(point[None], rng)
        fast = triangulate(RIG, uv[:, 0], uv[:, 1], cov[:, 0], cov[:, 1])
        slow = by_engine(lambda p, uv=uv, cov=cov: whitened(p[None], uv, cov), point + 0.01)  # type: ignore[misc]
        assert slow.covariance is not None
        C = slow.covariance.matrix
        d = fast.xyz_m[0] - slow.shared
        assert d @ np.linalg.solve(C, d) < 1e-6
        np.testing.assert_allclose(fast.covariance_m2[0], C, rtol=1e-3, atol=1e-4 * np.abs(C).max())


def test_eigenvalues_and_their_vectors_are_lapacks() -> None:
    rng = np.random.default_rng(5)
    cases = [rng.normal(size=(n, n)) * 10.0 ** rng.uniform(-9.0, 9.0) for n in (1, 2, 3, 4, 5) for _ in range(40)]
    cases += [np.zeros((4, 4)), np.eye(4), np.diag([3.0, -5.0, 3.0, 1.0]), np.outer(np.arange(4.0), np.arange(4.0))]
    for half in cases:
        S = half + half.T
        D, V = S.copy(), np.empty_like(S)
        diagonalise(D, V)
        size = max(np.abs(S).max(), 1e-300)
        np.testing.assert_allclose(V @ np.diag(np.diag(D)) @ V.T, S, atol=1e-14 * size)
        np.testing.assert_allclose(V.T @ V, np.eye(len(S)), atol=1e-14)
        np.testing.assert_allclose(np.sort(np.diag(D)), np.linalg.eigvalsh(S), atol=2e-14 * size)


def test_the_pose_of_a_target_is_the_engines() -> None:
    rng = np.random.default_rng(2)
    X = np.array([[-0.04, 0.0, 0.0], [0.03, 0.032, 0.0], [0.03, -0.03, 0.01], [0.0, 0.05, -0.02]])
    guess = np.array([0.05, -0.02, 0.9, 0.2, -0.3, 0.4])
    uv, cov = spots_of(pose_from_rotvec(guess[:3], guess[3:]).apply(X), rng)
    packed, n = PackedRig.of(RIG), len(X)
    T, C, residual = np.empty((4, 4)), np.empty((6, 6)), np.zeros((n, 2, 2))
    state, _, chi2 = pose_kernels.solve_named(
        packed.arrays, (uv, cov), 0.0, (X, np.zeros((n, 2)), np.array([0.0, 0.0, 1.0])), UNKNOWN,
        np.empty((n, 3)), np.empty((n, 3, 3)), T, C, residual,
    )  # fmt: skip
    assert state == pose_kernels.SOLVED
    # about the answer, in the project's perturbation: translation and a turn from the left
    at = T.copy()

    def residuals(p: Array) -> Array:
        turned = pose_from_rotvec(np.zeros(3), p[3:]).as_matrix()[:3, :3] @ at[:3, :3]
        return whitened(X @ turned.T + at[:3, 3] + p[:3], uv, cov)

    slow = by_engine(residuals, np.array([1e-3, -1e-3, 2e-3, 0.01, -0.01, 0.005]))
    assert slow.covariance is not None
    std = np.sqrt(np.diag(slow.covariance.matrix))
    assert (np.abs(slow.shared) < 1e-3 * std).all()
    np.testing.assert_allclose(np.sqrt(np.diag(C)), std, rtol=1e-3)
    assert chi2 == pytest.approx(float(np.sum(residuals(np.zeros(6)) ** 2)), rel=1e-6)


def test_a_round_light_is_the_engines() -> None:
    rng = np.random.default_rng(3)
    y, x = np.mgrid[:60, :70]
    truth = np.array([33.3, 28.6, 120.0, 6.0, 20.0])  # u, v, height, variance, background

    def light(p: Array) -> Array:
        return np.asarray(p[4] + p[2] * np.exp(-((x - p[0]) ** 2 + (y - p[1]) ** 2) / (2.0 * p[3])))

    image = np.clip(np.rint(light(truth) + rng.normal(0.0, 2.0, x.shape)), 0, 255).astype(np.uint8)
    work, out = new_work(), np.empty(RESULT)
    hot = np.empty((0, 2), np.int64)
    start = truth + np.array([0.4, -0.3, 10.0, 1.0, 2.0])
    flat = np.full(4, 1e-12)  # the background's slope is known to be none
    assert fit_round(Picture(image, np.uint8(0), 255, ANY), hot, False, start, flat, work, out)
    x0, x1, y0, y1 = work.box
    window = np.s_[y0:y1, x0:x1]
    slow = by_engine(lambda p: (light(p)[window] - image[window]).ravel(), start)
    assert slow.covariance is not None
    std = np.sqrt(np.diag(slow.covariance.matrix))  # of noise of one grey level, as out's
    assert (np.abs(out[[U, V, A, Q, B]] - slow.shared) < 0.2 * std).all()
    assert np.sqrt(out[[COV, COV + 2]]) == pytest.approx(std[:2], rel=0.02)
    assert out[RSS] / out[DOF] == pytest.approx(4.0, rel=0.2)


def test_a_streak_is_the_engines() -> None:
    rng = np.random.default_rng(4)
    ny, nx = 25, 31
    truth = np.array([12.0, 15.2, 12.4, 90.0, 1.6, 0.5, 2.4])
    values = np.empty((ny, nx))
    residuals = np.zeros((ny, nx))
    p = truth.copy()
    use = np.ones((ny, nx), np.uint8)

    # the model at the truth, from the fit's own residuals of an empty picture, then noise on top
    def light(p: Array) -> Array:
        m, J = np.empty(nx * ny), np.empty((len(p), nx * ny))
        light_models.light(STREAK, p, len(p), grid_of(0, 0, nx, ny), J, m)
        return m + p[0]

    values = light(truth).reshape(ny, nx) + rng.normal(0.0, 1.5, (ny, nx))
    residuals, use = np.zeros((ny, nx)), np.ones((ny, nx), np.uint8)
    p = truth + np.array([1.0, 0.3, -0.2, 8.0, 0.1, -0.1, 0.2])
    start = p.copy()
    assert fit_model(STREAK, p, len(p), Patch(np.array([0, nx, 0, ny]), values, use), nx * ny, residuals) > 0.0
    slow = by_engine(lambda q: (light(q) - values.ravel()) / 1.5, start)
    assert slow.covariance is not None
    std = np.sqrt(np.diag(slow.covariance.matrix))
    assert (np.abs(p - slow.shared) < 0.1 * std)[[0, 1, 2, 3]].all()


@pytest.mark.parametrize("aside", [False, True])
def test_a_boards_corner_is_the_engines(aside: bool) -> None:
    rng = np.random.default_rng(5)
    y, x = (v.ravel().astype(float) for v in np.mgrid[-12:13, -12:13])

    def level(p: Array) -> Array:
        edges = [erf((-np.sin(a) * (x - p[0]) + np.cos(a) * (y - p[1])) / (np.sqrt(2.0) * s))
                 for a, s in ((p[2], p[4]), (p[3], p[5]))]  # fmt: skip
        return np.asarray(p[6] + p[7] * x + p[8] * y + p[9] * edges[0] * edges[1])

    truth = np.array([0.21, -0.33, 0.15, 1.75, 0.9, 1.1, 120.0, 0.8, -0.5, 85.0])
    v = level(truth) + rng.normal(0.0, 1.0, x.shape)
    p = truth + np.array([0.2, 0.2, 0.05, -0.05, 0.2, -0.1, 5.0, 0.0, 0.0, -8.0])
    start = p.copy()
    H, window, work = np.empty((10, 10)), np.zeros((3, subpixel.LARGEST)), np.empty(subpixel.ROWS * subpixel.CHUNK)
    window[:, : len(x)] = x, y, v
    window, flat, near = window.ravel(), np.zeros((5, 5)), len(x)
    if aside:
        near = subpixel.set_aside(len(x), p, window, flat)
        assert near < 0.7 * len(x)
    subpixel._descend(0, near, p, 5.0, subpixel.LAST_STEP_PX, subpixel.TRIALS, H, window, flat, work)
    slow = by_engine(lambda q: level(q) - v, start)
    assert slow.covariance is not None
    std = np.sqrt(np.diag(slow.covariance.matrix))
    assert (np.abs(p - slow.shared) < 0.05 * std).all()
    full = np.tril(H) + np.tril(H, -1).T
    assert np.sqrt(np.diag(np.linalg.inv(full))) == pytest.approx(std, rel=0.01)


def test_inverse_kinematics_are_the_engines() -> None:
    rng = np.random.default_rng(6)
    arm = preset("ur10")
    for _ in range(7):
        q = rng.uniform(-1.5, 1.5, 6)
        T = fk(arm, q)
        slow = by_engine(lambda p, T=T: 1e3 * (fk(arm, p) - T)[:3].ravel(), q + 0.02)  # type: ignore[misc]
        fast = solve_numeric(arm, T, q + 0.02)
        assert fast.converged
        np.testing.assert_allclose(fast.q, slow.shared, atol=1e-5)
