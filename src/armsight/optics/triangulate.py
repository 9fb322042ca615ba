"""Points in space from their pixels in both views, each with its covariance."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import ArrayLike, NDArray

from armsight.errors import Degenerate, Inconsistent
from armsight.optics.kernels import triangulation as kernels
from armsight.optics.packed import PackedRig
from armsight.optics.rig import Rig

Array = NDArray[np.float64]


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
    """Points xyz_m (n, 3) in rig axes, covariance_m2 (n, 3, 3), chi2 (n,) of reprojection with 1 degree of freedom.

    verdict: (n,) of Verdict. Rows that are not FOUND are NaN: a batch keeps its order.
    """

    xyz_m: Array
    covariance_m2: Array
    chi2: Array
    verdict: NDArray[np.int8]

    @property
    def found(self) -> NDArray[np.bool_]:
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
    rig: Rig, left_px: ArrayLike, right_px: ArrayLike, cov_left_px2: ArrayLike, cov_right_px2: ArrayLike
) -> Triangulation:
    """Return the points of greatest likelihood: least whitened reprojection error in both distorted images.

    left_px, right_px: (n, 2). cov_left_px2, cov_right_px2: (n, 2, 2), or (2, 2) for all rows.
    Raises Inconsistent where the shapes do not belong together.
    """
    return _triangulate(rig, left_px, right_px, cov_left_px2, cov_right_px2, likeliest=True)


def triangulate_closed(
    rig: Rig, left_px: ArrayLike, right_px: ArrayLike, cov_left_px2: ArrayLike, cov_right_px2: ArrayLike
) -> Triangulation:
    """Return the points of the linear closed form, with first-order covariances; arguments as `triangulate`."""
    return _triangulate(rig, left_px, right_px, cov_left_px2, cov_right_px2, likeliest=False)


def stack_pairs(left: ArrayLike, right: ArrayLike, shape: tuple[int, ...]) -> Array:
    """Return (n, 2, *shape) [row, side] from two (n, *shape) arrays, or (*shape) to be repeated.

    Raises Inconsistent where the two differ in shape.
    """
    a, b = np.asarray(left, float), np.asarray(right, float)
    if a.shape != b.shape or a.shape[a.ndim - len(shape) :] != shape:
        raise Inconsistent(f"left has shape {a.shape} and right {b.shape}; both should be (n, {shape})")
    return np.ascontiguousarray(np.stack([a, b], axis=a.ndim - len(shape)))


def _triangulate(
    rig: Rig,
    left_px: ArrayLike,
    right_px: ArrayLike,
    cov_left_px2: ArrayLike,
    cov_right_px2: ArrayLike,
    *,
    likeliest: bool,
) -> Triangulation:
    packed = PackedRig.of(rig)
    uv = stack_pairs(np.atleast_2d(left_px), np.atleast_2d(right_px), (2,))  # (n, 2, 2)
    n = len(uv)
    cov = stack_pairs(cov_left_px2, cov_right_px2, (2, 2))
    if cov.ndim == 3:
        cov = np.repeat(cov[None], n, axis=0)  # (n, 2, 2, 2)
    if len(cov) != n:
        raise Inconsistent(f"{n} pairs of pixels with {len(cov)} covariances")
    xyz, covariance, chi2 = np.full((n, 3), np.nan), np.full((n, 3, 3), np.nan), np.full(n, np.nan)
    verdict = np.zeros(n, np.int8)
    kernels.triangulate_rows(packed.k, packed.R, packed.t, uv, cov, likeliest, xyz, covariance, chi2, verdict)
    return Triangulation(xyz_m=xyz, covariance_m2=covariance, chi2=chi2, verdict=verdict)
