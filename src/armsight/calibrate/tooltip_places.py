"""Readings of one place of a tool, which are one pose to its tip."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from armsight.arrays import Array
from armsight.errors import NotEnoughData
from armsight.fitting.groups import means, repeats
from armsight.units import DEG

MIN_POSES = 4
FAR = 8.0
"""What is this many times further off than the median belongs to something else."""
SAME_PLACE_RAD = 1.0 * DEG
"""Readings of one place of the tool are turned against each other by no more than this."""


def place_numbers(R: Array) -> NDArray[np.intp]:
    """Return (n,), from 0, which place of the tool each pose R (n, 3, 3) is a reading of."""
    return repeats(R.reshape(-1, 9) / np.sqrt(2.0), SAME_PLACE_RAD)  # distances of near rotations so are angles in rad


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Places:
    """Poses R (G, 3, 3), t (G, 3) and their covariances (G, 6, 6), if given, one a place; fine (n,): the readings that
    they are the means of."""

    poses: tuple[Array, Array, Array | None]
    fine: NDArray[np.bool_]


def places_of(R: Array, t: Array, C: Array | None, place: NDArray[np.intp]) -> Places:
    """Return one pose a place, the mean of its readings, which share what is wrong there: no number of them makes it
    less. Readings far from the middle one of their place are left out."""
    n = int(place.max()) + 1
    if n == len(R):
        return Places(poses=(R, t, C), fine=np.ones(n, bool))
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
    return Places(
        poses=(mean, means(t[fine], place[fine]), None if C is None else means(C[fine], place[fine])), fine=fine
    )
