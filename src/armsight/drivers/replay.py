"""What was recorded, played again at any speed on an injected clock, behind the Protocols of live devices."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from typing import Any, Generic, Self, TypeVar

import numpy as np
from scipy.spatial.transform import RigidTransform

from armsight.clock import Clock, SystemClock
from armsight.drivers.protocols import RobotState, Sent
from armsight.errors import DeviceFailed, Inconsistent, StaleData, UsageError
from armsight.records import Frame, JointReading, Motion
from armsight.records.result_parts import Skew

Item = TypeVar("Item", Frame, tuple[Frame, Frame])


class Replay(Generic[Item]):
    """Frames or pairs that were recorded, each at its own time, speed times as fast; 0 means as fast as they are read.

    open_items opens the recording and yields what is in it; it is called anew each time the replay is opened, so a
    replay begins anew. Stamps stay those of the recording. Raises Inconsistent at the item whose time runs backwards.
    """

    def __init__(
        self,
        name: str,
        open_items: Callable[[], Iterable[Item]],
        *,
        speed: float = 1.0,
        clock: Clock | None = None,
        total: int | None = None,
    ) -> None:
        if not (np.isfinite(speed) and speed >= 0.0):
            raise UsageError(
                f"a replay at {speed} times the speed cannot be", cure="Give 1, 0.5, 10, or 0 for no waiting"
            )
        self.name = name
        self.total = total
        self._open_items: Callable[[], Iterable[Item]] = open_items
        self._speed = speed
        self._clock = clock or SystemClock()
        self._items: Iterator[Item] | None = None

    @property
    def skew(self) -> Skew | None:
        """None: what the recording knows of it is in its stamps."""
        return None

    @property
    def opened(self) -> bool:
        """Whether it is open."""
        return self._items is not None

    def __enter__(self) -> Self:
        self._items = iter(self._open_items())
        return self

    def __exit__(self, *_: object) -> None:
        close: Any = getattr(self._items, "close", None)
        if close is not None:
            close()
        self._items = None

    def __iter__(self) -> Iterator[Item]:
        if self._items is None:
            raise DeviceFailed(f"{self.name} is not open", consequence="There are no frames", cure="Open it first")
        start_s = self._clock.now_s()
        first_s: float | None = None
        before_s = -np.inf
        for item in self._items:
            t_s = (item if isinstance(item, Frame) else item[0]).t_s
            check_forward(self.name, before_s, t_s)
            before_s = t_s
            first_s = t_s if first_s is None else first_s
            if self._speed > 0.0:
                self._clock.sleep_until(start_s + (t_s - first_s) / self._speed)
            yield item


def check_forward(name: str, before_s: float, t_s: float) -> None:
    """Raise Inconsistent where time does not run forward from one record to the next."""
    if not t_s > before_s:
        raise Inconsistent(
            f"{name}: time runs backwards, from {before_s:.6f} s to {t_s:.6f} s",
            consequence="The replay stops here, since nobody can tell which of the two is true",
            cure="Cut the recording at this place, or sort it by time",
        )


class ReplayRobot:
    """Recorded joints as a robot that is read, speed times as fast; stop holds it, commands raise DeviceFailed."""

    takes_poses = False

    def __init__(self, name: str, motion: Motion, *, speed: float = 1.0, clock: Clock | None = None) -> None:
        if not (np.isfinite(speed) and speed > 0.0):
            raise UsageError(f"a robot replayed at {speed} times the speed cannot be", cure="Give 1, or more, or less")
        if len(motion.t_s) < 2:
            raise Inconsistent(f"{name} has less than two readings", consequence="There is no motion to replay")
        self.name = name
        self._motion = motion
        self._speed = speed
        self._clock = clock or SystemClock()
        self._start_s: float | None = None
        self._held_s: float | None = None

    @property
    def n_joints(self) -> int:
        """How many joints were recorded."""
        return int(self._motion.q.shape[1])

    @property
    def cycle_s(self) -> float:
        """Median time between readings, as replayed."""
        return float(np.median(np.diff(self._motion.t_s))) / self._speed

    @property
    def state(self) -> RobotState:
        """Closed, stopped, moving, or lost at the recording's end."""
        if self._start_s is None:
            return RobotState.CLOSED
        if self._held_s is not None:
            return RobotState.STOPPED
        return RobotState.LOST if self._now_s() > self._motion.t_s[-1] + self.cycle_s else RobotState.MOVING

    def __enter__(self) -> Self:
        self._start_s, self._held_s = self._clock.now_s(), None
        return self

    def __exit__(self, *_: object) -> None:
        self._start_s = None

    def read(self) -> JointReading:
        """Return the newest reading of the recording at this moment; StaleData past its end."""
        self._check_open("read")
        now_s = self._now_s()
        index = max(int(np.searchsorted(self._motion.t_s, now_s + 1e-9, side="right")) - 1, 0)
        if self._held_s is None and now_s - self._motion.t_s[-1] > 2.0 * self.cycle_s * self._speed:
            raise StaleData(f"{self.name} has ended", consequence="There are no newer readings", cure="Replay it again")
        t_s = float(self._motion.t_s[index])
        return JointReading(q=self._motion.q[index], t_s=t_s, sequence=index, source=self.name)

    def step_joints(self, step: np.ndarray) -> Sent:
        """Raise DeviceFailed: what was recorded cannot be moved."""
        raise self._deaf()

    def move_pose(self, T_base_flange: RigidTransform) -> Sent:
        """Raise UsageError: it takes no poses."""
        raise UsageError(f"{self.name} is a recording and takes no poses")

    def stop(self) -> None:
        """Hold the replay where it stands."""
        if self._start_s is not None and self._held_s is None:
            self._held_s = self._now_s()

    def reset(self) -> None:
        """Go on from where it was held."""
        self._check_open("reset")
        if self._held_s is not None:
            first_s = float(self._motion.t_s[0])
            self._start_s = self._clock.now_s() - (self._held_s - first_s) / self._speed
            self._held_s = None

    def _now_s(self) -> float:
        if self._held_s is not None:
            return self._held_s
        passed_s = self._clock.now_s() - (self._start_s or 0.0)
        return float(self._motion.t_s[0]) + self._speed * passed_s

    def _check_open(self, what: str) -> None:
        if self._start_s is None:
            raise DeviceFailed(f"{self.name} is not open", consequence=f"It cannot {what}", cure="Open it first")

    def _deaf(self) -> DeviceFailed:
        return DeviceFailed(
            f"{self.name} is a recording", consequence="Nothing was sent", cure="Use a real or simulated robot"
        )
