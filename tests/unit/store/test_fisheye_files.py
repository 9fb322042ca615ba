"""Fisheye lenses in our files and in other programs'."""

from __future__ import annotations

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
from armsight.store.foreign import camera_from_kalibr
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


@pytest.mark.parametrize("camera", ["mei", "division"])
def test_other_kalibr_cameras_are_refused_by_name(tmp_path: Path, camera: str) -> None:
    (tmp_path / "k.yaml").write_text(KALIBR.format(camera=camera, distortion="radtan", more=""))
    with refuses(BadFile, "camera_model", camera) as refused:
        camera_from_kalibr(tmp_path / "k.yaml")
    assert "pinhole-equi" in refused.value.cure
