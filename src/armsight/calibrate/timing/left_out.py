"""How well views of one camera are foretold by the others, where three or more see the lights."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from armsight.arrays import Array
from armsight.calibrate.timing.fit import PathModel, build, solve_model, times
from armsight.calibrate.timing.views import Views
from armsight.fitting import Fit, Prior

BLOCK_S = 1.0
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
    turn = (np.floor(t / BLOCK_S).astype(np.intp) + v.side) % V
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
