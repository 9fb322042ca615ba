"""Errors of one recording hang together in time: white noise and a drift that is forgotten exponentially.

Share and time of the drift are averaged over a grid by restricted likelihood (Patterson, Thompson 1971; Hoeting and
others 1999), so that what is not known of them widens the answer. Errors are made independent by Kalman's filter of the
drift, in a time that grows with the rows, not with their cube.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve

from armsight.arrays import Array
from armsight.fitting.groups import without
from armsight.fitting.quantiles import chi2_sf, student_factor

SHARES = (0.2, 0.4, 0.6, 0.75, 0.87, 0.95, 0.99, 0.999)
"""Shares of the errors' variance that drift, of the models that are weighed against each other. Without the last one,
errors that drift altogether (over 40 of 400 rows) were taken for ones that are forgotten 1.5 times as fast, with as
little white noise beside their change from row to row: claims were 1.5 times too narrow."""
TIMES = 10
"""Correlation times that are tried, from the spacing of the rows to the length of the recording."""
LEAST_TIME_S = 1e-3
FEWEST = 12.0
"""Independent poses that a recording should be worth."""
BLOCKS = 6
"""Blocks of time that are left out one after the other."""
DRIFTS = 0.05
"""Share of the variance below which nothing drifts that a gap beside a block would have to keep out."""
MEMORY = 4_000_000
"""Numbers that are held at a time."""
NEGLIGIBLE = 1e-4
"""Weight below which a model has no say in a covariance."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Correlation:
    """How the errors of a recording hang together in time.

    time_s: after which a drift is forgotten (to 1/e). share: of the errors' variance that drifts. n_effective: how many
    independent poses they are worth; all three are means over the models, weighed by their likelihood. counted: whether
    times are in rows, of which nobody knows when they were taken.
    """

    time_s: float
    share: float
    n_effective: float
    counted: bool = False

    def neighbours(self, spacing_s: float) -> float:
        """Return how far errors so far apart in time are alike, from 0 to 1."""
        return self.share * float(np.exp(-spacing_s / max(self.time_s, LEAST_TIME_S)))

    def warnings(self, n: int) -> tuple[str, ...]:
        """Return what to do where a recording's n poses are worth too few; nothing where they are worth enough."""
        if self.n_effective >= FEWEST:
            return ()
        return (
            f"The errors of this recording drift over some {self.time_s:.2g} s, so that its {n} poses are worth "
            f"{self.n_effective:.0f} independent ones: record longer, or several times, and turn more.",
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Averaged:
    """The step (m,) to the best unknowns and its covariance C (m, m), over all models; weight, share, time_s and the
    variance of the errors of each model (M,)."""

    step: Array
    C: Array
    correlation: Correlation
    weight: Array
    share: Array
    time_s: Array
    variance: Array


def fit_averaged(r: Array, J: Array, t_s: Array, prior: tuple[Array, Array] | None = None) -> Averaged:
    """Return the linear fit to residuals r (n, k), derivative J (n, k, m), whose errors drift; t_s (n,) in any order.

    All components drift alike, each with the same variance. prior: (step (m,) that it wants, information (m, m)), in
    units of its own, not of the residuals' variance.
    """
    order = np.argsort(t_s, kind="stable")
    r, J, t = r[order], J[order], t_s[order]
    shares, times, log_prior = _models(t)
    free = r.size - J.shape[2]
    found = []
    for normal, logdet, worth in _whitened_normals(r, J, t, shares, times):
        found.append(_solved(normal, logdet, free, r.shape[1], prior, worth))
    likelihood = np.array([one.likelihood for one in found]) + log_prior
    weight = np.exp(likelihood - likelihood.max())
    weight = weight / weight.sum()
    steps = np.array([one.step for one in found])
    step = weight @ steps
    spread = steps - step
    C = np.einsum("k,kab->ab", weight, np.array([one.C for one in found])) + (spread.T * weight) @ spread
    share = float(weight @ shares)
    correlation = Correlation(
        time_s=float(weight @ (shares * times) / max(share, 1e-12)),
        share=share,
        n_effective=float(weight @ np.array([one.worth for one in found])),
    )
    variance = np.array([one.variance for one in found])
    return Averaged(
        step=step, C=C, correlation=correlation, weight=weight, share=shares, time_s=times, variance=variance
    )


def score_covariance(found: Averaged, J: Array, t_s: Array) -> Array:
    """Return the covariance (m, m) of J^T e over all rows, J (n, k, m), for errors e (n, k) that drift as found.

    What a fit that weighs all rows alike has for a gradient; with independent errors of variance one it is J^T J.
    """
    order = np.argsort(t_s, kind="stable")
    J, t = J[order], t_s[order]
    own = np.einsum("nka,nkb->ab", J, J)
    out = np.zeros(own.shape)
    rest = 1.0 - found.weight[found.weight < NEGLIGIBLE].sum()
    for weight, share, time_s, variance in zip(found.weight, found.share, found.time_s, found.variance, strict=True):
        if weight < NEGLIGIBLE:
            continue
        both = own.copy()
        if share > 0.0:
            before = np.zeros_like(J[0])  # (k, m): of all earlier rows, as far as they are remembered
            cross = np.zeros_like(own)
            for i, kept in enumerate(np.exp(-np.diff(t, prepend=t[0]) / time_s).tolist()):
                before *= kept
                cross += J[i].T @ before
                before += J[i]
            both += share * (cross + cross.T)
        out += weight / rest * variance * both
    return out


def made_independent(found: Averaged, columns: Array, t_s: Array) -> Array:
    """Return columns (n, c) of rows at t_s (n,), in order of time, as they are where the errors of the likeliest model
    found are independent, each of variance one."""
    order, best = np.argsort(t_s, kind="stable"), int(np.argmax(found.weight))
    white, _ = _innovations(columns[order], t_s[order], found.share[best : best + 1], found.time_s[best : best + 1])
    return np.asarray(white[0] / np.sqrt(found.variance[best]))


def time_blocks(t_s: Array, correlation: Correlation, *, blocks: int = BLOCKS) -> list[tuple[NDArray[np.bool_], ...]]:
    """Return (rows of a block, rows further away in time than a drift lasts), each (n,), of blocks of equal time."""
    out: list[tuple[NDArray[np.bool_], ...]] = []
    edges = np.linspace(t_s.min(), t_s.max(), blocks + 1)
    edges[-1] = np.inf
    width = float(edges[1] - edges[0])
    for low, high in pairwise(edges.tolist()):
        gap = min(correlation.time_s, 0.5 * width) if correlation.share > DRIFTS else 0.0
        inside = (t_s >= low) & (t_s < high)
        if inside.any():
            out.append((inside, ~inside & ((t_s < low - gap) | (t_s >= high + gap))))
    return out


def _models(t: Array) -> tuple[Array, Array, Array]:
    """Return share, time in s and logarithm of the weight beforehand of the models: none drifts, or a share of each
    time; as much of one kind for every time as of the other."""
    span = max(float(t[-1] - t[0]), LEAST_TIME_S)
    times = np.geomspace(max(span / len(t), LEAST_TIME_S), span, TIMES)
    shares = np.repeat(SHARES, TIMES)
    return (
        np.concatenate([[0.0], shares]),
        np.concatenate([times[:1], np.tile(times, len(SHARES))]),
        np.log(np.concatenate([[float(len(SHARES))], np.ones(len(shares))])),
    )


def _whitened_normals(r: Array, J: Array, t: Array, shares: Array, times: Array) -> list[tuple[Array, float, float]]:
    """Return of each model the normal matrix (m + 1, m + 1) of (J, r) made independent, the logarithm of the errors'
    correlation's determinant, and how many independent rows they are worth."""
    n, k, m = J.shape
    columns = np.concatenate([J, r[:, :, None]], axis=2).reshape(n, -1)
    columns = np.concatenate([columns, np.ones((n, 1))], axis=1)
    out = []
    chunk = max(1, MEMORY // columns.size)
    for begin in range(0, len(shares), chunk):
        part = slice(begin, begin + chunk)
        white, logdet = _innovations(columns, t, shares[part], times[part])
        for one, logarithm in zip(white, logdet.tolist(), strict=True):
            A = one[:, :-1].reshape(n * k, m + 1)
            out.append((A.T @ A, logarithm, float(one[:, -1] @ one[:, -1])))
    return out


def _innovations(columns: Array, t: Array, share: Array, time_s: Array) -> tuple[Array, Array]:
    """Return the columns (n, c) made independent of each other by each model (M, n, c), and log det of its correlation.

    Kalman's filter of a drift in white noise (Anderson, Moore 1979): each row minus what those before it foretell, over
    the deviation of that.
    """
    M, n = len(share), len(t)
    out = np.empty((M, n, columns.shape[1]))
    kept = np.exp(-np.diff(t, prepend=t[0])[:, None] / time_s)  # (n, M)
    drift, variance = np.zeros((M, columns.shape[1])), share.copy()
    logdet = np.zeros(M)
    for i in range(n):
        drift *= kept[i, :, None]
        if i:
            variance = kept[i] ** 2 * variance + share * (1.0 - kept[i] ** 2)
        total = variance + 1.0 - share
        innovation = columns[i] - drift
        out[:, i] = innovation / np.sqrt(total)[:, None]
        gain = variance / total
        drift += gain[:, None] * innovation
        variance = variance * (1.0 - gain)
        logdet += np.log(total)
    return out, logdet


@dataclass(frozen=True, slots=True)
class _Model:
    """One share and one time of the drift: how likely they are, the fit they make, and what its rows are worth.

    step (m,), C (m, m): to the best unknowns, and its covariance. variance: of the errors. worth: independent rows.
    """

    likelihood: float
    step: Array
    C: Array
    variance: float
    worth: float


def _solved(normal: Array, logdet: float, free: int, k: int, prior: tuple[Array, Array] | None, worth: float) -> _Model:
    """Return one model's restricted likelihood, step, covariance and variance from its normal matrix."""
    H, g = normal[:-1, :-1], normal[:-1, -1]
    factor = cho_factor(H)
    step = -cho_solve(factor, g)
    variance = max(float(normal[-1, -1] + g @ step) / free, 1e-300)
    logdet_H = 2.0 * float(np.log(np.diag(factor[0])).sum())
    likelihood = -0.5 * (k * logdet + logdet_H + free * np.log(variance))
    if prior is None:
        return _Model(likelihood, step, variance * cho_solve(factor, np.eye(len(g))), variance, worth)
    wanted, information = prior
    both = cho_factor(H / variance + information)
    step = cho_solve(both, information @ wanted - g / variance)
    return _Model(likelihood, step, cho_solve(both, np.eye(len(g))), variance, worth)


# What a model has wrong differs from region to region of a motion and does not average out over rows.
#
# The scatter of the residuals says nothing of it; fits without each region do (delete-a-group jackknife, Kott 2001).

FEWEST_ROWS = 24
"""Three a region: fewer leave answers without one region that hang on single rows."""
RARE = 0.01
"""Probability by chance of the scatter of answers without a region, from which on it is what is believed: of a Panda's
nominal arm 0.005, 2e-9 and 1e-12; of independent rows one recording in ten is believed less than it could be."""


def widened(covariance: Array, slopes: Array, noise: Array, errors: Array, part: NDArray[np.intp]) -> Array:
    """Return the covariance (K, K) of an answer, as wide as answers without each region scatter.

    slopes (m, r, K), noise (m, r, r), errors (m, r) of the rows at the answer; part (m,): their regions. As it is where
    there are too few rows, or the scatter is what rows with independent errors give.
    """
    g, size = int(part.max()) + 1, len(covariance)
    if len(errors) < FEWEST_ROWS:
        return covariance
    pull = np.einsum("mrk,mrs->mks", slopes, np.linalg.inv(noise))
    own = np.array([np.einsum("mks,msl->kl", pull[part == k], slopes[part == k]) for k in range(g)])
    gradient = np.array([np.einsum("mks,ms->k", pull[part == k], errors[part == k]) for k in range(g)])
    steps = without(np.asarray(np.linalg.inv(covariance), np.float64), own, gradient)
    root = np.linalg.cholesky(covariance)
    off = np.linalg.solve(root, (steps - steps.mean(axis=0)).T)
    W = (g - 1.0) / g * (off @ off.T)  # one where rows are independent
    if chi2_sf((g - 1.0) * float(np.trace(W)), size * (g - 1)) > RARE:
        return covariance
    share, axes = np.linalg.eigh(W)
    wide = np.maximum(share * student_factor(g - 1) ** 2, 1.0)
    axes = root @ axes
    return np.asarray((axes * wide) @ axes.T)
