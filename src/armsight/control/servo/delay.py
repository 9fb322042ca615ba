"""The delays of a servo, measured while it runs: of the cameras, and of the arm behind its commands."""

from __future__ import annotations

from collections import deque

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

FRAMES = 100
"""Frames of which the delay is the median."""
PRIOR_RAD = 0.05
"""The lag first assumed counts as much as this way of one joint; the lag of a longer way outweighs it."""
LEAST_S, MOST_S = 0.0, 0.5
"""Between these a lag is believed."""


class CameraDelay:
    """From exposure to pose, and from frame to frame: medians of the newest FRAMES."""

    def __init__(self) -> None:
        self._delays: deque[float] = deque(maxlen=FRAMES)
        self._periods: deque[float] = deque(maxlen=FRAMES)
        self._last_s: float | None = None
        self.delay_s = 0.0
        self.period_s = 0.0

    @property
    def n(self) -> int:
        """How many frames there were, FRAMES at most."""
        return len(self._delays)

    def add(self, exposed_s: float, known_s: float) -> None:
        """Take a frame exposed at exposed_s whose pose was known at known_s."""
        self._delays.append(known_s - exposed_s)
        self.delay_s = float(np.median(self._delays))
        if self._last_s is not None:
            self._periods.append(exposed_s - self._last_s)
            self.period_s = float(np.median(self._periods))
        self._last_s = exposed_s


class ArmLag:
    """How long the arm takes to be where it was told to be.

    While a joint is told to move at speed v it is v times the lag behind; the lag is their regression, with an
    assumed one as its beginning.
    """

    def __init__(self, assumed_s: float, cycle_s: float) -> None:
        self._cycle_s = cycle_s
        self._vv = PRIOR_RAD**2 / cycle_s  # a way of PRIOR_RAD in one second is that sum over its cycles
        self._ve = self._vv * assumed_s
        self.lag_s = assumed_s

    def add(self, now_s: float, q_s: float, q: Array, q_sent: Array, qd_sent: Array) -> None:
        """Take a reading q (n,) of q_s beside q_sent (n,), told for the cycle before now_s, at the speed qd_sent."""
        told = q_sent + qd_sent * (q_s - (now_s - self._cycle_s))  # where it was told to be at q_s
        self._vv += float(qd_sent @ qd_sent)
        self._ve += float(qd_sent @ (told - q))
        self.lag_s = min(max(self._ve / self._vv, LEAST_S), MOST_S)
