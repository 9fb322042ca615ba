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
    where that would fall a step that cannot overshoot (Zhou and others 2019, MM algorithms), then halved.
    """
    theta = _first(e[used], Q[:, used]) if start is None else start
    theta = np.maximum(theta, floor)
    best, value, sure = theta, -np.inf, None
    for _ in range(VARIANCE_ROUNDS):
        likelihood, pull, push, information, share = _step(e[used], J[used], known[used], Q[:, used], theta)
        if np.isfinite(believed):
            slope = -np.log(theta[-1]) / (believed**2 * theta[-1])
            likelihood -= 0.5 * (np.log(theta[-1]) / believed) ** 2
            pull[-1] += max(2.0 * slope, 0.0)
            push[-1] += max(-2.0 * slope, 0.0)
            information[-1, -1] += 1.0 / (believed * theta[-1]) ** 2
        if likelihood < value - 1e-9:
            theta, sure = (0.5 * (theta + best), None) if sure is None else (sure, None)
            continue
        best, value, score = theta, likelihood, 0.5 * (pull - push)
        sure = np.maximum(theta * np.sqrt(pull / push), floor)
        free = (theta > floor) | (score > 0.0)
        least = np.maximum(floor, 0.05 * theta * (floor > 0.0))
        new = _scored(theta, score, information, free, least)
        settled = (np.abs(new - theta) * share).max(initial=0.0, where=free) <= VARIANCE_SETTLED
        theta = new
        if settled:
            break
    theta = best
    V = known + np.einsum("k,knij->nij", theta, Q)
    likelihood, _, _, information, _ = _step(e[used], J[used], known[used], Q[:, used], theta)
    scale = 1.0 / np.sqrt(np.diag(information))
    covariance = np.linalg.pinv(information * np.outer(scale, scale), rcond=1e-9, hermitian=True)
    return Restricted(variances=theta, covariance=covariance * np.outer(scale, scale), V=V, log_likelihood=likelihood)


def _first(e: Array, Q: Array) -> Array:
    """Return a start: translation from the translations, orientation shared out evenly."""
    move, turn = float((e[:, :3] ** 2).mean()), float((e[:, 3:] ** 2).mean())
    return np.array([move, 0.5 * turn, 0.5 * turn])[: len(Q)]


def _scored(theta: Array, score: Array, information: Array, free: NDArray[np.bool_], least: Array) -> Array:
    """Return the variances after a scoring step of the free ones, none below the least; the others then go where they
    are best beside those that stopped there."""
    scale = 1.0 / np.sqrt(np.diag(information))
    alike = information * np.outer(scale, scale) + ALIKE * np.eye(len(scale))  # shapes of one kind share the step
    step, open_ = np.zeros_like(theta), free.copy()
    while open_.any():
        rest = scale * score - alike @ np.where(open_, 0.0, step / scale)
        step[open_] = scale[open_] * np.linalg.solve(alike[np.ix_(open_, open_)], rest[open_])
        low = open_ & (theta + step < least)
        if not low.any():
            break
        step[low], open_ = (least - theta)[low], open_ & ~low
    return np.asarray(np.maximum(theta + step, least))


def _step(e: Array, J: Array, known: Array, Q: Array, theta: Array) -> tuple[float, Array, Array, Array, Array]:
    """Return the restricted log-likelihood, what pulls each variance up and pushes it down (K,), half of whose
    difference is the score, the expected information (K, K), and what a unit of each adds to the noise, as a share."""
    V = known + np.einsum("k,knij->nij", theta, Q)
    W = np.linalg.inv(V)
    WJ = W @ J
    H = np.einsum("nia,nib->ab", J, WJ)
    C = np.linalg.inv(H)
    r = e - J @ (C @ np.einsum("nia,ni->a", WJ, e))
    Wr = np.einsum("nij,nj->ni", W, r)
    spent = WJ @ C @ WJ.transpose(0, 2, 1)  # (n, 6, 6): what the unknowns took of the observations' own
    pull, push = np.einsum("ni,knij,nj->k", Wr, Q, Wr), np.einsum("nij,knji->k", W - spent, Q)
    WQ = W @ Q  # (K, n, 6, 6)
    CB = C @ np.einsum("nia,knij,njb->kab", WJ, Q, WJ, optimize=True)
    information = np.einsum("knij,lnji->kl", WQ, WQ - 2.0 * spent @ Q) + np.einsum("kab,lba->kl", CB, CB)
    information = 0.25 * (information + information.T)
    _, logdet = np.linalg.slogdet(V)
    likelihood = -0.5 * (logdet.sum() + np.linalg.slogdet(H)[1] + float(np.einsum("ni,ni->", r, Wr)))
    return float(likelihood), pull, push, information, np.einsum("nij,knji->k", W, Q) / e.size
