"""Which of the goals that a controller was given it has taken, by where it says that it means to be."""

from __future__ import annotations

from collections import deque

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from armsight.drivers.pose_goals import between

Goal = NDArray[np.float64] | RigidTransform

NEAR = 1e-5
"""A planned position nearer to the last goal, in rad or m, is it; what it may lack is no jump."""

SAME = 1e-7
"""A planned position nearer to an older goal, in rad or m, is that one."""

OLDER = 16
"""So many goals are remembered: more than are ever under way."""


class GivenGoals:
    """The goals of one link that went out last, joints (n,) or poses; for the link's thread."""

    def __init__(self) -> None:
        self._goals: deque[Goal] = deque(maxlen=OLDER)

    def start(self) -> None:
        """Forget all."""
        self._goals.clear()

    def give(self, goal: Goal) -> None:
        """Note a goal that goes out, maybe once more."""
        if not self._goals or _apart(goal, self._goals[-1]) > 0.0:
            self._goals.append(goal)

    def taken(self, planned: Goal | None) -> bool:
        """Tell whether the planned position is the last goal, or one that was never given; True where none is told.

        A controller that smooths plans something between its goals, and limits by itself what it catches up; one that
        takes goals as they are, and stands at an older one, would catch it up within a cycle.
        """
        if planned is None or not self._goals or _apart(planned, self._goals[-1]) <= NEAR:
            return True
        return all(_apart(planned, goal) > SAME for goal in self._goals)


def _apart(a: Goal, b: Goal) -> float:
    """Return how far joints or poses are from each other, in rad or m."""
    if isinstance(a, RigidTransform) and isinstance(b, RigidTransform):
        return float(np.abs(np.concatenate(between(a, b))).max())
    return float(np.abs(np.asarray(a) - np.asarray(b)).max())
