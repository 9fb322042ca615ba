"""What the lights may be called: one hypothesis, what a track predicts, and the verdict."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from armsight.errors import Unseen
from armsight.measure.poses.target_model import TargetModel
from armsight.records import NotSeen

Array = NDArray[np.float64]
Index = NDArray[np.intp]

PREDICTION_RATIO = 3.0
"""A prediction decides between assignments where the next one is this many times further from it."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Assignment:
    """One hypothesis: names, the pair that each is (rows of Pairs), its chi-square, and the pose behind it.

    R (3, 3), t_m (3,): T_rig_target of the fit with slack; None for lights without a measured arrangement.
    """

    names: tuple[str, ...]
    pair: Index
    chi2: float
    R: Array | None = None
    t_m: Array | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Prediction:
    """Where the lights are expected: xyz_m (m, 3) in rig axes, NaN where nothing is known; within_m: how far off it
    may be; turned_m: how far off each light may be from the others, by the target's turning. It breaks ties, and only
    between assignments of which one is that near."""

    xyz_m: Array
    within_m: float
    turned_m: float = float("inf")

    def _far_m(self, model: TargetModel, a: Assignment) -> float:
        """Return the root mean square distance of the lights from where they are expected."""
        if a.R is None or a.t_m is None or not np.isfinite(self.xyz_m).any():
            return float("inf")
        return float(np.sqrt(np.nanmean(((model.xyz_m @ a.R.T + a.t_m) - self.xyz_m) ** 2) * 3.0))

    def _turned_far(self, model: TargetModel, a: Assignment) -> bool:
        """Whether a light is further from its place among the others than the target can have turned."""
        if a.R is None or a.t_m is None or np.isfinite(self.xyz_m[:, 0]).sum() < 2:
            return False
        off = model.xyz_m @ a.R.T + a.t_m - self.xyz_m
        return bool(np.nanmax(np.linalg.norm(off - np.nanmean(off, axis=0), axis=1)) > self.turned_m)

    def holds(self, model: TargetModel, a: Assignment) -> bool:
        """Whether an assignment is where the lights are expected."""
        return self._far_m(model, a) <= self.within_m and not self._turned_far(model, a)

    def choice(self, model: TargetModel, found: list[Assignment]) -> Assignment | None:
        """Return the assignment that is as expected where the next one is much further off."""
        far = np.array([self._far_m(model, a) for a in found])
        order = np.argsort(far)
        first = far[order[0]]
        if first <= self.within_m and far[order[1]] > PREDICTION_RATIO * first:
            return found[int(order[0])]
        return None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Match:
    """The assignment that holds, or none, why and by which cause; alternatives that fit as well.

    predicted: it is where it was expected. chance: expected number of others that fit as well by chance.
    """

    best: Assignment | None
    alternatives: tuple[Assignment, ...] = ()
    why: str = ""
    predicted: bool = False
    chance: float = 0.0
    cause: Unseen = Unseen.OTHER

    @property
    def missed(self) -> NotSeen:
        """Why no assignment holds."""
        return NotSeen(self.why, self.cause)
