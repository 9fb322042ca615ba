"""Errors that drift: the fit to poses of one recording, whose errors are alike for a while."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from armsight.arrays import Array
from armsight.calibrate.correlation import Correlation, fit_averaged, time_blocks
from armsight.calibrate.handeye.known_noise import CONDITION, moved
from armsight.calibrate.handeye.pairs import Arrays, Poses
from armsight.calibrate.handeye.solution import residuals
from armsight.fitting.groups import whitener

STEP = 1e-6
"""Of the numerical derivatives, m and rad."""


def fit_drifting(
    arrays: Arrays,
    keep: NDArray[np.bool_],
    start: Poses,
    t_s: Array,
    noise: Array | None = None,
) -> tuple[Poses, Array, Correlation]:
    """Return the fit to the kept pairs whose errors are white noise and a drift that is forgotten exponentially.

    With its covariance (12, 12) of (dtX, dwX, dtZ, dwZ), turns from the left, and how the errors hang together.

    arrays: of PosePairs.arrays, start: RX, tX, RZ, tZ near the answer, t_s (n,): times of the pairs. In the camera's
    axes all components drift alike, positions and turns each by their own size, or each pair by its noise (n, 6, 6).
    """
    used: Arrays = tuple(a[keep] for a in arrays)  # type: ignore[assignment]  # four stay four
    r, J = _linear(used, start)  # (n, 6), (n, 6, 12)
    if noise is None:
        size = np.repeat(np.sqrt([np.mean(r[:, :3] ** 2), np.mean(r[:, 3:] ** 2)]), 3)
        size = np.maximum(size, 1e-12)
        r, J = r / size, J / size[:, None]
    else:
        W = whitener(noise[keep], CONDITION)
        r, J = np.einsum("nij,nj->ni", W, r), W @ J
    found = fit_averaged(r, J, t_s[keep])
    return _moved(start, found.step), found.C, found.correlation


def _linear(arrays: Arrays, start: Poses) -> tuple[Array, Array]:
    """Return the residuals (n, 6) in camera axes, and their derivative (n, 6, 12) by steps of `_moved`."""
    r = residuals(arrays, *start)
    J = np.empty((len(r), 6, 12))
    for a in range(12):
        step = np.zeros(12)
        step[a] = STEP
        J[:, :, a] = (residuals(arrays, *_moved(start, step)) - residuals(arrays, *_moved(start, -step))) / (2.0 * STEP)
    return r, J


def _moved(start: Poses, step: Array) -> Poses:
    """Return RX, tX, RZ, tZ after a step (12,) of (dtX, dwX, dtZ, dwZ)."""
    (RX, tX), (RZ, tZ), _ = moved(start[:2], start[2:], 1.0, step)
    return RX, tX, RZ, tZ


def left_out_blocks(
    arrays: Arrays,
    keep: NDArray[np.bool_],
    start: Poses,
    t_s: Array,
    correlation: Correlation,
    noise: Array | None = None,
) -> Array:
    """Return the error (n, 6) of each pair against the fit to the pairs further away in time than a drift lasts.

    The recording is parted into blocks of equal time; each is left out with what lies within a correlation time.
    """
    out = residuals(arrays, *start)
    for inside, away in time_blocks(t_s, correlation):
        others = keep & away
        if others.sum() < 4:
            continue
        at, _, _ = fit_drifting(arrays, others, start, t_s, noise)
        there: Arrays = tuple(a[inside] for a in arrays)  # type: ignore[assignment]  # four stay four
        out[inside] = residuals(there, *at)
    return out
