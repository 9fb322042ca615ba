"""A rig that moved between two rows, or two recordings put together: one placement for the rows before, one after."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from armsight.geometry.lie import skew
from armsight.verify.evidence import Case, Evidence
from armsight.verify.left_out import by_chance, fit_linear
from armsight.verify.model import Noise

Array = NDArray[np.float64]

FEWEST_ROWS = 6
"""Rows on either side of a split that are the least."""
SPLITS = 60
"""Places, evenly spread over the rows, at which a split is tried."""
CHANCE = 1e-6
"""Probability by chance, over all splits, below which a split is one."""
SHARE = 0.25
"""A split counts that leaves less than this share of the squares that joints and geometry leave: half the error."""


def moved_rig(evidence: Evidence, noise: Noise, case: Case, explained: float) -> str:
    """Return where the rows fall into two placements of the measuring frame, in words; "" where they do not.

    noise: what the evidence was whitened with. explained: the squares that the best of joints and geometry
    leaves. A crash between two rows is told the same way where it turned the base or the rig.
    """
    m = len(case.q)
    if m < 2 * FEWEST_ROWS:
        return ""
    places = np.unique(np.linspace(FEWEST_ROWS, m - FEWEST_ROWS, SPLITS).astype(int))
    columns = noise.whiten(_placement(case.measured.xyz_m, evidence.linear.residual.shape[1]))
    plain = evidence.plain()
    tried = {int(k): fit_linear(evidence.linear, columns * (np.arange(m) >= k)[:, None, None]) for k in places}
    at = min(tried, key=lambda k: tried[k].squares)
    best = tried[at]
    if best.squares > SHARE * explained or len(tried) * by_chance(evidence.linear, plain, best) > CHANCE:
        return ""
    row = int(case.measured.rows[at])
    jump = 1e3 * float(np.linalg.norm(best.values[:3]))
    return (
        f"From about row {row} on the rows lie apart from those before, by {jump:.3g} mm: the rig, the base or the "
        "tool was moved in between, or two recordings were put together. Verify the two parts apart."
    )


def _placement(xyz: Array, rows: int) -> Array:
    """Return how residuals (m, rows) follow a small move of the measuring frame about the places' mean (m, rows, 6)."""
    columns = np.zeros((len(xyz), rows, 6))
    columns[:, :3, :3] = np.eye(3)
    columns[:, :3, 3:] = -skew(xyz - xyz.mean(axis=0))
    if rows == 6:
        columns[:, 3:, 3:] = np.eye(3)
    return columns
