"""Stamps that transport only delays: the clock is the lower edge of their scatter, not its middle."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.special import log_ndtr

Array = NDArray[np.float64]

LEAST_SIGMA_S = 2e-5
"""Nothing is stamped more evenly than this by a computer."""
MIN_GAIN = 3.0
"""By how much the logarithm of the likelihood must be better than without lateness: by chance once in a hundred."""
JITTERS = np.array([0.95, 0.9, 0.85, 0.8, 0.75, 0.7, 0.6, 0.5, 0.35, 0.2, 0.1, 0.05, 0.02])
"""Of the stamps without lateness, over their whole scatter: what the likelihood says of each is averaged, because a few
stamps at the edge make it rugged."""
BOUNDS = ((-10.0, 10.0), (-10.0, 10.0), (-5.0, 2.0))
"""Of offset, slope and the logarithm of lateness, over the stamps' scatter."""
STEP = 1e-3
"""For second derivatives, in units in which the unknowns are about one."""
STRAYS = 0.05
MAD = 1.4826
EDGE = 1.5
"""The edge of n stamps that are late by tau is known to this many tau / n at best."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LateStamps:
    """A clock under late stamps: offset_s and slope over x, their covariance (2, 2), and the scatter.

    sigma_s: of the stamps without lateness; late_s: mean lateness, which falls off exponentially.
    """

    offset_s: float
    slope_s: float
    covariance: Array
    sigma_s: float
    late_s: float


def fit_lateness(x: Array, r: Array) -> LateStamps | None:
    """Return the line under residuals r (n,) over x (n,), |x| <= 1, where they are plainly late; None where not.

    The likelihood is that of normal jitter plus an exponential lateness (the exponentially modified normal
    distribution, Grushka 1972).
    """
    scale = float(np.std(r))
    if not scale > LEAST_SIGMA_S:
        return None
    z = r / scale
    sigmas = np.unique(np.maximum(JITTERS, LEAST_SIGMA_S / scale))[::-1]
    fits, start = [], np.array([-0.7, 0.0, -0.4])
    for sigma in sigmas.tolist():
        fits.append(_fit(x, z, sigma, start))
        start = fits[-1][1]
    costs = np.array([cost for cost, _, _ in fits])
    if not costs.min() < _even_cost(z):
        return None
    weight = np.exp(costs.min() - costs)
    weight /= weight.sum()
    at = np.array([p for _, p, _ in fits])
    mean = weight @ at
    off = at - mean
    C = np.einsum("k,kij->ij", weight, np.array([C for _, _, C in fits])) + np.einsum("k,ki,kj->ij", weight, off, off)
    late = float(weight @ np.exp(at[:, 2]))
    edge = EDGE * late / len(z)
    return LateStamps(
        offset_s=float(mean[0]) * scale,
        slope_s=float(mean[1]) * scale,
        covariance=(C[:2, :2] + np.diag([edge**2, 3.0 * edge**2])) * scale**2,
        sigma_s=float(weight @ sigmas) * scale,
        late_s=late * scale,
    )


def _even_cost(z: Array) -> float:
    """Return the cost of even jitter, some of the stamps touched: normal, and STRAYS of them anywhere."""
    sigma = max(MAD * float(np.median(np.abs(z - np.median(z)))), 1e-3)
    strays = STRAYS / max(float(np.ptp(z)), 1e-9)
    touched = -np.log((1.0 - STRAYS) * np.exp(-0.5 * (z / sigma) ** 2) / (sigma * np.sqrt(2.0 * np.pi)) + strays)
    normal = 0.5 * len(z) * (1.0 + np.log(2.0 * np.pi))  # the standard deviation of z is one
    return float(min(touched.sum(), normal - MIN_GAIN))


def _fit(x: Array, z: Array, sigma: float, start: Array) -> tuple[float, Array, Array]:
    """Return the least cost, offset, slope and log lateness (3,), and their covariance (3, 3), for one jitter."""

    def cost(p: Array) -> float:
        tau = np.exp(p[2])
        u = z - p[0] - p[1] * x
        log = sigma**2 / (2.0 * tau**2) - u / tau + log_ndtr(u / sigma - sigma / tau) - np.log(tau)
        return float(-log.sum())

    found = minimize(cost, start, method="L-BFGS-B", bounds=BOUNDS)
    values, axes = np.linalg.eigh(_hessian(cost, found.x))
    C = (axes / np.maximum(values, 1.0)) @ axes.T
    return float(found.fun), np.asarray(found.x, np.float64), C


def _hessian(cost: Callable[[Array], float], at: Array) -> Array:
    n = len(at)
    H = np.empty((n, n))
    steps = STEP * np.eye(n)
    for i in range(n):
        for j in range(i + 1):
            H[i, j] = H[j, i] = (
                cost(at + steps[i] + steps[j])
                - cost(at + steps[i] - steps[j])
                - cost(at - steps[i] + steps[j])
                + cost(at - steps[i] - steps[j])
            ) / (4.0 * STEP**2)
    return H
