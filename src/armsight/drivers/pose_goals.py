"""Where a controller that takes poses is told to go next, cut to what one of its cycles allows."""

from __future__ import annotations

import threading

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.drivers.joint_goals import LEAD_S
from armsight.errors import Inconsistent


class PoseGoals:
    """The goal pose of one flange, T_base_flange, safe between the thread that asks and the thread that sends.

    Speeds in m/s and rad/s; commands of one cycle never add up beyond its way.
    """

    def __init__(self, name: str, speed_m_s: float, speed_rad_s: float, cycle_s: float) -> None:
        self._name = name
        self._speeds = (speed_m_s, speed_rad_s)
        self._cycle_s = cycle_s
        self._lock = threading.Lock()
        self._sent = RigidTransform.identity()
        self._next = self._sent

    @property
    def sent(self) -> RigidTransform:
        """Where the controller was last told to go."""
        return self._sent

    @property
    def next(self) -> RigidTransform:
        """Where it is told to go with the next packet."""
        return self._next

    def start(self, pose: RigidTransform) -> None:
        """Begin at a pose, with nothing asked."""
        with self._lock:
            self._sent = self._next = pose

    def hold(self) -> None:
        """Forget what was asked and not yet sent."""
        with self._lock:
            self._next = self._sent

    def take(self) -> RigidTransform:
        """Return what goes on the wire now."""
        with self._lock:
            self._sent = self._next
            return self._sent

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
