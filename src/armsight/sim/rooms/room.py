"""A furnished room: made once for its spec, seen by cameras that stand or move."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from armsight.errors import Inconsistent
from armsight.sim.lens import Lens
from armsight.sim.mirror import MirrorLens
from armsight.sim.render import LightImage
from armsight.sim.rooms.kernels import meet_scene
from armsight.sim.rooms.presets import PRESETS, Layout
from armsight.sim.rooms.scene import Panel, Scene
from armsight.sim.rooms.view import View
from armsight.sim.scene import Light

Array = NDArray[np.float64]

SEED_ROOM = 30
"""Stream of random numbers of rooms, beside those of sim.cell."""

LENS_BLUR_PX = 0.6
"""Gaussian blur of a room by the lens: chosen, as of the boards; the target and not the room is in focus."""

MOVING_STEP = 2
"""Pixels on a side for which one ray is cast where the camera moves; what is between is interpolated."""

MARGIN_M, LOW_MARGIN_M = 0.35, 0.12
"""Free space behind and below the places that the target takes: the arm and the hand need some."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Room:
    """What stands in a room, in its axes: x right, y down, z ahead. level: grey levels of white in its mean light."""

    scene: Scene
    indicators: tuple[Light, ...]
    level: float

    def seen_indicators(self, eye_m: Array) -> tuple[Light, ...]:
        """Return the indicators that nothing stands before, from a place (3,)."""
        if not self.indicators:
            return ()
        ends = np.array([light.xyz_m for light in self.indicators], dtype=np.float64)
        met = np.empty(len(ends), np.int64)
        meet_scene(self.scene.arrays, np.ascontiguousarray(eye_m, dtype=np.float64), ends, met)
        return tuple(light for light, k in zip(self.indicators, met, strict=True) if k < 0)

    def light(self, view: View, T_room_camera: RigidTransform, channels: int, samples: int = 4) -> LightImage:
        """Return the light (h, w, channels) of all but the indicators; a grey camera gets the mean of the colours."""
        seen = view.cast(self.scene, T_room_camera, samples=samples)[:, :, :3]
        grey = seen if channels == 3 else seen.mean(axis=2, keepdims=True)
        height, width = view.lens.height, view.lens.width
        if view.step > 1:
            size = (grey.shape[1] * view.step, grey.shape[0] * view.step)
            grey = cv2.resize(grey, size, interpolation=cv2.INTER_LINEAR)[:height, :width]
        else:
            grey = cv2.GaussianBlur(grey, (0, 0), LENS_BLUR_PX)
        out: LightImage = np.ascontiguousarray(self.level * grey.reshape(height, width, channels), dtype=np.float32)
        return out


def eye_of(lens: Lens) -> Array:
    """Return where a lens sees from (3,), in camera axes: behind mirrors not from where it stands."""
    if isinstance(lens, MirrorLens):
        return np.asarray(lens.mirrors.pose(lens.side).translation, dtype=np.float64)
    return np.zeros(3)


@lru_cache(maxsize=8)
def view_of(lens: Lens, step: int) -> View:
    """Return the view of a lens; its rays are traced once."""
    return View(lens=lens, step=step)


@lru_cache(maxsize=4)
def furnished(preset: str, seed: int, layout: Layout, level: float) -> Room:
    """Return the room of a preset's name and a seed. Raises Inconsistent for an unknown name."""
    return room_of(preset, seed, layout, level, (), ())


def room_of(
    preset: str, seed: int, layout: Layout, level: float, panels: Sequence[Panel], indicators: Sequence[Light]
) -> Room:
    """Return the room of a preset with more panels and indicators, in room axes, in it."""
    if preset not in PRESETS:
        raise Inconsistent(f"there is no room {preset!r}", cure=f"Known are: {', '.join(PRESETS)}")
    if not layout.depth_m > layout.clear_m or not layout.floor_m > layout.low_m:
        raise Inconsistent(
            f"the room's wall at {layout.depth_m:.2f} m or its floor {layout.floor_m:.2f} m below the rig leaves no "
            f"space for the target, which needs {layout.clear_m:.2f} m ahead and {layout.low_m:.2f} m below",
            cure="Give a larger depth_m or floor_m, or none",
        )
    rng = np.random.default_rng([seed, SEED_ROOM])
    made = PRESETS[preset](layout, rng)
    return Room(
        scene=Scene.lit([*made.panels, *panels], rng),
        indicators=(*made.lights, *indicators),
        level=level,
    )


def upright(T_world_rig: RigidTransform, up: Sequence[float]) -> RigidTransform:
    """Return T_world_room of a room about a rig: at its place, ahead where it looks, level."""
    R, above = T_world_rig.rotation.as_matrix(), np.asarray(up, dtype=np.float64)
    ahead = R[:, 2] - (R[:, 2] @ above) * above
    if np.linalg.norm(ahead) < 0.2:  # it looks up or down: ahead is where the top or the bottom of its image is
        ahead = -R[:, 1] * np.sign(-R[:, 2] @ above)
        ahead = ahead - (ahead @ above) * above
    ahead = ahead / np.linalg.norm(ahead)
    T = np.eye(4)
    T[:3, :3] = np.column_stack([np.cross(-above, ahead), -above, ahead])
    T[:3, 3] = T_world_rig.translation
    return RigidTransform.from_matrix(T)


def layout_about(
    places_m: Array, *, depth_m: float | None, floor_m: float | None, least_floor_m: float, rng: np.random.Generator
) -> Layout:
    """Return where a room may stand about the places (n, 3), in room axes, that the target takes.

    depth_m, floor_m: as asked for, or chosen: the wall one to two metres behind, the floor at least_floor_m or lower.
    """
    clear, low = float(places_m[:, 2].max()) + MARGIN_M, float(places_m[:, 1].max()) + LOW_MARGIN_M
    behind = float(rng.uniform(1.0, 1.8))
    return Layout(
        depth_m=depth_m if depth_m is not None else max(clear + behind, 2.4),
        clear_m=clear,
        floor_m=floor_m if floor_m is not None else max(least_floor_m, low + 0.1),
        low_m=low,
    )
