"""Two images of a scene with their rig, and the patch of one view as a plane would show it in the other."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import convolve, map_coordinates, spline_filter

from armsight.errors import Inconsistent, UsageError
from armsight.optics import SIDES, Rig

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True, eq=False)
class StereoViews:
    """Grey images (h, w) of both cameras of a rig, taken of a scene at rest."""

    rig: Rig
    left: NDArray[np.uint8]
    right: NDArray[np.uint8]

    def __post_init__(self) -> None:
        for side in SIDES:
            shape, camera = getattr(self, side).shape, self.rig.camera(side)
            if shape != (camera.height, camera.width):
                raise Inconsistent(
                    f"the {side} image has shape {shape}, the rig's {side} camera {(camera.height, camera.width)}",
                    consequence="No point is looked for",
                    cure="Give the images of this rig's cameras, in their full size",
                )

    @cached_property
    def _levels(self) -> dict[str, Array]:
        return {side: getattr(self, side).astype(np.float64) for side in SIDES}

    @cached_property
    def _splines(self) -> dict[str, Array]:
        return {side: np.asarray(spline_filter(levels, order=3)) for side, levels in self._levels.items()}

    @cached_property
    def noise_levels2(self) -> float:
        """Variance of the noise of one pixel in grey levels squared, of both images together (Immerkaer 1996).

        By the median, so that edges do not count.
        """
        kernel = np.array([[1.0, -2.0, 1.0], [-2.0, 4.0, -2.0], [1.0, -2.0, 1.0]]) / 6.0  # of unit norm
        off = [np.abs(convolve(levels, kernel)) for levels in self._levels.values()]
        return float(np.mean([(np.median(one) / 0.6745) ** 2 for one in off]))

    def grey(self, side: str, uv_px: Array) -> Array:
        """Return the grey levels (n,) of a cubic spline through the pixels at uv_px (n, 2); NaN outside the image."""
        return _at(self._splines[side], uv_px, 3)

    def grey_fast(self, side: str, uv_px: Array) -> Array:
        """Return the grey levels (n,) at uv_px (n, 2), linear between pixels; NaN outside the image."""
        return _at(self._levels[side], uv_px, 1)


def _at(image: Array, uv_px: Array, order: Literal[1, 3]) -> Array:
    """Return an image's values (n,) at uv_px (n, 2) by splines of an order, NaN outside."""
    height, width = image.shape
    u, v = uv_px.T
    inside = (u >= 0.0) & (u <= width - 1.0) & (v >= 0.0) & (v <= height - 1.0)  # False for NaN
    out = np.full(len(u), np.nan)
    places: Array = np.stack([v[inside], u[inside]])
    out[inside] = map_coordinates(image, places, order=order, prefilter=False, mode="mirror")
    return out


def other_side(side: str) -> str:
    """Return the other of left and right; raises UsageError for a side that is neither."""
    if side not in SIDES:
        raise UsageError(f"the view {side!r} is neither left nor right", cure="Say in which one the points are picked")
    return SIDES[1 - SIDES.index(side)]


class Patch:
    """A square of pixels round one pixel of a view, and where planes through it are seen in the other view.

    px (2,): its middle; half_px: from the middle to its edge. A plane is given by inverse depths w, 1 / z in the
    camera's axes, which are affine over normalised rays.
    """

    def __init__(self, views: StereoViews, side: str, px: Array, half_px: int) -> None:
        self._views, self._side, self.other = views, side, other_side(side)
        steps = np.arange(-half_px, half_px + 1, dtype=np.float64)
        offsets = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)  # (n, 2) in u, v
        self.middle = len(offsets) // 2
        self.uv_px = px + offsets
        self.grey = views.grey(side, self.uv_px)
        rig = views.rig
        self._rays = rig.camera(side).rays(self.uv_px)  # (n, 2)
        self._T_other_side = rig.T_rig_camera(self.other).inv() * rig.T_rig_camera(side)
        self._camera = rig.camera(self.other)
        self._span = np.abs(self._rays - self._rays[self.middle]).max(axis=0)
        self.slopes = (self._rays - self._rays[self.middle]) / self._span  # (n, 2): about -1 to 1 over the patch

    @property
    def seen(self) -> bool:
        """Whether the whole patch is in the image and every pixel has a ray."""
        return bool(np.isfinite(self.grey).all() and np.isfinite(self._rays).all())

    def in_other(self, inverse_depth: Array) -> Array:
        """Return the pixels (..., 2) of the other view for inverse depths (..., n) in 1/m; NaN behind the camera."""
        w = np.asarray(inverse_depth)
        rays = np.broadcast_to(np.append(self._rays, np.ones((len(self._rays), 1)), axis=1), (*w.shape, 3))
        with np.errstate(divide="ignore", invalid="ignore"):
            points = np.where(w[..., None] > 0.0, rays / w[..., None], np.nan).reshape(-1, 3)
        out = np.full((len(points), 2), np.nan)
        ok = np.isfinite(points).all(axis=1)
        moved = self._T_other_side.apply(points[ok])
        moved[moved[:, 2] <= 0.0] = np.nan
        front = np.isfinite(moved).all(axis=1)
        uv = np.full((len(moved), 2), np.nan)
        if front.any():
            uv[front] = self._camera.project(moved[front])
        out[ok] = uv
        return out.reshape(*w.shape, 2)

    def on_plane(self, inverse_depth: float, slopes: Array) -> Array:
        """Return how the point of the middle moves (3, 2) in m per px of its view, on a plane through it.

        slopes (2,): change of the inverse depth by the patch's slopes. In the camera's axes.
        """
        near = self.uv_px[self.middle] + np.array([[-0.5, 0.0], [0.5, 0.0], [0.0, -0.5], [0.0, 0.5]])
        rays = self._views.rig.camera(self._side).rays(near)
        w = inverse_depth + (rays - self._rays[self.middle]) / self._span @ slopes
        points = np.append(rays, np.ones((4, 1)), axis=1) / w[:, None]
        return np.asarray(np.stack([points[1] - points[0], points[3] - points[2]], axis=1))
