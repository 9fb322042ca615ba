"""Cameras of measuring programs: Metashape's XML of one camera, HALCON's text of camera parameters, with their lenses.

Metashape (Agisoft's user manual, "Camera models", frame): with x = X/Z, y = Y/Z, r2 = x^2 + y^2
x' = x (1 + K1 r2 + K2 r2^2 + K3 r2^3 + K4 r2^4) + P1 (r2 + 2 x^2) + 2 P2 x y, y' likewise with P2 (r2 + 2 y^2) +
2 P1 x y; u = 0.5 w + cx + x' f + x' B1 + y' B2, v = 0.5 h + cy + y' f: cx, cy from the image's middle, pixels counted
from the image's corner, so that the first one's centre is at (0.5, 0.5); P1 and P2 stand for OpenCV's p2 and p1.

HALCON (MVTec's reference of calibrate_cameras and read_cam_par): text up to version 12, from 13 on bytes: nine files of
four cameras begin as KNOWN does and go on with read_cam_par's numbers, lengths in mm. On the sensor, in m, u
= Focus X/Z. Division model: the pixel is at u' = 2 u / (1 + sqrt(1 - 4 Kappa (u^2 + v^2))). Polynomial model, from
pixel to ray: u = u' + u' (K1 r2 + K2 r2^2 + K3 r2^3) + P1 (r2 + 2 u'^2) + 2 P2 u' v', v likewise with 2 P1 u' v' + P2
(r2 + 2 v'^2). Column u' / Sx + Cx, row v' / Sy + Cy, pixels counted from the first one's centre.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from armsight.arrays import Array
from armsight.errors import BadFile
from armsight.optics import Camera
from armsight.store.codec import named
from armsight.store.foreign import lenses, numbers
from armsight.store.foreign.several import Asked, Placed
from armsight.store.foreign.storage import BINARY, read_storage

KNOWN = bytes.fromhex("48435052 0003 00 00000000 00000008")
FORM = struct.Struct(">6d2i")
UNITS = {"Focus": 1e-3, "Kappa": 1e6, "Sx": 1e-3, "Sy": 1e-3, "Cx": 1.0, "Cy": 1.0, "ImageWidth": 1, "ImageHeight": 1}
"""Of HALCON's binary form of an area scan camera with the division model, in its order."""
CORNER_PX = 0.5
"""From the corner of the first pixel, where Metashape and COLMAP count from, to its centre."""


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
    if "corrections" in content:
        raise BadFile(
            f"{where}: holds additional corrections beside the lens, whose meaning Agisoft does not tell",
            consequence="The lens without them would be another one",
            cure="Optimize the cameras without 'Fit additional corrections' and export it again",
        )
    intrinsics = (f + b1, f, 0.5 * size[0] + cx - CORNER_PX, 0.5 * size[1] + cy - CORNER_PX, b2)
    if not k4:
        with named(where):
            exact = Camera.pinhole(*size, *intrinsics[:4], skew=b2, distortion=[k1, k2, p2, p1, k3])
        return [Placed(name="camera", lens=lambda: exact)]

    def step(rays: Array) -> tuple[Array, Array]:
        r2 = (rays**2).sum(axis=1)
        return 1.0 + r2 * (k1 + r2 * (k2 + r2 * (k3 + r2 * k4))), _tangential(rays, p1, p2)

    uv = lenses.pixels(size)
    rays = lenses.straight(lenses.in_plane(uv, intrinsics), step, where)
    return [Placed(name="camera", lens=lambda: lenses.nearest_pinhole(rays, uv, intrinsics, size, where, asked))]


def read_halcon(path: Path, asked: Asked) -> list[Placed]:
    """Return the camera of HALCON's parameters of an area scan camera. Raises BadFile."""
    content, where = read_storage(path), str(path)
    if BINARY in content:
        content = _of_bytes(content[BINARY], where)
    if "Vx" in content or "Tilt" in content or "Rot" in content:
        raise BadFile(f"{where}: a line scan or a tilted lens", cure="Take an area scan camera with a lens not tilted")
    focus, sx, sy = (_number(content, key, where, positive=True) for key in ("Focus", "Sx", "Sy"))
    cx, cy = (_number(content, key, where, needed=True) for key in ("Cx", "Cy"))
    size = numbers.count_at(content, "ImageWidth", where), numbers.count_at(content, "ImageHeight", where)
    intrinsics = (focus / sx, focus / sy, cx, cy, 0.0)
    uv = lenses.pixels(size)
    bent = lenses.in_plane(uv, intrinsics)
    r2 = ((focus * bent) ** 2).sum(axis=1)  # on the sensor, m^2
    if "Kappa" in content:
        rays = bent / (1.0 + _number(content, "Kappa", where) * r2)[:, None]
    else:
        k1, k2, k3, p1, p2 = (_number(content, key, where, needed=True) for key in ("K1", "K2", "K3", "P1", "P2"))
        rays = bent * (1.0 + r2 * (k1 + r2 * (k2 + r2 * k3)))[:, None] + _tangential(focus * bent, p1, p2) / focus
    return [Placed(name="camera", lens=lambda: lenses.nearest_pinhole(rays, uv, intrinsics, size, where, asked))]


def _of_bytes(data: bytes, where: str) -> dict[str, float]:
    """Return the parameters of HALCON's binary form as its text has them, in m. Raises BadFile for another camera."""
    if not data.startswith(KNOWN) or len(data) != len(KNOWN) + FORM.size:
        raise BadFile(
            f"{where}: HALCON's binary form of another camera than area scan with the division model, or cut",
            consequence="What its bytes mean is not known",
            cure="Write the parameters by hand as the text that MVTec's reference of read_cam_par shows",
        )
    values = FORM.unpack(data[len(KNOWN) :])
    return {name: unit * value for (name, unit), value in zip(UNITS.items(), values, strict=True)}


def _tangential(xy: Array, p1: float, p2: float) -> Array:
    """Return the shift (n, 2) of places xy (n, 2) by decentring, in Metashape's and HALCON's order."""
    x, y = xy.T
    r2 = x**2 + y**2
    return np.stack([p1 * (r2 + 2 * x**2) + 2 * p2 * x * y, p2 * (r2 + 2 * y**2) + 2 * p1 * x * y], axis=1)


def _number(content: Mapping[str, Any], key: str, where: str, *, needed: bool = False, positive: bool = False) -> float:
    """Return the number under a key, 0 where it may be left out and is. Raises BadFile."""
    if key not in content and not (needed or positive):
        return 0.0
    value = numbers.number_at(content, key, where)
    if positive and not value > 0.0:
        raise BadFile(
            f"{where}: {key} is {value:g}, not above zero", cure="Take the parameters of a lens that is calibrated"
        )
    return value
