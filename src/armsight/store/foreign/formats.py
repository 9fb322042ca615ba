"""Every kind of camera file of other programs: how it is read and written, one entry a kind.

What a file of each really says stands, with its source, at the head of the module that reads it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from armsight.errors import BadFile, UsageError
from armsight.optics import SIDES, Camera, Rig
from armsight.store.foreign import colmap, devices, kalibr, matlab, opencv, photogrammetry, realsense, ros, several
from armsight.store.foreign.several import Asked, Placed


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraFormat:
    """A kind of file: title for lists; needs: what has to be said or given beside it; unit: of its lengths.

    signs: patterns of what stands in its first lines, of which a file that is of no kind may have some.
    camera, rig: read one; write_camera, write_rig: write one, where it is written. files: how many make a rig; outs:
    how many are written of one.
    """

    title: str
    needs: str = ""
    unit: str = "m"
    signs: tuple[str, ...] = ()
    files: tuple[int, ...] = (1,)
    outs: tuple[int, ...] = (1,)
    camera: Callable[[Path, Asked], Camera] | None = None
    rig: Callable[[Sequence[Path], Asked], Rig] | None = None
    write_camera: Callable[[Path, Camera], None] | None = None
    write_rig: Callable[[Sequence[Path], Rig], None] | None = None


def _several(
    title: str,
    read: Callable[[Path, Asked], list[Placed]],
    *,
    names: Sequence[str] = (),
    writes: str = "",
    needs: str = "",
    unit: str = "",
    signs: tuple[str, ...] = (),
) -> CameraFormat:
    """Return a kind that a function reads as a list of cameras; names: of a rig's, else the file's."""
    return CameraFormat(
        title=title,
        needs=needs,
        unit=unit,
        signs=signs,
        camera=lambda path, asked: several.camera_of(read(path, asked), str(path), asked),
        rig=lambda paths, asked: several.rig_of(read(paths[0], asked), str(paths[0]), asked, names),
        write_rig=(lambda paths, rig: several.write_several(paths[0], rig, writes)) if writes else None,
    )


UNIT = "--unit where the board's squares were not given in metres"

FORMATS = {
    "ros": CameraFormat(
        signs=("camera_matrix", "distortion_model", "projection_matrix", "rectification_matrix", "binning_x"),
        title="ROS camera_info, as files or as ros2 topic echo prints it",
        needs="of a rig left and right",
        files=(2,),
        outs=(2, 3),
        camera=lambda path, asked: ros.camera_from_ros(path, told=asked.told, approximate=asked.approximate),
        rig=lambda paths, asked: ros.rig_from_ros(
            *paths[:2], unit_m=asked.unit_m, told=asked.told, approximate=asked.approximate
        ),
        write_camera=ros.camera_to_ros,
        write_rig=lambda paths, rig: ros.rig_and_frames_to_ros(paths, rig),
    ),
    "opencv": CameraFormat(
        signs=("opencv-matrix", "opencv_storage", "cameraMatrix", "camera_matrix", "distCoeffs", r"\bmtx\b"),
        title="OpenCV FileStorage in YAML, JSON or XML, of OpenCV 4 and 5; of a ZED's tool",
        needs=f"--size where it does not say it; {UNIT}",
        files=(1, 2),
        camera=lambda path, asked: opencv.camera_from_opencv(
            path, size=asked.size, told=asked.told, approximate=asked.approximate
        ),
        rig=lambda paths, asked: opencv.rig_from_opencv(
            paths, size=asked.size, unit_m=asked.unit_m, told=asked.told, approximate=asked.approximate
        ),
        write_camera=opencv.camera_to_opencv,
        write_rig=lambda paths, rig: opencv.rig_to_opencv(paths[0], rig),
    ),
    "kalibr": CameraFormat(
        signs=("cam0", "camera_model", "distortion_coeffs", "T_cn_cnm1"),
        title="Kalibr camchain, of any of its models",
        camera=kalibr.camera_from_kalibr,
        rig=lambda paths, asked: kalibr.rig_from_kalibr(paths[0], asked),
        write_camera=kalibr.camera_to_kalibr,
        write_rig=lambda paths, rig: kalibr.rig_to_kalibr(paths[0], rig),
    ),
    "zed": _several(
        "Stereolabs SN*.conf",
        devices.read_zed,
        names=SIDES,
        needs="--size of one side's images",
        unit="mm",
        signs=("LEFT_CAM_", "RIGHT_CAM_", r"^\[STEREO\]"),
    ),
    "depthai": _several(
        "Luxonis DepthAI calibration (JSON)",
        devices.read_depthai,
        unit="cm",
        signs=("cameraData", "toCameraSocket", "intrinsicMatrix"),
    ),
    "aniposelib": _several(
        "aniposelib calibration.toml",
        several.read_aniposelib,
        writes="aniposelib",
        needs=UNIT,
        signs=(r"^\[cam_", "distortions", r"^\[metadata\]"),
    ),
    "caliscope": _several(
        "caliscope camera_array.toml",
        several.read_caliscope,
        writes="caliscope",
        needs=UNIT,
        signs=(r"^\[cameras\.", "cam_id", "rotation_count", "distortions"),
    ),
    "multical": _several(
        "multical calibration.json",
        several.read_multical,
        writes="multical",
        needs=UNIT,
        signs=("camera_poses", "image_size", "image_sets"),
    ),
    "metashape": _several(
        "Metashape camera calibration (Agisoft XML)",
        photogrammetry.read_metashape,
        signs=("<calibration", "<projection", "<b1>"),
    ),
    "halcon": _several(
        "HALCON camera parameters (.dat, .cal)",
        photogrammetry.read_halcon,
        signs=("ParGroup", "^Focus:", "^(Kappa|K1):"),
    ),
    "realsense": _several(
        "RealSense: text of rs-enumerate-devices -c, or JSON of librealsense's fields",
        realsense.read_realsense,
        needs="--size where it holds several; of a rig --name of its cameras",
        unit="metres",
        signs=("Intrinsic of", "ppx", "ppy", "coeffs", "rs-enumerate-devices", "brown_conrady"),
    ),
    "matlab": _several(
        "MATLAB cameraParameters, stereoParameters as a struct (.mat up to version 7)",
        matlab.read_matlab,
        names=SIDES,
        needs="--size of a struct from before R2017; --unit where WorldUnits is not a unit",
        signs=(r"\AMATLAB ",),
    ),
    "colmap": CameraFormat(
        signs=("CAMERA_ID, MODEL", "RIG_ID, NUM_SENSORS", "SIMPLE_RADIAL|PINHOLE"),
        title="COLMAP cameras.txt, of a rig with rigs.txt (3.12 and later)",
        needs="of a rig both files, and --unit",
        files=(2,),
        outs=(1, 2),
        camera=lambda path, asked: several.camera_of(colmap.read_cameras(path, asked), str(path), asked),
        rig=colmap.rig_from_colmap,
        write_camera=lambda path, camera: colmap.cameras_to_colmap(path, [camera]),
        write_rig=colmap.rig_to_colmap,
    ),
}
OFF_CENTRE, CENTRED = 0.1, 0.05
"""Of the image's size: lenses are within the one of its middle, mostly within the other; of sides 4 to 3 that are
exchanged it is 0.17."""
OBLONG = 0.05
"""Of fx, by which fy differs in no camera seen: in those of the public files of the tests by 0.04 at most."""
READ = tuple(name for name, one in FORMATS.items() if one.rig is not None)
WRITTEN = tuple(name for name, one in FORMATS.items() if one.write_rig is not None)


def read_foreign_camera(kind: str, path: Path, asked: Asked) -> Camera:
    """Return the camera that is meant of a file of one of FORMATS. Raises BadFile, UsageError."""
    read = FORMATS[kind].camera
    if read is None:
        raise UsageError(f"a file of {kind} is written only", cure="Give a file of another kind")
    camera = read(path, asked)
    _check_shape(camera, str(path), asked)
    return camera


def read_foreign_rig(kind: str, paths: Sequence[Path], asked: Asked) -> Rig:
    """Return the rig in the files of one of FORMATS. Raises BadFile, UsageError."""
    one = FORMATS[kind]
    if one.rig is None:
        raise UsageError(f"a file of {kind} is written only", cure="Give a file of another kind")
    if one.unit in ("mm", "cm", "metres") and asked.unit_m is not None:
        raise UsageError(
            f"a file of {kind} is in {one.unit}, which is known",
            consequence="Another unit would put the cameras elsewhere",
            cure="Leave --unit out",
        )
    rig = one.rig(paths, asked)
    for camera in rig.cameras:
        _check_shape(camera.camera, f"{' and '.join(str(path) for path in paths)}, {camera.name}", asked)
    return rig


def _check_shape(camera: Camera, where: str, asked: Asked) -> None:
    """Raise BadFile where the principal point fits the image's size with width and height exchanged, and only so; tell
    where pixels would be far from square.
    """
    fx, fy = camera.intrinsics[:2].tolist()
    if abs(fx - fy) > OBLONG * fx:
        asked.told.append(
            f"{where}: fx {fx:.0f} px and fy {fy:.0f} px differ by {100 * abs(fx - fy) / fx:.0f} %: pixels are mostly "
            "square, so look whether numbers are exchanged there"
        )
    middle, size = camera.intrinsics[2:4], np.array([camera.width, camera.height])
    off, turned = (float(np.abs((middle + 0.5) / one - 0.5).max()) for one in (size, size[::-1]))
    if off > OFF_CENTRE and turned < CENTRED:
        raise BadFile(
            f"{where}: the principal point {middle[0]:.0f}, {middle[1]:.0f} px is in the middle of images of "
            f"{size[1]}x{size[0]} px, and the size is {size[0]}x{size[1]}",
            consequence="Width and height are exchanged, or the camera's pictures were turned after its calibration",
            cure="Correct the size there, width first; calibrate turned pictures as they are used",
        )
