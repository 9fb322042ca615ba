"""Fisheye and rational lenses in our files and in other programs'."""

import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from armsight.errors import BadFile, Inconsistent
from armsight.ops.conversion import convert_camera, convert_rig
from armsight.optics import Camera, LensKind, Rig
from armsight.optics.camera import with_step
from armsight.records import NamedCovariance
from armsight.store import read_camera, read_rig, write_camera, write_rig
from armsight.store.foreign import camera_from_kalibr
from armsight.store.foreign.several import Asked
from armsight.store.rigs import CameraModel, RigModel
from armsight.store.yamls import read_yaml
from refusals import refuses

D = (9.0, -5.2, 3e-4, -2e-4, 0.9, 9.3, -2.6, -0.4)
K = (566.0, 566.3, 640.3, 398.2)
D_FISHEYE = [-0.012, 0.02, -0.015, 0.004]
FISHEYE = Camera.fisheye(1280, 1024, 420.0, 415.0, 640.3, 511.2, distortion=D_FISHEYE)
RATIONAL = Camera.rational(1280, 800, *K, distortion=D)
NAMES = ("left.k1", "right.k6", "right.tx")


def rig_of(camera: Camera) -> Rig:
    """A pair of a camera and one whose lens differs a little."""
    step = 1e-4 * np.eye(10)[8] if camera is FISHEYE else 1e-3 * np.eye(13)[12]
    return Rig(
        left=camera,
        right=with_step(camera, step),
        T_rig_left=RigidTransform.identity(),
        T_rig_right=RigidTransform.from_translation([0.075, 0.001, -0.002]),
    )


OF_CAMERAS = [
    *((FISHEYE, kind) for kind in ("armsight", "ros", "opencv", "kalibr")),
    *((RATIONAL, kind) for kind in ("ros", "opencv", "colmap")),
]
OF_RIGS = [
    *((FISHEYE, kind) for kind in ("ros", "opencv", "kalibr")),
    *((RATIONAL, kind) for kind in ("ros", "opencv", "multical", "caliscope", "aniposelib")),
]


def named(one: object) -> str:
    return one.lens.value if isinstance(one, Camera) else str(one)


@pytest.mark.parametrize(("camera", "kind"), OF_CAMERAS, ids=named)
def test_a_camera_goes_there_and_back(tmp_path: Path, camera: Camera, kind: str) -> None:
    other, back = tmp_path / ("cameras.txt" if kind == "colmap" else "other.yaml"), tmp_path / "back.yaml"
    write_camera(tmp_path / "camera.yaml", camera)
    convert_camera(tmp_path / "camera.yaml", other, to=kind)
    if kind != "armsight":
        convert_camera(other, back)
    found = read_camera(back if kind != "armsight" else other)
    assert found.lens is camera.lens and found.is_close(camera, tol=0.0 if camera is FISHEYE else 1e-12)


@pytest.mark.parametrize(("camera", "kind"), OF_RIGS, ids=named)
def test_a_rig_goes_there_and_back(tmp_path: Path, camera: Camera, kind: str) -> None:
    rig = rig_of(camera)
    write_rig(tmp_path / "rig.yaml", rig)
    names = {
        "ros": ("left.yaml", "right.yaml"),
        "multical": ("rig.json",),
        "opencv": ("rig.yml",),
        "kalibr": ("k.yaml",),
    }
    outs = [tmp_path / name for name in names.get(kind, ("rig.toml",))]
    convert_rig([tmp_path / "rig.yaml"], outs, to=kind)
    convert_rig(outs, [tmp_path / "back.yaml"])
    back = read_rig(tmp_path / "back.yaml")
    assert back.left.is_close(camera, tol=1e-12)
    assert back.right.is_close(rig.right, tol=1e-12)
    np.testing.assert_allclose(back.T_rig_right.translation, [0.075, 0.001, -0.002], atol=1e-9)


def test_colmap_gets_its_fisheye(tmp_path: Path) -> None:
    write_camera(tmp_path / "camera.yaml", FISHEYE)
    convert_camera(tmp_path / "camera.yaml", tmp_path / "cameras.txt", to="colmap")
    line = (tmp_path / "cameras.txt").read_text().splitlines()[-1].split()
    assert line[1] == "OPENCV_FISHEYE"
    np.testing.assert_allclose([float(x) for x in line[4:]], [420.0, 415.0, 640.8, 511.7, *D_FISHEYE])


def test_opencv_reads_a_fisheye_as_its_own(tmp_path: Path) -> None:
    write_camera(tmp_path / "camera.yaml", FISHEYE)
    convert_camera(tmp_path / "camera.yaml", tmp_path / "cv.yml", to="opencv")
    storage = cv2.FileStorage(str(tmp_path / "cv.yml"), cv2.FILE_STORAGE_READ)
    own, k = storage.getNode("camera_matrix").mat(), storage.getNode("distortion_coefficients").mat()
    assert int(storage.getNode("fisheye_model").real()) == 1
    X = np.array([[[0.3, -0.2, 0.5]]])
    expected = cv2.fisheye.projectPoints(X, np.zeros(3), np.zeros(3), own, k)[0].ravel()
    np.testing.assert_allclose(FISHEYE.project(X[0])[0], expected, atol=1e-9)


@pytest.mark.parametrize("model", ["mei", "division"])
def test_other_kalibr_cameras_are_refused_by_name(tmp_path: Path, model: str) -> None:
    text = "cam0:\n  camera_model: {}\n  distortion_model: radtan\n  distortion_coeffs: [-0.012, 0.02, -0.015, 0.004]\n"
    text += "  intrinsics: [420.0, 415.0, 640.3, 511.2]\n  resolution: [1280, 1024]\n"
    (tmp_path / "k.yaml").write_text(text.format(model))
    with refuses(BadFile, "camera_model", model) as refused:
        camera_from_kalibr(tmp_path / "k.yaml")
    assert "pinhole-equi" in refused.value.cure


def test_our_files_hold_a_rational_lens_under_a_version_of_their_own(tmp_path: Path) -> None:
    known = NamedCovariance(names=NAMES, matrix=np.diag([1e-4, 2e-4, 1e-9]))
    rig = replace(rig_of(RATIONAL), covariance=known)
    write_camera(tmp_path / "camera.yaml", RATIONAL)
    write_rig(tmp_path / "rig.yaml", rig)
    assert read_camera(tmp_path / "camera.yaml").is_close(RATIONAL, tol=0.0)
    back = read_rig(tmp_path / "rig.yaml")
    assert back.right.is_close(rig.right, tol=0.0)
    assert back.covariance is not None
    assert back.covariance.names == NAMES
    versions = [read_yaml(tmp_path / name)["version"] for name in ("camera.yaml", "rig.yaml")]
    assert versions == [2, 3]
    for model, version in ((CameraModel, 2), (RigModel, 3)):  # what readers before knew
        assert version not in model.model_fields["version"].annotation.__args__
    write_camera(tmp_path / "plain.yaml", Camera.pinhole(1280, 800, *K))
    assert read_yaml(tmp_path / "plain.yaml")["version"] == 1


def test_kalibr_has_no_such_model(tmp_path: Path) -> None:
    write_camera(tmp_path / "camera.yaml", RATIONAL)
    with refuses(Inconsistent, "rational", "Kalibr"):
        convert_camera(tmp_path / "camera.yaml", tmp_path / "k.yaml", to="kalibr")


def depthai(path: Path, coefficients: list[float]) -> Path:
    fx, fy, cx, cy = K
    camera = {"cameraType": 0, "width": 1280, "height": 800, "intrinsicMatrix": [[fx, 0, cx], [0, fy, cy], [0, 0, 1]]}
    path.write_text(json.dumps({"cameraData": [[0, {**camera, "distortionCoeff": coefficients, "extrinsics": {}}]]}))
    return path


def test_fourteen_coefficients_are_exact_without_prism_and_tilt(tmp_path: Path) -> None:
    source = depthai(tmp_path / "oak.json", [*D, *[0.0] * 6])
    convert_camera(source, tmp_path / "camera.yaml")
    assert read_camera(tmp_path / "camera.yaml").lens is LensKind.RATIONAL
    assert read_camera(tmp_path / "camera.yaml").is_close(RATIONAL, tol=0.0)


def test_prism_and_tilt_are_the_nearest_lens_or_refused(tmp_path: Path) -> None:
    X = np.stack([*np.meshgrid(np.linspace(-0.9, 0.9, 13), np.linspace(-0.55, 0.55, 9)), np.ones((9, 13))], axis=-1)
    X = X.reshape(-1, 3)
    out = tmp_path / "camera.yaml"
    for coefficients in ([*D, 2e-5, 0.0, -1e-5, 0.0, 0.0, 0.0], [*D, 0.0, 0.0, 0.0, 0.0, 0.01, 0.004]):
        source = depthai(tmp_path / "oak.json", coefficients)
        tilted = bool(coefficients[12])
        if tilted:
            with refuses(BadFile, "thin prism", "tilt", "px off", "--approximate"):
                convert_camera(source, out)
        convert_camera(source, out, asked=Asked(approximate=tilted))
        theirs = cv2.projectPoints(X, np.zeros(3), np.zeros(3), RATIONAL.matrix, np.array(coefficients))[0].reshape(
            -1, 2
        )
        apart = np.linalg.norm(read_camera(out).project(X) - theirs, axis=1).max()
        assert apart < (4.0 if tilted else 0.05)
        assert tilted or apart < np.linalg.norm(RATIONAL.project(X) - theirs, axis=1).max()


def test_a_lens_that_leaves_the_picture_without_rays_is_refused(tmp_path: Path) -> None:
    source = depthai(tmp_path / "oak.json", [0.0] * 5 + [4.0, 0.0, 0.0] + [0.0] * 6)
    with refuses(BadFile, "no ray", "pole", "26.6 degrees"):
        convert_camera(source, tmp_path / "camera.yaml")
