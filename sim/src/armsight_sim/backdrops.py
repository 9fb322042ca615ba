"""Cameras put into a room: what is behind the target, drawn once where the rig stands, every frame where it moves."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from scipy.spatial.transform import RigidTransform

from armsight._files import is_utf8
from armsight.arrays import Array
from armsight.errors import Inconsistent
from armsight_sim.camera import SimCamera
from armsight_sim.lens import Lens
from armsight_sim.render import LightImage, Patch
from armsight_sim.rigs import MirrorLens, Mirrors
from armsight_sim.rooms import textures as tx
from armsight_sim.rooms.occluders import Occluder, make_occluder
from armsight_sim.rooms.room import MOVING_STEP, Room, eye_of, furnished, layout_about, room_of, view_of
from armsight_sim.rooms.scene import Panel, Texture, View
from armsight_sim.scenario_keys import OccluderKeys, PanelKeys, RoomKeys
from armsight_sim.scene import Light, Rest

SEED_LAYOUT = 32
"""Stream of random numbers of a room's size, beside those of sim.cell."""

MIRROR_SHARE = 0.5
"""Of the light that a half-silvered plate sends into each of two views on one sensor."""

OCCLUDER_LIGHT = 1.0
"""Light on an occluder over the room's mean light."""


def make_room(
    keys: RoomKeys,
    places_m: Array,
    seed: int,
    *,
    least_floor_m: float,
) -> Room:
    """Return the room of a checked key about the places (n, 3) of the target, in room axes."""
    seed = seed if keys.seed is None else keys.seed
    layout = layout_about(
        places_m,
        depth_m=keys.depth_m,
        floor_m=keys.floor_m,
        least_floor_m=least_floor_m,
        rng=np.random.default_rng([seed, SEED_LAYOUT]),
    )
    if not keys.panels and not keys.indicators:
        return furnished(keys.preset, seed, layout, keys.white_level)
    rng = np.random.default_rng([seed, SEED_LAYOUT, 1])
    return room_of(keys.preset, seed, layout, keys.white_level, _panels(keys, rng), _indicators(keys))


def _texture(panel: PanelKeys, rng: np.random.Generator) -> Texture:
    """Return the surface of a panel's key; those that are printed or shown have their own colours."""
    b, g, r = panel.colour
    coloured: dict[str, Callable[[np.random.Generator, tx.Colour], Texture]] = {
        "plaster": tx.plaster,
        "brick": tx.brick,
        "concrete": tx.concrete,
        "wood": tx.wood,
        "metal": tx.metal,
        "paint": tx.paint,
    }
    if panel.surface in coloured:
        return coloured[panel.surface](rng, (b, g, r))
    if panel.surface == "checkerboard":
        return tx.checkerboard(9, 6)
    if panel.surface == "screen":
        return tx.screen(rng)
    return tx.poster(rng) if panel.surface == "poster" else tx.cardboard(rng)


def _panels(keys: RoomKeys, rng: np.random.Generator) -> list[Panel]:
    """Return the panels of a room's key."""
    return [
        Panel(
            T_room_panel=panel.T_room_panel.pose(),
            size_m=(panel.size_m[0], panel.size_m[1]),
            texture=_texture(panel, rng),
            tile_m=None if panel.tile_m is None else (panel.tile_m, panel.tile_m),
            glow=panel.glow,
            gloss=panel.gloss,
        )
        for panel in keys.panels
    ]


def _indicators(keys: RoomKeys) -> list[Light]:
    return [
        Light(
            name=f"added indicator {n + 1}",
            xyz_m=(one.xyz_m[0], one.xyz_m[1], one.xyz_m[2]),
            level=one.level,
            sigma_px=one.sigma_px,
            facing=(0.0, 0.0, 0.0),
            bgr=(one.bgr[0], one.bgr[1], one.bgr[2]),
        )
        for n, one in enumerate(keys.indicators)
    ]


def make_occluders(keys: Sequence[OccluderKeys], level: float, seed: int) -> tuple[Occluder, ...]:
    """Return the occluders of a room's key; level: grey levels of white in the room's mean light."""
    return tuple(
        make_occluder(
            one.kind,
            size_m=one.size_m,
            from_m=np.array(one.from_m),
            to_m=np.array(one.to_m),
            first_s=one.at_s,
            last_s=one.at_s + one.for_s,
            level=OCCLUDER_LIGHT * level,
            seed=seed + number,
        )
        for number, one in enumerate(keys)
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Onlooker:
    """A camera of a rig that may move in a room: what it sees of it."""

    room: Room
    camera: SimCamera

    @classmethod
    def of(cls, room: Room, camera: SimCamera) -> Onlooker:
        """Return the onlooker of a camera whose T_world_camera is its pose in the rig."""
        still = np.zeros_like(camera.backdrop)
        return cls(room=room, camera=replace(camera, backdrop=still, exposure_s=0.0, readout_s=0.0, occluders=()))

    def light(self, T_room_rig: RigidTransform, *, step: int = MOVING_STEP) -> LightImage:
        """Return the light (h, w, c) of the room and its indicators, of a rig at a pose in the room."""
        T_room_camera = T_room_rig * self.camera.T_world_camera
        lens, channels = self.camera.lens, self.camera.backdrop.shape[2]
        light = self.room.light(view_of(lens, step), T_room_camera, channels, samples=4 if step == 1 else 1)
        seen = self.room.seen_indicators(T_room_camera.apply(eye_of(lens)))
        rest = Rest(T_world_target=T_room_rig.inv())
        for source in self.camera.sources(seen, rest, 0.0, frozenset(), ()):
            source.add_to(Patch(row=0, column=0, light=light))
        return light


def _fields(lens: Lens) -> tuple[tuple[object, ...], Mirrors | None, str]:
    plain = (lens.width, lens.height, lens.focal_px, lens.centre_px, lens.skew_px, lens.distortion, lens.fisheye)
    return (plain, lens.mirrors, lens.side) if isinstance(lens, MirrorLens) else (plain, None, "")


@lru_cache(maxsize=12)
def _standing(
    room: Room, plain: tuple[object, ...], mirrors: Mirrors | None, side: str, pose: tuple[float, ...], channels: int
) -> LightImage:
    """Return the light of a room on a camera at rest, given by what can be compared, so that it is drawn once."""
    names = ("width", "height", "focal_px", "centre_px", "skew_px", "distortion", "fisheye")
    given: dict[str, Any] = dict(zip(names, plain, strict=True))
    lens = Lens(**given) if mirrors is None else MirrorLens(**given, mirrors=mirrors, side=side)
    return room.light(View(lens=lens), RigidTransform.from_matrix(np.array(pose).reshape(4, 4)), channels)


def room_backdrop(room: Room, camera: SimCamera, T_room_rig: RigidTransform) -> LightImage:
    """Return the light (h, w, c) that a camera of a rig that stands at a pose in the room gets."""
    T_room_camera = T_room_rig * camera.T_world_camera
    pose = tuple(T_room_camera.as_matrix().ravel().tolist())
    light = _standing(room, *_fields(camera.lens), pose, camera.backdrop.shape[2]).copy()
    onlooker = Onlooker.of(room, camera)
    seen = room.seen_indicators(T_room_camera.apply(eye_of(camera.lens)))
    for source in onlooker.camera.sources(seen, Rest(T_world_target=T_room_rig.inv()), 0.0, frozenset(), ()):
        source.add_to(Patch(row=0, column=0, light=light))
    return light


def picture_backdrop(path: str, camera: SimCamera) -> LightImage:
    """Return the light (h, w, c) behind a picture that the camera would deliver, cut and scaled to fill its image."""
    height, width, channels = camera.backdrop.shape
    mode = cv2.IMREAD_COLOR if channels == 3 else cv2.IMREAD_GRAYSCALE
    there = is_utf8(path) and Path(path).is_file()  # OpenCV writes of a missing file to stderr
    picture = cv2.imread(path, mode) if there else None
    if picture is None:
        raise Inconsistent(
            f"room.picture: {path} is not a picture that can be read", cure="Give the path of a PNG or JPEG file"
        )
    scale = max(width / picture.shape[1], height / picture.shape[0])
    size = (max(round(scale * picture.shape[1]), width), max(round(scale * picture.shape[0]), height))
    way = cv2.INTER_AREA if scale < 1.0 else cv2.INTER_LINEAR
    large = cv2.resize(picture, size, interpolation=way)
    j, i = (size[1] - height) // 2, (size[0] - width) // 2
    light = camera.pipeline.decode(large[j : j + height, i : i + width]).reshape(height, width, channels)
    return np.ascontiguousarray(light, dtype=np.float32)


def stand_in_room(
    cameras: Mapping[str, SimCamera],
    room: Room | RoomKeys,
    T_room_rig: RigidTransform,
    occluders: Sequence[Occluder] = (),
) -> dict[str, SimCamera]:
    """Return cameras at rest before a room, or the pictures of its keys; their backdrops (hot pixels) stay on it.

    Two views through mirrors share a sensor: each gives it half its light.
    """
    lights = {
        side: picture_backdrop(room.picture_of(side), camera)
        if isinstance(room, RoomKeys)
        else room_backdrop(room, camera, T_room_rig)
        for side, camera in cameras.items()
    }
    if any(isinstance(camera.lens, MirrorLens) for camera in cameras.values()):
        shared = np.asarray(MIRROR_SHARE * sum(lights.values()), dtype=np.float32)
        lights = dict.fromkeys(lights, shared)
    return {
        side: replace(camera, backdrop=lights[side] + camera.backdrop, occluders=tuple(occluders))
        for side, camera in cameras.items()
    }


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MovingBackdrops:
    """What the cameras of a rig that moves see of a room, frame by frame; hot pixels stay where they are."""

    onlookers: Mapping[str, Onlooker]
    glow: Mapping[str, LightImage]
    T_world_room: RigidTransform

    @classmethod
    def of(cls, cameras: Mapping[str, SimCamera], room: Room, T_world_room: RigidTransform) -> MovingBackdrops:
        """Return those of a rig's cameras; what they see without the room (hot pixels) is added to it."""
        return cls(
            onlookers={side: Onlooker.of(room, camera) for side, camera in cameras.items()},
            glow={side: camera.backdrop for side, camera in cameras.items()},
            T_world_room=T_world_room,
        )

    def light(self, side: str, T_world_rig: RigidTransform) -> LightImage:
        """Return the light (h, w, c) on the camera of a side, or of 'image' on the one sensor behind mirrors."""
        T_room_rig = self.T_world_room.inv() * T_world_rig
        if side != "image":
            return self.onlookers[side].light(T_room_rig) + self.glow[side]
        both = sum(onlooker.light(T_room_rig) for onlooker in self.onlookers.values())
        return np.asarray(MIRROR_SHARE * both + self.glow["left"], dtype=np.float32)
