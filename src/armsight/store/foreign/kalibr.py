"""Kalibr's camchain YAML.

Cameras cam0, cam1 ... in a chain, each with camera_model, intrinsics in px, distortion_model, distortion_coeffs,
resolution [width, height]; camN's T_cn_cnm1 (4 x 4, metres) takes points of the camera before it into camN. What Kalibr
adds (rostopic, T_cam_imu, cam_overlaps, timeshift_cam_imu) is not used.

pinhole [fu, fv, pu, pv] with radtan [k1, k2, p1, p2] or equidistant [k1, k2, k3, k4] is a camera here. The other models
(ethz-asl/kalibr, aslam_cameras/implementation) become the nearest one over the picture. With m the place on the plane
at 1 that a pixel undistorts to and r2 = |m|^2, its ray is, as Kalibr's keypointToEuclidean has it:
pinhole-fov [w]: m tan(w r) / (2 r tan(w/2)), 1;
omni [xi, ...], with none, radtan or equidistant: m, 1 - xi (r2 + 1) / (xi + sqrt(1 + (1 - xi^2) r2));
eucm [alpha, beta, ...]: m, (1 - beta alpha^2 r2) / (alpha sqrt(1 - (2 alpha - 1) beta r2) + 1 - alpha);
ds [xi, alpha, ...]: with z = (1 - alpha^2 r2) / (alpha sqrt(1 - (2 alpha - 1) r2) + 1 - alpha) and
s = (z xi + sqrt(z^2 + (1 - xi^2) r2)) / (z^2 + r2): s m, s z - xi.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from armsight.arrays import Array
from armsight.errors import BadFile, Inconsistent
from armsight.optics import SIDES, Camera, LensKind, Rig
from armsight.store.atomic import write_text
from armsight.store.codec import named
from armsight.store.foreign import lenses, numbers
from armsight.store.foreign.several import Asked, Placed, Pose, camera_of, rig_of
from armsight.store.yamls import dump_yaml, read_yaml

MODELS: Mapping[str, tuple[int, tuple[str, ...]]] = {
    "pinhole": (0, ("radtan", "equidistant", "none", "fov")),
    "omni": (1, ("radtan", "equidistant", "none")),
    "eucm": (2, ("none",)),
    "ds": (2, ("none",)),
}
"""Kalibr's camera models: numbers before fu, fv, pu, pv, and the distortions that it calibrates them with."""


def read_kalibr(path: Path, asked: Asked) -> list[Placed]:
    """Return the cameras of a camchain, placed in the axes of cam0. Raises BadFile."""
    return kalibr_cameras(read_yaml(path), str(path), asked)


def camera_from_kalibr(path: Path, asked: Asked | None = None) -> Camera:
    """Return a camera of a camchain, cam0 where none is named. Raises BadFile, UsageError."""
    asked = asked or Asked()
    return camera_of(read_kalibr(path, asked), str(path), asked if asked.names else replace(asked, names=("cam0",)))


def rig_from_kalibr(path: Path, asked: Asked | None = None) -> Rig:
    """Return the rig of a camchain, the rig's axes those of cam0, or of the first camera that is named: left and right
    where it has two, else cam0, cam1 ...

    Raises BadFile where the file has more cameras than a rig, another model or no T_cn_cnm1; UsageError.
    """
    return kalibr_rig(read_yaml(path), str(path), asked)


def kalibr_rig(content: Mapping[str, Any], where: str, asked: Asked | None = None) -> Rig:
    """Return the rig of a camchain's content; see rig_from_kalibr."""
    asked = asked or Asked()
    found = kalibr_cameras(content, where, asked)
    return rig_of(found, where, asked, SIDES if len(found) == len(SIDES) and not asked.names else ())


def kalibr_cameras(content: Mapping[str, Any], where: str, asked: Asked) -> list[Placed]:
    """Return the cameras of a camchain's content; see read_kalibr."""
    by_number = {int(key[3:]): key for key in content if key.startswith("cam") and key[3:].isdecimal()}
    links = [by_number[k] for k in sorted(by_number)]
    if links != [f"cam{k}" for k in range(len(links))] or not links:
        raise BadFile(
            f"{where}: a chain of the cameras {', '.join(links) or 'none'}",
            consequence="Each camera's pose is told from the one before it, cam0 first",
            cure="Number the cameras from cam0 on, and leave none out",
        )
    found: list[Placed] = []
    pose: Pose | None = (np.eye(3), np.zeros(3))
    for link in links:
        if found:
            pose = _placed(pose, content, link, where)
        lens = partial(kalibr_camera, content, link, where, asked)
        found.append(Placed(name=link, lens=lens, pose=pose))
    return found


def _placed(before: Pose | None, content: Mapping[str, Any], link: str, where: str) -> Pose | None:
    """Return a camera's pose from that of the one before it; None where the chain is broken: cameras alone may do."""
    here = f"{where}, {link}"
    block = _block(content, link, where)
    if before is None or "T_cn_cnm1" not in block:
        return None
    T = numbers.matrix_at(block, "T_cn_cnm1", (4, 4), here)
    if np.abs(T[3] - (0.0, 0.0, 0.0, 1.0)).max() > 0.0:
        raise BadFile(f"{here}: T_cn_cnm1 does not end with the row 0, 0, 0, 1", cure="Correct it there")
    R = numbers.rotation_of(T[:3, :3], "T_cn_cnm1", here)
    return (R, T[:3, 3]) if link == "cam1" else (R @ before[0], R @ before[1] + T[:3, 3])


def kalibr_camera(content: Mapping[str, Any], name: str, where: str, asked: Asked) -> Camera:
    """Return one camera of a camchain's content; of another model than ours the nearest one. Raises BadFile."""
    block, here = _block(content, name, where), f"{where}, {name}"
    model, distortion = _one_of(block, "camera_model", MODELS, here), block.get("distortion_model")
    own, known = MODELS[model]
    _one_of(block, "distortion_model", known, here)
    *lens, fu, fv, pu, pv = numbers.matrix_at(block, "intrinsics", (1, 4 + own), here).ravel().tolist()
    values = np.zeros(5)
    if distortion != "none":
        values = numbers.array_of(numbers.value_at(block, "distortion_coeffs", here), "distortion_coeffs", here).ravel()
    size = numbers.array_of(numbers.value_at(block, "resolution", here), "resolution", here).ravel()
    if size.size != 2 or not all(float(value).is_integer() and 1 <= value <= 1e6 for value in size):
        raise BadFile(f"{here}: resolution is not [width, height] in px", cure="Correct it there")
    wh = int(size[0]), int(size[1])
    make = Camera.pinhole
    if distortion == "equidistant":
        make, values = Camera.fisheye, numbers.fisheye_coefficients(values, "distortion_coeffs", here)
    elif distortion == "radtan":
        values = np.append(numbers.matrix_at(block, "distortion_coeffs", (1, 4), here).ravel(), 0.0)
    elif distortion == "fov":
        lens, model = numbers.matrix_at(block, "distortion_coeffs", (1, 1), here).ravel().tolist(), "fov"
    with named(here):
        plain = make(*wh, fu, fv, pu, pv, distortion=np.zeros(5) if distortion == "fov" else values)
    if model == "pinhole":
        return plain
    uv = lenses.pixels(wh)
    with np.errstate(all="ignore"):  # roots of what no ray reaches are NaN, as pixels without one
        directions = RAYS[model](plain.rays(uv), *lens)
    return lenses.nearest_camera(directions, uv, wh, here, asked)


def _one_of(block: Mapping[str, Any], key: str, known: Iterable[str], where: str) -> str:
    model = numbers.value_at(block, key, where)
    if model not in tuple(known):
        raise BadFile(
            f"{where}: {key} is {str(model)[:40]!r}",
            consequence=f"Only {' or '.join(known)} can be used",
            cure="Calibrate with pinhole-radtan, a wide or fisheye lens with pinhole-equi",
        )
    return str(model)


def _fov(m: Array, w: float) -> Array:
    r = np.maximum(np.hypot(*m.T), 1e-12)
    within = np.where(np.abs(w) * r < 0.5 * np.pi, 1.0, np.nan)
    along = np.tan(w * r) / (2.0 * r * np.tan(0.5 * w)) if w else np.ones(len(m))
    return np.column_stack([m * along[:, None], within])


def _omni(m: Array, xi: float) -> Array:
    r2 = (m**2).sum(axis=1)
    return np.column_stack([m, 1.0 - xi * (r2 + 1.0) / (xi + np.sqrt(1.0 + (1.0 - xi**2) * r2))])


def _eucm(m: Array, alpha: float, beta: float) -> Array:
    r2 = (m**2).sum(axis=1)
    root = np.sqrt(1.0 - (2.0 * alpha - 1.0) * beta * r2)
    return np.column_stack([m, (1.0 - beta * alpha**2 * r2) / (alpha * root + 1.0 - alpha)])


def _ds(m: Array, xi: float, alpha: float) -> Array:
    r2 = (m**2).sum(axis=1)
    z = (1.0 - alpha**2 * r2) / (alpha * np.sqrt(1.0 - (2.0 * alpha - 1.0) * r2) + 1.0 - alpha)
    s = (z * xi + np.sqrt(z**2 + (1.0 - xi**2) * r2)) / (z**2 + r2)
    return np.column_stack([m * s[:, None], s * z - xi])


RAYS: Mapping[str, Callable[..., Array]] = {"fov": _fov, "omni": _omni, "eucm": _eucm, "ds": _ds}
"""Directions (n, 3) of places (n, 2) by a model's own numbers, NaN where there is none."""


def kalibr_mapping(camera: Camera) -> dict[str, Any]:
    """Return a camera as Kalibr's file holds it; Inconsistent where radtan or equidistant cannot say it."""
    fisheye = camera.lens is LensKind.FISHEYE
    fx, fy, cx, cy, skew, *coefficients = camera.intrinsics.tolist()
    if camera.lens is LensKind.RATIONAL:
        raise Inconsistent(
            "the lens is rational", consequence="Kalibr has no such model", cure="Calibrate it as a pinhole"
        )
    k3 = 0.0 if fisheye else coefficients[4]
    if skew != 0.0 or k3 != 0.0:
        raise Inconsistent(
            f"the camera has skew {skew:g} px and k3 {k3:g}", consequence="Kalibr has neither", cure="Fix both at zero"
        )
    return {
        "camera_model": "pinhole",
        "intrinsics": [fx, fy, cx, cy],
        "distortion_model": "equidistant" if fisheye else "radtan",
        "distortion_coeffs": coefficients[:4],
        "resolution": [camera.width, camera.height],
    }


def camera_to_kalibr(path: Path, camera: Camera) -> None:
    """Write a camchain of one camera; Inconsistent where radtan cannot say it."""
    write_text(path, dump_yaml({"cam0": kalibr_mapping(camera)}))


def rig_to_kalibr(path: Path, rig: Rig) -> None:
    """Write a camchain of the rig's cameras in their order; Inconsistent where radtan cannot say a camera."""
    content: dict[str, Any] = {}
    for k, one in enumerate(rig.cameras):
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = numbers.relative(rig.cameras[max(k - 1, 0)].T_rig_camera, one.T_rig_camera)
        beside = [j for j in (k - 1, k + 1) if 0 <= j < len(rig.cameras)]
        step = {} if k == 0 else {"T_cn_cnm1": T.tolist()}
        content[f"cam{k}"] = {**step, "cam_overlaps": beside, **kalibr_mapping(one.camera)}
    write_text(path, dump_yaml(content))


def _block(content: Mapping[str, Any], name: str, where: str) -> Mapping[str, Any]:
    block = numbers.value_at(content, name, where)
    if not isinstance(block, Mapping):
        raise BadFile(f"{where}: {name} is not a camera")
    return block
