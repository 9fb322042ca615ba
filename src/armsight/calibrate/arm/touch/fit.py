"""The fit of an arm to what it touched; the noises of touches and of joint readings are found from their scatter."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from armsight.arrays import Array
from armsight.calibrate.arm.fit import Tolerance
from armsight.calibrate.arm.touch.model import TouchModel
from armsight.calibrate.arm.touch.touches import Kind, Touches
from armsight.fitting import Fit, Loss, LossKind, Prior, Problem, Settings, solve
from armsight.fitting.quantiles import MEDIAN_3, chi2_ppf

ROUNDS = 4
"""Fits with the noises of the one before; they settle in two or three."""
FIRST_M = 5e-4
"""A touch's standard deviation before any was estimated: a tip in a cone, by hand."""
LEAST_TOUCH_M, MOST_TOUCH_M = 1e-6, 0.3
LEAST_JOINT, MOST_JOINT = 1e-7, 3e-3
"""Of a joint's reading, rad or m: from exact to a twelve-bit step."""
OPEN = 1e-9
"""Share of a parameter's information that keeps the likelihood finite where nothing tells a direction."""
GROSS = 4.0
"""Rows further off than so many times the middle one have no say in the noises."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TouchNoise:
    """Standard deviations: of a touch, by kind, in one coordinate, m; of a joint's reading, rad or m."""

    touch_m: dict[Kind, float]
    joint: float

    def whitener(self, touches: Touches, by_q: Array) -> Array:
        """Return W (m, 3, 3) that makes misses (m, 3) of unit variance; of scalar rows in the first number."""
        L = np.linalg.cholesky(self.covariance(touches, by_q))
        W = np.linalg.inv(L)
        W[touches.scalar, 1:] = 0.0
        return np.asarray(W)

    def covariance(self, touches: Touches, by_q: Array) -> Array:
        """Return that of misses (m, 3, 3); what scalar rows do not say has a variance of one."""
        own = np.array([self.touch_m[kind] for kind in touches.kind]) ** 2 + touches.sigma_m**2
        V = own[:, None, None] * np.eye(3) + self.joint**2 * (by_q @ by_q.mT)
        scalar = touches.scalar
        V[scalar] = np.eye(3) + (V[scalar, :1, :1] - 1.0) * np.diag([1.0, 0.0, 0.0])
        return np.asarray(V)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TouchFit:
    """Parameters p (P,), the engine's fit, the noises, W (m, 3, 3) that whitens the rows, what was freed, and the kinds
    of features."""

    p: Array
    fit: Fit
    noise: TouchNoise
    whiten: Array
    free: tuple[str, ...]
    kinds: tuple[Kind, ...]

    @property
    def scatter_m(self) -> float:
        """The largest standard deviation of a touch, m."""
        return max(self.noise.touch_m[kind] for kind in self.kinds)

    def misses_m(self, model: TouchModel, touches: Touches) -> Array:
        """Return how far off rows (m,) are, m."""
        return np.asarray(np.linalg.norm(model.misses(self.p, touches)[0], axis=1))


def fit_touches(
    model: TouchModel, guess: Array, free: Collection[str], tolerance: Tolerance, noise: TouchNoise | None = None
) -> TouchFit:
    """Return tip, features and what is named in free by maximum likelihood, with priors from the tolerances.

    noise: where it is known; else it is found, by restricted maximum likelihood. Raises NotConverged.
    """
    given, touches = noise, model.touches
    fixed = frozenset(model.names) - set(free) - set(model.mounts)
    priors = {name: Prior(mean=0.0, sigma=tolerance.of(name)) for name in free}
    noise = noise or TouchNoise(touch_m=dict.fromkeys(Kind, FIRST_M), joint=LEAST_JOINT)
    p = guess
    for _ in range(ROUNDS):
        arm_part = p[: model.n_arm]
        lever = model.arm_model.lever_m(arm_part, touches.as_points())
        W = noise.whitener(touches, model.misses(p, touches, lever)[2])
        problem = Problem(
            names=model.names,
            guess=p,
            n_residuals=model.n_residuals,
            fixed=fixed,
            priors=priors,
            # of good rows one in a hundred is beyond the scale
            loss=Loss(kind=LossKind.HUBER, scale=float(np.sqrt(chi2_ppf(0.99, 3))), block=3),
            evaluate=lambda x, _, W=W, held=lever: model.evaluate(x, W, held),  # type: ignore[misc]
        )
        fit = solve(problem, Settings(allow_undetermined=True, max_iterations=200, cost_tolerance=1e-8))
        p = fit.shared
        before, noise = noise, given or estimate_noise(model, p, free, tolerance, noise)
        if all(abs(np.log(noise.touch_m[k] / before.touch_m[k])) < 0.01 for k in set(touches.kind)):
            break
    freed = tuple(name for name in model.names if name not in fixed)
    return TouchFit(p=p, fit=fit, noise=noise, whiten=W, free=freed, kinds=tuple(sorted(set(touches.kind))))


def estimate_noise(
    model: TouchModel, p: Array, free: Collection[str], tolerance: Tolerance, before: TouchNoise
) -> TouchNoise:
    """Return the noises by restricted maximum likelihood (Patterson, Thompson 1971, Biometrika 58, 545), gross rows
    left out; the priors of what is freed count, as what they let the fit take up."""
    touches = model.touches
    e, A, y, by_q, prior, pull = _linear(model, p, free, tolerance)
    rows = _not_gross(e, touches)
    kept = touches.take(rows)
    kinds = sorted(set(kept.kind))
    A, y, by_q = A[rows], y[rows], by_q[rows]
    A[kept.scalar, 1:] = y[kept.scalar, 1:] = 0.0

    def noise_of(log: Array) -> TouchNoise:
        size = np.exp(log)
        touch = {**before.touch_m, **dict(zip(kinds, size.tolist(), strict=False))}
        return TouchNoise(touch_m=touch, joint=float(size[-1]))

    def neg2_log_likelihood(log: Array) -> float:
        V = noise_of(log).covariance(kept, by_q)
        L = np.linalg.cholesky(V)
        W = np.linalg.inv(L)
        r, J = (W @ y[..., None]).ravel(), (W @ A).reshape(y.size, -1)
        information = J.T @ J + prior
        scale = 1.0 / np.sqrt(np.maximum(np.diag(information), 1e-30))
        # directions that nothing tells have no part in it
        C = np.linalg.cholesky(information * np.outer(scale, scale) + OPEN * np.eye(len(scale)))
        g = np.linalg.solve(C, scale * (J.T @ r + pull))
        size = 2.0 * np.log(np.einsum("mii->mi", L)).sum()
        size += 2.0 * (np.log(np.diag(C)) - np.log(scale)).sum()
        return float(size + r @ r - g @ g)

    low = np.log([LEAST_TOUCH_M] * len(kinds) + [LEAST_JOINT])
    high = np.log([MOST_TOUCH_M] * len(kinds) + [MOST_JOINT])
    first = [np.log(_scatter(e[rows], kept, kind)) for kind in kinds]
    starts = [np.array([*first, np.log(joint)]) for joint in (LEAST_JOINT * 3.0, 1e-4)]
    tries = [
        minimize(neg2_log_likelihood, np.clip(x, low, high), bounds=list(zip(low, high, strict=True))) for x in starts
    ]
    return noise_of(min(tries, key=lambda found: float(found.fun)).x)


def _linear(model: TouchModel, p: Array, free: Collection[str], tolerance: Tolerance) -> tuple[Array, ...]:
    """Return misses e (m, 3), their slopes A (m, 3, k) by what is fitted, what they say of changes from the nominal y,
    their slopes by joint values, and information (k, k) and gradient (k,) of priors and known lengths."""
    e, by, by_q = model.misses(p, model.touches)
    index = [i for i, name in enumerate(model.names) if name in free or name in model.mounts]
    weight = np.array([tolerance.of(name) ** -2 if name in free else 0.0 for name in np.array(model.names)[index]])
    A = by[:, :, index]
    y = e - A @ np.where(weight > 0.0, p[index], 0.0)  # what the rows say of changes from the nominal
    off, by_off = model.lengths(p)
    prior, gain = np.diag(weight), by_off[:, index]
    prior = prior + gain.T @ gain
    pull = gain.T @ (off - gain @ np.where(weight > 0.0, p[index], 0.0))
    return e, A, y, by_q, prior, pull


def _scatter(e: Array, touches: Touches, kind: Kind) -> float:
    mine = np.array([k is kind for k in touches.kind])
    scale = np.sqrt(MEDIAN_3) if kind is Kind.POINT else 0.6745
    middle = float(np.median(np.linalg.norm(e[mine], axis=1))) / scale
    return float(np.clip(middle, LEAST_TOUCH_M, MOST_TOUCH_M))


def _not_gross(e: Array, touches: Touches) -> NDArray[np.intp]:
    """Return the rows that are not further off than GROSS times their kind's middle one."""
    limit = np.array([GROSS * _scatter(e, touches, kind) for kind in touches.kind])
    limit *= np.where(touches.scalar, 1.0, np.sqrt(3.0))
    return np.flatnonzero(np.linalg.norm(e, axis=1) <= np.maximum(limit, LEAST_TOUCH_M))
