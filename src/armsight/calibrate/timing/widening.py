"""How far a fit of clocks is to be believed: views left out of it, blocks of its residuals, pulls at its rig."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import scipy  # loads its special functions where they are used
from numpy.typing import NDArray

from armsight.arrays import Array
from armsight.calibrate.timing.fit import PathModel, build, solve_model, times
from armsight.calibrate.timing.views import Views
from armsight.fitting import Fit, Prior

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


LEFT_OUT_S = 1.0
"""Of a camera's views that are left out together: longer than a path can be guessed."""
NEAR_S = 0.15
"""Another camera that saw a light within it ties the two clocks: a path goes on for some frames."""


def onlookers(views: Views, t_s: Array, n_cameras: int, near_s: float = NEAR_S) -> NDArray[np.intp]:
    """Return how many other cameras (m,) saw the light of each view within this time of it."""
    count = np.zeros(len(views), np.intp)
    for light in range(len(views.names)):
        mine = np.flatnonzero(views.light == light)
        for s in range(n_cameras):
            there = np.sort(t_s[mine[views.side[mine] == s]])
            at = mine[views.side[mine] != s]
            if not len(there):
                continue
            after = np.searchsorted(there, t_s[at])
            gaps = [np.abs(there[np.clip(after + k, 0, len(there) - 1)] - t_s[at]) for k in (-1, 0)]
            count[at] += np.minimum(*gaps) < near_s
    return count


def left_out_rms(model: PathModel, fit: Fit, priors: dict[str, Prior]) -> Array:
    """Return the RMS (V,) of the whitened residuals of blocks that were left out of the fit by turns.

    In each block one camera is left out, so that all times are fitted by the others; NaN where no two of them looked
    on.
    """
    v, x, V = model.views, fit.shared, len(model.mid_s)
    t, _ = model.times_s(x)
    seen = onlookers(v, t, V, model.grid.spacing_s) >= 2  # further from a view a path is guessed
    turn = (np.floor(t / LEFT_OUT_S).astype(np.intp) + v.side) % V
    squares, n = np.zeros(V), np.zeros(V)
    for k in range(V):
        rest = turn != k
        others = build(v.take(rest), model.grid.spacing_s, model.mid_s, x, model.depth[rest])
        others = replace(others, together=model.together)
        found = solve_model(others, x, priors).shared
        judged = np.flatnonzero(~rest & seen)
        judged = judged[[others.grid.inside(t[i : i + 1]) for i in judged]]
        at = np.zeros(len(v), bool)
        at[judged] = True
        part = PathModel(views=v.take(at), grid=others.grid, mid_s=model.mid_s, depth=model.depth[at], c=others.c)
        rows = part.seen(part.times_s(found)[0], found)
        r = times(rows, others.fit_paths(found).c[:, None])[:, 0] - rows.right
        np.add.at(squares, np.repeat(part.views.side, 2), r**2)
        np.add.at(n, np.repeat(part.views.side, 2), 1.0)
    return np.asarray(np.sqrt(np.where(n > 0.0, squares / np.maximum(n, 1.0), np.nan)))
