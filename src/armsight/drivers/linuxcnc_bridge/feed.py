"""Goals to jog counts at the servo rate."""

from __future__ import annotations

import math
from typing import Any

from .ini import COUNT

SPARE = 2e-3
"""A target keeps so far within a range: counts that lead beyond it would be dropped whole, and told to nobody."""

SLACK_S = 0.1
"""What is commanded may be behind the target by twice the braking distance, and by the way in so long."""


class Feed:
    """Goals of one arm to jog counts; positions in degrees, or the INI's length unit.

    at: where the joints are asked to be. target: what the counts say, one braking distance ahead: the planner of a jog
    keeps so far behind its target, and is then where it is asked to be (to 0.0005 degrees at 15 degrees/s).
    """

    def __init__(self, machine: dict[str, Any], *, offsets: bool = False) -> None:
        """machine: of describe. offsets: of its axes, in place of its joints."""
        joints = machine["offsets" if offsets else "joints"]
        self.n = len(joints)
        self._dt = machine["servo_s"]
        self._range = [(one["lower"] + SPARE, one["upper"] - SPARE) for one in joints]
        self._speed = [one["speed"] for one in joints]
        # [TRAJ]DEFAULT_LINEAR_ACCELERATION limits every jog, whatever unit the joint has
        cap = math.inf if offsets else machine["jog_acceleration"]
        self._acceleration = [min(one["acceleration"], cap) for one in joints]
        pairs = list(zip(self._speed, self._acceleration))  # noqa: B905  # as all below, of one length
        self.braking_s = max((speed / acceleration for speed, acceleration in pairs), default=0.0)
        self.behind = [speed * speed / acceleration + SLACK_S * speed for speed, acceleration in pairs]
        self._counts = [0] * self.n
        self.start([0.0] * self.n, self._counts)

    def start(self, at: list[float], counts: list[int] | None = None) -> None:
        """Begin where the joints are commanded to be; the counts go on from where they are, so that nothing moves."""
        self._counts = list(self._counts if counts is None else counts)
        self.at, self.target = list(at), list(at)
        self._base = [where - COUNT * count for where, count in zip(at, self._counts)]  # noqa: B905
        self._velocity = [0.0] * self.n

    def asks(self, goal: list[float]) -> bool:
        """Tell whether the joints move, or a goal is elsewhere."""
        return any(self._velocity) or goal != self.at

    def far(self, goal: list[float], samples: int) -> bool:
        """Tell whether a goal is farther than the way of so many samples at full speed."""
        time_s = samples * self._dt
        return any(abs(g - at) > speed * time_s for g, at, speed in zip(goal, self.at, self._speed))  # noqa: B905

    @property
    def moves(self) -> bool:
        """Whether the last goal was another than the one before."""
        return any(self._velocity)

    def step(self, goal: list[float], samples: int, nominal: int) -> list[tuple[int, ...]]:
        """Return the counts of so many samples on the way to a goal, which has the nominal number of them."""
        time_s = nominal * self._dt
        most = [speed * time_s for speed in self._speed]
        ways = [min(max(g - at, -m), m) for g, at, m in zip(goal, self.at, most)]  # noqa: B905
        rows = []
        for k in range(1, samples + 1):
            for j, way in enumerate(ways):
                v = self._velocity[j] + (way / time_s - self._velocity[j]) * k / samples
                ahead = self.at[j] + way * k / samples + v * abs(v) / (2.0 * self._acceleration[j])
                self.target[j] = min(max(ahead, self._range[j][0]), self._range[j][1])
            self._counts = [round((t - base) / COUNT) for t, base in zip(self.target, self._base)]  # noqa: B905
            rows.append(tuple(self._counts))
        self.at = [g if abs(g - at) <= m else at + w for g, at, m, w in zip(goal, self.at, most, ways)]  # noqa: B905
        self._velocity = [way / time_s for way in ways]
        return rows

    def let_go(self) -> bool:
        """Leave the arm to come to rest at its target, which is where it is asked to be from now on; tell of a change.

        What leads is never taken back: the arm has used that way to brake.
        """
        changed = self.moves or any(abs(t - at) > COUNT for t, at in zip(self.target, self.at))  # noqa: B905
        self.at, self._velocity = list(self.target), [0.0] * self.n
        return changed

    def lost(self, commanded: list[float]) -> bool:
        """Tell whether some joint is farther from its target than its planner can be."""
        return any(abs(t - c) > most for t, c, most in zip(self.target, commanded, self.behind))  # noqa: B905
