"""What callers hand over, checked once and turned into what the rest of the package takes."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from os import PathLike, fspath
from pathlib import Path
from types import NoneType
from typing import Any

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import RigidTransform, Rotation

from armsight._files import read_file
from armsight.arrays import Array, Image
from armsight.drivers.images import LARGEST_BYTES, LEAST_BITS, image_of_8_bits, too_large
from armsight.errors import ArmsightError, BadImage, Inconsistent, UsageError
from armsight.ops.commands import in_python
from armsight.records import Frame, checked_array, real_array, require_count, require_kind, require_rigid

ImageLike = ArrayLike | str | PathLike[str] | Frame
Poses = RigidTransform | ArrayLike | Sequence[RigidTransform]


def as_image(image: ImageLike, name: str = "the image", bits: int | None = None) -> Image:
    """Return an image as contiguous uint8 (h, w) grey or (h, w, 3) BGR; a path is read, of a Frame its image taken.

    Colours are in OpenCV's order, blue first, as cv2.imread gives them. bits: of the light in uint16 arrays and 16-bit
    files alike, scaled so that full scale is 255. Raises BadImage for any other type or shape, and for 16 bits of which
    nothing says how many carry the light.
    """
    if bits is not None:
        require_count("bits", bits, least=LEAST_BITS)
    if isinstance(image, str | PathLike):
        return read_image(fspath(image), bits)
    array = _plain(image.image if isinstance(image, Frame) else image, name)
    if array.ndim == 3 and array.shape[2] == 1:
        array = array[:, :, 0]
    if array.dtype == np.uint16 and array.size:
        array = _of_8_bits(array, bits, name)
    if array.dtype != np.uint8 or array.ndim not in (2, 3) or (array.ndim == 3 and array.shape[2] != 3):
        raise BadImage(
            f"{name} is of type {array.dtype} and shape {array.shape}",
            consequence="It cannot be searched",
            cure="Give 8-bit grey (h, w) or 8-bit BGR (h, w, 3), as cv2.imread does",
        )
    if not array.size:
        raise BadImage(f"{name} is empty: its shape is {array.shape}", cure="Check that the camera gave a frame")
    return np.ascontiguousarray(array)


def _plain(image: object, name: str) -> NDArray[Any]:
    try:
        array = np.asarray(image)
    except (TypeError, ValueError) as error:
        raise BadImage(f"{name} is no array ({error})", cure="Give 8-bit grey (h, w) or BGR (h, w, 3)") from error
    if isinstance(image, np.ma.MaskedArray) and np.ma.getmaskarray(image).any():
        raise BadImage(
            f"{name} is masked in places",
            consequence="What is below the mask would be measured",
            cure="Give the plain image, and the mask as SpotSettings(mask=...), True where spots may be",
        )
    return array


def read_image(path: str, bits: int | None = None) -> Image:
    """Return an image file's content, grey or BGR as stored. Raises BadImage where it cannot be read; see as_image."""
    try:
        data = read_file(Path(path), limit=LARGEST_BYTES)
    except OSError as error:
        raise BadImage(f"{path} cannot be read ({error.strerror})", cure="Check the path") from error
    flags = cv2.IMREAD_ANYCOLOR | cv2.IMREAD_ANYDEPTH
    image = None if too_large(data) else cv2.imdecode(np.frombuffer(data, np.uint8), flags)
    if image is None:
        raise BadImage(f"{path} is no image", cure="Give PNG, JPEG, BMP or TIFF")
    return _of_8_bits(image, bits, path)


def _of_8_bits(image: NDArray[Any], bits: int | None, name: str) -> Image:
    try:
        return image_of_8_bits(image, bits if image.dtype == np.uint16 else None, name)
    except ArmsightError as error:
        in_python(error)
        raise


def as_frame(image: ImageLike, *, name: str, t_s: float = 0.0, sequence: int = 0, bits: int | None = None) -> Frame:
    """Return an image as a Frame; a copy where the caller's array could be written to, for frames are read-only."""
    array = as_image(image, name, bits)
    if isinstance(image, np.ndarray) and np.shares_memory(array, image) and image.flags.writeable:
        array = array.copy()
    return Frame(image=array, t_s=t_s, sequence=sequence, source=name)


def as_images(images: Iterable[ImageLike], name: str, bits: int | None = None) -> list[Frame]:
    """Return many images as frames: arrays, or paths, whose names the frames have."""
    if not isinstance(images, Iterable) or (isinstance(images, np.ndarray) and images.ndim < 3):
        raise UsageError(
            f"{name}s are one {type(images).__name__}",
            consequence="There are no images to look at",
            cure="Give a list of images, or a folder",
        )
    many: Iterable[Any] = images
    return [
        as_frame(
            image, name=Path(fspath(image)).name if isinstance(image, str | PathLike) else f"{name} {n}", bits=bits
        )
        for n, image in enumerate(many)
    ]


def as_poses(poses: Poses, name: str) -> RigidTransform:
    """Return n poses as one stack. poses: (4, 4), (n, 4, 4), a RigidTransform of one or many, or a list of any.

    Raises Inconsistent, naming the row (from 0), for what is not finite or no rigid transform.
    """
    return RigidTransform.from_matrix(as_matrices(poses, name))


def as_matrices(poses: Poses, name: str) -> Array:
    """Return n poses as (n, 4, 4), the rotations made orthonormal to the last digit; raises as as_poses."""
    T = _stacked(poses, name)
    if T.ndim == 2:
        T = T[None]
    if T.ndim != 3 or T.shape[1:] != (4, 4):
        raise Inconsistent(
            f"{name} has the shape {T.shape}",
            consequence="It is read as no pose",
            cure="Give 4x4 matrices (n, 4, 4), or a scipy RigidTransform",
        )
    if not len(T):
        raise Inconsistent(f"{name} is empty", consequence="There is nothing to work on", cure="Give at least one pose")
    require_rigid(name, T)
    return np.ascontiguousarray(RigidTransform.from_matrix(T).as_matrix())


def as_rotations(rotations: Rotation | ArrayLike, name: str, rows: int) -> Array:
    """Return (rows, 3, 3), checked as poses are; a scipy Rotation is taken as well."""
    R = checked_array(name, rotations.as_matrix() if isinstance(rotations, Rotation) else rotations, (rows, 3, 3))
    T = np.tile(np.eye(4), (rows, 1, 1))
    T[:, :3, :3] = R
    require_rigid(name, T)
    return R


def as_path(path: str | PathLike[str], name: str = "path") -> Path:
    """Return a file's path; raises UsageError for what is none."""
    require_kind(name, path, str, PathLike, cure="Give a file's path as text or pathlib.Path")
    return Path(path)


def as_size(size: tuple[int, int] | None) -> tuple[int, int] | None:
    """Return width and height as whole numbers, None where not given. Raises UsageError."""
    require_kind("size", size, tuple, list, NoneType, cure="Give (width, height)")
    if size is None:
        return None
    width, height = checked_array("size", size, (2,)).tolist()
    if min(width, height) < 1.0 or width % 1.0 or height % 1.0:
        raise UsageError(
            f"size is {size}, no image's", consequence="It cannot be used", cure="Give (width, height) in px"
        )
    return int(width), int(height)


def as_joint_numbers(joint: ArrayLike, rows: int) -> NDArray[np.intp]:
    """Return which joint moves in each row, counted from 1, as (rows,); raises Inconsistent for anything else."""
    try:
        numbers = np.asarray(joint)
    except ValueError:  # rows of different lengths
        numbers = np.empty(0, object)
    if numbers.shape != (rows,) or not np.issubdtype(numbers.dtype, np.integer):
        raise Inconsistent(
            f"joint has the shape {numbers.shape} and the type {numbers.dtype}",
            consequence="Nobody knows which joint moves in which row",
            cure=f"Give {rows} whole numbers, one per row, counted from 1",
        )
    return numbers.astype(np.intp)


def _stacked(poses: Any, name: str) -> Array:
    if isinstance(poses, Rotation):
        raise Inconsistent(
            f"{name} is a Rotation, which says no place",
            consequence="It is read as no pose",
            cure="Give RigidTransform.from_components(translation, rotation)",
        )
    if isinstance(poses, RigidTransform):
        return np.asarray(poses.as_matrix(), float)
    if isinstance(poses, list | tuple) and any(isinstance(pose, RigidTransform) for pose in poses):
        poses = [pose.as_matrix() if isinstance(pose, RigidTransform) else pose for pose in poses]
    return real_array(name, poses)
