"""Outliers and smoothing of paths, against the path before noise was put on it."""

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial import cKDTree
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.control.paths import corners, moved_by, outliers, resampled, smoothed, without_rows
from armsight.errors import Inconsistent, NotEnoughData
from armsight.records import TaughtPath

DOWN = Rotation.from_rotvec([math.pi, 0.0, 0.0])
LEGS = np.array([[0, 0, 0], [0.2, 0, 0], [0.15, 0.1, 0], [0.05, 0.1, 0], [0, 0, 0]])


def path_through(xyz, rotation=None):
    turns = Rotation.from_quat(np.tile(DOWN.as_quat(), (len(xyz), 1))) if rotation is None else rotation
    return TaughtPath.of_poses(RigidTransform.from_components(np.asarray(xyz, float), turns))


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
