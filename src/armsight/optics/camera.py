"""A pinhole camera with skew and Brown-Conrady distortion."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from armsight.errors import Inconsistent
from armsight.optics.kernels.camera import project_many, undistort_many
from armsight.records import Saveable, frozen_array

Array = NDArray[np.float64]

INTRINSICS = ("fx", "fy", "cx", "cy", "skew", "k1", "k2", "p1", "p2", "k3")
"""Names and order of a camera's intrinsics vector; fx..skew in px, the rest without unit."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Plate:
    """A plane glass plate at 45 degrees before the lens, through which a mirror rig's left view goes."""

    thickness_m: float
    index: float = 1.5

    def __post_init__(self) -> None:
        if not (0.0 < self.thickness_m < 0.1 and 1.0 < self.index < 3.0):
            raise Inconsistent(
                f"a glass plate {self.thickness_m:g} m thick of refractive index {self.index:g} cannot be",
                cure="Give the thickness in metres; glass has an index of about 1.5",
            )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Camera(Saveable):
    """Image size in px and intrinsics (10,) in the order of INTRINSICS.

    Model: x = X/Z, y = Y/Z; Brown-Conrady with k1, k2, k3 radial and p1, p2 tangential (OpenCV's order in
    files: k1, k2, p1, p2, k3); u = fx xd + skew yd + cx, v = fy yd + cy. plate: the camera looks through one, its
    normal (-1, 0, 1); the camera's centre is then where the optical axis seems to come from (MATH 3.1).
    """

    width: int
    height: int
    intrinsics: Array
    plate: Plate | None = None

    def __post_init__(self) -> None:
        k = frozen_array("intrinsics", self.intrinsics, (len(INTRINSICS),))
        object.__setattr__(self, "intrinsics", k)
        if self.width < 1 or self.height < 1:
            raise Inconsistent(f"an image of {self.width}x{self.height} px cannot be")
        if not (k[0] > 0.0 and k[1] > 0.0):
            raise Inconsistent(
                f"focal lengths fx {k[0]:g}, fy {k[1]:g} px are not positive",
                consequence="The camera has no rays",
                cure="Calibrate it again, or correct the file",
            )

    @classmethod
    def pinhole(
        cls,
        width: int,
        height: int,
        fx: float,
        fy: float,
        cx: float,
        cy: float,
        *,
        skew: float = 0.0,
        distortion: ArrayLike = (0.0, 0.0, 0.0, 0.0, 0.0),
    ) -> Camera:
        """Return a camera from its usual parameters; distortion is k1, k2, p1, p2, k3."""
        return cls(
            width=width,
            height=height,
            intrinsics=np.concatenate([[fx, fy, cx, cy, skew], np.asarray(distortion, float)]),
        )

    @property
    def packed(self) -> Array:
        """Intrinsics and plate (12,) as the compiled code takes them; zeros without a plate."""
        plate = (0.0, 1.0) if self.plate is None else (self.plate.thickness_m, self.plate.index)
        return np.concatenate([self.intrinsics, plate])

    @property
    def matrix(self) -> Array:
        """The (3, 3) camera matrix in px."""
        fx, fy, cx, cy, skew = self.intrinsics[:5]
        return np.array([[fx, skew, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])

    @property
    def distortion(self) -> Array:
        """k1, k2, p1, p2, k3."""
        return np.asarray(self.intrinsics[5:])

    def project(self, points_m: ArrayLike) -> Array:
        """Return the pixels (n, 2) of points (n, 3) in camera axes; NaN for points behind the camera."""
        X = np.ascontiguousarray(np.atleast_2d(np.asarray(points_m, float)))
        uv = np.empty((len(X), 2))
        project_many(self.packed, np.eye(3), np.zeros(3), X, uv)
        return uv

    def rays(self, uv_px: ArrayLike) -> Array:
        """Return the normalised rays (n, 2) = (X/Z, Y/Z) of pixels (n, 2); NaN where a pixel has none.

        Directions: through a plate a ray does not go through the camera's centre, but up to 0.2 mm beside it.
        """
        uv = np.ascontiguousarray(np.atleast_2d(np.asarray(uv_px, float)))
        xy = np.empty_like(uv)
        undistort_many(self.intrinsics, uv, xy)
        return xy

    def is_close(self, other: Camera, *, tol: float) -> bool:
        """Tell whether two cameras have the same size, intrinsics and plate within tol."""
        return (self.width, self.height) == (other.width, other.height) and bool(
            np.allclose(self.packed, other.packed, rtol=0.0, atol=tol)
        )
