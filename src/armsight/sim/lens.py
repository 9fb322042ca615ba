"""The simulated lens: from first principles, so that the product's own projection can be tested against it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from armsight.errors import Inconsistent
from armsight.records import frozen_array
from armsight.sim.lenses.kernels import see_points, trace_rays

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Lens:
    """A pinhole with skew behind a Brown-Conrady lens, or a fisheye lens.

    width, height, focal_px (fx, fy), centre_px (cx, cy) and skew_px in px; distortion is k1, k2, p1, p2, k3
    without unit, of a fisheye k1, k2, k3, k4, 0. A ray (x, y, 1) lands at u = fx xd + skew yd + cx, v = fy yd + cy.
    """

    width: int
    height: int
    focal_px: tuple[float, float]
    centre_px: tuple[float, float]
    skew_px: float = 0.0
    distortion: tuple[float, float, float, float, float] = (0.0, 0.0, 0.0, 0.0, 0.0)
    fisheye: bool = False

    def __post_init__(self) -> None:
        frozen_array("lens", self.vector, (11,))
        if self.width < 1 or self.height < 1 or min(self.focal_px) <= 0.0:
            raise Inconsistent(f"a lens of {self.width}x{self.height} px with focal lengths {self.focal_px} cannot be")

    @property
    def vector(self) -> Array:
        """The eleven numbers in the order the kernels take them."""
        return np.array(
            [*self.focal_px, *self.centre_px, self.skew_px, *self.distortion, float(self.fisheye)], dtype=np.float64
        )

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
            **({"lens": "fisheye"} if self.fisheye else {}),
            "width": self.width,
            "height": self.height,
            "fx": fx,
            "fy": fy,
            "cx": cx,
            "cy": cy,
            "skew": self.skew_px,
            "distortion": list(self.distortion[:4] if self.fisheye else self.distortion),
        }
