"""Files as OpenCV, ROS and Kalibr write them (data/foreign/README.md): read, written, and checked by OpenCV itself."""

import re
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.errors import BadFile, Inconsistent
from armsight.geometry import is_close
from armsight.optics import Camera
from armsight.store import foreign
from armsight.store.foreign.opencv import opencv_rig
from armsight.store.foreign.ros import ros_camera, ros_rig
from armsight.store.yamls import read_yaml
from refusals import refuses

DATA = Path(__file__).parent / "data" / "foreign"
OPENCV = (DATA / "opencv" / "intrinsics.yml", DATA / "opencv" / "extrinsics.yml")
ROS = (DATA / "ros" / "left.yaml", DATA / "ros" / "right.yaml")
KALIBR = DATA / "kalibr" / "camchain.yaml"
SIZE = (640, 480)


def by_cv2(path, *names):
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_READ)
    values = tuple(storage.getNode(name).mat() for name in names)
    storage.release()
    return values


def truth():
    """M1, D1, M2, D2, R, T as OpenCV reads its own files, and points before both cameras."""
    points = np.random.default_rng(5).uniform((-0.15, -0.1, 0.3), (0.15, 0.1, 0.6), (50, 3))
    return (*by_cv2(OPENCV[0], "M1", "D1", "M2", "D2"), *by_cv2(OPENCV[1], "R", "T")), points


def pixels_by_cv2(points):
    (M1, D1, M2, D2, R, T), _ = truth()
    left = cv2.projectPoints(points, np.zeros(3), np.zeros(3), M1, D1)[0].reshape(-1, 2)
    right = cv2.projectPoints(points, cv2.Rodrigues(R)[0], T, M2, D2)[0].reshape(-1, 2)
    return left, right


# six decimals in the ROS files: 5e-7 of the rectifying rotations' entries is 3e-4 px at f = 530 px
RIGS = {
    "opencv": (lambda: foreign.rig_from_opencv(OPENCV, size=SIZE), 1e-9),
    "kalibr": (lambda: foreign.rig_from_kalibr(KALIBR), 1e-9),
    "ros": (lambda: foreign.rig_from_ros(*ROS), 2e-3),
}


@pytest.mark.parametrize("name", RIGS)
def test_a_rig_projects_as_opencv_does(name):
    read, tolerance_px = RIGS[name]
    rig = read()
    _, points = truth()
    for got, want in zip(rig.project(points), pixels_by_cv2(points), strict=True):
        assert np.abs(got - want).max() < tolerance_px
    assert rig.baseline_m == pytest.approx(0.0832, abs=5e-6)  # 83.2 mm: metres, and right is on the right
    assert rig.T_rig_right.translation[0] > 0.08
    assert (rig.left.width, rig.left.height) == SIZE


def test_what_we_write_opencv_reads(tmp_path):
    rig = foreign.rig_from_kalibr(KALIBR)
    foreign.rig_to_opencv(tmp_path / "pair.yml", rig)
    (M1, D1, M2, D2, R, T), _ = truth()
    for got, want in zip(
        by_cv2(tmp_path / "pair.yml", "M1", "D1", "M2", "D2", "R", "T"), (M1, D1, M2, D2, R, T), strict=True
    ):
        assert got.shape == want.shape
        assert np.abs(got - want).max() < 1e-12
    foreign.camera_to_opencv(tmp_path / "camera.yml", rig.left)
    assert np.array_equal(by_cv2(tmp_path / "camera.yml", "camera_matrix")[0], rig.left.matrix)


def test_the_pair_we_write_for_ros_rectifies_and_gives_the_depth(tmp_path):
    """What stereo_image_proc does with the files, done by OpenCV: equal rows, and Z = f B / d."""
    rig = foreign.rig_from_opencv(OPENCV, size=SIZE)
    left, right = tmp_path / "left.yaml", tmp_path / "right.yaml"
    foreign.rig_to_ros(left, right, rig, names=("l", "r"))
    _, points = truth()
    rectified = []
    for path, uv in zip((left, right), pixels_by_cv2(points), strict=True):
        content = read_yaml(path)
        K, D, R, P = (
            np.array(content[key]["data"]).reshape(content[key]["rows"], content[key]["cols"])
            for key in ("camera_matrix", "distortion_coefficients", "rectification_matrix", "projection_matrix")
        )
        rectified.append(cv2.undistortPointsIter(uv, K, D, R, P, (3, 100, 1e-12)).reshape(-1, 2))
        if path is left:
            Z = (points @ R.T)[:, 2]
    disparity = rectified[0][:, 0] - rectified[1][:, 0]
    assert np.abs(rectified[0][:, 1] - rectified[1][:, 1]).max() < 1e-6
    assert np.allclose(-P[0, 3] / disparity, Z, rtol=1e-7)


ROUND_TRIPS = {
    "opencv": (
        lambda folder, rig: foreign.rig_to_opencv(folder / "a", rig),
        lambda folder: foreign.rig_from_opencv([folder / "a"]),
    ),
    "ros": (
        lambda folder, rig: foreign.rig_to_ros(folder / "a", folder / "b", rig),
        lambda folder: foreign.rig_from_ros(folder / "a", folder / "b"),
    ),
    "kalibr": (
        lambda folder, rig: foreign.rig_to_kalibr(folder / "a", rig),
        lambda folder: foreign.rig_from_kalibr(folder / "a"),
    ),
}


@pytest.mark.parametrize("name", ROUND_TRIPS)
def test_round_trip(tmp_path, name):
    write, read = ROUND_TRIPS[name]
    rig = foreign.rig_from_opencv(OPENCV, size=SIZE)
    write(tmp_path, rig)
    back = read(tmp_path)
    for side in ("left", "right"):
        assert np.array_equal(back.camera(side).intrinsics, rig.camera(side).intrinsics)
    assert is_close(back.T_rig_right, rig.T_rig_right, tol_m=1e-13, tol_rad=1e-13)
    assert foreign.kind_of(tmp_path / "a") == name


def test_a_rig_whose_axes_are_not_the_left_cameras_keeps_its_geometry(tmp_path):
    rig = foreign.rig_from_opencv(OPENCV, size=SIZE)
    T = RigidTransform.from_components([1.0, 2.0, 3.0], Rotation.from_rotvec([0.4, -0.2, 0.7]))
    moved = replace(rig, T_rig_left=T * rig.T_rig_left, T_rig_right=T * rig.T_rig_right)
    for name, (write, read) in ROUND_TRIPS.items():
        (tmp_path / name).mkdir()
        write(tmp_path / name, moved)
        assert is_close(read(tmp_path / name).T_rig_right, rig.T_rig_right, tol_m=1e-13, tol_rad=1e-13)


def test_single_cameras(tmp_path):
    K, D = by_cv2(DATA / "opencv" / "camera.yml", "camera_matrix", "distortion_coefficients")
    camera = foreign.camera_from_opencv(DATA / "opencv" / "camera.yml")
    assert np.array_equal(camera.matrix, K)
    assert np.array_equal(camera.distortion, D.ravel())
    documented = foreign.camera_from_ros(DATA / "ros" / "documented.yaml")
    assert documented.distortion.tolist() == pytest.approx([0.018641, -0.080795, 0.00067016, -0.0018003, 0.0], rel=1e-4)
    assert (documented.width, documented.height, documented.matrix[1, 2]) == (640, 480, 246.2279496394374)
    first = foreign.camera_from_kalibr(DATA / "kalibr" / "documented.yaml")
    assert first.intrinsics[:4].tolist() == [461.629, 460.152, 362.680, 246.049]
    for write, read in (
        (foreign.camera_to_opencv, foreign.camera_from_opencv),
        (foreign.camera_to_ros, foreign.camera_from_ros),
        (foreign.camera_to_kalibr, foreign.camera_from_kalibr),
    ):
        write(tmp_path / "camera", camera)
        assert np.array_equal(read(tmp_path / "camera").intrinsics, camera.intrinsics)


def test_other_models_are_refused_by_name():
    with refuses(BadFile, "documented.yaml", "cam1", "nearest", "--approximate"):
        foreign.rig_from_kalibr(DATA / "kalibr" / "documented.yaml")
    content = read_yaml(ROS[0])
    with refuses(BadFile, "distortion_model", "thin_prism"):
        ros_rig({**content, "distortion_model": "thin_prism"}, content, "l", "r")
    with refuses(BadFile, "5 coefficients", "fisheye", "four"):
        ros_rig({**content, "distortion_model": "equidistant"}, content, "l", "r")
    bent = {**content, "distortion_coefficients": {"rows": 1, "cols": 8, "data": [0.0] * 5 + [10.0, -30.0, 60.0]}}
    with refuses(BadFile, "no ray", "pole", "armsight calibrate camera"):
        ros_camera(bent, "l")


def test_a_pair_that_is_swapped_or_none_is_recognised():
    with refuses(Inconsistent, "swapped"):
        foreign.rig_from_ros(ROS[1], ROS[0])
    single = DATA / "ros" / "documented.yaml"
    with refuses(Inconsistent, "single"):
        foreign.rig_from_ros(single, single)


def test_millimetres_are_recognised():
    content = {**read_yaml(OPENCV[0]), **read_yaml(OPENCV[1])}
    millimetres = {**content, "T": [[-83.19], [0.93], [-0.07]]}
    with refuses(BadFile, "83.1952 m", "millimetres"):
        opencv_rig(millimetres, "pair.yml", size=SIZE)
    rig = opencv_rig(millimetres, "pair.yml", size=SIZE, unit_m=1e-3)
    assert rig.baseline_m == pytest.approx(0.0832, abs=1e-5)


def test_what_a_file_does_not_say_is_asked_for():
    with refuses(BadFile, "size"):
        foreign.rig_from_opencv(OPENCV)
    with pytest.raises(BadFile, match=r"R is missing|no pair"):
        foreign.rig_from_opencv(OPENCV[:1], size=SIZE)
    with refuses(BadFile, "no pair"):
        foreign.rig_from_opencv([DATA / "opencv" / "camera.yml"])


def test_a_lens_that_a_format_cannot_say_is_not_written(tmp_path):
    rig = foreign.rig_from_opencv(OPENCV, size=SIZE)
    k3 = Camera(width=640, height=480, intrinsics=[*rig.left.intrinsics[:9], 0.01])
    with pytest.raises(Inconsistent, match=r"k3 0\.01"):
        foreign.rig_to_kalibr(tmp_path / "a", replace(rig, left=k3))
    skewed = Camera(width=640, height=480, intrinsics=[*rig.left.intrinsics[:4], 0.1, *rig.left.intrinsics[5:]])
    with pytest.raises(Inconsistent, match="skew"):
        foreign.rig_to_ros(tmp_path / "a", tmp_path / "b", replace(rig, left=skewed))
    larger = Camera(width=800, height=600, intrinsics=rig.left.intrinsics)
    for write, _ in (ROUND_TRIPS["ros"], ROUND_TRIPS["opencv"]):
        with refuses(Inconsistent, "size"):
            write(tmp_path, replace(rig, left=larger))
    assert not list(tmp_path.iterdir())


BROKEN = {
    "a matrix of another size": ("M1", {"rows": 2, "cols": 3, "data": [1.0] * 6}, ("M1", "(2, 3)")),
    "numbers missing": ("M1", {"rows": 3, "cols": 3, "data": [1.0] * 8}, ("M1", "8 numbers", "3 x 3")),
    "nan": ("T", [float("nan"), 0.0, 0.0], ("T", "finite")),
    "no rotation": ("R", (2 * np.eye(3)).tolist(), ("R", "rotation matrix")),
    "a mirror": ("R", np.diag([1.0, 1.0, -1.0]).tolist(), ("R", "rotation matrix")),
    "no baseline": ("T", [0.0, 0.0, 0.0], "0 m apart"),
    "no camera matrix": ("M2", np.ones((3, 3)).tolist(), ("M2", "camera matrix")),
    "words": ("D1", "plumb_bob", ("D1", "list")),
    "three coefficients": ("D1", [0.0, 0.0, 0.0], ("D1", "3 coefficients")),
    "tilted sensor": ("D2", [0.0] * 13 + [0.1], ("thin prism", "tilt", "px off", "--approximate")),
}


@pytest.mark.parametrize("case", BROKEN)
def test_a_broken_entry_is_named(case):
    key, value, message = BROKEN[case]
    content = {**read_yaml(OPENCV[0]), **read_yaml(OPENCV[1]), key: value}
    with refuses(BadFile, message) as caught:
        opencv_rig(content, "pair.yml", size=SIZE)
    assert caught.value.cause.startswith("pair.yml")


@pytest.mark.parametrize("name", ["opencv", "kalibr", "ros"])
def test_a_principal_point_that_no_lens_has_is_refused_by_every_reader(name, tmp_path):
    paths = {"opencv": OPENCV, "kalibr": (KALIBR,), "ros": ROS}[name]
    (tmp_path / name).write_text(re.sub(r"34[0-9]\.[0-9]+", "48422.5", paths[0].read_text(), count=1))
    bad = (tmp_path / name, *paths[1:])
    with refuses(BadFile, name, "cx", "48422.5 px"):
        {
            "opencv": lambda: foreign.rig_from_opencv(bad, size=SIZE),
            "kalibr": lambda: foreign.rig_from_kalibr(*bad),
            "ros": lambda: foreign.rig_from_ros(*bad),
        }[name]()


def test_a_window_in_the_corner_of_a_large_sensor_is_taken():
    assert Camera.pinhole(128, 96, 2000.0, 2000.0, -1900.0, 50.0).intrinsics[2] == -1900.0
    with refuses(Inconsistent, "cy", "2097", "outside"):
        Camera.pinhole(128, 96, 2000.0, 2000.0, -1900.0, 2097.0)
