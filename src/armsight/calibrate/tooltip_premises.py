"""What a tip is calibrated on: one tool that rests on one point, and that point where it was measured to be."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from armsight.calibrate.tooltip_result import TipCalibration
from armsight.calibrate.tooltip_stream import slopes
from armsight.errors import Inconsistent
from armsight.fitting.quantiles import chi2_isf, f_sf
from armsight.units import MM

Array = NDArray[np.float64]

FALSE_ALARM = 1e-6
"""Chance that good poses are told to be of two tools, or a well measured point to be elsewhere."""
AGREED = 1e-6
"""Poses that agree to this (RMS; m, or rad) are of one tool, whatever their last digits say."""
FEWEST, SPLITS = 5, 60
"""Poses of a part; and how many places to part the rows at are tried at most."""
UNSEEN = 1e-12
"""A direction that gives less than this share of the best one's information stays as in the fit of all poses."""
SHARE = 0.1
"""Two parts are told where they leave less than this share of the squares. Of 1,600 recordings of 10 to 100 poses with
white noise none leaves less than 0.3; where positions walk at random while the tool is led once around, one in 200
leaves less than 0.05 to 0.12, and in any order less than 0.14. 3 mm of slip over 0.17 mm of noise leave 0.02."""


def require_one_tool(R: Array, t: Array, rows: NDArray[np.intp]) -> None:
    """Raise Inconsistent where poses R (n, 3, 3), t (n, 3), in their order, fall into two parts with a tip each.

    rows (n,): numbers of the poses, from 0.
    """
    if (found := two_settings(R, t)) is None:
        return
    at, moved = found
    tip, point = (float(np.linalg.norm(v)) / MM for v in np.split(moved, 2))
    raise Inconsistent(
        f"from row {rows[at] + 1} on the poses want another tip than those before, by {tip:.3g} mm, and another "
        f"resting point, by {point:.3g} mm",
        consequence="The tool slipped or the point was moved in between, or two recordings were put together; no tip "
        "is given",
        cure=f"Calibrate the rows before row {rows[at] + 1} and those from it on apart, or record again with tool and "
        "point clamped",
    )


def two_settings(R: Array, t: Array) -> tuple[int, Array] | None:
    """Return the first of poses R (n, 3, 3), t (n, 3) that have another tip or point than those before it.

    With what these moved by (6,), m. None where one tip and point may serve all.
    """
    n = len(R)
    if n < 2 * FEWEST:
        return None
    J = slopes(R).reshape(n, 3, 6)
    x = np.linalg.lstsq(J.reshape(-1, 6), -t.reshape(-1), rcond=None)[0]
    r = J @ x + t
    whole = float((r**2).sum())
    # a part's fit differs from that of all by what its own normal equations still ask for: running sums give both parts
    k = np.unique(np.linspace(FEWEST, n - FEWEST, SPLITS).astype(int))
    A, g = np.einsum("nia,nib->nab", J, J).cumsum(axis=0), np.einsum("nia,ni->na", J, r).cumsum(axis=0)
    A, g = np.stack([A[k - 1], A[-1] - A[k - 1]]), np.stack([g[k - 1], g[-1] - g[k - 1]])
    steps = -np.einsum("pkab,pkb->pka", np.linalg.pinv(A, rcond=UNSEEN, hermitian=True), g)
    gain = -np.einsum("pka,pka->k", steps, g)
    best = int(gain.argmax())
    left, dof = max(whole - float(gain[best]), 1e-300), 3 * n - 12
    chance = float(f_sf(float(gain[best]) / 6.0 / (left / dof), 6, dof)) * len(k)
    one = whole < 3 * n * AGREED**2 or left > SHARE * whole or chance > FALSE_ALARM
    return None if one else (int(k[best]), steps[1, best] - steps[0, best])


def require_point_there(free: TipCalibration, xyz_m: Array, sigma_m: float) -> None:
    """Raise Inconsistent where the point, measured at xyz_m (3,) to sigma_m, is not where the poses alone find it."""
    C = free.covariance.matrix[3:, 3:] + sigma_m**2 * np.eye(3)
    off = xyz_m - free.point_m
    if float(off @ np.linalg.solve(C, off)) <= float(chi2_isf(FALSE_ALARM, 3)):
        return
    found = ",".join(f"{v:.5f}" for v in free.point_m)
    raise Inconsistent(
        f"the point was measured {np.linalg.norm(off) / MM:.3g} mm from where the tip rests, at {found} m by the poses",
        consequence="The tip would be drawn aside by it; none is given",
        cure="Leave the point out, the tip does not need it; or measure it in the frame of the poses, and say how well "
        "with --point-sigma",
    )
