"""Smooth curves through a few settings of a zoom lens, and how far off they may be between them.

A curve is a straight line plus a Gaussian process with a squared-exponential covariance: what moves in a zoom lens
moves on cams without kinks. How quickly it bends and by how much is not known, so curves of all bend lengths and
amplitudes are averaged by how well they explain the settings (Rasmussen, Williams 2006, chapters 2.7 and 5.2).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy  # loads its special functions where they are used

from armsight.arrays import Array
from armsight.fitting.quantiles import NORMAL_95

BEND_LENGTHS = np.geomspace(0.45, 4.0, 12)
"""Lengths over which a curve may bend, in ranges of the settings. Cams bend over about half their stroke or more; of
150 simulated lenses of five settings (not those of the benchmark) 96.5 % lie within 95 % intervals with 0.35, 94.3 %
with 0.5, 90.3 % with 0.7. Beyond four strokes a curve is a parabola."""

AMPLITUDES = np.geomspace(0.02, 30.0, 40)
"""Departures from the straight line that are considered, in those that the settings show (or their noise)."""

NUGGET = 1e-11
"""Relative variance that keeps long bend lengths solvable; its square root is far below any calibration's noise."""


BISECTIONS = 24
"""Of a half-width: to 1e-7 of the widest that is possible."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Curves:
    """Curves of p parameters at m places: weights (m, n) of the n settings' values; variance (p, m) between them.

    The weights are those of all p parameters. variance: of the interpolation alone, zero at the settings; what the
    settings' own variances bring is weights^2 times these.
    """

    weights: Array
    variance: Array


def curves(x: Array, y: Array, variance: Array, at: Array) -> Curves:
    """Return the curves through y (p, n), known to variance (p, n), of settings x (n,), at the places at (m,).

    The p parameters bend over one common length; each has an amplitude of its own. x lies in 0 ... 1, n is at least 3:
    two settings tell nothing about what is between them.
    """
    p, n = y.shape
    line = np.column_stack([np.ones(n), x])  # (n, 2)
    Q = np.linalg.svd(line)[0][:, 2:]  # (n, n - 2): what is left of the settings beside a line
    noise = np.sqrt(np.einsum("ik,pi->p", Q**2, variance) / (n - 2))
    spread = np.sqrt(((y @ Q) ** 2).sum(axis=1) / (n - 2))
    scale = np.maximum(noise, spread)
    moving = scale > 1e-14 * np.maximum(1.0, np.abs(y).max(axis=1))  # the others are equal, or on a line
    unit = np.where(moving, scale, 1.0)
    log_evidence = np.zeros((len(BEND_LENGTHS), p, len(AMPLITUDES)))
    W = np.empty((len(BEND_LENGTHS), len(at), n))
    kriging = np.empty((len(BEND_LENGTHS), len(at)))
    for i, length in enumerate(BEND_LENGTHS):
        K = _covariance(x[:, None] - x, length)
        size = np.trace(Q.T @ K @ Q) / (n - 2)
        W[i], kriging[i] = _kriging(K / size, line, _covariance(at[:, None] - x, length) / size, at, 1.0 / size)
        own = np.einsum("ik,pi,il->pkl", Q, variance / unit[:, None] ** 2, Q)
        log_evidence[i] = _log_evidence(Q.T @ K @ Q / size, own, (y / unit[:, None]) @ Q)
    log_evidence += np.log(AMPLITUDES / (AMPLITUDES + (noise / unit)[:, None]))  # flat below the noise, 1/a above it
    log_evidence[:, ~moving] = 0.0
    return _averaged(W, kriging, log_evidence, y, np.where(moving, unit, 0.0))


def _covariance(distance: Array, length: float) -> Array:
    return np.asarray(np.exp(-0.5 * (distance / length) ** 2))


def _kriging(K: Array, line: Array, k_at: Array, at: Array, top: float) -> tuple[Array, Array]:
    """Return the weights (m, n) and variances (m,) of universal kriging through the settings, for amplitude 1."""
    n = len(K)
    A = np.block([[K + NUGGET * top * np.eye(n), line], [line.T, np.zeros((2, 2))]])
    right = np.column_stack([k_at, np.ones(len(at)), at])  # (m, n + 2)
    solved = np.linalg.solve(A, right.T).T
    return solved[:, :n], np.maximum(top - (solved * right).sum(axis=1), 0.0)


def _log_evidence(K: Array, own: Array, z: Array) -> Array:
    """Return the log likelihood (p, a) of what is left beside a line z (p, n - 2), own (p, n - 2, n - 2) its noise."""
    S = AMPLITUDES[:, None, None] ** 2 * K + own[:, None]  # (p, a, n - 2, n - 2)
    S = S + 1e-12 * np.trace(S, axis1=-2, axis2=-1)[..., None, None] * np.eye(len(K))
    L = np.linalg.cholesky(S)
    whitened = np.linalg.solve(L, np.broadcast_to(z[:, None, :, None], (*S.shape[:3], 1)))[..., 0]
    logs = np.log(np.diagonal(L, axis1=-2, axis2=-1)).sum(axis=-1)
    return np.asarray(-0.5 * (whitened**2).sum(axis=-1) - logs)


def _averaged(W: Array, kriging: Array, log_evidence: Array, y: Array, unit: Array) -> Curves:
    """Return the mean curve over bend lengths and amplitudes, and how far the truth may be from it.

    The distribution of what is between settings has long tails where few settings tell the amplitude. variance is that
    of the Gaussian with the same 95 % interval, as everything downstream takes it for one.
    """
    peak = log_evidence.max(axis=2)  # (l, p)
    of_amplitude = np.exp(log_evidence - peak[..., None])
    log_length = (np.log(of_amplitude.sum(axis=2)) + peak).sum(axis=1)  # (l,)
    share = np.exp(log_length - log_length.max())
    share /= share.sum()
    of_amplitude *= share[:, None, None] / of_amplitude.sum(axis=2, keepdims=True)  # (l, p, a), sums to 1 over l and a
    weights = np.einsum("l,lmn->mn", share, W)
    shift = np.einsum("lmn,pn->lpm", W - weights, y)[:, :, None]  # (l, p, 1, m)
    scale = unit[:, None, None] * AMPLITUDES[:, None] * np.sqrt(kriging)[:, None, None]  # (l, p, a, m)
    half = _half_width(of_amplitude[..., None], shift, scale)
    return Curves(weights=weights, variance=(half / NORMAL_95) ** 2)


def _half_width(share: Array, shift: Array, scale: Array) -> Array:
    """Return the half-width (p, m) about 0 that holds 95 % of Gaussians (l, p, a, m), by bisection."""
    low = np.zeros((scale.shape[1], scale.shape[3]))
    high = np.abs(shift).max(axis=(0, 2)) + 4.0 * scale.max(axis=(0, 2))
    safe = np.maximum(scale, 1e-300)
    for _ in range(BISECTIONS):
        half = 0.5 * (low + high)
        z = half[:, None]  # (p, 1, m)
        within = scipy.special.ndtr((z - shift) / safe) - scipy.special.ndtr((-z - shift) / safe)
        inside = (share * within).sum(axis=(0, 2))
        low, high = np.where(inside < 0.95, half, low), np.where(inside < 0.95, high, half)
    return np.asarray(high)
