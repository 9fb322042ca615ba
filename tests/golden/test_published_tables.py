"""Tables as other programs write them (data/tables/README.md), each read by one command as it comes."""

import json
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.store import read_joints, read_poses
from armsight.store.arm_points import read_arm_points
from armsight.store.handeye_file import read_pairs, read_robot_poses
from armsight.store.interpret import OURS, TableFormat

DATA = Path(__file__).parent / "data" / "tables"
TRUTH = {name: np.array(value) for name, value in json.loads((DATA / "truth.json").read_text()).items()}
POSE_FILES = {
    "TUM RGB-D": ("tum/groundtruth.txt", ()),
    "EuRoC MAV": ("euroc/data.csv", ()),
    "UR RTDE record": ("rtde/robot_data.csv", ()),
    "Tabb robot_cali": ("robot_cali/robot_cali.txt", ("--units", "mm")),
    "7-Scenes": ("seven_scenes", ()),
}
PAIR_FILES = {
    "MoveIt Calibration": "moveit/samples.yaml",
    "easy_handeye2": "easy_handeye2/cell.samples",
    "MATLAB": "poses.mat",
}


@pytest.mark.parametrize("name", POSE_FILES)
def test_poses_are_read_by_one_command(name, armsight, tmp_path):
    file, options = POSE_FILES[name]
    done = armsight("convert", "table", DATA / file, *options, "--as", "poses", "-o", tmp_path / "poses.csv")
    assert done.code == 0, done.json
    poses = read_poses(tmp_path / "poses.csv")
    np.testing.assert_allclose([p.T_parent_target for p in poses], TRUTH["T_base_flange"], atol=1e-9)
    timed = "column of time" not in str(done.json["notes"])
    want = TRUTH["t_s"] if timed else np.arange(len(poses))
    np.testing.assert_allclose([p.t_s for p in poses], want, atol=1e-4, rtol=0)
    assert timed == (name in ("TUM RGB-D", "EuRoC MAV", "UR RTDE record"))


@pytest.mark.parametrize("name", PAIR_FILES)
def test_a_hand_eye_calibration_reads_samples_as_they_are_saved(name, armsight, tmp_path):
    pairs = read_pairs(DATA / PAIR_FILES[name])
    np.testing.assert_allclose(pairs.T_base_flange.as_matrix(), TRUTH["T_base_flange"], atol=1e-9)
    np.testing.assert_allclose(pairs.T_camera_target.as_matrix(), TRUTH["T_camera_target"], atol=1e-9)
    done = armsight("calibrate", "handeye", "--pairs", DATA / PAIR_FILES[name], "-o", tmp_path / "handeye.yaml")
    assert done.code == 0, done.json
    got = done.json["T_flange_camera"]
    np.testing.assert_allclose(got["xyz_m"], TRUTH["T_flange_camera"][:3, 3], atol=1e-6)


def test_joints_of_a_ros_joint_state_take_the_order_of_the_arm(armsight, tmp_path):
    names = [f"{name}_joint" for name in ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")]
    file = DATA / "rostopic" / "joint_states.csv"
    motion = read_joints(file, TableFormat(joints=tuple(names)))
    np.testing.assert_allclose(motion.q, TRUTH["q"], atol=1e-9)
    np.testing.assert_allclose(motion.t_s, TRUTH["t_s"], atol=1e-6, rtol=0)
    done = armsight("convert", "table", file, "--as", "joints", "-o", tmp_path / "joints.csv")
    assert done.code == 3  # without the arm nobody knows that elbow is not the first joint
    assert "--arm" in done.json["error"]["cure"]


def test_joints_of_the_rtde_recorder_are_the_measured_ones():
    motion = read_joints(DATA / "rtde" / "robot_data.csv")
    np.testing.assert_allclose(motion.q, TRUTH["q"], atol=1e-9)


def test_a_table_of_a_laser_tracker_without_header():
    points = read_arm_points(DATA / "tracker" / "data.txt", TableFormat(columns="q1..q6_deg,xyz_mm"))
    np.testing.assert_allclose(points.q, TRUTH["q"], atol=1e-9)
    np.testing.assert_allclose(points.xyz_m, TRUTH["T_base_flange"][:, :3, 3], atol=1e-9)


def test_kuka_poses_with_semicolons_and_decimal_commas():
    told = []
    poses = read_poses(DATA / "kuka" / "points.csv", format_=TableFormat(robot="kuka", notify=told.append), timed=False)
    T = np.array([pose.T_parent_target for pose in poses])
    np.testing.assert_allclose(T[:, :3, :3], json.loads((DATA / "kuka" / "truth.json").read_text()), atol=1e-9)
    np.testing.assert_allclose(T[:, :3, 3], TRUTH["T_base_flange"][:, :3, 3], atol=1e-9)
    assert any("zyx-rotating" in text for text in told)


def test_poses_without_names_go_to_the_images_by_number_or_by_order():
    images = [f"rgb_{k:04d}.png" for k in range(12)]
    by_number = read_robot_poses(DATA / "seven_scenes", images=images)
    by_order = read_robot_poses(DATA / "robot_cali" / "robot_cali.txt", TableFormat(units="mm"), images=images)
    for found in (by_number, by_order):
        T = RigidTransform.concatenate([found[name] for name in images])
        np.testing.assert_allclose(T.as_matrix(), TRUTH["T_base_flange"], atol=1e-9)


# the products of rotations that RoboDK's public converters write out (robomath, Apache-2.0): X_2_Pose
MAKERS = {
    "kuka": ("a,b,c", "zyx"),
    "fanuc": ("w,p,r", "xyz-fixed"),
    "yaskawa": ("rx,ry,rz", "xyz-fixed"),
    "staubli": ("rx,ry,rz", "xyz"),
    "kawasaki": ("o,a,t", "zyz"),
}


@pytest.mark.parametrize("maker", MAKERS)
def test_a_makers_angles_are_products_of_elementary_rotations(maker, tmp_path):
    names, order = MAKERS[maker]
    angles = np.random.default_rng(3).uniform([-170, 5, -170], [170, 85, 170], (6, 3))
    rows = "\n".join(f"500,1,2,{a},{b},{c}" for a, b, c in angles)
    (tmp_path / "p.csv").write_text(f"X,Y,Z,{names.upper()}\n{rows}\n")
    axes, fixed = order[:3], order.endswith("fixed")
    parts = [Rotation.from_rotvec(np.radians(angles[:, [k]]) * np.eye(3)["xyz".index(axes[k])]) for k in range(3)]
    want = parts[2] * parts[1] * parts[0] if fixed else parts[0] * parts[1] * parts[2]
    got = read_poses(tmp_path / "p.csv", format_=TableFormat(robot=maker), timed=False)
    T = np.array([pose.T_parent_target for pose in got])
    np.testing.assert_allclose(T[:, :3, :3], want.as_matrix(), atol=1e-12)


def test_abb_quaternions_have_the_scalar_first(tmp_path):
    (tmp_path / "p.csv").write_text("x,y,z,q1,q2,q3,q4\n600,0,500,0.6,0.8,0,0\n600,0,500,1,0,0,0\n")
    first = read_poses(tmp_path / "p.csv", format_=TableFormat(robot="abb"), timed=False)[0]
    want = Rotation.from_quat([0.8, 0.0, 0.0, 0.6]).as_matrix()
    np.testing.assert_allclose(first.T_parent_target[:3, :3], want, atol=1e-12)
    assert read_poses(tmp_path / "p.csv", format_=TableFormat(robot="abb"), timed=False)[1].T_parent_target[0, 3] == 0.6
    assert OURS.maker is None


@pytest.mark.parametrize(("scale", "q", "says"), [(1.0, 90, "--units deg"), (1000.0, 1, "x_mm")])
def test_a_table_in_our_own_columns_is_held_to_their_units(tmp_path, armsight, scale, q, says):
    rows = [f"{1 + i % 2},{q * i / 20},0.1,{0.5 * scale},{0.01 * i * scale},0.3" for i in range(20)]
    (tmp_path / "sweep.csv").write_text("\n".join(["joint,q1,q2,x_m,y_m,z_m", *rows]) + "\n")
    done = armsight("convert", "table", tmp_path / "sweep.csv", "--as", "sweep", "-o", tmp_path / "out.csv")
    assert done.code == 3 and says in done.text and not (tmp_path / "out.csv").exists()


def test_an_empty_column_is_told(tmp_path, armsight):
    (tmp_path / "j.csv").write_text("t_s,q1,q2\n" + "".join(f"{i / 10},{i / 10},\n" for i in range(9)))
    done = armsight("convert", "table", tmp_path / "j.csv", "--as", "joints")
    assert done.code == 0 and [note for note in done.json["notes"] if "q2" in note and "empty" in note]
