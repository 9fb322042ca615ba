"""Furnished rooms, by name: nothing stands between the rig and the target, or where it moves.

A room is made once for its spec and seen by cameras that stand or move.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.arrays import Array
from armsight.errors import Inconsistent
from armsight_sim.lens import Lens
from armsight_sim.render import LightImage
from armsight_sim.rigs import MirrorLens
from armsight_sim.rooms import textures as tx
from armsight_sim.rooms.furniture import AHEAD, DOWN, LEFT, RIGHT, Furnisher
from armsight_sim.rooms.kernels import meet_scene
from armsight_sim.rooms.scene import RAYS, Panel, Scene, Texture, View
from armsight_sim.scene import Light

Rng = np.random.Generator


@dataclass(frozen=True, slots=True, kw_only=True)
class Layout:
    """Where a room may stand, from an eye at the origin that looks along z, y down.

    depth_m: of the wall ahead. clear_m: up to here the middle stays free. floor_m: y of the floor. low_m: y below which
    things may stand also between.
    """

    depth_m: float = 3.2
    clear_m: float = 1.3
    floor_m: float = 1.1
    low_m: float = 0.35

    @property
    def half_width_m(self) -> float:
        """Half the width of the room."""
        return 0.5 + 0.75 * self.depth_m

    @property
    def top_m(self) -> float:
        """Where the ceiling is."""
        return self.floor_m - max(2.6, 0.9 + 0.6 * self.depth_m)

    @property
    def behind_m(self) -> float:
        """How far behind the eye the room ends."""
        return 1.5


def workshop(layout: Layout, rng: Rng) -> Furnisher:
    """Return a workshop: brick or plaster, a window, benches, shelves, tools, machines with lights, cables."""
    made = Furnisher(rng)
    wall: tuple[Texture, float] = (
        (tx.brick(rng, (0.16, 0.21, 0.36)), 2.0) if rng.uniform() < 0.5 else (tx.plaster(rng, (0.42, 0.47, 0.50)), 2.5)
    )
    _enclose(made, layout, wall, (tx.concrete(rng, (0.26, 0.28, 0.29)), 3.0))
    w, depth, floor = layout.half_width_m, layout.depth_m, layout.floor_m
    mirror = -1.0 if rng.uniform() < 0.5 else 1.0
    view = 0.6 * depth  # about half of what a webcam sees at the wall
    made.window((mirror * max(0.62 * view, 1.08), floor - 1.75, depth), AHEAD, (0.9, 1.0), 6.0)
    made.window((-mirror * w, floor - 1.6, 0.55 * depth), LEFT if mirror > 0 else RIGHT, (1.6, 1.1), 6.0)
    made.bench((mirror * 0.25 * view, floor, depth - 0.4), (1.7, 0.85, 0.65))
    _on_bench(made, mirror * 0.25 * view, floor - 0.85, depth - 0.45)
    made.shelf((-mirror * 0.68 * view, floor, depth - 0.3), (0.95, 2.0, 0.42), 5)
    _tools(made, (mirror * 0.04 * view, floor - 1.55, depth - 0.015))
    _papers(made, (-mirror * 0.18 * view, floor - 1.7, depth - 0.006), -mirror)
    _cables(made, layout, 5)
    steel = tx.metal(rng, (0.5, 0.5, 0.5))
    for n in range(3):
        x = mirror * (0.93 + 0.05 * n) * view
        made.pipe((x, floor - 0.5 * (floor - layout.top_m), depth - 0.07), 0.018, floor - layout.top_m, steel)
    grey = tx.paint(rng, (0.36, 0.38, 0.36))
    made.box(
        (-mirror * 0.15 * view, floor - 0.75, depth - 0.28),
        (0.5, 1.5, 0.45),
        grey,
        front=tx.cabinet(rng),
        gloss=0.15,
        exponent=40.0,
    )
    for n in range(4):
        made.indicator((-mirror * 0.15 * view - 0.15 + 0.1 * n, floor - 1.3, depth - 0.508))
    _tape(made, layout)
    _near_things(made, layout, 6)
    _litter(made, layout, 12)
    return made


def office(layout: Layout, rng: Rng) -> Furnisher:
    """Return an office: light plaster, a large window, desks with monitors, book shelves, posters."""
    made = Furnisher(rng)
    _enclose(
        made, layout, (tx.plaster(rng, (0.66, 0.70, 0.72)), 2.5), (tx.wood(rng, (0.16, 0.27, 0.40), (512, 512)), 1.6)
    )
    depth, floor, view = layout.depth_m, layout.floor_m, 0.6 * layout.depth_m
    mirror = -1.0 if rng.uniform() < 0.5 else 1.0
    made.window((-mirror * 0.55 * view, floor - 1.7, depth), AHEAD, (1.3, 1.2), 7.0)
    made.window(
        (mirror * layout.half_width_m, floor - 1.6, 0.5 * depth), RIGHT if mirror > 0 else LEFT, (1.8, 1.2), 7.0
    )
    made.bench((mirror * 0.35 * view, floor, depth - 0.5), (1.6, 0.74, 0.75))
    for n, x in enumerate((0.15, 0.55)):
        made.monitor(
            (mirror * x * view, floor - 0.74 - 0.31, depth - 0.45), 0.52, 1.6, float(rng.normal(0.0, 12.0)) + n
        )
    made.row_of_boxes((mirror * 0.6 * view, mirror * 0.6 * view + 0.5), floor - 0.74, depth - 0.4, (0.06, 0.2), 0.25)
    made.shelf((mirror * 0.9 * view, floor, depth - 0.2), (0.8, 1.9, 0.3), 5)
    _papers(made, (mirror * 0.25 * view, floor - 1.75, depth - 0.006), mirror)
    made.instrument((mirror * 0.85 * view, floor - 0.8, depth - 0.5), (0.3, 0.1, 0.25), 4)
    _cables(made, layout, 2)
    _near_things(made, layout, 3)
    _litter(made, layout, 5)
    return made


def plain(layout: Layout, rng: Rng) -> Furnisher:
    """Return a nearly empty room: plaster, skirting, a socket, one ceiling lamp."""
    made = Furnisher(rng)
    _enclose(made, layout, (tx.plaster(rng, (0.55, 0.58, 0.60)), 2.5), (tx.concrete(rng, (0.30, 0.31, 0.32)), 3.0))
    x = float(rng.uniform(-0.4, 0.4)) * layout.depth_m
    socket = tx.paint(rng, (0.75, 0.76, 0.76), 48)
    made.box((x, layout.floor_m - 0.3, layout.depth_m - 0.01), (0.16, 0.08, 0.02), socket)
    made.indicator((x + 0.05, layout.floor_m - 0.3, layout.depth_m - 0.022))
    return made


PRESETS: Mapping[str, Callable[[Layout, Rng], Furnisher]] = {"workshop": workshop, "office": office, "plain": plain}


def _enclose(made: Furnisher, layout: Layout, walls: tuple[Texture, float], floor: tuple[Texture, float]) -> None:
    """Add walls, floor, ceiling, skirting and the ceiling's lamps."""
    ceiling = (tx.plaster(made.rng, (0.70, 0.72, 0.73), 384), 2.5)
    made.shell(
        layout.half_width_m, layout.top_m, layout.floor_m, layout.depth_m, layout.behind_m, walls, floor, ceiling
    )
    made.skirting(layout.half_width_m, layout.floor_m, layout.depth_m)
    for z in (0.15, 0.72):
        for x in (-0.5, 0.5):
            position = (x * layout.half_width_m, layout.top_m + 0.12, z * layout.depth_m)
            made.tube(position, 1.2, float(made.rng.uniform(14.0, 20.0)))


def _on_bench(made: Furnisher, x: float, top: float, z: float) -> None:
    """Put instruments, a monitor, a vice and a lamp on a bench."""
    rng = made.rng
    made.instrument((x - 0.55, top - 0.07, z), (0.36, 0.14, 0.3), 5, float(rng.normal(0.0, 8.0)))
    made.instrument((x - 0.52, top - 0.19, z + 0.02), (0.32, 0.10, 0.28), 3, float(rng.normal(0.0, 4.0)))
    made.monitor((x + 0.05, top - 0.30, z + 0.05), 0.5, 1.5, float(rng.normal(0.0, 10.0)))
    steel = tx.metal(rng, (0.40, 0.42, 0.42))
    made.pipe((x + 0.42, top - 0.09, z - 0.05), 0.035, 0.18, steel)
    made.box((x + 0.56, top - 0.06, z), (0.12, 0.12, 0.2), steel, yaw_deg=25.0, gloss=1.2, exponent=50.0)
    made.box(
        (x + 0.3, top - 0.03, z - 0.15), (0.2, 0.06, 0.12), tx.cardboard(rng, 128), yaw_deg=float(rng.normal(0, 20))
    )
    bulb = tx.stored(np.ones((8, 8, 3)) * np.array([0.55, 0.82, 1.0]))
    black = tx.paint(rng, (0.03, 0.03, 0.03), 32)
    made.box((x + 0.72, top - 0.25, z), (0.02, 0.5, 0.02), black)
    made.box((x + 0.68, top - 0.52, z), (0.16, 0.04, 0.1), black)
    made.panel((x + 0.68, top - 0.52, z - 0.052), AHEAD, (0.13, 0.03), bulb, glow=30.0, lamp=True)


def _tools(made: Furnisher, xyz_m: tuple[float, float, float]) -> None:
    """Hang tools on a board on the wall."""
    x, y, z = xyz_m
    made.panel((x, y, z), AHEAD, (0.9, 0.5), tx.paint(made.rng, (0.28, 0.24, 0.20)))
    kinds = ("spanner", "driver", "hammer")
    for n in range(7):
        tall = float(made.rng.uniform(0.16, 0.32))
        drawn = tx.tool(made.rng, kinds[int(made.rng.integers(3))])
        made.panel((x - 0.38 + 0.125 * n, y - 0.2 + 0.5 * tall, z - 0.015), AHEAD, (tall / 3.0, tall), drawn, gloss=0.9)


def _papers(made: Furnisher, xyz_m: tuple[float, float, float], towards: float) -> None:
    """Hang a poster on the wall and a printed checkerboard beside it; towards: 1 to its right, -1 to its left."""
    x, y, z = xyz_m
    made.panel((x, y, z), AHEAD, (0.42, 0.594), tx.poster(made.rng))
    made.panel((x + 0.42 * towards, y + 0.05, z), AHEAD, (0.36, 0.28), tx.checkerboard(8, 6))


def _cables(made: Furnisher, layout: Layout, count: int) -> None:
    """Hang cables on the wall ahead."""
    for _ in range(count):
        tall = float(made.rng.uniform(0.8, 1.6))
        x = float(made.rng.uniform(-0.55, 0.55)) * layout.depth_m
        tone = float(made.rng.choice([0.015, 0.03, 0.25]))
        y = layout.floor_m - 0.35 - 0.5 * tall - float(made.rng.uniform(0.0, 0.6))
        drawn = tx.cable(made.rng, (tone, tone, tone), thick=int(made.rng.integers(4, 9)))
        made.panel((x, y, layout.depth_m - 0.03), AHEAD, (0.5 * tall, tall), drawn)


def _tape(made: Furnisher, layout: Layout) -> None:
    """Stick warning tape on the floor."""
    yellow = tx.paint(made.rng, (0.03, 0.50, 0.62), 64)
    position = (0.0, layout.floor_m - 0.002, layout.depth_m - 1.0)
    made.panel(position, DOWN, (1.8 * layout.half_width_m, 0.06), yellow)


def _near_things(made: Furnisher, layout: Layout, count: int) -> None:
    """Put boxes on the floor: low ones anywhere, tall ones beyond what must stay clear."""
    rng, clear = made.rng, layout.clear_m + 0.3
    for _ in range(count):
        wide, tall, deep = rng.uniform((0.12, 0.08, 0.12), (0.45, 0.3, 0.4)).tolist()
        if rng.uniform() < 0.5:
            z, tall = float(rng.uniform(clear, max(layout.depth_m - 0.8, clear + 0.1))), 1.6 * tall
        else:
            z, tall = float(rng.uniform(0.5, clear)), min(tall, 0.8 * (layout.floor_m - layout.low_m))
        x, yaw = float(rng.uniform(-0.6, 0.6)) * z, float(rng.uniform(-40.0, 40.0))
        made.any_box((x, layout.floor_m - 0.5 * tall, z), (wide, tall, deep), yaw)


def _litter(made: Furnisher, layout: Layout, count: int) -> None:
    """Lay flat things on the floor or the table below the target: tools, cables, sheets, plates of bare metal."""
    rng = made.rng
    for _ in range(count):
        z = float(rng.uniform(-0.2, layout.clear_m + 0.3))
        position = (float(rng.uniform(-0.7, 0.7)) * max(z, 0.5), layout.floor_m - float(rng.uniform(0.002, 0.006)), z)
        turn = DOWN @ Rotation.from_euler("z", float(rng.uniform(0.0, 360.0)), degrees=True).as_matrix()
        kind = int(rng.integers(5))
        tall = float(rng.uniform(0.15, 0.3))
        if kind == 0:
            made.panel(position, turn, (tall / 3.0, tall), tx.tool(rng, "spanner"), gloss=0.9)
        elif kind == 1:
            made.panel(position, turn, (tall / 3.0, tall), tx.tool(rng, "driver"), gloss=0.5)
        elif kind == 2:
            made.panel(position, turn, (1.5 * tall, 3.0 * tall), tx.cable(rng, (0.02, 0.02, 0.02), thick=5))
        elif kind == 3:
            made.panel(position, turn, (0.21, 0.297), tx.poster(rng))
        else:
            made.panel(position, turn, (0.8 * tall, tall), tx.metal(rng, (0.45, 0.46, 0.46)), gloss=1.5, exponent=60.0)


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

    def light(self, view: View, T_room_camera: RigidTransform, channels: int, samples: int = RAYS) -> LightImage:
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
