"""Path tools against numbers worked out by hand and the path before noise was put on it, and the check for an arm."""

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial import cKDTree
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.control.guard import Box, JointLimit, Limits
from armsight.control.paths import (
    PathTrouble,
    check_path,
    corners,
    filleted,
    joined,
    moved_by,
    offset_along_tool,
    outliers,
    resampled,
    reversed_path,
    smoothed,
    tilted,
    without_rows,
)
from armsight.errors import Inconsistent, NotEnoughData
from armsight.kinematics import pose, preset
from armsight.records import TaughtPath

DOWN = Rotation.from_rotvec([math.pi, 0.0, 0.0])
TAGS = ("", "weld_on", "weld_off")
LEGS = np.array([[0, 0, 0], [0.2, 0, 0], [0.15, 0.1, 0], [0.05, 0.1, 0], [0, 0, 0]])


def path_through(xyz, rotation=DOWN, **more):
    turns = Rotation.from_quat(np.tile(rotation.as_quat(), (len(xyz), 1)))
    path = TaughtPath.of_poses(RigidTransform.from_components(np.asarray(xyz, float), turns))
    return replace(path, **more)


L_SHAPE = path_through([[0, 0, 0], [0.1, 0, 0], [0.1, 0.1, 0]])
ALONG_X = path_through([[0, 0, 0], [0.1, 0, 0], [0.2, 0, 0]], tags=TAGS)


def test_resampled_rows_are_even_and_the_corner_is_kept():
    made = resampled(L_SHAPE, 0.03)  # legs of 0.1 m: four steps of 0.025 m each
    x = [0, 0.025, 0.05, 0.075, 0.1, 0.1, 0.1, 0.1, 0.1]
    assert np.allclose(made.xyz_m, np.stack([x, x[:1] * 5 + [0.025, 0.05, 0.075, 0.1], [0] * 9], axis=1), atol=1e-15)


def test_a_fillet_of_a_right_angle():
    made = filleted(L_SHAPE, 0.02)
    # centre (0.08, 0.02): touches the legs at (0.08, 0) and (0.1, 0.02); 18 steps of 5 deg
    assert len(made) == 2 + 19
    arc = made.xyz_m[1:-1]
    assert np.allclose(arc[0], [0.08, 0, 0]) and np.allclose(arc[-1], [0.1, 0.02, 0])
    assert np.allclose(np.linalg.norm(arc - [0.08, 0.02, 0], axis=1), 0.02)


def test_offset_goes_along_the_tool():
    made = offset_along_tool(ALONG_X, -0.01)  # the tool points down: back is up
    assert np.allclose(made.xyz_m, np.add(ALONG_X.xyz_m, [0, 0, 0.01])) and made.tags == TAGS


def test_a_travel_angle_points_the_tool_ahead_and_keeps_the_tip():
    made = tilted(ALONG_X, travel_rad=math.radians(15))
    assert np.allclose(made.T_world_tip[:, :3, 2], [math.sin(math.radians(15)), 0, -math.cos(math.radians(15))])
    assert np.array_equal(made.xyz_m, ALONG_X.xyz_m) and made.tags == TAGS


def test_a_work_angle_turns_about_the_path():
    made = tilted(ALONG_X, work_rad=math.radians(30))  # about +x: -z goes to +y
    assert np.allclose(made.T_world_tip[:, :3, 2], [0, 0.5, -math.sqrt(0.75)])


def test_reversal_welds_the_same_stretch_at_the_same_speed():
    path = replace(ALONG_X, speed_m_s=np.array([0.1, 0.02, 0.1]), t_s=np.array([0.0, 1.0, 2.0]))
    made = reversed_path(path)
    assert made.tags == ("weld_on", "weld_off", "")
    assert made.speed_m_s[:2].tolist() == [0.02, 0.1]  # the stretch from 0.1 to 0.2 m is still passed at 0.02 m/s
    assert np.array_equal(made.xyz_m, path.xyz_m[::-1]) and np.isnan(made.t_s).all()


def test_joining_leaves_the_double_row_out():
    second = replace(path_through([[0.2, 0, 0], [0.2, 0.1, 0]]), tags=("", "end"))
    made = joined(ALONG_X, second)
    assert made.xyz_m.tolist() == [[0, 0, 0], [0.1, 0, 0], [0.2, 0, 0], [0.2, 0.1, 0]]
    assert made.tags == (*TAGS, "end")


@pytest.mark.parametrize(
    "second",
    [
        path_through([[0.202, 0, 0], [0.3, 0, 0]]),
        path_through([[0.2, 0, 0], [0.3, 0, 0]], Rotation.identity()),
        replace(path_through([[0.2, 0, 0], [0.3, 0, 0]]), parent="base"),
        replace(path_through([[0.2, 0, 0], [0.3, 0, 0]]), tags=("weld_on", "")),
    ],
    ids=["apart", "turned", "other frame", "two tags"],
)
def test_ends_that_do_not_meet_are_refused(second):
    with pytest.raises(Inconsistent):
        joined(ALONG_X, second)


def circle(rows=400):
    angle = np.linspace(0.0, 1.8 * math.pi, rows)
    return path_through(0.1 * np.stack([np.cos(angle), np.sin(angle), 0.0 * angle], axis=1))


def trapezium():
    return resampled(path_through(LEGS), 0.002, keep=(1, 2, 3))


def noisy(path, sigma_m, sigma_rad=0.0, seed=5):
    rng = np.random.default_rng(seed)
    T = path.T_world_tip.copy()
    T[:, :3, 3] += rng.normal(0.0, sigma_m, (len(path), 3))
    turn = Rotation.from_rotvec(rng.normal(0.0, sigma_rad, (len(path), 3)))
    T[:, :3, :3] = (path.poses.rotation * turn).as_matrix()
    return replace(path, T_world_tip=T)


def error_m(path, truth):
    """RMS distance of the rows from the truth's line; noise along the line is no error of its shape."""
    line = np.concatenate([np.linspace(a, b, 200, endpoint=False) for a, b in itertools.pairwise(truth.xyz_m)])
    return math.sqrt(np.mean(cKDTree(line).query(path.xyz_m)[0] ** 2))


@pytest.mark.parametrize("truth", [circle(), trapezium()], ids=["circle", "trapezium"])
def test_smoothing_brings_a_path_nearer_to_the_truth(truth):
    taught = noisy(truth, 1e-4, 2e-3)
    made = smoothed(taught)
    assert error_m(made, truth) < 0.6 * error_m(taught, truth)
    assert np.mean(moved_by(truth, made)[1] ** 2) < 0.36 * np.mean(moved_by(truth, taught)[1] ** 2)


@pytest.mark.parametrize("bound_m", [5e-4, 1e-4, 3e-5])
def test_no_row_moves_or_turns_beyond_the_bounds(bound_m):
    taught = noisy(trapezium(), 2e-4, 5e-3)
    way, turn = moved_by(taught, smoothed(taught, bound_m=bound_m, bound_rad=2e-3))
    assert 0.0 < way.max() <= bound_m * (1 + 1e-9) and 0.0 < turn.max() <= 2e-3 * (1 + 1e-9)


def test_corners_stay_sharp():
    made = smoothed(noisy(trapezium(), 1e-4))
    rows = corners(made)
    assert len(rows) == 3
    for row, corner in zip(rows, LEGS[1:4], strict=True):
        assert np.linalg.norm(made.xyz_m[row] - corner) < 5e-4  # a corner rounded over the window would be 2 mm off


def spoiled(path, rows, by_m=0.0, by_rad=0.0):
    T = path.T_world_tip.copy()
    T[rows, :3, 3] += [0.0, 0.6 * by_m, 0.8 * by_m]
    T[rows, :3, :3] = T[rows, :3, :3] @ Rotation.from_rotvec([by_rad, 0.0, 0.0]).as_matrix()
    return replace(path, T_world_tip=T)


@pytest.mark.parametrize("truth", [circle(), trapezium()], ids=["circle", "trapezium"])
def test_outliers_are_found_and_no_other_row(truth):
    rows = [0, 40, 41, 90, 150]  # an end, two in a row, one alone, one more
    found = outliers(spoiled(noisy(truth, 1e-4), rows, by_m=5e-3))
    assert [outlier.row for outlier in found] == rows
    assert all(4e-3 < outlier.off_m < 6e-3 for outlier in found) and "row 40 is" in found[1].text


def test_a_start_after_a_stop_is_no_outlier():
    s = np.concatenate([np.zeros(30), 0.004 * np.arange(60)])
    path = noisy(path_through(np.stack([s, 0 * s, 0 * s], axis=1)), 5e-5)
    assert outliers(replace(path, t_s=0.03 * np.arange(90))) == ()


def test_rows_taken_out_leave_their_tags():
    path = replace(circle(12), tags=("",) * 4 + ("weld_on",) + ("",) * 7)
    made = without_rows(path, [4])
    assert len(made) == 11 and made.tags[3] == "weld_on"
    with pytest.raises(Inconsistent):
        without_rows(replace(path, tags=("",) * 3 + ("weld_off", "weld_on") + ("",) * 7), [4])
    with pytest.raises(NotEnoughData):
        without_rows(path, range(11))


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
