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


STALL_S = 0.09
"""A thread between two of whose turns so much time passes has stood still. A busy computer keeps a control loop waiting
for 38 ms at most (docs/benchmarks.md), and a stand-still of 0.1 s is always found."""

STALL_CYCLES = 3.0
"""... or so many of its cycles, where those are longer."""


def monotonic_s() -> float:
    """Return seconds since an arbitrary origin, the same for all processes; time in which the machine slept counts.

    Steps of the system's clock change nothing. Where the system has no such clock sleep does not count.
    """
    return time.clock_gettime(time.CLOCK_BOOTTIME) if hasattr(time, "CLOCK_BOOTTIME") else time.monotonic()


class StandStill:
    """Tells how long its owner stood still: stopped, starved or asleep with the machine, by the gap between its turns.

    What was asked and enabled before a stand-still counts no more after it, whoever finds it.
    """

    def __init__(self, cycle_s: float, stall_s: float = STALL_S) -> None:
        """cycle_s: how often its owner has a turn. stall_s: the longest gap, where three cycles are not longer."""
        self._longest_s = max(stall_s, STALL_CYCLES * cycle_s)
        self.turn_s: float | None = None
        """When its last turn began."""

    def begin(self) -> None:
        """Forget the last turn: the next one is the first."""
        self.turn_s = None

    def turn(self, now_s: float) -> float:
        """Note a turn at now_s; return for how long its owner stood still before it, in s, 0 where it did not."""
        stood_s, self.turn_s = self.since(now_s), now_s
        return stood_s

    def since(self, now_s: float) -> float:
        """Return for how long its owner stood still since its last turn, in s, 0 where it did not; no turn is noted."""
        gap_s = 0.0 if self.turn_s is None else now_s - self.turn_s
        return gap_s if gap_s > self._longest_s else 0.0


class SystemClock:
    """The machine's monotonic clock; waits by sleeping, then spinning over the last stretch."""

    SPIN_S = 300e-6  # a sleep wakes up to 1.1 ms late, a spin of 0.3 ms at the end is 0.2 us late at p99

    def now_s(self) -> float:
        """Return monotonic_s()."""
        return monotonic_s()

    def sleep_until(self, t_s: float) -> None:
        """Sleep to SPIN_S before t_s, spin over the rest."""
        rest = t_s - monotonic_s() - self.SPIN_S
        if rest > 0.0:
            time.sleep(rest)
        while monotonic_s() < t_s:
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
