"""Errors that drift: the fit to poses of one recording, whose errors are alike for a while."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve, solve_triangular
from scipy.spatial.transform import Rotation

from armsight.calibrate.handeye.pairs import Array, Arrays
from armsight.calibrate.handeye.solution import residuals

SHARES = (0.2, 0.4, 0.6, 0.75, 0.87, 0.95, 0.99)
"""Shares of the errors' variance that drift, of the models that are weighed against each other."""
TIMES = 10
"""Correlation times that are tried, from the spacing of the poses to the length of the recording."""
STEP = 1e-6
"""Of the numerical derivatives, m and rad."""
FEWEST = 12.0
"""Independent poses that a recording should be worth."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Correlation:
    """How the errors of a recording hang together in time.

    time_s: after which a drift is forgotten (to 1/e). share: of the errors' variance that drifts. n_effective: how many
    independent poses they are worth; all three are means over the models, weighed by their likelihood.
    """

    time_s: float
    share: float
    n_effective: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class DriftingFit:
    """The unknowns of F X B = Z, their covariance C (12, 12) of (dtX, dwX, dtZ, dwZ), turns from the left, and why."""

    R_X: Array
    t_x: Array
    R_Z: Array
    t_z: Array
    C: Array
    correlation: Correlation


def fit_drifting(
    arrays: Arrays, keep: NDArray[np.bool_], start: tuple[Array, Array, Array, Array], t_s: Array
) -> DriftingFit:
    """Return the fit to the kept pairs whose errors are white noise and a drift that is forgotten exponentially.

    arrays: of PosePairs.arrays, start: RX, tX, RZ, tZ near the answer, t_s (n,): times of the pairs. In the camera's
    axes all components drift alike, places and turns each by their own size. Share and time of the drift are averaged
    over a grid by restricted likelihood (Patterson, Thompson 1971; Hoeting and others 1999), so that what is not known
    of them widens the answer.
    """
    used: Arrays = tuple(a[keep] for a in arrays)  # type: ignore[assignment]  # four stay four
    r, J = _linear(used, start)  # (n, 6), (n, 6, 12)
    size = np.repeat(np.sqrt([np.mean(r[:, :3] ** 2), np.mean(r[:, 3:] ** 2)]), 3)
    size = np.maximum(size, 1e-12)
    r, J = r / size, J / size[:, None]
    t = t_s[keep]
    tried = [_generalised(r, J, _correlated(t, a, tau)) for a, tau in _grid(t)]
    weight = np.exp(np.array([one[0] for one in tried]) - max(one[0] for one in tried))
    weight = weight / weight.sum()
    step = np.einsum("k,ka->a", weight, np.array([one[1] for one in tried]))
    C = np.zeros((12, 12))
    for w, (_, one, covariance, _) in zip(weight, tried, strict=True):
        C += w * (covariance + np.outer(one - step, one - step))
    RX, tX, RZ, tZ = _moved(start, step)
    grid = np.array(_grid(t))
    return DriftingFit(
        R_X=RX,
        t_x=tX,
        R_Z=RZ,
        t_z=tZ,
        C=C,
        correlation=Correlation(
            time_s=float(weight @ (grid[:, 0] * grid[:, 1]) / max(float(weight @ grid[:, 0]), 1e-12)),
            share=float(weight @ grid[:, 0]),
            n_effective=float(weight @ np.array([one[3] for one in tried])),
        ),
    )


def _grid(t: Array) -> list[tuple[float, float]]:
    """Return (share, time in s) of the models: none drifts, or a share of each time; as many of one kind as other."""
    span = float(np.ptp(t))
    times = np.geomspace(max(span / len(t), 1e-3), span, TIMES)
    return [(0.0, float(times[0]))] * len(SHARES) + [(a, float(tau)) for a in SHARES for tau in times]


def _correlated(t: Array, share: float, time_s: float) -> Array:
    """Return the correlation (n, n) of the errors at times t (n,)."""
    return np.asarray((1.0 - share) * np.eye(len(t)) + share * np.exp(-np.abs(t[:, None] - t) / time_s))


def _generalised(r: Array, J: Array, R: Array) -> tuple[float, Array, Array, float]:
    """Return restricted log-likelihood, step (12,), covariance (12, 12), and the effective number of poses."""
    n, m = len(r), J.shape[2]
    L = np.linalg.cholesky(R)
    e = solve_triangular(L, r, lower=True).reshape(-1)
    D = solve_triangular(L, J.reshape(n, -1), lower=True).reshape(-1, m)
    H, g = D.T @ D, D.T @ e
    factor = cho_factor(H)
    step = -cho_solve(factor, g)
    free = 6 * n - m
    variance = float(e @ e + g @ step) / free
    logdet_R = 2.0 * float(np.log(np.diag(L)).sum())
    logdet_H = 2.0 * float(np.log(np.diag(factor[0])).sum())
    likelihood = -0.5 * (6.0 * logdet_R + logdet_H + free * np.log(max(variance, 1e-300)))
    ones = solve_triangular(L, np.ones(n), lower=True)
    return likelihood, step, variance * cho_solve(factor, np.eye(m)), float(ones @ ones)


def _linear(arrays: Arrays, start: tuple[Array, Array, Array, Array]) -> tuple[Array, Array]:
    """Return the residuals (n, 6) in camera axes, and their derivative (n, 6, 12) by steps of `_moved`."""
    r = residuals(arrays, *start)
    J = np.empty((len(r), 6, 12))
    for a in range(12):
        step = np.zeros(12)
        step[a] = STEP
        J[:, :, a] = (residuals(arrays, *_moved(start, step)) - residuals(arrays, *_moved(start, -step))) / (2.0 * STEP)
    return r, J


def _moved(start: tuple[Array, Array, Array, Array], step: Array) -> tuple[Array, Array, Array, Array]:
    """Return RX, tX, RZ, tZ after a step (12,) of (dtX, dwX, dtZ, dwZ)."""
    RX, tX, RZ, tZ = start
    turns = Rotation.from_rotvec(step.reshape(4, 3)[1::2]).as_matrix()
    return turns[0] @ RX, tX + step[:3], turns[1] @ RZ, tZ + step[6:9]


def left_out_blocks(
    arrays: Arrays,
    keep: NDArray[np.bool_],
    start: tuple[Array, Array, Array, Array],
    t_s: Array,
    correlation: Correlation,
    *,
    blocks: int = 6,
) -> Array:
    """Return the error (n, 6) of each pair against the fit to the pairs further away in time than a drift lasts.

    The recording is parted into blocks of equal time; each is left out with what lies within a correlation time.
    """
    out = residuals(arrays, *start)
    edges = np.linspace(t_s.min(), t_s.max() + 1e-9, blocks + 1)
    for low, high in pairwise(edges.tolist()):
        inside = (t_s >= low) & (t_s < high)
        gap = min(correlation.time_s, 0.5 * (high - low)) if correlation.share > 0.05 else 0.0
        others = keep & ((t_s < low - gap) | (t_s > high + gap))
        if not inside.any() or others.sum() < 4:
            continue
        fitted = fit_drifting(arrays, others, start, t_s)
        out[inside] = residuals(tuple(a[inside] for a in arrays), fitted.R_X, fitted.t_x, fitted.R_Z, fitted.t_z)
    return out
