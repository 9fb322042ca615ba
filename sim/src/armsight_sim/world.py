"""A robot, a target and a rig together: what the cameras see and what the encoders read, frame by frame.

Reached through a scenario (sim.scenario_schema). The axes of all poses that leave here are those of the rig, unless
they say world. A frame depends on the seed and its own index only.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from armsight.arrays import Array
from armsight.records import Frame
from armsight_sim.arms import Servo, SimArm, covering
from armsight_sim.backdrops import MovingBackdrops
from armsight_sim.camera import SimCamera
from armsight_sim.cell import SEED_NOISE, Truth
from armsight_sim.motions import Vibration
from armsight_sim.render import LightImage
from armsight_sim.scene import Event, Light, Path, ghosts_seen, hidden_lights

SEED_JITTER, SEED_DROP = 10, 11
"""Further streams of random numbers beside those of sim.cell."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Carried:
    """A path that is the arm's flange with something fixed to it: T_world_base, true arm, T_flange_thing."""

    arm: SimArm
    servo: Servo
    T_flange_thing: RigidTransform
    vibration: Vibration

    def __call__(self, t_s: Array) -> RigidTransform:
        """Return the poses T_world_thing at times (m,)."""
        flange = RigidTransform.from_matrix(self.arm.flanges(self.servo.at(t_s)))
        shaken = flange * RigidTransform.from_translation(self.vibration(np.asarray(t_s)))
        return self.arm.T_world_base * shaken * self.T_flange_thing


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Between:
    """The pose of a target as its rig sees it, where both may move: T_rig_target."""

    rig: Path
    target: Path

    def __call__(self, t_s: Array) -> RigidTransform:
        """Return the poses T_rig_target at times (m,)."""
        return self.rig(t_s).inv() * self.target(t_s)


@dataclass(frozen=True, slots=True, kw_only=True)
class Timing:
    """When frames are taken and how they come.

    fps: frames a second; jitter_s: standard deviation of another camera's moment from the left one's, of which its
    stamp knows nothing; latency_s: from the exposure's middle to the frame's arrival; drop: share of frames that are
    lost.
    """

    fps: float
    jitter_s: float = 0.0
    latency_s: float = 0.0
    drop: float = 0.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Sight:
    """A light before a camera: its pixel (2,), NaN where it shines elsewhere.

    hidden_by: empty where it is seen, else the joint whose link is before it, turned away, outside, event or occluder.
    """

    t_s: float
    camera: str
    light: str
    uv_px: Array
    hidden_by: str


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class World:
    """A simulated cell with a robot, with the face of sim.cell.Cell.

    views: the cameras' names, or ('image',) for the complex images of a mirror rig. servo: the arm's motion, worked out
    to the end; vibration: of its flange. frozen, dropped, cut_off: events (frames, views) in which the image stands
    still, none comes, no joints are read. radii_m: of the arm's links as obstacles. moving: the room as cameras that
    move see it; None for those that stand, or in the dark.
    """

    name: str
    seed: int
    n_frames: int
    timing: Timing
    views: tuple[str, ...]
    cameras: Mapping[str, SimCamera]
    moving: MovingBackdrops | None
    lights: tuple[Light, ...]
    rig_path: Path
    target_path: Path
    rig: dict[str, Any]
    target: dict[str, Any]
    nominal: SimArm
    true: SimArm
    T_flange_tool: RigidTransform
    servo: Servo
    vibration: Vibration
    T_base_rig: RigidTransform | None
    T_flange_rig: RigidTransform | None
    radii_m: tuple[float, ...]
    events: tuple[Event, ...]
    frozen: tuple[Event, ...] = ()
    dropped: tuple[Event, ...] = ()
    cut_off: tuple[Event, ...] = ()
    sweeps: tuple[tuple[int, int], ...] = ()
    zero_jumps: tuple[tuple[float, float, Array], ...] = ()
    assumptions: tuple[str, ...] = ()
    path: Path = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "path", Between(rig=self.rig_path, target=self.target_path))

    @property
    def fps(self) -> float:
        """Frames a second."""
        return self.timing.fps

    @property
    def kept(self) -> tuple[int, ...]:
        """Numbers of the frames that arrived from every camera."""
        return tuple(index for index in range(self.n_frames) if not self._lost(index))

    @property
    def truth(self) -> tuple[Truth, ...]:
        """Time in s, position in m and scalar-last quaternion of T_rig_target in every frame that arrived."""
        return _truth(self.path, np.array(self.kept) / self.fps)

    @property
    def world_truth(self) -> tuple[Truth, ...]:
        """The same of T_world_target."""
        return _truth(self.target_path, np.array(self.kept) / self.fps)

    @property
    def joints(self) -> tuple[tuple[float, Array], ...]:
        """Time in s and encoder readings (n,) at every frame that arrived while the robot's link was there."""
        kept = [index for index in self.kept if not any(event.applies(index, "both") for event in self.cut_off)]
        t_s = np.array(kept) / self.fps
        q = self.servo.read(t_s)
        for start_s, end_s, by in self.zero_jumps:
            q = q + ((t_s >= start_s) & (t_s < end_s))[:, None] * by
        return tuple(zip(t_s.tolist(), q, strict=True))

    def frames(self) -> Iterator[tuple[Frame, ...]]:
        """Yield the frames of all views that arrived, in the order of time; numbers tell of those that did not."""
        for index in self.kept:
            yield tuple(self.frame(index, view) for view in self.views)

    def frame(self, index: int, view: str) -> Frame:
        """Return the frame number index of a view."""
        seen = max((e.first for e in self.frozen if e.applies(index, view)), default=index)
        t_s = index / self.fps
        image = self._complex(seen) if view == "image" else self._single(seen, view)
        exposure_s = next(iter(self.cameras.values())).exposure_s
        return Frame(image=image, t_s=t_s, sequence=index, source=f"{self.name}/{view}", exposure_s=exposure_s)

    def hidden(self, index: int, side: str) -> frozenset[str]:
        """Return the names of the lights that a camera cannot see in a frame: covered on command, or by the arm."""
        return hidden_lights(self.events, index, side).union(self._links(index, side))

    def _links(self, index: int, side: str) -> dict[str, int]:
        """Return the lights that the arm hides from a camera in a frame, and by which link."""
        if not any(self.radii_m) or self.T_base_rig is None:
            return {}
        t_s = np.array([index / self.fps])
        return behind_arm(self, side, self.true.frames(self.servo.at(t_s)[0]), self.path(t_s)[0])

    def sights(self, index: int) -> Iterator[Sight]:
        """Yield every light before every camera in a frame, and what hides it there, if anything does."""
        for side, camera in self.cameras.items():
            t_s = self._moment(index, side)
            told, passing = hidden_lights(self.events, index, side), camera.covered(self.lights, self.path, t_s)
            links = self._links(index, side)
            inside = np.array([camera.lens.width, camera.lens.height]) - 0.5
            for light, uv in zip(self.lights, camera.centres_px(self.lights, self.path, t_s), strict=True):
                hidden = "" if light.name not in links else self.true.joints[links[light.name]].name
                if not np.isfinite(uv).all():
                    hidden = "turned away"
                elif light.name in told:
                    hidden = "event"
                elif light.name in passing:
                    hidden = "occluder"
                elif not ((uv >= -0.5) & (uv < inside)).all():
                    hidden = "outside"
                yield Sight(t_s=index / self.fps, camera=side, light=light.name, uv_px=uv, hidden_by=hidden)

    def _single(self, index: int, side: str) -> NDArray[np.uint8]:
        camera, t_s = self.cameras[side], self._moment(index, side)
        sources = camera.sources(
            self.lights, self.path, t_s, self.hidden(index, side), ghosts_seen(self.events, index, side)
        )
        return camera.develop(sources, self._noise(index, side), self._backdrop(side, t_s))

    def _backdrop(self, view: str, t_s: float) -> LightImage | None:
        """Return the room as a camera that moves sees it; None where the camera's own backdrop holds it."""
        return None if self.moving is None else self.moving.light(view, self.rig_path(np.array([t_s]))[0])

    def _complex(self, index: int) -> NDArray[np.uint8]:
        """Return both views on one sensor."""
        t_s = index / self.fps
        left = self.cameras["left"]
        sources = [
            source
            for side in self.cameras
            for source in self.cameras[side].sources(
                self.lights, self.path, t_s, self.hidden(index, side), ghosts_seen(self.events, index, side)
            )
        ]
        return left.develop(sources, self._noise(index, "left"), self._backdrop("image", t_s))

    def _noise(self, index: int, side: str) -> np.random.Generator:
        return np.random.default_rng([self.seed, SEED_NOISE, [*self.cameras].index(side), index])

    def _moment(self, index: int, side: str) -> float:
        """Return when a frame is really exposed."""
        late, number = 0.0, [*self.cameras].index(side)
        if number > 0 and self.timing.jitter_s > 0.0:
            stream = [self.seed, SEED_JITTER, index, *((number,) if number > 1 else ())]
            late = self.timing.jitter_s * float(np.random.default_rng(stream).normal())
        return index / self.fps + late

    def _lost(self, index: int) -> bool:
        if any(
            event.applies(index, "both") or event.applies(index, view)
            for event in self.dropped
            for view in self.cameras
        ):
            return True
        if self.timing.drop <= 0.0:
            return False
        lots = np.random.default_rng([self.seed, SEED_DROP, index]).uniform(size=len(self.views))
        return bool((lots < self.timing.drop).any())


def behind_arm(world: World, side: str, frames: Array, T_rig_target: RigidTransform) -> dict[str, int]:
    """Return which link, from 0, of an arm with frames (n + 1, 4, 4) in base axes hides a light from a fixed camera."""
    if not any(world.radii_m) or world.T_base_rig is None:
        return {}
    eye = (world.T_base_rig * world.cameras[side].T_world_camera).translation
    T_base_target = world.T_base_rig * T_rig_target
    links = {
        light.name: covering(frames, world.radii_m, np.asarray(eye), np.asarray(T_base_target.apply(light.xyz_m)))
        for light in world.lights
    }
    return {name: link for name, link in links.items() if link is not None}


def _truth(path: Path, t_s: Array) -> tuple[Truth, ...]:
    if not len(t_s):
        return ()
    poses = path(t_s)
    quat = poses.rotation.as_quat(canonical=True)
    return tuple(zip(t_s.tolist(), np.asarray(poses.translation), quat, strict=True))
