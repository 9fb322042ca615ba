"""Path tools against numbers worked out by hand, and the check of a path for an arm."""

import math

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.control.guard import Box, JointLimit, Limits
from armsight.control.paths import PathTrouble, check_path, corners, filleted, resampled
from armsight.kinematics import pose, preset
from armsight.records import TaughtPath

DOWN = Rotation.from_rotvec([math.pi, 0.0, 0.0])


def path_through(xyz, rotation=None, **more):
    xyz = np.asarray(xyz, float)
    turns = Rotation.from_quat(np.tile(DOWN.as_quat(), (len(xyz), 1))) if rotation is None else rotation
    return TaughtPath.of_poses(RigidTransform.from_components(xyz, turns), **more)


L_SHAPE = path_through([[0, 0, 0], [0.1, 0, 0], [0.1, 0.1, 0]])


def test_resampled_rows_are_even_and_the_corner_is_kept():
    made = resampled(L_SHAPE, 0.03)  # legs of 0.1 m: four steps of 0.025 m each
    x = [0, 0.025, 0.05, 0.075, 0.1, 0.1, 0.1, 0.1, 0.1]
    assert np.allclose(made.xyz_m, np.stack([x, x[:1] * 5 + [0.025, 0.05, 0.075, 0.1], [0] * 9], axis=1), atol=1e-15)


def test_corners_of_a_trapezium_are_found_through_noise():
    legs = np.array([[0, 0, 0], [0.2, 0, 0], [0.15, 0.1, 0], [0.05, 0.1, 0], [0, 0, 0]])
    dense = resampled(path_through(legs), 0.002, keep=(1, 2, 3))
    noise = np.random.default_rng(4).normal(0, 1e-4, dense.xyz_m.shape)
    found = corners(path_through(dense.xyz_m + noise))
    assert len(found) == 3
    assert np.linalg.norm(dense.xyz_m[list(found)] - legs[1:4], axis=1).max() < 0.005


def test_a_fillet_of_a_right_angle():
    made = filleted(L_SHAPE, 0.02)
    # centre (0.08, 0.02): touches the legs at (0.08, 0) and (0.1, 0.02); 18 steps of 5 deg
    assert len(made) == 2 + 19
    arc = made.xyz_m[1:-1]
    assert np.allclose(arc[0], [0.08, 0, 0]) and np.allclose(arc[-1], [0.1, 0.02, 0])
    assert np.allclose(np.linalg.norm(arc - [0.08, 0.02, 0], axis=1), 0.02)


ARM = preset("irb120")
HOME = np.array([0.1, 0.2, 0.1, 0.2, 0.9, 0.3])


def line(way=(0.0, 0.1, 0.0), rows=21, **more):
    T = pose(ARM, HOME).as_matrix()
    poses = np.repeat(T[None], rows, axis=0)
    poses[:, :3, 3] += np.linspace(0, 1, rows)[:, None] * np.array(way)
    return TaughtPath.of_poses(RigidTransform.from_matrix(poses), **more)


def troubles(check):
    return {issue.trouble for issue in check.issues}


def test_a_good_path_passes_and_its_readings_reach_it():
    path = line()
    check = check_path(path, ARM, Limits(), start=HOME)
    assert check.ok and len(check.q) == 21
    assert np.allclose(pose(ARM, check.q).as_matrix(), path.T_world_tip, atol=1e-6)
    assert check.t_s[-1] == pytest.approx(1.0)  # 0.1 m at 0.1 m/s


def test_a_path_out_of_reach_names_its_rows():
    check = check_path(line((0.0, 2.0, 0.0), 41), ARM, Limits(), start=HOME)
    rows = [issue.row for issue in check.issues if issue.trouble is PathTrouble.UNREACHED]
    assert not check.ok and rows == list(range(len(check.q), 41))


def test_speeds_of_tool_and_joints_are_held_to_the_limits():
    assert PathTrouble.SPEED in troubles(check_path(line(), ARM, Limits(), speed_m_s=0.2, start=HOME))
    slow = Limits(joints=(JointLimit(speed=0.01),) * 6)
    assert troubles(check_path(line(), ARM, slow, start=HOME)) == {PathTrouble.JOINT_SPEED}


def test_a_joint_range_of_the_limits_is_kept():
    tight = Limits(joints=(JointLimit(lower=-1.0, upper=0.12), *(JointLimit(),) * 5))
    check = check_path(line(), ARM, tight, start=HOME)
    assert troubles(check) == {PathTrouble.LIMITS} and check.issues[-1].row == 20


def test_boxes_are_kept_between_rows_too():
    tip = line().xyz_m
    thin = Box(lower_m=tip[0] + [-0.1, 0.04, -0.1], upper_m=tip[0] + [0.1, 0.041, 0.1], name="fence")
    two = line(rows=2)  # neither row is in the fence
    check = check_path(two, ARM, Limits(forbidden=(thin,)), start=HOME)
    assert {(i.trouble, i.row) for i in check.issues if "tool" in i.text} == {(PathTrouble.FORBIDDEN, 1)}
    room = Box(lower_m=tip[0] - 1.0, upper_m=tip[0] + [1.0, 0.07, 1.0])
    found = check_path(line(), ARM, Limits(workspace=room), start=HOME)
    first = min(i.row for i in found.issues if "tool" in i.text)
    assert first == 14  # 0.07 m less the margin of 0.005 is passed at row 14 (0.070 m)


def test_a_singular_path_is_told():
    q = np.repeat(HOME[None], 11, axis=0)
    q[:, 4] = np.linspace(0.1, -0.1, 11)
    check = check_path(TaughtPath.of_poses(pose(ARM, q)), ARM, Limits(), start=q[0])
    assert PathTrouble.SINGULAR in troubles(check)
