"""Whether positions in the rig's axes are as far apart as the arm moved between them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtr

from armsight.calibrate.arm.plausibility import MOST_SHARE
from armsight.errors import Inconsistent
from armsight.geometry import align_points

Array = NDArray[np.float64]

SURE = 1e-5
"""Chance below which a wrong scale is believed: one good set in a hundred thousand is accused, as in hand-eye."""
MOST_OFF = 0.01
"""Scales further from one are no print's tolerance (some 0.5 %) and no arm's: lengths of a nominal one are known to
0.2 %, while a wrong square, a wrong baseline or a page fitted to the paper are off by more."""


def motion_scale(base_m: Array, rig_m: Array) -> tuple[float, float]:
    """Return by what positions (m, 3) are larger than the arm's motion (m, 3), and the standard deviation of that.

    Least squares of rig = k R base + t (Umeyama 1991, equation 42), so that noise of the positions does not shrink it;
    the deviation is by the residuals, with the seven unknowns counted.
    """
    b, x = base_m - base_m.mean(axis=0), rig_m - rig_m.mean(axis=0)
    turned = b @ align_points(rig_m, base_m).T_a_b.rotation.as_matrix().T
    spread = float((b**2).sum())
    k = float((x * turned).sum()) / spread
    variance = float(((x - k * turned) ** 2).sum()) / (3 * len(x) - 7)
    return k, float(np.sqrt(variance / spread))


def check_motion_scale(base_m: Array, rig_m: Array) -> None:
    """Raise Inconsistent where positions (m, 3), four or more, are of another scale than the arm's motion."""
    k, std = motion_scale(base_m, rig_m)
    off, freedom = abs(k - 1.0), 3 * len(rig_m) - 7
    if std * np.sqrt(freedom) > MOST_SHARE:  # no scale makes them the arm's
        return
    if off <= MOST_OFF or 2.0 * float(stdtr(freedom, -off / max(std, 1e-12))) >= SURE:
        return
    raise Inconsistent(
        f"the positions are {100.0 * off:.3g} +- {100.0 * std:.2g} % "
        f"{'further' if k > 1.0 else 'less far'} apart than the arm moved its tool",
        consequence="Where the rig stands would be wrong by as much of its distance, and nothing is written",
        cure="Check the size of the board's squares that the rig was calibrated with, its baseline, and the unit of "
        "the positions; then whether the arm's file is of this arm, and its tool's point the one that was measured",
    )
