"""The operator's enable: motion goes on only while somebody keeps saying so."""

from __future__ import annotations

import math

from armsight.clock import Clock

TIMEOUT_S = 0.25
"""An enable that nobody renewed for so long is gone: some key repeats, or a client's heartbeats, one of them lost."""


class Enable:
    """A deadman: keep() renews it, release() ends it at once. Any thread may call each of them at any time."""

    def __init__(self, clock: Clock, timeout_s: float = TIMEOUT_S) -> None:
        self._clock = clock
        self._timeout_s = timeout_s
        self._until_s = -math.inf

    def keep(self) -> None:
        """Say that the operator is there."""
        self._until_s = self._clock.now_s() + self._timeout_s

    def release(self) -> None:
        """Say that the operator let go."""
        self._until_s = -math.inf

    def alive(self) -> bool:
        """Tell whether it was renewed within its time."""
        return self._clock.now_s() <= self._until_s
