"""Fisheye lenses in our files and in other programs'."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from armsight.errors import BadFile
from armsight.ops.conversion import convert_camera, convert_rig
from armsight.optics import Camera, LensKind, Rig, RigKind
from armsight.store import read_camera, read_rig, write_camera, write_rig
from armsight.store.foreign import camera_from_kalibr, camera_from_opencv, camera_from_ros
from armsight.store.yamls import dump_yaml, read_yaml
from refusals import refuses

D = [-0.012, 0.02, -0.015, 0.004]
CAMERA = Camera.fisheye(1280, 1024, 420.0, 415.0, 640.3, 511.2, distortion=D)
RIG = Rig(
    kind=RigKind.STEREO,
    left=CAMERA,
    right=replace(CAMERA, intrinsics=CAMERA.intrinsics + np.eye(10)[8] * 1e-4),
    T_rig_left=RigidTransform.identity(),
    T_rig_right=RigidTransform.from_translation([0.12, 0.001, -0.002]),
)
KALIBR = """\
cam0:
  camera_model: {camera}
  distortion_model: {distortion}
  distortion_coeffs: [-0.012, 0.02, -0.015, 0.004{more}]
  intrinsics: [420.0, 415.0, 640.3, 511.2]
  resolution: [1280, 1024]
"""


@pytest.mark.parametrize("kind", ["armsight", "ros", "opencv", "kalibr"])
def test_a_camera_goes_there_and_back(tmp_path: Path, kind: str) -> None:
    write_camera(tmp_path / "camera.yaml", CAMERA)
    convert_camera(tmp_path / "camera.yaml", tmp_path / "other.yaml", to=kind)
    if kind != "armsight":
        convert_camera(tmp_path / "other.yaml", tmp_path / "back.yaml")
    back = read_camera(tmp_path / ("back.yaml" if kind != "armsight" else "other.yaml"))
    assert back.lens is LensKind.FISHEYE
    assert back.is_close(CAMERA, tol=0.0)


@pytest.mark.parametrize("kind", ["ros", "opencv", "kalibr"])
def test_a_rig_goes_there_and_back(tmp_path: Path, kind: str) -> None:
    write_rig(tmp_path / "rig.yaml", RIG)
    outs = [tmp_path / name for name in (("left.yaml", "right.yaml") if kind == "ros" else ("both.yaml",))]
    convert_rig([tmp_path / "rig.yaml"], outs, to=kind)
    convert_rig(outs, [tmp_path / "back.yaml"])
    back = read_rig(tmp_path / "back.yaml")
    assert back.left.is_close(CAMERA, tol=1e-12)
    assert back.right.is_close(RIG.right, tol=1e-12)
    np.testing.assert_allclose(back.T_rig_right.translation, [0.12, 0.001, -0.002], atol=1e-9)


def test_colmap_gets_its_fisheye(tmp_path: Path) -> None:
    write_camera(tmp_path / "camera.yaml", CAMERA)
    convert_camera(tmp_path / "camera.yaml", tmp_path / "cameras.txt", to="colmap")
    line = (tmp_path / "cameras.txt").read_text().splitlines()[-1].split()
    assert line[1] == "OPENCV_FISHEYE"
    np.testing.assert_allclose([float(x) for x in line[4:]], [420.0, 415.0, 640.8, 511.7, *D])


def test_opencv_reads_what_is_written_as_its_own(tmp_path: Path) -> None:
    write_camera(tmp_path / "camera.yaml", CAMERA)
    convert_camera(tmp_path / "camera.yaml", tmp_path / "cv.yml", to="opencv")
    storage = cv2.FileStorage(str(tmp_path / "cv.yml"), cv2.FILE_STORAGE_READ)
    K, k = storage.getNode("camera_matrix").mat(), storage.getNode("distortion_coefficients").mat()
    assert int(storage.getNode("fisheye_model").real()) == 1
    X = np.array([[[0.3, -0.2, 0.5]]])
    expected = cv2.fisheye.projectPoints(X, np.zeros(3), np.zeros(3), K, k)[0].ravel()
    np.testing.assert_allclose(CAMERA.project(X[0])[0], expected, atol=1e-9)


@pytest.mark.parametrize("camera", ["omni", "eucm", "ds"])
def test_other_kalibr_cameras_are_refused_by_name(tmp_path: Path, camera: str) -> None:
    (tmp_path / "k.yaml").write_text(KALIBR.format(camera=camera, distortion="radtan", more=""))
    with refuses(BadFile, "camera_model", camera) as refused:
        camera_from_kalibr(tmp_path / "k.yaml")
    assert "pinhole-equi" in refused.value.cure


@pytest.mark.parametrize("model", ["fov", "radtan8"])
def test_other_kalibr_lenses_are_refused_by_name(tmp_path: Path, model: str) -> None:
    (tmp_path / "k.yaml").write_text(KALIBR.format(camera="pinhole", distortion=model, more=""))
    with refuses(BadFile, "distortion_model", model):
        camera_from_kalibr(tmp_path / "k.yaml")


def _kalibr(path: Path) -> None:
    path.write_text(KALIBR.format(camera="pinhole", distortion="equidistant", more=", 0.001"))
    camera_from_kalibr(path)


def _ros(path: Path) -> None:
    write_camera(path, CAMERA)
    convert_camera(path, path.with_name("r.yaml"), to="ros")
    content = read_yaml(path.with_name("r.yaml"))
    content["distortion_coefficients"] = {"rows": 1, "cols": 5, "data": [0.1, 0.0, 0.0, 0.0, 0.0]}
    path.write_text(dump_yaml(content))
    camera_from_ros(path)


def _opencv(path: Path) -> None:
    matrix = "!!opencv-matrix\n   rows: {}\n   cols: {}\n   dt: d\n   data: {}\n"
    path.write_text(
        "%YAML:1.0\n---\nimage_width: 1280\nimage_height: 1024\nfisheye_model: 1\n"
        + "camera_matrix: "
        + matrix.format(3, 3, [420.0, 0.0, 640.0, 0.0, 420.0, 512.0, 0.0, 0.0, 1.0])
        + "distortion_coefficients: "
        + matrix.format(1, 5, [0.1, 0.0, 0.0, 0.0, 0.0])
    )
    camera_from_opencv(path)


@pytest.mark.parametrize("read", [_kalibr, _ros, _opencv])
def test_five_coefficients_are_no_fisheye(tmp_path: Path, read: Callable[[Path], None]) -> None:
    with pytest.raises(BadFile, match="5 coefficients"):
        read(tmp_path / "five.yaml")


def test_our_own_file_with_another_number_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "camera.yaml"
    write_camera(path, CAMERA)
    path.write_text(path.read_text().replace("lens: fisheye", "lens: pinhole"))
    with refuses(BadFile, "k1, k2, p1, p2, k3"):
        read_camera(path)
    path.write_text(path.read_text().replace("lens: pinhole", "lens: omni"))
    with pytest.raises(BadFile, match="lens"):
        read_camera(path)
