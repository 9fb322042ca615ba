"""Where a controller is told to go next, cut to what one of its cycles allows, and which goals it has taken."""

from __future__ import annotations

import threading
from collections import deque
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.arrays import Array
from armsight.errors import Inconsistent, UsageError
from armsight.records import frozen_array

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


G = TypeVar("G", Array, RigidTransform)


class _Goals(Generic[G]):
    """A goal, safe between the thread that asks and the thread that sends. name: of the robot."""

    def __init__(self, name: str, cycle_s: float, at: G) -> None:
        self._name = name
        self._cycle_s = cycle_s
        self._lock = threading.Lock()
        self._sent: G = at
        self._next: G = at

    @property
    def sent(self) -> G:
        """Where the controller was last told to go: joints (n,), or T_base_flange."""
        return self._sent

    def start(self, at: G) -> None:
        """Begin there, with nothing asked."""
        with self._lock:
            self._sent = self._next = at

    def hold(self) -> None:
        """Forget what was asked and not yet sent."""
        with self._lock:
            self._next = self._sent

    def take(self) -> G:
        """Return what goes on the wire now."""
        with self._lock:
            self._sent = self._next
            return self._sent


class JointGoals(_Goals[Array]):
    """The goal of one arm's joints.

    Commands of one cycle change the goal of that cycle and never add up beyond its way; a cycle ends when `take` hands
    the goal to the wire. A goal that the controller may not have taken goes out again: no two steps reach it as one.
    """

    def __init__(self, name: str, limits: JointLimits, cycle_s: float) -> None:
        super().__init__(name, cycle_s, np.zeros(len(limits.max_speed)))
        self._limits = limits
        self._longest = limits.max_speed * cycle_s
        self._lead = limits.max_speed * max(LEAD_S, 2.0 * cycle_s)

    @property
    def n(self) -> int:
        """How many joints."""
        return len(self._longest)

    @property
    def limits(self) -> JointLimits:
        """Range and speed of the joints."""
        return self._limits

    def room(self) -> tuple[Array, Array]:
        """Return how far it is to the lower (negative) and to the upper end of the range, each (n,)."""
        return self._limits.lower - self._sent, self._limits.upper - self._sent

    def slow_down(self, max_speed: Array) -> None:
        """Allow no more than max_speed (n,) in rad/s or m/s, where that is less than the limits say."""
        with self._lock:
            self._longest = np.minimum(self._limits.max_speed, max_speed) * self._cycle_s

    def narrow(self, limits: JointLimits) -> None:
        """Keep within the limits of the controller as well, which are known when it has told them."""
        with self._lock:
            own = self._limits
            self._limits = JointLimits(
                lower=np.maximum(own.lower, limits.lower),
                upper=np.minimum(own.upper, limits.upper),
                max_speed=np.minimum(own.max_speed, limits.max_speed),
            )
            self._longest = np.minimum(self._longest, limits.max_speed * self._cycle_s)
            self._lead = np.minimum(self._lead, limits.max_speed * max(LEAD_S, 2.0 * self._cycle_s))

    def start(self, at: Array) -> None:
        """Begin at joints (n,), with nothing asked."""
        super().start(np.array(at, dtype=float))

    def step(self, step: Array, q: Array) -> tuple[Array, tuple[str, ...]]:
        """Move the goal on by step (n,) as far as this cycle allows; return the goal and what cut it, in words.

        q (n,): where the arm is by its newest reading. Raises UsageError for another number of joints, Inconsistent
        for values that are not finite.
        """
        values = np.asarray(step, dtype=float)
        if values.shape != (self.n,):
            raise UsageError(
                f"{self._name} has {self.n} joints, but the step has shape {values.shape}", cure=f"Give {self.n} values"
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


class PoseGoals(_Goals[RigidTransform]):
    """The goal pose of one flange, T_base_flange; speeds in m/s and rad/s, which commands of one cycle never exceed."""

    def __init__(self, name: str, speed_m_s: float, speed_rad_s: float, cycle_s: float) -> None:
        super().__init__(name, cycle_s, RigidTransform.identity())
        self._speeds = (speed_m_s, speed_rad_s)

    @property
    def next(self) -> RigidTransform:
        """Where it is told to go with the next packet."""
        return self._next

    def go(self, goal: RigidTransform, here: RigidTransform) -> tuple[RigidTransform, tuple[str, ...]]:
        """Move the goal towards a pose as far as this cycle allows; return the goal and what cut it, in words.

        here: where the flange is by its newest reading. Raises Inconsistent for a pose that is not finite.
        """
        if not np.isfinite(goal.as_matrix()).all():
            raise Inconsistent(f"{self._name}: a pose is not finite", consequence="Nothing was sent")
        with self._lock:
            way_m, turn = between(self._sent, goal)
            ways = (float(np.linalg.norm(way_m)), float(np.linalg.norm(turn)))
            longest = [speed * self._cycle_s for speed in self._speeds]
            words = [
                f"{what} of the flange"
                for what, way, most in zip(("speed", "turning"), ways, longest, strict=True)
                if way > most * 1.000001
            ]
            share = min(1.0, *(most / max(way, 1e-300) for way, most in zip(ways, longest, strict=True)))
            now = RigidTransform.from_components(
                np.asarray(self._sent.translation) + share * way_m,
                Rotation.from_rotvec(share * turn) * self._sent.rotation,
            )
            if self._lead(now, here) > max(1.0, self._lead(self._sent, here)):
                now, words = self._sent, [*words, "lag of the flange"]
            self._next = now
            return now, tuple(words)

    def _lead(self, goal: RigidTransform, here: RigidTransform) -> float:
        """Return by how much a goal is ahead of the flange, as a share of what is allowed."""
        way_m, turn = between(here, goal)
        lead_s = max(LEAD_S, 2.0 * self._cycle_s)
        return max(
            float(np.linalg.norm(way_m)) / (self._speeds[0] * lead_s),
            float(np.linalg.norm(turn)) / (self._speeds[1] * lead_s),
        )


def between(start: RigidTransform, end: RigidTransform) -> tuple[np.ndarray, np.ndarray]:
    """Return the way (3,) in m and the turn (3,) in rad, both in base axes, from one pose to another."""
    turn = (end.rotation * start.rotation.inv()).as_rotvec()
    return np.asarray(end.translation) - np.asarray(start.translation), np.asarray(turn)


def away(start: RigidTransform, offset: Array) -> RigidTransform:
    """Return the pose that is a way in m and a turn in rad (6,), in base axes, from a start: between's reverse."""
    return RigidTransform.from_components(
        np.asarray(start.translation) + offset[:3], Rotation.from_rotvec(offset[3:]) * start.rotation
    )


Goal = NDArray[np.float64] | RigidTransform

NEAR = 1e-5
"""A planned position nearer to the last goal, in rad or m, is it; what it may lack is no jump."""

SAME = 1e-7
"""A planned position nearer to an older goal, in rad or m, is that one."""

OLDER = 16
"""So many goals are remembered: more than are ever under way."""


class GivenGoals:
    """The goals of one link that went out last, joints (n,) or poses; for the link's thread."""

    def __init__(self) -> None:
        self._goals: deque[Goal] = deque(maxlen=OLDER)

    def start(self) -> None:
        """Forget all."""
        self._goals.clear()

    def give(self, goal: Goal) -> None:
        """Note a goal that goes out, maybe once more."""
        if not self._goals or _apart(goal, self._goals[-1]) > 0.0:
            self._goals.append(goal)

    def taken(self, planned: Goal | None) -> bool:
        """Tell whether the planned position is the last goal, or one that was never given; True where none is told.

        A controller that smooths plans something between its goals, and limits by itself what it catches up; one that
        takes goals as they are, and stands at an older one, would catch it up within a cycle.
        """
        if planned is None or not self._goals or _apart(planned, self._goals[-1]) <= NEAR:
            return True
        return all(_apart(planned, goal) > SAME for goal in self._goals)


def _apart(a: Goal, b: Goal) -> float:
    """Return how far joints or poses are from each other, in rad or m."""
    if isinstance(a, RigidTransform) and isinstance(b, RigidTransform):
        return float(np.abs(np.concatenate(between(a, b))).max())
    return float(np.abs(np.asarray(a) - np.asarray(b)).max())
