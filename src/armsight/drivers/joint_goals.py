"""Where a controller is told to go next: steps of many calls, cut to what one of its cycles allows."""

from __future__ import annotations

import threading
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from armsight.errors import Inconsistent, UsageError
from armsight.records import frozen_array

Array = NDArray[np.float64]

LEAD_S = 0.5
"""Time at full speed by which a goal may be ahead of the arm: where the arm is held up, it must not leap when freed."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class JointLimits:
    """Range of the joint values, lower and upper (n,) in rad or m, and their largest speed (n,) in rad/s or m/s."""

    lower: Array
    upper: Array
    max_speed: Array

    def __post_init__(self) -> None:
        object.__setattr__(self, "max_speed", frozen_array("max_speed", self.max_speed, (None,)))
        n = self.max_speed.shape
        lower, upper = (np.array(v, dtype=float) for v in (self.lower, self.upper))
        if lower.shape != n or upper.shape != n:
            raise UsageError(f"limits of {lower.shape}, {upper.shape} and {n} joints do not belong together")
        if not ((lower < upper).all() and (self.max_speed > 0.0).all()):
            raise UsageError(
                "a joint's range is empty or its speed not positive", cure="Give lower < upper and a speed above 0"
            )
        for name, values in (("lower", lower), ("upper", upper)):
            values.setflags(write=False)
            object.__setattr__(self, name, values)


class JointGoals:
    """The goal of one arm, safe between the thread that asks and the thread that sends.

    Commands of one cycle change the goal of that cycle and never add up beyond its way; a cycle ends when `take` hands
    the goal to the wire. A goal that the controller may not have taken goes out again: no two steps reach it as one.
    """

    def __init__(self, name: str, limits: JointLimits, cycle_s: float) -> None:
        self._name = name
        self._limits = limits
        self._cycle_s = cycle_s
        self._longest = limits.max_speed * cycle_s
        self._lead = limits.max_speed * max(LEAD_S, 2.0 * cycle_s)
        self._lock = threading.Lock()
        self._sent = np.zeros(len(limits.max_speed))
        self._next = self._sent

    @property
    def n(self) -> int:
        """How many joints."""
        return len(self._longest)

    @property
    def sent(self) -> Array:
        """Where the controller was last told to go, (n,)."""
        return self._sent

    def slow_down(self, max_speed: Array) -> None:
        """Allow no more than max_speed (n,) in rad/s or m/s, where that is less than the limits say."""
        with self._lock:
            self._longest = np.minimum(self._limits.max_speed, max_speed) * self._cycle_s

    def start(self, q: Array) -> None:
        """Begin at q (n,), with nothing asked."""
        with self._lock:
            self._sent = self._next = np.array(q, dtype=float)

    def hold(self) -> None:
        """Forget what was asked and not yet sent."""
        with self._lock:
            self._next = self._sent

    def take(self) -> Array:
        """Return what goes on the wire now, (n,)."""
        with self._lock:
            self._sent = self._next
            return self._sent

    def step(self, step: Array, q: Array) -> tuple[Array, tuple[str, ...]]:
        """Move the goal on by step (n,) as far as this cycle allows; return the goal and what cut it, in words.

        q (n,): where the arm is by its newest reading. Raises UsageError for another number of joints, Inconsistent
        for values that are not finite.
        """
        values = np.asarray(step, dtype=float)
        if values.shape != (self.n,):
            raise UsageError(
                f"{self._name} has {self.n} joints, but the step has shape {values.shape}",
                consequence="Nothing was sent",
                cure=f"Give {self.n} values",
            )
        if not np.isfinite(values).all():
            raise Inconsistent(f"{self._name}: a step is not finite", consequence="Nothing was sent")
        with self._lock:
            way = self._next + values - self._sent
            # all joints alike, so that the direction of the motion stays
            share = float(np.min(self._longest / np.maximum(np.abs(way), 1e-300), initial=1.0))
            words = [
                f"speed of joint {i}" for i in range(1, self.n + 1) if abs(way[i - 1]) > self._longest[i - 1] * 1.000001
            ]
            goal = self._sent + share * way
            # a limit never moves the arm by itself: where it stands beyond one, it may only stay or come back
            low = np.minimum(self._limits.lower, self._sent)
            high = np.maximum(self._limits.upper, self._sent)
            held = np.clip(goal, low, high)
            words += [f"range of joint {i}" for i in (np.flatnonzero(held != goal) + 1)]
            goal, ahead = held, np.abs(held - q) > self._lead
            back = np.abs(goal - q) < np.abs(self._sent - q)
            goal = np.where(ahead & ~back, self._sent, goal)
            words += [f"lag of joint {i}" for i in (np.flatnonzero(ahead & ~back) + 1)]
            self._next = goal
            return goal, tuple(words)
