"""Simulated devices behind the Protocols of real ones, on an injected clock."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from types import TracebackType
from typing import Any, Self

from armsight.clock import Clock, SystemClock
from armsight.errors import DeviceFailed
from armsight.records import Frame
from armsight_sim.robot import SimRobot
from armsight_sim.scenario_builder import build_robot
from armsight_sim.scenario_schema import Scenario
from armsight_sim.world import World


def sim_robot(device: str, *, settings: Mapping[str, Any], clock: Clock | None = None) -> SimRobot:
    """Return the robot of a scenario, whose file's content is in settings."""
    return build_robot(Scenario.model_validate(dict(settings)), device, clock or SystemClock())


class SimCameraView:
    """One simulated camera, 'left', 'right', or the 'image' of a mirror rig: a FrameSource.

    Each frame is handed out when it would have arrived; the clock is waited for, never hurried.
    """

    def __init__(self, world: World, clock: Clock, view: str) -> None:
        self._world = world
        self._clock = clock
        self._view = view
        self._start_s: float | None = None

    @property
    def name(self) -> str:
        """The scenario's name and the view's."""
        return f"{self._world.name}/{self._view}"

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

    def __iter__(self) -> Iterator[Frame]:
        for index in self._world.kept:
            if self._start_s is None:
                raise DeviceFailed(f"{self.name} is not open", consequence="There are no frames", cure="Open it first")
            self._clock.sleep_until(self._start_s + index / self._world.fps + self._world.timing.latency_s)
            yield self._world.frame(index, self._view)
