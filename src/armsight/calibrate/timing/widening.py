"""By how much what hangs together in a fit's residuals, or pulls at its rig, widens what it claims of the clocks."""

from __future__ import annotations

import numpy as np
import scipy  # loads its special functions where they are used

from armsight.arrays import Array
from armsight.calibrate.timing.fit import PathModel
from armsight.fitting import Fit

BLOCKS, BLOCK_S = 25, 1.0
"""Blocks of a recording at most, and how long one is at least: what a camera gets wrong of a light's middle stays for
a second or two."""
CHANCE = 1e-3
"""Blocks scatter more than single spots tell, and rigs are further off, by chance this often."""
FELT = 0.5
"""Share of its variance by which the lights must tell something of a direction of the rig to be asked about it."""


def widened(model: PathModel, fit: Fit) -> Array:
    """Return by how much (n,) the standard deviations of the fit's n free numbers are wider, by blocks of time.

    Each block's own part in a number is independent of the other blocks' however its residuals hang together (the
    sandwich of Huber 1967, by clusters: Liang, Zeger 1986). 1 where blocks scatter as single spots tell.
    """
    m = 2 * len(model.views)
    if fit.covariance is None:
        return np.ones(len(fit.shared))
    free = [fit.names.index(name) for name in fit.covariance.names]
    noise = fit.scale**2 if model.together == 1.0 else 1.0
    evaluation = model.evaluate(fit.shared, np.zeros((1, 0)))
    J, r = evaluation.shared[0, :m, free].T, evaluation.residuals[0, :m]
    gain = (J @ fit.covariance.matrix) / noise  # (2 m, n): how each number follows each residual
    t = np.repeat(model.times_s(fit.shared)[0], 2)
    long = max(BLOCK_S, np.ptp(t) / BLOCKS)
    block = np.floor((t - t.min()) / long).astype(np.intp)
    own, told = (np.zeros((block.max() + 1, gain.shape[1])) for _ in range(2))
    np.add.at(own, block, gain * r[:, None])
    np.add.at(told, block, gain**2 * noise)
    # under independent spots a block's square has the variance told; chi2 of as many blocks as count
    total = np.maximum(told.sum(axis=0), 1e-300)
    count = total**2 / np.maximum((told**2).sum(axis=0), 1e-300)  # of blocks that count as much as the best
    ratio = (own**2).sum(axis=0) / total
    clear = ratio * count > scipy.special.chdtri(count, CHANCE)
    return np.asarray(np.sqrt(np.where(clear, np.maximum(ratio, 1.0), 1.0)))


def rig_pull(model: PathModel, fit: Fit, wider: Array) -> tuple[float, Array]:
    """Return how far the rig is off over its doubt, 1 where chance explains it, and the pull (V,) of each camera's
    numbers in their deviations. wider: of the fit."""
    k, doubt = model.views.doubt.size, model.views.doubt
    if not k or fit.covariance is None:
        return 1.0, np.zeros(len(model.mid_s))
    z, ratio = fit.shared[-k:], float(np.mean(wider[-k:] ** 2))
    # what is found of z has the variance by which it is better known than before, and more where spots hang together
    told, axes = np.linalg.eigh(np.eye(k) - fit.covariance.matrix[-k:, -k:])
    felt = told > FELT
    told, axes = told[felt], axes[:, felt]
    chi2 = float(((axes.T @ z) ** 2 / (told * (told + ratio * (1.0 - told)))).sum())
    off = float(np.sqrt(chi2 / len(told))) if len(told) and chi2 > scipy.special.chdtri(len(told), CHANCE) else 1.0
    return off, np.asarray(np.abs(doubt.root @ z).max(axis=1))
