"""Poses that tell less of a tip than their number: readings of one place of the tool, and samples of one recording."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from armsight.arrays import Array
from armsight.calibrate.correlation import Averaged, Correlation, fit_averaged, time_blocks
from armsight.errors import Inconsistent, NotEnoughData
from armsight.fitting.groups import means, repeats
from armsight.records import frozen_array
from armsight.units import DEG

Poses = tuple[Array, Array, Array | None]

MIN_POSES = 4
FAR = 8.0
"""What is this many times further off than the median belongs to something else."""
SAME_PLACE_RAD = 1.0 * DEG
"""Readings of one place of the tool are turned against each other by no more than this."""


def place_numbers(R: Array) -> NDArray[np.intp]:
    """Return (n,), from 0, which place of the tool each pose R (n, 3, 3) is a reading of."""
    return repeats(R.reshape(-1, 9) / np.sqrt(2.0), SAME_PLACE_RAD)  # distances of near rotations so are angles in rad


def places_of(R: Array, t: Array, C: Array | None, place: NDArray[np.intp]) -> tuple[Poses, NDArray[np.bool_]]:
    """Return R (G, 3, 3), t (G, 3), C (G, 6, 6), one pose a place, the mean of its readings, and which (n,) are in it.

    They share what is wrong there: no number of them makes it less. Those far from the middle one are left out.
    """
    n = int(place.max()) + 1
    if n == len(R):
        return (R, t, C), np.ones(n, bool)
    if n < MIN_POSES:
        raise NotEnoughData(
            f"{len(R)} poses are readings of {n} places of the tool, {MIN_POSES} are the fewest that can be checked",
            consequence="No tip is given",
            cure="Turn the tool about its end between readings, to 8 places and more",
        )
    fine = np.ones(len(R), bool)
    for values in (R.reshape(-1, 9), t):
        middle = np.stack([np.median(values[place == k], axis=0) for k in range(n)])
        away = np.linalg.norm(values - middle[place], axis=1)
        several = away[(np.bincount(place) > 2)[place]]
        fine &= away <= FAR * max(float(np.median(several)) if len(several) else np.inf, 1e-9)
    fine |= ~np.isin(place, place[fine])  # a place keeps all its readings where none is near its middle
    mean = np.asarray(Rotation.from_matrix(means(R[fine], place[fine])).as_matrix())
    covariance = None if C is None else means(C[fine], place[fine])
    return (mean, means(t[fine], place[fine]), covariance), fine


# Poses of one recording, whose errors are alike for a while: weighed, claimed and left out by it.

FEWEST_KEPT = 4
"""Poses that must stay where a block of time is left out."""
LEAST_SHARE_TURN = 0.3
"""Share of the turn that they must still have: with less, their tip says nothing of the block."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TipFit:
    """A tip; from poses of one recording with the errors' drift in it.

    x (6,): tip, point. C (6, 6): its covariance. left_out_m (n, 3): R tip + t - point of each pose by the poses further
    away in time, NaN where they do not tell it.
    """

    x: Array
    C: Array
    left_out_m: Array
    correlation: Correlation | None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PivotStream:
    """Poses R (n, 3, 3), t (n, 3) at t_s (n,); V (n, 3, 3): covariances of their residuals up to a factor. prior: what
    is known of x beforehand, with its information (6, 6)."""

    R: Array
    t: Array
    V: Array
    t_s: Array
    prior: tuple[Array, Array] | None = None

    def fit(self, x: Array, keep: NDArray[np.bool_], turn: Array) -> TipFit:
        """Return the fit to the kept poses, x (6,) near it; turn (n,): how far each is turned from the mean, rad."""
        found = self._averaged(x, keep)
        left = np.full((len(self.R), 3), np.nan)
        for inside, away in time_blocks(self.t_s, found.correlation):
            others = keep & away
            if others.sum() < FEWEST_KEPT or _rms(turn[others]) < LEAST_SHARE_TURN * _rms(turn[keep]):
                continue
            left[inside] = self._residuals(x + self._averaged(x, others).step)[inside]
        return TipFit(x=x + found.step, C=found.C, left_out_m=left, correlation=found.correlation)

    def _averaged(self, x: Array, keep: NDArray[np.bool_]) -> Averaged:
        """Return the fit of a step from x, residuals made of one size by the square roots of V."""
        value, vector = np.linalg.eigh(self.V[keep])
        # the symmetric root, not Cholesky's: whitened components stay those of x, y and z, whose drifts are one kind of
        # thing
        root = (vector / np.sqrt(value)[:, None, :]) @ vector.transpose(0, 2, 1)  # (n, 3, 3)
        J = slopes(self.R[keep])
        r = np.einsum("nij,nj->ni", root, self._residuals(x)[keep])
        prior = None if self.prior is None else (self.prior[0] - x, self.prior[1])
        return fit_averaged(r, root @ J, self.t_s[keep], prior)

    def _residuals(self, x: Array) -> Array:
        return np.asarray(self.R @ x[:3] + self.t - x[3:])


def checked_times(t_s: Array, n: int) -> Array:
    """Return times (n,) of one recording; Inconsistent where there are not as many, or they all are the same."""
    t = frozen_array("t_s", t_s, (n,))
    if not np.ptp(t) > 0.0:
        raise Inconsistent(
            f"all {n} poses are of one moment",
            consequence="How long their errors are alike cannot be told",
            cure="Give the times at which they were measured, or none",
        )
    return t


def _rms(turn: Array) -> float:
    return float(np.sqrt(np.mean(turn**2)))


def slopes(R: Array) -> Array:
    """Return (n, 3, 6): how R tip + t - point goes with tip and point."""
    return np.concatenate([R, np.tile(-np.eye(3), (len(R), 1, 1))], axis=2)
