"""A camera with skew: a pinhole with Brown-Conrady distortion, OpenCV's rational model, or a fisheye lens."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from types import NoneType

import numpy as np
from numpy.polynomial import Polynomial
from numpy.typing import ArrayLike

from armsight import records
from armsight.arrays import Array
from armsight.defaults import GLASS
from armsight.errors import Inconsistent
from armsight.optics.kernels.camera import project_many, undistort_many
from armsight.optics.kernels.wide import FISHEYE, RATIONAL

SIDES = ("left", "right")

INTRINSICS = ("fx", "fy", "cx", "cy", "skew", "k1", "k2", "p1", "p2", "k3")
"""Names and order of a camera's intrinsics vector; fx..skew in px, the rest without unit."""

FISHEYE_INTRINSICS = ("fx", "fy", "cx", "cy", "skew", "k1", "k2", "k3", "k4", "none")
"""The same of a fisheye lens; the last place is empty, zero and never free."""

RATIONAL_INTRINSICS = (*INTRINSICS, "k4", "k5", "k6")
"""The same of a rational lens, in OpenCV's order of its eight coefficients."""

WIDEST_RAD = float(np.radians(85.0))
"""Rays are X/Z, Y/Z here, which a ray at 90 degrees has not; at 85 they are 11.4 and a pixel changes them by 130 times
what it does in the middle. Beyond it a fisheye or rational lens is not used."""

FURTHEST_OUTSIDE = 1.0
"""Image sizes by which the principal point may lie outside, as in the corner of a sensor that was cut out of it; and
always a focal length: a lens draws at 45 degrees from its axis, so that small windows of large sensors are taken."""

NO_TURN, NO_SHIFT = records.frozen_array("R", np.eye(3), (3, 3)), records.frozen_array("t", np.zeros(3), (3,))


class LensKind(StrEnum):
    """A pinhole with Brown-Conrady distortion, a fisheye (OpenCV's fisheye, Kalibr's equidistant), or OpenCV's rational
    model with eight coefficients."""

    PINHOLE = "pinhole"
    FISHEYE = "fisheye"
    RATIONAL = "rational"


PACKED = len(RATIONAL_INTRINSICS) + 2
"""Numbers of a camera as compiled code takes it."""
INTRINSICS_OF = {
    LensKind.PINHOLE: INTRINSICS,
    LensKind.FISHEYE: FISHEYE_INTRINSICS,
    LensKind.RATIONAL: RATIONAL_INTRINSICS,
}
EMPTY_PLACE = FISHEYE_INTRINSICS[-1]
"""The name of a place among intrinsics that stands for nothing."""


def coefficients_of(lens: LensKind) -> tuple[str, ...]:
    """Return the names of a lens's distortion coefficients, in the order of files."""
    return tuple(name for name in INTRINSICS_OF[lens][5:] if name != EMPTY_PLACE)


def names_beside(lenses: Sequence[LensKind]) -> list[tuple[str, ...]]:
    """Return the names of the intrinsics of cameras of these lenses, equally many of each, the rest empty places."""
    own = [INTRINSICS_OF[lens] for lens in lenses]
    n = max(map(len, own))
    return [names + (EMPTY_PLACE,) * (n - len(names)) for names in own]


@dataclass(frozen=True, slots=True, kw_only=True)
class Plate:
    """A plane glass plate at 45 degrees before the lens, through which a mirror rig's left view goes."""

    thickness_m: float
    index: float = GLASS

    def __post_init__(self) -> None:
        if not (0.0 < self.thickness_m < 0.1 and 1.0 < self.index < 3.0):
            raise Inconsistent(
                f"a glass plate {self.thickness_m:g} m thick of refractive index {self.index:g} cannot be",
                cure="Give the thickness in metres; glass has an index of about 1.5",
            )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Camera(records.Saveable):
    """Image size in px and intrinsics (10,) in the order of INTRINSICS, of a fisheye lens of FISHEYE_INTRINSICS, of a
    rational one (13,) of RATIONAL_INTRINSICS.

    Model: x = X/Z, y = Y/Z; Brown-Conrady with k1, k2, k3 radial and p1, p2 tangential (OpenCV's order in
    files: k1, k2, p1, p2, k3); u = fx xd + skew yd + cx, v = fy yd + cy. Fisheye: (xd, yd) = (x, y) theta_d / r with
    r = hypot(x, y), theta = atan(r), theta_d = theta (1 + k1 theta^2 + k2 theta^4 + k3 theta^6 + k4 theta^8) (Kannala
    and Brandt 2006, equation 6). Rational: Brown-Conrady, the radial factor divided by 1 + k4 r^2 + k5 r^4 + k6 r^6. Of
    both points further than widest_rad from the axis have no image. plate: the camera looks through one, its normal
    (-1, 0, 1); the camera's centre is then where the optical axis seems to come from
    (MATH 3.1). packed (15,): intrinsics and plate as the compiled code takes them; zeros without a plate, see its
    FISHEYE and RATIONAL.
    """

    width: int
    height: int
    intrinsics: Array
    plate: Plate | None = None
    lens: LensKind = LensKind.PINHOLE
    packed: Array = field(init=False, repr=False)

    def __post_init__(self) -> None:
        records.require_count("width", self.width)
        records.require_count("height", self.height)
        records.require_kind("plate", self.plate, Plate, NoneType)
        object.__setattr__(self, "lens", records.one_of(LensKind, "lens", self.lens))
        k = records.frozen_array("intrinsics", self.intrinsics, (len(self.names),))
        object.__setattr__(self, "intrinsics", k)
        if self.width < 1 or self.height < 1:
            raise Inconsistent(f"an image of {self.width}x{self.height} px cannot be", cure="Give its size in px")
        if not (k[0] > 0.0 and k[1] > 0.0):
            raise Inconsistent(
                f"focal lengths fx {k[0]:g}, fy {k[1]:g} px are not positive",
                consequence="The camera has no rays",
                cure="Calibrate it again, or correct the file",
            )
        self._require_middle()
        if self.lens is LensKind.FISHEYE and (self.plate is not None or k[9] != 0.0):
            raise Inconsistent(
                "a fisheye lens with " + ("a glass plate before it" if self.plate else "a fifth coefficient"),
                consequence="The model has k1, k2, k3, k4 and no plate",
                cure="Say lens: pinhole for five coefficients or a mirror rig",
            )
        if self.lens is LensKind.RATIONAL and self.plate is not None:
            raise Inconsistent(
                "a rational lens with a glass plate before it", cure="Say lens: pinhole for a mirror rig"
            )
        flag = {LensKind.FISHEYE: FISHEYE, LensKind.RATIONAL: RATIONAL}.get(self.lens)
        if flag is not None:
            rest = (flag, float(np.tan(self.widest_rad)))
        else:
            rest = (0.0, 1.0) if self.plate is None else (self.plate.thickness_m, self.plate.index)
        packed = np.concatenate([k[:10], rest, k[10:], np.zeros(len(RATIONAL_INTRINSICS) - len(k))])
        packed.setflags(write=False)
        object.__setattr__(self, "packed", packed)

    def _require_middle(self) -> None:
        """Raise Inconsistent where the optical axis meets the image's plane where no lens puts it."""
        for name, at, f, size in zip(
            ("cx", "cy"), self.intrinsics[2:4], self.intrinsics[:2], (self.width, self.height), strict=True
        ):
            outside = max(-at, at - size)
            if outside > max(FURTHEST_OUTSIDE * size, f):
                raise Inconsistent(
                    f"the principal point {name} {at:g} px is {outside:.0f} px outside an image of {self.width}x"
                    f"{self.height} px, further than the image's size and than the focal length of {f:g} px",
                    consequence="No lens draws an image so far from its axis: every ray would be wrong",
                    cure="Look for a wrong decimal point, a unit other than px, fx and cx swapped, or the image size "
                    "of another camera; or calibrate it again",
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
            intrinsics=_intrinsics(fx, fy, cx, cy, skew, records.checked_array("distortion", distortion, (5,))),
        )

    @classmethod
    def fisheye(
        cls,
        width: int,
        height: int,
        fx: float,
        fy: float,
        cx: float,
        cy: float,
        *,
        skew: float = 0.0,
        distortion: ArrayLike = (0.0, 0.0, 0.0, 0.0),
    ) -> Camera:
        """Return a camera with a fisheye lens; distortion is k1, k2, k3, k4. Raises Inconsistent for another number."""
        k = records.real_array("distortion", distortion)
        if k.shape != (4,):
            raise Inconsistent(
                f"a fisheye lens with {k.size} coefficients",
                consequence="The model has four: k1, k2, k3, k4",
                cure="Say lens: pinhole for k1, k2, p1, p2, k3",
            )
        intrinsics = _intrinsics(fx, fy, cx, cy, skew, [*records.checked_array("distortion", k, (4,)), 0.0])
        return cls(width=width, height=height, intrinsics=intrinsics, lens=LensKind.FISHEYE)

    @classmethod
    def rational(
        cls,
        width: int,
        height: int,
        fx: float,
        fy: float,
        cx: float,
        cy: float,
        *,
        skew: float = 0.0,
        distortion: ArrayLike = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
    ) -> Camera:
        """Return a camera with OpenCV's rational model; distortion is k1, k2, p1, p2, k3, k4, k5, k6."""
        k = records.checked_array("distortion", distortion, (8,))
        return cls(width=width, height=height, intrinsics=_intrinsics(fx, fy, cx, cy, skew, k), lens=LensKind.RATIONAL)

    @property
    def names(self) -> tuple[str, ...]:
        """The names of the intrinsics, in their order."""
        return INTRINSICS_OF[self.lens]

    @property
    def widest_rad(self) -> float:
        """The angle from the optical axis up to which it is used: 90 degrees; a fisheye's or a rational lens's 85, less
        where it folds: where its image no longer grows outwards."""
        if self.lens is LensKind.PINHOLE:
            return float(np.pi / 2.0)
        if self.lens is LensKind.RATIONAL:
            return min(WIDEST_RAD, float(np.arctan(np.sqrt(_rational_end(self.intrinsics)))))
        k1, k2, k3, k4 = self.intrinsics[5:9]
        turns = np.roots([9.0 * k4, 7.0 * k3, 5.0 * k2, 3.0 * k1, 1.0])  # theta^2 where d theta_d / d theta = 0
        folds = [float(np.sqrt(q.real)) for q in turns if abs(q.imag) < 1e-9 * abs(q) and q.real > 0.0]
        return min([WIDEST_RAD, *folds])

    @property
    def named(self) -> dict[str, float]:
        """The intrinsics by name, in their order, without empty places."""
        return {
            name: value for name, value in zip(self.names, self.intrinsics.tolist(), strict=True) if name != EMPTY_PLACE
        }

    @property
    def matrix(self) -> Array:
        """The (3, 3) camera matrix in px."""
        fx, fy, cx, cy, skew = self.intrinsics[:5]
        return np.array([[fx, skew, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])

    @property
    def distortion(self) -> Array:
        """k1, k2, p1, p2, k3; of a fisheye lens k1, k2, k3, k4; of a rational one k1, k2, p1, p2, k3, k4, k5, k6."""
        return np.asarray(self.intrinsics[5 : 5 + len(coefficients_of(self.lens))])

    def project(self, points_m: ArrayLike) -> Array:
        """Return pixels (n, 2) of points (n, 3) or (3,) in camera axes, m; NaN without one. Raises Inconsistent."""
        X = records.checked_rows("points_m", points_m, 3, nan=True)
        uv = np.empty((len(X), 2))
        project_many(self.packed, NO_TURN, NO_SHIFT, X, uv)
        return uv

    def rays(self, uv_px: ArrayLike) -> Array:
        """Return the normalised rays (n, 2) = (X/Z, Y/Z) of pixels (n, 2) or one (2,).

        NaN where a pixel has none or is NaN. Raises Inconsistent for any other shape.
        Directions: through a plate a ray does not go through the camera's centre, but up to 0.2 mm beside it.
        """
        uv = records.checked_rows("uv_px", uv_px, 2, nan=True)
        xy = np.empty_like(uv)
        undistort_many(self.packed, uv, xy)
        return xy

    def is_close(self, other: Camera, *, tol: float) -> bool:
        """Tell whether two cameras have the same size, lens, intrinsics and plate within tol."""
        records.require_kind("other", other, Camera)
        records.require_number("tol", tol)
        return (self.width, self.height, self.lens) == (other.width, other.height, other.lens) and bool(
            np.allclose(self.packed, other.packed, rtol=0.0, atol=tol)
        )


def with_step(camera: Camera, step: Array) -> Camera:
    """Return a camera with its intrinsics moved by a step (n,), whose places beyond them are empty."""
    return replace(camera, intrinsics=camera.intrinsics + step[: len(camera.names)])


def _rational_end(k: Array) -> float:
    """Return r^2 where a rational lens of intrinsics k (13,) first has a pole or folds, infinity where never."""
    top, bottom = Polynomial([1.0, *k[[5, 6, 9]]]), Polynomial([1.0, *k[10:]])
    # d (r top / bottom) / d r has the sign of this, in q = r^2
    growth = top * bottom + Polynomial([0.0, 2.0]) * (top.deriv() * bottom - top * bottom.deriv())
    ends = np.concatenate([part.trim().roots() for part in (bottom, growth)])
    return float(min(ends.real[(abs(ends.imag) < 1e-9 * abs(ends)) & (ends.real > 0.0)], default=np.inf))


def _intrinsics(fx: float, fy: float, cx: float, cy: float, skew: float, distortion: ArrayLike) -> Array:
    """Return fx, fy, cx, cy, skew (px) with the coefficients (5,) as one vector; raises UsageError for no numbers."""
    for name, value in (("fx", fx), ("fy", fy), ("cx", cx), ("cy", cy), ("skew", skew)):
        records.require_number(name, value)
    return np.concatenate([[fx, fy, cx, cy, skew], np.asarray(distortion, float)])
