"""The times of a link, and how far its controller is."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

from armsight.arrays import Array


@dataclass(frozen=True, slots=True, kw_only=True)
class LinkTimes:
    """Times of a link, in s: its cycle; after what time a reading is stale; after what silence the link is lost.

    The last is the time after which the controller's own watchdog ends the motion: until then it may be late.
    """

    cycle_s: float
    stale_s: float
    silent_s: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Pace:
    """How far a controller is.

    steps: so many it was given, one a cycle at most. asked: how many those were when the last command came; it is among
    the next. cycles: of its own until the newest, those that were missed among them. t_s: when the newest was answered.
    """

    steps: int
    asked: int
    cycles: int
    t_s: float


@runtime_checkable
class Paced(Protocol):
    """A robot whose controller sets the pace: whoever moves it waits for each step to go out before the next."""

    def wait_step(self, after: int, wait_s: float) -> Pace:
        """Return the pace once more than `after` steps and the last command went out, or what it is after wait_s."""
        ...

    def slow_down(self, max_speed: Array) -> None:
        """Let no joint go faster than max_speed (n,) in rad/s or m/s, whoever asks."""
        ...
