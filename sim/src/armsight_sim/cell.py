"""What a simulated cell is: cameras, what they watch, the truth about it, and in words what was chosen.

The world is the rig: the axes of the left camera. A frame depends on the cell's seed and its own index only.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.spatial.transform import RigidTransform

from armsight.arrays import Array
from armsight.geometry import xyz_quat
from armsight.records import Frame
from armsight_sim.boards import Board, board_light, corner_rays
from armsight_sim.camera import SimCamera
from armsight_sim.pipeline import IDEAL, Pipeline
from armsight_sim.render import LightImage
from armsight_sim.rigs import SIDES, rig_mapping
from armsight_sim.scenario_keys import RoomKeys
from armsight_sim.scene import Event, Light, Path, ghosts_seen, hidden_lights
from armsight_sim.sensor import Sensor


def room_chosen(keys: RoomKeys, dark: str) -> str:
    """Return what was chosen about the room."""
    if keys.dark:
        return f"room: {dark}"
    if keys.picture is not None:
        return "room: pictures of one's own"
    return f"room: {keys.preset}, white at {keys.white_level:g} grey levels of light, furniture from the seed"


def pipeline_chosen(pipeline: Pipeline) -> str:
    """Return what was chosen about lens losses and processing."""
    if pipeline == IDEAL:
        return "processing: none; no mosaic of colour filters, no glare, no vignetting"
    mosaic = "Bayer mosaic" if pipeline.bayer else "no mosaic"
    jpeg = "no JPEG" if pipeline.jpeg_quality is None else f"JPEG of quality {pipeline.jpeg_quality}"
    return (
        f"processing: vignetting {100 * pipeline.vignetting:g} %, glare {100 * pipeline.glare:g} %, {mosaic}, curve "
        f"{pipeline.curve}, sharpening {pipeline.sharpening:g}, {jpeg}"
    )


def cameras_chosen(cameras: Mapping[str, SimCamera]) -> tuple[str, ...]:
    """Return what was chosen about a pair of cameras."""
    left, right, T = cameras["left"].lens, cameras["right"].lens, cameras["right"].T_world_camera
    turn = np.rad2deg(float(np.linalg.norm(T.rotation.as_rotvec())))
    return (
        f"cameras: {left.width}x{left.height} px, fx {left.focal_px[0]:.1f} and {right.focal_px[0]:.1f} px, "
        f"distortion {list(left.distortion)} and {list(right.distortion)}",
        f"rig: right camera at {np.round(1e3 * np.asarray(T.translation), 2).tolist()} mm, turned {turn:.2f} deg",
    )


def light_chosen(level: float, sigma_px: float, diameter_m: float | None) -> str:
    """Return what was chosen about the lights."""
    if diameter_m is None:
        return f"lights: Gaussian of sigma {sigma_px:g} px, {level:g} grey levels high at any distance"
    return f"lights: flat discs of {1e3 * diameter_m:g} mm, {level:g} grey levels, lens blur sigma {sigma_px:g} px"


def sensor_chosen(sensor: Sensor) -> str:
    """Return what was chosen about the sensor."""
    return (
        f"sensor: {sensor.electrons_per_level:g} electrons per grey level, read noise of "
        f"{sensor.read_noise_level:g} levels, clipping at {sensor.saturation}"
    )


Truth = tuple[float, Array, Array]

SEED_PATH, SEED_BACKDROP, SEED_NOISE, SEED_BOARD = range(4)
"""Streams of random numbers that a cell's seed is split into, so that more noise never moves the target."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Cell:
    """Two cameras that watch lights on a moving target.

    rig, target: the structures of rig.yaml and target.yaml. truth: per frame t_s, xyz_m (3,) and quat_xyzw (4,) of
    T_world_target at the middle of the exposure, world = rig. assumptions: every number that was chosen.
    """

    name: str
    seed: int
    n_frames: int
    fps: float
    cameras: Mapping[str, SimCamera]
    lights: tuple[Light, ...]
    path: Path
    target: dict[str, Any]
    events: tuple[Event, ...]
    assumptions: tuple[str, ...]

    @property
    def rig(self) -> dict[str, Any]:
        """The true rig, as rig.yaml has it under kind and cameras."""
        return rig_mapping({side: (camera.lens, camera.T_world_camera) for side, camera in self.cameras.items()})

    @property
    def truth(self) -> tuple[Truth, ...]:
        """Time in s, position in m and scalar-last quaternion of the target in every frame."""
        t_s = np.arange(self.n_frames) / self.fps
        poses = self.path(t_s)
        xyz, quat = np.asarray(poses.translation), poses.rotation.as_quat(canonical=True)
        return tuple(zip(t_s.tolist(), xyz, quat, strict=True))

    def pair(self, index: int) -> tuple[Frame, Frame]:
        """Return the left and right frame number index."""
        return self._frame(index, "left"), self._frame(index, "right")

    def frames(self) -> Iterator[tuple[Frame, Frame]]:
        """Yield all pairs in the order of time."""
        for index in range(self.n_frames):
            yield self.pair(index)

    def centres_px(self, index: int, side: str) -> dict[str, Array]:
        """Return the true pixel (2,) of each light's centre at the middle of the exposure, where it is not covered."""
        camera = self.cameras[side]
        covered = hidden_lights(self.events, index, side) | camera.covered(self.lights, self.path, index / self.fps)
        uv = camera.centres_px(self.lights, self.path, index / self.fps)
        return {light.name: spot for light, spot in zip(self.lights, uv, strict=True) if light.name not in covered}

    def _frame(self, index: int, side: str) -> Frame:
        camera, t_s = self.cameras[side], index / self.fps
        image = camera.expose(
            self.lights,
            self.path,
            t_s,
            np.random.default_rng([self.seed, SEED_NOISE, SIDES.index(side), index]),
            hidden=hidden_lights(self.events, index, side),
            ghosts=ghosts_seen(self.events, index, side),
        )
        source = f"{self.name}/{side}"
        return Frame(image=image, t_s=t_s, sequence=index, source=source, exposure_s=camera.exposure_s)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BoardCell:
    """Two cameras that watch a checkerboard held still at one pose after another; the face of a Cell.

    truth: T_world_board per pair. board: as the command line takes it. behind: the light of a room on each camera;
    None where the board's own shade of the room is behind it.
    """

    name: str
    seed: int
    fps: float
    cameras: Mapping[str, SimCamera]
    printed: Board
    poses: tuple[RigidTransform, ...]
    assumptions: tuple[str, ...]
    behind: Mapping[str, LightImage] | None = None

    @property
    def n_frames(self) -> int:
        """How many pairs there are."""
        return len(self.poses)

    @property
    def board(self) -> str:
        """The board in one word."""
        return f"checkerboard:{self.printed.columns}x{self.printed.rows}:{self.printed.square_m:g}"

    @property
    def rig(self) -> dict[str, Any]:
        """The true rig, as rig.yaml has it under kind and cameras."""
        return rig_mapping({side: (camera.lens, camera.T_world_camera) for side, camera in self.cameras.items()})

    @property
    def target(self) -> dict[str, Any]:
        """The board, as target.yaml has it."""
        b = self.printed
        return {"kind": "checkerboard", "columns": b.columns, "rows": b.rows, "square_m": b.square_m}

    @property
    def truth(self) -> tuple[Truth, ...]:
        """Time in s, position in m and scalar-last quaternion of the board in every pair."""
        return tuple((index / self.fps, *xyz_quat(pose)) for index, pose in enumerate(self.poses))

    def frames(self) -> Iterator[tuple[Frame, Frame]]:
        """Yield all pairs; the rays through the pixels are traced once."""
        rays = {side: corner_rays(camera.lens) for side, camera in self.cameras.items()}
        for index, pose in enumerate(self.poses):
            left, right = (self._frame(index, side, rays[side], pose) for side in SIDES)
            yield left, right

    def _frame(self, index: int, side: str, rays: Array, pose: RigidTransform) -> Frame:
        camera = self.cameras[side]
        T_camera_board = camera.T_world_camera.inv() * pose
        printed = self.printed if self.behind is None else replace(self.printed, room=0.0)
        light = board_light(rays, printed, T_camera_board)
        light = light * camera.backdrop  # here the backdrop is the lamps' unevenness about 1
        if self.behind is not None:
            beyond = board_light(rays, replace(self.printed, black=0.0, white=0.0, room=1.0), T_camera_board)
            light = light + beyond * self.behind[side]
        rng = np.random.default_rng([self.seed, SEED_NOISE, SIDES.index(side), index])
        light = camera.losses.through(np.ascontiguousarray(light, dtype=np.float32))
        image = camera.pipeline.develop(light, camera.sensor, rng, grey=camera.grey)
        return Frame(image=image, t_s=index / self.fps, sequence=index, source=f"{self.name}/{side}")
