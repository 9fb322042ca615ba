"""Two images of a scene with their rig, and a patch of one matched in the other as a piece of a plane.

Least squares as Gruen 1985, with the plane as in Habbecke, Kobbelt 2007.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
import scipy  # loads its ndimage where it is used
from numpy.typing import NDArray

from armsight.arrays import Array
from armsight.errors import Degenerate, Inconsistent, NotConverged, UsageError
from armsight.optics import SIDES, Rig

STEPS = 30
SETTLED_PX = np.array([1e-3, 2e-2, 2e-2, 1e-3])
FARTHEST_PX = 3.0
"""From where the search ended; beyond it another place was slid to."""
SLOPE_STD = 0.5
"""Standard deviation of a surface's slope, as change of disparity by pixels."""
DIFFERENCE_PX = 0.05
SHARED_NOISE = 1.4
"""Between pixels both pictures are interpolated, so that neighbours share noise: errors of rendered planes, squared, by
what residuals alone claim."""
NOISE_DERIVATIVE = 2.2
"""Variance of the slope of a cubic spline through white noise of variance 1: 1.1 to 3.4 by the place in a pixel."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Refined:
    """Where a patch's middle is in the other view: other_px (2,) with covariance_px2 (2, 2), std_px along the line.

    inverse_depth: of the middle, 1/m; slopes (2,): its change from the patch's middle to its edge, by the patch's
    slopes. correlation: of the patch on this plane.
    """

    other_px: Array
    covariance_px2: Array
    std_px: float
    correlation: float
    inverse_depth: float
    slopes: Array


def correlation(seen: Array, patch: Array) -> Array:
    """Return the normalised correlation (m,) of grey levels (m, n) with a patch (n,); NaN where some are not seen."""
    a = seen - seen.mean(axis=1, keepdims=True)
    b = patch - patch.mean()
    size = np.linalg.norm(a, axis=1) * np.linalg.norm(b)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray(np.where(size > 1e-9, a @ b / size, np.where(np.isnan(size), np.nan, 0.0)))


def refined(views: StereoViews, patch: Patch, inverse_depth: float, epipolar_std_px: float) -> Refined:
    """Return the place of least squares near an inverse depth in 1/m.

    Unknown are the shift along the line, the plane's two slopes and the distance from the line (all in px; the latter
    three held by their standard deviations), gain and offset of the grey levels. Raises NotConverged where this slides
    away or does not settle, Degenerate where a part of it is not seen in the other view.
    """
    model = _Model(views, patch, inverse_depth)
    held = np.array([math.inf, *[SLOPE_STD * model.half_px] * 2, epipolar_std_px])
    p = np.zeros(4)
    for _ in range(STEPS):
        r, J, _ = model.linearised(p)
        variance = max(float(r @ r) / (len(r) - 6), 1e-12)
        information = J.T @ J / variance + np.diag(held**-2)
        step = np.linalg.solve(information, J.T @ r / variance - p * held**-2)
        step *= min(1.0, 1.0 / float(np.abs(step).max() + 1e-12))
        p = p + step
        if abs(p[0]) > FARTHEST_PX:
            raise _lost(f"slid {p[0]:.1f} px away from where the search found it")
        if (np.abs(step) < SETTLED_PX).all():
            break
    else:
        raise _lost("did not settle")
    r, J, seen = model.linearised(p)
    cov = _covariance(r, J, views.noise_levels2 * model.noise_in_derivatives(), np.diag(held**-2))
    axes = np.stack([model.along, model.across], axis=1)  # (2, 2)
    return Refined(
        other_px=model.positions(p)[patch.middle],
        covariance_px2=axes @ cov[np.ix_([0, 3], [0, 3])] @ axes.T + 1e-6 * np.eye(2),
        std_px=math.sqrt(float(cov[0, 0])),
        correlation=float(correlation(seen[None], patch.grey)[0]),
        inverse_depth=inverse_depth + model.per_px * p[0],
        slopes=model.per_px * p[1:3],
    )


class _Model:
    """Grey levels of the patch's plane in the other view by p (4,): shift, two slopes, distance from the line; px."""

    def __init__(self, views: StereoViews, patch: Patch, inverse_depth: float) -> None:
        self._views, self._patch, self._w = views, patch, inverse_depth
        self.half_px = 0.5 * (math.sqrt(len(patch.grey)) - 1.0)
        near = patch.in_other(np.outer([0.999, 1.001], np.full(len(patch.grey), inverse_depth)))[:, patch.middle]
        way = near[1] - near[0]
        length = float(np.linalg.norm(way))
        if not length > 1e-9:
            raise Degenerate("the epipolar line has no direction there", consequence="No point is given")
        self.along = way / length
        self.across = np.array([-self.along[1], self.along[0]])
        self.per_px = 0.002 * inverse_depth / length

    def positions(self, p: Array) -> Array:
        """Return the pixels (n, 2) of the other view."""
        w = self._w + self.per_px * (p[0] + self._patch.slopes @ p[1:3])
        return np.asarray(self._patch.in_other(w) + p[3] * self.across)

    def linearised(self, p: Array) -> tuple[Array, Array, Array]:
        """Return residuals (n,), their negative derivatives (n, 4) with gain and offset taken out, grey levels (n,)."""
        seen = self._grey(p)
        columns = []
        for k in range(4):
            d = np.zeros(4)
            d[k] = DIFFERENCE_PX
            columns.append((self._grey(p + d) - self._grey(p - d)) / (2.0 * DIFFERENCE_PX))
        basis = np.linalg.qr(np.stack([seen, np.ones(len(seen))], axis=1))[0]
        gain = float(np.polyfit(seen, self._patch.grey, 1)[0])
        J = gain * np.stack(columns, axis=1)
        r = self._patch.grey - basis @ (basis.T @ self._patch.grey)
        return r, J - basis @ (basis.T @ J), seen

    def noise_in_derivatives(self) -> Array:
        """Return what white noise of one grey level adds to J^T J (4, 4), J being the derivatives of `linearised`."""
        along = np.append(np.ones((len(self._patch.grey), 1)), self._patch.slopes, axis=1)  # (n, 3)
        out = np.zeros((4, 4))
        out[:3, :3], out[3, 3] = along.T @ along, len(along)
        return NOISE_DERIVATIVE * out

    def _grey(self, p: Array) -> Array:
        grey = self._views.grey(self._patch.other, self.positions(p))
        if not np.isfinite(grey).all():
            raise Degenerate(
                f"the place found is at the border of the {self._patch.other} image, or beyond it",
                consequence="No point is given",
                cure="Pick what both views see whole",
            )
        return grey


def _covariance(r: Array, J: Array, noise: Array, prior: Array) -> Array:
    """Return the covariance (4, 4) in px^2 of what was fitted with residuals r (n,) and derivatives J (n, 4).

    noise (4, 4): what the picture's noise adds to J^T J. It looks like texture and is none, and it meets the other
    picture's noise: both is taken into account. Raises Degenerate where nothing else is there.
    """
    variance = SHARED_NOISE * max(float(r @ r) / (len(r) - 6), 1e-12)
    texture = J.T @ J - noise
    if float(np.linalg.eigvalsh(texture + variance * prior).min()) <= 0.0:
        raise Degenerate(
            "the patch's texture is lost in noise",
            consequence="No point is given",
            cure="Pick a place with texture; or give a larger patch",
        )
    A = np.linalg.inv(texture + variance * prior)
    return np.asarray(A @ (variance * texture + 0.5 * variance * noise + variance**2 * prior) @ A)


def _lost(what: str) -> NotConverged:
    return NotConverged(
        f"the match {what}", consequence="No point is given", cure="Pick a place with more texture, or a larger patch"
    )


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
        return {side: np.asarray(scipy.ndimage.spline_filter(levels, order=3)) for side, levels in self._levels.items()}

    @cached_property
    def noise_levels2(self) -> float:
        """Variance of the noise of one pixel in grey levels squared, of both images together (Immerkaer 1996).

        By the median, so that edges do not count.
        """
        kernel = np.array([[1.0, -2.0, 1.0], [-2.0, 4.0, -2.0], [1.0, -2.0, 1.0]]) / 6.0  # of unit norm
        off = [np.abs(scipy.ndimage.convolve(levels, kernel)) for levels in self._levels.values()]
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
    positions: Array = np.stack([v[inside], u[inside]])
    out[inside] = scipy.ndimage.map_coordinates(image, positions, order=order, prefilter=False, mode="mirror")
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
