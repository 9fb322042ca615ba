"""A camera's stamps against the steady clock that takes its frames: period, lost frames, jitter, lateness."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy  # loads its optimize and special where they are used
from numpy.typing import NDArray

from armsight.arrays import Array
from armsight.errors import Inconsistent, NotEnoughData
from armsight.records import frozen_array

FEWEST_FRAMES = 30
MAD = 1.4826
"""Standard deviation over median absolute deviation of a normal distribution."""
TUKEY = 4.685
"""Where Tukey's weight ends, in standard deviations: 95 % efficient for normal noise."""
EFFICIENCY = 0.95
ROUNDS_OF_WEIGHTS = 20
MAX_STAMP_S = 1e7
"""Stamps that count from 1970 would give a delay of hours, known to hours, that no double can hold to a millisecond."""
ROUNDS_OF_NUMBERS = 10
MAX_JITTER = 0.25
"""Of a period: stamps that scatter more do not tell which frame is which."""
SLOWEST_S = 2.0
"""Frames further apart follow no light that moves: a camera's stamps in ms step by 2 and more at up to 500 Hz."""
SMALLER = {"ms": 1e3, "us": 1e6, "ns": 1e9}
"""Units of stamps, by how many make a second."""
FOLLOW, FOLLOW_PERIOD = 0.1, 0.002
"""Shares of a stamp's offset by which the clock and its period follow while frames are counted."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SteadyStamps:
    """The stamps (n,) in s freed of jitter, and the clock they follow.

    number (n,): of each frame, from 0, lost ones counted. covariance (2, 2): of the clock's offset (s) at mid_s and its
    rate (ppm). late_s: how late a stamp is in the mean, where transport only delays; the clock is then the lower edge.
    """

    t_s: Array
    number: NDArray[np.int64]
    period_s: float
    jitter_s: float
    jitter_std_s: float
    mid_s: float
    covariance: Array
    late_s: float = 0.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "t_s", frozen_array("t_s", self.t_s, (None,)))
        object.__setattr__(self, "covariance", frozen_array("covariance", self.covariance, (2, 2)))

    @property
    def lost(self) -> int:
        """Frames between the first and the last one that are not there."""
        return int(self.number[-1]) + 1 - len(self.number)

    def clock_covariance(self, at_s: float) -> Array:
        """Return the covariance (2, 2) of the clock's offset (s) at a stamp, and its rate (ppm)."""
        move = self.moved(at_s)
        return np.asarray(move @ self.covariance @ move.T)

    def moved(self, at_s: float) -> Array:
        """Return what makes the clock's offset and rate at mid_s (2,) those at a stamp: (2, 2)."""
        return np.array([[1.0, 1e-6 * (at_s - self.mid_s)], [0.0, 1.0]])


def camera_clock(stamps_s: Array, side: str) -> SteadyStamps:
    """Return the steady clock of a camera's stamps (n,); raises as `steady`, and Inconsistent for ms, us and ns."""
    period = float(np.median(np.diff(stamps_s))) if len(stamps_s) >= FEWEST_FRAMES else 0.0
    unit = next((unit for unit, many in SMALLER.items() if period < SLOWEST_S * many), "ns")
    if period > SLOWEST_S:
        raise Inconsistent(
            f"the stamps of the {side} camera step by {period:.4g}: as seconds no light that moves is followed, as "
            f"{unit} they are {SMALLER[unit] / period:.3g} frames a second",
            consequence="Taken as seconds they would tie no clock to another",
            cure=f"Give its stamps in seconds, divided by {SMALLER[unit]:.0f}",
        )
    return steady(stamps_s, side)


def steady(stamps_s: Array, side: str, *, complete: bool = False) -> SteadyStamps:
    """Return the steady clock behind the stamps (n,) of a camera, by a robust line of stamp over frame number.

    complete: no frame is lost, so that the k-th stamp is that of the k-th frame however late it comes. Raises
    NotEnoughData for fewer than FEWEST_FRAMES, Inconsistent for stamps beyond MAX_STAMP_S, and where no steady clock
    explains the stamps.
    """
    s = np.asarray(stamps_s, float)
    if len(s) < FEWEST_FRAMES:
        raise NotEnoughData(
            f"the {side} camera has {len(s)} frames",
            consequence="Its clock cannot be told from the jitter of its stamps",
            cure="Record 10 to 20 s",
        )
    if np.abs(s).max() > MAX_STAMP_S:
        raise Inconsistent(
            f"the stamps of the {side} camera count from {np.abs(s).max() / 86400.0:.0f} days ago",
            consequence="The delay at stamp 0 and the drift since then cannot be told apart; no timing is given",
            cure="Take the same number off all stamps of both cameras, here and when measuring, to begin near 0",
        )
    number = np.arange(len(s)) if complete else _numbers(s)
    # in turns: a line tells which number each stamp is nearest to, the numbers give a better line
    for _ in range(ROUNDS_OF_NUMBERS):
        offset, period, weight, jitter = _line(number, s)
        again = number if complete or not period > 0.0 else _growing((s - offset) / period)
        if np.array_equal(again, number):
            break
        number = again
    if not (period > 0.0 and jitter < MAX_JITTER * period):
        raise Inconsistent(
            f"the stamps of the {side} camera follow no steady rate: they scatter by {1e3 * jitter:.2g} ms about "
            f"frames {1e3 * period:.3g} ms apart",
            consequence="Lost frames cannot be told from late ones; no timing is given",
            cure="Hold the frame rate fixed (no automatic exposure that changes it), and use the camera's own stamps",
        )
    return _steady(s, number, weight, period, offset, jitter)


def _numbers(s: Array) -> NDArray[np.int64]:
    """Return frame numbers from the spacing of the stamps, by a clock that follows them slowly."""
    step = np.diff(s)
    period = float(np.median(step))
    near = step[np.abs(step - period) < 0.5 * period]
    period = float(near.mean())  # jitter cancels
    number = np.zeros(len(s), np.int64)
    expected = float(s[0])
    for k in range(1, len(s)):
        n = max(round((s[k] - expected) / period), 0)
        # a phase-locked loop: one stamp that is late by much moves the clock by a tenth of that
        off = s[k] - expected - n * period
        expected += n * period + FOLLOW * off
        period += FOLLOW_PERIOD * off / max(n, 1)
        number[k] = number[k - 1] + n
    return number


def _growing(x: Array) -> NDArray[np.int64]:
    """Return the growing whole numbers nearest to x (n,), the first one 0."""
    k = np.arange(len(x))
    # numbers grow by one at least: x - k must not fall, and isotonic regression is the nearest that does not
    number = np.rint(scipy.optimize.isotonic_regression(x - k).x).astype(np.int64) + k
    return np.asarray(number - number[0])


def _line(number: NDArray[np.int64], s: Array) -> tuple[float, float, Array, float]:
    """Return offset, slope, weights (n,) and the residuals' robust standard deviation of stamp over number."""
    x = number - number.mean()
    y = s - s.mean()
    w = np.ones_like(y)
    slope = intercept = sigma = 0.0
    for _ in range(ROUNDS_OF_WEIGHTS):
        mean_x, mean_y = np.average(x, weights=w), np.average(y, weights=w)
        slope = float((w * (x - mean_x)) @ (y - mean_y) / max(float((w * (x - mean_x)) @ (x - mean_x)), 1e-300))
        intercept = float(mean_y - slope * mean_x)
        r = y - intercept - slope * x
        sigma = MAD * float(np.median(np.abs(r)))
        if not sigma > 0.0:
            break
        # Tukey's biweight (1 - (r / c)^2)^2: a stamp far off has no pull at all
        w = np.clip(1.0 - (r / (TUKEY * sigma)) ** 2, 1e-12, 1.0) ** 2
    return float(s.mean() + intercept - slope * number.mean()), slope, w, sigma


def _under(number: NDArray[np.int64], period: float, offset: float, half: float, late: LateStamps) -> SteadyStamps:
    """Return the clock at the lower edge of late stamps, about which a robust line (offset, period) had been laid."""
    slope = late.slope_s / half
    fitted = offset + period * number + late.offset_s + slope * (number - number.mean())
    per_ppm = np.diag([1.0, 1e6 / (period * half)])
    jitter = float(np.hypot(late.sigma_s, late.late_s))
    return SteadyStamps(
        t_s=fitted,
        number=number,
        period_s=period + slope,
        jitter_s=jitter,
        jitter_std_s=jitter / np.sqrt(len(number)),
        mid_s=float(fitted.mean()),
        covariance=per_ppm @ late.covariance @ per_ppm,
        late_s=late.late_s,
    )


def _steady(
    s: Array, number: NDArray[np.int64], weight: Array, period: float, offset: float, jitter: float
) -> SteadyStamps:
    fitted = np.asarray(offset + period * number, dtype=np.float64)
    r = s - fitted
    half = 0.5 * float(number[-1] - number[0])
    late = fit_lateness((number - number.mean()) / half, r) if half > 0.0 else None
    if late is not None:
        return _under(number, period, offset, half, late)
    kept = np.abs(r) <= TUKEY * jitter if jitter > 0.0 else np.ones(len(s), bool)
    n = int(kept.sum())
    jitter = float(np.sqrt(r[kept] @ r[kept] / max(n - 2, 1)))
    mid = float(fitted.mean())
    X = np.stack([np.ones(len(s)), 1e-6 * (fitted - mid)], axis=1)
    return SteadyStamps(
        t_s=fitted,
        number=number,
        period_s=period,
        jitter_s=jitter,
        jitter_std_s=jitter / np.sqrt(2.0 * n),
        mid_s=mid,
        covariance=jitter**2 / EFFICIENCY * np.linalg.inv(X.T @ X),
    )


# Stamps that transport only delays: the clock is the lower edge of their scatter, not its middle.

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
        log = sigma**2 / (2.0 * tau**2) - u / tau + scipy.special.log_ndtr(u / sigma - sigma / tau) - np.log(tau)
        return float(-log.sum())

    found = scipy.optimize.minimize(cost, start, method="L-BFGS-B", bounds=BOUNDS)
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
