"""A scene through a lens: every pixel's rays, traced once, cast wherever the camera is."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from armsight.sim.lens import Lens
from armsight.sim.mirror import MirrorLens
from armsight.sim.rooms.kernels import cast_scene
from armsight.sim.rooms.scene import Scene

Array = NDArray[np.float64]
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
            place, ray = self.lens.mirrors.trace(self.lens.side, xy.reshape(-1, 2))
            eye = np.asarray(self.lens.mirrors.pose(self.lens.side).translation)
            place = place + ((eye - place) * ray).sum(axis=1)[:, None] * ray  # back to where all rays seem to start
            rays, origins = ray.reshape(*xy.shape[:2], 3), place.reshape(*xy.shape[:2], 3)
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
        samples: int = 4,
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
