"""Whether a target that a moving camera sees reacts to the camera's motion: one that does not was not seen just now."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from armsight.control.guard.space import pose_difference

Array = NDArray[np.float64]

LIKELY, FEW = 4.0, 8.0
"""Standard deviations by which the scatter of a pose that stands may be above what its noise makes of it, and what is
added to that: of few poses it is not yet like a normal distribution."""
POSES = 5
"""Of fewer poses the scatter tells nothing: two or three of a target that is followed at 0.2 m/s may agree."""
TELLING = 10.0
"""The camera's motion tells once it would move a resting target by so many standard deviations of its pose."""
STANDS = 3
"""So many poses in a row, equal to the last digit while the camera moved, are one picture: one may be sent twice."""
STANDS_M = 0.001
"""A camera that moved so far sees no equal poses: ten times what an arm shakes."""


class Reaction:
    """Watches the target's place before a camera that moves. One thread sees; any may look at missing."""

    def __init__(self, chase_m: float) -> None:
        self._chase_m = chase_m
        self._n = self._same = 0
        self._mean, self._scatter = np.zeros(6), 0.0
        self._T_base_since = self._T_since = self._T_rig_target = np.eye(4)
        self.missing = False

    def see(self, T_base_rig: Array, T_rig_target: Array, sigma: Array) -> None:
        """Take where the rig was, (4, 4), as the target was seen at (4, 4) with standard deviations (6,) in rig axes.

        Those of a rotation that was not seen are infinite.
        """
        self._same = self._same + 1 if np.array_equal(self._T_rig_target, T_rig_target) else 0
        if self._n:
            off = np.concatenate(pose_difference(T_rig_target, self._T_since)) / sigma
            before = off - self._mean
            self._n += 1
            self._mean = self._mean + before / self._n
            self._scatter += float(before @ (off - self._mean))
        freedom = 6.0 * (self._n - 1)
        if not self._n or self._scatter > freedom + LIKELY * np.sqrt(2.0 * freedom) + FEW:
            self._n, self._mean, self._scatter = 1, np.zeros(6), 0.0
            self._T_base_since, self._T_since = T_base_rig, T_rig_target
        self._T_rig_target = T_rig_target
        rested = np.linalg.inv(T_base_rig) @ self._T_base_since @ self._T_since
        told = np.concatenate(pose_difference(rested, self._T_since)) / sigma
        way_m = float(np.linalg.norm(T_base_rig[:3, 3] - self._T_base_since[:3, 3]))
        stands = self._same >= STANDS and way_m > STANDS_M
        told_by = self._n >= POSES and way_m > self._chase_m and float(np.linalg.norm(told)) > TELLING
        if stands or told_by:
            self.missing = True

    def forget(self) -> None:
        """Begin anew: the operator has looked."""
        self._n = self._same = 0
        self.missing = False
