"""How far a pair of pixels is from lying in one plane with the baseline."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from armsight.errors import Inconsistent
from armsight.geometry.poses import skew
from armsight.optics.kernels import rays as kernels
from armsight.optics.packed import PackedRig
from armsight.optics.rig import Rig
from armsight.records import checked_array, checked_rows

Array = NDArray[np.float64]


def fundamental_matrix(rig: Rig) -> Array:
    """Return F (3, 3), of unit norm, with (u, v, 1)_right F (u, v, 1)_left = 0 for undistorted pixels."""
    T_right_left = rig.T_rig_right.inv() * rig.T_rig_left
    E = skew(T_right_left.translation) @ T_right_left.rotation.as_matrix()  # (3, 3) essential
    F = np.linalg.inv(rig.right.matrix).T @ E @ np.linalg.inv(rig.left.matrix)
    return np.asarray(F / np.linalg.norm(F))


def epipolar_distance(rig: Rig, left_px: ArrayLike, right_px: ArrayLike) -> Array:
    """Return (n, 2): signed distance in px of each left pixel from its partner's line, and of each right pixel.

    left_px, right_px: (n, 2) as seen, with distortion; the line is the tangent of the epipolar curve at the
    pixel. NaN where a pixel has no ray. For a parallel pair both are the difference of the rows.
    """
    packed = PackedRig.of(rig)
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
    uv = checked_rows("left_px" if side == 0 else "right_px", px, 2, nan=True)
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
