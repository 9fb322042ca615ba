"""Errors that drift: the filter against whole matrices, blocks of time, and what is told."""

import numpy as np
import pytest

from armsight.calibrate.correlation import Correlation, fit_averaged, score_covariance, time_blocks

N, M = 30, 3


def drifting(seed: int, share: float, time_s: float) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return residuals (n, 2), derivative (n, 2, m), times (n,) and the errors' correlation (n, n)."""
    rng = np.random.default_rng(seed)
    t = np.sort(rng.uniform(0.0, 10.0, N))
    R = (1.0 - share) * np.eye(N) + share * np.exp(-np.abs(t[:, None] - t) / time_s)
    J = rng.normal(size=(N, 2, M))
    return np.linalg.cholesky(R) @ rng.normal(size=(N, 2)), J, t, R


def test_each_models_fit_is_that_of_whole_matrices() -> None:
    r, J, t, _ = drifting(0, 0.8, 2.0)
    found = fit_averaged(r, J, t)
    steps, covariances, likelihood, worth = [], [], [], []
    for share, time_s in zip(found.share, found.time_s, strict=True):
        R = (1.0 - share) * np.eye(N) + share * np.exp(-np.abs(t[:, None] - t) / time_s)
        W = np.kron(np.linalg.inv(R), np.eye(2))
        A, b = J.reshape(-1, M), r.ravel()
        H = A.T @ W @ A
        steps.append(-np.linalg.solve(H, A.T @ W @ b))
        e = b + A @ steps[-1]
        variance = float(e @ W @ e) / (2 * N - M)
        covariances.append(variance * np.linalg.inv(H))
        logdet = 2.0 * np.linalg.slogdet(R)[1] + np.linalg.slogdet(H)[1]
        likelihood.append(-0.5 * (logdet + (2 * N - M) * np.log(variance)))
        worth.append(np.linalg.inv(R).sum())
    weight = np.exp(np.array(likelihood) - max(likelihood)) * np.where(found.share == 0.0, 8.0, 1.0)
    weight = weight / weight.sum()
    step = weight @ np.array(steps)
    spread = np.array(steps) - step
    C = np.einsum("k,kab->ab", weight, covariances) + (spread.T * weight) @ spread
    assert found.weight == pytest.approx(weight, abs=1e-9)
    assert found.step == pytest.approx(step, rel=1e-9)
    assert np.allclose(found.C, C, rtol=1e-9)
    assert found.correlation.n_effective == pytest.approx(weight @ worth, rel=1e-9)


def test_the_order_of_rows_plays_no_part_and_a_prior_counts_for_what_it_is() -> None:
    r, J, t, _ = drifting(1, 0.8, 2.0)
    order = np.random.default_rng(2).permutation(N)
    plain = fit_averaged(r, J, t)
    assert fit_averaged(r[order], J[order], t[order]).step == pytest.approx(plain.step, rel=1e-9)
    sure = fit_averaged(r, J, t, (np.full(M, 3.0), 1e12 * np.eye(M)))
    unsure = fit_averaged(r, J, t, (np.full(M, 3.0), 1e-12 * np.eye(M)))
    assert sure.step == pytest.approx(np.full(M, 3.0), abs=1e-6) and np.diag(sure.C).max() < 1e-11
    assert unsure.step == pytest.approx(plain.step, abs=1e-9)


def test_the_gradients_scatter_is_that_of_whole_matrices() -> None:
    r, J, t, _ = drifting(3, 0.8, 2.0)
    found = fit_averaged(r, J, t)
    expected = np.zeros((M, M))
    for weight, share, time_s, variance in zip(found.weight, found.share, found.time_s, found.variance, strict=True):
        R = (1.0 - share) * np.eye(N) + share * np.exp(-np.abs(t[:, None] - t) / time_s)
        A = J.reshape(-1, M)
        expected += weight * variance * A.T @ np.kron(R, np.eye(2)) @ A
    order = np.random.default_rng(4).permutation(N)
    assert score_covariance(found, J[order], t[order]) == pytest.approx(expected, rel=2e-2)


def test_blocks_leave_out_what_is_near_in_time() -> None:
    t = np.linspace(0.0, 60.0, 121)
    blocks = time_blocks(t, Correlation(time_s=3.0, share=0.8, n_effective=10.0))
    assert len(blocks) == 6 and sum(inside.sum() for inside, _ in blocks) == len(t)
    for inside, away in blocks:
        assert np.abs(t[away][:, None] - t[inside]).min() >= 3.0 - 1e-9
    alone = time_blocks(t, Correlation(time_s=3.0, share=0.0, n_effective=121.0))
    assert all((inside | away).all() for inside, away in alone)
