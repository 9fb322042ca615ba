"""From a checked scenario's keys to its cameras, the room that they see, and what goes wrong before them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.spatial.transform import RigidTransform

from armsight.arrays import Array
from armsight.errors import Inconsistent
from armsight_sim.backdrops import MovingBackdrops, make_occluders, make_room, stand_in_room
from armsight_sim.camera import SimCamera
from armsight_sim.cell import SEED_BACKDROP
from armsight_sim.lens import Cam, Lens, ZoomLens, zoomed
from armsight_sim.rigs import SIDES, MirrorLens, Mirrors, mirror_rig, mirror_views, rig_mapping
from armsight_sim.rooms.room import upright
from armsight_sim.scenario_keys import EventKeys, RoomKeys, pipeline_of
from armsight_sim.scenario_schema import CameraKeys, LensKeys, Scenario
from armsight_sim.scene import Event, Ghost, Light, Path
from armsight_sim.sensor import Sensor, ambient, with_hot_pixels

PLACES = 60
"""Moments of a run at which it is asked where the target is, so that no furniture stands there."""

STANDING_EYE_M = 1.0
"""How high above the floor a rig stands on its bench or tripod at least, where its scenario does not say."""


def _lens(keys: LensKeys, cameras: CameraKeys) -> Lens:
    n = 8 if keys.lens == "rational" else 5
    return Lens(
        width=cameras.width,
        height=cameras.height,
        focal_px=(keys.fx, keys.fy),
        centre_px=(keys.cx, keys.cy),
        distortion=tuple([*keys.distortion, *[0.0] * n][:n]),
        fisheye=keys.lens == "fisheye",
    )


def _placed(keys: LensKeys, cameras: CameraKeys, pose: RigidTransform) -> tuple[Lens, RigidTransform]:
    """Return a camera's lens and where it stands; of a zoom lens, at its setting."""
    if keys.zoom is None:
        return _lens(keys, cameras), pose
    content = keys.zoom.model_dump()
    at, (low, high), cam, bend = (content.pop(name) for name in ("at", "range", "cam", "bend"))
    wide_mm = keys.zoom.wide_mm
    made = ZoomLens(
        width=cameras.width,
        height=cameras.height,
        zoom=(low, high),
        cam=Cam(cam),
        bend=(bend[0], bend[1]),
        pitch_mm=wide_mm / keys.fx,
        aspect=keys.fy / keys.fx,
        **content,
    )
    lens, placed = zoomed(made, pose, at)
    off = [c - 0.5 * (n - 1) for c, n in zip((keys.cx, keys.cy), (cameras.width, cameras.height), strict=True)]
    cx, cy = lens.centre_px
    return replace(lens, centre_px=(cx + off[0], cy + off[1])), placed


def with_zoom(keys: CameraKeys, zoom: float) -> CameraKeys:
    """Return the cameras with every zoom lens at a value. Raises Inconsistent where there is none."""
    changed: dict[str, Any] = {}
    for side, lens in keys.lenses.items():
        if lens.zoom is not None:
            changed[side] = lens.model_copy(update={"zoom": lens.zoom.model_copy(update={"at": zoom})})
    if not changed:
        raise Inconsistent("the cameras have no zoom lens", cure="Give cameras.left.zoom, or leave the zoom away")
    pair = {side: changed.pop(side) for side in SIDES if side in changed}
    others = {"others": {**(keys.others or {}), **changed}} if changed else {}
    return keys.model_copy(update=pair | others)


def make_cameras(keys: CameraKeys, seed: int, *, ambient_level: float) -> tuple[dict[str, SimCamera], dict[str, Any]]:
    """Return the cameras of a rig in its axes, and the rig as rig.yaml has it; ambient_level: what they see so far."""
    here = RigidTransform.identity()
    if keys.mirrors is not None:
        views = mirror_views(_lens(keys.left, keys), Mirrors(**keys.mirrors.model_dump()))
        places: dict[str, tuple[Lens | MirrorLens, RigidTransform]] = {side: (views[side], here) for side in SIDES}
        rig = mirror_rig(views)
    else:
        placed = {name: _placed(lens, keys, lens.T_rig_camera.pose()) for name, lens in keys.placed.items()}
        placed = {"left": _placed(keys.left, keys, here)} | placed
        places, rig = dict(placed), rig_mapping(placed)
    sensor = Sensor(electrons_per_level=keys.sensor.electrons_per_level, read_noise_level=keys.sensor.read_noise_level)
    pipeline = pipeline_of(keys.pipeline)
    cameras = {}
    for number, (side, (lens, T_rig_camera)) in enumerate(places.items()):
        bgr = (1.0, 1.0, 1.0) if keys.colour or pipeline.bayer else (1.0,)
        room = ambient(keys.width, keys.height, ambient_level, bgr=bgr)
        if keys.sensor.hot_pixels:
            rng = np.random.default_rng([seed, SEED_BACKDROP, number])
            room = with_hot_pixels(room, keys.sensor.hot_pixels, (20.0, 120.0), rng)
        cameras[side] = SimCamera(
            lens=lens,
            T_world_camera=T_rig_camera,
            sensor=sensor,
            backdrop=room,
            exposure_s=keys.exposure_s,
            readout_s=keys.readout_s,
            pipeline=pipeline,
            grey=not keys.colour,
        )
    return cameras, rig


def set_room(
    keys: RoomKeys,
    cameras: Mapping[str, SimCamera],
    lights: Sequence[Light],
    paths: tuple[Path, Path],
    *,
    seed: int,
    until_s: float,
    stands: bool,
) -> tuple[dict[str, SimCamera], MovingBackdrops | None]:
    """Return the cameras in the room of a scenario, and where their rig moves, what they see frame by frame.

    paths: of the rig and of the target, in world axes, whose z is up.
    """
    occluders = make_occluders(keys.occluders, keys.white_level, seed)
    if keys.dark or keys.picture is not None:
        if keys.dark:
            seen = {side: replace(camera, occluders=occluders) for side, camera in cameras.items()}
        else:
            seen = stand_in_room(cameras, keys, RigidTransform.identity(), occluders)
        return seen, None
    rig_path, target_path = paths
    T_world_rig = rig_path(np.zeros(1))[0]
    T_world_room = keys.T_world_room.pose() if keys.T_world_room else upright(T_world_rig, (0.0, 0.0, 1.0))
    poses = target_path(np.linspace(0.0, until_s, PLACES))
    spots = np.array([light.xyz_m for light in lights], dtype=np.float64)
    places = np.concatenate([(T_world_room.inv() * pose).apply(spots) for pose in poses])
    rig_height = float(T_world_rig.translation[2])
    least = rig_height if rig_height > 0.5 else STANDING_EYE_M
    room = make_room(keys, places, seed, least_floor_m=least)
    if stands:
        return stand_in_room(cameras, room, T_world_room.inv() * T_world_rig, occluders), None
    carried = {side: replace(camera, occluders=occluders) for side, camera in cameras.items()}
    return carried, MovingBackdrops.of(carried, room, T_world_room)


def events_of(scenario: Scenario, kinds: tuple[str, ...]) -> tuple[Event, ...]:
    """Return the events of these kinds, by the frames that they are in."""

    def made(event: EventKeys) -> Event:
        first = int(np.ceil(event.at_s * scenario.fps - 1e-9))
        last = max(first + 1, int(np.ceil((event.at_s + event.for_s) * scenario.fps - 1e-9)))
        ghosts: tuple[Ghost, ...] = ()
        if event.kind == "reflection" and event.uv_px is not None:
            uv = (event.uv_px[0], event.uv_px[1])
            ghosts = (Ghost(uv_px=uv, level=event.level, sigma_px=scenario.target.sigma_px),)
        hidden = tuple(event.lights) if event.kind == "occluded" else ()
        return Event(first=first, last=last, side=event.side, note=event.kind, hidden=hidden, ghosts=ghosts)

    return tuple(made(event) for event in scenario.events if event.kind in kinds)


def zero_jumps(scenario: Scenario, units: Array) -> tuple[tuple[float, float, Array], ...]:
    """Return when encoders jump: from, to in s, and by how much (n,) in rad or m."""
    jumps = []
    for event in scenario.events:
        if event.kind == "encoder_jump" and event.joint is not None and event.by is not None:
            by = np.zeros(len(units))
            by[event.joint - 1] = units[event.joint - 1] * event.by
            jumps.append((event.at_s, event.at_s + event.for_s, by))
    return tuple(jumps)
