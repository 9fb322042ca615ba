"""Whether measurements are of the arm at all: fits that miss by much of what the tool moved are refused, with rows."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from armsight.calibrate.arm.initial_guess import start
from armsight.calibrate.arm.model import ArmModel
from armsight.calibrate.arm.other_arm import explained
from armsight.calibrate.arm.points import ArmPoints
from armsight.errors import Degenerate, Inconsistent

Array = NDArray[np.float64]

MOST_SHARE = 0.1
"""Errors of a larger share of how far the tool moved are not of this arm: 2 degrees of all zeros give 0.02 to 0.04."""
WRONG = 0.2
"""Share of rows with such errors that is borne, as outliers by name; a robust fit goes astray at about a third."""
PLAUSIBILITY_TRIES = 60
"""Draws of joint positions: at half the rows wrong, one draw of four without a wrong one is missed once in 48."""
AGREEING = 0.4
"""Share of the rows that must agree before the others are named: half of them swapped leaves a half, and the nominal
arm's own errors put some of those beyond the limit."""
DRAWN = 4
"""Joint positions per draw: the fewest that base and one tool point do not fit whatever they are."""
REFITS = 4
"""Fits to the rows that agree, and counts again."""
PLAUSIBILITY_SEED = 7
"""The same measurements give the same answer."""


def spread_m(xyz_m: Array) -> float:
    """Return how far positions (m, 3) typically are from their middle, in m; medians, which few wrong rows leave
    alone."""
    return float(np.median(np.linalg.norm(xyz_m - np.median(xyz_m, axis=0), axis=1)))


def check_fit(model: ArmModel, points: ArmPoints, error_m: Array) -> None:
    """Raise Inconsistent where the best fit's errors (m,) say that the measurements are not of this arm."""
    spread = spread_m(points.xyz_m)
    if exceeded(error_m) > MOST_SHARE * spread:
        other = explained(model, points)
        raise senseless(error_m, spread, () if other else _disagreeing(model, points, MOST_SHARE * spread), other)


def exceeded(error_m: Array) -> float:
    """Return what the share WRONG of errors (m,) exceeds, in m."""
    return float(np.quantile(error_m, 1.0 - WRONG))


def senseless(error_m: Array, spread: float, rows: Sequence[int] = (), other: str = "") -> Inconsistent:
    """Return the refusal; rows from 0 that do not agree with the majority, none where there is no majority.

    other: why they are of another arm, where that is known.
    """
    told = f": row{'s' * (len(rows) > 1)} {ranges(rows)} do not agree with the others" if len(rows) else ""
    cure = "Leave those rows out, or measure them again" if len(rows) else "Give the file of this arm"
    if other:
        return Inconsistent(
            f"the nominal arm misses a fifth of the positions by {1e3 * exceeded(error_m):.3g} mm or more, and the "
            f"tool moved by {1e3 * spread:.3g} mm",
            consequence="Nothing is written",
            cure=other,
        )
    return Inconsistent(
        f"the best fit misses a fifth of the positions by {1e3 * exceeded(error_m):.3g} mm or more, and the tool moved "
        f"by {1e3 * spread:.3g} mm{told}",
        consequence="The measurements are not of this arm at these readings, and nothing is written",
        cure=f"{cure}; look for another arm's rows, readings and positions out of step, positions of a reflection, "
        "rows of several places on the tool without a column `point`",
    )


def ranges(rows: Sequence[int] | NDArray[np.intp]) -> str:
    """Return rows counted from 0 as text counted from 1, neighbours joined: '3-7, 9'."""
    parts = np.split(np.asarray(rows), np.flatnonzero(np.diff(rows) > 1) + 1)
    told = [f"{part[0] + 1}" + (f"-{part[-1] + 1}" if len(part) > 1 else "") for part in parts]
    return ", ".join(told[:12]) + (" and more" if len(told) > 12 else "")


def _disagreeing(model: ArmModel, points: ArmPoints, limit_m: float) -> list[int]:
    """Return the rows that miss by more than a limit what the most rows agree on; none where too few do."""
    rng = np.random.default_rng(PLAUSIBILITY_SEED)
    position = points.position
    like = model.vector(RigidTransform.identity(), [model.arm.T_flange_tool] * len(model.labels))
    best = np.zeros(len(points), bool)
    for _ in range(PLAUSIBILITY_TRIES):
        drawn = rng.choice(position.max() + 1, DRAWN, replace=False)
        rows = np.flatnonzero(np.isin(position, drawn))
        try:
            p = start(model, points.take(rows), like=like)
        except Degenerate:
            continue
        agree = _within(model, p, points, limit_m)
        best = agree if agree.sum() > best.sum() else best
    for _ in range(REFITS):  # from all that agree, base and tool are better known than from the draw
        if len(np.unique(position[best])) < DRAWN:
            return []
        best = _within(model, start(model, points.take(np.flatnonzero(best)), like=like), points, limit_m)
    return [] if best.mean() < AGREEING else np.flatnonzero(~best).tolist()


def _within(model: ArmModel, p: Array, points: ArmPoints, limit_m: float) -> NDArray[np.bool_]:
    return np.asarray(np.linalg.norm(model.errors(p, points)[0], axis=1) <= limit_m)


def check_apart(points: ArmPoints, holdout: ArmPoints) -> None:
    """Raise Inconsistent where rows of the holdout are rows of the measurements, to the last digit."""
    fitted = set(map(bytes, np.column_stack([points.q, points.xyz_m])))
    same = sum(bytes(row) in fitted for row in np.column_stack([holdout.q, holdout.xyz_m]))
    if same:
        raise Inconsistent(
            f"{same} of {len(holdout)} rows of the holdout are rows of the measurements too",
            consequence="They would judge the geometry that was fitted to them, and call it better than it is",
            cure="Give rows that are in one file only, or leave the holdout away: rows left out in turn judge then",
        )
