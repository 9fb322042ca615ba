"""Variances of noise beside a known one, by restricted maximum likelihood: for any shapes, a few poses at a time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

VARIANCE_ROUNDS = 60
VARIANCE_SETTLED = 1e-3
"""Share of the noise by which no variance may still move."""
ALIKE = 1e-9
"""Added to the information of variances of unit information: covariances of one shape are told from no common noise."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Restricted:
    """variances (K,), their covariance (K, K), V (n, 6, 6): the noise they make of each observation, and the restricted
    log-likelihood."""

    variances: Array
    covariance: Array
    V: Array
    log_likelihood: float


def restricted_variances(
    e: Array,
    J: Array,
    known: Array,
    Q: Array,
    used: NDArray[np.bool_],
    floor: Array,
    start: Array | None = None,
    believed: float = np.inf,
) -> Restricted:
    """Return the variances theta of V_i = known_i + sum theta_k Q_ki from the residuals of a linear model.

    e (n, 6), J (n, 6, m), known (n, 6, 6), Q (K, n, 6, 6). used (n,): observations that count. floor (K,): the
    least variances. start (K,): near the answer. believed: standard deviation of the logarithm of the last variance
    about nought, as it is known beforehand. Fisher scoring on the restricted likelihood (Patterson, Thompson 1971),
    halved where it would fall.
    """
    theta = _first(e[used], Q[:, used]) if start is None else start
    theta = np.maximum(theta, floor)
    best, value = theta, -np.inf
    for _ in range(VARIANCE_ROUNDS):
        likelihood, score, information, share = _step(e[used], J[used], known[used], Q[:, used], theta)
        if np.isfinite(believed):
            logarithm = np.log(theta[-1])
            likelihood -= 0.5 * (logarithm / believed) ** 2
            score[-1] -= logarithm / (believed**2 * theta[-1])
            information[-1, -1] += 1.0 / (believed * theta[-1]) ** 2
        if likelihood < value - 1e-9:
            theta = 0.5 * (theta + best)
            continue
        best, value = theta, likelihood
        free = (theta > floor) | (score > 0.0)
        step = np.zeros_like(theta)
        step[free] = _solved(information[np.ix_(free, free)], score[free])
        new = np.maximum(np.maximum(theta + step, floor), 0.05 * theta * (floor > 0.0))
        settled = (np.abs(new - theta) * share).max(initial=0.0, where=free) <= VARIANCE_SETTLED
        theta = new
        if settled:
            break
    V = known + np.einsum("k,knij->nij", theta, Q)
    likelihood, _, information, _ = _step(e[used], J[used], known[used], Q[:, used], theta)
    scale = 1.0 / np.sqrt(np.diag(information))
    covariance = np.linalg.pinv(information * np.outer(scale, scale), rcond=1e-9, hermitian=True)
    return Restricted(variances=theta, covariance=covariance * np.outer(scale, scale), V=V, log_likelihood=likelihood)


def _first(e: Array, Q: Array) -> Array:
    """Return a start: translation from the translations, orientation shared out evenly."""
    move, turn = float((e[:, :3] ** 2).mean()), float((e[:, 3:] ** 2).mean())
    return np.array([move, 0.5 * turn, 0.5 * turn])[: len(Q)]


def _solved(information: Array, score: Array) -> Array:
    """Return the scoring step; shapes that the data cannot tell apart share it."""
    scale = 1.0 / np.sqrt(np.diag(information))
    alike = information * np.outer(scale, scale) + ALIKE * np.eye(len(scale))
    return np.asarray(scale * np.linalg.solve(alike, scale * score))


def _step(e: Array, J: Array, known: Array, Q: Array, theta: Array) -> tuple[float, Array, Array, Array]:
    """Return the restricted log-likelihood, its score (K,), expected information (K, K), and what a unit of each
    variance adds to the noise (K,), as a share of it."""
    V = known + np.einsum("k,knij->nij", theta, Q)
    W = np.linalg.inv(V)
    WJ = W @ J
    H = np.einsum("nia,nib->ab", J, WJ)
    C = np.linalg.inv(H)
    r = e - J @ (C @ np.einsum("nia,ni->a", WJ, e))
    Wr = np.einsum("nij,nj->ni", W, r)
    P = W - WJ @ C @ WJ.transpose(0, 2, 1)  # diagonal blocks
    score = 0.5 * (np.einsum("ni,knij,nj->k", Wr, Q, Wr) - np.einsum("nij,knji->k", P, Q))
    PQ = P @ Q  # (K, n, 6, 6)
    information = 0.5 * np.einsum("knij,lnji->kl", PQ, PQ)
    _, logdet = np.linalg.slogdet(V)
    likelihood = -0.5 * (logdet.sum() + np.linalg.slogdet(H)[1] + float(np.einsum("ni,ni->", r, Wr)))
    return float(likelihood), score, information, np.einsum("nij,knji->k", W, Q) / e.size
