"""Clocks of tests: one that a test moves while a loop in another thread waits for it, one that stops a thread."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

from armsight.clock import Clock

PAUSE_S = 1e-4
PATIENCE_S = 10.0


class GatedClock:
    """Time stands still until advance() lets it pass; whoever sleeps in another thread then runs as far as it reaches.

    One thread sleeps, one advances. advance returns when the sleeper waits for a later moment, so that what it did is
    the same in every run.
    """

    def __init__(self, t_s: float = 0.0) -> None:
        self._t_s = self._end_s = t_s
        self._wanted_s: float | None = None
        self._news = threading.Condition()
        self._left = False

    def now_s(self) -> float:
        """Return the time in s."""
        return self._t_s

    def sleep_until(self, t_s: float) -> None:
        """Wait until advance has let the time come; returns at once where it has passed, or after leave()."""
        if t_s <= self._t_s:
            return
        with self._news:
            self._wanted_s = t_s
            self._news.notify_all()
            self._news.wait_for(lambda: self._end_s >= t_s or self._left)
            self._wanted_s = None
            self._t_s = max(self._t_s, t_s)

    def advance(self, dt_s: float) -> None:
        """Let dt_s >= 0 pass, and wait until the sleeper waits for what comes later."""
        if dt_s < 0.0:
            raise ValueError(f"a clock cannot run backwards by {-dt_s} s")
        with self._news:
            end_s = self._end_s = max(self._end_s, self._t_s) + dt_s
            self._news.notify_all()
            self._news.wait_for(lambda: self._left or (self._wanted_s is not None and self._wanted_s > end_s))
            self._t_s = max(self._t_s, end_s)

    def leave(self) -> None:
        """Let the sleeper go, and nobody wait any more: the end of the test, or of the sleeper."""
        with self._news:
            self._left = True
            self._news.notify_all()


class HaltingClock:
    """A clock on which a thread stands still from when it next asks for the time: as one that the system stopped."""

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._thread = ""
        self._asked = self._stands = 0
        self._may_go = threading.Event()
        self._may_go.set()

    def now_s(self) -> float:
        """Return the time in s; to a thread that stands still, once it goes on."""
        if threading.current_thread().name == self._thread:
            self._asked += 1
            self._stands += not self._may_go.is_set()
            self._may_go.wait()
        return self._clock.now_s()

    def sleep_until(self, t_s: float) -> None:
        """Wait as the clock does."""
        self._clock.sleep_until(t_s)

    def halt(self, thread: str) -> None:
        """Let the thread of this name stand still; returns when it does."""
        self._thread, self._stands = thread, 0
        self._may_go.clear()
        self._until(lambda: self._stands > 0)

    def go_on(self) -> None:
        """Let it go on; returns when it has asked for the time again, so that it knows how late it is."""
        asked = self._asked
        self._may_go.set()
        self._until(lambda: self._asked > asked)
        self._thread = ""

    def _until(self, holds: Callable[[], bool]) -> None:
        end_s = time.monotonic() + PATIENCE_S
        while not holds():
            if time.monotonic() > end_s:
                raise AssertionError(f"the thread {self._thread} does not ask for the time")
            time.sleep(PAUSE_S)
