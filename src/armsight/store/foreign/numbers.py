"""Numbers out of other programs' YAML, each with the key's name where it is wrong."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from armsight.errors import BadFile
from armsight.geometry import pose_from_matrix
from armsight.store.codec import LARGEST

Array = NDArray[np.float64]

ROTATION_TOLERANCE = 1e-4
"""Largest entry of R R^T - 1: files with five decimals stay below it, wrong matrices do not."""

LARGEST_BASELINE_M = 10.0
"""A pair further apart than this is one whose file is in millimetres."""


def value_at(content: Mapping[str, Any], key: str, where: str) -> Any:
    """Return content[key]; BadFile where it is missing."""
    if key not in content:
        keys = ", ".join(str(name) for name in content)[:200]
        raise BadFile(
            f"{where}: the key {key} is missing; found {keys}", consequence="The file is not used", cure="Add it"
        )
    return content[key]


def array_of(value: Any, key: str, where: str) -> Array:
    """Return a list, nested lists, or a matrix written as rows, cols, data, as a finite array; else BadFile."""
    shape: tuple[int, ...] | None = None
    if isinstance(value, Mapping):
        shape = (_size(value, "rows", key, where), _size(value, "cols", key, where))
        value = value_at(value, "data", f"{where}, {key}")
    try:
        array = np.array(value, dtype=object)
        if not all(isinstance(item, int | float) and not isinstance(item, bool) for item in array.ravel()):
            raise ValueError("not numbers")
        numbers = array.astype(np.float64)
    except (ValueError, TypeError, OverflowError) as error:
        raise _bad(key, where, "is not a list of numbers") from error
    if shape is not None:
        if numbers.size != shape[0] * shape[1]:
            raise _bad(key, where, f"holds {numbers.size} numbers, not {shape[0]} x {shape[1]}")
        numbers = numbers.reshape(shape)
    if not (np.abs(numbers) <= LARGEST).all():
        raise _bad(key, where, f"holds a number that is not finite, or beyond {LARGEST:g}")
    return numbers


def _size(value: Mapping[str, Any], name: str, key: str, where: str) -> int:
    size = value.get(name)
    if isinstance(size, bool) or not isinstance(size, int) or not 0 <= size <= 1_000_000:
        raise _bad(key, where, f"has no whole number {name}")
    return size


def matrix_at(content: Mapping[str, Any], key: str, shape: tuple[int, int], where: str) -> Array:
    """Return the matrix of the given shape under a key; a flat list of the right length is taken row by row."""
    matrix = array_of(value_at(content, key, where), key, where)
    if matrix.size != shape[0] * shape[1] or (matrix.ndim == 2 and 1 not in matrix.shape and matrix.shape != shape):
        raise _bad(key, where, f"has the shape {matrix.shape}, not {shape}")
    return matrix.reshape(shape)


def count_at(content: Mapping[str, Any], key: str, where: str) -> int:
    """Return the number of pixels under a key; BadFile where it is no whole number of at least one."""
    value = value_at(content, key, where)
    if isinstance(value, float) and value.is_integer():
        value = int(value)
    if isinstance(value, bool) or not isinstance(value, int) or not 1 <= value <= 1_000_000:
        raise _bad(key, where, "is not a whole number of pixels")
    return value


def intrinsics_of(matrix: Array, key: str, where: str) -> tuple[float, float, float, float, float]:
    """Return fx, fy, cx, cy, skew of a camera matrix (3, 3); BadFile where it has another form."""
    if abs(matrix[1, 0]) + abs(matrix[2, 0]) + abs(matrix[2, 1]) > 0.0 or matrix[2, 2] != 1.0:
        raise _bad(key, where, "is not a camera matrix [fx s cx; 0 fy cy; 0 0 1]")
    fx, skew, cx = matrix[0].tolist()
    return fx, float(matrix[1, 1]), cx, float(matrix[1, 2]), skew


def brown_conrady(values: Array, key: str, where: str) -> Array:
    """Return k1, k2, p1, p2, k3 of an OpenCV vector; BadFile where it needs terms that we do not have."""
    flat = values.ravel()
    if flat.size not in (0, 4, 5, 8, 12, 14):
        raise _bad(key, where, f"holds {flat.size} coefficients; OpenCV's models have 4, 5, 8, 12 or 14")
    if np.any(flat[5:] != 0.0):
        raise BadFile(
            f"{where}: {key} uses the rational, thin-prism or tilted model ({flat.size} coefficients)",
            consequence="It cannot be turned into k1, k2, p1, p2, k3 without loss",
            cure="Calibrate with the five-parameter model (plumb_bob)",
        )
    return np.concatenate([flat[:5], np.zeros(max(0, 5 - flat.size))])


def fisheye_coefficients(values: Array, key: str, where: str) -> Array:
    """Return k1, k2, k3, k4 of OpenCV's fisheye or Kalibr's equidistant model; BadFile for another number of them."""
    flat = values.ravel()
    if flat.size != 4:
        raise BadFile(
            f"{where}: {key} holds {flat.size} coefficients, and a fisheye lens has four (k1, k2, k3, k4)",
            consequence="The file is not used",
            cure="Say the model that they are of: five are those of a pinhole (plumb_bob, radtan)",
        )
    return flat


def rotation_of(matrix: Array, key: str, where: str) -> Array:
    """Return the proper rotation nearest to a matrix (3, 3); BadFile where it is none within rounding."""
    if np.abs(matrix @ matrix.T - np.eye(3)).max() > ROTATION_TOLERANCE or np.linalg.det(matrix) < 0.0:
        raise _bad(key, where, "is not a rotation matrix")
    U, _, Vt = np.linalg.svd(matrix)
    return np.asarray(U @ Vt)


def placed(R: Array, t_m: Array, where: str) -> RigidTransform:
    """Return T_left_right from R, t of p_right = R p_left + t; BadFile where t cannot be metres between cameras."""
    baseline_m = float(np.linalg.norm(t_m))
    if not 0.0 < baseline_m <= LARGEST_BASELINE_M:
        raise BadFile(
            f"{where}: the cameras would stand {baseline_m:g} m apart",
            consequence="The rig is not used",
            cure="Lengths are read as metres; for a file in millimetres say unit 0.001"
            if baseline_m > 0.0
            else "Give the file of a calibrated stereo pair, not of single cameras",
        )
    return pose_from_matrix(R, t_m).inv()


def relative(T_rig_left: RigidTransform, T_rig_right: RigidTransform) -> tuple[Array, Array]:
    """Return R (3, 3), t (3,) of p_right = R p_left + t."""
    T_right_left = T_rig_right.inv() * T_rig_left
    return np.asarray(T_right_left.rotation.as_matrix(), float), np.asarray(T_right_left.translation, float)


def rows_of(matrix: Array) -> Sequence[float]:
    """Return a matrix as the flat list, row by row, that these files hold."""
    return [float(value) for value in matrix.ravel()]


def _bad(key: str, where: str, what: str) -> BadFile:
    return BadFile(f"{where}: {key} {what}", consequence="The file is not used", cure="Correct it there")
