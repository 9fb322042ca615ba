"""How long a pair may take, and on how many cores: what a caller with a live rate says, and a batch does not.

A deadline is kept by counted work, not by a clock: a picture gives the same answer whatever else the machine does. What
does not fit is refused, never answered from the part that was looked at: the rest may hold as good an answer.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol, TypeVar

from armsight.errors import UsageError

T = TypeVar("T")

LIVE_S = 0.1
"""Deadline of a picture before which somebody waits."""


class Both(Protocol):
    """Does a piece of work for both sides, 0 and 1, and returns what comes of them."""

    def __call__(self, work: Callable[[int], T], /) -> tuple[T, T]:
        """Return (work(0), work(1))."""


def in_turn(work: Callable[[int], T]) -> tuple[T, T]:
    """Do it for one side after the other."""
    return work(0), work(1)


@dataclass(frozen=True, slots=True, kw_only=True)
class Pace:
    """deadline_s: for a pair, on a machine like that of the benchmarks; None: as long as it takes. both: side by side
    on two cores where the caller has them."""

    deadline_s: float | None = None
    both: Both = in_turn

    def __post_init__(self) -> None:
        if self.deadline_s is not None and not self.deadline_s > 0.0:
            raise UsageError(f"a deadline of {self.deadline_s:g} s is not positive", cure="Give seconds, or none")

    @property
    def live(self) -> bool:
        """Whether somebody waits: what cannot be looked at in time is refused."""
        return self.deadline_s is not None

    def most(self, whole: int, each_s: float, share: float) -> int:
        """Return how many pieces of work of each_s fit into a share of the deadline; `whole` where there is none."""
        return whole if self.deadline_s is None else min(whole, int(share * self.deadline_s / each_s))


BATCH = Pace()
