"""Cameras by name with poses to one frame, as aniposelib, caliscope and multical keep them, and as a rig here.

All three write OpenCV's numbers: matrix, distortion, image size (width, height), and a pose p_camera = R p_world + t
whose length has the unit of the board's squares at calibration. aniposelib (0.8, cameras.py): TOML, a table cam_0,
cam_1 ... each, taken in the order of these keys, `rotation` a rotation vector, `fisheye = true` for cv2.fisheye.
caliscope (0.11, cameras/camera_array.py): TOML, tables `cameras.ID`, `rotation` a rotation vector or, in old files, a
matrix; a camera that was not placed yet has none. multical (io/export_calib.py): JSON, `cameras` and `camera_poses`
with R and T, of a camera's name, or of `A_to_B`: p_A = R p_B + t, where B is named alone; model `standard`, `rational`,
`thin_prism`, `tilted` or `fisheye`.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.arrays import Array
from armsight.errors import BadFile, UsageError
from armsight.optics import SIDES, Camera, LensKind, MountedCamera, Rig
from armsight.store.atomic import write_json, write_text
from armsight.store.codec import named
from armsight.store.foreign import numbers
from armsight.store.foreign.opencv_lens import opencv_lens
from armsight.store.foreign.storage import read_storage

Pose = tuple[Array, Array]

NO_NAME = re.compile(r"[^A-Za-z0-9_-]+")


@dataclass(frozen=True, slots=True, kw_only=True)
class Asked:
    """What is said beside a file: the images' size (width, height) px, the length of its unit, which camera or cameras
    are meant, whether a lens may be taken as the nearest one; told takes what is to be said of the file."""

    size: tuple[int, int] | None = None
    unit_m: float | None = None
    names: tuple[str, ...] = ()
    approximate: bool = False
    told: list[str] = field(default_factory=list)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Placed:
    """A camera of a file, its name there; lens: reads it, only of those that are meant, so that no other one is named
    or refused; pose: R (3, 3), t (3,) of p_camera = R p_world + t, None where unknown."""

    name: str
    lens: Callable[[], Camera]
    pose: Pose | None = None


def camera_of(found: Sequence[Placed], where: str, asked: Asked) -> Camera:
    """Return the camera that is meant, or the only one. Raises UsageError where it is not clear which."""
    if len(found) == 1 and not asked.names:
        return found[0].lens()
    if len(asked.names) != 1:
        raise UsageError(
            f"{where} holds {len(found)} cameras: {_names(found)}",
            consequence="One camera goes into one file",
            cure=f"Say which: --name {found[0].name}; or convert all of them as a rig",
        )
    return chosen(found, where, asked)[0].lens()


def chosen(found: Sequence[Placed], where: str, asked: Asked) -> list[Placed]:
    """Return the cameras that are meant, in the order that they are named in; all where none is named."""
    by_name = {one.name: one for one in found}
    if len(by_name) < len(found):
        raise BadFile(
            f"{where} holds {len(found)} cameras of {len(by_name)} names: {_names(found)}",
            consequence="Which of those of one name is meant is not clear",
            cure="Keep one of each name",
        )
    unknown = [name for name in asked.names if name not in by_name]
    if unknown:
        raise UsageError(f"{where} holds no camera {unknown[0]!r}", cure=f"Use one of: {_names(found)}")
    return [by_name[name] for name in asked.names] if asked.names else list(found)


def rig_of(found: Sequence[Placed], where: str, asked: Asked, names: Sequence[str] = ()) -> Rig:
    """Return the cameras that are meant as a rig in the axes of the first one, under their names or other ones.

    Raises BadFile where one has no pose, and where the unit is open; UsageError.
    """
    cameras = chosen(found, where, asked)
    loose = [one.name for one in cameras if one.pose is None]
    if loose:
        raise BadFile(
            f"{where}: no pose of {', '.join(loose)}",
            consequence="A rig needs the pose of every camera",
            cure=f"Name the others: {' '.join(f'--name {one.name}' for one in cameras if one.pose is not None)}"
            if len(loose) < len(cameras)
            else "Convert each as a camera, and calibrate how they stand",
        )
    if sorted(one.name for one in cameras) == list(SIDES):
        cameras.sort(key=lambda one: one.name)  # a pair's first is left
    called = names if len(names) == len(cameras) else _plain(cameras, asked)
    mounted: list[MountedCamera] = []
    (R_first, t_first), *_ = poses = [one.pose for one in cameras if one.pose is not None]
    for one, name, (R, t) in zip(cameras, called, poses, strict=True):
        T = RigidTransform.identity()
        if mounted:
            R = R @ R_first.T
            step = t - R @ t_first
            if not step.any():
                raise BadFile(
                    f"{where}: {cameras[0].name} and {one.name} stand at the same point",
                    consequence="Two views from one point measure no distance",
                    cure=f"Say which are meant: --name {cameras[0].name} --name ..., of those that stand apart",
                )
            T = numbers.placed(R, step, f"{where}, {cameras[0].name} and {one.name}", asked.unit_m)
        mounted.append(MountedCamera(name=name, camera=one.lens(), T_rig_camera=T))
    with named(where):
        return Rig(cameras=mounted)


def _plain(cameras: Sequence[Placed], asked: Asked) -> list[str]:
    """Return names that a rig takes: of two cameras left and right, else a letter first and no other signs.

    What is changed is told.
    """
    if len(cameras) == len(SIDES) and {one.name for one in cameras} != set(SIDES):
        asked.told.append(f"the cameras {cameras[0].name} and {cameras[1].name} are called left and right here")
        return list(SIDES)
    plain = []
    for one in cameras:
        name = NO_NAME.sub("-", one.name)[:16]
        plain.append(name if name[:1].isalpha() else f"cam{name}"[:16])
        if plain[-1] != one.name:
            asked.told.append(f"the camera {one.name!r} is called {plain[-1]} here")
    return plain


def _names(found: Sequence[Placed]) -> str:
    return ", ".join(one.name for one in found)


def read_aniposelib(path: Path, asked: Asked) -> list[Placed]:
    """Return the cameras of aniposelib's calibration.toml. Raises BadFile."""
    content = read_storage(path)
    return [
        _opencv(str(content[key]["name"]), content[key], f"{path}, {key}", asked, pose=("rotation", "translation"))
        for key in sorted(content)
        if key != "metadata"
    ]


def read_caliscope(path: Path, asked: Asked) -> list[Placed]:
    """Return the cameras of caliscope's camera_array.toml. Raises BadFile."""
    cameras = read_storage(path)["cameras"]
    return [
        _opencv(str(key), one, f"{path}, camera {key}", asked, pose=("rotation", "translation"))
        for key, one in cameras.items()
    ]


def read_multical(path: Path, asked: Asked) -> list[Placed]:
    """Return the cameras of multical's calibration.json. Raises BadFile."""
    content = read_storage(path)
    poses = _multical_poses(content.get("camera_poses") or {}, list(content["cameras"]), str(path))
    renamed = {"K": "matrix", "dist": "distortions", "image_size": "size"}
    found = []
    for name, one in content["cameras"].items():
        where = f"{path}, {name}"
        model = str(one.get("model", "standard"))
        if model not in ("standard", "rational", "thin_prism", "tilted", "fisheye"):
            raise BadFile(f"{where}: the model is {model[:40]!r}", cure="Calibrate with its model standard")
        camera = {renamed.get(key, key): value for key, value in one.items()} | {"fisheye": model == "fisheye"}
        placed = _opencv(name, camera, where, asked)
        found.append(replace(placed, pose=poses.get(name)))
    return found


def _multical_poses(poses: Mapping[str, Any], names: Sequence[str], where: str) -> dict[str, Pose]:
    """Return R, t of p_camera = R p_world + t, by camera; relations are followed from the cameras named alone."""
    given = {
        str(key): (
            numbers.rotation_of(numbers.matrix_at(one, "R", (3, 3), f"{where}, {key}"), "R", f"{where}, {key}"),
            numbers.matrix_at(one, "T", (3, 1), f"{where}, {key}").ravel(),
        )
        for key, one in poses.items()
        if isinstance(one, Mapping)
    }
    found = {name: given[name] for name in names if name in given}
    steps = {(a, b): given[f"{a}_to_{b}"] for a in names for b in names if a not in found and f"{a}_to_{b}" in given}
    while any(b in found and a not in found for a, b in steps):
        for (a, b), (R, t) in steps.items():
            if b in found and a not in found:
                found[a] = (R @ found[b][0], R @ found[b][1] + t)
    return found


def _opencv(name: str, one: Mapping[str, Any], where: str, asked: Asked, pose: tuple[str, str] | None = None) -> Placed:
    """Return a camera of OpenCV's numbers, with its pose under two keys where it has one."""
    lens = partial(_opencv_lens, one, where, asked)
    if pose is None or all(one.get(key) in (None, "null") for key in pose):  # "null": caliscope's, not placed yet
        return Placed(name=name, lens=lens)
    R = numbers.array_of(numbers.value_at(one, pose[0], where), pose[0], where)
    R = Rotation.from_rotvec(R.ravel()).as_matrix() if R.size == 3 else numbers.matrix_at(one, pose[0], (3, 3), where)
    t = numbers.matrix_at(one, pose[1], (3, 1), where).ravel()
    return Placed(name=name, lens=lens, pose=(numbers.rotation_of(R, pose[0], where), t))


def _opencv_lens(one: Mapping[str, Any], where: str, asked: Asked) -> Camera:
    size = numbers.array_of(numbers.value_at(one, "size", where), "size", where).ravel()
    if size.size != 2 or not all(float(value).is_integer() and 1 <= value <= 1e6 for value in size):
        raise BadFile(f"{where}: size is not [width, height] in px", cure="Correct it there")
    wh = int(size[0]), int(size[1])
    intrinsics = numbers.intrinsics_of(numbers.matrix_at(one, "matrix", (3, 3), where), "matrix", where)
    values = numbers.array_of(numbers.value_at(one, "distortions", where), "distortions", where)
    return lens_of(values, intrinsics, wh, where, asked, fisheye=bool(one.get("fisheye", False)))


def lens_of(
    values: Array,
    intrinsics: tuple[float, float, float, float, float],
    size: tuple[int, int],
    where: str,
    asked: Asked,
    *,
    fisheye: bool,
) -> Camera:
    """Return a camera from OpenCV's coefficients; of a fisheye the first four, where the others are zero."""
    if fisheye:
        flat = values.ravel()
        values = numbers.fisheye_coefficients(flat if np.any(flat[4:]) else flat[:4], "the distortion", where)
        with named(where):
            return Camera.fisheye(*size, *intrinsics[:4], skew=intrinsics[4], distortion=values)
    return opencv_lens(values, intrinsics, size, where, asked.told, approximate=asked.approximate)


def write_several(path: Path, rig: Rig, kind: str) -> None:
    """Write a rig as aniposelib, caliscope or multical keep it, in metres, the world being the rig's axes."""
    cameras = [_parts(one) for one in rig.cameras]
    if kind == "multical":
        poses = {
            one.name: {"R": Rotation.from_rotvec(parts["rotation"]).as_matrix().tolist(), "T": parts["translation"]}
            for one, parts in zip(rig.cameras, cameras, strict=True)
        }
        lenses = {
            one.name: {
                "model": "fisheye" if parts["fisheye"] else "rational" if len(parts["distortions"]) > 5 else "standard",
                "image_size": parts["size"],
                "K": parts["matrix"],
                "dist": [parts["distortions"]],
            }
            for one, parts in zip(rig.cameras, cameras, strict=True)
        }
        write_json(path, {"cameras": lenses, "camera_poses": poses})
        return
    tables = []
    for k, (one, parts) in enumerate(zip(rig.cameras, cameras, strict=True)):
        head = f'[cam_{k}]\nname = "{one.name}"' if kind == "aniposelib" else f"[cameras.{k}]\ncam_id = {k}"
        tables.append("\n".join([head, *(f"{key} = {_toml(value)}" for key, value in parts.items())]))
    write_text(path, "\n\n".join([*tables, *(["[metadata]"] if kind == "aniposelib" else [])]) + "\n")


def _parts(one: MountedCamera) -> dict[str, Any]:
    T = one.T_rig_camera.inv()
    return {
        "size": [one.camera.width, one.camera.height],
        "matrix": one.camera.matrix.tolist(),
        "distortions": one.camera.distortion.tolist(),
        "rotation": T.rotation.as_rotvec().tolist(),
        "translation": T.translation.tolist(),
        "fisheye": one.camera.lens is LensKind.FISHEYE,
    }


def _toml(value: object) -> str:
    """Return a number, a truth value or nested lists of numbers as TOML, which says these as Python and JSON do."""
    return str(value).lower() if isinstance(value, bool) else str(value)
