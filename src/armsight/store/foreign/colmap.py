"""COLMAP's cameras.txt and, from version 3.12 on, rigs.txt, as text (its documentation, "Output Format").

A line of cameras.txt is CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS; COLMAP counts pixels from the image's corner: the
centre of its first pixel is (0.5, 0.5). A line of rigs.txt is RIG_ID, NUM_SENSORS, the reference sensor's type and id,
then of each other one SENSOR_TYPE, SENSOR_ID, HAS_POSE and, where it has one, QW, QX, QY, QZ, TX, TY, TZ of p_sensor =
R p_rig + t; the reference sensor's axes are the rig's. The unit is what the reconstruction happened to have.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from armsight.errors import BadFile, Inconsistent, UsageError
from armsight.geometry import xyz_quat
from armsight.optics import Camera, LensKind, Rig
from armsight.store.atomic import write_text
from armsight.store.foreign import numbers
from armsight.store.foreign.photogrammetry import CORNER_PX
from armsight.store.foreign.several import Asked, Placed, Pose, lens_of, rig_of
from armsight.store.foreign.storage import COLMAP_CAMERAS, COLMAP_RIGS, read_storage
from armsight.store.tables import number, plain_float

PARAMETERS = {
    "SIMPLE_PINHOLE": "f cx cy",
    "PINHOLE": "fx fy cx cy",
    "SIMPLE_RADIAL": "f cx cy k1",
    "RADIAL": "f cx cy k1 k2",
    "OPENCV": "fx fy cx cy k1 k2 p1 p2",
    "FULL_OPENCV": "fx fy cx cy k1 k2 p1 p2 k3 k4 k5 k6",
    "OPENCV_FISHEYE": "fx fy cx cy k1 k2 k3 k4",
    "SIMPLE_RADIAL_FISHEYE": "f cx cy k1",
    "RADIAL_FISHEYE": "f cx cy k1 k2",
}
"""What a model's numbers are; of a fisheye the series in the angle (its src/colmap/sensor/models.h)."""
PINHOLE = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
FISHEYE = ("k1", "k2", "k3", "k4")


def read_cameras(path: Path, asked: Asked) -> list[Placed]:
    """Return the cameras of cameras.txt by their numbers, without poses. Raises BadFile."""
    content = read_storage(path)
    if COLMAP_CAMERAS not in content:
        raise BadFile(f"{path} is a rigs.txt", cure="Give cameras.txt, of a rig both: cameras.txt rigs.txt")
    lines = [line or [""] for line in content[COLMAP_CAMERAS]]
    return [Placed(name=line[0], lens=partial(_camera, line, str(path), asked)) for line in lines]


def rig_from_colmap(paths: Sequence[Path], asked: Asked) -> Rig:
    """Return the one rig of cameras.txt and rigs.txt. Raises BadFile; UsageError where the unit is not said."""
    found = [read_storage(path) for path in paths]
    rigs = next((one[COLMAP_RIGS] for one in found if COLMAP_RIGS in one), None)
    where = " and ".join(str(path) for path in paths)
    if rigs is None or len(rigs) != 1 or len(paths) != 2:
        raise BadFile(
            f"{where}: {'no rigs.txt' if rigs is None else f'{len(rigs)} rigs'}",
            consequence="How the cameras stand to each other is not known",
            cure="Give cameras.txt and a rigs.txt that holds one rig",
        )
    if asked.unit_m is None:
        raise UsageError(
            f"{where}: COLMAP's unit of length is the reconstruction's own",
            consequence="How far the cameras stand apart is not known",
            cure="Give the length of its unit in metres: --unit 1 where it was scaled to metres",
        )
    poses = _poses(rigs[0], where)
    cameras = [
        one
        for path, content in zip(paths, found, strict=True)
        if COLMAP_CAMERAS in content
        for one in read_cameras(path, asked)
    ]
    placed = [replace(one, pose=poses[one.name]) for one in cameras if one.name in poses]
    return rig_of(placed, where, asked)


def _poses(line: Sequence[str], where: str) -> dict[str, Pose | None]:
    """Return the poses of a rig's cameras by their numbers, None of one without."""
    poses: dict[str, Pose | None] = {}
    words = list(line[2:])
    try:
        while words:
            kind, name, *words = words
            first = not poses
            has = first or words.pop(0) == "1"
            pose = (np.eye(3), np.zeros(3)) if first else None
            if has and not first:
                pose_numbers, words = [plain_float(x) for x in words[:7]], words[7:]
                q, t = pose_numbers[:4], np.array(pose_numbers[4:])
                if len(t) != 3 or not (0.9 < np.linalg.norm(q) < 1.1 and np.isfinite(t).all()):
                    raise ValueError(f"the pose of sensor {name}")
                pose = (Rotation.from_quat([*q[1:], q[0]]).as_matrix(), t)
            if kind == "CAMERA":
                poses[name] = pose
    except (ValueError, IndexError) as error:
        raise BadFile(
            f"{where}: a line of rigs.txt that is none ({error})", cure="Write it anew with COLMAP"
        ) from error
    return poses


def _camera(line: Sequence[str], where: str, asked: Asked) -> Camera:
    """Return the camera of a line of cameras.txt."""
    name, model, *words = line if len(line) > 4 else ["", ""]
    names = PARAMETERS.get(model, "").split()
    if not names or len(words) != 2 + len(names):
        known = ", ".join(PARAMETERS)
        raise BadFile(
            f"{where}: camera {name or '?'} is of the model {model[:40]!r} with {max(0, len(words) - 2)} numbers",
            consequence="It cannot be used",
            cure=f"Refine the cameras as OPENCV, a fisheye as OPENCV_FISHEYE; known are {known}",
        )
    here = f"{where}, camera {name}"
    values = dict(zip(("width", "height", *names), (_number(word, here) for word in words), strict=True))
    size = numbers.count_at(values, "width", here), numbers.count_at(values, "height", here)
    f = values.get("f", 0.0)
    at = (values["cx"] - CORNER_PX, values["cy"] - CORNER_PX)
    fisheye = "FISHEYE" in model
    lens = np.array([values.get(key, 0.0) for key in (FISHEYE if fisheye else PINHOLE)])
    intrinsics = (values.get("fx", f), values.get("fy", f), *at, 0.0)
    return lens_of(lens, intrinsics, size, here, asked, fisheye=fisheye)


def _number(word: str, where: str) -> float:
    try:
        return float(numbers.array_of(plain_float(word), "a number", where))
    except ValueError as error:
        raise BadFile(f"{where}: {word[:40]!r} is no number", cure="Correct it there") from error


def rig_to_colmap(paths: Sequence[Path], rig: Rig) -> None:
    """Write cameras.txt, and rigs.txt where a second file is named, in metres. Raises Inconsistent."""
    cameras_to_colmap(paths[0], [one.camera for one in rig.cameras])
    if len(paths) == 1:
        return
    lines = [
        "# Rig calib list with one line of data per calib:",
        f"# Number of rigs: 1; in metres; {', '.join(rig.names)}",
    ]
    words = ["1", str(len(rig.cameras)), "CAMERA", "1"]
    T_rig_first = rig.cameras[0].T_rig_camera
    for k, one in enumerate(rig.cameras[1:], 2):
        xyz, quat = xyz_quat(one.T_rig_camera.inv() * T_rig_first)
        words += ["CAMERA", str(k), "1", *(number(x) for x in (quat[3], *quat[:3], *xyz))]
    write_text(paths[1], "\n".join([*lines, " ".join(words)]) + "\n")


def cameras_to_colmap(path: Path, cameras: Sequence[Camera]) -> None:
    """Write cameras.txt, numbered from 1; Inconsistent where a camera has skew or looks through a plate."""
    lines = ["# Camera list with one line of data per camera:", "#   CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]"]
    lines.append(f"# Number of cameras: {len(cameras)}")
    for k, camera in enumerate(cameras, 1):
        fx, fy, cx, cy, skew = camera.intrinsics[:5].tolist()
        if skew != 0.0 or camera.plate is not None:
            raise Inconsistent(
                f"camera {k} has skew or looks through a plate",
                consequence="COLMAP's models cannot say this",
                cure="Calibrate with skew fixed at zero",
            )
        first, further = camera.distortion[:4].tolist(), camera.distortion[4:].tolist()
        params = [fx, fy, cx + CORNER_PX, cy + CORNER_PX, *first]
        if camera.lens is LensKind.FISHEYE:
            model = "OPENCV_FISHEYE"
        else:
            model = "FULL_OPENCV" if any(further) else "OPENCV"
            params += [*further, 0.0, 0.0, 0.0][:4] if any(further) else []
        values = " ".join(number(value) for value in params)
        lines.append(f"{k} {model} {camera.width} {camera.height} {values}")
    write_text(path, "\n".join(lines) + "\n")
