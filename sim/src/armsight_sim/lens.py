"""The simulated lenses, from first principles, so that the product's own projection can be tested against them.

A zoom lens is two thin groups on a cam before a sensor: the front group spreads light, the rear one gathers it and
holds the stop (a retrofocus zoom, as cheap cameras have). Their distance sets the focal length; the front group follows
so that the picture stays sharp. Nothing here knows how the product interpolates between settings.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import RigidTransform

from armsight.arrays import Array
from armsight.errors import Inconsistent
from armsight.records import frozen_array
from armsight_sim.lenses.kernels import see_points, trace_rays


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Lens:
    """A pinhole with skew behind a Brown-Conrady lens, one of OpenCV's rational model, or a fisheye lens.

    width, height, focal_px (fx, fy), centre_px (cx, cy) and skew_px in px; distortion is k1, k2, p1, p2, k3
    without unit, of a fisheye k1, k2, k3, k4, 0, of a rational lens with k4, k5, k6 behind them. A ray (x, y, 1) lands
    at u = fx xd + skew yd + cx, v = fy yd + cy.
    """

    width: int
    height: int
    focal_px: tuple[float, float]
    centre_px: tuple[float, float]
    skew_px: float = 0.0
    distortion: tuple[float, ...] = (0.0, 0.0, 0.0, 0.0, 0.0)
    fisheye: bool = False

    def __post_init__(self) -> None:
        frozen_array("lens", self.vector, (14,))
        if self.width < 1 or self.height < 1 or min(self.focal_px) <= 0.0:
            raise Inconsistent(f"a lens of {self.width}x{self.height} px with focal lengths {self.focal_px} cannot be")

    @property
    def vector(self) -> Array:
        """The fourteen numbers in the order the kernels take them."""
        first, rest = self.distortion[:5], self.distortion[5:] or (0.0, 0.0, 0.0)
        return np.array([*self.focal_px, *self.centre_px, self.skew_px, *first, float(self.fisheye), *rest], np.float64)

    @property
    def rational(self) -> bool:
        """Whether it is one of OpenCV's rational model."""
        return len(self.distortion) > 5

    def project(self, points_m: ArrayLike) -> Array:
        """Return the pixels (..., 2) of points (..., 3) in camera axes; NaN for points not in front."""
        X = np.ascontiguousarray(points_m, dtype=np.float64)
        uv = np.empty((*X.shape[:-1], 2))
        see_points(self.vector, X.reshape(-1, 3), uv.reshape(-1, 2))
        return uv

    def rays(self, uv_px: ArrayLike) -> Array:
        """Return (x, y) (..., 2) of the rays (x, y, 1) behind pixels (..., 2); NaN where the lens folds."""
        uv = np.ascontiguousarray(uv_px, dtype=np.float64)
        rays = np.empty_like(uv)
        trace_rays(self.vector, uv.reshape(-1, 2), rays.reshape(-1, 2))
        return rays

    def mapping(self) -> dict[str, object]:
        """Return the intrinsics as rig.yaml writes them."""
        (fx, fy), (cx, cy) = self.focal_px, self.centre_px
        return {
            **({"lens": "fisheye"} if self.fisheye else {"lens": "rational"} if self.rational else {}),
            "width": self.width,
            "height": self.height,
            "fx": fx,
            "fy": fy,
            "cx": cx,
            "cy": cy,
            "skew": self.skew_px,
            "distortion": list(self.distortion[:4] if self.fisheye else self.distortion),
        }


SETTINGS = (100.0, 200.0, 300.0, 400.0, 500.0)
"""The zoom values that are calibrated where nobody chooses others: as CAP_PROP_ZOOM of many cameras counts."""


class Cam(StrEnum):
    """What the zoom value moves evenly along its way, but for the cam's bends."""

    DISTANCE = "distance"
    """The distance of the groups: a groove at a constant slope."""
    FOCAL = "focal"
    """The focal length: a motor that counts in it."""
    LOG_FOCAL = "log_focal"
    """Its logarithm: equal steps magnify alike."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ZoomLens:
    """A zoom lens of two thin groups; lengths in mm.

    zoom: least and greatest value of its setting. wide_mm, ratio: the shortest focal length, and the longest over it.
    front_mm (negative), rear_mm: focal lengths of the groups. cam, bend (2,): how the value moves them, and how the
    groove bends (shares of the way, even and odd about its middle). focus_mm: the distance it is focused on: the
    picture breathes with the image distance. decentre_mm: how far the groups stand off the axis, front x, y and rear
    x, y. barrel, cushion: radial distortion at the half diagonal at the wide and at the long end; fourth, tangential
    (2,): its further terms, in half diagonals. pitch_mm: of the pixels; aspect: their width over height.
    """

    width: int
    height: int
    zoom: tuple[float, float] = (100.0, 500.0)
    wide_mm: float = 3.0
    ratio: float = 3.0
    front_mm: float = -8.0
    rear_mm: float = 6.0
    cam: Cam = Cam.LOG_FOCAL
    bend: tuple[float, float] = (0.15, -0.08)
    focus_mm: float = 900.0
    decentre_mm: tuple[float, float, float, float] = (0.012, -0.008, -0.006, 0.010)
    barrel: float = -0.08
    cushion: float = 0.025
    fourth: float = 0.012
    tangential: tuple[float, float] = (4e-4, -3e-4)
    pitch_mm: float = 0.003
    aspect: float = 1.0008

    def __post_init__(self) -> None:
        low, high = self.zoom
        if not low < high:
            raise Inconsistent(f"a zoom from {low:g} to {high:g} cannot be")
        if not (self.front_mm < 0.0 < min(self.rear_mm, self.wide_mm, self.pitch_mm) and self.ratio > 1.0):
            raise Inconsistent(
                "a zoom lens has a front group that spreads, a rear one that gathers, and a ratio over 1"
            )
        if self._distance_mm(self.wide_mm * self.ratio) <= 0.0:
            raise Inconsistent("the groups of the zoom lens would run into each other at its long end")
        if abs(self.bend[0]) + abs(self.bend[1]) >= 1.0:
            raise Inconsistent("a cam that bends so much runs backwards")

    def focal_mm(self, zoom: float) -> float:
        """Return the focal length at a value of the zoom. Raises Inconsistent beyond its ends."""
        low, high = self.zoom
        if not low <= zoom <= high:
            raise Inconsistent(
                f"the simulated lens zooms from {low:g} to {high:g}, not to {zoom:g}", cure="Give a value in that range"
            )
        s = (zoom - low) / (high - low)
        way = s + s * (1.0 - s) * (self.bend[0] + self.bend[1] * (1.0 - 2.0 * s))
        if self.cam is Cam.FOCAL:
            return self.wide_mm * (1.0 + (self.ratio - 1.0) * way)
        if self.cam is Cam.LOG_FOCAL:
            return float(self.wide_mm * self.ratio**way)
        near, far = self._distance_mm(self.wide_mm), self._distance_mm(self.wide_mm * self.ratio)
        distance = near + (far - near) * way
        return self.front_mm * self.rear_mm / (self.front_mm + self.rear_mm - distance)

    def _distance_mm(self, focal_mm: float) -> float:
        """Return the distance of two thin groups that together have a focal length."""
        return self.front_mm + self.rear_mm - self.front_mm * self.rear_mm / focal_mm

    def pupil_m(self, zoom: float) -> float:
        """Return how far before the sensor the entrance pupil stands: the front group's image of the stop.

        The sensor stays where it is and the groups move, so the centre of projection moves with the zoom.
        """
        f = self.focal_mm(zoom)
        d = self._distance_mm(f)
        back = f * (1.0 - d / self.front_mm)  # from the rear group to the sensor
        behind = d * self.front_mm / (self.front_mm - d)  # of the front group, where the stop seems to be
        return 1e-3 * (back + d - behind)

    def lens(self, zoom: float) -> Lens:
        """Return the lens at a value of the zoom."""
        f = self.focal_mm(zoom)
        breathing = f / (self.focus_mm - f)
        fx = f * (1.0 + breathing) / self.pitch_mm
        rear = f / self.front_mm  # magnification by the rear group
        xa, ya, xb, yb = self.decentre_mm
        off = [(a * rear + b * (1.0 - rear)) / self.pitch_mm for a, b in ((xa, xb), (ya, yb))]
        way = np.log(f / self.wide_mm) / np.log(self.ratio)
        # a group's third-order distortion follows the height of the chief ray on it, which falls as the lens gets long
        second = self.barrel + (self.cushion - self.barrel) * way * (1.6 - 0.6 * way) + 2.0 * breathing * self.barrel
        fourth = self.fourth * (self.wide_mm / f) ** 2
        s = 0.5 * np.hypot(self.width, self.height) / fx
        p1, p2 = self.tangential
        return Lens(
            width=self.width,
            height=self.height,
            focal_px=(float(fx), float(fx * self.aspect)),
            centre_px=(0.5 * (self.width - 1) + off[0], 0.5 * (self.height - 1) + off[1]),
            distortion=(float(second / s**2), float(fourth / s**4), float(p1 / s), float(p2 / s), 0.0),
        )


def random_zoom_lens(rng: np.random.Generator, width: int, height: int) -> ZoomLens:
    """Return a zoom lens as another maker would build it: groups, ratio, cam, focus, centring and distortion drawn.

    Of the groups those are kept that have room between them at the long end.
    """
    while True:
        wide, ratio = rng.uniform(2.4, 5.0), rng.uniform(2.0, 5.0)
        front, rear = -rng.uniform(6.0, 14.0), rng.uniform(4.0, 10.0)
        if front + rear - front * rear / (wide * ratio) > 0.5:
            break
    return ZoomLens(
        width=width,
        height=height,
        wide_mm=wide,
        ratio=ratio,
        front_mm=front,
        rear_mm=rear,
        cam=tuple(Cam)[rng.integers(len(Cam))],
        bend=(float(rng.uniform(-0.4, 0.4)), float(rng.uniform(-0.25, 0.25))),
        focus_mm=float(np.exp(rng.uniform(np.log(500.0), np.log(3000.0)))),
        decentre_mm=tuple(rng.normal(0.0, 0.012, 4).tolist()),
        barrel=-float(rng.uniform(0.02, 0.12)),
        cushion=float(rng.uniform(-0.01, 0.05)),
        fourth=float(rng.uniform(-0.01, 0.02)),
        tangential=(float(rng.normal(0.0, 5e-4)), float(rng.normal(0.0, 5e-4))),
        aspect=1.0 + float(rng.normal(0.0, 1e-3)),
    )


Pair = Mapping[str, tuple[Lens, RigidTransform]]


def zoomed_pair(pair: Pair, zoom: float) -> dict[str, tuple[Lens, RigidTransform]]:
    """Return a pair with zoom lenses at a value; the poses given are those of the pupils at the wide end.

    Each camera's pupil moves along its axis with the zoom, the pair's axes stay.
    """
    return {side: zoomed(_like(lens, side), T, zoom) for side, (lens, T) in pair.items()}


def zoomed(made: ZoomLens, T_world_wide: RigidTransform, zoom: float) -> tuple[Lens, RigidTransform]:
    """Return a zoom lens at a value, and where its pupil then stands; T_world_wide: where it stands at the wide end."""
    ahead = made.pupil_m(zoom) - made.pupil_m(made.zoom[0])
    return made.lens(zoom), T_world_wide * RigidTransform.from_translation([0.0, 0.0, ahead])


def _like(lens: Lens, side: str) -> ZoomLens:
    """Return a zoom lens whose wide end has a lens's focal length; left and right differ as two of a kind do."""
    plain = ZoomLens(width=lens.width, height=lens.height)
    pitch_mm = plain.wide_mm / lens.focal_px[0]
    scaled = replace(plain, pitch_mm=pitch_mm)
    if side == "left":
        return scaled
    return replace(scaled, bend=(0.11, -0.05), decentre_mm=(-0.009, 0.011, 0.007, 0.004), barrel=-0.074)
