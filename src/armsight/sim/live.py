"""A simulated robot and the cameras that see it, both on one clock: what the robot is told is what the frames show."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from types import TracebackType
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from armsight.clock import Clock
from armsight.drivers import Skew
from armsight.errors import DeviceFailed, Inconsistent
from armsight.records import Frame
from armsight.sim.cell import SEED_NOISE
from armsight.sim.event_schema import EventKeys
from armsight.sim.motions import Jumping
from armsight.sim.rigs import SIDES
from armsight.sim.robot import SimRobot
from armsight.sim.scenario_builder import build_robot, build_world, joint_motion, robotics
from armsight.sim.scenario_schema import Scenario
from armsight.sim.scene import Path
from armsight.sim.world import World, behind_arm

Array = NDArray[np.float64]

LEAST_FPS = 10.0
"""Frames a second where the scenario takes fewer: its own pictures are taken when its robot rests, seconds apart."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FollowedTarget:
    """The path of a target on a robot's flange, in rig axes: where the robot is at a moment, now at the latest."""

    robot: SimRobot
    T_rig_base: RigidTransform
    T_flange_target: RigidTransform
    origin_s: float

    def __call__(self, t_s: Array) -> RigidTransform:
        """Return the poses T_rig_target at times (m,) since origin_s."""
        flanges = [self.robot.true_flange(self.origin_s + float(t)).as_matrix() for t in t_s]
        return self.T_rig_base * RigidTransform.from_matrix(np.array(flanges)) * self.T_flange_target


class LiveView:
    """The pairs of a fixed rig that watches a simulated robot: a PairSource without end, at the rig's own pace.

    A frame that nobody fetched in its time is not taken. Of the scenario's events the target's jumps are simulated (a
    tool that is knocked), at times since the cameras' opening; not the others, nor vibration.
    """

    skew: Skew | None = None
    total: int | None = None

    def __init__(self, world: World, robot: SimRobot, clock: Clock, jumps: Sequence[EventKeys] = ()) -> None:
        if world.T_base_rig is None or world.views != SIDES:
            raise Inconsistent(
                f"{world.name} has no two cameras beside the robot",
                consequence="They cannot watch it",
                cure="Take a scenario with cameras.mount base and a right camera",
            )
        self.name = f"{world.name}/left + {world.name}/right"
        self._world = world
        self._robot = robot
        self._clock = clock
        self._T_base_rig = world.T_base_rig
        self._fps = max(world.fps, LEAST_FPS)
        self._path: Path | None = None
        self._jumps = tuple(jumps)
        self._covered = False
        self.origin_s = 0.0

    def cover(self, on: bool = True) -> None:
        """Cover all lights, or uncover them."""
        self._covered = on

    def __enter__(self) -> Self:
        self.origin_s = self._clock.now_s()
        path: Path = FollowedTarget(
            robot=self._robot,
            T_rig_base=self._T_base_rig.inv(),
            T_flange_target=self._world.T_flange_tool,
            origin_s=self.origin_s,
        )
        for jump in self._jumps:
            if jump.by_m is not None:
                end_s = jump.at_s + jump.for_s
                path = Jumping(path=path, by_m=np.array(jump.by_m), start_s=jump.at_s, end_s=end_s)
        self._path = path
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._path = None

    def __iter__(self) -> Iterator[tuple[Frame, Frame]]:
        index = 0
        while True:
            path = self._path
            if path is None:
                raise DeviceFailed(f"{self.name} is not open", consequence="There are no frames", cure="Open it first")
            passed_s = self._clock.now_s() - self.origin_s - self._world.timing.latency_s
            index = max(index + 1, int(np.ceil(passed_s * self._fps - 1e-9)))
            t_s = index / self._fps
            self._clock.sleep_until(self.origin_s + t_s + self._world.timing.latency_s)
            yield self._frame(index, t_s, "left", path), self._frame(index, t_s, "right", path)

    def _frame(self, index: int, t_s: float, side: str, path: Path) -> Frame:
        camera = self._world.cameras[side]
        noise = np.random.default_rng([self._world.seed, SEED_NOISE, SIDES.index(side), index])
        image = camera.expose(self._world.lights, path, t_s, noise, hidden=self._hidden(t_s, side, path))
        return Frame(
            image=image, t_s=t_s, sequence=index, source=f"{self._world.name}/{side}", exposure_s=camera.exposure_s
        )

    def _hidden(self, t_s: float, side: str, path: Path) -> frozenset[str]:
        """Return the names of the lights that are covered: on command, or by the arm."""
        if self._covered:
            return frozenset(light.name for light in self._world.lights)
        frames = self._robot.true.frames(self._robot.true_joints(self.origin_s + t_s))
        return behind_arm(self._world, side, frames, path(np.array([t_s]))[0])


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LiveCell:
    """A robot, the cameras that watch it, and rig and target as rig.yaml and target.yaml have them."""

    robot: SimRobot
    pairs: LiveView
    rig: Mapping[str, Any]
    target: Mapping[str, Any]

    @property
    def origin_s(self) -> float:
        """The clock's time at which the cameras' stamps are zero, once they are open."""
        return self.pairs.origin_s


def live_cell(scenario: Scenario, clock: Clock, *, play: bool = False) -> LiveCell:
    """Return a scenario's robot and the cameras that watch it, on one clock.

    play: the robot's controller goes along the scenario's motion by itself. Raises Inconsistent for a rig that the
    robot carries.
    """
    world, robot = build_world(scenario, frames=1), build_robot(scenario, "", clock)
    if play:
        robot.play(joint_motion(scenario, robotics(scenario, scenario.seed).units, scenario.seed))
    jumps = [event for event in scenario.events if event.kind == "jump"]
    return LiveCell(robot=robot, pairs=LiveView(world, robot, clock, jumps), rig=world.rig, target=world.target)
