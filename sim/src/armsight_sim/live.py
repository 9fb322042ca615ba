"""A simulated robot and its cameras, both on one clock: what the robot is told is what the frames show."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import TracebackType
from typing import Any, Self

import numpy as np
from scipy.spatial.transform import RigidTransform

from armsight.arrays import Array
from armsight.clock import Clock
from armsight.drivers import Skew
from armsight.errors import DeviceFailed, Inconsistent
from armsight.records import Frame
from armsight_sim.backdrops import MovingBackdrops
from armsight_sim.cell import SEED_NOISE
from armsight_sim.motions import Hand, Jumping, Vibration, hand_path
from armsight_sim.render import LightImage
from armsight_sim.rigs import SIDES
from armsight_sim.robot import SimRobot
from armsight_sim.scenario_builder import build_robot, build_world, joint_motion, robotics
from armsight_sim.scenario_keys import EventKeys
from armsight_sim.scenario_schema import Scenario
from armsight_sim.scene import Path
from armsight_sim.world import World, behind_arm

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
    """The frames of a rig on the flange of a simulated robot: a MomentSource without end, at the rig's own pace.

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


LEAST_FPS = 10.0
"""Frames a second where the scenario takes fewer: its own pictures are taken when its robot rests, seconds apart."""
BEFORE_FLANGE_M = 0.13
"""How far before the place it has on the flange a target in a hand begins."""


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


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FreeTarget:
    """The path of a target in a hand, in the axes of a fixed rig; path: T_world_target."""

    T_rig_world: RigidTransform
    path: Path

    def __call__(self, t_s: Array) -> RigidTransform:
        """Return the poses T_rig_target at times (m,) since the opening."""
        return self.T_rig_world * self.path(t_s)


class LiveView:
    """The pairs of a fixed rig that watches a simulated robot: a MomentSource without end, at the rig's own pace.

    The target is on the robot's flange, or goes the way of a hand. A frame that nobody fetched in its time is not
    taken. Of the scenario's events the target's jumps are simulated (a tool that is knocked), at times since the
    cameras' opening; not the others, nor vibration.
    """

    skew: Skew | None = None
    total: int | None = None

    def __init__(
        self,
        world: World,
        robot: SimRobot,
        clock: Clock,
        jumps: Sequence[EventKeys] = (),
        *,
        fps: float | None = None,
        hand: Path | None = None,
    ) -> None:
        """hand: T_world_target of a target that is not on the flange. fps: the scenario's if not given."""
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
        self.fps = max(world.fps, LEAST_FPS) if fps is None else fps
        self.latency_s = world.timing.latency_s
        self._hand = hand
        self._path: Path | None = None
        self._jumps = tuple(jumps)
        self._covered = False
        self.origin_s = 0.0

    def cover(self, on: bool = True) -> None:
        """Cover all lights, or uncover them."""
        self._covered = on

    def target_at(self, t_s: float) -> RigidTransform:
        """Return T_world_target at a time since the opening: the truth that results are held against."""
        return self._world.true.T_world_base * self._T_base_rig * self._open_path()(np.array([t_s]))[0]

    def __enter__(self) -> Self:
        self.origin_s = self._clock.now_s()
        T_rig_base = self._T_base_rig.inv()
        path: Path = FollowedTarget(
            robot=self._robot,
            T_rig_base=T_rig_base,
            T_flange_target=self._world.T_flange_tool,
            origin_s=self.origin_s,
        )
        if self._hand is not None:
            path = FreeTarget(T_rig_world=T_rig_base * self._world.true.T_world_base.inv(), path=self._hand)
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
            passed_s = self._clock.now_s() - self.origin_s - self.latency_s
            index = max(index + 1, int(np.ceil(passed_s * self.fps - 1e-9)))
            self._clock.sleep_until(self.origin_s + index / self.fps + self.latency_s)
            yield self.pair(index)

    def pair(self, index: int) -> tuple[Frame, Frame]:
        """Return the pair number index, exposed index / fps after the opening. Raises DeviceFailed where not open."""
        path, t_s = self._open_path(), index / self.fps
        return self._frame(index, t_s, "left", path), self._frame(index, t_s, "right", path)

    def _open_path(self) -> Path:
        if self._path is None:
            raise DeviceFailed(f"{self.name} is not open", consequence="There are no frames", cure="Open it first")
        return self._path

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
        return frozenset(behind_arm(self._world, side, frames, path(np.array([t_s]))[0]))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LiveCell:
    """A robot, the cameras that watch it or that it carries, and rig and target as rig.yaml and target.yaml have them.

    T_mount_rig: where the rig truly is, on the flange where carried is set, else on the base. one_image: both views
    are on one image, which is given as left and as right.
    """

    robot: SimRobot
    pairs: LiveView | CarriedView
    rig: Mapping[str, Any]
    target: Mapping[str, Any]
    T_mount_rig: RigidTransform
    carried: bool = False
    one_image: bool = False

    @property
    def origin_s(self) -> float:
        """The clock's time at which the cameras' stamps are zero, once they are open."""
        return self.pairs.origin_s


def live_cell(
    scenario: Scenario,
    clock: Clock,
    *,
    play: bool = False,
    hand: Hand | str | None = None,
    speed_m_s: float = 0.05,
    seed: int | None = None,
    fps: float | None = None,
    room: Any = None,
) -> LiveCell:
    """Return a scenario's robot and the cameras that watch it or that it carries, on one clock.

    play: the robot's controller goes along the scenario's motion by itself. hand: how a target that the robot does not
    carry is led, at speed_m_s, from where it is in the scenario (on the flange: from before it) at the cameras'
    opening; None: as the scenario has it. seed, fps, room: the scenario's if not given; fps at least LEAST_FPS then.
    """
    if seed is not None:
        scenario = scenario.model_copy(update={"seed": seed})
    carried = scenario.cameras.mount == "flange"
    world = build_world(scenario, frames=None if carried and hand is None else 1, room=room)
    if carried:
        return _carried_cell(world, scenario, clock, hand=hand, speed_m_s=speed_m_s, fps=fps)
    robot = build_robot(scenario, "", clock)
    if play:
        robot.play(joint_motion(scenario, robotics(scenario, scenario.seed).units, scenario.seed))
    jumps = [event for event in scenario.events if event.kind == "jump"]
    path = None
    if hand is not None:
        start = _before_flange(world, robot, robot.true_joints(clock.now_s()))
        path = hand_path(hand, start, speed_m_s, world.seed)
    view = LiveView(world, robot, clock, jumps, fps=fps, hand=path)
    return LiveCell(
        robot=robot,
        pairs=view,
        rig=world.rig,
        target=world.target,
        T_mount_rig=scenario.cameras.T_mount_rig.pose(),
    )


def _before_flange(world: World, robot: SimRobot, q: Array) -> RigidTransform:
    """Return T_world_target of a target in a hand: before the flange of a robot at q (n,), towards the cameras."""
    T_base_flange = robot.true.flange(q)
    away = RigidTransform.from_translation([0.0, 0.0, -BEFORE_FLANGE_M])  # a target's z points away from the cameras
    return robot.true.T_world_base * T_base_flange * world.T_flange_tool * away


def _carried_cell(
    world: World, scenario: Scenario, clock: Clock, *, hand: Hand | str | None, speed_m_s: float, fps: float | None
) -> LiveCell:
    """Return the cell of a rig on the flange; the robot begins where its own following would."""
    robot = build_robot(scenario, "", clock, home=world.servo.at(0.0)[0])
    path = world.target_path
    if hand is not None:
        path = hand_path(hand, path(np.zeros(1))[0], speed_m_s, world.seed)
    view = CarriedView(world, robot, clock, fps=max(world.fps, LEAST_FPS) if fps is None else fps, target=path)
    return LiveCell(
        robot=robot,
        pairs=view,
        rig=world.rig,
        target=world.target,
        T_mount_rig=view.T_flange_rig,
        carried=True,
        one_image=len(world.views) == 1,
    )
