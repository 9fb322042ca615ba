"""A Universal Robot's factory calibration: against products of 4 x 4 matrices, and against a controller's own poses.

The frames of the ROS driver's YAML are made here as its program makes them: each link's turn and shift apart, the long
d of the two nearly parallel axes drawn in along the next axis (ur_calibration's algorithm), and its angles.
"""

import csv
import io

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from armsight.errors import ArmsightError, BadFile, Inconsistent, UsageError
from armsight.kinematics import fk, preset
from armsight.ops.arm_files import convert_arm, load_arm
from armsight.store.factory_arms import read_factory_arm
from public_files import public_file

# the deltas of ur_calibration's own test, calibration_test.cpp, of an UR10: (d, a, theta, alpha) of three arms
ARMS = {
    name: np.array(text.split(), float).reshape(4, 6)
    for name, text in {
        "short": """
0.00065609212979853 1.4442162376284788 0.854147723854608 -2.2989425877563705 -1.5734986868e-05 1.90724355e-05
4.6311376834935676e-05 -0.00012568315331862312 0.00186216581161458 9.918593870679266e-05 4.215462720453e-06 0
-7.290070070824746e-05 -0.01713897289704999 -0.03707159413492756 0.054279462160583214 1.48898425e-07 1.55149e-05
0.000211987863869334 -0.0072553625957652995 -0.013483226769541364 0.0013495820227329425 -0.001263136163679 0
""",
        "far": """
-0.000144894975118076141 303.469135666158195 -309.88394307789747 6.41459904397394975 -4.4823290e-05 -0.00087071
0.000108651068627930392 0.240324175250532346 0.00180628180213493472 2.63076149165684402e-05 3.966386325e-06 0
1.59613525316931737e-07 -0.917209621528830232 7.12936131346499469 0.0710299029424392298 -1.6425897e-06 9.1728e-08
-0.000444781952841921679 -0.00160215112531214153 0.00631917793331091861 -0.00165055247340828437 0.00076368251 0
""",
    }.items()
}
KEYS = ("delta_d", "delta_a", "delta_theta", "delta_alpha")


def conf(name, status=2, **changes):
    lists = dict(zip(KEYS, ARMS[name], strict=True)) | changes
    lines = [f"{key} = [ {', '.join(map(repr, map(float, lists[key])))}]" for key in lists]
    return "\n".join(["[mounting]", *lines, "joint_checksum = [ 0x9557c84f]", f"calibration_status = {status} # 2", ""])


def turn_z(angle):
    T = np.eye(4)
    T[:3, :3] = Rotation.from_euler("z", angle).as_matrix()
    return T


def rows_of(name, nominal):
    """Rows d, a, theta, alpha (6, 4) of the arm."""
    drawn = np.array([[j.d_m, j.a_m, j.theta_rad, j.alpha_rad] for j in nominal.joints])
    return drawn + ARMS[name].T


def by_products(rows, q):
    """The flange in the base, row by row: Rz(q + theta) z(d) x(a) Rx(alpha)."""
    T = np.eye(4)
    for (d, a, theta, alpha), value in zip(rows, q, strict=True):
        link = np.eye(4)
        link[:3, :3] = Rotation.from_euler("x", alpha).as_matrix()
        link[:3, 3] = a, 0.0, d
        T = T @ turn_z(value + theta) @ link
    return T


@pytest.mark.parametrize("name", ARMS)
def test_deltas_are_added_to_the_nominal_table(name, tmp_path):
    path = tmp_path / "calibration.conf"
    path.write_text(conf(name))
    nominal = preset("ur10")
    arm = load_arm(str(path), nominal)
    assert max(abs(joint.d_m) for joint in arm.joints) < 3.0, "no d of hundreds of metres"
    q = np.random.default_rng(1).uniform(-2, 2, (200, 6))
    wanted = np.array([by_products(rows_of(name, nominal), row) for row in q])
    assert np.abs(fk(arm, q) - wanted).max() < 1e-9
    assert arm.joints[0].upper == nominal.joints[0].upper


def drawn_in(rows):
    """The links of ur_calibration, each d/theta and a/alpha apart, with the long d of joints 2 and 3 drawn in."""
    chain = []
    for d, a, theta, alpha in rows:
        first = turn_z(theta)
        first[2, 3] = d
        second = np.eye(4)
        second[:3, :3] = Rotation.from_euler("x", alpha).as_matrix()
        second[0, 3] = a
        chain += [first, second]
    for link in (1, 2):
        passive = chain[2 * link] @ chain[2 * link + 1]
        along = passive[:3, 2]
        t = -passive[2, 3] / along[2]
        foot = passive[:3, 3] + t * along  # where the next axis meets the plane of this joint
        theta = np.arctan(foot[1] / foot[0])
        old = rows[link][2]
        chain[2 * link] = turn_z(theta)
        chain[2 * link + 1][:3, :3] = (
            Rotation.from_euler("z", old - theta) * Rotation.from_euler("x", rows[link][3])
        ).as_matrix()
        chain[2 * link + 1][0, 3] = -np.linalg.norm(foot)
        chain[2 * link + 2][2, 3] -= t
    return [chain[0], *(chain[k] @ chain[k + 1] for k in range(1, 11, 2))]


@pytest.mark.parametrize("name", ARMS)
def test_frames_of_the_ros_driver_are_the_same_arm(name, tmp_path):
    nominal = preset("ur10")
    frames = drawn_in(rows_of(name, nominal))
    lines = ["kinematics:"]
    for link, T in zip(("shoulder", "upper_arm", "forearm", "wrist_1", "wrist_2", "wrist_3"), frames, strict=True):
        angles = Rotation.from_matrix(T[:3, :3]).as_euler("XYZ")  # Eigen: eulerAngles(0, 1, 2)
        lines += [f"  {link}:", *(f"    {k}: {v!r}" for k, v in zip("xyz", T[:3, 3].tolist(), strict=True))]
        lines += [f"    {k}: {v!r}" for k, v in zip(("roll", "pitch", "yaw"), angles.tolist(), strict=True)]
    path = tmp_path / "my_robot_calibration.yaml"
    path.write_text("\n".join([*lines, "  hash: calib_1", ""]))
    arm = load_arm(str(path))
    assert arm.joints[2].name == "elbow_joint"
    q = np.random.default_rng(2).uniform(-2, 2, (200, 6))
    wanted = np.array([by_products(rows_of(name, nominal), row) for row in q])
    assert np.abs(fk(arm, q) - wanted).max() < 1e-9
    convert_arm(str(path), tmp_path / "arm.yaml")
    assert np.abs(fk(load_arm(str(tmp_path / "arm.yaml")), q) - wanted).max() < 1e-9


def test_a_controller_s_own_poses(tmp_path):
    """calibration.conf of a real UR5e and poses that its controller showed: 0.05 mm, nominal 1.1 mm."""
    repo = ("weijieyong/UR_kinematics_calib", "c4c579d2da6522528b75d64422b7fc58157cc077")
    (tmp_path / "calibration.conf").write_bytes(public_file(*repo, "configs/calibration.conf"))
    rows = list(csv.reader(io.StringIO(public_file(*repo, "data/joint-eef-data.csv").decode())))[1:]
    data = np.array([[float(cell) for cell in row] for row in rows])
    calibrated = load_arm(str(tmp_path / "calibration.conf"), preset("ur5e"))

    def off_mm(arm):
        T = fk(arm, np.deg2rad(data[:, :6]))
        return np.sqrt(np.mean(np.sum((T[:, :3, 3] * 1e3 - data[:, 6:9]) ** 2, axis=1)))

    assert off_mm(calibrated) < 0.06  # it shows 0.01 deg and 0.01 mm
    assert off_mm(preset("ur5e")) > 1.0


@pytest.mark.parametrize(
    ("repo", "commit", "path", "nominal"),
    [
        ("cambel/ur3-tools", "820707c1", "my_robot_calibration.yaml", "ur3e"),
        ("YongyuLiu03/ur10e_controller", "bfda7a27", "config/my_robot_calibration.yaml", "ur10e"),
    ],
)
def test_a_driver_s_yaml_of_a_real_robot_is_near_its_nominal_arm(repo, commit, path, nominal, tmp_path):
    (tmp_path / "robot.yaml").write_bytes(public_file(repo, commit, path))
    q = np.random.default_rng(3).uniform(-2, 2, (200, 6))
    off_m = np.linalg.norm((fk(load_arm(str(tmp_path / "robot.yaml")), q) - fk(preset(nominal), q))[:, :3, 3], axis=1)
    assert 2e-4 < np.sqrt(np.mean(off_m**2)) < 6e-3


@pytest.mark.parametrize(
    ("text", "nominal", "error", "match"),
    [
        (conf("far"), "kr6", Inconsistent, "another arm|from the nominal kr6"),
        (conf("far"), "iiwa14", UsageError, "plain"),
        (conf("far", status=1), "ur10", Inconsistent, "calibration_status is 1"),
        (conf("far", status=0), "ur10", Inconsistent, "calibration_status is 0"),
        (conf("far").replace("delta_d", "delta_e"), "ur10", BadFile, "delta_d"),
        (conf("far").replace("303.469", "303,469"), "ur10", BadFile, "6 numbers"),
        (conf("far", delta_a=(0.0,) * 5), "ur10", BadFile, "6 numbers"),
        ("[joint]\na = 3\n", "ur10", BadFile, "no delta_theta"),
    ],
)
def test_what_a_calibration_leaves_open_is_refused(text, nominal, error, match, tmp_path):
    path = tmp_path / "calibration.conf"
    path.write_text(text)
    with pytest.raises(error, match=match) as found:
        read_factory_arm(path, preset(nominal))
    assert found.value.cure


@pytest.mark.parametrize(
    "change", [("x: 0", "x: lost"), ("yaw:", "jaw:"), ("z: 0.1", "z: 151.9"), ("roll: 0", "roll: 90")]
)
def test_frames_that_cannot_be_are_refused(change, tmp_path):
    frame = "\n    x: 0\n    y: 0\n    z: 0.1\n    roll: 0\n    pitch: 0\n    yaw: 0"
    links = ("shoulder", "upper_arm", "forearm", "wrist_1", "wrist_2", "wrist_3")
    text = "kinematics:\n" + "\n".join(f"  {link}:{frame}" for link in links) + "\n"
    path = tmp_path / "kinematics.yaml"
    path.write_text(text.replace(*change, 1))
    with pytest.raises(ArmsightError) as found:
        load_arm(str(path))
    assert found.value.cure


ORIGINS = {  # xarm_ros, config/kinematics/default: x, y, z, roll of joints 1 ..
    "xarm6": (
        *((0, 0, 0.267, 0), (0, 0, 0, -1.5708), (0.0535, -0.2845, 0, 0)),
        *((0.0775, 0.3425, 0, -1.5708), (0, 0, 0, 1.5708), (0.076, 0.097, 0, -1.5708)),
    ),
    "xarm7": (
        *((0, 0, 0.267, 0), (0, 0, 0, -1.5708), (0, -0.293, 0, 1.5708), (0.0525, 0, 0, 1.5708)),
        *((0.0775, -0.3425, 0, 1.5708), (0, 0, 0, 1.5708), (0.076, 0.097, 0, -1.5708)),
    ),
}


@pytest.mark.parametrize("name", ORIGINS)
def test_an_xarms_frames_are_the_origins_of_its_description(name, tmp_path):
    rng = np.random.default_rng(4)
    frames = [
        (np.array([x, y, z]) + 1e-3 * rng.normal(size=3), np.array([roll, 0.0, 0.0]) + 4e-3 * rng.normal(size=3))
        for x, y, z, roll in ORIGINS[name]
    ]
    lines = ["kinematics:"]
    for k, (xyz, rpy) in enumerate(frames, 1):
        values = dict(zip(("x", "y", "z", "roll", "pitch", "yaw"), np.concatenate([xyz, rpy]).tolist(), strict=True))
        lines += [f"  joint{k}:", *(f"    {key}: {value!r}" for key, value in values.items())]
    path = tmp_path / f"{name}_kinematics_a1.yaml"
    path.write_text("\n".join(lines) + "\n")
    arm, q = load_arm(str(path)), rng.uniform(-2, 2, (50, len(frames)))
    for row, found in zip(q, fk(arm, q), strict=True):
        T = np.eye(4)
        for (xyz, (roll, pitch, yaw)), value in zip(frames, row, strict=True):
            origin = np.eye(4)
            turn = Rotation.from_euler("z", yaw) * Rotation.from_euler("y", pitch) * Rotation.from_euler("x", roll)
            origin[:3, :3], origin[:3, 3] = turn.as_matrix(), xyz
            T = T @ origin @ turn_z(value)
        assert np.abs(found - T).max() < 1e-9
    for kept in range(1, len(lines)):
        path.write_text("\n".join(lines[:kept]) + "\n")
        with pytest.raises(ArmsightError) as refused:
            load_arm(str(path))
        assert refused.value.cure


DH_TABLE = (  # tmr_ros2, modify_urdf.py, of a TM5-900
    "0,-90,0,145.2,0,-270,270,-90,0,429,0,0,-180,180,0,0,411.5,0,0,-155,155,90,90,0,-122.3,0,-180,180,"
    "0,90,0,106,0,-180,180,0,0,0,113.15,0,-270,270"
)


def test_a_techmans_differences_are_added_to_its_table(tmp_path):
    rng = np.random.default_rng(5)
    delta = rng.normal(size=(6, 5)) * (0.2, 0.1, 0.3, 0.4, 0.05)  # deg, deg, mm, mm, deg
    path = tmp_path / "tm5.txt"
    said = f"DHTable={{{DH_TABLE}}}\nDeltaDH={{{','.join(map(str, delta.ravel()))}}}\n"
    path.write_text(said)
    arm, q = load_arm(str(path)), rng.uniform(-2, 2, (50, 6))
    table = np.array([float(cell) for cell in DH_TABLE.split(",")]).reshape(6, 7)
    for row, found in zip(q, fk(arm, q), strict=True):
        T = np.eye(4)
        for (theta, alpha, a, d, *_), by, value in zip(table, delta, row, strict=True):
            link = np.eye(4)
            turn = Rotation.from_euler("x", alpha + by[1], degrees=True) * Rotation.from_euler("y", by[4], degrees=True)
            link[:3, :3], link[:3, 3] = turn.as_matrix(), (1e-3 * (a + by[2]), 0.0, 1e-3 * (d + by[3]))
            T = T @ turn_z(value + np.deg2rad(theta + by[0])) @ link
        assert np.abs(found - T).max() < 1e-9
    assert np.rad2deg(arm.joints[2].upper) == pytest.approx(155.0)
    in_m = ",".join(str(x) for x in (table * (1, 1, 1e-3, 1e-3, 1, 1, 1)).ravel())
    spoiled = (said.replace(DH_TABLE, in_m), said.replace("145.2,0,", "145.2,1,"), said.replace("-90", "-1.5708"))
    for text in (*spoiled, said.replace("DeltaDH", "delta"), 2 * said, said[:-30], said.replace("113.15", "113,15")):
        path.write_text(text)
        with pytest.raises(ArmsightError) as refused:
            load_arm(str(path))
        assert refused.value.cure
