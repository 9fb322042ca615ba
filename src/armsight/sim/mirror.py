"""One camera that sees twice: four mirrors, the first of them a half-silvered glass plate (Pachidis 2005, PSVS).

Every ray is traced surface by surface. Axes of the real camera O: x right, y down, z forward. The right view is
reflected by the plate's coated front and mirror 2; the left view passes the glass, then mirrors 3 and 4. All four
stand at 45 degrees.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import least_squares
from scipy.spatial.transform import RigidTransform

from armsight.errors import Inconsistent
from armsight.sim.lens import Lens
from armsight.sim.rigs import SIDES, rig_mapping

Array = NDArray[np.float64]

SLANT = np.sqrt(0.5)

ROUNDS = 12
"""Steps of the search for the ray that meets a point: each gains a factor of 300 (the plate's shift over the depth)."""

TRUTH_DEPTHS_M = (0.4, 0.6, 0.8)
"""Where the pinhole that stands for the left view is fitted."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Mirrors:
    """The mirrors before the lens.

    baseline_m: between the two virtual cameras. plate_m, index: thickness and refraction of the glass. near_m: from the
    lens to the plate's front, along the axis; gap_m: from there to mirror 3.
    """

    baseline_m: float
    plate_m: float = 1e-3
    index: float = 1.5
    near_m: float = 0.06
    gap_m: float = 0.04

    def __post_init__(self) -> None:
        if not (self.baseline_m > 0.0 and self.plate_m >= 0.0 and self.index >= 1.0):
            raise Inconsistent(
                f"mirrors with baseline_m {self.baseline_m}, plate_m {self.plate_m} and index {self.index} cannot be"
            )
        if not (self.near_m > 0.0 and self.gap_m > 2.0 * self.plate_m):
            raise Inconsistent("the mirrors stand before the lens, mirror 3 behind the plate")

    def trace(self, side: str, uv: ArrayLike) -> tuple[Array, Array]:
        """Return points (n, 3) and directions (n, 3) of the rays that leave the mirrors for (x, y, 1) = uv (n, 2)."""
        xy = np.atleast_2d(np.asarray(uv, dtype=float))
        ray = np.column_stack([xy, np.ones(len(xy))])
        ray /= np.linalg.norm(ray, axis=1)[:, None]
        place = np.zeros_like(ray)
        front = np.array([0.0, 0.0, self.near_m])
        half = 0.5 * self.baseline_m
        if side == "right":
            first = np.array([SLANT, 0.0, -SLANT])
            place, ray = _reflect(_meet(place, ray, front, first), ray, first)
            return _reflect(_meet(place, ray, front + np.array([half, 0.0, 0.0]), first), ray, first)
        through = np.array([-SLANT, 0.0, SLANT])
        place = _meet(place, ray, front, through)
        ray = _refract(ray, through, 1.0 / self.index)
        place = _meet(place, ray, front + self.plate_m * through, through)
        ray = _refract(ray, through, self.index)
        third, mirror = front + np.array([0.0, 0.0, self.gap_m]), np.array([-SLANT, 0.0, -SLANT])
        place, ray = _reflect(_meet(place, ray, third, mirror), ray, mirror)
        return _reflect(_meet(place, ray, third - np.array([half, 0.0, 0.0]), mirror), ray, mirror)

    def image(self, side: str, points_m: ArrayLike) -> Array:
        """Return the rays (x, y) (n, 2) of the lens that meet points (n, 3); NaN for points behind the mirrors."""
        X = np.atleast_2d(np.asarray(points_m, dtype=float))
        half = 0.5 * self.baseline_m
        depth = X[:, 2] + half
        seen = X[:, 2] > self.near_m + self.gap_m
        depth = np.where(seen, depth, 1.0)
        towards = half if side == "right" else -half
        uv = np.column_stack([(X[:, 0] - towards) / depth, X[:, 1] / depth])
        for _ in range(ROUNDS):
            place, ray = self.trace(side, np.where(seen[:, None], uv, 0.0))
            at = place + ((X[:, 2] - place[:, 2]) / ray[:, 2])[:, None] * ray
            miss = (at[:, :2] - X[:, :2]) / depth[:, None]
            uv = uv - miss
            if not np.abs(miss[seen]).max(initial=0.0) > 1e-15:
                break
        uv[~seen] = np.nan
        return uv


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MirrorLens(Lens):
    """A lens behind mirrors: one of the two views of a complex image; points and rays in the real camera's axes."""

    mirrors: Mirrors
    side: str

    def project(self, points_m: ArrayLike) -> Array:
        """Return the pixels (..., 2) of points (..., 3); NaN for points not in front of the mirrors."""
        X = np.asarray(points_m, dtype=np.float64)
        uv = self.mirrors.image(self.side, X.reshape(-1, 3))
        ahead = np.column_stack([uv, np.ones(len(uv))]).reshape(X.shape)
        return Lens.project(self, ahead)


def mirror_views(lens: Lens, mirrors: Mirrors) -> dict[str, MirrorLens]:
    """Return the lens as it sees left and right through the mirrors."""
    shared: dict[str, Any] = {
        "width": lens.width,
        "height": lens.height,
        "focal_px": lens.focal_px,
        "centre_px": lens.centre_px,
        "skew_px": lens.skew_px,
        "distortion": lens.distortion,
    }
    return {side: MirrorLens(mirrors=mirrors, side=side, **shared) for side in SIDES}


def mirror_rig(views: Mapping[str, MirrorLens]) -> dict[str, Any]:
    """Return the nearest pair of pinholes as rig.yaml has it: kind mirror, rig axes those of the real camera.

    The right view is a pinhole exactly; the left one, seen through a tilted plate, is only to about 0.02 px: its
    centre, focal lengths and principal point are fitted over the image at TRUTH_DEPTHS_M.
    """
    right = views["right"]
    half = 0.5 * right.mirrors.baseline_m
    lens, centre_m = _pinhole(views["left"])
    pair = {
        "left": (lens, RigidTransform.from_translation(centre_m)),
        "right": (_plain(right), RigidTransform.from_translation([half, 0.0, -half])),
    }
    return rig_mapping(pair) | {"kind": "mirror"}


def _plain(
    view: MirrorLens, focal_px: tuple[float, float] | None = None, centre_px: tuple[float, float] | None = None
) -> Lens:
    return Lens(
        width=view.width,
        height=view.height,
        focal_px=focal_px or view.focal_px,
        centre_px=centre_px or view.centre_px,
        skew_px=view.skew_px,
        distortion=view.distortion,
    )


def _pinhole(view: MirrorLens) -> tuple[Lens, Array]:
    """Return the lens and the place (3,) in O axes of the pinhole nearest to a view."""
    u, v = np.meshgrid(np.linspace(0.05, 0.95, 7) * view.width, np.linspace(0.05, 0.95, 5) * view.height)
    place, ray = view.mirrors.trace(view.side, view.rays(np.stack([u.ravel(), v.ravel()], axis=1)))
    points = np.vstack([place + ((z - place[:, 2]) / ray[:, 2])[:, None] * ray for z in TRUTH_DEPTHS_M])
    seen = view.project(points)
    half = 0.5 * view.mirrors.baseline_m

    def lens_of(x: Array) -> tuple[Lens, Array]:
        focal = (view.focal_px[0] * (1 + x[3]), view.focal_px[1] * (1 + x[4]))
        return _plain(view, focal, (view.centre_px[0] + x[5], view.centre_px[1] + x[6])), np.array(
            [-half, 0, -half]
        ) + x[:3]

    def misses(x: Array) -> Array:
        lens, centre_m = lens_of(x)
        return np.asarray((lens.project(points - centre_m) - seen).ravel())

    found = least_squares(misses, np.zeros(7), x_scale=[1e-4, 1e-4, 1e-4, 1e-3, 1e-3, 1.0, 1.0])
    return lens_of(found.x)


def _meet(place: Array, ray: Array, point: Array, normal: Array) -> Array:
    """Return where rays (n, 3) from places (n, 3) meet a plane."""
    along = ((point - place) @ normal) / (ray @ normal)
    return np.asarray(place + along[:, None] * ray)


def _reflect(place: Array, ray: Array, normal: Array) -> tuple[Array, Array]:
    return place, ray - 2.0 * (ray @ normal)[:, None] * normal


def _refract(ray: Array, normal: Array, ratio: float) -> Array:
    """Return unit rays (n, 3) behind a surface by Snell's law; normal along the way, ratio = index before / behind."""
    c = ray @ normal
    behind = np.sqrt(1.0 - ratio**2 * (1.0 - c**2))
    return np.asarray(ratio * ray + (behind - ratio * c)[:, None] * normal)
