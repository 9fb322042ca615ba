"""What a room is made of: textured rectangles at places, lit once; and what a lens sees of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from armsight.arrays import Array
from armsight.errors import Inconsistent
from armsight_sim.lens import Lens
from armsight_sim.rigs import MirrorLens
from armsight_sim.rooms.kernels import LEVELS, SQUARE, cast_scene, light_scene

Bytes = NDArray[np.uint8]
Indices = NDArray[np.int64]

MAP_CELL_M, MAP_CELLS = 0.11, (3, 44)
"""Pitch of the light worked out on a rectangle, and the least and most places along a side: shadows are soft."""

LARGE_M2 = 0.004
"""Panels smaller than this throw no shadows."""

WALL_M2, BOX_PANELS, BOX_EDGE_M = 1.0, 3, 1e-6
"""Panels larger than this are looked at first; most panels in an innermost box; what a box is larger than they are, for
rounding."""

LAMP_CELL_M, LAMP_CELLS = 0.3, 5
"""Pitch and most places along a side from which a lamp's rectangle shines."""

AROUND, TURNS = 24, 16
"""Directions in which a place looks about for light from all sides, and how many different sets of them there are."""

AMBIENT = 0.25
"""Light from all sides, before the room's mean is made 1. Chosen: shadows keep a third of the light."""


EXPONENT = 30.0
"""Sharpness of the lamps' highlights."""
RAYS = 4
"""Rays to a pixel."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Texture:
    """A picture (h, w, 4) uint8: square roots of the reflectance of blue, green and red (255: white), and coverage.

    mean: reflectance (3,) where it covers. cut_out: whether it leaves holes.
    """

    bytes: Bytes
    mean: Array = field(init=False, repr=False)
    cut_out: bool = field(init=False)

    def __post_init__(self) -> None:
        if self.bytes.dtype != np.uint8 or self.bytes.ndim != 3 or self.bytes.shape[2] != 4 or not self.bytes.size:
            raise Inconsistent(f"a texture of shape {self.bytes.shape} and type {self.bytes.dtype} cannot be")
        copied = self.bytes.copy()
        copied.setflags(write=False)
        object.__setattr__(self, "bytes", copied)
        weight = copied[:, :, 3:].astype(np.float32)
        mean = (SQUARE[copied[:, :, :3]] * weight).sum(axis=(0, 1), dtype=np.float64) / max(float(weight.sum()), 1.0)
        object.__setattr__(self, "mean", mean)
        object.__setattr__(self, "cut_out", bool((copied[:, :, 3] < 255).any()))

    def levels(self) -> list[Bytes]:
        """Return it and ever coarser copies; the mean is taken of the reflectance, not of its root."""
        found, light = [self.bytes], np.dstack([SQUARE[self.bytes[:, :, :3]], self.bytes[:, :, 3] / np.float32(255.0)])
        while len(found) < LEVELS and min(light.shape[:2]) >= 4:
            size = (light.shape[1] // 2, light.shape[0] // 2)
            light = cv2.resize(light, size, interpolation=cv2.INTER_AREA)
            coded = np.dstack([np.sqrt(light[:, :, :3]), light[:, :, 3]])
            found.append(np.round(255.0 * coded).astype(np.uint8))
        return found


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Panel:
    """A textured rectangle, seen from one side. Axes as a board's: x right, y down, z away from who sees it.

    T_room_panel: pose of its middle. size_m: width, height. tile_m: size of one copy of the texture; None: the panel's.
    glow: how bright it shines by itself, 1 as white in the room's mean light; 0 for what is lit. gloss,
    exponent: strength and sharpness of the lamps' highlights. lamp: whether its glow lights the room.
    """

    T_room_panel: RigidTransform
    size_m: tuple[float, float]
    texture: Texture
    tile_m: tuple[float, float] | None = None
    glow: float = 0.0
    gloss: float = 0.0
    exponent: float = EXPONENT
    lamp: bool = False

    def __post_init__(self) -> None:
        if not min(*self.size_m, *(self.tile_m or (1.0, 1.0))) > 0.0:
            raise Inconsistent(f"a panel of {self.size_m} m with tiles of {self.tile_m} m cannot be")
        if not (self.glow >= 0.0 and self.gloss >= 0.0 and self.exponent > 0.0):
            raise Inconsistent("glow, gloss and exponent of a panel are not negative")

    @property
    def geometry(self) -> Array:
        """Corner and axes (12,) as the kernels take them."""
        M = self.T_room_panel.as_matrix()
        corner = M[:3, 3] - 0.5 * self.size_m[0] * M[:3, 0] - 0.5 * self.size_m[1] * M[:3, 1]
        return np.concatenate([corner, M[:3, 0], M[:3, 1], M[:3, 2]])

    @property
    def corners(self) -> Array:
        """Return its corners (4, 3)."""
        g, (wide, high) = self.geometry, self.size_m
        return np.array([g[:3] + s * wide * g[3:6] + t * high * g[6:9] for s in (0.0, 1.0) for t in (0.0, 1.0)])

    def emitters(self, rng: np.random.Generator) -> Array:
        """Return the places (m, 9) from which it lights the room."""
        columns, rows = (min(LAMP_CELLS, max(1, round(side / LAMP_CELL_M))) for side in self.size_m)
        g = self.geometry
        s = (np.arange(columns)[None, :] + rng.uniform(0.2, 0.8, (rows, columns))) / columns * self.size_m[0]
        t = (np.arange(rows)[:, None] + rng.uniform(0.2, 0.8, (rows, columns))) / rows * self.size_m[1]
        places = g[:3] + s.reshape(-1, 1) * g[3:6] + t.reshape(-1, 1) * g[6:9] - 2e-3 * g[9:12]
        power = self.glow * self.texture.mean * self.size_m[0] * self.size_m[1] / (np.pi * len(places))
        n = len(places)
        return np.hstack([places, np.tile(g[9:12], (n, 1)), np.tile(power, (n, 1))])


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Scene:
    """Panels that are lit, by each other's lamps (`lit`) or evenly (`evenly`). fallen (k, 3): the light on them."""

    panels: tuple[Panel, ...]
    arrays: tuple[Any, ...] = field(repr=False)

    @classmethod
    def evenly(cls, panels: Sequence[Panel], level: float = 1.0) -> Scene:
        """Return panels on which the same light falls everywhere."""
        return cls(panels=tuple(panels), arrays=_arrays(panels, level))

    @classmethod
    def lit(cls, panels: Sequence[Panel], rng: np.random.Generator) -> Scene:
        """Return panels in the light of those that are lamps, with shadows; its mean over all of them is 1."""
        arrays = _arrays(panels, 1.0)
        emitters = [panel.emitters(rng) for panel in panels if panel.lamp]
        strong = np.vstack([*emitters, np.empty((0, 9))])
        mean = np.array([panel.texture.mean for panel in panels])
        light = np.zeros_like(arrays[8])
        large = [k for k, panel in enumerate(panels) if np.prod(panel.size_m) >= LARGE_M2]
        light_scene(arrays, mean, strong, _around(rng), AMBIENT, boxes_of(panels, large), light)
        weights = np.concatenate(
            [np.full(c * r, np.prod(p.size_m) / (c * r)) for p, (_, c, r) in zip(panels, arrays[5], strict=True)]
        )
        level = float(weights @ light.mean(axis=1) / weights.sum())
        light = _smoothed(light / np.float32(level), arrays[5])
        lamps = _highlights([panel for panel in panels if panel.lamp], level)
        return cls(panels=tuple(panels), arrays=(*arrays[:8], light, lamps))


def boxes_of(panels: Sequence[Panel], numbers: Sequence[int]) -> tuple[Array, Indices, Indices]:
    """Return panels in boxes within boxes, as the kernels' Shading: halved at the median along the longer side.

    Those as large as a wall are in the outermost alone: they are looked at first, and what is beyond them never.
    """
    corners = {k: panels[k].corners for k in numbers}
    bounds = {k: np.concatenate([places.min(axis=0), places.max(axis=0)]) for k, places in corners.items()}
    boxes: list[Array] = []
    links: list[tuple[int, int, int]] = []
    order: list[int] = []

    def enclose(within: list[int], direct: list[int]) -> None:
        """Add the box of panels, `direct` of which are in no box within, and those of the others."""
        number, first = len(boxes), len(order)
        around = np.array([bounds[k] for k in within])
        boxes.append(np.concatenate([around[:, :3].min(axis=0) - BOX_EDGE_M, around[:, 3:].max(axis=0) + BOX_EDGE_M]))
        links.append((first, first + len(direct), 0))
        order.extend(direct)
        rest = [k for k in within if k not in direct]
        if rest:
            middles = np.array([bounds[k][:3] + bounds[k][3:] for k in rest])
            along = middles[:, int(np.argmax(np.ptp(middles, axis=0)))]
            halves = np.array_split(np.argsort(along, kind="stable"), 2 if len(rest) > BOX_PANELS else 1)
            for half in halves:
                part = [rest[i] for i in half]
                enclose(part, part if len(part) <= BOX_PANELS else [])
        links[number] = (*links[number][:2], len(boxes))

    if numbers:
        enclose(list(numbers), [k for k in numbers if np.prod(panels[k].size_m) >= WALL_M2])
    return np.array(boxes).reshape(-1, 6), np.array(links, np.int64).reshape(-1, 3), np.array(order, np.int64)


def _highlights(lamps: Sequence[Panel], level: float) -> Array:
    """Return places and intensities (l, 6) of lamps, each in a row of up to four along its longer side."""
    rows = []
    for lamp in lamps:
        g, longer = lamp.geometry, int(lamp.size_m[1] > lamp.size_m[0])
        axis, count = g[3 + 3 * longer : 6 + 3 * longer], 4 if max(lamp.size_m) > 0.5 else 1
        power = lamp.glow * lamp.texture.mean * lamp.size_m[0] * lamp.size_m[1] / (np.pi * level * count)
        for s in (np.arange(count) + 0.5) / count - 0.5:
            position = np.asarray(lamp.T_room_panel.translation) + s * lamp.size_m[longer] * axis
            rows.append(np.concatenate([position, power]))
    return np.array(rows).reshape(-1, 6)


def _around(rng: np.random.Generator) -> Array:
    """Return sets (TURNS, AROUND, 3) of directions about z, as dense as the cosine to it."""
    n = np.arange(AROUND) + 0.5
    shift = rng.uniform(0.0, 1.0, (TURNS, 2))
    radius = np.sqrt((n / AROUND)[None, :])
    angle = 2.0 * np.pi * (n[None, :] * 0.618033988749895 + shift[:, :1])
    z = np.sqrt(np.maximum(1.0 - radius**2, 0.0)) + np.zeros_like(angle)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), z], axis=2)


def _smoothed(light: NDArray[np.float32], places: NDArray[np.int64]) -> NDArray[np.float32]:
    """Return the maps, each with the scatter of its few samples smoothed."""
    out = light.copy()
    for first, columns, rows in places.tolist():
        part = light[first : first + columns * rows].reshape(rows, columns, 3)
        soft = cv2.GaussianBlur(part, (3, 3), 0.8, borderType=cv2.BORDER_REPLICATE)
        out[first : first + columns * rows] = soft.reshape(-1, 3)
    return out


def _arrays(panels: Sequence[Panel], level: float) -> tuple[Any, ...]:
    """Return the scene as the kernels take it, evenly lit."""
    numbers: dict[int, int] = {}
    textures = [numbers.setdefault(id(panel.texture), len(numbers)) for panel in panels]
    distinct = {id(panel.texture): panel.texture for panel in panels}
    texels, table, first = [], np.zeros((max(len(distinct), 1), LEVELS, 3), np.int64), 0
    for key, texture in distinct.items():
        for depth, image in enumerate(texture.levels()):
            table[numbers[key], depth] = first, image.shape[1], image.shape[0]
            texels.append(image.reshape(-1, 4))
            first += image.shape[0] * image.shape[1]
    places, entries = [], 0
    for panel in panels:
        columns, rows = (int(np.clip(np.ceil(side / MAP_CELL_M), *MAP_CELLS)) for side in panel.size_m)
        places.append((entries, columns, rows))
        entries += columns * rows
    density = [
        (p.texture.bytes.shape[1] / (p.tile_m or p.size_m)[0], p.texture.bytes.shape[0] / (p.tile_m or p.size_m)[1])
        for p in panels
    ]
    look = [(p.glow, p.gloss, p.exponent, float(p.texture.cut_out)) for p in panels]
    return (
        np.array([panel.geometry for panel in panels]).reshape(-1, 12),
        np.array([panel.size_m for panel in panels], np.float64).reshape(-1, 2),
        np.array(textures, np.int64),
        np.array(density, np.float64).reshape(-1, 2),
        np.array(look, np.float64).reshape(-1, 4),
        np.array(places, np.int64).reshape(-1, 3),
        np.vstack([*texels, np.empty((0, 4), np.uint8)]),
        table,
        np.full((entries, 3), level, np.float32),
        np.zeros((0, 6)),
    )


Covered = NDArray[np.float32]
"""Light (h, w, 4): blue, green, red in the scene's unit times the share of the pixel that is covered; that share."""

SAMPLES = {
    1: ((0.5, 0.5),),
    2: ((0.25, 0.75), (0.75, 0.25)),
    4: ((0.125, 0.375), (0.375, 0.875), (0.625, 0.125), (0.875, 0.625)),
}
"""Rays a pixel, on lattices whose places differ in both coordinates."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class View:
    """The rays of a lens, or of one path through mirrors, through the corners of pixels of `step` px.

    rays, origins: (h + 1, w + 1, 3) in camera axes, for ceil(height / step) by ceil(width / step) such pixels.
    """

    lens: Lens
    step: int = 1
    rays: NDArray[np.float32] = field(init=False, repr=False)
    origins: NDArray[np.float32] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        rows, columns = -(-self.lens.height // self.step), -(-self.lens.width // self.step)
        v, u = np.mgrid[0 : rows + 1, 0 : columns + 1] * float(self.step) - 0.5
        xy = self.lens.rays(np.stack([u, v], axis=-1))
        if isinstance(self.lens, MirrorLens):
            origin, ray = self.lens.mirrors.trace(self.lens.side, xy.reshape(-1, 2))
            eye = np.asarray(self.lens.mirrors.pose(self.lens.side).translation)
            origin = origin + ((eye - origin) * ray).sum(axis=1)[:, None] * ray  # back to where all rays seem to start
            rays, origins = ray.reshape(*xy.shape[:2], 3), origin.reshape(*xy.shape[:2], 3)
        else:
            rays, origins = np.concatenate([xy, np.ones((*xy.shape[:2], 1))], axis=-1), np.zeros((1, 1, 3))
        object.__setattr__(self, "rays", np.ascontiguousarray(rays, dtype=np.float32))
        object.__setattr__(self, "origins", np.ascontiguousarray(origins, dtype=np.float32))

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of the view's pixels."""
        return self.rays.shape[0] - 1, self.rays.shape[1] - 1

    def cast(
        self,
        scene: Scene,
        T_scene_camera: RigidTransform,
        *,
        samples: int = RAYS,
        region: tuple[int, int, int, int] | None = None,
    ) -> Covered:
        """Return what a camera at a pose sees; region: rows and columns, first and past the last of each."""
        j0, j1, i0, i1 = region or (0, self.shape[0], 0, self.shape[1])
        out = np.empty((j1 - j0, i1 - i0, 4), np.float32)
        M = T_scene_camera.as_matrix()
        part = (slice(j0, j1 + 1), slice(i0, i1 + 1))
        cast_scene(
            scene.arrays,
            np.ascontiguousarray(M[:3, :3]),
            np.ascontiguousarray(M[:3, 3]),
            np.ascontiguousarray(self.rays[part]),
            self.origins if len(self.origins) == 1 else np.ascontiguousarray(self.origins[part]),
            np.array(SAMPLES[samples]),
            self.step / float(np.sqrt(self.lens.focal_px[0] * self.lens.focal_px[1])),
            out,
        )
        return out
