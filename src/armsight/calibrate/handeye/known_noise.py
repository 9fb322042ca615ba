"""Pose pairs whose camera poses bring covariances of their own: weighed by these, and by what they leave unexplained.

The noise of a pair is V_i = a T + b W + c L_i + s S_i: S_i the covariance that came with the camera's pose, T and W
unit noise of its position and orientation, L_i that of the robot's orientation as seen at the target. The common
additions a, b, c and the factor s are found from the residuals: covariances that are too small altogether grow, where
those of a few pairs are too small the additions keep these from taking over, and covariances that explain nothing fade
behind the additions.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from armsight.arrays import Array, Mask
from armsight.calibrate.handeye.kernels import fit as kernels
from armsight.calibrate.handeye.pairs import Arrays
from armsight.fitting.groups import leave_one_out, whitener
from armsight.geometry.poses import skew
from armsight.records.checks import for_kernels

Pose = tuple[Array, Array]
Fitted = tuple[Pose, Pose, float, Array, Array, tuple[Array, Array, Array], float, int]
"""X, Z, gamma, variances (k,), C (m, m), whitened (e (n, 6), J (n, 6, m), lever (n,)), restricted log-likelihood, and
iterations: what a fit returns, compiled or not."""

BELIEVED = 0.8
"""How far the logarithm of the factor on the covariances is off, as known beforehand: their standard deviations are
right within a factor of 1.5. What the residuals show beyond is put to the additions first. Without this belief the
corners of the real recording in benchmarks/handeye.py grow 15 times and its positions left out get worse by a tenth;
covariances that are all 9 times too small or too large are found out none the less."""
CONDITION = 1e-12
"""Noise below this share of a pair's own in some direction is added to it, so that every pair can be whitened."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Linear:
    """Residuals e (n, 6) in camera axes, derivatives J (n, 6, 13), and L (n, 6, 6): unit noise of the robot's
    orientation as it is seen at the target; lever (n,) in m."""

    e: Array
    J: Array
    L: Array
    lever: Array


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Weighing:
    """By what the pairs of a fit were weighed.

    known (n, 6, 6): covariances of the camera's poses, as given. V (n, 6, 6): the noise of each pair, in camera axes.
    Q (4, n, 6, 6): its derivatives by the variances a, b, c and s, whitened, zero for pairs not used.
    """

    known: Array
    V: Array
    Q: Array


def linearise(arrays: Arrays, X: Pose, Z: Pose, gamma: float, *, to_hand: bool) -> Linear:
    """Return the residuals and their derivatives by dtX, dwX, dtZ, dwZ, gamma."""
    n = len(arrays[0])
    e, J, reach = np.empty((n, 6)), np.empty((n, 6, 13)), np.empty((n, 3))
    (RX, tX), (RZ, tZ) = (tuple(map(for_kernels, pose)) for pose in (X, Z))
    kernels.linearise(((RX, tX), (RZ, tZ), gamma), arrays, to_hand, e, J, reach)
    at = np.concatenate([-skew(reach), np.tile(np.eye(3), (n, 1, 1))], axis=1)  # (n, 6, 3): dw at the flange
    return Linear(e=e, J=J, L=at @ at.transpose(0, 2, 1), lever=np.linalg.norm(reach, axis=1))


def fit_weighed(
    arrays: Arrays,
    known: Array,
    keep: NDArray[np.bool_],
    start: tuple[Pose, Pose, float],
    least: tuple[Array, float],
    *,
    to_hand: bool,
    n_free: int,
    settled: tuple[float, int],
) -> tuple[Fitted, Weighing] | None:
    """Return the maximum-likelihood fit with the four variances by restricted likelihood, and by what the pairs were
    weighed; None without a minimum.

    known (n, 6, 6): covariances of the camera's poses. start: X, Z, gamma near the answer. least: the smallest a, b and
    c (3,), and the share of the residuals that stays with the covariances. n_free: 12, or 13 with gamma. settled: step
    in standard deviations, and the most rounds.
    """
    X, Z, gamma = start
    theta = floor = None
    for iteration in range(settled[1]):
        at = linearise(arrays, X, Z, gamma, to_hand=to_hand)
        Q = _shapes(at, known)
        if theta is None or floor is None:
            theta, floor = _first(at, known, keep, least)
        J = at.J[:, :, :n_free]
        try:
            found = restricted_variances(at.e, J, np.zeros_like(known), Q, keep, floor, theta, BELIEVED)
            W = whitener(found.V, CONDITION)
            e, J = np.einsum("nij,nj->ni", W, at.e), W @ J
            e[~keep], J[~keep] = 0.0, 0.0
            C = np.linalg.inv(np.einsum("nia,nib->ab", J, J))
        except np.linalg.LinAlgError:
            return None
        step = -C @ np.einsum("nia,ni->a", J, e)
        if not np.isfinite(step).all():
            return None
        size, theta = float((np.abs(step) / np.sqrt(np.diag(C))).max()), found.variances
        X, Z, gamma = moved(X, Z, gamma, step)
        if size < settled[0]:
            Q = W @ Q @ W.transpose(0, 2, 1)
            Q[:, ~keep] = 0.0
            whitened = e + J @ step, J, at.lever
            fitted = X, Z, gamma, theta, C, whitened, found.log_likelihood, iteration + 1
            return fitted, Weighing(known=known, V=found.V, Q=Q)
    return None


def left_out(
    arrays: Arrays, X: Pose, Z: Pose, gamma: float, V: Array, keep: Mask, C: Array, *, to_hand: bool
) -> tuple[Array, Array]:
    """Return the error (n, 6) of each pair as predicted from the other kept ones, and its squared length (n,) against
    its own noise V (n, 6, 6) and that of the unknowns, C (m, m). NaN where a pair alone fixes some unknown."""
    at = linearise(arrays, X, Z, gamma, to_hand=to_hand)
    W = whitener(V, CONDITION)
    steps, q = leave_one_out(np.einsum("nij,nj->ni", W, at.e), W @ at.J[:, :, : len(C)], C, keep)
    return residuals_after(arrays, X, Z, gamma, steps), q


def residuals_after(arrays: Arrays, X: Pose, Z: Pose, gamma: float, steps: Array) -> Array:
    """Return the residual (n, 6) of each pair, in camera axes, after a step (n, 12) or (n, 13) of its own."""
    out = np.empty((len(steps), 6))
    kernels.residuals_after((X, Z, gamma), arrays, steps, out)
    return out


def moved(X: Pose, Z: Pose, gamma: float, step: Array) -> tuple[Pose, Pose, float]:
    """Return X, Z and gamma after a step (12,) or (13,)."""
    turns = Rotation.from_rotvec(step[:12].reshape(4, 3)[1::2]).as_matrix()
    further = gamma + float(step[12]) if len(step) > 12 else gamma
    return (turns[0] @ X[0], X[1] + step[:3]), (turns[1] @ Z[0], Z[1] + step[6:9]), further


def _shapes(at: Linear, known: Array) -> Array:
    n = len(at.e)
    Q = np.zeros((4, n, 6, 6))
    Q[0, :, :3, :3] = Q[1, :, 3:, 3:] = np.eye(3)
    Q[2], Q[3] = at.L, known
    return Q


def _first(at: Linear, known: Array, keep: NDArray[np.bool_], least: tuple[Array, float]) -> tuple[Array, Array]:
    """Return where the variances (4,) start, and the least they may become.

    Of the middle pair's position a share stays noise of position: the covariances', or what is added where they are
    smaller.
    """
    squares = (at.e[keep] ** 2).reshape(-1, 2, 3).mean(axis=2)  # of position and turn
    claimed = np.diagonal(known[keep, :3, :3], axis1=1, axis2=2).mean(axis=1)
    move, turn = np.median(squares, axis=0).tolist()
    floor = np.append(least[0], least[1] * min(float(np.median(squares[:, 0] / claimed)), 1.0))
    floor[0] = max(floor[0], least[1] * move - float(np.median(claimed)))
    return np.maximum(np.array([0.3 * move, 0.3 * turn, 0.1 * turn, 1.0]), floor), floor


# Variances of noise beside a known one, by restricted maximum likelihood: for any shapes, a few poses at a time.


VARIANCE_ROUNDS = 60
VARIANCE_SETTLED = 1e-3
"""Share of the noise by which no variance may still move."""
ALIKE = 1e-9
"""Added to the information of variances of unit information: covariances of one shape are told from no common noise."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Restricted:
    """Variances by restricted maximum likelihood, and what they make.

    variances (K,), covariance (K, K). V (n, 6, 6): the noise of each observation. log_likelihood: restricted.
    """

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
    theta = _first_variances(e[used], Q[:, used]) if start is None else start
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


def _first_variances(e: Array, Q: Array) -> Array:
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
