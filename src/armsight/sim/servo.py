"""The motors behind the joints: commands taken once a cycle, lag, speed limits, and what they did, at any time."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from armsight.errors import Inconsistent

Array = NDArray[np.float64]

HAIR = 1e-6
"""Share of a step that is rounding."""

GRID_S = 0.004
"""Longest step of the motion's record: at 10 rad/s^2 a straight line in between is 20 urad off at most."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Drive:
    """How the joints follow their commands.

    cycle_s: between two commands that the controller takes. lag_s: time constant of the way to the command. max_speed
    (n,): rad/s or m/s. encoder_step (n,): what a reading is a multiple of, in rad or m.
    """

    cycle_s: float
    lag_s: float
    max_speed: Array
    encoder_step: Array

    def __post_init__(self) -> None:
        if not (self.cycle_s > 0.0 and self.lag_s >= 0.0):
            raise Inconsistent(f"a drive of cycle {self.cycle_s} s and lag {self.lag_s} s cannot be")
        if not ((self.max_speed > 0.0).all() and (self.encoder_step >= 0.0).all()):
            raise Inconsistent("speed limits must be positive and encoder steps not negative")


class Servo:
    """Joints under way. Time only runs forward; `advance` first, then ask for any moment up to then."""

    def __init__(self, drive: Drive, q: ArrayLike, t_s: float = 0.0, *, keep: int | None = None) -> None:
        """Rest at q (n,) from t_s on; keep: how many steps of the past to remember at least, None for all."""
        self.drive = drive
        self._keep = keep
        self._dt_s = drive.cycle_s / max(1, math.ceil(drive.cycle_s / GRID_S))
        self._start_s = t_s
        self._q = [np.array(q, dtype=float)]
        self._goal = self._q[0].copy()
        self._queue: deque[tuple[float, Array]] = deque()

    @property
    def t_s(self) -> float:
        """The moment up to which the motion is known."""
        return self._start_s + (len(self._q) - 1) * self._dt_s

    @property
    def goal(self) -> Array:
        """The last command (n,), taken or not yet."""
        return (self._queue[-1][1] if self._queue else self._goal).copy()

    def command(self, t_s: float, q: Array) -> None:
        """Have the joints go to q (n,) from time t_s on; commands come in the order of time."""
        self._queue.append((t_s, np.array(q, dtype=float)))

    def halt(self) -> None:
        """Forget all commands and stay where the joints are."""
        self._queue.clear()
        self._goal = self._q[-1].copy()

    def advance(self, t_s: float) -> None:
        """Let the joints move until t_s is covered."""
        decay = math.exp(-self._dt_s / self.drive.lag_s) if self.drive.lag_s > 0.0 else 0.0
        longest = self.drive.max_speed * self._dt_s
        while t_s - self.t_s > HAIR * self._dt_s:  # rounding of long sums must not make two steps of one
            while self._queue and self._queue[0][0] <= self.t_s + 1e-9:
                self._goal = self._queue.popleft()[1]
            rest = self._goal - self._q[-1]
            self._q.append(self._q[-1] + np.clip((1.0 - decay) * rest, -longest, longest))
        if self._keep is not None and len(self._q) > 2 * self._keep:
            forgotten = len(self._q) - self._keep
            self._start_s += forgotten * self._dt_s
            del self._q[:forgotten]

    def at(self, t_s: ArrayLike) -> Array:
        """Return the true joint values (m, n) at times (m,) up to the moment known; before the start they rest."""
        place = np.clip((np.atleast_1d(t_s) - self._start_s) / self._dt_s, 0.0, len(self._q) - 1.0)
        low = np.minimum(place.astype(int), max(len(self._q) - 2, 0))
        share = (place - low)[:, None]
        first = np.array([self._q[i] for i in low])
        second = np.array([self._q[min(i + 1, len(self._q) - 1)] for i in low])
        return np.asarray(first + share * (second - first))

    def read(self, t_s: ArrayLike) -> Array:
        """Return the encoders' readings (m, n) at times (m,)."""
        step = self.drive.encoder_step
        q = self.at(t_s)
        return np.where(step > 0.0, np.round(q / np.where(step > 0.0, step, 1.0)) * step, q)
