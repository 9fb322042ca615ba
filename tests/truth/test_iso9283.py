"""The standard deviations that the figures of ISO 9283 claim, against those of simulated tests repeated many times.

The sample standard deviation of N values has a relative standard deviation of 1 / sqrt(2 N), a share p of N trials one
of sqrt(p (1 - p) / N); four of them are allowed, and APPROXIMATION for what the delta method leaves at 30 visits
(benchmarks/iso9283.py).
"""

from math import sqrt

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from armsight.verify.iso9283 import CommandedPath, Iso9283Test, PathRun, PathTest, PoseVisits, evaluate
from armsight.verify.iso9283.figure import radial

TRIALS = 100
VISITS = 30
APPROXIMATION = 0.05
RATIO = 4.0 / sqrt(2.0 * TRIALS) + APPROXIMATION
COVERED = 4.0 * sqrt(0.95 * 0.05 / TRIALS) + APPROXIMATION / 2

ROBOT = np.diag([50e-6, 20e-6, 10e-6, 1e-4, 2e-4, 3e-4]) ** 2  # m, rad
CAMERA = np.diag([20e-6, 20e-6, 30e-6, 1e-4, 1e-4, 1e-4]) ** 2
SYSTEMATIC = np.diag([10e-6, 10e-6, 15e-6, 5e-5, 5e-5, 5e-5]) ** 2
OFFSET = np.array([150e-6, -80e-6, 40e-6, 5e-4, 0.0, -5e-4])


def one_pose(rng, name="P1", at=(0.0, 0.0, 0.0), offset=OFFSET):
    scatter = rng.multivariate_normal(np.zeros(6), ROBOT + CAMERA, VISITS)
    error = offset + rng.multivariate_normal(np.zeros(6), SYSTEMATIC) + scatter
    return PoseVisits(
        pose=name,
        xyz_m=at + error[:, :3],
        quat_xyzw=Rotation.from_rotvec(error[:, 3:]).as_quat(),
        visit=np.arange(VISITS),
        covariance=np.tile(CAMERA + SYSTEMATIC, (VISITS, 1, 1)),
        systematic=SYSTEMATIC,
        approach=("x",) * VISITS,
        commanded_xyz_m=at,
        commanded_quat_xyzw=[0, 0, 0, 1],
    )


@pytest.fixture(scope="module")
def trials():
    """By key, an array (TRIALS, 4): value, std, corrected, corrected_std."""
    rows: dict[str, list[list[float]]] = {}
    for trial in range(TRIALS):
        rng = np.random.default_rng([9283, trial])
        poses = [one_pose(rng, "P2"), one_pose(rng, "P4", (0.5, 0.3, 0.1), -OFFSET)]
        for figure in evaluate(Iso9283Test(poses=poses)):
            if figure.value is not None:
                row = [figure.value, figure.std, figure.corrected, figure.corrected_std]
                rows.setdefault(figure.key, []).append(row)
    return {key: np.array(values, float) for key, values in rows.items()}


STEP = np.array([0.5, 0.3, 0.1])
DISTANCE = float(np.linalg.norm(STEP - 2 * OFFSET[:3]) - np.linalg.norm(STEP))
TRUTH = {
    "AP_m P2": float(np.linalg.norm(OFFSET[:3])),
    "AP_x_m P2": OFFSET[0],
    "AP_a_rad P2": OFFSET[3],
    "RP_m P2": radial(ROBOT[:3, :3]).repeatability,
    "RP_b_rad P2": 3.0 * sqrt(ROBOT[4, 4]),
    "AD_m P2-P4": DISTANCE,
    "RD_m P2-P4": 3.0 * sqrt(2.0 * float(STEP @ ROBOT[:3, :3] @ STEP) / float(STEP @ STEP)),
}


@pytest.mark.parametrize("key", TRUTH)
def test_the_claimed_standard_deviation_is_the_real_one(trials, key):
    value, std = trials[key][:, 0], trials[key][:, 1]
    assert std.mean() / value.std(ddof=1) == pytest.approx(1.0, abs=RATIO)


@pytest.mark.parametrize("key", TRUTH)
def test_the_corrected_figure_covers_the_robots_own(trials, key):
    corrected, std = trials[key][:, 2], trials[key][:, 3]
    covered = np.mean(np.abs(corrected - TRUTH[key]) <= 1.96 * std)
    assert covered >= 0.95 - COVERED


@pytest.mark.parametrize("key", ["RP_m P2", "RP_b_rad P2", "RD_m P2-P4"])
def test_the_cameras_scatter_is_taken_out_on_average(trials, key):
    value, corrected = trials[key][:, 0].mean(), trials[key][:, 2]
    spread = corrected.std(ddof=1) / sqrt(TRIALS)
    assert abs(corrected.mean() - TRUTH[key]) <= 4.0 * spread + APPROXIMATION * TRUTH[key]
    assert value > TRUTH[key] + 4.0 * spread  # the negative control: uncorrected, the camera's scatter is in it


def test_accuracy_of_a_perfect_robot_is_not_claimed_to_be_seen():
    seen = []
    for trial in range(TRIALS):
        figure = evaluate(Iso9283Test(poses=[one_pose(np.random.default_rng([1, trial]), offset=np.zeros(6))]))["AP_m"]
        seen.append(figure.corrected > 1.96 * figure.corrected_std)
    assert np.mean(seen) <= 0.05 + COVERED


def test_path_accuracys_standard_deviation_is_the_real_one():
    path = CommandedPath(xyz_m=[[0.0, 0.0, 0.0], [0.3, 0.0, 0.0]], speed_m_s=0.1)
    t = np.linspace(-0.1, 3.1, 81)
    rows = []
    for trial in range(TRIALS // 8):
        rng = np.random.default_rng([2, trial])
        runs = []
        for _ in range(10):
            y, z = np.array([1e-3, 0.0]) + rng.normal(0.0, 1e-4, 2)
            speed = 0.101 + rng.normal(0.0, 1e-3)
            x = 0.15 + speed * (t - 1.5)
            runs.append(PathRun(t_s=t, xyz_m=np.stack([x, np.full_like(t, y), np.full_like(t, z)], axis=1)))
        found = evaluate(Iso9283Test(paths=[PathTest(name="line", runs=runs, commanded=path)]))
        rows.append([v for key in ("AT_m", "RT_m", "AV_ratio", "RV_ratio") for v in (found[key].value, found[key].std)])
    table = np.array(rows)
    allowed = 3.0 / sqrt(TRIALS / 4) + 0.1  # 10 runs: the approximation is 10 %
    for column in range(0, 8, 2):
        claimed = np.sqrt(np.mean(table[:, column + 1] ** 2))
        assert claimed / table[:, column].std(ddof=1) == pytest.approx(1.0, abs=allowed)
