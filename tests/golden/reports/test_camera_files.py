"""Strangers' calibrations of cameras as OpenCV 4 and 5, ROS and devices write them, right and in other units."""

import numpy as np
import pytest

import armsight
from armsight.errors import BadFile
from armsight.ops.conversion import convert_rig, load_camera, load_rig
from armsight.optics import LensKind
from armsight.store.foreign import Asked
from refusals import refuses
from reports import case


@pytest.mark.parametrize("name", ["m.yml", "vec.yml", "cam.yml", "m.xml", "m.json"])
@pytest.mark.parametrize("version", ["v4", "v5"])
def test_what_opencv_writes_is_read(version, name):
    folder = case("camera-files")
    name = f"{version}_{name}" if name.endswith("yml") else f"{version}.{name.split('.')[1]}"
    if "cam" in name:
        assert load_camera(folder / name).intrinsics[:4].tolist() == [700.0, 700.0, 640.0, 360.0]
        return
    rig = load_rig([folder / name])
    assert 1e3 * rig.baseline_m == pytest.approx(120.003, abs=1e-3)
    assert rig.right.intrinsics[[5, 6, 7, 8]].tolist() == [-0.17, 0.026, 0.0003, -0.0002]


@pytest.mark.parametrize(
    ("names", "unit_m", "right_mm"),
    [
        (["oak_cm.yml"], 0.01, 75.001),
        (["endo_mm.yml"], 0.001, 4.2),
        (["squares.yml"], 0.025, 60.0),
        (["v5_cm.yml"], 0.01, 120.003),
        (["v4_mm.yml"], 0.001, 120.003),
        (["../cameras-09/left.yaml", "../cameras-09/right.yaml"], 0.001, 60.0),
    ],
)
def test_lengths_in_another_unit_are_asked_for_and_the_cure_works(names, unit_m, right_mm, tmp_path):
    files = [case("camera-files") / name for name in names]
    with refuses(BadFile, "apart", f"--unit {unit_m}" if unit_m in (0.001,) else "--unit"):
        convert_rig(files, [tmp_path / "rig.yaml"])
    assert not (tmp_path / "rig.yaml").exists()
    convert_rig(files, [tmp_path / "rig.yaml"], asked=Asked(unit_m=unit_m))
    assert 1e3 * load_rig([tmp_path / "rig.yaml"]).baseline_m == pytest.approx(right_mm, abs=0.01)


def test_four_coefficients_of_a_wide_lens_are_asked_for_and_the_cure_works(tmp_path):
    file = case("camera-files") / "fe.yml"
    with refuses(BadFile, "D1", "four coefficients", "distortion_model: equidistant"):
        load_rig([file])
    (tmp_path / "fe.yml").write_text(file.read_text() + "distortion_model: equidistant\n")
    assert load_rig([tmp_path / "fe.yml"]).left.lens is LensKind.FISHEYE
    (tmp_path / "pi.yml").write_text(file.read_text() + "distortion_model: plumb_bob\n")
    assert load_rig([tmp_path / "pi.yml"]).left.lens is LensKind.PINHOLE


def test_a_rational_lens_is_read_as_it_is(tmp_path):
    import cv2

    folder = case("cameras-20")
    convert_rig([folder / "left.yaml", folder / "right.yaml"], [tmp_path / "rig.yaml"])
    K = np.array([[798.2, 0, 641.7], [0, 798.4, 402.6], [0, 0, 1]])
    k = np.array([2.31, -6.02, 0.00031, -0.00049, 2.87, 2.19, -5.71, 2.52])
    x, y = np.meshgrid(np.linspace(-0.7, 0.7, 15), np.linspace(-0.4, 0.4, 9))
    rays = np.column_stack([x.ravel(), y.ravel(), np.ones(x.size)])
    right = cv2.projectPoints(rays, np.zeros(3), np.zeros(3), K, k)[0].reshape(-1, 2)
    inside = ((right > 0.0) & (right < [1279.0, 799.0])).all(axis=1)
    off = np.linalg.norm(load_rig([tmp_path / "rig.yaml"]).left.project(rays) - right, axis=1)[inside]
    assert off.max() < 1e-8


@pytest.mark.parametrize("kind", ["r", "e", "f"])
def test_camera_info_is_read_from_files_messages_and_streams(kind):
    folder = case("camera-files")
    rig = load_rig([folder / f"{kind}_l.yaml", folder / f"{kind}_r.yaml"])
    assert 1e3 * rig.baseline_m == pytest.approx(120.0, abs=1e-6)
    assert rig.left.intrinsics[:4].tolist() == [700.0, 701.0, 640.0, 360.0]
    assert rig.left.intrinsics[[5, 6, 7, 8]].tolist() == [-0.17, 0.026, 0.0003, -0.0002]


def test_a_stream_of_two_cameras_and_binned_images_are_refused(tmp_path):
    folder = case("camera-files")
    one, other = ((folder / f"f_{side}.yaml").read_text() for side in "lr")
    for text, says in (
        (f"{one}---\n{other}", "Keep one message"),
        (one.replace("binning_x: 0", "binning_x: 2"), "binned"),
        (one.replace("  height: 0\n  width: 0", "  height: 480\n  width: 640"), "part"),
    ):
        (tmp_path / "info.yaml").write_text(text)
        with refuses(BadFile, says):
            load_camera(tmp_path / "info.yaml")
    (tmp_path / "info.yaml").write_text(f"{one}---\n{one}")
    assert load_camera(tmp_path / "info.yaml").width == 1280
    ros1 = one.replace("\nd:", "\nD:").replace("\nk:", "\nK:").replace("\nr:", "\nR:").replace("\np:", "\nP:")
    (tmp_path / "info.yaml").write_text(ros1)
    assert load_camera(tmp_path / "info.yaml").height == 720


def test_a_rotation_vector_is_one_and_a_zed_without_rays_is_refused_by_cause():
    folder = case("camera-files")
    rig = load_rig([folder / "tr_r.yml"])
    assert 0.0 < np.linalg.norm(rig.T_rig_right.rotation.as_rotvec()) < 0.2
    with refuses(BadFile, "D_LEFT", "no ray"):
        convert_rig([folder / "zed_calibration_1234.yml"], [folder / "never.yaml"], asked=Asked(unit_m=0.001))


def test_python_warns_of_what_the_command_tells():
    with pytest.warns(UserWarning, match="nearest"):
        armsight.read_rig(case("camera-files") / "k_fov.yaml")
