"""Joint motion within limits of speed, acceleration and jerk, and how it comes to rest: ruckig's trajectories.

Ruckig (Berscheid and Kröger, Jerk-limited Real-time Trajectory Generation with Arbitrary Target States, RSS 2021) gives
the time-optimal motion from any state in about a microsecond; docs/decisions tells why it was chosen.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from ruckig import ControlInterface, InputParameter, Result, Ruckig, RuckigError, Synchronization, Trajectory

from armsight.arrays import Array

REST_SPEED = 1e-9
"""Joints slower than this (rad/s or m/s) are at rest: rounding."""

LEAST = 1e-6
"""Ruckig takes no speed limit of zero; a joint that has no way to go may move so slowly (rad/s or m/s)."""

SLACK = 1e-9
"""Share by which a target's speed stays below the limit, so that rounding is no error."""


@dataclass(frozen=True, slots=True, eq=False)
class State:
    """Where the joints were last told to go, q, at which velocity qd and acceleration qdd, each (n,)."""

    q: Array
    qd: Array
    qdd: Array

    @classmethod
    def rest(cls, q: Array) -> State:
        """Return rest at q (n,)."""
        return cls(np.array(q, dtype=float), np.zeros(len(q)), np.zeros(len(q)))

    @property
    def at_rest(self) -> bool:
        """Whether nothing moves."""
        return not (np.abs(self.qd).max() > REST_SPEED or np.abs(self.qdd).max() > REST_SPEED)


@dataclass(frozen=True, slots=True, eq=False)
class Ceiling:
    """What the joints may do in this cycle: speed, acceleration, jerk, each (n,) and positive."""

    speed: Array
    acceleration: Array
    jerk: Array


class Course:
    """A motion of the joints over time; time 0 is the state that it was planned from."""

    def __init__(self, trajectory: Trajectory) -> None:
        self._trajectory = trajectory
        self.duration_s = float(trajectory.duration)

    def at(self, t_s: float) -> State:
        """Return the state at a time; past the end it goes on at its last velocity, a rest stays."""
        q, qd, qdd = self._trajectory.at_time(t_s)
        return State(np.array(q), np.array(qd), np.array(qdd))

    def sampled(self, times_s: list[float]) -> tuple[Array, Array, Array]:
        """Return q, qd, qdd, each (m, n), at times (m,)."""
        at = self._trajectory.at_time
        rows = np.array([at(t) for t in times_s])  # (m, 3, n)
        return rows[:, 0], rows[:, 1], rows[:, 2]


class Planner:
    """Plans courses of n joints; one per guard, for one thread."""

    def __init__(self, n: int, cycle_s: float) -> None:
        self._n = n
        self._ruckig = Ruckig(n, cycle_s)
        self._zeros = [0.0] * n

    def to_velocity(self, state: State, qd: Array, ceiling: Ceiling) -> Course | None:
        """Return the fastest course to joint velocities qd (n,); None where there is none."""
        wanted = self._input(state, ceiling)
        wanted.control_interface = ControlInterface.Velocity
        wanted.target_velocity = qd.tolist()
        return self._planned(wanted)

    def to_rest(self, state: State, ceiling: Ceiling) -> Course | None:
        """Return the fastest course to rest; None where there is none."""
        return self.to_velocity(state, np.zeros(self._n), ceiling)

    def to_position(self, state: State, q: Array, qd: Array, ceiling: Ceiling) -> Course | None:
        """Return the fastest course to joint values q (n,), passed at velocities qd (n,); None where there is none."""
        wanted = self._input(state, ceiling)
        wanted.control_interface = ControlInterface.Position
        wanted.target_position = q.tolist()
        longest = (1.0 - SLACK) * np.maximum(ceiling.speed, LEAST)
        wanted.target_velocity = np.clip(qd, -longest, longest).tolist()
        return self._planned(wanted)

    def _input(self, state: State, ceiling: Ceiling) -> InputParameter:
        wanted = InputParameter(self._n)
        wanted.synchronization = Synchronization.Time
        wanted.current_position = state.q.tolist()
        wanted.current_velocity = state.qd.tolist()
        wanted.current_acceleration = state.qdd.tolist()
        wanted.target_acceleration = self._zeros
        wanted.max_velocity = np.maximum(ceiling.speed, LEAST).tolist()
        # an acceleration that is there already is taken down by the jerk limit like any other
        wanted.max_acceleration = np.maximum(ceiling.acceleration, (1.0 + SLACK) * np.abs(state.qdd)).tolist()
        wanted.max_jerk = ceiling.jerk.tolist()
        return wanted

    def _planned(self, wanted: InputParameter) -> Course | None:
        trajectory = Trajectory(self._n)
        try:
            result = self._ruckig.calculate(wanted, trajectory)
        except (RuckigError, ValueError):  # the second: a result that its Python side has no name for
            return None
        return Course(trajectory) if result in (Result.Working, Result.Finished) else None
