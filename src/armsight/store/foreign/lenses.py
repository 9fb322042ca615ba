"""Lenses of other models as the nearest one of ours: by its coefficients alone, or by all of its numbers.

A model is given by the rays of pixels over the whole picture, so that the distance that is told is one in px, and the
largest there is.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import cv2
import numpy as np
from scipy.optimize import least_squares

from armsight.arrays import Array
from armsight.errors import BadFile, Inconsistent
from armsight.optics import Camera
from armsight.optics.camera import WIDEST_RAD
from armsight.store.codec import named
from armsight.store.foreign import numbers
from armsight.store.foreign.opencv_lens import nearest_like
from armsight.store.foreign.several import Asked

FURTHEST_PX = 0.05
"""By which another model may differ from ours anywhere in the picture: half of what a good calibration's corners
scatter by."""
ROUNDS, SETTLED = 60, 1e-12
"""Of the search for a ray, whose distance shrinks by the distortion's slope each round."""
PINHOLE_RAD = float(np.radians(80.0))
"""Beyond it no pinhole is tried: X/Z of the outermost pixels alone would decide the fit."""
FEWEST = 0.3
"""Share of the picture that must have rays to fit a lens to."""
GRID = (41, 31)

Intrinsics = tuple[float, float, float, float, float]
Size = tuple[int, int]
LENSES: Mapping[str, tuple[Callable[..., Camera], Callable[..., Any], int]] = {
    "pinhole": (Camera.pinhole, cv2.projectPoints, 5),
    "fisheye": (Camera.fisheye, cv2.fisheye.projectPoints, 4),
}
"""How a camera is made, how OpenCV projects by it, and how many coefficients it has."""


def pixels(size: Size) -> Array:
    """Return pixels (n, 2) over a picture, its corners among them."""
    u, v = np.meshgrid(np.linspace(0.0, size[0] - 1.0, GRID[0]), np.linspace(0.0, size[1] - 1.0, GRID[1]))
    return np.stack([u.ravel(), v.ravel()], axis=1)


def in_plane(uv: Array, intrinsics: Intrinsics) -> Array:
    """Return the places (n, 2) on the plane at 1 that pixels (n, 2) are drawn at."""
    fx, fy, cx, cy, skew = intrinsics
    y = (uv[:, 1] - cy) / fy
    return np.stack([(uv[:, 0] - cx - skew * y) / fx, y], axis=1)


def straight(bent: Array, step: Callable[[Array], tuple[Array, Array]], where: str) -> Array:
    """Return the rays (n, 2) that a lens bends to places (n, 2) on the plane at 1.

    step: of rays the stretch (n,) and the shift (n, 2) in bent = (ray stretch) + shift. Raises BadFile.
    """
    rays = bent
    with np.errstate(all="ignore"):
        for _ in range(ROUNDS):
            stretch, shift = step(rays)
            before, rays = rays, (bent - shift) / stretch[:, None]
    if not np.abs(rays - before).max() < SETTLED:
        raise BadFile(f"{where}: parts of the picture have no ray", cure="Correct the lens's coefficients there")
    return rays


def nearest_pinhole(rays: Array, uv: Array, intrinsics: Intrinsics, size: Size, where: str, asked: Asked) -> Camera:
    """Return the pinhole whose k1, k2, p1, p2, k3 are nearest to rays (n, 2) of pixels uv (n, 2), or the rational lens
    where that one is too far. Raises BadFile.
    """
    fx, fy, cx, cy, skew = intrinsics
    K = np.array([[fx, skew, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
    there = bool(np.isfinite(rays).all())
    values, _, most_px = numbers.fitted_coefficients(rays, uv, K) if there else (uv[0], 0.0, np.inf)
    if there and most_px > FURTHEST_PX:
        with named(where):
            start = Camera.rational(*size, fx, fy, cx, cy, skew=skew, distortion=np.append(values, np.zeros(3)))
        rational, apart_px = nearest_like(start, np.column_stack([rays, np.ones(len(rays))]), uv)
        if apart_px <= FURTHEST_PX:
            _tell("rational lens", apart_px, where, asked)
            return rational
    _tell("k1, k2, p1, p2, k3", most_px, where, asked)
    with named(where):
        return Camera.pinhole(*size, fx, fy, cx, cy, skew=skew, distortion=values)


def nearest_camera(directions: Array, uv: Array, size: Size, where: str, asked: Asked) -> Camera:
    """Return the pinhole or fisheye camera that is nearest to directions (n, 3) of pixels uv (n, 2), NaN where one has
    none; all of its numbers but the skew, 0, are fitted.

    Raises BadFile where the lens sees further than a camera here, or is too far from both.
    """
    angle = np.arctan2(np.linalg.norm(directions[:, :2], axis=1), directions[:, 2])
    seen = angle <= WIDEST_RAD  # not where it is NaN
    share = float(seen.mean())
    if share < 1.0 and not (asked.approximate and share >= FEWEST):
        widest = np.degrees(np.nanmax(angle)) if np.isfinite(angle).any() else np.nan
        raise BadFile(
            f"{where}: the lens sees {widest:.0f} degrees from its axis, and {100.0 * (1.0 - share):.1f} % of the "
            f"picture lie beyond {np.degrees(WIDEST_RAD):.0f} or have no ray",
            consequence=f"A camera here has rays up to {np.degrees(WIDEST_RAD):.0f} degrees",
            cure="Take the rest of the picture with --approximate: what is seen further out is not used then"
            if share >= FEWEST
            else "Take a lens that sees less, or cut the middle out of the pictures and calibrate them anew here",
        )
    kinds = list(LENSES) if angle[seen].max() <= PINHOLE_RAD else ["fisheye"]
    fits = [(*_fitted(kind, directions[seen], uv[seen], size), kind) for kind in kinds]
    most_px, camera, kind = min(fits, key=lambda one: one[0])
    if camera is None:
        raise BadFile(f"{where}: no camera here comes near to the lens", cure="Calibrate it anew here")
    _tell(kind, most_px, where, asked, told_px=0.0)
    if share < 1.0:
        asked.told.append(f"{where}: {100.0 * (1.0 - share):.0f} % of the picture, at its edge, have no rays here")
    return camera


def _fitted(kind: str, directions: Array, uv: Array, size: Size) -> tuple[float, Camera | None]:
    """Return the largest distance in px from a lens of a kind to directions (n, 3) of pixels (n, 2), and the camera."""
    make, project, count = LENSES[kind]
    points = np.ascontiguousarray(directions / directions[:, 2:])[:, None]
    none = np.zeros(3)

    def apart_px(x: Array) -> Array:
        K = np.array([[x[0], 0.0, x[2]], [0.0, x[1], x[3]], [0.0, 0.0, 1.0]])
        return np.asarray(project(points, none, none, K, x[4:])[0].reshape(-1, 2) - uv).ravel()

    focal_px = float(np.ptp(uv[:, 0]) / np.ptp(np.arctan2(directions[:, 0], directions[:, 2])))
    start = np.array([focal_px, focal_px, 0.5 * size[0], 0.5 * size[1], *np.zeros(count)])
    try:
        x = least_squares(apart_px, start, x_scale="jac", method="lm", xtol=1e-12, ftol=1e-12).x
        camera = make(*size, *x[:4].tolist(), distortion=x[4:])
    except (Inconsistent, ValueError, cv2.error):  # of numbers that are no lens's
        return np.inf, None
    apart = np.linalg.norm(camera.project(directions) - uv, axis=1)  # NaN where it folds
    return (float(apart.max()) if np.isfinite(apart).all() else np.inf), camera


def _tell(of: str, most_px: float, where: str, asked: Asked, *, told_px: float = numbers.TOLD_PX) -> None:
    """Tell how far the nearest lens is. Raises BadFile where that is too far."""
    if not (most_px <= FURTHEST_PX or (asked.approximate and np.isfinite(most_px))):
        raise BadFile(
            f"{where}: the lens is {most_px:.2g} px from the nearest {of} where it is furthest",
            consequence=f"Beyond {FURTHEST_PX} px it would be another lens",
            cure="Take the nearest lens all the same with --approximate, or calibrate anew here",
        )
    if most_px > told_px:
        asked.told.append(f"{where}: the nearest {of} is taken, {most_px:.2g} px apart at most")
