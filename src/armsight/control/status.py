"""The state of a robot and of the loop that moves it: one record for screens, clients, pages and logs."""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from armsight.control.guard import GuardState
from armsight.drivers import RobotState
from armsight.records import JointReading

HOW_LONG = re.compile(r",? (?:for|last seen) (?:more than )?[\d.e+-]+ m?s\b.*")
"""What differs from cycle to cycle of one reason."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RobotStatus:
    """A robot and its loop in the newest cycle; replaced as one, so that any thread may read it.

    t_s: when it was so, on the loop's clock. cycle: the cycle's number. robot: what its link says. guard: the guard's
    state, and why it does not run, in words. limited: the limits that cut the set point. source: who asks for motion.
    reading: the newest, its time on the same clock; None before the first. q_sent (n,): where the robot was last told
    to go, in rad or m. at_rest: nothing moves any more by command. finished: the source has nothing more to ask.
    enabled: whether the enable was alive. late, missed: cycles that began late, that were left out.

    Where others ask the loop for motion, their side adds what the loop does not know. dropped: how often what was asked
    was forgotten, because it held, stopped or was told to. driver: who drives, empty for nobody, and for how long.
    lateness_p99_s: 99 % of the cycles began at most so late.
    """

    t_s: float
    cycle: int
    robot: RobotState
    guard: GuardState
    why: str = ""
    limited: tuple[str, ...] = ()
    source: str = ""
    reading: JointReading | None
    q_sent: NDArray[np.float64]
    at_rest: bool = True
    finished: bool = False
    enabled: bool = False
    late: int = 0
    missed: int = 0
    dropped: int = 0
    driver: str = ""
    driver_s: float = 0.0
    lateness_p99_s: float = 0.0

    @property
    def q(self) -> NDArray[np.float64]:
        """Where the robot is by its newest reading (n,), in rad or m; where it was told to go before the first."""
        return self.q_sent if self.reading is None else self.reading.q

    @property
    def reason(self) -> str:
        """Why it does not run, without for how long: the same in each cycle."""
        return HOW_LONG.sub("", self.why)
