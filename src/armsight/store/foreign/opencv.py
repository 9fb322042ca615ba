"""OpenCV FileStorage YAML of calibrated cameras and pairs.

OpenCV fixes no names; these are read: of a pair `M1 D1 M2 D2 R T` (the stereo_calib sample, in one or two files),
`cameraMatrix1 distCoeffs1 ...` (the names of the function's arguments) or `K1 D1 K2 D2 R T`; of one camera
`camera_matrix` or `cameraMatrix` or `K`, with `distortion_coefficients`, `distCoeffs`, `dist_coeffs` or `D`. The
image size is `image_width` and `image_height`, or a list `imageSize`, `image_size` or `size` (width, height); the
stereo sample leaves it out, then it must be given. p_right = R p_left + T. T is in the unit of the board's squares at
calibration: taken as metres unless unit_m says otherwise; a pair more than 10 m apart is refused as millimetres.

A fisheye lens is told by `fisheye_model: 1`, as OpenCV's calibration sample writes it, or by `distortion_model` or
`model`: four coefficients alone may be of either lens and are taken as a pinhole's k1, k2, p1, p2.

The text is parsed here and not by cv2.FileStorage, so that a broken file gives an error that names its line.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from armsight.errors import BadFile, Inconsistent
from armsight.optics import Camera, LensKind, Rig, RigKind
from armsight.store.atomic import write_text
from armsight.store.codec import named
from armsight.store.foreign.numbers import (
    array_of,
    brown_conrady,
    count_at,
    fisheye_coefficients,
    intrinsics_of,
    matrix_at,
    placed,
    relative,
    rotation_of,
    value_at,
)
from armsight.store.foreign.rectification import rectification
from armsight.store.yamls import read_yaml

Array = NDArray[np.float64]

PAIR_NAMES = (("M1", "D1", "M2", "D2"), ("cameraMatrix1", "distCoeffs1", "cameraMatrix2", "distCoeffs2"))
PAIR_NAMES_ALSO = (("K1", "D1", "K2", "D2"), ("cameraMatrix1", "D1", "cameraMatrix2", "D2"))
CAMERA_NAMES = ("camera_matrix", "cameraMatrix", "K", "M")
DISTORTION_NAMES = ("distortion_coefficients", "distCoeffs", "dist_coeffs", "D")
FISHEYE_NAMES = ("fisheye", "equidistant", "kannala_brandt", "opencv_fisheye")
PINHOLE_NAMES = ("pinhole", "plumb_bob", "radtan", "brown_conrady", "opencv", "rational_polynomial")
SIZE_NAMES = ("imageSize", "image_size", "size")

Size = tuple[int, int]


def camera_from_opencv(path: Path, *, size: Size | None = None) -> Camera:
    """Return the camera of a FileStorage YAML; size (width, height) is wanted where the file does not say it."""
    return opencv_camera(read_yaml(path), str(path), size=size)


def opencv_camera(content: Mapping[str, Any], where: str, *, size: Size | None = None) -> Camera:
    """Return the camera that FileStorage content describes; see camera_from_opencv."""
    key = _first(content, CAMERA_NAMES, where)
    distortion = _first(content, DISTORTION_NAMES, where)
    return _camera(content, key, distortion, _size(content, size, where), where)


def rig_from_opencv(paths: Sequence[Path], *, size: Size | None = None, unit_m: float = 1.0) -> Rig:
    """Return the rig of one or more FileStorage files (the sample writes intrinsics.yml and extrinsics.yml).

    size: (width, height) where the files do not say it. unit_m: the length of T's unit in metres. Raises BadFile.
    """
    content: dict[str, Any] = {}
    for path in paths:
        for key, value in read_yaml(path).items():
            if key in content and content[key] != value:
                raise BadFile(f"{path}: {key} differs from the other file's", consequence="The rig is not used")
            content[key] = value
    return opencv_rig(content, " and ".join(str(path) for path in paths), size=size, unit_m=unit_m)


def opencv_rig(content: Mapping[str, Any], where: str, *, size: Size | None = None, unit_m: float = 1.0) -> Rig:
    """Return the rig that FileStorage content describes; see rig_from_opencv."""
    sets = (*PAIR_NAMES, *PAIR_NAMES_ALSO)
    names = next((names for names in sets if all(name in content for name in names)), None)
    if names is None:
        raise BadFile(
            f"{where}: no pair of cameras; found {', '.join(str(key) for key in content)[:200]}",
            consequence="The rig is not known",
            cure="Wanted: " + " or ".join(" ".join(names) for names in sets) + ", with R and T",
        )
    wh = _size(content, size, where)
    R = rotation_of(matrix_at(content, "R", (3, 3), where), "R", where)
    t = matrix_at(content, "T", (3, 1), where).ravel() * unit_m
    return Rig(
        kind=RigKind.STEREO,
        left=_camera(content, names[0], names[1], wh, where),
        right=_camera(content, names[2], names[3], wh, where),
        T_rig_left=RigidTransform.identity(),
        T_rig_right=placed(R, t, where),
    )


def camera_to_opencv(path: Path, camera: Camera) -> None:
    """Write a FileStorage YAML of one camera, with the names of OpenCV's calibration sample."""
    parts: dict[str, int | Array] = {
        "image_width": camera.width,
        "image_height": camera.height,
        "camera_matrix": camera.matrix,
        "distortion_coefficients": camera.distortion.reshape(-1, 1),
    }
    if camera.lens is LensKind.FISHEYE:
        parts |= {"fisheye_model": 1}
    write_text(path, storage_text(parts))


def rig_to_opencv(path: Path, rig: Rig) -> None:
    """Write a FileStorage YAML of a pair: M1 D1 M2 D2 R T in metres, the left image's size, and R1 R2 P1 P2 Q E F.

    Raises Inconsistent where the images differ in size, which this file cannot say.
    """
    if (rig.left.width, rig.left.height) != (rig.right.width, rig.right.height):
        raise Inconsistent("the cameras' images differ in size", consequence="OpenCV's stereo file cannot say this")
    R, t = relative(rig.T_rig_left, rig.T_rig_right)
    parts: dict[str, int | Array] = {
        "image_width": rig.left.width,
        "image_height": rig.left.height,
        "M1": rig.left.matrix,
        "D1": rig.left.distortion.reshape(1, -1),
        "M2": rig.right.matrix,
        "D2": rig.right.distortion.reshape(1, -1),
        "R": R,
        "T": t.reshape(3, 1),
    }
    if rig.left.lens is LensKind.FISHEYE:
        parts |= {"fisheye_model": 1}
    found = rectification(rig)
    parts |= {name: getattr(found, name) for name in ("R1", "R2", "P1", "P2", "Q", "E", "F")}
    write_text(path, storage_text(parts))


def storage_text(parts: Mapping[str, int | Array]) -> str:
    """Return whole numbers and matrices as FileStorage YAML, which cv2.FileStorage reads."""
    lines = ["%YAML:1.0", "---"]
    for name, value in parts.items():
        if isinstance(value, int):
            lines.append(f"{name}: {value}")
            continue
        rows = ",\n       ".join(", ".join(repr(float(x)) for x in row) for row in value)
        head = f"{name}: !!opencv-matrix\n   rows: {value.shape[0]}\n   cols: {value.shape[1]}\n   dt: d"
        lines.append(f"{head}\n   data: [ {rows} ]")
    return "\n".join(lines) + "\n"


def _camera(content: Mapping[str, Any], matrix: str, distortion: str, size: Size, where: str) -> Camera:
    intrinsics = intrinsics_of(matrix_at(content, matrix, (3, 3), where), matrix, where)
    fisheye = _is_fisheye(content, where)
    coefficients = fisheye_coefficients if fisheye else brown_conrady
    values = coefficients(array_of(value_at(content, distortion, where), distortion, where), distortion, where)
    make = Camera.fisheye if fisheye else Camera.pinhole
    with named(where):
        return make(*size, *intrinsics[:4], skew=intrinsics[4], distortion=values)


def _is_fisheye(content: Mapping[str, Any], where: str) -> bool:
    """Tell whether the coefficients are of cv2.fisheye; BadFile for a model that is neither."""
    name = content.get("distortion_model", content.get("model"))
    known = {**dict.fromkeys(FISHEYE_NAMES, True), **dict.fromkeys(PINHOLE_NAMES, False)}
    if isinstance(name, str) and name.lower() not in known:
        raise BadFile(
            f"{where}: the lens model is {name[:40]!r}",
            consequence="Only OpenCV's pinhole and its fisheye can be used",
            cure="Calibrate with cv2.calibrateCamera or cv2.fisheye.calibrate",
        )
    return bool(content.get("fisheye_model", False)) or (isinstance(name, str) and known[name.lower()])


def _first(content: Mapping[str, Any], names: Sequence[str], where: str) -> str:
    for name in names:
        if name in content:
            return name
    found = ", ".join(str(key) for key in content)[:200]
    raise BadFile(f"{where}: none of {', '.join(names)}; found {found}", consequence="The file is not used")


def _size(content: Mapping[str, Any], size: Size | None, where: str) -> Size:
    if "image_width" in content:
        return count_at(content, "image_width", where), count_at(content, "image_height", where)
    for name in SIZE_NAMES:
        if name in content:
            values = array_of(content[name], name, where).ravel()
            if values.size != 2 or not all(float(v).is_integer() and 1 <= v <= 1e6 for v in values):
                raise BadFile(f"{where}: {name} is not a width and a height in px", consequence="It is not used")
            return int(values[0]), int(values[1])
    if size is None:
        raise BadFile(
            f"{where}: the file does not say the size of the images",
            consequence="The cameras are not known completely",
            cure="Give the size, e.g. --size 640x480, or add image_width and image_height to the file",
        )
    return size
