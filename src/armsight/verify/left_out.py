"""Linear models of whitened residuals, compared on rows left out: what each gains, and whether by more than chance."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from armsight.fitting.quantiles import chi2_sf, t_sf

Array = NDArray[np.float64]

BLOCKS = 10
RIDGE = 1e-9
"""Keeps directions that no row tells where they are, in scaled information."""
SAME_POSE = 5e-3
"""Joint values (rad or m) rounded to this are one pose: its repeats do not say what another pose would."""
ROBUST = 4.0
"""Whitened rows beyond so many robust standard deviations count less."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Linear:
    """residual (m, k) in standard deviations; fixed (m, k, B): columns that are always fitted (base and tool); block
    (m,): which rows are left out together; inflation: rows worth one independent row."""

    residual: Array
    fixed: Array
    block: NDArray[np.intp]
    inflation: float

    @property
    def weight(self) -> Array:
        """Return (m,) the square root of each row's weight: gross rows count less."""
        size = np.sqrt((self.residual**2).sum(axis=1) / self.residual.shape[1])
        limit = ROBUST * max(float(np.median(size)), 1e-300)
        return np.asarray(np.sqrt(np.minimum(1.0, limit / np.maximum(size, 1e-300))))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Fitted:
    """A linear fit: values (K,) and covariance (K, K) of the columns added, in-sample sum of squares, left-out squares
    by block (b,), and how many directions were fitted."""

    values: Array
    covariance: Array
    squares: float
    left: Array
    rank: int

    @property
    def left_out(self) -> float:
        """The sum of squares on rows left out."""
        return float(self.left.sum())


def blocks(m: int, group: NDArray[np.intp] | None = None) -> NDArray[np.intp]:
    """Return (m,) which block each row is of: stretches of neighbouring rows, groups never apart."""
    if group is None:
        group = np.arange(m)
    _, first, which = np.unique(group, return_index=True, return_inverse=True)
    order = np.argsort(np.argsort(first))[which]
    block = order * BLOCKS // (order.max() + 1)
    return np.asarray(np.unique(block, return_inverse=True)[1], dtype=np.intp)  # no number without rows


def jackknife_std(problem: Linear, added: Array, region: NDArray[np.intp], prior: Array | None = None) -> Array:
    """Return the standard deviations (K,) of the values of columns added (m, k, K), by fits without each region.

    What the model has wrong differs from region to region and does not average out over rows; the scatter of the
    residuals says nothing of it (delete-a-group jackknife, Kott 2001).
    """
    parts = np.unique(region)
    left = []
    for part in parts:
        rows = np.flatnonzero(region != part)
        some = Linear(
            residual=problem.residual[rows],
            fixed=problem.fixed[rows],
            block=np.zeros(len(rows), dtype=np.intp),
            inflation=problem.inflation,
        )
        left.append(_solved(some, added[rows], prior)[0])
    if len(left) < 2:
        return np.zeros(added.shape[2])
    return np.asarray(np.sqrt((len(left) - 1.0) * np.var(left, axis=0)))


def poses_of(q: Array) -> NDArray[np.intp]:
    """Return (m,) which pose each row of joint values (m, n) is at."""
    return np.unique(np.round(q / SAME_POSE), axis=0, return_inverse=True)[1].reshape(-1)


def fit_linear(problem: Linear, added: Array, prior: Array | None = None) -> Fitted:
    """Fit the fixed columns and those added (m, k, K), to all rows and with each block left out.

    prior (K,): standard deviations about zero of the added ones, none where inf.
    """
    n_fixed, rows = problem.fixed.shape[2], problem.residual.shape[1]
    _, theta, X, y, size, H, A = _solved(problem, added, prior)
    b = X.T @ y
    squares = float(((y - X @ theta) ** 2).sum())
    block = np.repeat(problem.block, rows)
    left = np.zeros(problem.block.max() + 1)
    for k in range(len(left)):
        part, own = X[block == k], y[block == k]
        rest = np.linalg.solve(H - part.T @ part, b - part.T @ own)
        left[k] = float(((own - part @ rest) ** 2).sum())
    inverse = np.linalg.inv(H) / np.outer(size, size)
    rank = int(np.linalg.matrix_rank(A, tol=1e-8 * len(A), hermitian=True)) if len(A) else 0
    return Fitted(
        values=(theta / size)[n_fixed:],
        covariance=inverse[n_fixed:, n_fixed:],
        squares=squares,
        left=left,
        rank=rank,
    )


def _solved(problem: Linear, added: Array, prior: Array | None) -> tuple[Array, ...]:
    """Return the values (K,) of the columns added, then the scaled solution (B + K,), columns (m k, B + K), residuals
    (m k,), the columns' sizes, information with priors and without."""
    w, n_fixed = problem.weight, problem.fixed.shape[2]
    X = np.concatenate([problem.fixed, added], axis=2) * w[:, None, None]
    X = np.asarray(X.reshape(problem.residual.size, X.shape[2]))
    y = (problem.residual * w[:, None]).ravel()
    size = np.linalg.norm(X, axis=0)
    size[size == 0.0] = 1.0
    X /= size
    precision = np.zeros(X.shape[1])
    if prior is not None:
        precision[n_fixed:] = 1.0 / (prior * size[n_fixed:]) ** 2
    A = X.T @ X
    H = A + np.diag(precision + RIDGE)
    theta = np.linalg.solve(H, X.T @ y)
    return np.asarray((theta / size)[n_fixed:]), np.asarray(theta), X, y, np.asarray(size), np.asarray(H), np.asarray(A)


def gain(poorer: Fitted, richer: Fitted) -> float:
    """Return the share by which the left-out sum of squares falls; negative where it rises."""
    return 1.0 - richer.left_out / max(poorer.left_out, 1e-300)


def falls(poorer: Fitted, richer: Fitted) -> float:
    """Return the one-sided probability that left-out squares fall as much, block by block, by chance."""
    fall = poorer.left - richer.left
    spread = float(fall.std(ddof=1)) / np.sqrt(len(fall))
    if not spread > 0.0:
        return 0.0 if fall.sum() > 0.0 else 1.0
    return float(t_sf(fall.mean() / spread, len(fall) - 1))


def by_chance(problem: Linear, poorer: Fitted, richer: Fitted) -> float:
    """Return the probability that columns without meaning take as much off the sum of squares (likelihood ratio).

    The noise is what the richer fit leaves; neighbouring rows that hang together count as fewer.
    """
    count = problem.residual.size
    freedom = max(count - richer.rank, 1)
    k = max(richer.rank - poorer.rank, 1)
    noise = richer.squares / freedom
    if not noise > 0.0:
        return 0.0 if poorer.squares > 0.0 else 1.0
    worth = max(freedom / problem.inflation, 4.0)
    ratio = worth * np.log(max(poorer.squares, 1e-300) / max(richer.squares, 1e-300))
    return float(chi2_sf(ratio, k))
