"""Things that stand in rooms, put together from panels. Room axes: x right, y down, z forward, from the eye."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.arrays import Array
from armsight_sim.rooms import textures as tx
from armsight_sim.rooms.scene import EXPONENT, Panel, Texture
from armsight_sim.scene import Light

Vector = tuple[float, float, float]

AHEAD, LEFT, RIGHT, DOWN, UP, BACK = (
    np.array([[1, 0, 0], [0, 1, 0], [0, 0, 1]]),
    np.array([[0, 0, -1], [0, 1, 0], [1, 0, 0]]),
    np.array([[0, 0, 1], [0, 1, 0], [-1, 0, 0]]),
    np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0]]),
    np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]]),
    np.array([[-1, 0, 0], [0, 1, 0], [0, 0, -1]]),
)
"""Rotations of panels by where one looks to see them: the wall ahead, on the left, ..., floor, ceiling, behind."""

BOX_COLOURS = ((0.45, 0.12, 0.05), (0.06, 0.10, 0.55), (0.05, 0.38, 0.62), (0.10, 0.32, 0.08), (0.30, 0.30, 0.30))
"""Blue, red, yellow, green and grey plastic, in blue, green, red."""

LED_COLOURS = ((0.10, 1.0, 0.08), (0.06, 0.10, 1.0), (1.0, 1.0, 1.0), (1.0, 0.45, 0.10), (0.10, 0.60, 1.0))
"""Of indicators: green, red, white, blue, amber."""


@dataclass(slots=True)
class Furnisher:
    """Collects a room's panels and indicators."""

    rng: np.random.Generator
    panels: list[Panel] = field(default_factory=list)
    lights: list[Light] = field(default_factory=list)

    def panel(self, xyz_m: Vector, turn: Array, size_m: tuple[float, float], texture: Texture, **look: object) -> Panel:
        """Add a panel by its middle, a rotation of T_room_panel and a size; look: what else Panel takes."""
        made = Panel(
            T_room_panel=RigidTransform.from_components(list(xyz_m), Rotation.from_matrix(turn)),
            size_m=size_m,
            texture=texture,
            **look,  # type: ignore[arg-type]
        )
        self.panels.append(made)
        return made

    def box(
        self,
        xyz_m: Vector,
        size_m: Vector,
        texture: Texture,
        *,
        yaw_deg: float = 0.0,
        front: Texture | None = None,
        gloss: float = 0.0,
        exponent: float = EXPONENT,
        tile_m: float | None = None,
    ) -> None:
        """Add a box (all but its bottom) by its middle and its width, height and depth, turned about the vertical."""
        R = Rotation.from_euler("y", yaw_deg, degrees=True).as_matrix()
        w, h, d = size_m
        for turn, offset, size in (
            (AHEAD, (0.0, 0.0, -0.5 * d), (w, h)),
            (BACK, (0.0, 0.0, 0.5 * d), (w, h)),
            (RIGHT, (-0.5 * w, 0.0, 0.0), (d, h)),
            (LEFT, (0.5 * w, 0.0, 0.0), (d, h)),
            (DOWN, (0.0, -0.5 * h, 0.0), (w, d)),
        ):
            x, y, z = np.asarray(xyz_m) + R @ np.array(offset)
            face = front if turn is AHEAD and front is not None else texture
            tile = None if tile_m is None or face is front else (tile_m, tile_m)
            self.panel((x, y, z), R @ turn, size, face, gloss=gloss, exponent=exponent, tile_m=tile)

    def pipe(self, xyz_m: Vector, radius_m: float, length_m: float, texture: Texture, *, sides: int = 12) -> None:
        """Add an upright shiny pipe by its middle, as a prism."""
        across = 2.0 * radius_m * np.tan(np.pi / sides)
        for n in range(sides):
            R = Rotation.from_euler("y", 360.0 * n / sides, degrees=True).as_matrix()
            x, y, z = np.asarray(xyz_m) + R @ np.array([0.0, 0.0, -radius_m])
            self.panel((x, y, z), R @ AHEAD, (across, length_m), texture, gloss=2.5, exponent=60.0)

    def shell(
        self,
        half_width_m: float,
        top_m: float,
        floor_m: float,
        depth_m: float,
        behind_m: float,
        walls: tuple[Texture, float],
        floor: tuple[Texture, float],
        ceiling: tuple[Texture, float],
    ) -> None:
        """Add walls, floor and ceiling, each with its texture and the size of one copy of it."""
        tall, long = floor_m - top_m, depth_m + behind_m
        middle_y, middle_z = 0.5 * (floor_m + top_m), 0.5 * (depth_m - behind_m)
        wall, wall_m = walls
        for turn, position, size in (
            (AHEAD, (0.0, middle_y, depth_m), (2.0 * half_width_m, tall)),
            (BACK, (0.0, middle_y, -behind_m), (2.0 * half_width_m, tall)),
            (LEFT, (-half_width_m, middle_y, middle_z), (long, tall)),
            (RIGHT, (half_width_m, middle_y, middle_z), (long, tall)),
        ):
            self.panel(position, turn, size, wall, tile_m=(wall_m, wall_m))
        for turn, y, (texture, tile_m) in ((DOWN, floor_m, floor), (UP, top_m, ceiling)):
            self.panel((0.0, y, middle_z), turn, (2.0 * half_width_m, long), texture, tile_m=(tile_m, tile_m))

    def skirting(self, half_width_m: float, floor_m: float, depth_m: float) -> None:
        """Add the skirting board of the wall ahead and of the sides, and the line it draws along the floor."""
        strip = tx.paint(self.rng, (0.10, 0.11, 0.12), 32)
        y = floor_m - 0.05
        self.panel((0.0, y, depth_m - 0.012), AHEAD, (2.0 * half_width_m, 0.1), strip)
        self.panel((0.012 - half_width_m, y, 0.5 * depth_m), LEFT, (depth_m, 0.1), strip)
        self.panel((half_width_m - 0.012, y, 0.5 * depth_m), RIGHT, (depth_m, 0.1), strip)

    def window(self, xyz_m: Vector, turn: Array, size_m: tuple[float, float], glow: float) -> None:
        """Add an over-exposed window in a wall, with its frame, bars and sill, by its middle."""
        w, h = size_m
        frame = tx.paint(self.rng, (0.62, 0.64, 0.65), 48)
        away = turn[:, 2]
        self._flush(xyz_m, turn, (0.0, 0.0), size_m, tx.daylight(self.rng), -0.004 * away, glow=glow, lamp=True)
        sides = [(x, 0.0, (0.06, h + 0.06)) for x in (-0.5 * w, 0.5 * w)]
        lintel, sill = (0.0, -0.5 * h, (w, 0.06)), (0.0, 0.5 * h, (w + 0.1, 0.08))
        bars = [(0.0, 0.0, (0.045, h)), (0.0, -0.2 * h, (w, 0.03))]
        for x, y, size in (*sides, lintel, sill, *bars):
            self._flush(xyz_m, turn, (x, y), size, frame, -0.02 * away)

    def _flush(
        self,
        xyz_m: Vector,
        turn: Array,
        at_m: tuple[float, float],
        size_m: tuple[float, float],
        texture: Texture,
        lift_m: Array,
        **look: object,
    ) -> None:
        """Add a panel at a place of another one's face."""
        x, y, z = np.asarray(xyz_m) + turn[:, 0] * at_m[0] + turn[:, 1] * at_m[1] + lift_m
        self.panel((x, y, z), turn, size_m, texture, **look)

    def tube(self, xyz_m: Vector, length_m: float, glow: float, *, across: bool = True) -> None:
        """Add a ceiling lamp: a bright tray that shines down, with a rim that is seen from the side."""
        size = (length_m, 0.16) if across else (0.16, length_m)
        white = tx.stored(np.ones((8, 8, 3)) * np.array([0.92, 0.97, 1.0]))
        x, y, z = xyz_m
        self.panel((x, y, z), UP, size, white, glow=glow, lamp=True)
        rim = tx.stored(np.ones((8, 8, 3)) * np.array([0.92, 0.97, 1.0]))
        self.panel((x, y - 0.02, z - 0.5 * size[1]), AHEAD, (size[0], 0.05), rim, glow=0.6 * glow)

    def shelf(self, xyz_m: Vector, size_m: Vector, boards: int) -> None:
        """Add a shelf, open to the front, full of boxes; xyz_m: the middle of its foot."""
        x, y, z = xyz_m
        w, h, d = size_m
        steel = tx.metal(self.rng, (0.30, 0.28, 0.26), (128, 128))
        for sx in (-0.5, 0.5):
            for sz in (-0.5, 0.5):
                self.box((x + sx * w, y - 0.5 * h, z + sz * d), (0.035, h, 0.035), steel, gloss=0.3)
        pitch = h / boards
        board = tx.wood(self.rng, (0.22, 0.36, 0.48), (128, 384))
        for n in range(boards):
            top = y - n * pitch - 0.06
            self.box((x, top + 0.0125, z), (w, 0.025, d), board)
            self.row_of_boxes((x - 0.48 * w, x + 0.48 * w), top, z - 0.06, (0.3 * pitch, 0.78 * pitch), 0.7 * d)

    def row_of_boxes(
        self, between_m: tuple[float, float], top_m: float, z_m: float, heights_m: tuple[float, float], depth_m: float
    ) -> None:
        """Add boxes of cardboard and plastic side by side on a board whose top is at y = top_m."""
        at = between_m[0] + self.rng.uniform(0.0, 0.06)
        while at < between_m[1] - 0.08:
            wide, tall = self.rng.uniform(0.07, 0.30), self.rng.uniform(*heights_m)
            wide = min(wide, between_m[1] - at)
            if self.rng.uniform() < 0.85:
                yaw = float(self.rng.normal(0.0, 4.0))
                self.any_box((at + 0.5 * wide, top_m - 0.5 * tall, z_m), (0.92 * wide, tall, 0.8 * depth_m), yaw)
            at += wide + self.rng.uniform(0.005, 0.05)

    def any_box(self, xyz_m: Vector, size_m: Vector, yaw_deg: float) -> None:
        """Add a box of cardboard or of coloured plastic, whichever is drawn."""
        if self.rng.uniform() < 0.45:
            self.box(xyz_m, size_m, tx.cardboard(self.rng, 160), yaw_deg=yaw_deg)
            return
        colour = BOX_COLOURS[int(self.rng.integers(len(BOX_COLOURS)))]
        shade = float(self.rng.uniform(0.5, 1.2))
        b, g, r = (shade * c for c in colour)
        self.box(xyz_m, size_m, tx.paint(self.rng, (b, g, r), 96), yaw_deg=yaw_deg, gloss=0.12, exponent=25.0)

    def bench(self, xyz_m: Vector, size_m: Vector) -> None:
        """Add a workbench by the middle of its foot: a wooden top on steel legs, a drawer unit below."""
        x, y, z = xyz_m
        w, h, d = size_m
        steel = tx.metal(self.rng, (0.20, 0.22, 0.22), (128, 128))
        self.box((x, y - h + 0.02, z), (w, 0.04, d), tx.wood(self.rng, (0.26, 0.42, 0.56)), tile_m=1.2)
        for sx in (-0.46, 0.46):
            for sz in (-0.42, 0.42):
                self.box((x + sx * w, y - 0.5 * h + 0.02, z + sz * d), (0.05, h - 0.04, 0.05), steel, gloss=0.2)
        drawers = tx.paint(self.rng, (0.35, 0.20, 0.10), 96)
        for n in range(3):
            tall = (h - 0.15) / 3.0
            middle = y - h + 0.08 + (n + 0.5) * tall
            self.box((x + 0.3 * w, middle, z), (0.3 * w, 0.94 * tall, 0.8 * d), drawers, gloss=0.1)
            self.box((x + 0.3 * w, middle - 0.2 * tall, z - 0.42 * d), (0.1, 0.015, 0.02), steel, gloss=1.0)

    def instrument(self, xyz_m: Vector, size_m: Vector, leds: int, yaw_deg: float = 0.0) -> None:
        """Add an instrument by its middle, with indicators on its front."""
        case = tx.paint(self.rng, (0.22, 0.22, 0.22), 64)
        self.box(xyz_m, size_m, case, front=tx.devices(self.rng), yaw_deg=yaw_deg, gloss=0.05)
        R = Rotation.from_euler("y", yaw_deg, degrees=True).as_matrix()
        for n in range(leds):
            at = np.array([(-0.42 + 0.1 * n) * size_m[0], 0.36 * size_m[1], -0.5 * size_m[2] - 0.002])
            x, y, z = np.asarray(xyz_m) + R @ at
            self.indicator((x, y, z), facing=(float(-R[0, 2]), 0.0, float(-R[2, 2])))

    def indicator(self, xyz_m: Vector, facing: Vector = (0.0, 0.0, -1.0)) -> None:
        """Add a small light of a drawn colour and brightness, as machines carry them."""
        colour = LED_COLOURS[int(self.rng.integers(len(LED_COLOURS)))]
        level = float(self.rng.choice([60.0, 120.0, 200.0, 400.0]))
        self.lights.append(
            Light(
                name=f"indicator {len(self.lights) + 1}",
                xyz_m=xyz_m,
                level=level,
                sigma_px=float(self.rng.uniform(0.9, 2.0)),
                facing=facing,
                bgr=colour,
            )
        )

    def monitor(self, xyz_m: Vector, width_m: float, glow: float, yaw_deg: float = 0.0) -> None:
        """Add a monitor by the middle of its screen, on a foot."""
        tall = 0.5625 * width_m
        black = tx.paint(self.rng, (0.02, 0.02, 0.02), 32)
        x, y, z = xyz_m
        R = Rotation.from_euler("y", yaw_deg, degrees=True).as_matrix()
        self.box((x, y, z), (width_m + 0.03, tall + 0.03, 0.04), black, yaw_deg=yaw_deg, gloss=0.06)
        sx, sy, sz = np.asarray(xyz_m) + R @ np.array([0.0, 0.0, -0.022])
        self.panel((sx, sy, sz), R @ AHEAD, (width_m, tall), tx.screen(self.rng), glow=glow)
        self.box((x, y + 0.5 * tall + 0.06, z + 0.03), (0.06, 0.12, 0.05), black, gloss=0.06)
        self.box((x, y + 0.5 * tall + 0.125, z), (0.24, 0.012, 0.18), black, gloss=0.06)
