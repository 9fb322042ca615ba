"""Numbers out of other programs' YAML, with the key where one is wrong; a rectified pair (OpenCV's stereoRectify)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from scipy.spatial.transform import RigidTransform

from armsight.arrays import Array
from armsight.errors import BadFile, Inconsistent
from armsight.geometry import pose_from_matrix
from armsight.geometry.poses import skew
from armsight.optics import LensKind, Rig
from armsight.records.checks import LARGEST_BASELINE_M
from armsight.store.codec import LARGEST

ROTATION_TOLERANCE = 1e-4
"""Largest entry of R R^T - 1: files with five decimals stay below it, wrong matrices do not."""

TOLD_PX = 0.01
"""Distance of the nearest lens from which on it is told: a hundredth of a pixel is what corners are good to."""
LEAST_BASELINE_M = 1e-3
"""Between two cameras: those of endoscopes stand 4 mm apart."""
WHOLE = 0.9
"""Share of the image that must have rays: of lenses made for it a corner may fold over."""


def value_at(content: Mapping[str, Any], key: str, where: str) -> Any:
    """Return content[key]; BadFile where it is missing."""
    if key not in content:
        keys = ", ".join(str(name) for name in content)[:200]
        raise BadFile(f"{where}: the key {key} is missing; found {keys}", cure="Add it")
    return content[key]


def array_of(value: Any, key: str, where: str) -> Array:
    """Return a list, nested lists, or a matrix written as rows, cols, data, as a finite array; else BadFile."""
    shape: tuple[int, ...] | None = None
    if isinstance(value, Mapping):
        if "sizes" not in value:  # of OpenCV 5, of arrays that are no matrix
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


def number_at(content: Mapping[str, Any], key: str, where: str) -> float:
    """Return the one number under a key. Raises BadFile."""
    value = array_of(value_at(content, key, where), key, where)
    if value.size != 1:
        raise _bad(key, where, f"is {value.size} numbers, not one")
    return float(value.ravel()[0])


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


def fitted_coefficients(rays: Array, uv: Array, K: Array) -> tuple[Array, float, float]:
    """Return k1, k2, p1, p2, k3 (5,) that bring rays (n, 2) nearest to pixels uv (n, 2) with a camera matrix K (3, 3),
    and the distance left in px, RMS and largest.

    The distorted place is linear in them: least squares.
    """
    x, y = rays.T
    r2 = x**2 + y**2
    columns = [
        np.stack([x * r2, y * r2]),
        np.stack([x * r2**2, y * r2**2]),
        np.stack([2.0 * x * y, r2 + 2.0 * y**2]),
        np.stack([r2 + 2.0 * x**2, 2.0 * x * y]),
        np.stack([x * r2**3, y * r2**3]),
    ]
    A = np.stack(columns, axis=-1)  # (2, n, 5) of the place in the image plane
    in_px = np.einsum("ij,jnk->ink", K[:2, :2], A).reshape(-1, 5)
    bent = (uv.T - K[:2, :2] @ rays.T - K[:2, 2:]).ravel()
    k = np.linalg.lstsq(in_px, bent, rcond=None)[0]
    apart = np.linalg.norm((in_px @ k - bent).reshape(2, -1), axis=0)
    return k, float(np.sqrt((apart**2).mean())), float(apart.max())


def fisheye_coefficients(values: Array, key: str, where: str) -> Array:
    """Return k1, k2, k3, k4 of OpenCV's fisheye or Kalibr's equidistant model; BadFile for another number of them."""
    flat = values.ravel()
    if flat.size != 4:
        raise BadFile(
            f"{where}: {key} holds {flat.size} coefficients, and a fisheye lens has four (k1, k2, k3, k4)",
            cure="Say the model that they are of: five are those of a pinhole (plumb_bob, radtan)",
        )
    return flat


def rotation_of(matrix: Array, key: str, where: str) -> Array:
    """Return the proper rotation nearest to a matrix (3, 3); BadFile where it is none within rounding."""
    if np.abs(matrix @ matrix.T - np.eye(3)).max() > ROTATION_TOLERANCE or np.linalg.det(matrix) < 0.0:
        raise _bad(key, where, "is not a rotation matrix")
    U, _, Vt = np.linalg.svd(matrix)
    return np.asarray(U @ Vt)


def placed(R: Array, t: Array, where: str, unit_m: float | None = None) -> RigidTransform:
    """Return T_left_right from R, t of p_right = R p_left + t; BadFile where t cannot be metres between cameras.

    unit_m: length of t's unit in metres; None where nobody has said it, so that it must look like metres.
    """
    apart = float(np.linalg.norm(t))
    apart_m = apart * (1.0 if unit_m is None else unit_m)
    if 0.0 < apart_m < LEAST_BASELINE_M:
        raise BadFile(
            f"{where}: the cameras would stand {1e6 * apart_m:.3g} um apart",
            consequence="No two cameras fit so near to each other: the length has another unit",
            cure="Look for the unit there: ZED's files are in mm, DepthAI's in cm; correct it, or --unit",
        )
    if not apart > 0.0 or (unit_m is None and apart > LARGEST_BASELINE_M):
        raise BadFile(
            f"{where}: the cameras would stand {apart:g} m apart",
            cure="Say the file's unit: --unit 0.001 for millimetres, 0.01 for centimetres, a square's side in metres "
            "where the board was given in squares, --unit 1 where they do stand so far apart"
            if apart > 0.0
            else "Give the file of a calibrated stereo pair, not of single cameras",
        )
    return pose_from_matrix(R, t * (1.0 if unit_m is None else unit_m)).inv()


def relative(T_rig_left: RigidTransform, T_rig_right: RigidTransform) -> tuple[Array, Array]:
    """Return R (3, 3), t (3,) of p_right = R p_left + t."""
    T_right_left = T_rig_right.inv() * T_rig_left
    return np.asarray(T_right_left.rotation.as_matrix(), float), np.asarray(T_right_left.translation, float)


def rows_of(matrix: Array) -> Sequence[float]:
    """Return a matrix as the flat list, row by row, that these files hold."""
    return [float(value) for value in matrix.ravel()]


def _bad(key: str, where: str, what: str) -> BadFile:
    return BadFile(f"{where}: {key} {what}", cure="Correct it there")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Rectification:
    """R1, R2 (3, 3): into the rectified cameras' axes; P1, P2 (3, 4): their projections; Q (4, 4): pixels and disparity
    to points in the left rectified camera's axes, m; E, F (3, 3): essential and fundamental matrix, of points without
    distortion: x_right^T F x_left = 0."""

    R1: Array
    R2: Array
    P1: Array
    P2: Array
    Q: Array
    E: Array
    F: Array


def rectification(rig: Rig) -> Rectification:
    """Return a rig's rectification, no disparity at infinity, alpha 0. Raises Inconsistent for two image sizes."""
    if (rig.left.width, rig.left.height) != (rig.right.width, rig.right.height):
        raise Inconsistent("the cameras' images differ in size", consequence="One rectified pair cannot say this")
    R, t = relative(rig.T_rig_left, rig.T_rig_right)
    lenses = {rig.left.lens, rig.right.lens}
    if len(lenses) > 1 and LensKind.FISHEYE in lenses:
        raise Inconsistent("one camera is a pinhole and one a fisheye", consequence="OpenCV cannot rectify the pair")
    size = (rig.left.width, rig.left.height)
    cameras = (rig.left.matrix, rig.left.distortion, rig.right.matrix, rig.right.distortion)
    if lenses == {LensKind.FISHEYE}:
        R1, R2, P1, P2, Q = cv2.fisheye.stereoRectify(*cameras, size, R, t, flags=cv2.CALIB_ZERO_DISPARITY)
    else:
        R1, R2, P1, P2, Q, *_ = cv2.stereoRectify(*cameras, size, R, t, flags=cv2.CALIB_ZERO_DISPARITY, alpha=0.0)
    E = skew(t) @ R
    F = np.linalg.inv(rig.right.matrix).T @ E @ np.linalg.inv(rig.left.matrix)
    scale = F[2, 2] if abs(F[2, 2]) > np.finfo(float).eps * np.abs(F).max() else np.linalg.norm(F)
    parts = {"R1": R1, "R2": R2, "P1": P1, "P2": P2, "Q": Q, "E": E, "F": F / scale}
    return Rectification(**{name: np.asarray(part, np.float64) for name, part in parts.items()})
