"""Joint values to be reached, then nothing more."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from armsight.control.setpoints import CycleState, Finished, JointGoal, SetPoint
from armsight.records import frozen_array

ARRIVED = 1e-6
"""A joint sent nearer to its goal than this (rad or m) and slower than this per s has arrived."""


class GoalSource:
    """Goes to joint values q (n,) in rad or m as fast as the guard lets it, and has then finished."""

    def __init__(self, q: ArrayLike, name: str = "goal") -> None:
        """Raises Inconsistent for values that are not finite."""
        self.name = name
        self._goal = JointGoal(q=frozen_array("q", q, (None,)))

    def next(self, now: CycleState) -> SetPoint:
        """Return the goal until the robot was sent there and rests."""
        goal = self._goal.q
        if len(goal) != len(now.q_sent):
            return self._goal  # the guard refuses it, and says why
        away = float(np.abs(goal - now.q_sent).max())
        return Finished() if max(away, float(np.abs(now.qd_sent).max())) < ARRIVED else self._goal
