"""Compiled fits against the engine on the same data: same optimum, same covariance (decision 0001).

The models are written anew here, with derivatives by finite differences. Spots and poses are held against the bound of
their data: tests/truth/test_spots.py, test_pose.py.
"""

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.special import erf

from armsight.fitting import Evaluation, Fit, Problem, solve
from armsight.fitting.kernels import diagonalise
from armsight.kinematics import fk, preset, solve_numeric
from armsight.measure.boards.kernels import subpixel
from armsight.optics import Camera, parallel_rig, triangulate

Array = NDArray[np.float64]
RIG = parallel_rig(Camera.pinhole(640, 480, 800.0, 800.0, 319.5, 239.5), 0.1)


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
    H, window = np.empty((10, 10)), np.zeros((3, subpixel.LARGEST), np.float32)
    work = np.empty(subpixel.ROWS * subpixel.CHUNK, np.float32)
    window[:, : len(x)] = x, y, v
    window, flat, near = np.append(window, np.zeros(subpixel.CHUNK, np.float32)), np.zeros((5, 5)), len(x)
    if aside:
        near = subpixel.set_aside(len(x), p, window, flat)
        assert near < 0.7 * len(x)
    subpixel._descend(0, near, p, 5.0, 1e-4, subpixel.TRIALS, H, window, flat, work)
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
