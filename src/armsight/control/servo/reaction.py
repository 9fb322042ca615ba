"""Whether a target that a moving camera sees reacts to the camera's motion: one that does not was not seen just now."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from armsight.control.servo.law import ServoError

Array = NDArray[np.float64]

REACTS = 0.25
"""Share of the camera's way by which a target's place before it has to change: a resting one changes by all of it."""
ERROR_M = 0.005
"""A target nearer than this to where it is wanted may stay there while both move: the arm follows it well."""


class Reaction:
    """Watches the target's place before a camera that moves towards it. One thread sees; any may look at missing."""

    def __init__(self, chase_m: float) -> None:
        self._chase_m = chase_m
        self._since: tuple[Array, Array] | None = None
        self.missing = False

    def see(self, T_base_flange: Array, T_rig_target: Array, error: ServoError | None) -> None:
        """Take where the flange was, (4, 4), as the target was seen at (4, 4), and how far it is from where wanted."""
        if error is None or float(np.linalg.norm(error.translation_m)) < ERROR_M or self._since is None:
            self._since = (T_base_flange, T_rig_target)
            return
        way_m = float(np.linalg.norm(T_base_flange[:3, 3] - self._since[0][:3, 3]))
        seen_m = float(np.linalg.norm(T_rig_target[:3, 3] - self._since[1][:3, 3]))
        if seen_m > REACTS * max(way_m, 0.1 * self._chase_m):
            self._since = (T_base_flange, T_rig_target)
        elif way_m > self._chase_m:
            self.missing = True

    def forget(self) -> None:
        """Begin anew: the operator has looked."""
        self._since, self.missing = None, False
