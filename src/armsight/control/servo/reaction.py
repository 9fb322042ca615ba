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
NOISE_SIGMAS = 6.0
"""Standard deviations of a pose's change by noise; a target that is followed well wanders by more before the camera."""

STANDS = 3
"""So many poses in a row, equal to the last digit while the camera moved, are one picture: one may be sent twice."""

STANDS_M = 0.001
"""A camera that moved so far, as a target before it would tell, sees no equal poses: ten times what an arm shakes."""


class Reaction:
    """Watches the target's place before a camera that moves. One thread sees; any may look at missing."""

    def __init__(self, chase_m: float) -> None:
        self._chase_m = chase_m
        self._away: tuple[Array, Array] | None = None
        self._since: tuple[Array, Array] | None = None
        self._same = 0
        self._last: Array | None = None
        self.missing = False

    def see(self, T_base_rig: Array, T_rig_target: Array, sigma_m: Array, error: ServoError | None) -> None:
        """Take where the rig was, (4, 4), as the target was seen at (4, 4), and how far it is from where wanted.

        sigma_m (3,): standard deviations of its place in rig axes.
        """
        now, way_m = (T_base_rig, T_rig_target), 0.0
        if self._since is not None:
            way_m, seen_m = moved(self._since, now)
            if (np.abs(seen_m) > NOISE_SIGMAS * np.sqrt(2.0) * sigma_m).any():
                self._since, way_m = None, 0.0
        self._since = self._since or now
        self._same = self._same + 1 if self._last is not None and np.array_equal(self._last, T_rig_target) else 0
        self._last = T_rig_target
        self.missing = self.missing or (self._same >= STANDS and way_m > STANDS_M)
        self.missing = self.missing or way_m > self._chase_m
        if error is None or float(np.linalg.norm(error.translation_m)) < ERROR_M:
            self._away = None
        if self._away is not None:
            way_m, seen_m = moved(self._away, now)
            if float(np.linalg.norm(seen_m)) > REACTS * max(way_m, 0.1 * self._chase_m):
                self._away = None
            self.missing = self.missing or (self._away is not None and way_m > self._chase_m)
        self._away = self._away or now

    def forget(self) -> None:
        """Begin anew: the operator has looked."""
        self._away, self._since, self._same, self.missing = None, None, 0, False


def moved(since: tuple[Array, Array], now: tuple[Array, Array]) -> tuple[float, Array]:
    """Return how far a resting target would have gone before the camera, and how far (3,) this one was seen to go."""
    (A, T), (B, T_now) = since, now
    rested_m = B[:3, :3].T @ (A[:3, :3] @ T[:3, 3] + A[:3, 3] - B[:3, 3])
    return float(np.linalg.norm(rested_m - T[:3, 3])), T_now[:3, 3] - T[:3, 3]
