"""Points in space from their pixels in both views, each with its covariance."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import ArrayLike, NDArray

from armsight.arrays import Array, Mask
from armsight.errors import Degenerate, Inconsistent
from armsight.optics.kernels import triangulation as kernels
from armsight.optics.rig import PackedRig, Rig
from armsight.records import checked_array, checked_rows, real_array, require_kind


class Verdict(IntEnum):
    """What became of a pair of pixels."""

    FOUND = kernels.FOUND
    NO_RAY = kernels.NO_RAY
    PARALLEL = kernels.PARALLEL
    BEHIND = kernels.BEHIND


_WORDS = {
    Verdict.NO_RAY: "a pixel has no ray under the camera's distortion, or no covariance",
    Verdict.PARALLEL: "the rays are parallel within their standard deviations",
    Verdict.BEHIND: "the rays meet behind a camera (left and right swapped, or a wrong pair)",
}


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Triangulation:
    """Points xyz_m (n, 3) in rig axes, covariance_m2 (n, 3, 3), chi2 (n,), verdict (n,); NaN where not FOUND."""

    xyz_m: Array
    covariance_m2: Array
    chi2: Array
    verdict: NDArray[np.int8]

    @property
    def found(self) -> Mask:
        """Which rows (n,) are points."""
        return np.asarray(self.verdict == Verdict.FOUND)

    def require_all(self) -> Triangulation:
        """Return itself, or raise Degenerate saying which rows are no points and why."""
        bad = np.flatnonzero(~self.found)
        if len(bad):
            words = _WORDS[Verdict(int(self.verdict[bad[0]]))]
            raise Degenerate(
                f"{len(bad)} of {len(self.verdict)} pairs of pixels give no point; row {bad[0]}: {words}",
                consequence="Nothing is triangulated",
                cure="Leave these rows out, or check which image is the left one",
            )
        return self


def triangulate(
    rig: Rig,
    uv_left_px: ArrayLike,
    uv_right_px: ArrayLike,
    covariance_left_px2: ArrayLike,
    covariance_right_px2: ArrayLike,
) -> Triangulation:
    """Return the points of greatest likelihood: least whitened reprojection error in both distorted images.

    uv_left_px, uv_right_px: (n, 2), or (2,) of one point. covariance_left_px2, covariance_right_px2: (n, 2, 2), or
    (2, 2) for all rows.
    A row that is NaN in any of them gives none (`Verdict.NO_RAY`). Raises Inconsistent where the shapes do not belong
    together.

    Examples
    --------
    >>> rig = armsight.simulate("hand-cell", frames=1).rig
    >>> left, right = rig.project([[0.1, 0.0, 1.0]])
    >>> armsight.triangulate(rig, left, right, np.eye(2), np.eye(2)).xyz_m.round(6) + 0.0
    array([[0.1, 0. , 1. ]])
    """
    return _triangulate(rig, uv_left_px, uv_right_px, covariance_left_px2, covariance_right_px2, likeliest=True)


def triangulate_closed(
    rig: Rig,
    uv_left_px: ArrayLike,
    uv_right_px: ArrayLike,
    covariance_left_px2: ArrayLike,
    covariance_right_px2: ArrayLike,
) -> Triangulation:
    """Return the points of the linear closed form, with first-order covariances; arguments as `triangulate`."""
    return _triangulate(rig, uv_left_px, uv_right_px, covariance_left_px2, covariance_right_px2, likeliest=False)


def _triangulate(
    rig: Rig,
    uv_left_px: ArrayLike,
    uv_right_px: ArrayLike,
    covariance_left_px2: ArrayLike,
    covariance_right_px2: ArrayLike,
    *,
    likeliest: bool,
) -> Triangulation:
    require_kind("rig", rig, Rig)
    packed = PackedRig.of(rig.pair())
    left, right = (
        checked_rows("uv_left_px", uv_left_px, 2, nan=True),
        checked_rows("uv_right_px", uv_right_px, 2, nan=True),
    )
    n = len(left)
    if len(right) != n:
        raise Inconsistent(
            f"{n} pixels on the left and {len(right)} on the right",
            consequence="Nothing is triangulated",
            cure="Give as many of both, row by row of the same point",
        )
    uv, cov = np.empty((n, 2, 2)), np.empty((n, 2, 2, 2))
    uv[:, 0], uv[:, 1] = left, right
    cov[:, 0], cov[:, 1] = (
        _covariances("covariance_left_px2", covariance_left_px2, n),
        _covariances("covariance_right_px2", covariance_right_px2, n),
    )
    return _rows(packed, uv, cov, likeliest=likeliest)


def triangulate_views(rig: Rig, uv_px: Array, covariance_px2: Array) -> Triangulation:
    """Return the points of greatest likelihood by all cameras of a rig, as `triangulate` does by two.

    uv_px (n, V, 2), covariance_px2 (n, V, 2, 2): infinite where a camera does not show the point; two at least do.
    """
    return _rows(PackedRig.of(rig), uv_px, covariance_px2, likeliest=True)


def _rows(packed: PackedRig, uv: Array, cov: Array, *, likeliest: bool) -> Triangulation:
    n = len(uv)
    xyz, covariance, chi2 = np.empty((n, 3)), np.empty((n, 3, 3)), np.empty(n)
    chi2.fill(np.nan)
    verdict = np.zeros(n, np.int8)
    kernels.triangulate_rows(packed.arrays, uv, cov, likeliest, xyz, covariance, chi2, verdict)
    return Triangulation(xyz_m=xyz, covariance_m2=covariance, chi2=chi2, verdict=verdict)


def _covariances(name: str, value: ArrayLike, n: int) -> Array:
    """Return (n, 2, 2), or (2, 2) for all rows."""
    array = real_array(name, value)
    return checked_array(name, array, (2, 2) if array.ndim == 2 else (n, 2, 2), nan=True)


def epipolar_distance(rig: Rig, left_px: ArrayLike, right_px: ArrayLike) -> Array:
    """Return (n, 2): signed distance in px of each left pixel from its partner's line, and of each right pixel.

    left_px, right_px: (n, 2) as seen, with distortion; the line is the tangent of the epipolar curve at the
    pixel. NaN where a pixel has no ray. For a parallel pair both are the difference of the rows.
    """
    packed = PackedRig.of(rig.pair())
    rays = [_rays(packed, side, px) for side, px in enumerate((left_px, right_px))]
    if len(rays[0][0]) != len(rays[1][0]):
        raise Inconsistent(f"{len(rays[0][0])} left pixels with {len(rays[1][0])} right ones", cure="Give pairs")
    out = np.full((len(rays[0][0]), 2), np.nan)
    kernels.epipolar_rows(*rays[0], *rays[1], packed.baseline, out)
    return out


def epipolar_chi2(
    packed: PackedRig, left_px: Array, cov_left_px2: Array, right_px: Array, cov_right_px2: Array
) -> Array:
    """Return (n, m): squared epipolar distance of every left spot to every right one, whitened (1 degree of freedom).

    left_px (n, 2) with cov_left_px2 (n, 2, 2); right_px (m, 2) with cov_right_px2 (m, 2, 2). NaN without a ray.
    """
    d_left, D_left = _rays(packed, 0, left_px)
    d_right, D_right = _rays(packed, 1, right_px)
    cov_left_px2 = checked_array("cov_left_px2", cov_left_px2, (len(d_left), 2, 2))
    cov_right_px2 = checked_array("cov_right_px2", cov_right_px2, (len(d_right), 2, 2))
    chi2 = np.empty((len(d_left), len(d_right)))
    kernels.epipolar_matrix(d_left, D_left, cov_left_px2, d_right, D_right, cov_right_px2, packed.baseline, chi2)
    return chi2


def _rays(packed: PackedRig, side: int, px: ArrayLike) -> tuple[Array, Array]:
    """Return the rays (n, 3) and their derivatives (n, 3, 2) by the pixels of one side."""
    uv = checked_rows("left_px" if side == 0 else "right_px", px, 2, nan=True).view()
    uv.setflags(write=False)  # one type of array for the kernel, whoever owns it
    d, D, ok = np.empty((len(uv), 3)), np.empty((len(uv), 3, 2)), np.empty(len(uv), np.bool_)
    kernels.rays_in_rig(packed.k[side], packed.R[side], uv, d, D, ok)
    return d, D


def epipolar_curve(rig: Rig, side: str, px: ArrayLike, depths_m: ArrayLike) -> Array:
    """Return (m, 2): where in the other camera's image a pixel (2,) of `side` may be, from near to far.

    depths_m (m,): along the pixel's ray. NaN behind the other camera, and where the pixel has no ray. Lens distortion
    bends the curve; points outside the image are given too.
    """
    other = "right" if side == "left" else "left"
    x, y = rig.camera(side).rays(checked_array("px", px, (2,), nan=True))[0]
    along = checked_array("depths_m", depths_m, (None,))[:, None] * np.array([x, y, 1.0])
    T_other_side = rig.T_rig_camera(other).inv() * rig.T_rig_camera(side)
    points = T_other_side.apply(along)
    uv = np.full((len(along), 2), np.nan)
    front = np.isfinite(points).all(axis=1) & (points[:, 2] > 0.0)
    if front.any():
        uv[front] = rig.camera(other).project(points[front])
    return uv
