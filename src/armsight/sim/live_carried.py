"""A rig that a simulated robot carries, and a target that a hand or a turning base leads before it, on one clock."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from types import TracebackType
from typing import Self

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from armsight.clock import Clock
from armsight.drivers import Skew
from armsight.errors import DeviceFailed, Inconsistent
from armsight.records import Frame
from armsight.sim.backdrops import MovingBackdrops
from armsight.sim.motions import Vibration
from armsight.sim.render import LightImage
from armsight.sim.robot import SimRobot
from armsight.sim.scene import Path
from armsight.sim.world import World

Array = NDArray[np.float64]

BACKDROP_M, BACKDROP_RAD = 5e-4, 2e-4
"""The room is drawn anew where the rig moved further: at 1000 px and a metre or more of room, half a pixel."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CarriedRig:
    """The path of a rig on the flange, in world axes: where the robot is at a moment, now at the latest."""

    robot: SimRobot
    T_flange_rig: RigidTransform
    vibration: Vibration
    origin_s: float

    def __call__(self, t_s: Array) -> RigidTransform:
        """Return the poses T_world_rig at times (m,) since origin_s."""
        robot, t = self.robot, np.atleast_1d(t_s)
        flanges = np.array([robot.true_flange(self.origin_s + float(moment)).as_matrix() for moment in t])
        shaken = RigidTransform.from_matrix(flanges) * RigidTransform.from_translation(self.vibration(t))
        return robot.true.T_world_base * shaken * self.T_flange_rig


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class KeptBackdrops(MovingBackdrops):
    """What the cameras of a carried rig see of a room, drawn anew only where the rig moved enough to show.

    A rig at rest shakes by micrometres; drawing the room for each of them would take most of a frame's time.
    """

    kept: dict[str, tuple[RigidTransform, LightImage]] = field(default_factory=dict)

    def light(self, side: str, T_world_rig: RigidTransform) -> LightImage:
        """Return the light (h, w, c) on the camera of a side, or of 'image' on the one sensor behind mirrors."""
        known = self.kept.get(side)
        if known is not None:
            moved = known[0].inv() * T_world_rig
            if np.linalg.norm(moved.translation) < BACKDROP_M and moved.rotation.magnitude() < BACKDROP_RAD:
                return known[1]
        light = MovingBackdrops.light(self, side, T_world_rig)
        self.kept[side] = T_world_rig, light
        return light


class CarriedView:
    """The frames of a rig on the flange of a simulated robot: a PairSource without end, at the rig's own pace.

    A mirror rig's complex image is given as left and as right. The target goes its own way, which the robot does not
    know. A frame that nobody fetched in its time is not taken. Not simulated: the arm in the view, and of the
    scenario's events all but jumps of the target.
    """

    skew: Skew | None = None
    total: int | None = None

    def __init__(self, world: World, robot: SimRobot, clock: Clock, *, fps: float, target: Path) -> None:
        """target: T_world_target at times since the opening. Raises Inconsistent for a rig that stands."""
        if world.T_flange_rig is None:
            raise Inconsistent(
                f"the rig of {world.name} is not carried by the robot",
                consequence="The robot cannot follow a target with it",
                cure="Take a scenario with cameras.mount flange",
            )
        self.name = " + ".join(f"{world.name}/{view}" for view in world.views)
        self.origin_s = 0.0
        self.fps = fps
        self.latency_s = world.timing.latency_s
        self.T_flange_rig = world.T_flange_rig
        moving = world.moving
        if moving is not None:
            moving = KeptBackdrops(onlookers=moving.onlookers, glow=moving.glow, T_world_room=moving.T_world_room)
        self._world = replace(
            world, timing=replace(world.timing, fps=fps), target_path=target, moving=moving, events=(), frozen=()
        )
        self._robot = robot
        self._clock = clock
        self._live: World | None = None
        self._covered: frozenset[str] = frozenset()

    def cover(self, on: bool = True, *, names: Sequence[str] | None = None) -> None:
        """Cover lights of these names, all where none are given, or uncover them."""
        known = [light.name for light in self._world.lights]
        chosen = frozenset(known if names is None else names)
        self._covered = self._covered | chosen if on else self._covered - chosen

    def target_at(self, t_s: float) -> RigidTransform:
        """Return T_world_target at a time since the opening: the truth that results are held against."""
        return self._world.target_path(np.array([t_s]))[0]

    def __enter__(self) -> Self:
        self.origin_s = self._clock.now_s()
        path = CarriedRig(
            robot=self._robot,
            T_flange_rig=self.T_flange_rig,
            vibration=self._world.vibration,
            origin_s=self.origin_s,
        )
        self._live = replace(self._world, rig_path=path)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._live = None

    def __iter__(self) -> Iterator[tuple[Frame, Frame]]:
        index = 0
        while True:
            passed_s = self._clock.now_s() - self.origin_s - self.latency_s
            index = max(index + 1, int(np.ceil(passed_s * self.fps - 1e-9)))
            self._clock.sleep_until(self.origin_s + index / self.fps + self.latency_s)
            yield self.pair(index)

    def pair(self, index: int) -> tuple[Frame, Frame]:
        """Return the pair number index, exposed index / fps after the opening. Raises DeviceFailed where not open."""
        if self._live is None:
            raise DeviceFailed(f"{self.name} is not open", consequence="There are no frames", cure="Open it first")
        world = self._live
        shown = tuple(light for light in world.lights if light.name not in self._covered)
        frames = [replace(world, lights=shown).frame(index, view) for view in world.views]
        return frames[0], frames[-1]
