"""Pairs of simulated cameras in the axes of the left one, and one camera that sees twice through four mirrors.

Of the mirrors the first is a half-silvered glass plate (Pachidis 2005, PSVS). Every ray is traced surface by surface.
Axes of the real camera O: x right, y down, z forward. The right view is reflected by the plate's coated front and
mirror 2; the left view passes the glass, then mirrors 3 and 4. All four stand at 45 degrees.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.arrays import Array
from armsight.errors import Inconsistent
from armsight.geometry import xyz_quat
from armsight_sim.lens import Lens

SIDES = ("left", "right")

Pair = dict[str, tuple[Lens, RigidTransform]]
"""Lens and T_world_camera of 'left' and 'right'."""


def converging_webcams(width: int, height: int) -> Pair:
    """Return two webcams of 68 degrees width 120 mm apart that toe in by 5 degrees, as two real ones would differ.

    The focal length follows the width; every number is chosen. The lenses' centres lie off the image's, the right
    camera is a little higher, further back and rolled, and the distortion is that of plastic webcam lenses.
    """
    scale = width / 1280.0
    left = Lens(
        width=width,
        height=height,
        focal_px=(948.0 * scale, 949.5 * scale),
        centre_px=(0.5 * (width - 1) + 6.3 * scale, 0.5 * (height - 1) - 4.1 * scale),
        distortion=(0.090, -0.180, 0.0008, -0.0005, 0.050),
    )
    right = Lens(
        width=width,
        height=height,
        focal_px=(953.5 * scale, 952.0 * scale),
        centre_px=(0.5 * (width - 1) - 3.8 * scale, 0.5 * (height - 1) + 5.6 * scale),
        distortion=(0.084, -0.171, -0.0006, 0.0007, 0.042),
    )
    toe_in = Rotation.from_rotvec(
        [0.00371689809, -0.08725704762, 0.00538496788]
    )  # 0.2, -5.0 and 0.3 degrees about x, y, z, as in webcam-cell
    return {
        "left": (left, RigidTransform.identity()),
        "right": (right, RigidTransform.from_components([0.120, 0.0015, -0.002], toe_in)),
    }


def parallel_pair(width: int, height: int, *, focal_px: float, baseline_m: float) -> Pair:
    """Return two equal pinholes without distortion, baseline_m apart along x, looking the same way."""
    lens = Lens(
        width=width,
        height=height,
        focal_px=(focal_px, focal_px),
        centre_px=(0.5 * (width - 1), 0.5 * (height - 1)),
    )
    return {
        "left": (lens, RigidTransform.identity()),
        "right": (lens, RigidTransform.from_translation([baseline_m, 0.0, 0.0])),
    }


def rig_mapping(pair: Mapping[str, tuple[Lens, RigidTransform]]) -> dict[str, Any]:
    """Return the cameras as rig.yaml has them under kind and cameras, and other than a pair under its version."""
    cameras = {}
    for side, (lens, T_world_camera) in pair.items():
        xyz, quat = xyz_quat(T_world_camera)
        cameras[side] = lens.mapping() | {"T_rig_camera": {"xyz_m": xyz.tolist(), "quat_xyzw": quat.tolist()}}
    if tuple(cameras) != SIDES:
        return {"version": 2, "kind": "cameras", "cameras": cameras}
    return {"kind": "stereo", "cameras": cameras}


SLANT = np.sqrt(0.5)

MIRROR_ROUNDS = 12
"""Steps of the search for the ray that meets a point: each gains a factor of 300 (the plate's shift over the depth)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Mirrors:
    """The mirrors before the lens.

    baseline_m: between the two virtual cameras. plate_m, index: thickness and refraction of the glass. near_m: from the
    lens to the plate's front, along the axis; gap_m: from there to mirror 3. tilts_rad: of mirror 1 (the plate) to 4,
    each (turn about the vertical y, tilt about the line in its face square to y), about the point where the chief ray
    meets it.
    """

    baseline_m: float
    plate_m: float = 1e-3
    index: float = 1.5
    near_m: float = 0.06
    gap_m: float = 0.04
    tilts_rad: tuple[tuple[float, float], ...] = ((0.0, 0.0),) * 4

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
        origin = np.zeros_like(ray)
        if side == "left":
            origin, ray = self._glass(origin, ray)
        for point, normal in self._mirrors(side):
            origin, ray = _reflect(_meet(origin, ray, point, normal), ray, normal)
        return origin, ray

    def _glass(self, origin: Array, ray: Array) -> tuple[Array, Array]:
        """Return where rays leave the plate, and their directions."""
        front, through = np.array([0.0, 0.0, self.near_m]), -self.normals()[0]
        origin = _meet(origin, ray, front, through)
        ray = _refract(ray, through, 1.0 / self.index)
        origin = _meet(origin, ray, front + self.plate_m * through, through)
        return origin, _refract(ray, through, self.index)

    def _mirrors(self, side: str) -> list[tuple[Array, Array]]:
        """Return a point and the normal of the two mirrors on a side's way out."""
        front, half = np.array([0.0, 0.0, self.near_m]), np.array([0.5 * self.baseline_m, 0.0, 0.0])
        normals = self.normals()
        if side == "right":
            return [(front, normals[0]), (front + half, normals[1])]
        third = front + np.array([0.0, 0.0, self.gap_m])
        return [(third, normals[2]), (third - half, normals[3])]

    def normals(self) -> Array:
        """Return the mirrors' normals (4, 3): at 45 degrees, turned by their tilts."""
        upright = np.array([[SLANT, 0.0, -SLANT], [SLANT, 0.0, -SLANT], [-SLANT, 0.0, -SLANT], [-SLANT, 0.0, -SLANT]])
        out = []
        for normal, (turn, tilt) in zip(upright, self.tilts_rad, strict=True):
            across = np.array([-normal[2], 0.0, normal[0]])  # in the face, square to y
            out.append(Rotation.from_rotvec(turn * np.array([0.0, 1.0, 0.0]) + tilt * across).apply(normal))
        return np.array(out)

    def pose(self, side: str) -> RigidTransform:
        """Return T_camera_virtual: the camera as a side's mirrors show it; left, where the glass lets it seem to be.

        The glass shifts the camera along its normal, so far that the traced chief ray comes from there.
        """
        T = np.eye(4)
        for point, normal in self._mirrors(side):
            mirror = np.eye(4)
            mirror[:3, :3] -= 2.0 * np.outer(normal, normal)
            mirror[:3, 3] = 2.0 * (point @ normal) * normal
            T = mirror @ T
        if side == "left":
            origin, _ = self._glass(np.zeros((1, 3)), np.array([[0.0, 0.0, 1.0]]))
            T[:3, 3] += T[:3, :3] @ np.array([origin[0, 0], 0.0, -origin[0, 0]])
        return RigidTransform.from_matrix(T)

    def image(self, side: str, points_m: ArrayLike) -> Array:
        """Return the rays (x, y) (n, 2) of the lens that meet points (n, 3); NaN for points behind the mirrors."""
        X = np.atleast_2d(np.asarray(points_m, dtype=float))
        half = 0.5 * self.baseline_m
        depth = X[:, 2] + half
        seen = X[:, 2] > self.near_m + self.gap_m
        depth = np.where(seen, depth, 1.0)
        towards = half if side == "right" else -half
        uv = np.column_stack([(X[:, 0] - towards) / depth, X[:, 1] / depth])
        for _ in range(MIRROR_ROUNDS):
            origin, ray = self.trace(side, np.where(seen[:, None], uv, 0.0))
            at = origin + ((X[:, 2] - origin[:, 2]) / ray[:, 2])[:, None] * ray
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
        "fisheye": lens.fisheye,
    }
    return {side: MirrorLens(mirrors=mirrors, side=side, **shared) for side in SIDES}


def mirror_rig(views: Mapping[str, MirrorLens]) -> dict[str, Any]:
    """Return the two views as rig.yaml has them: kind mirror, rig axes those of the real camera.

    The right view is a pinhole exactly; the left one a pinhole behind a glass plate, whose centre lies where the
    traced chief ray seems to come from.
    """
    mirrors = views["right"].mirrors
    poses = {side: mirrors.pose(side) for side in SIDES}
    pair = {side: (_plain(views[side]), poses[side]) for side in SIDES}
    content = rig_mapping(pair) | {"kind": "mirror"}
    if mirrors.plate_m > 0.0:
        content["cameras"]["left"]["plate"] = {"thickness_m": mirrors.plate_m, "index": mirrors.index}
    return content


def _plain(view: MirrorLens) -> Lens:
    return Lens(
        width=view.width,
        height=view.height,
        focal_px=view.focal_px,
        centre_px=view.centre_px,
        skew_px=view.skew_px,
        distortion=view.distortion,
    )


def _meet(origin: Array, ray: Array, point: Array, normal: Array) -> Array:
    """Return where rays (n, 3) from places (n, 3) meet a plane."""
    along = ((point - origin) @ normal) / (ray @ normal)
    return np.asarray(origin + along[:, None] * ray)


def _reflect(origin: Array, ray: Array, normal: Array) -> tuple[Array, Array]:
    return origin, ray - 2.0 * (ray @ normal)[:, None] * normal


def _refract(ray: Array, normal: Array, ratio: float) -> Array:
    """Return unit rays (n, 3) behind a surface by Snell's law; normal along the way, ratio = index before / behind."""
    c = ray @ normal
    behind = np.sqrt(1.0 - ratio**2 * (1.0 - c**2))
    return np.asarray(ratio * ray + (behind - ratio * c)[:, None] * normal)
