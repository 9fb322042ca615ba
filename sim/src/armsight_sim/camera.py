"""A simulated camera: renders the lights of a moving target over its exposure."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np
from scipy.spatial.transform import RigidTransform

from armsight.arrays import Array
from armsight.errors import Inconsistent
from armsight_sim.lens import Lens
from armsight_sim.pipeline import IDEAL, LensLosses, Picture, Pipeline
from armsight_sim.render import LightImage, LightSource, Patch, PointSource, RegionSource, render_sources
from armsight_sim.rooms.occluders import Occluder
from armsight_sim.scene import Ghost, Light, Path
from armsight_sim.sensor import Sensor

EDGE_NODES = (32, 720)
"""Least and most nodes on a disc's outline; between them, one per EDGE_STEP_SIGMA of the blur."""

EDGE_STEP_SIGMA = 0.7
"""Spacing of the outline's nodes in sigma: the trapezoid rule's error is then exp(-2 pi^2 / 0.7^2), below rounding."""

TRACK_NODES = (4, 128)
"""Least and most Gauss-Legendre nodes over the exposure: two already give a uniform motion its exact variance, 128
draw a streak of 80 sigma smoothly."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SimCamera:
    """Lens, place in the world, sensor, the light that is there without the target (h, w, c), and exposure.

    readout_s: time from the first row's exposure to the last row's (a rolling shutter); the middle row is on time.
    pipeline: the lens's losses and the camera's processing. grey: pictures of a colour camera are handed out grey.
    occluders: what comes between it and the lights, in the axes of their path.
    """

    lens: Lens
    T_world_camera: RigidTransform
    sensor: Sensor
    backdrop: LightImage
    exposure_s: float = 0.0
    readout_s: float = 0.0
    pipeline: Pipeline = IDEAL
    grey: bool = False
    occluders: tuple[Occluder, ...] = ()
    losses: LensLosses = field(init=False, repr=False)
    still: LightImage = field(init=False, repr=False)

    def __post_init__(self) -> None:
        shape = self.backdrop.shape
        if len(shape) != 3 or shape[:2] != (self.lens.height, self.lens.width) or shape[2] not in (1, 3):
            raise Inconsistent(f"a backdrop of shape {shape} does not fit a {self.lens.width}x{self.lens.height} lens")
        if self.backdrop.dtype != np.float32 or not (self.backdrop >= 0.0).all():
            raise Inconsistent("a backdrop is float32 and nowhere negative")
        backdrop = self.backdrop.copy()
        backdrop.setflags(write=False)
        object.__setattr__(self, "backdrop", backdrop)
        losses = LensLosses(pipeline=self.pipeline, height=self.lens.height, width=self.lens.width)
        object.__setattr__(self, "losses", losses)
        object.__setattr__(self, "still", losses.through(backdrop))
        if not (self.exposure_s >= 0.0 and self.readout_s >= 0.0):
            raise Inconsistent(f"an exposure of {self.exposure_s} s, read out in {self.readout_s} s, cannot be")

    def centres_px(self, lights: Sequence[Light], path: Path, t_s: float) -> Array:
        """Return the pixels (n, 2) of the lights' centres at time t_s; NaN behind the camera or facing away."""
        return np.asarray(self._tracks(lights, self._poses(path, np.array([t_s])))[0])

    def light(
        self,
        lights: Sequence[Light],
        path: Path,
        t_s: float,
        *,
        hidden: frozenset[str] = frozenset(),
        ghosts: Sequence[Ghost] = (),
    ) -> LightImage:
        """Return the light (h, w, c) on the sensor, in grey levels without noise, of an exposure about t_s."""
        patch = self._on_sensor(self.backdrop, self.still, self.sources(lights, path, t_s, hidden, ghosts))
        image = self.still.copy()
        height, width = patch.light.shape[:2]
        image[patch.row : patch.row + height, patch.column : patch.column + width] = patch.light
        return image

    def expose(
        self,
        lights: Sequence[Light],
        path: Path,
        t_s: float,
        rng: np.random.Generator,
        *,
        hidden: frozenset[str] = frozenset(),
        ghosts: Sequence[Ghost] = (),
    ) -> Picture:
        """Return the 8-bit image (h, w) or (h, w, 3) of an exposure whose middle is t_s."""
        return self.develop(self.sources(lights, path, t_s, hidden, ghosts), rng)

    def develop(
        self, sources: Sequence[LightSource], rng: np.random.Generator, backdrop: LightImage | None = None
    ) -> Picture:
        """Return the 8-bit image of sources of light over the backdrop, or over another one (of a moving camera)."""
        before = self.backdrop if backdrop is None else backdrop
        still = self.still if backdrop is None else self.losses.through(backdrop)
        patch = self._on_sensor(before, still, sources)
        return self.pipeline.develop(still, self.sensor, rng, patch, grey=self.grey)

    def _on_sensor(self, before: LightImage, still: LightImage, sources: Sequence[LightSource]) -> Patch:
        """Return what sources change of the light `still` that the sensor gets of the light `before` the lens."""
        return self.losses.patched(before, still, render_sources(before, sources))

    def sources(
        self, lights: Sequence[Light], path: Path, t_s: float, hidden: frozenset[str], ghosts: Sequence[Ghost]
    ) -> list[LightSource]:
        """Return the light that the lights not hidden and the ghosts put on the sensor."""
        sources: list[LightSource] = [
            self._point(np.array([ghost.uv_px]), np.ones(1), ghost.level, ghost.sigma_px, ghost.bgr) for ghost in ghosts
        ]
        before, behind = self._covers(lights, path, t_s)
        sources = [*behind, *sources]
        shown = [light for light in lights if light.name not in hidden]
        groups = (
            [(shown, t_s)]
            if self.readout_s == 0.0
            else [([light], self._row_time(light, path, t_s)) for light in shown]
        )
        for group, at_s in groups if shown else ():
            poses, tracks, share = self._exposed(group, path, at_s)
            for i, light in enumerate(group):
                if light.diameter_m is not None:
                    sources.append(self._disc(light, poses, tracks[:, i], share))
                else:
                    sources.append(self._point(tracks[:, i], share, light.level, light.sigma_px, light.bgr))
        return [*sources, *before]

    def covered(self, lights: Sequence[Light], path: Path, t_s: float) -> frozenset[str]:
        """Return the names of the lights whose centres an occluder hides at a time."""
        if not self.occluders or not lights:
            return frozenset()
        places = np.asarray(path(np.array([t_s]))[0].apply(np.array([light.xyz_m for light in lights], dtype=float)))
        hidden = np.zeros(len(lights), np.bool_)
        for occluder in self.occluders:
            hidden |= occluder.covers(self.lens, self.T_world_camera, places, t_s)
        return frozenset(light.name for light, covered in zip(lights, hidden, strict=True) if covered)

    def _covers(self, lights: Sequence[Light], path: Path, t_s: float) -> tuple[list[LightSource], list[LightSource]]:
        """Return what occluders cover, of those before the nearest light and of those behind it."""
        before: list[LightSource] = []
        behind: list[LightSource] = []
        for occluder in self.occluders:
            pose = occluder.pose(t_s)
            source = occluder.source(self.lens, self.T_world_camera, t_s, self.backdrop.shape[2])
            if pose is None or source is None:
                continue
            T_camera_world = self.T_world_camera.inv()
            target = T_camera_world * path(np.array([t_s]))[0]
            depths = [float(target.apply(light.xyz_m)[2]) for light in lights]
            nearer = float((T_camera_world * pose).translation[2]) < min(depths, default=np.inf)
            (before if nearer else behind).append(source)
        return before, behind

    def _row_time(self, light: Light, path: Path, t_s: float) -> float:
        """Return when the row that sees a light is exposed, by a rolling shutter."""
        at_s = t_s
        for _ in range(3):  # a light crosses a small part of the image in a readout: each round gains a factor of 30
            row = float(self.centres_px([light], path, at_s)[0, 1])
            if not 0.0 <= row <= self.lens.height:
                return t_s
            at_s = t_s + self.readout_s * (row / (self.lens.height - 1) - 0.5)
        return at_s

    def _poses(self, path: Path, t_s: Array) -> tuple[Array, Array]:
        """Return rotations (n, 3, 3) and translations (n, 3) of T_camera_target at the times (n,)."""
        world, target = self.T_world_camera.as_matrix(), path(t_s).as_matrix()  # (4, 4), (n, 4, 4)
        R = world[:3, :3].T
        return R @ target[:, :3, :3], (target[:, :3, 3] - world[:3, 3]) @ R.T

    def _tracks(self, lights: Sequence[Light], poses: tuple[Array, Array]) -> Array:
        """Return the pixels (poses, lights, 2) of the lights' centres; NaN behind the camera or facing away."""
        R, t = poses
        places = np.array([light.xyz_m for light in lights], dtype=np.float64)
        facing = np.array([light.facing for light in lights], dtype=np.float64)
        in_camera = places @ R.transpose(0, 2, 1) + t[:, None, :]  # (poses, lights, 3)
        uv = self.lens.project(in_camera)
        towards = np.einsum("pli,pli->pl", facing @ R.transpose(0, 2, 1), in_camera)
        wide = np.array([0.0 if light.wide_deg >= 90.0 else np.cos(np.deg2rad(light.wide_deg)) for light in lights])
        least = wide * np.linalg.norm(facing, axis=1) * np.linalg.norm(in_camera, axis=2)
        uv[(towards >= -least) & facing.any(axis=1)] = np.nan
        return uv

    def _exposed(self, lights: Sequence[Light], path: Path, t_s: float) -> tuple[tuple[Array, Array], Array, Array]:
        """Return poses (n), tracks (n, lights, 2) and shares (n,) that integrate the motion over the exposure."""
        count = TRACK_NODES[0] if self.exposure_s > 0.0 else 1
        while True:
            nodes, share = _legendre(count)
            poses = self._poses(path, t_s + 0.5 * self.exposure_s * nodes)
            tracks = self._tracks(lights, poses)
            if count == 1 or count == TRACK_NODES[1]:
                return poses, tracks, share
            lengths = np.linalg.norm(np.diff(tracks, axis=0), axis=2).sum(axis=0) / nodes[-1]  # (lights,) px
            steps = lengths / np.array([light.sigma_px for light in lights])
            longest = float(np.max(steps[np.isfinite(steps)], initial=0.0))
            # nodes lie pi/2 of their mean spacing apart in the middle: 1.6 of them per sigma make that one sigma
            if 1.6 * longest + 1.0 <= count:
                return poses, tracks, share
            count = min(max(math.ceil(1.6 * longest) + 1, count + 1), TRACK_NODES[1])

    def _channels(self, bgr: tuple[float, float, float]) -> Array:
        """Return the share of each of the camera's channels; a grey camera takes the mean of the three."""
        return np.array(bgr) if self.backdrop.shape[2] == 3 else np.array([sum(bgr) / 3.0])

    def _point(
        self, track_px: Array, share: Array, level: float, sigma_px: float, bgr: tuple[float, float, float]
    ) -> PointSource:
        """Return a Gaussian that spends a share (n,) of the exposure at each place of track_px (n, 2)."""
        flux = 2.0 * math.pi * sigma_px**2 * level * share
        return PointSource(uv_px=track_px, flux=flux, sigma_px=sigma_px, bgr=self._channels(bgr))

    def _disc(self, light: Light, poses: tuple[Array, Array], track_px: Array, share: Array) -> RegionSource:
        """Return a flat disc, its outline traced through the lens, at each pose for its share of the exposure."""
        seen = np.isfinite(track_px).all(axis=1)
        R, t = poses[0][seen], poses[1][seen]
        nearest_m = float(np.min((R @ np.asarray(light.xyz_m) + t)[:, 2], initial=np.inf))
        round_px = math.pi * max(self.lens.focal_px) * (light.diameter_m or 0.0) / nearest_m
        nodes = int(np.clip(round_px / (EDGE_STEP_SIGMA * light.sigma_px) + 1.0, EDGE_NODES[0], EDGE_NODES[1]))
        return RegionSource(
            outlines_px=self.lens.project(light.edge_m(nodes) @ R.transpose(0, 2, 1) + t[:, None, :]),
            share=share[seen],
            sigma_px=light.sigma_px,
            bgr=light.level * self._channels(light.bgr),
        )


@lru_cache(maxsize=TRACK_NODES[1])
def _legendre(count: int) -> tuple[Array, Array]:
    """Return the Gauss-Legendre nodes on [-1, 1] and their shares of it."""
    nodes, weights = np.polynomial.legendre.leggauss(count)
    share = 0.5 * weights
    nodes.setflags(write=False)
    share.setflags(write=False)
    return nodes, share
