"""What a model has wrong differs from region to region of a motion and does not average out over rows.

The scatter of the residuals says nothing of it; fits without each region do (delete-a-group jackknife, Kott 2001).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from armsight.fitting.quantiles import chi2_sf, t_ppf

Array = NDArray[np.float64]

HALVINGS = 3
"""Eight regions: each takes an eighth away from what determines an answer."""
FEWEST_ROWS = 24
"""Three a region: fewer leave answers without one region that hang on single rows."""
RARE = 0.01
"""Probability by chance of the scatter of answers without a region, from which on it is what is believed: of a Panda's
nominal arm 0.005, 2e-9 and 1e-12; of independent rows one recording in ten is believed less than it could be."""
NORMAL_95 = 1.959964


def regions(values: Array) -> NDArray[np.intp]:
    """Return (m,) which part of their space each row of values (m, n) is in, of 2^HALVINGS about equal ones.

    Halved again and again across the value that spreads most, so that a part is near in all of them.
    """
    out = np.zeros(len(values), dtype=np.intp)
    size = np.maximum(np.ptp(values, axis=0), 1e-300)
    for _ in range(HALVINGS):
        for part in range(out.max() + 1):
            rows = np.flatnonzero(out == part)
            if len(rows) < 2:
                continue
            own = values[rows, int(np.argmax((values[rows] / size).std(axis=0)))]
            out[rows[own > np.median(own)]] += len(values)  # the upper half, numbered anew below
        out = np.unique(out, return_inverse=True)[1].astype(np.intp)
    return out


def widened(covariance: Array, slopes: Array, noise: Array, errors: Array, part: NDArray[np.intp]) -> Array:
    """Return the covariance (K, K) of an answer, as wide as answers without each region scatter.

    slopes (m, r, K), noise (m, r, r), errors (m, r) of the rows at the answer; part (m,): their regions. As it is where
    there are too few rows, or the scatter is what rows with independent errors give.
    """
    g, size = int(part.max()) + 1, len(covariance)
    if len(errors) < FEWEST_ROWS:
        return covariance
    pull = np.einsum("mrk,mrs->mks", slopes, np.linalg.inv(noise))
    H = np.linalg.inv(covariance)
    without = np.empty((g, size))
    for k in range(g):
        own, at = part == k, np.einsum("mks,ms->k", pull[part == k], errors[part == k])
        without[k] = np.linalg.solve(H - np.einsum("mks,msl->kl", pull[own], slopes[own]), at)
    root = np.linalg.cholesky(covariance)
    off = np.linalg.solve(root, (without - without.mean(axis=0)).T)
    W = (g - 1.0) / g * (off @ off.T)  # one where rows are independent
    if chi2_sf((g - 1.0) * float(np.trace(W)), size * (g - 1)) > RARE:
        return covariance
    share, axes = np.linalg.eigh(W)
    wide = np.maximum(share * (float(t_ppf(0.975, g - 1)) / NORMAL_95) ** 2, 1.0)
    axes = root @ axes
    return np.asarray((axes * wide) @ axes.T)
