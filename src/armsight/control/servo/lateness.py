"""Whether a moving camera's pictures are as old as their stamps say: a target placed at other times takes its way."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

BACK = np.array([0, 1, 2, 3, 4, 6, 8, 11, 15])
"""Frames by which pictures may be older than their stamps: half a second of a webcam."""
FRAMES = 30
"""Frames over which the target's way is compared: a second of a webcam."""
STEP = 3
"""Frames from one place to the next of which the second difference is taken: noise of 0.1 mm is less than a hand."""
ROUGH_M = 0.001
"""Second differences (root of the mean square) below which nothing moves enough to tell."""
SMOOTHER = 0.25
"""The way by older pictures is smoother by less than this only where they are older: honest hands of up to 0.5 m/s
gave 0.39 and more, a delay of two frames 0.06 to 0.11, one that grows 0.08 to 0.18."""
GAP = 1.5
"""Frames further apart than so many periods begin anew."""


class Lateness:
    """Places the target by the camera's poses of some frames before. One thread sees; any may look at frames."""

    def __init__(self) -> None:
        n = FRAMES + int(BACK[-1])
        self._T_base_rig, self._xyz_m = np.zeros((n, 4, 4)), np.ones((n, 4))
        self._rows = np.arange(n - FRAMES, n) - BACK[:, None]
        self._last_s = -np.inf
        self._n = 0
        self.frames = 0

    def see(self, t_s: float, period_s: float, T_base_rig: Array, xyz_m: Array) -> None:
        """Take where the rig was, (4, 4), as the target was seen at xyz_m (3,) in its axes, at t_s by the stamp."""
        self._n = self._n + 1 if t_s - self._last_s < GAP * period_s else 1
        self._last_s = t_s
        self._T_base_rig[:-1], self._xyz_m[:-1] = self._T_base_rig[1:], self._xyz_m[1:]
        self._T_base_rig[-1], self._xyz_m[-1, :3] = T_base_rig, xyz_m
        if self._n < len(self._xyz_m):
            return
        at_m = np.einsum("mnij,nj->mni", self._T_base_rig[self._rows, :3], self._xyz_m[-FRAMES:])
        bend_m = at_m[:, 2 * STEP :] - 2.0 * at_m[:, STEP:-STEP] + at_m[:, : -2 * STEP]
        rough_m = np.sqrt(np.square(bend_m).sum(axis=2).mean(axis=1))
        best = int(np.argmin(rough_m))
        if rough_m[0] > ROUGH_M and rough_m[best] < SMOOTHER * rough_m[0]:
            self.frames = int(BACK[best])

    def forget(self) -> None:
        """Begin anew: the operator has looked."""
        self._n, self.frames = 0, 0
