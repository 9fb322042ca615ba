"""The delays of a servo, measured while it runs: of the cameras, and of the arm behind its commands."""

from __future__ import annotations

from collections import deque
from statistics import median

import numpy as np

from armsight.arrays import Array

FRAMES = 100
"""Frames of which the delay is the median."""
WINDOW_S, EVERY_S = 3.0, 0.5
"""The arm's lag is found from the newest motion of so long, and so often."""
ROWS = 150
"""Commands and readings of the window that are looked at, at most."""
LAGS_S = np.linspace(0.0, 0.4, 41)
"""Lags that are tried; the best is refined between its neighbours."""
LEAST_WAY = 0.02
"""Way of all joints (rad or m, root of their squares) below which a motion tells no lag: 400 steps of an encoder."""


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
        self.delay_s = median(self._delays)
        if self._last_s is not None:
            self._periods.append(exposed_s - self._last_s)
            self.period_s = median(self._periods)
        self._last_s = exposed_s


class ArmLag:
    """How long the arm takes to be where it was told to be: the shift in time that fits readings to commands best.

    The control loop adds; the thread of the cameras estimates, so that no cycle waits for it.
    """

    def __init__(self, assumed_s: float, cycle_s: float) -> None:
        """assumed_s: the lag until motion tells it."""
        self.lag_s = assumed_s
        self._cycle_s = cycle_s
        self._rows: deque[tuple[float, Array, float, Array]] = deque(maxlen=int(WINDOW_S / cycle_s) + 2)
        self._next_s = -np.inf

    def add(self, now_s: float, q_s: float, q: Array, q_sent: Array) -> None:
        """Take a reading q (n,) of q_s beside q_sent (n,), which was told in the cycle before now_s."""
        self._rows.append((now_s - self._cycle_s, q_sent, q_s, q))

    def estimate(self, now_s: float) -> None:
        """Find the lag anew where it is time to and the arm moved enough to tell it."""
        if now_s < self._next_s or len(self._rows) < 0.5 * WINDOW_S / self._cycle_s:
            return
        self._next_s = now_s + EVERY_S
        rows = list(self._rows)
        rows = rows[:: -(-len(rows) // ROWS)]
        sent_s, q_s = np.array([row[0] for row in rows]), np.array([row[2] for row in rows])
        q_sent, q = np.array([row[1] for row in rows]), np.array([row[3] for row in rows])
        if np.linalg.norm(np.ptp(q_sent, axis=0)) < LEAST_WAY:
            return
        late = q_s > sent_s[0] + LAGS_S[-1]  # where every lag that is tried falls within what was sent
        misfit = _misfits(sent_s, q_sent, q_s[late], q[late])
        best = int(np.argmin(misfit))
        if 0 < best < len(LAGS_S) - 1:
            a, b, c = misfit[best - 1 : best + 2]
            self.lag_s = float(LAGS_S[best] + 0.5 * (a - c) / (a - 2.0 * b + c) * (LAGS_S[1] - LAGS_S[0]))


def _misfits(sent_s: Array, q_sent: Array, q_s: Array, q: Array) -> Array:
    """Return for each of LAGS_S the sum of squares of readings minus what was sent so long before."""
    t = q_s - LAGS_S[:, None]
    k = np.clip(np.searchsorted(sent_s, t) - 1, 0, len(sent_s) - 2)
    share = ((t - sent_s[k]) / (sent_s[k + 1] - sent_s[k]))[:, :, None]
    return np.asarray(np.square(q_sent[k] + share * (q_sent[k + 1] - q_sent[k]) - q).sum(axis=(1, 2)))
