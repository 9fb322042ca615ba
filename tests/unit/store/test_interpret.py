"""Tables that contradict themselves or leave something open are refused with what they look like, never guessed."""

from pathlib import Path

import numpy as np
import pytest
from scipy.io import savemat
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.errors import Ambiguous, ArmsightError, BadFile, Inconsistent, NotEnoughData, UsageError
from armsight.store import read_joints, read_poses
from armsight.store.arm_points import read_arm_points, read_sweeps
from armsight.store.handeye_file import read_pairs, read_robot_poses
from armsight.store.interpret import OURS, TableFormat
from armsight.store.interpret.read import interpret
from refusals import refuses

RNG = np.random.default_rng(7)
QUAT = "0,0,0,1"


@pytest.fixture
def file(tmp_path: Path):
    def write(text: str, name: str = "table.csv") -> Path:
        (tmp_path / name).write_text(text)
        return tmp_path / name

    return write


def rows(*columns: np.ndarray) -> str:
    return "\n".join(",".join(repr(float(cell)) for cell in row) for row in np.column_stack(columns)) + "\n"


def test_degrees_where_radians_are_said_are_told(file) -> None:
    path = file("t_s,q1,q2\n0,172.4,3\n1,10,20\n")
    with refuses(Inconsistent, "degrees", "172.4") as refused:
        read_joints(path)
    assert "q1_deg" in refused.value.cure and "--units deg" in refused.value.cure
    assert read_joints(path, TableFormat(units="deg")).q[0, 0] == pytest.approx(np.radians(172.4))
    assert read_joints(path, TableFormat(as_stated=True)).q[0, 0] == 172.4
    for reader, header in ((read_arm_points, "q1,q2,x_m,y_m,z_m"), (read_sweeps, "joint,q1,x_m,y_m,z_m")):
        with refuses(Inconsistent, "degrees"):
            reader(file(f"{header}\n1,172.4,0.1,0.2,0.3\n"))


def test_radians_where_degrees_are_said_are_told(file) -> None:
    q = RNG.uniform(-1.5, 1.5, (8, 3))
    path = file("q1_deg,q2_deg,q3_deg\n" + rows(q))
    with refuses(Inconsistent, "like radians"):
        read_joints(path, timed=False)
    assert read_joints(path, TableFormat(as_stated=True), timed=False).q[0, 0] == pytest.approx(np.radians(q[0, 0]))
    few = file("q1_deg,q2_deg\n0.5,1.0\n0.2,0.1\n")  # two rows near zero are nothing odd
    assert read_joints(few, timed=False).q.shape == (2, 2)


def test_mm_and_m_are_told_apart(file) -> None:
    xyz = RNG.uniform(0.2, 0.9, (6, 3))
    with refuses(Inconsistent, "mm or cm"):
        read_poses(file("t_s,x,y,z,qx,qy,qz,qw\n" + f"0,612,20,300,{QUAT}\n"))
    with pytest.raises(Inconsistent, match="612 m") as refused:  # and not told to be named x_mm, which they are
        read_poses(file("t_s,x_mm,y_mm,z_mm,qx,qy,qz,qw\n" + f"0,612000,20,300,{QUAT}\n"))
    assert "_mm" not in refused.value.cure
    with refuses(Inconsistent, "like metres"):
        read_arm_points(file("q1,x_mm,y_mm,z_mm\n" + rows(np.zeros(6), xyz)))
    points = read_arm_points(file("q1,x_mm,y_mm,z_mm\n" + rows(np.zeros(6), 1e3 * xyz)))
    np.testing.assert_allclose(points.xyz_m, xyz, atol=1e-15)
    with refuses(Inconsistent, "mm"):
        read_robot_poses(file(f"file,x_m,y_m,z_m,qx,qy,qz,qw\na.png,600,20,300,{QUAT}\n"))


@pytest.mark.parametrize("names", ["rx_deg,ry_deg,rz_deg", "A,B,C", "rx,ry,rz"])
def test_angles_without_an_order_are_refused(file, names: str) -> None:
    with pytest.raises((Ambiguous, BadFile)) as refused:
        read_poses(file(f"t_s,x_mm,y_mm,z_mm,{names}\n0,500,20,300,0.1,0.2,0.3\n"))
    assert names == "A,B,C" or "--euler" in refused.value.cure


def test_an_order_that_the_numbers_contradict_is_told(file) -> None:
    angles = np.column_stack([RNG.uniform(-170, 170, 30), RNG.uniform(-80, 80, 30), RNG.uniform(-170, 170, 30)])
    text = "x_mm,y_mm,z_mm,rx_deg,ry_deg,rz_deg\n" + rows(np.full((30, 3), 500.0), angles)
    good = read_poses(file(text), format_=TableFormat(euler="xyz-fixed"), timed=False)
    want = Rotation.from_euler("xyz", angles, degrees=True).as_matrix()
    np.testing.assert_allclose([p.T_parent_target[:3, :3] for p in good], want, atol=1e-12)
    with refuses(Inconsistent, "another order"):
        read_poses(file(text), format_=TableFormat(euler="yxz"), timed=False)
    vectors = text.replace("rx_deg,ry_deg,rz_deg", "rotvec_x_deg,rotvec_y_deg,rotvec_z_deg").replace("170", "169")
    big = vectors + "500.0,500.0,500.0,300,200,160\n"
    with refuses(Inconsistent, "Euler"):
        read_poses(file(big), timed=False)


def test_a_place_of_three_equal_coordinates_is_one_and_a_fill_far_off_is_none(file) -> None:
    places = [(500.0, 500.0, 500.0), (300.0, 400.0, 350.0), (500.0, 500.0, 500.0), (450.0, 380.0, 410.0)]
    header = "x_mm,y_mm,z_mm,qx,qy,qz,qw\n"
    turns = [(0.1 * k, 0.0, 0.0, np.sqrt(1.0 - 0.01 * k**2)) for k in range(1, 7)]

    def text(xyz: list[tuple[float, ...]]) -> str:
        return header + "".join(
            ",".join(map(repr, map(float, (*a, *b)))) + "\n" for a, b in zip(xyz, turns, strict=False)
        )

    assert len([p for p in read_poses(file(text(places)), timed=False) if p.T_parent_target is not None]) == 4
    gone = [*places[1:], (-9999.0, -9999.0, -9999.0), (-9999.0, -9999.0, -9999.0)]
    assert len([p for p in read_poses(file(text(gone)), timed=False) if p.T_parent_target is not None]) == 3


def test_roll_pitch_yaw_are_ros_angles_and_said_to_be(file) -> None:
    told: list[str] = []
    path = file("t,x,y,z,roll,pitch,yaw\n0,0.5,0.2,0.3,0.1,0.2,0.3\n")
    pose = read_poses(path, format_=TableFormat(notify=told.append))[0]
    want = Rotation.from_euler("xyz", [0.1, 0.2, 0.3]).as_matrix()
    np.testing.assert_allclose(pose.T_parent_target[:3, :3], want, atol=1e-12)
    assert any("ROS" in text for text in told)


def test_matrices_say_themselves_how_they_are_flattened(file) -> None:
    T = RigidTransform.from_components([0.5, 0.2, 0.3], Rotation.from_rotvec([0.4, -0.2, 1.0])).as_matrix()
    for flat in (T.ravel(), T.T.ravel(), T[:3].ravel()):
        pose = read_poses(file(rows(flat[None])), timed=False)[0]
        np.testing.assert_allclose(pose.T_parent_target, T, atol=1e-12)
    bare = T.copy()
    bare[:3, 3] = 0.0
    with refuses(Ambiguous, "row by row"):
        read_poses(file(rows(bare.ravel()[None])), timed=False)
    broken = T.copy()
    broken[0, 0] += 0.1
    with refuses(BadFile, "line 1", "nine"):
        read_poses(file(rows(broken.ravel()[None])), timed=False)


def test_two_columns_for_one_coordinate_are_not_guessed(file) -> None:
    with refuses(Ambiguous, "same coordinate"):
        read_arm_points(file("q1,x_mm,y_mm,z_mm,laser_x_mm,laser_y_mm,laser_z_mm\n0,500,1,2,500,1,2\n"))
    points = read_arm_points(
        file("q1,x_mm,y_mm,z_mm,laser_x_mm,laser_y_mm,laser_z_mm\n0,500,1,2,600,1,2\n", "b.csv"),
        TableFormat(columns="q1,-,-,-,xyz_mm"),
    )
    assert points.xyz_m[0, 0] == pytest.approx(0.6)
    assert read_arm_points(file("q1,x_mm,y_mm,z_mm,target_x_mm\n0,500,1,2,9\n", "c.csv")).xyz_m[0, 0] == 0.5


def test_times(file) -> None:
    ns = read_poses(file(f"timestamp,x,y,z,qx,qy,qz,qw\n1403636580838555648,1,2,3,{QUAT}\n"))[0]
    assert ns.t_s == pytest.approx(1403636580.8385556, abs=1e-6)
    ms = read_poses(file(f"time [ms],x_m,y_m,z_m,qx,qy,qz,qw\n1500,1,2,3,{QUAT}\n"))[0]
    assert ms.t_s == 1.5
    path = file(f"x_m,y_m,z_m,qx,qy,qz,qw\n1,2,3,{QUAT}\n1,2,4,{QUAT}\n")
    assert [pose.t_s for pose in read_poses(path, timed=False)] == [0.0, 1.0]
    with refuses(BadFile, "t_s", "missing"):
        read_poses(path)


def test_matlab_and_its_versions(tmp_path: Path) -> None:
    q, xyz = RNG.uniform(-90, 90, (9, 6)), RNG.uniform(100, 900, (9, 3))
    savemat(tmp_path / "named.mat", {"q_deg": q, "xyz_mm": xyz.T})
    savemat(tmp_path / "bare.mat", {"data": np.column_stack([q, xyz])})
    for points in (
        read_arm_points(tmp_path / "named.mat"),
        read_arm_points(tmp_path / "bare.mat", TableFormat(columns="q1..q6_deg,xyz_mm")),
    ):
        np.testing.assert_allclose(points.q, np.radians(q))
        np.testing.assert_allclose(points.xyz_m, 1e-3 * xyz)
    (tmp_path / "new.mat").write_bytes(b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM" + b"\x89HDF\r\n")
    (tmp_path / "none.mat").write_bytes(b"nothing")
    for name in ("new.mat", "none.mat"):
        with pytest.raises(BadFile):
            read_arm_points(tmp_path / name)


def test_poses_the_other_way_round_are_inverted_where_the_names_say_so(file) -> None:
    T = RigidTransform.from_components([0.5, 0.2, 0.3], Rotation.from_rotvec([0.4, -0.2, 1.0]))
    cells = ",".join(repr(float(v)) for v in [*T.translation, *T.rotation.as_quat()])
    pose = ["x_m", "y_m", "z_m", "qx", "qy", "qz", "qw"]
    header = ",".join(f"{frame}_{name}" for frame in ("gripper2base", "target_camera") for name in pose)
    pairs = read_pairs(file(f"{header}\n" + 4 * f"{cells},{cells}\n"))
    np.testing.assert_allclose(pairs.T_base_flange[0].as_matrix(), T.as_matrix(), atol=1e-12)
    np.testing.assert_allclose(pairs.T_camera_target[0].as_matrix(), T.inv().as_matrix(), atol=1e-12)


def test_ros_messages_as_they_are_echoed(file) -> None:
    message = (
        "header:\n  stamp: {sec: 12, nanosec: 500000000}\npose:\n  position: {x: 0.5, y: 0.1, z: 0.2}\n"
        "  orientation: {x: 0, y: 0, z: 0, w: 1}\n---\n"
    )
    poses = read_poses(file(message + message.replace("12", "13"), "echo.yaml"))
    assert [pose.t_s for pose in poses] == [12.5, 13.5]
    states = "header:\n  stamp: {secs: 1, nsecs: 0}\nname: [b, a]\nposition: [0.1, 0.2]\nvelocity: []\neffort: []\n"
    assert read_joints(file(states, "js.yaml"), TableFormat(joints=("a", "b"))).q.tolist() == [[0.2, 0.1]]
    with refuses(BadFile, "w", "first"):
        read_poses(file("- {xyz_m: [1, 2, 3], quat: [1, 0, 0, 0]}\n", "list.yaml"), timed=False)
    listed = read_poses(file("- {xyz_m: [1, 2, 3], quat_wxyz: [1, 0, 0, 0]}\n", "list.yaml"), timed=False)
    np.testing.assert_allclose(listed[0].T_parent_target[:3, :3], np.eye(3))


@pytest.mark.parametrize(
    ("text", "options", "kind"),
    [
        ("1 2 3\n4 5\n", {}, BadFile),
        ("t_s,x,y\n", {}, NotEnoughData),
        ("1,2,3,0,0,0,1\n", {}, BadFile),
        ("1,2,3,0,0,0,1\n", {"columns": "xyz_m,qx"}, BadFile),
        ("1,2,3,0,0,0,1\n", {"euler": "xxz"}, UsageError),
        ("1,2,3,2,0,0,1\n", {"columns": "xyz_m,quat_xyzw"}, BadFile),
        ("- {a: 1}\n- {b: 2}\n", {}, BadFile),
        ("[1, 2", {}, ArmsightError),
    ],
)
def test_what_cannot_be_read_is_refused(file, text: str, options: dict[str, str], kind: type[Exception]) -> None:
    with pytest.raises(kind):
        read_poses(file(text, "t.txt"), format_=TableFormat(**options), timed=False)


def test_a_table_of_ours_is_left_as_it_is(file) -> None:
    text = "t_s,q1,q2\n0,1,2\n"
    found = interpret(file(text), "joints", OURS)
    assert found.data == text.encode() and found.notes == ()
    with refuses(BadFile, "t_s", "mean"):
        read_joints(file("t_x,t_s,q1\n0,1,2\n"))


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("commas.csv", "q1,x_m,y_m,z_m,point\n0.1,0.5,0.25,1.5,A\n0.2,0.5,0.25,1.5,\n"),
        ("marked.csv", "q1;x_m;y_m;z_m;point;\n0,1;0,5;0,25;1,5;A;\n0,2;0,5;0,25;1,5;;\n"),
        ("records.json", '[{"q1": 0.1, "x_m": 0.5, "y_m": 0.25, "z_m": 1.5, "point": "A"},'
         ' {"q1": 0.2, "x_m": 0.5, "y_m": 0.25, "z_m": 1.5, "point": "B"}]'),
    ],
)  # fmt: skip
def test_our_columns_are_read_however_their_cells_are_apart(tmp_path: Path, name: str, text: str) -> None:
    (tmp_path / name).write_text(text, newline="")
    points = read_arm_points(tmp_path / name)
    np.testing.assert_array_equal(points.q[:, 0], [0.1, 0.2])
    np.testing.assert_array_equal(points.xyz_m, [[0.5, 0.25, 1.5]] * 2)
    assert points.point in (("A", ""), ("A", "B"))


COLUMNS = "x,y,z,x,y,z,w"
LEVELS = {
    "levels and index named": ("body,{b}\nkind,{k}\naxis,{a}\nt_s,,,,,,,\n", ("0.0,", "0.1,")),
    "index named": (",{b}\n,{k}\n,{a}\nt_s,,,,,,,\n", ("0.0,", "0.1,")),
    "no index": ("{b}\n{k}\n{a}\n", ("", "")),
}
"""Texts of pandas 2.2.3: DataFrame.to_csv with three levels of columns."""


@pytest.mark.parametrize("name", LEVELS)
def test_columns_of_several_levels_are_read_as_pandas_writes_them(file, name: str) -> None:
    head, times = LEVELS[name]
    said = head.format(b=",".join(["Tool"] * 7), k=",".join(["position"] * 3 + ["rotation"] * 4), a=COLUMNS)
    path = file(said + "".join(f"{t}0.1,0.2,0.3,0.0,0.0,0.6,0.8\n" for t in times))
    for pose in read_poses(path, timed=bool(times[0])):
        T = RigidTransform.from_matrix(pose.T_parent_target)
        assert np.allclose(T.translation, [0.1, 0.2, 0.3])
        assert np.allclose(T.rotation.as_quat(), [0.0, 0.0, 0.6, 0.8])


def test_joints_counted_by_a_level_are_read(file) -> None:
    read = read_joints(file(",q,q,q\n,1,2,3\nt_s,,,\n0.0,0.1,0.2,0.3\n0.1,0.2,0.3,0.4\n"))
    assert read.q.tolist() == [[0.1, 0.2, 0.3], [0.2, 0.3, 0.4]]


def test_a_first_row_of_words_is_no_header(file) -> None:
    with refuses(BadFile, "lost"):
        read_joints(file("t_s,q1,q2\n0,0.1,0.2\nlost,lost,lost\n1,0.2,0.3\n"))
