"""Public files of cameras, by repository, commit and path: none is in this repository."""

from pathlib import Path
from typing import NamedTuple

import pytest

from armsight.errors import DataRefused, UsageError
from armsight.ops.conversion import load_camera, load_rig
from armsight.store.foreign import READ, Asked, kind_of
from public_files import public_file


class Public(NamedTuple):
    """A file, and what is read of it: baseline_mm of the first two cameras, None of one alone; or says: a refusal."""

    kind: str
    repository: str
    commit: str
    paths: tuple[str, ...]
    asked: Asked = Asked()
    baseline_mm: float | None = None
    says: tuple[str, ...] = ()


CALISCOPE = ("caliscope", "mprib/caliscope", "ddda95b4")
MATLAB = ("matlab", "huenguyen594/akat-stevi", "d1a2d9c3")
HD, MER = Asked(size=(1280, 720)), "src/bit_vision/model/camparMER.dat"
METASHAPE = ("metashape", "bilkos/AutoFTG-Scripts_Metashape-Pro", "dcda5d4d")
MULTICAL = ("multical", "CalebCurranVelasco/Northrop-Grumman-Field-Session", "3f95e183", ("multical/calibration.json",))
PAIR = ("intrinsics.yml", "extrinsics.yml")
MM = Asked(unit_m=1e-3)
FILES = (
    Public("ros", "ros-perception/image_common", "f6e4ab66", ("camera_info_manager/tests/test_calibration.yaml",)),
    Public("ros", "ros-drivers/usb_cam", "772b25f4", ("config/camera_info.yaml",)),
    Public("opencv", "Barry-Liang/stereoCalibrate", "1c3c1ad0", PAIR, Asked(size=(640, 480), unit_m=1e-3), 92.055),
    Public("opencv", "thaytan/stereo-calibration", "e43d3c36", PAIR, Asked(size=(640, 480), unit_m=1e-3), 60.747),
    Public("opencv", "czoido/stereo-camera-visualization", "8725eba8", PAIR, Asked(size=(640, 480)), says=("--unit",)),
    Public("kalibr", "rayykia/DTC_dect_loc", "daea1102", ("camchain.yaml",)),
    Public("kalibr", "aviralshastri/kalibr-data", "60c4300f", ("kalibr-camchain-imucam.yaml",)),
    Public("kalibr", "mrastgoo/camera_imu_calibration_kalibr_viper", "d109082a", ("camchain.yaml",)),
    Public("zed", "willdzeng/zed_cpu_ros", "78c93afc", ("config/SN1267.conf",), HD, 120.0),
    Public("zed", "zhanghanduo/zed_cpu_ros", "a3c09980", ("config/SN2358.conf",), HD, 119.997),
    Public(
        *("zed", "tokuda99/zed_cpu_ros2_wrapper", "e6de3e4a", ("config/calibration/SN20292994.conf",)),
        Asked(size=(2208, 1242)),
        120.023,
    ),
    Public(*MULTICAL, says=("1.29546 m apart", "--unit")),
    Public(*MULTICAL, Asked(unit_m=1.0), 1295.462),
    Public(
        *("multical", "Kechuan-ln/multical", "66b9b77d", ("intrinsic_hyperoff_linear_60fps.json",)),
        Asked(names=("cam2",)),
    ),
    Public(*METASHAPE, ("AutoFTG/cameras/Nokia-XR20_48MP_2022-12.xml",)),
    Public(*METASHAPE, ("AutoFTG/cameras/SAMPLE_DJI-Phantom-4-Advanced_20MP.xml",)),
    Public(*METASHAPE, ("AutoFTG/cameras/SAMPLE_DJI-Phantom-4-Pro2_20MP.xml",), says=("2.7 px", "--approximate")),
    Public(*METASHAPE, ("AutoFTG/cameras/SAMPLE_Fisheye.xml",), says=("fisheye",)),
    Public("halcon", "Justin-ma/HHWedldADS", "7a5c759c", ("camera_parameters.dat",)),
    Public("halcon", "gheini/BAT_halcon", "18c5f90b", ("camera_parameters.dat",)),
    Public("halcon", "moyang602/bit_mbzirc", "b74aabf4", (MER,)),
    Public("depthai", "luxonis/depthai", "8c6c58f0", ("depthai_calib.json",), Asked(names=("CAM_B", "CAM_C")), 73.789),
    Public(
        *("depthai", "luxonis/depthai-core", "af205967", ("examples/calib_data_v5.json",)),
        Asked(names=("CAM_B", "CAM_C")),
        74.468,
    ),
    Public(
        *("depthai", "alessandrocurci2002/depthai-ros", "edc01e85", ("oak_calib.json",)),
        Asked(names=("CAM_B", "CAM_C")),
        says=("tilt", "0.8 px", "--approximate"),
    ),
    Public("aniposelib", "Melokeo/AmbiguousMonkey", "7b7cb9fd", ("ammonkey/cfgs/calibration.toml",), MM, 437.938),
    Public("aniposelib", "dimitrov-hristo/Markerless-Tracking-GUI", "05814c98", ("calibration.toml",), MM, 1114.694),
    Public(*CALISCOPE, ("tests/reference/2d_data/camera_array.toml",), baseline_mm=453.808),
    Public(*CALISCOPE, ("tests/sessions/4_cam_recording/camera_array.toml",), Asked(unit_m=1.0), 1611.163),
    Public(
        *CALISCOPE,
        ("tests/sessions/point_estimate_creation/unlinked_camera/camera_array.toml",),
        says=("no pose of 1, 2, 3, 4, 5, 6",),
    ),
    Public(
        "realsense",
        "IUTRobotique/robotic-arm-computer-vision",
        "d2f83e2f",
        ("realsense_calibration.json",),
        Asked(names=("color",)),
    ),
    Public(
        *("realsense", "JerryChen1125/Explicit-Recovery-Behavior-Diffusion-Policy", "146e0cee"),
        ("realsense_intrinsics.json",),
        Asked(names=("231522072820-color",)),
    ),
    Public(*MATLAB, ("stereoParams.mat",), Asked(size=(1280, 960)), 77.499),
    Public(*MATLAB, ("stereoParams10.mat",), baseline_mm=73.015),
    Public("matlab", "LarryDong/HandEye-Tsai", "e5c94edd", ("cameraParams.mat",), says=("toStruct",)),
    Public("matlab", "ThreebodyDarkforest/StereoDepthMap", "73cc2679", ("stereoParams.mat",), says=("0 structs",)),
    Public("colmap", "plaxxma/Incremental-SfM", "42c7d3e7", ("sparse/cameras.txt",)),
    Public("colmap", "plaxxma/Incremental-SfM", "42c7d3e7", ("sparse_colmap/0/cameras.txt",)),
)


@pytest.mark.parametrize("one", FILES, ids=lambda one: f"{one.repository}:{one.paths[0]}")
def test_a_public_file_is_read_as_the_table_says(one, tmp_path):
    paths = [tmp_path / Path(path).name for path in one.paths]
    for path, inside in zip(paths, one.paths, strict=True):
        path.write_bytes(public_file(one.repository, one.commit, inside))
    assert kind_of(paths[0]) == one.kind
    if one.says:
        with pytest.raises((DataRefused, UsageError)) as raised:
            (load_camera(paths[0], one.asked) if one.kind == "metashape" else load_rig(paths, one.asked))
        assert all(said in str(raised.value) for said in one.says)
    elif one.baseline_mm is None:
        assert min(load_camera(paths[0], one.asked).intrinsics[:2]) > 100.0
    else:
        rig = load_rig(paths, one.asked)
        first, second, *_ = (camera.T_rig_camera.translation for camera in rig.cameras)
        assert 1000.0 * sum((second - first) ** 2) ** 0.5 == pytest.approx(one.baseline_mm, abs=0.01)


def test_the_table_names_kinds_that_are_read():
    assert {one.kind for one in FILES} <= set(READ)
