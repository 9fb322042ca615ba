"""How an arm moves: one reading of its joints, a track of them, a path of the tool's tip."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from numbers import Real

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import RigidTransform

from armsight.arrays import Array
from armsight.errors import Inconsistent, StaleData
from armsight.records import checks
from armsight.records.by_value import Saveable


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class JointReading:
    """Joint values q (n,) in rad or m at one moment, with number and origin."""

    q: NDArray[np.float64]
    t_s: float
    sequence: int
    source: str

    def __post_init__(self) -> None:
        checks.freeze(self, q=(None,))
        checks.require_numbers(self, "sequence")
        checks.require_kind("t_s", self.t_s, Real)
        if not np.isfinite(self.t_s):
            raise Inconsistent(f"{self.source}: the time {self.t_s} is not finite")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Motion:
    """A track of joint values: t_s (m,) increasing, q (m, n) in rad or m."""

    t_s: NDArray[np.float64]
    q: NDArray[np.float64]

    def __post_init__(self) -> None:
        checks.freeze(self, t_s=(None,))
        checks.freeze(self, q=(len(self.t_s), None))
        if (np.diff(self.t_s) <= 0.0).any():
            row = int(np.argmax(np.diff(self.t_s) <= 0.0)) + 1
            raise Inconsistent(
                f"time does not increase at row {row}: {self.t_s[row]:.9g} s after {self.t_s[row - 1]:.9g} s",
                consequence="The track has no order",
                cure="Give each time once, in order",
            )


KEPT = 2000
"""Readings remembered: four seconds at 500 Hz, more than any camera is late."""
AHEAD_CYCLES = 2.5
"""A moment so many cycles after the newest reading is still told, by the last speed; one reading may be late."""
GAP_CYCLES = 3.5
"""Readings further apart than so many cycles leave the moments between them untold."""

MOST_ACCELERATION = 30.0
"""No joint of an arm of this size speeds up faster (rad/s^2, m/s^2): a reading that leaps more is no bend."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class JointsAt:
    """Joint values q (n,) in rad or m at a moment, their speed (n,) a second, and by how much the way between readings
    may be off, bend (n,): what the last change of speed does over that time."""

    q: Array
    speed: Array
    bend: Array


class JointHistory:
    """The newest readings of a robot, in the order of their times."""

    def __init__(self, cycle_s: float) -> None:
        """Begin empty; cycle_s: between two readings of the robot."""
        self._cycle_s = cycle_s
        self._readings: deque[tuple[float, Array]] = deque(maxlen=KEPT)  # one deque: another thread may add meanwhile

    def add(self, reading: JointReading) -> bool:
        """Take a reading; False for one that is not newer than the last."""
        if self._readings and reading.t_s <= self._readings[-1][0]:
            return False
        self._readings.append((reading.t_s, reading.q))
        return True

    @property
    def newest_s(self) -> float | None:
        """The time of the newest reading; None before the first."""
        return self._readings[-1][0] if self._readings else None

    def at(self, t_s: float) -> JointsAt:
        """Return the joints at a moment, between readings or after the last. Raises StaleData without near ones."""
        t, q = self._near(t_s)
        k = min(max(int(np.searchsorted(t, t_s)) - 1, 0), len(t) - 2)
        step_s = float(t[k + 1] - t[k])
        if step_s > GAP_CYCLES * self._cycle_s:
            raise StaleData(f"no joint reading came for {step_s:.3f} s", consequence="Where the arm was is not known")
        speed = (q[k + 1] - q[k]) / step_s
        since, until = t_s - t[k], t_s - t[k + 1]
        return JointsAt(
            q=np.asarray(q[k] + since * speed),
            speed=np.asarray(speed),
            bend=np.asarray(0.5 * self._acceleration(t, q, k) * abs(since * until)),
        )

    def _near(self, t_s: float) -> tuple[Array, Array]:
        """Return times (m,) and values (m, n), m >= 2, of the readings about a moment."""
        known = list(self._readings)
        if len(known) < 2:
            raise StaleData("fewer than two joint readings have come", consequence="Where the arm is is not known")
        if t_s - known[-1][0] > AHEAD_CYCLES * self._cycle_s:
            raise StaleData(
                f"the newest joint reading is {t_s - known[-1][0]:.3f} s older than the exposure",
                consequence="Where the arm was is not known",
                cure="Look at the robot's link; a constant lag belongs into --latency",
            )
        after = len(known) - 1
        while after > 1 and known[after - 1][0] > t_s:
            after -= 1
        if t_s < known[after - 1][0]:
            raise StaleData(f"the first joint reading came {known[after - 1][0] - t_s:.3f} s after the exposure")
        chosen = known[max(after - 2, 0) : after + 2]
        return np.array([t for t, _ in chosen]), np.array([q for _, q in chosen])

    @staticmethod
    def _acceleration(t: Array, q: Array, k: int) -> Array:
        """Return (n,) how fast the speed changed at either end of step k, the larger, at most MOST_ACCELERATION."""
        speeds = np.diff(q, axis=0) / np.diff(t)[:, None]
        change = np.zeros(q.shape[1])
        for a, b in ((k - 1, k), (k, k + 1)):
            if a >= 0 and b < len(speeds):
                change = np.maximum(change, np.abs(speeds[b] - speeds[a]) / (0.5 * (t[b + 1] - t[a])))
        return np.minimum(change, MOST_ACCELERATION)


# A path of the tool's tip, as it was taught or made: places, times, speeds and tags.

WELD_ON, WELD_OFF = "weld_on", "weld_off"
"""Tags that playing acts on; any other word, or none, is kept and means nothing to it."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TaughtPath(Saveable):
    """Poses of the tip one after the other.

    T_world_tip (n, 4, 4); t_s (n,): when each was taught, growing, or NaN where it was not; speed_m_s (n,): at which it
    is to be passed, NaN where that is open; tags (n,): one word each, empty for none. parent: the frame of the poses,
    world or base.
    """

    T_world_tip: Array
    t_s: Array
    speed_m_s: Array
    tags: tuple[str, ...]
    parent: str = "world"

    def __post_init__(self) -> None:
        object.__setattr__(self, "tags", checks.require_texts("tags", self.tags))
        checks.require_kind("parent", self.parent, str, cure="Name the frame of the poses")
        n = len(self.tags)
        T = checks.frozen_array("T_world_tip", checks.checked_poses("T_world_tip", self.T_world_tip, n), (n, 4, 4))
        object.__setattr__(self, "T_world_tip", T)
        for name in ("t_s", "speed_m_s"):
            values = checks.checked_array(name, getattr(self, name), (n,), nan=True).copy()
            values.setflags(write=False)
            object.__setattr__(self, name, values)
        known = self.t_s[np.isfinite(self.t_s)]
        if np.any(np.diff(known) <= 0.0):
            raise Inconsistent(
                "the times of a path do not grow", consequence="It is not used", cure="Put its rows into their order"
            )
        if np.any(self.speed_m_s[np.isfinite(self.speed_m_s)] <= 0.0):
            raise Inconsistent(
                "a speed of a path is not positive", consequence="It is not used", cure="Give m/s, or NaN for any"
            )

    @classmethod
    def of_poses(
        cls,
        poses: RigidTransform | ArrayLike,
        *,
        t_s: Array | None = None,
        speed_m_s: float | Array = np.nan,
        parent: str = "world",
    ) -> TaughtPath:
        """Return the path through poses, RigidTransform (n) or (n, 4, 4), without tags."""
        T = checks.checked_poses("poses", poses.as_matrix() if isinstance(poses, RigidTransform) else poses)
        n, speeds = len(T), checks.real_array("speed_m_s", speed_m_s)
        return cls(
            T_world_tip=T,
            t_s=np.full(n, np.nan) if t_s is None else t_s,
            speed_m_s=np.full(n, speeds) if speeds.ndim == 0 else speeds,
            tags=("",) * n,
            parent=parent,
        )

    def __len__(self) -> int:
        return len(self.tags)

    @property
    def xyz_m(self) -> Array:
        """Places of the tip (n, 3)."""
        return np.asarray(self.T_world_tip[:, :3, 3])

    @property
    def poses(self) -> RigidTransform:
        """The poses (n)."""
        return RigidTransform.from_matrix(self.T_world_tip)

    @property
    def length_m(self) -> Array:
        """Length along the path up to each pose (n,), 0 at the first."""
        return np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(self.xyz_m, axis=0), axis=1))])
