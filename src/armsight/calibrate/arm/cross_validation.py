"""Errors at joint positions left out, with all that looked at the measurements done again without them (nested folds).

Noise, weights, the choice of parameters, coupled readings and the kind of model are found afresh in each fold, and the
fit runs to its end (Varma and Simon 2006: what is chosen with the rows left out flatters itself on them).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from armsight.calibrate.arm.fit import Tolerance
from armsight.calibrate.arm.initial_guess import start
from armsight.calibrate.arm.model import ArmModel
from armsight.calibrate.arm.model_selection import FOLDS, PROVED, Level, best_level, fit_levels
from armsight.calibrate.arm.points import ArmPoints
from armsight.errors import Degenerate, NotConverged, NotEnoughData

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LeftOut:
    """Errors (m,) in m at rows left out; NaN where the other rows do not tell where a row's tool point is.

    nominal_m: with the nominal geometry. chosen_m: with what each fold chose. by_level: with each kind of model.
    """

    nominal_m: Array
    chosen_m: Array
    by_level: Mapping[str, Array]

    @property
    def judged(self) -> NDArray[np.bool_]:
        """Which rows (m,) are judged."""
        return np.asarray(np.isfinite(self.nominal_m))


def cross_validate(
    model: ArmModel, points: ArmPoints, levels: Sequence[Level], tolerance: Tolerance, *, scale: bool
) -> LeftOut:
    """Return the errors at each row, calibrated without its joint position and every FOLDS-th beside it, or without its
    block of time, every FOLDS-th beside it and what is near them in time.

    levels: of all rows; the folds begin where they ended. A fold takes a kind of model as all rows do, by one step
    (left_out); with fewer rows the same fall is fewer of its standard errors, by the root of their share. Raises
    NotEnoughData where no fold can be judged.
    """
    m = len(points)
    nominal, chosen = np.full(m, np.nan), np.full(m, np.nan)
    by_level = {x.name: np.full(m, np.nan) for x in levels}
    fold = points.group % FOLDS
    for k in range(int(fold.max()) + 1):
        rest = points.take(np.flatnonzero(points.away(fold == k)))
        known = np.array([label in rest.labels for label in points.point])
        rows = np.flatnonzero((fold == k) & known)
        if not len(rows):
            continue
        try:
            guess = start(model, rest, like=levels[0].fitted.p)
            refitted = fit_levels(model, rest, guess, tolerance, scale=scale, like=levels)
        except (NotConverged, Degenerate):
            continue
        there = points.take(rows)
        sizes = {x.name: np.linalg.norm(model.errors(x.fitted.p, there)[0], axis=1) for x in refitted}
        nominal[rows] = sizes[refitted[0].name]
        fewer = PROVED * float(np.sqrt(len(rest) / m))
        taken = best_level(refitted, rest.group, proved=fewer)
        chosen[rows] = sizes[taken.name]
        for name, errors in by_level.items():
            errors[rows] = sizes.get(name, nominal[rows])
    if not np.isfinite(nominal).any():
        raise NotEnoughData(
            "no row can be predicted from the rows of other joint positions",
            consequence="Whether a correction is worth it cannot be judged",
            cure="Measure every point of the tool at several joint positions, and more of them",
        )
    return LeftOut(nominal_m=nominal, chosen_m=chosen, by_level=by_level)
