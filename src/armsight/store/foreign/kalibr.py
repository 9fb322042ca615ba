"""Kalibr's camchain YAML.

Cameras cam0, cam1 ... in a chain, each with camera_model pinhole, intrinsics [fu, fv, pu, pv] in px, distortion_model
radtan with [k1, k2, p1, p2] or equidistant with [k1, k2, k3, k4], resolution [width, height]; camN's T_cn_cnm1 (4 x 4,
metres) takes points of the camera before it into camN. What Kalibr adds (rostopic, T_cam_imu,
cam_overlaps, timeshift_cam_imu) is not used. Other models are refused by name.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import RigidTransform

from armsight.errors import BadFile, Inconsistent
from armsight.optics import SIDES, Camera, LensKind, MountedCamera, Rig
from armsight.store.atomic import write_text
from armsight.store.codec import named
from armsight.store.foreign import numbers
from armsight.store.yamls import dump_yaml, read_yaml


def camera_from_kalibr(path: Path, *, name: str = "cam0") -> Camera:
    """Return one camera of a camchain; BadFile where it is none or has another model."""
    return kalibr_camera(read_yaml(path), name, str(path))


def kalibr_camera(content: Mapping[str, Any], name: str, where: str) -> Camera:
    """Return one camera of a camchain's content; see camera_from_kalibr."""
    block = _block(content, name, where)
    block_name = f"{where}, {name}"
    for key, known in (("camera_model", ("pinhole",)), ("distortion_model", ("radtan", "equidistant", "none"))):
        model = numbers.value_at(block, key, block_name)
        if model not in known:
            raise BadFile(
                f"{block_name}: {key} is {str(model)[:40]!r}",
                consequence=f"Only {' or '.join(known)} can be used",
                cure="Calibrate with pinhole-radtan, a wide or fisheye lens with pinhole-equi",
            )
    fisheye = block["distortion_model"] == "equidistant"
    fu, fv, pu, pv = numbers.matrix_at(block, "intrinsics", (1, 4), block_name).ravel().tolist()
    distortion = np.zeros(4 if fisheye else 5)
    if fisheye:
        values = numbers.array_of(
            numbers.value_at(block, "distortion_coeffs", block_name), "distortion_coeffs", block_name
        )
        distortion = numbers.fisheye_coefficients(values, "distortion_coeffs", block_name)
    elif block["distortion_model"] == "radtan":
        distortion[:4] = numbers.matrix_at(block, "distortion_coeffs", (1, 4), block_name).ravel()
    size = numbers.array_of(numbers.value_at(block, "resolution", block_name), "resolution", block_name).ravel()
    if size.size != 2 or not all(float(value).is_integer() and 1 <= value <= 1e6 for value in size):
        raise BadFile(f"{block_name}: resolution is not [width, height] in px")
    with named(block_name):
        make = Camera.fisheye if fisheye else Camera.pinhole
        return make(int(size[0]), int(size[1]), fu, fv, pu, pv, distortion=distortion)


def rig_from_kalibr(path: Path, *, unit_m: float | None = None) -> Rig:
    """Return the rig of a camchain, the rig's axes those of cam0: left and right where it has two, else cam0, cam1 ...

    unit_m: the length of its unit in metres. Raises BadFile where the file has more cameras than a rig, another model
    or no T_cn_cnm1.
    """
    return kalibr_rig(read_yaml(path), str(path), unit_m)


def kalibr_rig(content: Mapping[str, Any], where: str, unit_m: float | None = None) -> Rig:
    """Return the rig of a camchain's content; see rig_from_kalibr."""
    found = {int(key[3:]): key for key in content if key.startswith("cam") and key[3:].isdecimal()}
    links = [found[k] for k in sorted(found)]
    if links != [f"cam{k}" for k in range(len(links))] or not links:
        raise BadFile(
            f"{where}: a chain of the cameras {', '.join(links) or 'none'}",
            consequence="Each camera's pose is told from the one before it, cam0 first",
            cure="Number the cameras from cam0 on, and leave none out",
        )
    T, cameras = RigidTransform.identity(), []
    for name, link in zip(SIDES if len(links) == len(SIDES) else links, links, strict=True):
        if link != "cam0":
            step = _step(content, link, where, unit_m)
            T = step if link == "cam1" else T * step  # by the identity a pose would be rounded
        cameras.append(MountedCamera(name=name, camera=kalibr_camera(content, link, where), T_rig_camera=T))
    with named(where):
        return Rig(cameras=cameras)


def _step(content: Mapping[str, Any], link: str, where: str, unit_m: float | None) -> RigidTransform:
    block_name = f"{where}, {link}"
    T = numbers.matrix_at(_block(content, link, where), "T_cn_cnm1", (4, 4), block_name)
    if np.abs(T[3] - (0.0, 0.0, 0.0, 1.0)).max() > 0.0:
        raise BadFile(f"{block_name}: T_cn_cnm1 does not end with the row 0, 0, 0, 1")
    return numbers.placed(numbers.rotation_of(T[:3, :3], "T_cn_cnm1", block_name), T[:3, 3], block_name, unit_m)


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
