"""Factory calibrations of ready-made stereo cameras: Stereolabs' SN*.conf, Luxonis' DepthAI JSON.

ZED (stereolabs/zed-open-capture, examples/include/calibration.hpp; what Stereolabs' own calibration tools write): an
INI file with a section a side and resolution, LEFT_CAM_HD ..., fx, fy, cx, cy and k1, k2, in later files p1, p2 and k3
too; newer ones hold LEFT_DISTO and RIGHT_DISTO with k1, k2, p1, p2, k3, k4, k5, k6 of OpenCV's rational model, some
with s1 to s4, for all resolutions: what Stereolabs' SDK undistorts by (stereolabs/zed-ros2-wrapper #128). STEREO in mm:
p_right = Rodrigues(RX, CV, RZ) p_left + (-Baseline, TY, TZ), the angles a resolution each (CV_HD). The first files call
it BaseLine and have neither TY nor TZ; what a file leaves out is zero, as in the makers' programs. The sign is that of
the makers' tool, which writes Baseline = -T[0] of cv2.stereoCalibrate.

DepthAI (luxonis/depthai-core, CalibrationHandler.cpp, EepromData): cameraData pairs of a socket's number and a camera
of matrix, 14 coefficients, size, and extrinsics p_to = R p_this + translation in cm, to the camera `toCameraSocket`, -1
for none. `specTranslation` is the drawing's, not what was measured, and not used. cameraType 0 is OpenCV's pinhole, 1
its fisheye with four coefficients.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from armsight.errors import BadFile, UsageError
from armsight.optics import SIDES, Camera
from armsight.store.foreign import numbers
from armsight.store.foreign.lenses import pixels
from armsight.store.foreign.several import Asked, Placed, Pose, lens_of
from armsight.store.foreign.storage import read_storage

ZED_SIZES = {
    "VGA": (672, 376),
    "SVGA": (960, 600),
    "HD": (1280, 720),
    "FHD": (1920, 1080),
    "FHD1200": (1920, 1200),
    "2K": (2208, 1242),
    "QHDPLUS": (3200, 1800),
    "4K": (3840, 2160),
}
"""Images of one side, width and height in px, by the end of a section's name in capitals."""
RATIONAL = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
"""OpenCV's order."""
PRISM = ("s1", "s2", "s3", "s4")
ZED_LENSES = (RATIONAL[:2], RATIONAL[:4], RATIONAL[:5])
"""Coefficients that the sections of a file hold, of the first files first."""
ZED_TOLD_PX = 0.1
"""Between the two lenses of a newer file; of those seen they are 5 to 35 px apart."""
MM, CM = 1e-3, 1e-2

SOCKETS = "ABCDEFGHIJ"
"""DepthAI's CameraBoardSocket 0 is CAM_A."""
CAMERA_TYPES = {0: "perspective", 1: "fisheye", 2: "equirectangular", 3: "radial division"}


def read_zed(path: Path, asked: Asked) -> list[Placed]:
    """Return left and right of a ZED at the size that is asked for. Raises BadFile, UsageError."""
    content, where = read_storage(path), str(path)
    there = [key.removeprefix("LEFT_CAM_") for key in content if key.startswith("LEFT_CAM_")]
    sizes = {ZED_SIZES[name.upper()]: name for name in there if name.upper() in ZED_SIZES}
    size = asked.size if asked.size is not None or len(sizes) != 1 else next(iter(sizes))
    if size is None or size not in sizes:
        of = ", ".join(f"{width}x{height}" for width, height in sizes) or f"none that is known ({', '.join(there)})"
        raise UsageError(
            f"{where} holds a calibration for each size of images: {of}",
            consequence="Which is meant is not clear" if size is None else f"None is of {size[0]}x{size[1]}",
            cure="Give the size of one camera's images, such as --size 1280x720",
        )
    name, stereo = sizes[size], content["STEREO"]
    keys = _zed_lens_keys(content, where)
    left, right = (
        partial(_zed_camera, content, f"{side}_CAM_{name}", keys, size, where, asked) for side in ("LEFT", "RIGHT")
    )
    angles = [numbers.number_at(stereo, f"{key}_{name}", where) for key in ("RX", "CV", "RZ")]
    across = [f"{key}_{name}" if f"{key}_{name}" in stereo else key for key in ("TY", "TZ")]
    if len(keys) < len(ZED_LENSES[-1]) and not set(across) & stereo.keys():
        asked.told.append(f"{where} is of a ZED's first files, without TY and TZ: they are 0, as its maker reads it")
        across = []
    shifts = [numbers.number_at(stereo, key, where) for key in across] or [0.0, 0.0]
    along = "BaseLine" if "BaseLine" in stereo else "Baseline"
    t_m = MM * np.array([-numbers.number_at(stereo, along, where), *shifts])
    return [
        Placed(name=SIDES[0], lens=left, pose=(np.eye(3), np.zeros(3))),
        Placed(name=SIDES[1], lens=right, pose=(Rotation.from_rotvec(angles).as_matrix(), t_m)),
    ]


def _zed_lens_keys(content: Mapping[str, Any], where: str) -> tuple[str, ...]:
    """Return which coefficients the sections of a file hold, the others being zero, as the makers' programs read it.

    Raises BadFile where one section holds others: a line is missing.
    """
    cameras = [one for key, one in content.items() if "_CAM_" in key and isinstance(one, Mapping)]
    held = {tuple(key for key in ZED_LENSES[-1] if key in one) for one in cameras} - {()}
    keys = held.pop() if len(held) == 1 else ()
    if held or (keys and keys not in ZED_LENSES):
        raise BadFile(
            f"{where}: its sections do not hold the same coefficients of k1, k2, p1, p2, k3",
            consequence="A line is missing, and the lens would be another one",
            cure="Download the file of the camera's serial number anew",
        )
    return keys


def _zed_camera(
    content: Mapping[str, Any], section: str, keys: Sequence[str], size: tuple[int, int], where: str, asked: Asked
) -> Camera:
    """Return the camera of one section, by the lens for all sizes where the file holds one. Raises BadFile."""
    one = numbers.value_at(content, section, where)
    fx, fy, cx, cy = (numbers.number_at(one, key, f"{where}, {section}") for key in ("fx", "fy", "cx", "cy"))

    def camera(lens: Mapping[str, Any], name: str, keys: Sequence[str]) -> Camera:
        values = [numbers.number_at(lens, key, f"{where}, {name}") for key in keys]
        values += [0.0] * (len(ZED_LENSES[-1]) - len(values))
        return lens_of(np.array(values), (fx, fy, cx, cy, 0.0), size, f"{where}, {name}", asked, fisheye=False)

    rational = f"{section.split('_')[0]}_DISTO"
    lens = content.get(rational)
    if not (isinstance(lens, Mapping) and set(RATIONAL) <= lens.keys()):
        return camera(one, section, keys or ZED_LENSES[-1])
    if lens["k4"] and not any(lens[key] for key in ("p1", "p2", "k5", "k6")):
        raise BadFile(
            f"{where}, {rational}: k1, k2, k3, k4 alone are not zero",
            consequence="They may be a fisheye's or a pinhole's",
            cure="Calibrate it anew here",
        )
    taken = camera(lens, rational, RATIONAL + (PRISM if set(PRISM) & lens.keys() else ()))
    if keys:
        uv = pixels(size)
        older = camera(one, section, keys).project(np.column_stack([taken.rays(uv), np.ones(len(uv))]))
        apart_px = float(np.nanmax(np.linalg.norm(older - uv, axis=1)))
        if apart_px > ZED_TOLD_PX:
            asked.told.append(
                f"{where}: the lens of {rational} is taken, as its maker does; that of {section} is up to "
                f"{apart_px:.1f} px from it: look which one fits a board"
            )
    return taken


def read_depthai(path: Path, asked: Asked) -> list[Placed]:
    """Return the cameras of a DepthAI board by their sockets, CAM_A ..., placed in the axes of the camera that most of
    their chains of poses end at, in metres. Raises BadFile.
    """
    where = str(path)
    entries = [_socket(one, where) for one in read_storage(path)["cameraData"]]
    cameras = dict(entries)
    if len(cameras) < len(entries):
        raise BadFile(f"{where}: one socket holds two cameras", cure="Keep one of each socket in cameraData")
    poses = {socket: _chain(cameras, socket, where) for socket in cameras}
    ends = [end for end, _ in poses.values()]
    common = max(ends, key=ends.count) if ends else None
    found = []
    for socket, one in sorted(cameras.items()):
        name = f"CAM_{SOCKETS[socket]}"
        here = f"{where}, {name}"
        if not numbers.array_of(one.get("intrinsicMatrix") or [], "intrinsicMatrix", here).any():
            if not asked.names:
                asked.told.append(f"{here} has no calibration")
            continue
        end, (R, t) = poses[socket]
        lens = partial(_depthai_camera, one, here, asked)
        found.append(Placed(name=name, lens=lens, pose=(R.T, -R.T @ t) if end == common else None))
    return found


def _socket(entry: object, where: str) -> tuple[int, Mapping[str, Any]]:
    """Return the number of a board's socket and the camera in it."""
    if isinstance(entry, list) and len(entry) == 2 and isinstance(entry[1], Mapping):
        number = entry[0]
        if type(number) is int and 0 <= number < len(SOCKETS):
            return number, entry[1]
    raise BadFile(
        f"{where}: an entry of cameraData is no pair of a socket's number and a camera",
        cure="Write the file anew with the board's eepromToJsonFile",
    )


def _chain(cameras: Mapping[int, Mapping[str, Any]], socket: int, where: str) -> tuple[int, Pose]:
    """Return the socket that a camera's chain of poses ends at, and R, t (m) of p_end = R p_camera + t."""
    R, t, seen = np.eye(3), np.zeros(3), {socket}
    while True:
        extrinsics = cameras[socket].get("extrinsics") or {}
        to = extrinsics.get("toCameraSocket", -1)
        if to not in cameras:
            return socket, (R, t)
        if to in seen:
            raise BadFile(f"{where}: the poses of the cameras {sorted(seen)} lead in a circle", cure="Correct it there")
        here = f"{where}, CAM_{SOCKETS[socket]}"
        step = numbers.rotation_of(
            numbers.matrix_at(extrinsics, "rotationMatrix", (3, 3), here), "rotationMatrix", here
        )
        measured = numbers.value_at(extrinsics, "translation", here)
        shift = np.array([numbers.number_at(measured, x, here) for x in "xyz"])
        R, t, socket = step @ R, step @ t + CM * shift, to
        seen.add(to)


def _depthai_camera(one: Mapping[str, Any], where: str, asked: Asked) -> Camera:
    """Return the camera of a socket that was calibrated."""
    kind = one.get("cameraType", 0)
    if kind not in (0, 1):
        raise BadFile(
            f"{where}: the lens model is {CAMERA_TYPES.get(kind, kind)!r}",
            cure="Calibrate it anew here",
        )
    size = numbers.count_at(one, "width", where), numbers.count_at(one, "height", where)
    if asked.size not in (None, size):
        raise BadFile(
            f"{where}: the calibration is of images of {size[0]}x{size[1]} px",
            consequence="How the board makes other sizes of them, by scaling or cutting, is not in the file",
            cure="Record at that size, and leave --size out",
        )
    intrinsics = numbers.intrinsics_of(
        numbers.matrix_at(one, "intrinsicMatrix", (3, 3), where), "intrinsicMatrix", where
    )
    values = numbers.array_of(numbers.value_at(one, "distortionCoeff", where), "distortionCoeff", where)
    return lens_of(values, intrinsics, size, where, asked, fisheye=kind == 1)
