"""Simulated devices behind the Protocols of real ones, on an injected clock."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from types import TracebackType
from typing import Any, Self

from armsight.clock import Clock, SystemClock
from armsight.drivers import Skew
from armsight.errors import DeviceFailed
from armsight.records import Frame
from armsight.sim.robot import SimRobot
from armsight.sim.scenario_builder import build_robot
from armsight.sim.scenario_schema import Scenario
from armsight.sim.world import World


def sim_robot(device: str, *, settings: Mapping[str, Any], clock: Clock | None = None) -> SimRobot:
    """Return the robot of a scenario, whose file's content is in settings."""
    return build_robot(Scenario.model_validate(dict(settings)), device, clock or SystemClock())


class _OnClock:
    """A world's frames, each handed out when it would have arrived; the clock is waited for, never hurried."""

    def __init__(self, world: World, clock: Clock) -> None:
        self._world = world
        self._clock = clock
        self._start_s: float | None = None

    @property
    def name(self) -> str:
        """The scenario's name."""
        return self._world.name

    @property
    def total(self) -> int | None:
        """How many frames arrive."""
        return len(self._world.kept)

    @property
    def opened(self) -> bool:
        """Whether it is open."""
        return self._start_s is not None

    def __enter__(self) -> Self:
        self._start_s = self._clock.now_s()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._start_s = None

    def _indices(self) -> Iterator[int]:
        """Yield the numbers of the frames as they arrive."""
        for index in self._world.kept:
            if self._start_s is None:
                raise DeviceFailed(f"{self.name} is not open", consequence="There are no frames", cure="Open it first")
            self._clock.sleep_until(self._start_s + index / self._world.fps + self._world.timing.latency_s)
            yield index


class SimPairs(_OnClock):
    """A simulated pair of cameras: a PairSource."""

    @property
    def skew(self) -> Skew | None:
        """None: the stamps of a pair are the same, and what jitter there is they do not know."""
        return None

    def __iter__(self) -> Iterator[tuple[Frame, Frame]]:
        for index in self._indices():
            yield self._world.frame(index, "left"), self._world.frame(index, "right")


class SimCameraView(_OnClock):
    """One simulated camera, 'left', 'right', or the 'image' of a mirror rig: a FrameSource."""

    def __init__(self, world: World, clock: Clock, view: str) -> None:
        super().__init__(world, clock)
        self._view = view

    @property
    def name(self) -> str:
        """The scenario's name and the view's."""
        return f"{self._world.name}/{self._view}"

    def __iter__(self) -> Iterator[Frame]:
        for index in self._indices():
            yield self._world.frame(index, self._view)
