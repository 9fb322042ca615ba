"""Intel RealSense: what rs-enumerate-devices -c prints, and JSON of librealsense's own fields.

librealsense (include/librealsense2/rsutil.h, h/rs_types.h, tools/enumerate-devices): p_to = R p_from + t in metres, R
as nine numbers column by column, which the tool prints as the matrix; ppx, ppy from the centre of the first pixel.
"Brown Conrady" is OpenCV's model with k1, k2, p1, p2, k3. "Inverse" and "Modified Brown Conrady" both project with the
shift by p1, p2 taken of what k1, k2, k3 have bent already, which the nearest k1, k2, p1, p2, k3 differ from by
hundredths of a pixel; "inverse" is what deprojecting does, not what the coefficients are of. "Kannala Brandt4" is
OpenCV's fisheye. Ftheta has one coefficient more than Kalibr's fov and is no lens of this maker's stereo cameras.

The tool prints each camera once a size, and the poses between all streams. JSON has no fixed form, as everybody writes
it with Python: taken are mappings of rs2_intrinsics (width, height, fx, fy, ppx, ppy, model, coeffs) by the keys that
lead to them, and of rs2_extrinsics under a key that says from and to, such as depth_to_color.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from armsight.arrays import Array
from armsight.errors import BadFile, UsageError
from armsight.optics import Camera
from armsight.store.foreign import lenses, numbers
from armsight.store.foreign.several import Asked, Placed, Pose, lens_of
from armsight.store.foreign.storage import REALSENSE_TEXT, read_storage
from armsight.store.tables import plain_float

INTRINSICS = frozenset(("width", "height", "fx", "fy", "ppx", "ppy", "model", "coeffs"))
EXTRINSICS = frozenset(("rotation", "translation"))
MODELS = ("none", "modified_brown_conrady", "inverse_brown_conrady", "ftheta", "brown_conrady", "kannala_brandt4")
"""In the order of rs2_distortion."""
BENT = MODELS[1:3]
BLOCK = re.compile(r'^\s*Intrinsic of "([^"]+)" / \d+x\d+ / \{[^}]*\}\s*$(.*?)(?=^\s*(?:In|Ex)trinsic|\Z)', re.M | re.S)
FIELD = re.compile(r"^\s*(Width|Height|PPX|PPY|Fx|Fy|Distortion|Coeffs):[ \t]*(.*?)\s*$", re.M)
STEP = re.compile(
    r'^\s*Extrinsic from "([^"]+)"\s+To\s+"([^"]+)"\s*:\s*'
    r"Rotation Matrix:\s*((?:\S+\s+){9})Translation Vector:([^\n]*)$",
    re.M,
)
RENAMED = {"Distortion": "model"}


def read_realsense(path: Path, asked: Asked) -> list[Placed]:
    """Return the cameras of a RealSense, placed in the axes of the one that most of them have a pose to.

    Raises BadFile; UsageError where it holds several sizes of a camera and none is said.
    """
    content, where = read_storage(path), str(path)
    text = content.get(REALSENSE_TEXT)
    found = list(_of_text(text, where)) if isinstance(text, str) else list(_of_json(content, (), where))
    blocks = [(name, one) for name, one in found if one.keys() >= INTRINSICS]
    cameras = _of_size(blocks, where, asked)
    poses = _poses([(name, one) for name, one in found if one.keys() >= EXTRINSICS], list(cameras), where)
    return [
        Placed(name=name, lens=partial(_camera, one, f"{where}, {name}", asked), pose=poses.get(name))
        for name, one in cameras.items()
    ]


def _of_text(text: str, where: str) -> Iterator[tuple[str, Mapping[str, Any]]]:
    """Yield the intrinsics and extrinsics that rs-enumerate-devices printed, by their streams."""
    try:
        for name, block in BLOCK.findall(text):
            if not block.strip():  # "Intrinsic NOT available!"
                continue
            one: dict[str, Any] = {RENAMED.get(key, key.lower()): value for key, value in FIELD.findall(block)}
            counts = {key: int(one[key]) for key in ("width", "height")}
            lens = {key: plain_float(one[key]) for key in ("fx", "fy", "ppx", "ppy")}
            yield name, {**one, **counts, **lens, "coeffs": [plain_float(x) for x in one["coeffs"].split()]}
        for a, b, R, t in STEP.findall(text):
            columns = np.array([plain_float(x) for x in R.split()]).reshape(3, 3).T.ravel().tolist()
            yield f"{a}_to_{b}", {"rotation": columns, "translation": [plain_float(x) for x in t.split()]}
    except (ValueError, KeyError) as error:
        raise BadFile(
            f"{where}: a block of rs-enumerate-devices is damaged ({error})", cure="Print it anew into a file"
        ) from error


def _of_json(content: Any, keys: tuple[str, ...], where: str) -> Iterator[tuple[str, Mapping[str, Any]]]:
    """Yield the mappings of intrinsics and extrinsics by the keys that lead to them."""
    if isinstance(content, Mapping):
        if content.keys() >= INTRINSICS or content.keys() >= EXTRINSICS:
            said = [re.sub(r"_?(in|ex)trin(sic)?s?_?", "", key, flags=re.IGNORECASE) for key in keys]
            yield "-".join(key for key in said if key) or "camera", content
            return
        for key, value in content.items():
            yield from _of_json(value, (*keys, str(key)), where)


def _of_size(blocks: Sequence[tuple[str, Mapping[str, Any]]], where: str, asked: Asked) -> dict[str, Mapping[str, Any]]:
    """Return each camera's block of the size that is asked for, or its only one. Raises BadFile, UsageError."""
    names = dict.fromkeys(name for name, _ in blocks)
    if not names:
        raise BadFile(f"{where}: no intrinsics of a camera", cure="Print them with rs-enumerate-devices -c")
    found: dict[str, Mapping[str, Any]] = {}
    for name in names:
        of = {str(one): one for key, one in blocks if key == name and asked.size in (None, _size(one))}
        if len(of) > 1 and (not asked.names or name in asked.names):
            sizes = ", ".join(dict.fromkeys("{}x{}".format(*_size(one)) for one in of.values()))
            raise UsageError(
                f"{where} holds {len(of)} calibrations of {name}, of images of {sizes}",
                consequence="Which is meant is not clear",
                cure=f"Give the size of the images that you record, such as --size {sizes.split(',')[0]}"
                if "," in sizes
                else "Keep the one of the format that you record: raw and rectified images differ",
            )
        if of:
            found[name] = next(iter(of.values()))
    if not found:
        raise UsageError(f"{where}: no camera has images of that size", cure="Give one that is there, or none")
    return found


def _size(one: Mapping[str, Any]) -> tuple[Any, Any]:
    return one["width"], one["height"]


def _poses(steps: Sequence[tuple[str, Mapping[str, Any]]], names: Sequence[str], where: str) -> dict[str, Pose]:
    """Return R, t (m) of p_camera = R p_common + t of the cameras that have a pose to the first one that others have
    one to.
    """
    given: dict[tuple[str, str], Pose] = {}
    plain = {name.lower(): name for name in names}
    for key, one in steps:
        a, _, b = key.lower().partition("_to_")
        if a in plain and b in plain and a != b:
            here = f"{where}, {key}"
            R = numbers.array_of(one["rotation"], "rotation", here)
            if R.shape != (9,):
                raise BadFile(
                    f"{here}: the rotation has the shape {R.shape}",
                    consequence="librealsense has nine numbers column by column; whether rows of three are rows or "
                    "columns is not known",
                    cure="Write its nine numbers as they come: list(extrinsics.rotation)",
                )
            R = numbers.rotation_of(R.reshape(3, 3).T, "rotation", here)
            step = R, numbers.matrix_at(one, "translation", (3, 1), here).ravel()
            before = given.setdefault((plain[a], plain[b]), step)
            if any((x != y).any() for x, y in zip(before, step, strict=True)):
                raise BadFile(f"{where}: two poses from {plain[a]} to {plain[b]}", cure="Keep those of one device")
    best: dict[str, Pose] = {}
    for common in names:
        poses: dict[str, Pose] = {common: (np.eye(3), np.zeros(3))}
        for name in names:
            if (common, name) in given:
                poses[name] = given[common, name]
            elif (name, common) in given:
                R, t = given[name, common]
                poses[name] = R.T, -R.T @ t
        best = max(best, poses, key=len)
    return best if len(best) > 1 else {}


def _camera(one: Mapping[str, Any], where: str, asked: Asked) -> Camera:
    """Return the camera of rs2_intrinsics. Raises BadFile."""
    word = str(one["model"]).lower().rsplit(".", 1)[-1].removeprefix("rs2_distortion_").replace(" ", "_")
    model = MODELS[int(word)] if word.isdecimal() and int(word) < len(MODELS) else word
    values = numbers.array_of(one["coeffs"], "coeffs", where).ravel()
    fx, fy, ppx, ppy = (numbers.number_at(one, key, where) for key in ("fx", "fy", "ppx", "ppy"))
    size = numbers.count_at(one, "width", where), numbers.count_at(one, "height", where)
    intrinsics = (fx, fy, ppx, ppy, 0.0)
    if model not in MODELS or values.size != 5 or (model in ("none", "ftheta") and values.any()):
        raise BadFile(
            f"{where}: the lens is {model[:40]!r} with {values.size} coefficients",
            consequence="It cannot be used",
            cure="Calibrate the camera anew here",
        )
    if model not in BENT or not values[2:4].any():
        return lens_of(values, intrinsics, size, where, asked, fisheye=model == "kannala_brandt4")
    k1, k2, p1, p2, k3 = values

    def step(rays: Array) -> tuple[Array, Array]:
        r2 = (rays**2).sum(axis=1)
        stretch = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
        x, y = (rays * stretch[:, None]).T
        return stretch, np.stack([2 * p1 * x * y + p2 * (r2 + 2 * x**2), 2 * p2 * x * y + p1 * (r2 + 2 * y**2)], axis=1)

    uv = lenses.pixels(size)
    rays = lenses.straight(lenses.in_plane(uv, intrinsics), step, where)
    return lenses.nearest_pinhole(rays, uv, intrinsics, size, where, asked)
