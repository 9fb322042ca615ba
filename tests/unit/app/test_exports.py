"""Calibrations and recordings for other programs, read back by OpenCV, by the bag's reader, or by hand."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.calibrate.handeye import Setup
from armsight.errors import UsageError
from armsight.geometry import is_close
from armsight.ops.conversion import convert_handeye, convert_rig
from armsight.ops.recording.export import export
from armsight.ops.sources.bags import joint_states
from armsight.optics import Camera, Rig, RigKind
from armsight.records import Frame, JointReading, PoseStatus, TargetPose
from armsight.store import write_rig
from armsight.store.bags import IMAGE, BagTopic
from armsight.store.foreign import FrameNames
from armsight.store.handeye_file import write_handeye_poses
from armsight.store.recording import ImageFormat, RecordingWriter, encode
from armsight.store.yamls import read_yaml
from refusals import refuses

CAMERA = Camera.pinhole(640, 480, 612.5, 611.0, 318.2, 241.7, distortion=(-0.21, 0.07, 1e-4, -2e-4, 0.01))
RIG = Rig(
    kind=RigKind.STEREO,
    left=CAMERA,
    right=Camera.pinhole(640, 480, 615.0, 614.0, 322.0, 238.0, distortion=(-0.2, 0.06, 0.0, 1e-4, 0.0)),
    T_rig_left=RigidTransform.identity(),
    T_rig_right=RigidTransform.from_components([0.12, 0.001, -0.002], Rotation.from_rotvec([0.01, -0.05, 0.002])),
)
X = RigidTransform.from_components([0.03, -0.05, 0.11], Rotation.from_rotvec([0.1, -0.2, 1.5]))
Y = RigidTransform.from_components([0.6, 0.1, 0.02], Rotation.from_rotvec([0.02, 3.0, 0.1]))
ORIGIN_NS = 1_700_000_000_000_000_000


@pytest.fixture
def rig_file(tmp_path: Path) -> Path:
    write_rig(tmp_path / "rig.yaml", RIG)
    return tmp_path / "rig.yaml"


def test_opencv_gets_what_its_own_sample_writes(rig_file: Path, tmp_path: Path) -> None:
    convert_rig([rig_file], [tmp_path / "cv.yml"], to="opencv")
    storage = cv2.FileStorage(str(tmp_path / "cv.yml"), cv2.FILE_STORAGE_READ)
    names = ("M1", "D1", "M2", "D2", "R", "R1", "R2", "P1", "P2", "Q", "E", "F")
    got = {name: storage.getNode(name).mat() for name in names}
    points = np.random.default_rng(1).uniform((-0.2, -0.2, 0.8), (0.2, 0.2, 1.4), (30, 3))
    uv = [np.asarray(view) for view in RIG.project(points)]
    ideal = [
        cv2.undistortPoints(uv[k].reshape(-1, 1, 2), got[f"M{k + 1}"], got[f"D{k + 1}"], P=got[f"M{k + 1}"])[:, 0]
        for k in (0, 1)
    ]
    ones = np.ones((30, 1))
    lines = np.hstack([ideal[1], ones]) @ got["F"]  # (n, 3) of x_right^T F
    off_px = np.abs((lines * np.hstack([ideal[0], ones])).sum(axis=1)) / np.linalg.norm(lines[:, :2], axis=1)
    assert off_px.max() < 1e-3
    rays = [
        np.hstack([(one - M[:2, 2]) / (M[0, 0], M[1, 1]), ones])
        for one, M in zip(ideal, (got["M1"], got["M2"]), strict=True)
    ]
    assert np.abs(np.einsum("ni,ij,nj->n", rays[1], got["E"], rays[0])).max() < 1e-6
    flat = [
        cv2.undistortPoints(uv[k].reshape(-1, 1, 2), got[f"M{k + 1}"], got[f"D{k + 1}"], R=got[f"R{k + 1}"],
                            P=got[f"P{k + 1}"])[:, 0]
        for k in (0, 1)
    ]  # fmt: skip
    disparity = flat[0][:, 0] - flat[1][:, 0]
    back = np.column_stack([flat[0], disparity, np.ones(30)]) @ got["Q"].T
    np.testing.assert_allclose(back[:, :3] / back[:, 3:] @ got["R1"], points, atol=1e-5)


def transforms(path: Path) -> dict[tuple[str, str], RigidTransform]:
    found = {}
    for node in ET.parse(path).getroot():
        assert (node.get("pkg"), node.get("exec")) == ("tf2_ros", "static_transform_publisher")
        words = (node.get("args") or "").split()
        args = dict(zip(words[::2], words[1::2], strict=True))
        xyz, quat = ([float(args[f"--{name}"]) for name in names] for names in ("xyz", ("qx", "qy", "qz", "qw")))
        found[args["--frame-id"], args["--child-frame-id"]] = RigidTransform.from_components(
            xyz, Rotation.from_quat(quat)
        )
    return found


def test_ros_gets_the_pair_and_where_the_cameras_are(rig_file: Path, tmp_path: Path) -> None:
    outs = [tmp_path / "l.yaml", tmp_path / "r.yaml", tmp_path / "tf.launch.xml"]
    convert_rig([rig_file], outs, to="ros")
    found = transforms(outs[2])
    assert is_close(found["rig", "right"], RIG.T_rig_right, tol_m=1e-12, tol_rad=1e-12)
    with pytest.raises(UsageError, match="4 output"):
        convert_rig([rig_file], [*outs, tmp_path / "x"], to="ros")


@pytest.mark.parametrize("setup", list(Setup))
def test_a_hand_eye_calibration_goes_to_ros(setup: Setup, tmp_path: Path) -> None:
    write_handeye_poses(tmp_path / "handeye.yaml", setup, X, Y)
    in_hand = setup is Setup.EYE_IN_HAND
    names = FrameNames(base="base", flange="flange", camera="cam", target="board")
    for kind in ("easy_handeye", "easy_handeye2", "tf"):
        convert_handeye(tmp_path / "handeye.yaml", tmp_path / kind, to=kind, names=names)
    first, second = read_yaml(tmp_path / "easy_handeye"), read_yaml(tmp_path / "easy_handeye2")
    assert first["parameters"]["eye_on_hand"] is in_hand
    assert first["parameters"]["robot_effector_frame"] == "flange"
    assert second["parameters"]["calibration_type"] == ("eye_in_hand" if in_hand else "eye_on_base")
    for values in (first["transformation"], {**second["transform"]["translation"]}):
        np.testing.assert_allclose([values[name] for name in "xyz"], X.translation, atol=1e-12)
    quat = [first["transformation"][name] for name in ("qx", "qy", "qz", "qw")]
    assert quat == [second["transform"]["rotation"][name] for name in "xyzw"]
    np.testing.assert_allclose(Rotation.from_quat(quat).as_matrix(), X.rotation.as_matrix(), atol=1e-12)
    found = transforms(tmp_path / "tf")
    parents = ("flange", "base") if in_hand else ("base", "flange")
    assert is_close(found[parents[0], "cam"], X, tol_m=1e-12, tol_rad=1e-12)
    assert is_close(found[parents[1], "board"], Y, tol_m=1e-12, tol_rad=1e-12)
    with refuses(UsageError, "easy_handeye2", "tf"):
        convert_handeye(tmp_path / "handeye.yaml", tmp_path / "x", to="kalibr", names=names)


def recorded(path: Path, rig_file: Path | None = None) -> list[Frame]:
    rng = np.random.default_rng(2)
    frames = []
    with RecordingWriter(path, origin_ns=ORIGIN_NS) as writer:
        if rig_file is not None:
            writer.attach("rig.yaml", rig_file.read_bytes())
        for k in range(4):
            image = rng.integers(0, 256, (480, 640), dtype=np.uint8)
            frames.append(Frame(image=image, t_s=0.1 * k, sequence=k, source="camera", exposure_s=0.004))
            writer.frame("left", frames[-1], encode(image, ImageFormat.RAW))
            writer.joints(JointReading(q=np.array([0.1 * k, 0.2]), t_s=0.1 * k, sequence=k, source="robot"))
            pose = TargetPose(
                t_s=0.1 * k,
                status=PoseStatus.OK,
                parent="rig",
                T_parent_target=X.as_matrix(),
                covariance=np.eye(6) * 1e-8,
            )
            writer.pose(pose)
    return frames


def test_a_recording_becomes_a_bag_that_is_read_like_any_other(tmp_path: Path, rig_file: Path) -> None:
    frames = recorded(tmp_path / "a.mcap", rig_file)
    done = export(tmp_path / "a.mcap", tmp_path / "bag", to="rosbag2")
    assert done.n == {
        "/left/image_raw": 4, "/left/camera_info": 4, "/joint_states": 4, "/target/pose": 4,
    }  # fmt: skip
    with BagTopic(f"bag:{tmp_path / 'bag'}:/left/image_raw", (IMAGE,)) as topic:
        assert topic.origin_ns == ORIGIN_NS
        for want, got in zip(frames, topic.frames(colour=False), strict=True):
            np.testing.assert_array_equal(got.image, want.image)
            assert got.t_s == pytest.approx(want.t_s, abs=1e-9)
    states = joint_states(f"bag:{tmp_path / 'bag'}:/joint_states")
    assert states.names == ("q1", "q2")
    np.testing.assert_allclose(states.motion.q[:, 0], [0.0, 0.1, 0.2, 0.3])
    with refuses(UsageError, "already"):
        export(tmp_path / "a.mcap", tmp_path / "bag", to="rosbag2")
