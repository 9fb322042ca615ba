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
NOTED_OFF = 0.002
"""Scales further from one are told: those of three real sets of a UR10 by its nominal lengths are within 0.0014."""


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


def check_motion_scale(base_m: Array, rig_m: Array) -> tuple[str, ...]:
    """Return a note where positions (m, 3), four or more, are of a slightly other scale than the arm's motion.

    Raises Inconsistent where they are of another one altogether.
    """
    k, std = motion_scale(base_m, rig_m)
    off, freedom = abs(k - 1.0), 3 * len(rig_m) - 7
    if std * np.sqrt(freedom) > MOST_SHARE:  # no scale makes them the arm's
        return ()
    if off <= NOTED_OFF or 2.0 * float(stdtr(freedom, -off / max(std, 1e-12))) >= SURE:
        return ()
    further = "further" if k > 1.0 else "less far"
    cause = f"the positions are {100.0 * off:.3g} +- {100.0 * std:.2g} % {further} apart than the arm moved its tool"
    check = "the size of the board's squares that the rig was calibrated with, its baseline, and "
    if off <= MOST_OFF:
        wrong = "where the rig stands is wrong by as much of its distance, which no standard deviation here tells"
        return (f"{cause}: {wrong}. Check {check}whether the arm's file is of this arm",)
    raise Inconsistent(
        cause,
        consequence="Where the rig stands would be wrong by as much of its distance, and nothing is written",
        cure=f"Check {check}the unit of the positions; then whether the arm's file is of this arm, and its tool's "
        "point the one that was measured",
    )
