"""ROS camera_info YAML, as camera_calibration_parsers and camera_calibration write it.

One file per camera: image_width, image_height, camera_matrix K, distortion_model plumb_bob with k1, k2, p1, p2, k3,
rational_polynomial with k4, k5, k6 behind them (image_geometry, OpenCV's order), or equidistant with k1, k2, k3, k4,
rectification_matrix R, projection_matrix P; metres and pixels. Of a stereo pair R turns each camera's axes into the
rectified axes, in which p_right = p_left + (P[0, 3] / P[0, 0], P[1, 3] / P[1, 1], 0): P of the right camera carries
the baseline. So p_right_camera = R_right^T (R_left p_left_camera + that shift).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import RigidTransform

from armsight.arrays import Array
from armsight.errors import BadFile, Inconsistent
from armsight.optics import Camera, LensKind, Rig, RigKind
from armsight.store.atomic import write_text
from armsight.store.codec import named
from armsight.store.foreign import numbers
from armsight.store.foreign.opencv_lens import opencv_lens
from armsight.store.foreign.storage import read_storage
from armsight.store.foreign.written import Transform, write_tf_launch
from armsight.store.yamls import dump_yaml

ROS_MODEL = {
    LensKind.PINHOLE: "plumb_bob",
    LensKind.FISHEYE: "equidistant",
    LensKind.RATIONAL: "rational_polynomial",
}
"""sensor_msgs/distortion_models."""


def camera_from_ros(path: Path, *, told: list[str] | None = None, approximate: bool = False) -> Camera:
    """Return the camera of a camera_info YAML; BadFile where it is none or has another lens model."""
    return ros_camera(read_storage(path), str(path), told, approximate=approximate)


def ros_camera(
    content: Mapping[str, Any], where: str, told: list[str] | None = None, *, approximate: bool = False
) -> Camera:
    """Return the camera that camera_info content describes; told: takes what is to be said. See camera_from_ros."""
    model = content.get("distortion_model", "plumb_bob")
    if model not in ("plumb_bob", "rational_polynomial", "equidistant"):
        raise BadFile(
            f"{where}: distortion_model is {str(model)[:40]!r}",
            consequence="Only plumb_bob, rational_polynomial and equidistant (k1, k2, k3, k4) can be used",
            cure="Calibrate with plumb_bob, a fisheye lens with equidistant",
        )
    key = "distortion_coefficients"
    intrinsics = numbers.intrinsics_of(
        numbers.matrix_at(content, "camera_matrix", (3, 3), where), "camera_matrix", where
    )
    size = numbers.count_at(content, "image_width", where), numbers.count_at(content, "image_height", where)
    values, fisheye = numbers.array_of(numbers.value_at(content, key, where), key, where), model == "equidistant"
    if not fisheye:
        return opencv_lens(values, intrinsics, size, where, told, approximate=approximate)
    distortion = numbers.fisheye_coefficients(values, key, where)
    with named(where):
        return Camera.fisheye(*size, *intrinsics[:4], skew=intrinsics[4], distortion=distortion)


def rig_from_ros(
    left: Path,
    right: Path,
    *,
    unit_m: float | None = None,
    told: list[str] | None = None,
    approximate: bool = False,
) -> Rig:
    """Return the rig of a pair of camera_info files, its axes those of the left camera.

    unit_m: the length of the baseline's unit in metres. told: takes what is to be said. Raises BadFile where a file is
    none, Inconsistent where they are no stereo pair or are swapped.
    """
    contents = read_storage(left), read_storage(right)
    return ros_rig(*contents, str(left), str(right), unit_m=unit_m, told=told, approximate=approximate)


def ros_rig(
    left: Mapping[str, Any],
    right: Mapping[str, Any],
    where_left: str,
    where_right: str,
    *,
    unit_m: float | None = None,
    told: list[str] | None = None,
    approximate: bool = False,
) -> Rig:
    """Return the rig of the content of two camera_info files; see rig_from_ros."""
    both = ((left, where_left), (right, where_right))
    cameras = [ros_camera(*one, told, approximate=approximate) for one in both]
    shifts, turns = [], []
    for content, where in both:
        P = numbers.matrix_at(content, "projection_matrix", (3, 4), where)
        if not (P[0, 0] > 0.0 and P[1, 1] > 0.0):
            raise BadFile(f"{where}: projection_matrix has no focal length")
        shifts.append(np.array([P[0, 3] / P[0, 0], P[1, 3] / P[1, 1], 0.0]))
        turns.append(
            numbers.rotation_of(
                numbers.matrix_at(content, "rectification_matrix", (3, 3), where), "rectification_matrix", where
            )
        )
    _check_order(shifts[0], shifts[1], where_left, where_right)
    R = turns[1].T @ turns[0]  # (3, 3) p_right = R p_left + t
    t = turns[1].T @ (shifts[1] - shifts[0])  # (3,)
    return Rig(
        kind=RigKind.STEREO,
        left=cameras[0],
        right=cameras[1],
        T_rig_left=RigidTransform.identity(),
        T_rig_right=numbers.placed(R, t, where_right, unit_m),
    )


def _check_order(left: Array, right: Array, where_left: str, where_right: str) -> None:
    if not left.any() and not right.any():
        raise Inconsistent(
            f"{where_left} and {where_right}: neither projection_matrix carries a baseline",
            consequence="The cameras' places are not known: these are two single calibrations",
            cure="Give the two files of a stereo calibration",
        )
    if left.any() and not right.any():
        raise Inconsistent(
            f"{where_left} and {where_right}: the baseline stands in the first file, where the left camera belongs",
            consequence="Left and right are swapped",
            cure="Give the files in the other order",
        )


def ros_mapping(camera: Camera, name: str, R: Array | None = None, P: Array | None = None) -> dict[str, Any]:
    """Return a camera as camera_info content; R (3, 3) and P (3, 4) default to those of a single camera."""
    P = np.hstack([camera.matrix, np.zeros((3, 1))]) if P is None else P
    return {
        "image_width": camera.width,
        "image_height": camera.height,
        "camera_name": name,
        "camera_matrix": _matrix(camera.matrix),
        "distortion_model": ROS_MODEL[camera.lens],
        "distortion_coefficients": _matrix(camera.distortion.reshape(1, -1)),
        "rectification_matrix": _matrix(np.eye(3) if R is None else R),
        "projection_matrix": _matrix(P),
    }


def camera_to_ros(path: Path, camera: Camera, *, name: str = "camera") -> None:
    """Write a camera_info YAML of a single camera."""
    write_text(path, dump_yaml(ros_mapping(camera, name)))


def rig_to_ros(left: Path, right: Path, rig: Rig, *, names: tuple[str, str] = ("left", "right")) -> None:
    """Write the pair of camera_info files of a rig; R and P by OpenCV's stereoRectify, as ROS's own tool does.

    Raises Inconsistent where the two images differ in size (one P serves both) or a camera has skew, which
    rectification by image_geometry leaves out.
    """
    if any(camera.intrinsics[4] != 0.0 for camera in (rig.left, rig.right)):
        raise Inconsistent(
            "a camera of the rig has skew", consequence="ROS's rectification leaves it out", cure="Fix skew at zero"
        )
    found = numbers.rectification(rig)
    for path, camera, name, R_rectify, P in (
        (left, rig.left, names[0], found.R1, found.P1),
        (right, rig.right, names[1], found.R2, found.P2),
    ):
        write_text(path, dump_yaml(ros_mapping(camera, name, R_rectify, P)))


def rig_and_frames_to_ros(paths: Sequence[Path], rig: Rig) -> None:
    """Write the two camera_info files of a pair, and the transforms to both cameras where a third file is named."""
    rig_to_ros(paths[0], paths[1], rig)
    if len(paths) > 2:
        sides = (("left", rig.T_rig_left), ("right", rig.T_rig_right))
        write_tf_launch(paths[2], [Transform(parent="rig", child=name, T_parent_child=T) for name, T in sides])


def _matrix(matrix: Array) -> dict[str, Any]:
    return {"rows": matrix.shape[0], "cols": matrix.shape[1], "data": numbers.rows_of(matrix)}
