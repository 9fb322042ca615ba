"""What a tip is calibrated on: one tool that rests on one point, and that point where it was measured to be."""

from __future__ import annotations

from itertools import product

import numpy as np
from numpy.typing import NDArray

from armsight.arrays import Array
from armsight.calibrate.tooltip_result import ToolTipResult
from armsight.calibrate.tooltip_stream import slopes
from armsight.errors import Inconsistent
from armsight.fitting.quantiles import chi2_isf
from armsight.units import MM

FALSE_ALARM = 1e-6
"""Chance that a well measured point is told to be elsewhere."""
AGREED = 1e-6
"""Poses that agree to this (RMS; m, or rad) are of one tool, whatever their last digits say."""
FEWEST, SPLITS = 5, 60
"""Poses of a part; and how many places to part the rows at are tried at most."""
UNSEEN = 1e-12
"""A direction that gives less than this share of the best one's information stays as in the fit of all poses."""
MOST = 80
"""Rows, beyond which neighbours are judged by their means."""
PARTS = (slice(3), slice(3, 6), slice(6))
"""What may have moved: tip, point or both; camera, target or both."""
SURE = float(np.log(1000.0))
"""Logarithm of the odds from which on two settings are told: by Markov's inequality good rows whose errors drift as one
of the models have them once in 1,000 at most."""
SHARES, TIMES, LONGEST = (0.5, 0.85, 0.999), 4, 3.0
"""Drifts that are weighed against two settings: shares of the errors' variance, and over how many times, from the
spacing of the rows to so many lengths of the recording, which is a walk at random."""


def require_one_tool(R: Array, t: Array, rows: NDArray[np.intp], t_s: Array | None) -> None:
    """Raise Inconsistent where poses R (n, 3, 3), t (n, 3), in their order, fall into two parts with a tip each.

    rows (n,): numbers of the poses, from 0. t_s (n,): their times, where they are of one recording.
    """
    if (found := two_settings(R, t, rows.astype(np.float64) if t_s is None else t_s)) is None:
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


def two_settings(R: Array, t: Array, t_s: Array) -> tuple[int, Array] | None:
    """Return the first of poses R (n, 3, 3), t (n, 3) that have another tip or point than those before it.

    With what these moved by (6,), in the unit of t. None where one tip and point may serve all. t_s (n,): times of the
    poses, rising, in any unit. Bayes's factor over what may have moved (as far as one row tells it, Zellner 1986) and
    where, and over errors that are white or drift, in the axes that are fixed or in those that turn.
    """
    begin = np.unique(np.linspace(0, len(R), min(len(R), MOST) + 1)[:-1].astype(int))
    if len(begin) < 2 * FEWEST:
        return None
    J = slopes(R)
    r = J @ np.linalg.lstsq(J.reshape(-1, 6), -t.reshape(-1), rcond=None)[0] + t
    if (r**2).mean() < AGREED**2:
        return None
    count, rows = np.diff(begin, append=len(R))[:, None], np.concatenate([J, r[:, :, None]], axis=2)
    fixed, turning = (np.add.reduceat(a.reshape(-1, 21), begin) / count for a in (rows, R.mT @ rows))
    n, fixed, turning = len(fixed), fixed.reshape(-1, 3, 7), turning.reshape(-1, 3, 7)
    k = np.unique(np.linspace(FEWEST, n - FEWEST, SPLITS).astype(int))
    sums = (fixed.mT @ fixed).cumsum(axis=0)
    white = _odds(sums[-1], sums[-1] - sums[k - 1], sums[-1] - sums[k - 1], n)
    if _log_odds([white]) < SURE:  # drifts could but explain it
        return None
    t_s = np.add.reduceat(t_s, begin) / count[:, 0]
    gap, found = np.abs(t_s[:, None] - t_s), [white]
    for time_s, share in product(np.geomspace(gap.max() / n, LONGEST * gap.max(), TIMES), SHARES):
        V = share * np.exp(-gap / time_s) + (1.0 - share) * np.eye(n)
        P, logdet = np.linalg.inv(V), float(np.linalg.slogdet(V)[1])
        for all_ in (fixed.transpose(1, 0, 2), turning.transpose(1, 0, 2)):  # (3, n, 7)
            late = all_ * (np.arange(n) >= k[:, None])[:, None, :, None]  # (K, 3, n, 7)
            cross, both = late.mT @ (P @ all_), late.mT @ (P @ late)
            found.append(_odds((all_.mT @ (P @ all_)).sum(axis=0), cross.sum(axis=1), both.sum(axis=1), n, logdet))
    if _log_odds(found) < SURE:
        return None
    best = int(np.logaddexp.reduce([two for _, two, _ in found], axis=(0, 1)).argmax())
    return int(begin[k[best]]), white[2][best]


def _log_odds(found: list[tuple[float, Array, Array]]) -> float:
    """Return the logarithm of the odds of two settings over one, drifts and places to part at being alike before."""
    one, two = np.array([each[0] for each in found]), np.array([each[1] for each in found])
    return float(np.logaddexp.reduce(two, axis=None) - np.log(two[0].size) - np.logaddexp.reduce(one))


def _odds(N: Array, cross: Array, both: Array, n: int, logdet: float = 0.0) -> tuple[float, Array, Array]:
    """Return log likelihoods of one setting, and that PARTS moved at each of K rows (PARTS, K); and the moves (K, 6).

    N (7, 7): normal matrix of the slopes and residuals of n rows, cross (K, 7, 7): of the later ones with all, both
    (K, 7, 7): with each other; logdet: of the errors' correlation.
    """
    least, free = UNSEEN * float(np.trace(N[:6, :6])), 3 * n - 6
    H = N[:6, :6] + least * np.eye(6)
    x = -np.linalg.solve(H, N[:6, 6])
    left = max(float(N[6, 6] + N[6, :6] @ x), 1e-300)
    one = -0.5 * float(3.0 * logdet + np.linalg.slogdet(H)[1] + free * np.log(left))
    information = both[:, :6, :6] - cross[:, :6, :6] @ np.linalg.solve(H, cross[:, :6, :6].mT) + least * np.eye(6)
    pull = -(cross[:, :6, 6:] + cross[:, :6, :6] @ x[:, None])
    two = np.empty((len(PARTS), len(cross)))
    for i, part in enumerate(PARTS):
        move = np.linalg.solve(information[:, part, part], pull[:, part])
        gain = np.minimum((move * pull[:, part]).sum(axis=(1, 2)) / left, 1.0 - 1e-12) * n / (n + 1.0)
        two[i] = one - 0.5 * (move.shape[1] * np.log(n + 1.0) + free * np.log1p(-gain))
    return one, np.asarray(two), np.asarray(move[:, :, 0])


def require_point_there(free: ToolTipResult, xyz_m: Array, sigma_m: float) -> None:
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
