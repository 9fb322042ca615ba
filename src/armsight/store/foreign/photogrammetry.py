"""Cameras of measuring programs: Metashape's XML of one camera, HALCON's text of camera parameters, with their lenses.

Metashape (Agisoft's user manual, "Camera models", frame): with x = X/Z, y = Y/Z, r2 = x^2 + y^2
x' = x (1 + K1 r2 + K2 r2^2 + K3 r2^3 + K4 r2^4) + P1 (r2 + 2 x^2) + 2 P2 x y, y' likewise with P2 (r2 + 2 y^2) +
2 P1 x y; u = 0.5 w + cx + x' f + x' B1 + y' B2, v = 0.5 h + cy + y' f: cx, cy from the image's middle, pixels counted
from the image's corner, so that the first one's centre is at (0.5, 0.5); P1 and P2 stand for OpenCV's p2 and p1.

HALCON (MVTec's reference of calibrate_cameras and read_cam_par): on the sensor, in m, u = Focus X/Z. Division model:
the pixel is at u' = 2 u / (1 + sqrt(1 - 4 Kappa (u^2 + v^2))). Polynomial model, from pixel to ray: u = u' + u' (K1 r2
+ K2 r2^2 + K3 r2^3) + P1 (r2 + 2 u'^2) + 2 P2 u' v', v likewise with 2 P1 u' v' + P2 (r2 + 2 v'^2). Column u' / Sx +
Cx, row v' / Sy + Cy, pixels counted from the first one's centre.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from armsight.arrays import Array
from armsight.errors import BadFile
from armsight.optics import Camera
from armsight.store.codec import named
from armsight.store.foreign import numbers
from armsight.store.foreign.several import Asked, Placed
from armsight.store.foreign.storage import read_storage

CORNER_PX = 0.5
"""From the corner of the first pixel, where Metashape and COLMAP count from, to its centre."""
FURTHEST_PX = 0.05
"""By which another model may differ from k1, k2, p1, p2, k3 anywhere in the picture: half of what a good calibration's
corners scatter by."""
ROUNDS, SETTLED = 60, 1e-12
"""Of the search for a ray, whose distance shrinks by the distortion's slope each round."""

Intrinsics = tuple[float, float, float, float, float]


def read_metashape(path: Path, asked: Asked) -> list[Placed]:
    """Return the camera of a calibration that Metashape exported as Agisoft XML. Raises BadFile."""
    content, where = read_storage(path), str(path)
    kind = content["projection"]
    if kind != "frame":
        raise BadFile(
            f"{where}: the projection is {str(kind)[:40]!r}",
            consequence="Only 'frame' is a lens that can be used",
            cure="Calibrate with the camera type Frame, or anew here",
        )
    size = numbers.count_at(content, "width", where), numbers.count_at(content, "height", where)
    f, *rest = (_number(content, key, where) for key in ("f", "cx", "cy", "b1", "b2"))
    cx, cy, b1, b2 = rest
    k1, k2, k3, k4, p1, p2 = (_number(content, key, where) for key in ("k1", "k2", "k3", "k4", "p1", "p2"))
    if any(_number(content, key, where) for key in ("p3", "p4")):
        raise BadFile(f"{where}: p3 and p4 are not zero", cure="Calibrate without them")
    intrinsics = (f + b1, f, 0.5 * size[0] + cx - CORNER_PX, 0.5 * size[1] + cy - CORNER_PX, b2)
    values = np.array([k1, k2, p2, p1, k3])
    if k4:
        uv, bent = _grid(intrinsics, size)
        rays = bent.copy()
        for _ in range(ROUNDS):
            x, y = rays.T
            r2 = x**2 + y**2
            stretch = r2 * (k1 + r2 * (k2 + r2 * (k3 + r2 * k4)))
            shift = np.stack([p1 * (r2 + 2 * x**2) + 2 * p2 * x * y, p2 * (r2 + 2 * y**2) + 2 * p1 * x * y], axis=1)
            before, rays = rays, (bent - shift) / (1.0 + stretch)[:, None]
        if not np.abs(rays - before).max() < SETTLED:
            raise BadFile(f"{where}: parts of the picture have no ray", cure="Correct k1 to k4 there")
        values = _nearest(rays, uv, intrinsics, where, asked)
    return [Placed(name="camera", camera=_pinhole(intrinsics, size, values, where))]


def read_halcon(path: Path, asked: Asked) -> list[Placed]:
    """Return the camera of HALCON's parameters of an area scan camera. Raises BadFile."""
    content, where = read_storage(path), str(path)
    if "Vx" in content or "Tilt" in content or "Rot" in content:
        raise BadFile(f"{where}: a line scan or a tilted lens", cure="Take an area scan camera with a lens not tilted")
    focus, sx, sy = (_number(content, key, where, positive=True) for key in ("Focus", "Sx", "Sy"))
    cx, cy = (_number(content, key, where, needed=True) for key in ("Cx", "Cy"))
    size = numbers.count_at(content, "ImageWidth", where), numbers.count_at(content, "ImageHeight", where)
    intrinsics = (focus / sx, focus / sy, cx, cy, 0.0)
    uv, bent = _grid(intrinsics, size)
    x, y = focus * bent.T  # on the sensor, m
    r2 = x**2 + y**2
    if "Kappa" in content:
        rays = bent / (1.0 + _number(content, "Kappa", where) * r2)[:, None]
    else:
        k1, k2, k3, p1, p2 = (_number(content, key, where, needed=True) for key in ("K1", "K2", "K3", "P1", "P2"))
        stretch = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
        shift = np.stack([p1 * (r2 + 2 * x**2) + 2 * p2 * x * y, p2 * (r2 + 2 * y**2) + 2 * p1 * x * y], axis=1)
        rays = bent * stretch[:, None] + shift / focus
    values = _nearest(rays, uv, intrinsics, where, asked)
    return [Placed(name="camera", camera=_pinhole(intrinsics, size, values, where))]


def _grid(intrinsics: Intrinsics, size: tuple[int, int]) -> tuple[Array, Array]:
    """Return pixels (n, 2) over a picture, and the places (n, 2) on the plane at 1 that they are drawn at."""
    fx, fy, cx, cy, skew = intrinsics
    u, v = np.meshgrid(np.linspace(0.0, size[0] - 1.0, 41), np.linspace(0.0, size[1] - 1.0, 31))
    y = (v.ravel() - cy) / fy
    return np.stack([u.ravel(), v.ravel()], axis=1), np.stack([(u.ravel() - cx - skew * y) / fx, y], axis=1)


def _nearest(rays: Array, uv: Array, intrinsics: Intrinsics, where: str, asked: Asked) -> Array:
    """Return k1, k2, p1, p2, k3 nearest to rays (n, 2) of pixels uv (n, 2), and tell how near. Raises BadFile."""
    fx, fy, cx, cy, skew = intrinsics
    K = np.array([[fx, skew, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
    values, _, most_px = numbers.fitted_coefficients(rays, uv, K) if np.isfinite(rays).all() else (uv[0], 0.0, np.inf)
    if not (most_px <= FURTHEST_PX or asked.approximate):
        raise BadFile(
            f"{where}: the lens is {most_px:.2g} px from the nearest k1, k2, p1, p2, k3 where it is furthest",
            consequence=f"Beyond {FURTHEST_PX} px it would be another lens",
            cure="Take the nearest lens all the same with --approximate, or calibrate anew here",
        )
    if most_px > numbers.TOLD_PX:
        asked.told.append(f"{where}: the nearest k1, k2, p1, p2, k3 are taken, {most_px:.2g} px apart at most")
    return values


def _pinhole(intrinsics: Intrinsics, size: tuple[int, int], values: Array, where: str) -> Camera:
    with named(where):
        return Camera.pinhole(*size, *intrinsics[:4], skew=intrinsics[4], distortion=values)


def _number(content: Mapping[str, Any], key: str, where: str, *, needed: bool = False, positive: bool = False) -> float:
    """Return the number under a key, 0 where it may be left out and is. Raises BadFile."""
    if key not in content and not (needed or positive):
        return 0.0
    value = float(numbers.array_of(numbers.value_at(content, key, where), key, where).reshape(()))
    if positive and not value > 0.0:
        raise BadFile(
            f"{where}: {key} is {value:g}, not above zero", cure="Take the parameters of a lens that is calibrated"
        )
    return value
