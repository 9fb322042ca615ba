"""Where a joint's axis may be, its values known: the best of all directions, and others that noise does not exclude."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from armsight.calibrate.identify.chain import Axis
from armsight.calibrate.identify.kernels import axis_costs, settle_axis
from armsight.calibrate.identify.residuals import SweepResiduals

Array = NDArray[np.float64]

DIRECTIONS = 400
"""Directions tried, spread over the sphere 10 degrees apart."""
APART_COS = np.cos(np.deg2rad(25.0))
"""Minima nearer to each other than this are followed once."""
SAME_COS = np.cos(np.deg2rad(2.0))
FOLLOWED = 4
PLAUSIBLE = 60.0
"""Chi-square above the best one's up to which an axis is worth a start: positions are linearised there."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Candidate:
    """An axis as one sweep shows it, the other joints at rest, and the sweep's chi-square with it."""

    axis: Axis
    chi2: float


def candidates(seen: SweepResiduals, q: Array, *, revolute: bool) -> list[Candidate]:
    """Return the axes that explain a sweep best at the joint's values q (m,), the best first.

    For a direction the rest of the motion is linear, so that all directions can be tried: no start can be wrong. A
    turning joint's place is a + cos q b + sin q n x b, a sliding one's a + q n.
    """
    xyz, W = seen.sweeps.xyz_m, _information(seen)
    middle, mean = 0.5 * (q.min() + q.max()), xyz.mean(axis=0)
    centred, value = xyz - mean, q - middle
    grid = _sphere(DIRECTIONS)
    costs = np.empty(len(grid))
    axis_costs(revolute, grid, centred, W, value, costs)
    out: list[Candidate] = []
    for start in _minima(grid, costs):
        direction, p = start.copy(), np.empty(6)
        cost = settle_axis(revolute, direction, 0.1, centred, W, value, p)
        if not np.isfinite(cost) or any(one.axis.direction @ direction > SAME_COS for one in out):
            continue
        axis = Axis(point_m=mean + p[:3], direction=direction, revolute=revolute)
        out.append(Candidate(axis=axis, chi2=cost))
    out.sort(key=lambda one: one.chi2)
    return out


def plausible(found: Sequence[Candidate], best: float) -> list[Candidate]:
    """Return those candidates that the noise does not exclude beside one of chi-square best."""
    return [one for one in found if one.chi2 < best + PLAUSIBLE]


def _information(seen: SweepResiduals) -> Array:
    """Return the information (m, 3, 3) of every place."""
    m = len(seen.sweeps)
    W: Array
    if seen.rig is None and seen.whitener is not None:
        W = seen.whitener.transpose(0, 2, 1) @ seen.whitener / seen.sigma**2
    elif seen.sweeps.covariance_m2 is not None:
        W = np.asarray(np.linalg.inv(seen.sweeps.covariance_m2) / seen.relative**2)
    else:
        W = np.tile(np.eye(3) / seen.sigma**2, (m, 1, 1))
    return np.ascontiguousarray(W)


def _minima(grid: Array, costs: Array) -> list[Array]:
    """Return the best directions of the grid that lie apart."""
    out: list[Array] = []
    for i in np.argsort(costs):
        if len(out) == FOLLOWED or not np.isfinite(costs[i]):
            break
        if all(grid[i] @ one < APART_COS for one in out):
            out.append(grid[i])
    return out


def _sphere(n: int) -> Array:
    """Return n directions (n, 3), evenly spread."""
    i = np.arange(n) + 0.5
    z, turn = 1.0 - 2.0 * i / n, np.pi * (1.0 + np.sqrt(5.0)) * i
    r = np.sqrt(1.0 - z**2)
    return np.column_stack([r * np.cos(turn), r * np.sin(turn), z])
