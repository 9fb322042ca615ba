"""What points that are not where they are said to be make of a bundle: lights known to a covariance, a back of another
size. One Gauss-Newton step from the solution tells: with the points moved, it is how the fit would follow them.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.special import chdtri

from armsight.arrays import Array
from armsight.calibrate.cameras.bundle_adjustment import bundle_of, problem_of
from armsight.calibrate.cameras.outlier_rejection import RobustFit
from armsight.errors import Inconsistent
from armsight.records import NamedCovariance

STEP_M = 1e-6
"""Step of the differences by the lights' places: a thousandth of a pixel."""
STEP_SHARE = 1e-3
"""Share of its size by which a back is made larger and smaller."""
BY_CHANCE = 1e-6
"""A back is of another size where noise looks as much so this often,"""
OTHER_SIZE = 0.005
"""... and where it is off by this share: printers scale by less."""


def with_doubt_of(points: Array | None, robust: RobustFit, covariance: NamedCovariance) -> NamedCovariance:
    """Return a covariance with what the points (3 n, 3 n), m squared, are not known to; as it is of exact ones."""
    if points is None:
        return covariance
    n = len(robust.observations.X)
    start = _after(robust, np.zeros((n, 3)))[0]
    T = np.array([(_after(robust, STEP_M * step.reshape(n, 3))[0] - start) / STEP_M for step in np.eye(3 * n)]).T
    (own,) = [one for one in (robust.fit.covariance,) if one is not None]
    at = [covariance.names.index(name) for name in own.names]
    matrix = covariance.matrix.copy()
    matrix[np.ix_(at, at)] += T @ points @ T.T
    return NamedCovariance(names=covariance.names, matrix=0.5 * (matrix + matrix.T))


def require_size_of_back(robust: RobustFit) -> None:
    """Raise Inconsistent where the prints on the two sides of a board cannot both be of the size that is said."""
    seen = robust.observations
    if seen.n_front is None:
        return
    larger = np.where(np.arange(len(seen.X))[:, None] < seen.n_front, 0.0, STEP_SHARE * seen.X)
    low, here, high = (_after(robust, step)[1] for step in (-larger, 0.0 * larger, larger))
    bend = high - 2.0 * here + low
    off = STEP_SHARE * 0.5 * (low - high) / bend
    gain = 0.25 * (low - high) ** 2 / bend / robust.fit.scale**2
    if gain > chdtri(1, BY_CHANCE) and abs(off) > OTHER_SIZE:
        much = f"{100 * abs(off):.1f} % {'larger' if off > 0 else 'smaller'}"
        raise Inconsistent(
            f"beside the front the back is {much} than it is said to be",
            consequence="The size of one of the prints is wrong, places would be as well, and nothing was calibrated",
            cure="Measure the squares of both prints with a calliper, and give these sizes",
        )


def _after(robust: RobustFit, moved: Array) -> tuple[Array, float]:
    """Return the step (F,) of the free numbers once the points have moved (n, 3), m, and the cost after it."""
    fit, seen = robust.fit, replace(robust.observations, X=robust.observations.X + moved)
    (own,) = [one for one in (fit.covariance,) if one is not None]
    problem = problem_of(seen, bundle_of(fit, seen.n_cameras), frozenset(fit.names) - frozenset(own.names))
    here = problem.evaluate(problem.guess, problem.local_guess)
    normal = problem.normal_equations(here, problem.guess, np.array([fit.names.index(name) for name in own.names]))
    step = normal.step(0.0)
    return step[0], 0.5 * float((here.residuals**2).sum()) - float(normal.predicted_decrease(*step))
