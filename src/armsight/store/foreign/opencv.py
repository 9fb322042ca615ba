"""OpenCV FileStorage YAML of calibrated cameras and pairs.

OpenCV fixes no names; these are read: of a pair `M1 D1 M2 D2 R T` (the stereo_calib sample, in one or two files),
`cameraMatrix1 distCoeffs1 ...` (the names of the function's arguments), `K1 D1 K2 D2 R T` or the ZED's `K_LEFT D_LEFT
K_RIGHT D_RIGHT R T`, whose R is a rotation vector; of one camera
`camera_matrix` or `cameraMatrix` or `K`, with `distortion_coefficients`, `distCoeffs`, `dist_coeffs` or `D`. The
image size is `image_width` and `image_height`, or a list `imageSize`, `image_size` or `size` (width, height); the
stereo sample leaves it out, then it must be given. p_right = R p_left + T. T is in the unit of the board's squares at
calibration: taken as metres unless unit_m says otherwise; for a pair more than 1 m apart it must be said.

A fisheye lens is told by `fisheye_model: 1`, as OpenCV's calibration sample writes it, or by `distortion_model` or
`model`. Four coefficients alone may be of either lens: they are taken as a pinhole's k1, k2, p1, p2 where these can be
such, which is refused for a wide lens and for p1, p2 beyond what a tilted sensor makes.

The text, YAML, JSON or XML, is parsed here and not by cv2.FileStorage, so that
a broken file gives an error that names its line.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.arrays import Array
from armsight.errors import BadFile, Inconsistent
from armsight.optics import Camera, LensKind, Rig, RigKind
from armsight.store.atomic import write_text
from armsight.store.codec import named
from armsight.store.foreign import numbers
from armsight.store.foreign.opencv_lens import opencv_lens
from armsight.store.foreign.storage import read_storage

PAIR_NAMES = (("M1", "D1", "M2", "D2"), ("cameraMatrix1", "distCoeffs1", "cameraMatrix2", "distCoeffs2"))
PAIR_NAMES_ALSO = (
    ("K1", "D1", "K2", "D2"),
    ("cameraMatrix1", "D1", "cameraMatrix2", "D2"),
    ("K_LEFT", "D_LEFT", "K_RIGHT", "D_RIGHT"),
)
CAMERA_NAMES = ("camera_matrix", "cameraMatrix", "K", "M", "mtx")
DISTORTION_NAMES = ("distortion_coefficients", "distCoeffs", "dist_coeffs", "D", "dist_coeff", "dist")
FISHEYE_NAMES = ("fisheye", "equidistant", "kannala_brandt", "opencv_fisheye")
PINHOLE_NAMES = ("pinhole", "plumb_bob", "radtan", "brown_conrady", "opencv", "rational_polynomial")
SIZE_NAMES = ("imageSize", "image_size", "size", "Size", "img_size")

Size = tuple[int, int]

WIDE = 1.0
"""Tangent of the angle from the axis to an image's corner beyond which lenses are mostly fisheyes (45 degrees)."""
TILTED = 0.005
"""p1, p2 of a lens that stands askew by 0.3 degrees; of calibrated pinholes they are below a third of it."""


def camera_from_opencv(
    path: Path, *, size: Size | None = None, told: list[str] | None = None, approximate: bool = False
) -> Camera:
    """Return a FileStorage file's camera; size (width, height): where it says none. told: takes what is to be said.

    approximate: of a lens that is not modelled take the nearest one.
    """
    return opencv_camera(read_storage(path), str(path), size=size, told=told, approximate=approximate)


def opencv_camera(
    content: Mapping[str, Any],
    where: str,
    *,
    size: Size | None = None,
    told: list[str] | None = None,
    approximate: bool = False,
) -> Camera:
    """Return the camera that FileStorage content describes; see camera_from_opencv."""
    key = _first(content, CAMERA_NAMES, where)
    distortion = _first(content, DISTORTION_NAMES, where)
    return _camera(content, (key, distortion), _size(content, size, where), where, told, approximate)


def rig_from_opencv(
    paths: Sequence[Path],
    *,
    size: Size | None = None,
    unit_m: float | None = None,
    told: list[str] | None = None,
    approximate: bool = False,
) -> Rig:
    """Return the rig of one or more FileStorage files (the sample writes intrinsics.yml and extrinsics.yml).

    size: (width, height) where the files do not say it. unit_m: the length of T's unit in metres. told: takes what is
    to be said of them. Raises BadFile.
    """
    content: dict[str, Any] = {}
    for path in paths:
        for key, value in read_storage(path).items():
            if key in content and content[key] != value:
                raise BadFile(f"{path}: {key} differs from the other file's")
            content[key] = value
    where = " and ".join(str(path) for path in paths)
    return opencv_rig(content, where, size=size, unit_m=unit_m, told=told, approximate=approximate)


def opencv_rig(
    content: Mapping[str, Any],
    where: str,
    *,
    size: Size | None = None,
    unit_m: float | None = None,
    told: list[str] | None = None,
    approximate: bool = False,
) -> Rig:
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
    R = _rotation(content, where, told)
    t = numbers.matrix_at(content, "T", (3, 1), where).ravel()
    return Rig(
        kind=RigKind.STEREO,
        left=_camera(content, names[:2], wh, where, told, approximate),
        right=_camera(content, names[2:], wh, where, told, approximate),
        T_rig_left=RigidTransform.identity(),
        T_rig_right=numbers.placed(R, t, where, unit_m),
    )


def _rotation(content: Mapping[str, Any], where: str, told: list[str] | None) -> Array:
    """Return R (3, 3); three numbers are a rotation vector, as cv2.Rodrigues and the ZED's tools write it."""
    given = numbers.array_of(numbers.value_at(content, "R", where), "R", where)
    if given.size != 3:
        return numbers.rotation_of(numbers.matrix_at(content, "R", (3, 3), where), "R", where)
    if told is not None:
        told.append(f"{where}: R has three numbers, taken as a rotation vector in radians")
    return np.asarray(Rotation.from_rotvec(given.ravel()).as_matrix())


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
    R, t = numbers.relative(rig.T_rig_left, rig.T_rig_right)
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
    found = numbers.rectification(rig)
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


def _camera(
    content: Mapping[str, Any], names: Sequence[str], size: Size, where: str, told: list[str] | None, approximate: bool
) -> Camera:
    matrix, distortion = names
    intrinsics = numbers.intrinsics_of(numbers.matrix_at(content, matrix, (3, 3), where), matrix, where)
    given = numbers.array_of(numbers.value_at(content, distortion, where), distortion, where)
    fisheye = _is_fisheye(content, where)
    if fisheye:
        values = numbers.fisheye_coefficients(given, distortion, where)
        with named(where):
            return Camera.fisheye(*size, *intrinsics[:4], skew=intrinsics[4], distortion=values)
    if not {"fisheye_model", "distortion_model", "model"} & set(content):
        _refuse_open_lens(given.ravel(), intrinsics, size, f"{where}: {distortion}")
    return opencv_lens(given, intrinsics, size, f"{where}: {distortion}", told, approximate=approximate)


def _refuse_open_lens(given: Array, intrinsics: tuple[float, ...], size: Size, where: str) -> None:
    """Raise BadFile for four coefficients (4,) that may well be a fisheye's, of a file that does not say the lens."""
    fx, fy, cx, cy = intrinsics[:4]
    if given.size != 4 or not given.any() or not (fx > 0.0 and fy > 0.0):
        return
    reach = np.hypot(max(cx, size[0] - cx) / fx, max(cy, size[1] - cy) / fy)
    tilt = float(np.abs(given[2:]).max())
    if reach <= WIDE and tilt <= TILTED:
        return
    why = f"the lens sees {np.degrees(np.arctan(reach)):.0f} degrees from its axis" if reach > WIDE else ""
    raise BadFile(
        f"{where} has four coefficients and no lens model, and " + (why or f"the last two are up to {tilt:g}"),
        consequence="They may be a fisheye's k1, k2, k3, k4 as well as a pinhole's k1, k2, p1, p2",
        cure="Add a line to the file: `distortion_model: equidistant` for cv2.fisheye, `distortion_model: plumb_bob` "
        "for cv2.calibrateCamera",
    )


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
    raise BadFile(f"{where}: none of {', '.join(names)}; found {found}")


def _size(content: Mapping[str, Any], size: Size | None, where: str) -> Size:
    if "image_width" in content:
        return numbers.count_at(content, "image_width", where), numbers.count_at(content, "image_height", where)
    for name in SIZE_NAMES:
        if name in content:
            values = numbers.array_of(content[name], name, where).ravel()
            if values.size != 2 or not all(float(v).is_integer() and 1 <= v <= 1e6 for v in values):
                raise BadFile(f"{where}: {name} is not a width and a height in px")
            return int(values[0]), int(values[1])
    if size is None:
        raise BadFile(
            f"{where}: the file does not say the size of the images",
            consequence="The cameras are not known completely",
            cure="Give the size, e.g. --size 640x480, or add image_width and image_height to the file",
        )
    return size
