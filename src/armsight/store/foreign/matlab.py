"""MATLAB's cameraParameters and stereoParameters, saved as a struct: s = toStruct(params); save('f.mat', 's', '-v7').

MathWorks' reference (cameraParameters, stereoParameters, stereoParametersToOpenCV) and the classes' own text: the first
pixel's centre is at (1, 1); IntrinsicMatrix, of all releases, is the transpose of K, which came with R2022b;
RadialDistortion k1, k2 (k3), TangentialDistortion p1, p2 are OpenCV's; ImageSize is rows, columns, and missing before
R2017. [x y z] in the first camera's axes times RotationOfCamera2 plus TranslationOfCamera2 are those in the second's:
the transpose of OpenCV's R. Lengths are in WorldUnits, which is free text.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from armsight.arrays import Array
from armsight.errors import BadFile, UsageError
from armsight.optics import SIDES, Camera
from armsight.store.foreign import numbers
from armsight.store.foreign.several import Asked, Placed, lens_of
from armsight.store.interpret.other_files import mat_variables

SECOND = "CameraParameters2"
UNITS = {
    **dict.fromkeys(("mm", "millimeter", "millimeters", "millimetre", "millimetres"), 1e-3),
    **dict.fromkeys(("cm", "centimeter", "centimeters", "centimetre", "centimetres"), 1e-2),
    **dict.fromkeys(("m", "meter", "meters", "metre", "metres"), 1.0),
    **dict.fromkeys(("in", "inch", "inches"), 0.0254),
}
"""Lengths in metres of what is written as WorldUnits."""
FIRST_PX = 1.0


def read_matlab(path: Path, asked: Asked) -> list[Placed]:
    """Return the camera, or left and right, of a struct in a .mat file. Raises BadFile, UsageError."""
    where = str(path)
    variables = mat_variables(path, ("struct",))
    found = {name: one for name, one in variables.items() if isinstance(one, Mapping) and _is_one(one)}
    if len(found) != 1:
        raise BadFile(
            f"{where}: {len(found)} structs of cameraParameters or stereoParameters",
            consequence="Loose matrices do not say whose convention they have",
            cure="Save one: s = toStruct(params); save('f.mat', 's', '-v7')",
        )
    ((name, one),) = found.items()
    here = f"{where}, {name}"
    if SECOND not in one:
        return [Placed(name="camera", lens=partial(_camera, one, here, asked))]
    first, second = _part(one, "CameraParameters1", here), _part(one, SECOND, here)
    R = numbers.rotation_of(_matrix(one, "RotationOfCamera2", (3, 3), here).T, "RotationOfCamera2", here)
    t = _matrix(one, "TranslationOfCamera2", (1, 3), here).ravel()
    return [
        Placed(
            name=SIDES[0],
            lens=partial(_camera, first, f"{here}, CameraParameters1", asked),
            pose=(np.eye(3), np.zeros(3)),
        ),
        Placed(
            name=SIDES[1],
            lens=partial(_camera, second, f"{here}, {SECOND}", asked),
            pose=(R, _scaled(t, first, here, asked)),
        ),
    ]


def _is_one(struct: Mapping[str, Any]) -> bool:
    return "RadialDistortion" in struct or (SECOND in struct and "CameraParameters1" in struct)


def _part(struct: Mapping[str, Any], key: str, where: str) -> Mapping[str, Any]:
    part = numbers.value_at(struct, key, where)
    if isinstance(part, Mapping):
        return part
    raise BadFile(f"{where}: {key} is no struct", cure="Save it with toStruct(params), not with struct(params)")


def _scaled(t: Array, camera: Mapping[str, Any], where: str, asked: Asked) -> Array:
    """Return a length in metres where the file says its unit, else as it is. Raises UsageError where both say one."""
    said = str(camera.get("WorldUnits", "")).strip()
    unit_m = UNITS.get(said.lower())
    if unit_m is None:
        return t
    if asked.unit_m is not None:
        raise UsageError(
            f"{where}: WorldUnits says {said!r}",
            consequence="Another unit would put the cameras elsewhere",
            cure="Leave --unit out, or correct WorldUnits in MATLAB where it is wrong",
        )
    asked.told.append(f"{where}: lengths are in {said}, as WorldUnits says")
    return unit_m * t


def _camera(struct: Mapping[str, Any], where: str, asked: Asked) -> Camera:
    """Return the camera of a cameraParameters struct. Raises BadFile."""
    size = struct.get("ImageSize")
    if size is not None and np.size(size):
        rows, columns = _matrix(struct, "ImageSize", (1, 2), where).ravel().tolist()
        said = numbers.count_at({"columns": columns}, "columns", where), numbers.count_at({"rows": rows}, "rows", where)
        if asked.size not in (None, said):
            raise BadFile(f"{where}: ImageSize is {said[0]}x{said[1]}", cure="Leave --size out")
    elif asked.size is None:
        raise UsageError(
            f"{where}: no ImageSize, as before R2017",
            consequence="The camera is not known completely",
            cure="Give the size of the images, such as --size 1280x720",
        )
    else:
        said = asked.size
    key = "K" if "K" in struct else "IntrinsicMatrix"
    K = _matrix(struct, key, (3, 3), where)
    fx, fy, cx, cy, skew = numbers.intrinsics_of(K if key == "K" else K.T, key, where)
    radial = np.asarray(numbers.value_at(struct, "RadialDistortion", where)).tolist()
    radial = numbers.array_of(radial, "RadialDistortion", where).ravel()
    p1, p2 = _matrix(struct, "TangentialDistortion", (1, 2), where).ravel().tolist()
    if radial.size not in (2, 3):
        raise BadFile(f"{where}: {radial.size} radial coefficients", cure="Calibrate it with two or three")
    values = np.array([*radial[:2], p1, p2, *radial[2:]])
    return lens_of(values, (fx, fy, cx - FIRST_PX, cy - FIRST_PX, skew), said, where, asked, fisheye=False)


def _matrix(struct: Mapping[str, Any], key: str, shape: tuple[int, int], where: str) -> Array:
    return numbers.matrix_at({key: np.asarray(numbers.value_at(struct, key, where)).tolist()}, key, shape, where)
