"""Each line of docs/conventions.md, pinned by the test of its name."""

import re
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation
from scipy.special import ndtr

from armsight import store
from armsight.calibrate.cameras.calibrate import rms as calibration_rms
from armsight.geometry import compose_covariance, euler_rad, pose_difference, pose_from_euler, pose_from_quat, xyz_quat
from armsight.kinematics import Arm, Joint, JointType, dh_arm, fk
from armsight.measure.poses.pipeline import Setup, measure_pair
from armsight.measure.settings import SpotSettings
from armsight.measure.spots import find_spots
from armsight.optics import Camera, Rig, RigKind
from armsight.records import (
    CameraTiming,
    Frame,
    Points,
    PoseStatus,
    TargetKind,
    board_target,
    spot_target,
    unmeasured_target,
)
from armsight.records.target import BLUE, RED
from armsight.report.residuals import distance_rms
from armsight.store import covariances, tracks
from armsight.store.foreign import rig_from_kalibr
from armsight.store.urdf import arm_from_urdf
from armsight.units import DEG, MM
from armsight_sim.render import PointSource, render_sources

PAGE = Path(__file__).resolve().parents[2] / "docs" / "conventions.md"
CAMERA = Camera.pinhole(320, 240, 300.0, 310.0, 160.0, 120.0)
RIG = Rig(
    kind=RigKind.STEREO,
    left=CAMERA,
    right=CAMERA,
    T_rig_left=RigidTransform.identity(),
    T_rig_right=RigidTransform.from_translation([0.1, 0.0, 0.0]),
)


def test_every_line_has_a_test_and_every_test_a_line():
    lines = re.findall(r"^- \*\*(\w+)\*\*:", PAGE.read_text(encoding="utf-8"), re.MULTILINE)
    tests = [name.removeprefix("test_line_") for name in globals() if name.startswith("test_line_")]
    assert len(lines) == len(set(lines))
    assert sorted(lines) == sorted(tests)


def light(image_shape, uv_px, peak=200.0, sigma=1.5):
    """An image of Gaussian lights, each integrated over every pixel; written here, apart from product and renderer."""
    rows, columns = (np.arange(n)[:, None] + np.array([-0.5, 0.5]) for n in image_shape)
    out = np.full(image_shape, 10.0)
    for u, v in uv_px:
        along_u = np.diff(ndtr((columns - u) / sigma))[:, 0]
        along_v = np.diff(ndtr((rows - v) / sigma))[:, 0]
        out += peak * 2.0 * np.pi * sigma**2 * along_v[:, None] * along_u[None, :]
    return np.clip(np.rint(out), 0, 255).astype(np.uint8)


def seen_by_rig(points_m):
    """Measure lights at points_m (n, 3) in rig axes; pinholes projected here."""
    frames = []
    for side, x in (("left", 0.0), ("right", 0.1)):
        X = np.asarray(points_m) - (x, 0.0, 0.0)
        uv = np.stack([300.0 * X[:, 0] / X[:, 2] + 160.0, 310.0 * X[:, 1] / X[:, 2] + 120.0], axis=1)
        frames.append(Frame(image=light((240, 320), uv), t_s=0.0, sequence=0, source=side))
    return frames


def test_line_si():
    assert 1.0 * MM == 0.001
    assert pytest.approx(np.pi) == 180.0 * DEG
    points = Points(names=("A",), xyz_m=np.ones((1, 3), np.float32), covariance_m2=np.eye(3, dtype=np.float32)[None])
    assert points.xyz_m.dtype == points.covariance_m2.dtype == np.float64


def test_line_unit_in_the_name():
    words = {"spot", "camera", "status", "spots"}
    units = ("_m", "_rad", "_px", "_s")
    for column in {*covariances.POSE_COLUMNS, *tracks.POINT_COLUMNS, *tracks.SPOT_COLUMNS} - words:
        assert column.endswith(units) or re.fullmatch(r"q[xyzw]", column), column


def test_line_full_precision(tmp_path):
    rng = np.random.default_rng(0)
    camera = Camera(width=640, height=480, intrinsics=np.abs(rng.standard_normal(10)) * 10.0 ** rng.integers(-9, 3, 10))
    store.write_camera(tmp_path / "camera.yaml", camera)
    assert store.read_camera(tmp_path / "camera.yaml").intrinsics.tolist() == camera.intrinsics.tolist()


def test_line_rms():
    parts = [np.array([[3.0, 4.0]]), np.zeros((3, 2))]  # distances 5, 0, 0, 0
    assert distance_rms(parts) == pytest.approx(2.5)
    seen = np.array([[True, True], [True, True]])
    assert calibration_rms(np.array([[[3.0, 4.0], [0, 0]], [[0, 0], [0, 0]]]), seen) == pytest.approx(2.5)


def test_line_pose_name():
    T_world_camera = pose_from_euler([1.0, 0.0, 0.0], [0.0, 0.0, np.pi / 2])  # camera x is world y
    T_camera_target = RigidTransform.from_translation([2.0, 0.0, 0.0])
    T_world_target = T_world_camera * T_camera_target
    assert isinstance(T_world_target, RigidTransform)
    assert np.allclose(T_world_target.apply([0.0, 0.0, 0.0]), [1.0, 2.0, 0.0])
    assert np.allclose(RIG.T_rig_right.apply([0.0, 0.0, 0.0]), [0.1, 0.0, 0.0])  # the camera's centre in rig axes


def test_line_quaternion():
    half = np.sqrt(0.5)
    assert np.allclose(pose_from_quat([0, 0, 0], [0, 0, half, half]).apply([1.0, 0.0, 0.0]), [0.0, 1.0, 0.0])
    _, quat = xyz_quat(pose_from_quat([0, 0, 0], [0, 0, -half, -half]))
    assert np.allclose(quat, [0, 0, half, half])


def test_line_euler():
    rx, ry, rz = 0.3, -0.5, 1.1
    matrices = []
    for axis, angle in enumerate((rx, ry, rz)):
        i, j = (axis + 1) % 3, (axis + 2) % 3
        R = np.eye(3)
        R[i, i] = R[j, j] = np.cos(angle)
        R[i, j], R[j, i] = -np.sin(angle), np.sin(angle)
        matrices.append(R)
    R = matrices[2] @ matrices[1] @ matrices[0]
    assert np.allclose(pose_from_euler([0, 0, 0], [rx, ry, rz]).rotation.as_matrix(), R)
    assert np.allclose(euler_rad(Rotation.from_matrix(R)), [rx, ry, rz])


def test_line_covariance():
    T_a_b = pose_from_euler([0.1, 0.2, 0.3], [0.0, 0.0, np.pi / 2])
    perturbed = RigidTransform.from_components(
        np.add(T_a_b.translation, (1e-3, 0, 0)), Rotation.from_rotvec([0, 2e-3, 0]) * T_a_b.rotation
    )
    assert np.allclose(pose_difference(perturbed, T_a_b), [1e-3, 0, 0, 0, 2e-3, 0])
    # turning the parent about its z by rz moves a point 2 m along its x sideways: x of frame b is y of frame a
    rz = np.diag([0, 0, 0, 0, 0, 1e-6])
    moved = compose_covariance(T_a_b, rz, RigidTransform.from_translation([2.0, 0.0, 0.0]), np.zeros((6, 6)))
    assert np.allclose(np.diag(moved), [4e-6, 0, 0, 0, 0, 1e-6])


def test_line_position_only():
    points = np.array([[0.02, 0.0, 1.0], [0.06, 0.08, 1.0]])
    target = spot_target({"A": (0.0, -0.05, 0.0), "B": (0.04, 0.03, 0.0)})  # two lights as far apart as the points
    setup = Setup(rig=RIG, target=target, settings=SpotSettings())
    pose = measure_pair(setup, *seen_by_rig(points)).pose
    assert pose.status is PoseStatus.POSITION_ONLY
    assert np.allclose(pose.pose.translation, points.mean(axis=0), atol=2e-3)
    assert pose.covariance.shape == (3, 3)


def test_line_camera_axes():
    (centre, right, below, behind) = CAMERA.project([[0, 0, 1.0], [0.1, 0, 1.0], [0, 0.1, 1.0], [0, 0, -1.0]])
    assert np.allclose(centre, [160.0, 120.0])
    assert right[0] > centre[0]
    assert below[1] > centre[1]
    assert np.isnan(behind).all()


def test_line_pixel():
    image = light((40, 60), [(10.0, 5.0), (30.25, 20.0)])
    assert np.unravel_index(image.argmax(), image.shape) == (5, 10)
    found = find_spots(image, SpotSettings())
    assert sorted(np.round(found.uv_px, 2).tolist()) == [[10.0, 5.0], [30.25, 20.0]]
    # the simulated world renders by the same rule
    source = PointSource(uv_px=np.array([[10.0, 5.0]]), flux=np.array([2000.0]), sigma_px=1.5, bgr=np.ones(1))
    patch = render_sources(np.zeros((40, 60, 1), np.float32), [source])
    row, column = np.unravel_index(patch.light[:, :, 0].argmax(), patch.light.shape[:2])
    assert (row + patch.row, column + patch.column) == (5, 10)


def test_line_colour():
    image = np.full((120, 160, 3), 20, np.uint8)
    cv2.circle(image, (40, 60), 8, (0, 0, 230), -1)  # red in BGR
    cv2.circle(image, (120, 60), 8, (230, 0, 0), -1)
    for colour, u in ((RED, 40.0), (BLUE, 120.0)):
        found = find_spots(image, SpotSettings(colour=colour))
        assert np.allclose(found.uv_px, [[u, 60.0]], atol=0.5)


def test_line_lens():
    K, D = [500.0, 510.0, 320.0, 240.0], [-0.3, 0.1, 0.002, -0.003, 0.05]
    points = np.random.default_rng(0).uniform((-0.4, -0.3, 0.9), (0.4, 0.3, 1.1), (30, 3))
    matrix = np.array([[K[0], 0, K[2]], [0, K[1], K[3]], [0, 0, 1]])
    want = cv2.projectPoints(points, np.zeros(3), np.zeros(3), matrix, np.array(D))[0].reshape(-1, 2)
    plain = Camera.pinhole(640, 480, *K, distortion=D)
    skewed = Camera.pinhole(640, 480, *K, skew=2.0, distortion=D)
    assert np.allclose(plain.project(points), want, atol=1e-9)
    yd = (want[:, 1] - K[3]) / K[1]
    assert np.allclose(skewed.project(points) - want, np.stack([2.0 * yd, 0 * yd], axis=1), atol=1e-9)


def test_line_left_right():
    left, right = RIG.project([[0.0, 0.0, 1.0]])
    assert left[0, 0] > right[0, 0]  # the right camera sees things further left
    folder = Path(__file__).resolve().parents[1] / "golden" / "data" / "foreign"
    rig = rig_from_kalibr(folder / "kalibr" / "camchain.yaml")
    assert rig.T_rig_right.translation[0] > 0.0
    assert np.allclose(rig.T_rig_left.as_matrix(), np.eye(4))


def test_line_board():
    board = board_target(TargetKind.CHECKERBOARD, 3, 2, 0.025)
    assert board.xyz_m.tolist() == [[0.025 * c, 0.025 * r, 0.0] for r in range(2) for c in range(3)]
    assert board.names[4] == "r1c1"
    charuco = board_target(TargetKind.CHARUCO, 8, 5, 0.04, marker_m=0.03, dictionary="DICT_4X4_50")
    assert len(charuco.names) == 7 * 4
    # seen upright by a camera, x right and y down leave z pointing away from the viewer
    uv = CAMERA.project(np.add(board.xyz_m, (0.0, 0.0, 1.0)))
    assert uv[1, 0] > uv[0, 0]
    assert uv[3, 1] > uv[0, 1]


def test_line_unmeasured_target():
    points = np.array([[-0.06, 0.0, 1.0], [0.03, 0.04, 1.0], [0.03, -0.04, 1.0]])
    setup = Setup(rig=RIG, target=unmeasured_target(), settings=SpotSettings())
    measured = measure_pair(setup, *seen_by_rig(points))
    assert measured.pose.status is PoseStatus.OK
    order = [measured.names.index(name) for name in "ABC"]
    assert np.allclose(measured.points.xyz_m[order], points, atol=2e-3)
    pose = measured.pose.pose
    assert np.allclose(pose.translation, points.mean(axis=0), atol=2e-3)
    assert np.allclose(pose.rotation.as_matrix(), np.eye(3), atol=0.03)  # u right, v down, w away from the camera


def test_line_base():
    limit = '<limit lower="-1" upper="1"/></joint>'
    text = (
        '<robot name="r"><link name="floor"/><link name="arm"/><joint name="j" type="revolute"><parent link="floor"/>'
        f'<child link="arm"/><origin xyz="0.2 0.1 0.5" rpy="1 0 0"/><axis xyz="0 0 1"/>{limit}</robot>'
    )
    arm = arm_from_urdf(text)
    assert arm.base_link == "floor"
    assert np.allclose(arm.T_world_base.as_matrix(), np.eye(4))
    assert np.allclose(arm.T_base_frame0.translation, [0.2, 0.1, 0.5])
    assert np.allclose(fk(arm, [0.3])[:3, 3], [0.2, 0.1, 0.5])
    table = dh_arm("a", [(0.1, 0.0, 0.2, 0.0)])
    assert np.allclose(table.T_base_frame0.as_matrix(), np.eye(4))


def test_line_dh():
    theta, d, a, alpha = 0.4, 0.3, 0.2, -0.7

    def turn(axis, angle):
        T = np.eye(4)
        T[:3, :3] = Rotation.from_rotvec(angle * np.eye(3)["xyz".index(axis)]).as_matrix()
        return T

    def shift(axis, length):
        T = np.eye(4)
        T["xyz".index(axis), 3] = length
        return T

    want = turn("z", theta) @ shift("z", d) @ shift("x", a) @ turn("x", alpha)
    assert np.allclose(fk(dh_arm("one", [(a, alpha, d, 0.0)]), [theta]), want)
    parts = {"name": "j1", "a_m": a, "alpha_rad": alpha, "d_m": d, "beta_rad": 0.1}
    bent = Arm(name="one", joints=(Joint(**parts),))
    assert np.allclose(fk(bent, [theta]), want @ turn("y", 0.1))
    craig = Arm(name="one", joints=(Joint(**parts),), convention="craig")
    proximal = shift("x", a) @ turn("x", alpha) @ turn("y", 0.1) @ turn("z", theta) @ shift("z", d)
    assert np.allclose(fk(craig, [theta]), proximal)


def test_line_joint_value():
    turning = Arm(name="r", joints=(Joint(name="j", theta_rad=0.25, sign=-1.0),))
    assert np.allclose(fk(turning, [0.1])[:3, :3], Rotation.from_rotvec([0, 0, 0.15]).as_matrix())
    sliding = Arm(name="p", joints=(Joint(name="j", type=JointType.PRISMATIC, d_m=0.25, sign=-1.0),))
    assert np.allclose(fk(sliding, [0.1])[:3, 3], [0, 0, 0.15])


def test_line_frame_time():
    timing = CameraTiming(readout_s=0.02, delay_s=0.5, drift_ppm=100.0)
    assert timing.line_time([0.0, 239.0], 240) == pytest.approx([-0.01, 0.01])
    assert timing.line_time(119.5, 240) == pytest.approx(0.0)
    assert timing.rig_time([0.0, 1000.0]) == pytest.approx([0.5, 1000.6])
