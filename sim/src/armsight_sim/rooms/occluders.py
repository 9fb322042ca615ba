"""What comes between the cameras and the target: a hand, a cable, a card, on its way from one place to another."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from armsight.arrays import Array
from armsight.errors import Inconsistent
from armsight.records import frozen_array
from armsight_sim.lens import Lens
from armsight_sim.render import Patch
from armsight_sim.rooms import textures as tx
from armsight_sim.rooms.kernels import meet_scene
from armsight_sim.rooms.room import eye_of, view_of
from armsight_sim.rooms.scene import Panel, Scene

KINDS = ("hand", "cable", "card")

EDGE_BLUR_PX = 0.8
"""Gaussian blur of an occluder by the lens, which also makes up for its one ray a pixel."""

OUTLINE = 9
"""Places along each edge of an occluder's rectangle by which its reach in the image is found."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CoverSource:
    """Light (h, w, c) that replaces a share (h, w) of what lies behind it, with its corner at [row, column]."""

    row: int
    column: int
    light: NDArray[np.float32]
    share: NDArray[np.float32]
    sigma_px: float = 0.0

    def centres_px(self) -> Array:
        """Return the corners (2, 2)."""
        height, width = self.share.shape
        return np.array([[self.column, self.row], [self.column + width - 1, self.row + height - 1]], dtype=np.float64)

    def add_to(self, patch: Patch) -> None:
        """Cover the part of the patch that it reaches."""
        height, width = self.share.shape
        j0, i0 = max(self.row, patch.row), max(self.column, patch.column)
        j1 = min(self.row + height, patch.row + patch.light.shape[0])
        i1 = min(self.column + width, patch.column + patch.light.shape[1])
        if j0 >= j1 or i0 >= i1:
            return
        mine = (slice(j0 - self.row, j1 - self.row), slice(i0 - self.column, i1 - self.column))
        there = patch.light[j0 - patch.row : j1 - patch.row, i0 - patch.column : i1 - patch.column]
        there *= 1.0 - self.share[mine][:, :, None]
        there += self.light[mine]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Occluder:
    """Something flat that faces the rig and moves evenly from from_m to to_m (3,), in the axes of the target's path.

    scene: it, about the origin. It is there from first_s to last_s.
    """

    scene: Scene
    level: float
    from_m: Array
    to_m: Array
    first_s: float
    last_s: float

    def __post_init__(self) -> None:
        for name in ("from_m", "to_m"):
            object.__setattr__(self, name, frozen_array(name, getattr(self, name), (3,)))
        if not self.last_s > self.first_s:
            raise Inconsistent(f"an occluder from {self.first_s} s to {self.last_s} s cannot be")

    def pose(self, t_s: float) -> RigidTransform | None:
        """Return where it is at a time; None before and after its way."""
        if not self.first_s <= t_s < self.last_s:
            return None
        share = (t_s - self.first_s) / (self.last_s - self.first_s)
        return RigidTransform.from_translation(self.from_m + share * (self.to_m - self.from_m))

    def source(self, lens: Lens, T_world_camera: RigidTransform, t_s: float, channels: int) -> CoverSource | None:
        """Return what it covers in a camera's image; None where it is not seen."""
        pose = self.pose(t_s)
        if pose is None:
            return None
        T_camera_card = T_world_camera.inv() * pose
        region = self._region(lens, T_camera_card)
        if region is None:
            return None
        seen = view_of(lens, 1).cast(self.scene, T_camera_card.inv(), samples=1, region=region)
        seen[:] = cv2.GaussianBlur(seen, (0, 0), EDGE_BLUR_PX, borderType=cv2.BORDER_REPLICATE)
        light = seen[:, :, :3] if channels == 3 else seen[:, :, :3].mean(axis=2, keepdims=True)
        return CoverSource(
            row=region[0],
            column=region[2],
            light=np.asarray(self.level * light, dtype=np.float32),
            share=np.ascontiguousarray(seen[:, :, 3]),
        )

    def covers(self, lens: Lens, T_world_camera: RigidTransform, places_m: Array, t_s: float) -> NDArray[np.bool_]:
        """Tell which of places (n, 3), in the axes of the target's path, a camera does not see for it."""
        pose = self.pose(t_s)
        if pose is None:
            return np.zeros(len(places_m), np.bool_)
        T_card_world = pose.inv()
        eye = (T_card_world * T_world_camera).apply(eye_of(lens))
        met = np.empty(len(places_m), np.int64)
        meet_scene(
            self.scene.arrays, np.ascontiguousarray(eye), np.ascontiguousarray(T_card_world.apply(places_m)), met
        )
        return np.asarray(met >= 0)

    def _region(self, lens: Lens, T_camera_card: RigidTransform) -> tuple[int, int, int, int] | None:
        """Return rows and columns, first and past the last of each, that it reaches; None where it is not seen."""
        edge = np.linspace(-0.5, 0.5, OUTLINE)
        x, y = np.meshgrid(edge, edge)
        w, h = self.scene.panels[0].size_m
        points = T_camera_card.apply(np.column_stack([w * x.ravel(), h * y.ravel(), 0.0 * x.ravel()]))
        uv = lens.project(points)
        if not np.isfinite(uv).all():
            return None if not np.isfinite(uv).any() else (0, lens.height, 0, lens.width)
        i0, j0 = np.clip(np.floor(uv.min(axis=0)) - 4, 0, (lens.width, lens.height)).astype(int).tolist()
        i1, j1 = np.clip(np.ceil(uv.max(axis=0)) + 5, 0, (lens.width, lens.height)).astype(int).tolist()
        return (j0, j1, i0, i1) if j0 < j1 and i0 < i1 else None


def make_occluder(
    kind: str, *, size_m: float, from_m: Array, to_m: Array, first_s: float, last_s: float, level: float, seed: int
) -> Occluder:
    """Return a hand, a cable or a dark card of a height size_m. level: grey levels of white in the light on it."""
    if kind not in KINDS:
        raise Inconsistent(f"there is no occluder {kind!r}", cure=f"Known are: {', '.join(KINDS)}")
    rng = np.random.default_rng([seed, 31])
    if kind == "hand":
        texture, size = tx.hand(rng), (size_m, size_m)
    elif kind == "cable":
        texture, size = tx.cable(rng, (0.03, 0.03, 0.03), thick=12), (0.5 * size_m, size_m)
    else:
        texture, size = tx.paint(rng, (0.08, 0.08, 0.08)), (size_m, size_m)
    panel = Panel(T_room_panel=RigidTransform.identity(), size_m=size, texture=texture)
    return Occluder(scene=Scene.evenly([panel]), level=level, from_m=from_m, to_m=to_m, first_s=first_s, last_s=last_s)
