"""Injectable time, so that loops, watchdogs and playback can be tested fast and exactly."""

from __future__ import annotations

import time
from typing import Protocol


class Clock(Protocol):
    """Monotonic time in seconds and a way to wait for a moment of it."""

    def now_s(self) -> float:
        """Return seconds since an arbitrary origin; never runs backwards."""
        ...

    def sleep_until(self, t_s: float) -> None:
        """Return at t_s, or at once where that has passed."""
        ...


class SystemClock:
    """The machine's monotonic clock; waits by sleeping, then spinning over the last stretch."""

    SPIN_S = 300e-6  # a sleep wakes up to 1.1 ms late, a spin of 0.3 ms at the end is 0.2 us late at p99

    def now_s(self) -> float:
        """Return the monotonic time in seconds."""
        return time.monotonic()

    def sleep_until(self, t_s: float) -> None:
        """Sleep to SPIN_S before t_s, spin over the rest."""
        rest = t_s - time.monotonic() - self.SPIN_S
        if rest > 0.0:
            time.sleep(rest)
        while time.monotonic() < t_s:
            pass


class ManualClock:
    """A clock that moves only when told, for tests and simulation."""

    def __init__(self, t_s: float = 0.0) -> None:
        self._t_s = t_s

    def now_s(self) -> float:
        """Return the time it was last set to, in seconds."""
        return self._t_s

    def sleep_until(self, t_s: float) -> None:
        """Jump to t_s where that lies ahead."""
        self._t_s = max(self._t_s, t_s)

    def advance(self, dt_s: float) -> None:
        """Let dt_s >= 0 seconds pass."""
        if dt_s < 0.0:
            raise ValueError(f"a clock cannot run backwards by {-dt_s} s")
        self._t_s += dt_s
