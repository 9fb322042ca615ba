"""The times of a link, how far its controller is, what its own clock tells, and which readings can be."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from typing import Protocol, TypeAlias, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from armsight.arrays import Array
from armsight.records import JointReading
from armsight.units import MS


@dataclass(slots=True)
class LinkCounts:
    """Packets or frames since the link was opened.

    heard: good ones. missed: cycles whose one never came. repeated: with a number that was there, or an older one.
    refused: with values that cannot be. late: answers that the controller tells it did not take, or took late.
    foreign: packets of another sender. garbage_bytes: of a line, that belong to no frame.
    """

    heard: int = 0
    missed: int = 0
    repeated: int = 0
    refused: int = 0
    late: int = 0
    foreign: int = 0
    garbage_bytes: int = 0


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

    def slow_down(self, max_speed: Array) -> None:
        """Let no joint go faster than max_speed (n,) in rad/s or m/s, whoever asks."""


LARGEST_RAD = 100.0
"""No joint of a robot turns 16 times: a larger value is not a reading."""

LARGEST_M = 100.0
"""No flange is so far from its base."""

LARGEST_SPEED_RAD_S = 60.0
"""No joint of a robot moves so fast: a reading that says so is refused."""

JUMP_CYCLES = 3
"""Over so many missed cycles a joint may have moved; an arm that is elsewhere after more is refused until the link is
lost: the old goal must not pull it back."""


def possible(q: NDArray[np.float64], last: NDArray[np.float64], cycles: int, cycle_s: float) -> bool:
    """Tell whether joints can be where they are read, q (n,), so many cycles after the reading last (n,)."""
    return bool(np.abs(q - last).max() <= LARGEST_SPEED_RAD_S * min(cycles, JUMP_CYCLES) * cycle_s)


ENOUGH = 10
SEEN = 36
"""So many packets tell a cycle; it is watched over so many. Where every second one is lost, two pairs of neighbours are
among ten in 98 of 100 cases, and the next packets tell."""

TOLERANCE = 0.15
"""Share by which a cycle may be off: a computer that reads 28 ms states up to 40 ms late shows less than a tenth."""

JUMP_S = 0.1
"""A packet that was sent so much after it came shows a clock that jumped."""

DRIFT = 1e-3
"""Clocks drift apart by less than this share; quartz by a twentieth of that."""

CREDIT = 2.0
"""Steps that may come together where packets were late: those of the cycles that they were late by, no more."""

NEARLY = 0.9
"""A step is allowed where so much of a cycle has passed; stamps in whole ms are rounded."""


Heard: TypeAlias = Callable[[float, Array], object]
"""Is told of a reading: when it was sent, on this computer's clock, and its joints (n,)."""


class ControllerClock:
    """What is known of a controller's time from the stamps of its packets. numbered: packets tell their cycle's number.

    Without numbers the smallest steps between stamps are a cycle, with them all steps are averaged. own: the stamps are
    of this computer's clock, where the controller tells none.
    """

    def __init__(self, cycle_s: float, *, numbered: bool, own: bool = False) -> None:
        self._cycle_s, self._numbered, self._own = cycle_s, numbered, own
        self.heard: Heard | None = None
        self.start()

    def start(self) -> None:
        """Begin anew."""
        self._packets: deque[tuple[float, int]] = deque(maxlen=SEEN)
        self._least_s: float | None = None
        self._credit = 1.0

    @property
    def measured_s(self) -> float | None:
        """The cycle that it keeps; None where too few packets have come."""
        if len(self._packets) < ENOUGH:
            return None
        if self._numbered:
            (first_s, first), (last_s, last) = self._packets[0], self._packets[-1]
            mean_s = (last_s - first_s) / max(last - first, 1)
            return self._nearer(mean_s) if self._own else mean_s
        # the second: one stamp that is off makes no cycle
        return sorted(after - before for (before, _), (after, _) in pairwise(self._packets))[1]

    def _nearer(self, mean_s: float) -> float:
        """Return the mean or the median step, whichever is nearer to the cycle: a wrong one shows in both.

        A computer that stood still reads what had piled up at once, which shortens the mean; one that reads late now
        and then spoils the median.
        """
        steps = sorted((t1 - t0) / max(n1 - n0, 1) for (t0, n0), (t1, n1) in pairwise(self._packets))
        return min(mean_s, steps[len(steps) // 2], key=lambda step_s: abs(step_s - self._cycle_s))

    @property
    def wrong(self) -> str:
        """What is wrong with its cycle, in words; empty where nothing is, or too few packets have come to tell."""
        cycle_s = self.measured_s
        if cycle_s is None or abs(cycle_s / self._cycle_s - 1.0) <= TOLERANCE:
            return ""
        return f"its controller sends every {cycle_s / MS:.3g} ms, and this link is set to {self._cycle_s / MS:.3g} ms"

    @property
    def cure(self) -> str:
        """What to do where its cycle is wrong."""
        return f"Set cycle_s to {self.measured_s or self._cycle_s:.3g}, or the controller to what is set here"

    @property
    def sure(self) -> bool:
        """Whether what is wrong with the cycle is no chance of few packets."""
        return len(self._packets) == SEEN

    def hear(self, stamp_s: float, number: int, now_s: float, reading: JointReading | None = None) -> str:
        """Take a packet's stamp in s and number, come at now_s; return how its clock jumped, empty where it did not.

        Its reading is told to `heard` as of when it was sent: by its stamp, and by how much this computer's clock is
        ahead of the stamps of packets that came soonest. What a network or a busy computer held back is not late.
        """
        jump = ""
        if self._packets:
            last_s, last_number = self._packets[-1]
            passed_s = stamp_s - last_s
            self._credit = min(CREDIT, self._credit + passed_s / self._cycle_s)
            jump = self._jumped(passed_s, number - last_number, now_s - stamp_s)
        if jump:
            self._packets.clear()
            self._least_s = None
        else:
            age_s = now_s - stamp_s
            leak_s = DRIFT * (passed_s if self._packets else 0.0)
            self._least_s = age_s if self._least_s is None else min(self._least_s + leak_s, age_s)
        self._packets.append((stamp_s, number))
        if self.heard is not None and reading is not None and self._least_s is not None:
            self.heard(stamp_s + self._least_s, reading.q)
        return jump

    def take_step(self) -> bool:
        """Tell whether its time allows one more step, and count that."""
        if self._credit < NEARLY:
            return False
        self._credit -= 1.0
        return True

    def _jumped(self, passed_s: float, cycles: int, age_s: float) -> str:
        if self._own:
            return ""
        off_s = 0.0
        if self._numbered:
            off_s = passed_s - cycles * self._cycle_s * (
                1.0 if not self.measured_s else self.measured_s / self._cycle_s
            )
        if self._least_s is not None and age_s < self._least_s - JUMP_S:
            off_s = max(off_s, self._least_s - age_s)
        if abs(off_s) <= JUMP_S and passed_s > 0.0:
            return ""
        return f"its controller's clock jumped by {off_s:+.3f} s"
