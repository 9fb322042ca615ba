"""How punctual a loop is: lateness of its wake-ups and its periods, measured in fixed memory."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

KEPT = 65_536
"""Newest cycles that the figures are of: four minutes at 4 ms. Counts and the largest are of all."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Timing:
    """n_cycles done; late: begun later than the share of a cycle that counts as late; missed: cycles never begun.

    lateness and period: median, 99th percentile and maximum, in s; busy: of the time from wake-up to command sent.
    """

    n_cycles: int
    late: int
    missed: int
    lateness_s: tuple[float, float, float]
    period_s: tuple[float, float, float]
    busy_s: tuple[float, float, float]


class Jitter:
    """Collects the times of a loop's cycles; for the loop's own thread."""

    def __init__(self, late_s: float) -> None:
        self._late_s = late_s
        self._values = np.zeros((3, KEPT))
        self._most = [0.0, 0.0, 0.0]
        self.n_cycles = self.late = self.missed = 0
        self._woke_s: float | None = None

    def cycle(self, woke_s: float, late_s: float, done_s: float, missed: int) -> None:
        """Note a cycle: when it woke and by how much too late, when its command was sent, cycles missed before it."""
        period_s = np.nan if self._woke_s is None else woke_s - self._woke_s
        self._woke_s = woke_s
        at = self.n_cycles % KEPT
        for row, value in enumerate((late_s, period_s, done_s - woke_s)):
            self._values[row, at] = value
            self._most[row] = max(self._most[row], value) if value == value else self._most[row]
        self.n_cycles += 1
        self.late += late_s > self._late_s
        self.missed += missed

    def timing(self) -> Timing:
        """Return the figures so far."""
        rows = self._values[:, : min(self.n_cycles, KEPT)]
        lateness, period, busy = (
            _figures(row[np.isfinite(row)], most) for row, most in zip(rows, self._most, strict=True)
        )
        return Timing(
            n_cycles=self.n_cycles,
            late=self.late,
            missed=self.missed,
            lateness_s=lateness,
            period_s=period,
            busy_s=busy,
        )


def _figures(values: NDArray[np.float64], most: float) -> tuple[float, float, float]:
    if not len(values):
        return 0.0, 0.0, most
    return float(np.median(values)), float(np.percentile(values, 99.0)), most
