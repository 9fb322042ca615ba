"""What a robot's loop did, cycle by cycle, and when it is to end."""

from __future__ import annotations

from collections.abc import Callable

from armsight.control.guard import GuardState
from armsight.control.status import RobotStatus

STUCK_S = 5.0
"""A motion that the guard has held for so long, though the operator's enable was there, is given up."""


class CycleTally:
    """Counts cycles as the loop does them; given to it as what may end it."""

    def __init__(self, cancelled: Callable[[], bool]) -> None:
        self.cycles = 0
        self.holds: list[str] = []
        self.last: RobotStatus | None = None
        self.began_s: float | None = None
        self._cancelled = cancelled
        self._held_s: float | None = None

    def __call__(self, status: RobotStatus) -> bool:
        """Take a cycle; tell whether it was the last: at the end, let go of, stopped, or held for too long."""
        self.last = status
        self.cycles += 1
        self.began_s = status.t_s if self.began_s is None else self.began_s
        if status.why and status.reason not in self.holds:
            self.holds.append(status.reason)
        if status.guard is not GuardState.HOLDING:
            self._held_s = None
        elif self._held_s is None:
            self._held_s = status.t_s
        stuck = self._held_s is not None and status.t_s - self._held_s > STUCK_S
        return status.finished or self._cancelled() or status.guard is GuardState.STOPPED or stuck

    @property
    def took_s(self) -> float:
        """Time since the first cycle."""
        return 0.0 if self.last is None or self.began_s is None else self.last.t_s - self.began_s

    def stopped_by(self, *, finished: bool) -> str:
        """Return why the loop ended."""
        if finished:
            return "end"
        if self._cancelled():
            return "operator"
        return "" if self.last is None else self.last.why or (self.holds[-1] if self.holds else "")
