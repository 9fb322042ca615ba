"""The tool's tip in a simulated world: pivoting against the paper's mean, honesty, refusals."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.calibrate.tooltip import MeasuredPoint, TipRecording, calibrate_tooltip, mean_tip
from armsight.errors import Degenerate, Inconsistent, NotEnoughData
from refusals import refuses

DEG, MM = np.pi / 180, 1e-3
TIP, POINT = np.array([0.01, -0.02, 0.08]), np.array([0.2, 1.2, 0.08])
SIGMA_M, SIGMA_RAD = np.array([0.02, 0.05, 0.12]) * MM, 0.2 * DEG


def pivot(rng: np.random.Generator, n: int, tilt_deg: float = 25.0, noise: float = 1.0) -> RigidTransform:
    R = Rotation.from_rotvec(rng.uniform(-tilt_deg * DEG, tilt_deg * DEG, (n, 3)))
    t = POINT - R.apply(TIP)
    turn = Rotation.from_rotvec(noise * rng.normal(0, SIGMA_RAD, (n, 3)))
    return RigidTransform.from_components(t + noise * rng.normal(0, 1, (n, 3)) * SIGMA_M, turn * R)


def test_pivoting_beats_the_mean_and_knows_its_doubt() -> None:
    covariance = np.tile(np.diag([*SIGMA_M**2, *[SIGMA_RAD**2] * 3]), (50, 1, 1))
    mean, free, both, z = [], [], [], []
    for seed in range(60):
        rng = np.random.default_rng(seed)
        poses = pivot(rng, 50)
        point = POINT + rng.normal(0, 0.2 * MM, 3)
        M = poses.as_matrix()
        result = calibrate_tooltip(poses, covariance)
        mean.append(mean_tip(M[:, :3, :3], M[:, :3, 3], point) - TIP)
        free.append(result.tip_m - TIP)
        both.append(calibrate_tooltip(poses, covariance, MeasuredPoint(xyz_m=point, sigma_m=0.2 * MM)).tip_m - TIP)
        z.append(free[-1] / np.array(list(result.std.values())))
        assert result.rejected == ()
    rms = [float(np.sqrt(np.mean(np.square(errors)))) / MM for errors in (mean, free, both)]
    assert rms[0] == pytest.approx(0.2, abs=0.03)  # eq. (13) keeps the whole error of the point
    assert rms[1] < 0.6 * rms[0]
    assert rms[2] <= 1.02 * rms[1]
    assert np.sqrt(np.mean(np.square(z))) == pytest.approx(1.0, abs=0.15)


def test_a_slip_is_named_and_left_out() -> None:
    poses = pivot(np.random.default_rng(2), 30)
    M = poses.as_matrix().copy()
    M[[4, 17], 0, 3] += 5 * MM
    result = calibrate_tooltip(RigidTransform.from_matrix(M))
    assert [row for row, _ in result.rejected_rows] == [4, 17]
    assert result.tip_m == pytest.approx(TIP, abs=0.6 * MM)


def test_four_poses_are_believed_as_far_as_they_go() -> None:
    z = []
    for seed in range(150):
        rng = np.random.default_rng([4, seed])
        about, tilt = (
            np.arange(4) * 2 * np.pi / 3 + rng.normal(0, 0.2, 4),
            30 * DEG * np.r_[0, rng.uniform(0.8, 1.0, 3)],
        )
        R = Rotation.from_rotvec(np.c_[tilt * np.cos(about), tilt * np.sin(about), 0 * about])
        R = R * Rotation.from_euler("z", rng.uniform(-0.5, 0.5, (4, 1)))
        t = POINT - R.apply(TIP) + rng.normal(0, 0.2 * MM, (4, 3))
        result = calibrate_tooltip(RigidTransform.from_components(t, R))
        z.append((result.tip_m - TIP) / np.array(list(result.std.values())))
    assert np.mean(np.abs(z) < 1.96) > 0.92  # 0.86 where the likeliest ratio of the noises is taken for the true one


def test_repeated_readings_are_worth_their_places() -> None:
    rng = np.random.default_rng(5)
    places = pivot(rng, 8)
    i = rng.permutation(np.repeat(np.arange(8), 6))
    M = places[i].as_matrix()
    M[:, :3, 3] += rng.normal(0, 2e-6, (48, 3))
    M[7, 0, 3] += 5 * MM  # one reading that went wrong takes no place with it
    once, often = calibrate_tooltip(places), calibrate_tooltip(RigidTransform.from_matrix(M))
    assert [row for row, _ in often.rejected_rows] == [7]
    assert (often.n_used, often.n_effective, once.n_effective) == (47, 8, None)
    assert often.tip_m == pytest.approx(once.tip_m, abs=0.02 * MM)
    assert list(often.std.values()) == pytest.approx(list(once.std.values()), rel=0.05)
    assert often.loo_rms_m == pytest.approx(once.loo_rms_m, rel=0.1)
    assert any("worth 8 poses" in note for note in often.notes)
    three = RigidTransform.concatenate([places[k] for k in (0, 1, 2)] * 5)
    with refuses(NotEnoughData, "3 places"):
        calibrate_tooltip(three)


def test_a_narrow_pivot_is_told_from_a_tip_that_moved() -> None:
    rng = np.random.default_rng(6)
    for tilt, kind in ((5.0, Degenerate), (25.0, None)):
        poses = pivot(rng, 200, tilt_deg=tilt, noise=0.0)
        noise = rng.normal(0, 1, (200, 3)) * [0.4 * MM, 0.4 * MM, 4 * MM]
        M = RigidTransform.from_translation(noise).as_matrix() @ poses.as_matrix()
        if kind is None:
            assert calibrate_tooltip(RigidTransform.from_matrix(M)).tip_m == pytest.approx(TIP, abs=1.5 * MM)
        else:
            with refuses(kind, "turns by only", "scatter", "25 degrees"):
                calibrate_tooltip(RigidTransform.from_matrix(M))


def test_refusals() -> None:
    rng = np.random.default_rng(3)
    with pytest.raises(NotEnoughData, match="3 poses"):
        calibrate_tooltip(list(pivot(rng, 3)))
    with refuses(Degenerate, "by only"):
        calibrate_tooltip(pivot(rng, 30, tilt_deg=2.0))
    turns = Rotation.from_rotvec(np.outer(np.linspace(-0.5, 0.5, 20), [0, 0, 1.0]))
    with refuses(Degenerate, "one axis"):
        calibrate_tooltip(RigidTransform.from_components(POINT - turns.apply(TIP), turns))
    wandering = pivot(rng, 30)
    M = wandering.as_matrix().copy()
    M[::2, :3, 3] += rng.normal(0, 20 * MM, (15, 3))
    with refuses(Inconsistent, "resting"):
        calibrate_tooltip(RigidTransform.from_matrix(M))


def test_recording_tells_when_it_is_enough() -> None:
    recording = TipRecording(good_m=0.15 * MM)
    doubts = []
    for pose in pivot(np.random.default_rng(4), 60):
        recording = recording.with_pose(pose)
        doubts.append(recording.std_m)
        if recording.good_enough:
            break
    assert not np.isfinite(doubts[2])
    assert 8 < len(doubts) < 60
    assert "good enough" in recording.progress()
    assert TipRecording().with_pose(RigidTransform.identity()).progress().startswith("1 poses: ")


@pytest.mark.parametrize(
    "slip", [(np.array([0.0, 3 * MM, 0.0]), 0.0), (TIP - TIP[[1, 0, 2]] * [-1, 1, 1], 0.0), (0.0, 4 * MM)]
)
def test_two_settings_in_one_table_are_told_with_the_row(slip: tuple[NDArray[np.float64] | float, float]) -> None:
    off, point = slip  # a tool that slipped, one turned by 90 degrees, a point that was moved
    rng = np.random.default_rng(8)
    R = Rotation.from_rotvec(rng.uniform(-25 * DEG, 25 * DEG, (40, 3)))
    late = (np.arange(40) >= 20)[:, None]
    t = POINT + late * np.array([point, 0.0, 0.0]) - R.apply(TIP + late * off) + rng.normal(0, 0.1 * MM, (40, 3))
    both = RigidTransform.from_components(t, R)
    with refuses(Inconsistent, "row 21"):
        calibrate_tooltip(both)
    for part, turned in ((both[:20], 0.0), (both[20:], 1.0)):  # the cure
        assert calibrate_tooltip(part).tip_m == pytest.approx(TIP + turned * off, abs=0.3 * MM)


@pytest.mark.parametrize("n", [8, 30])
def test_a_point_that_is_not_where_it_was_measured_is_refused(n: int) -> None:
    rng = np.random.default_rng(9)
    for _ in range(6):
        poses = pivot(rng, n, noise=0.5)
        wrong = MeasuredPoint(xyz_m=POINT + 5 * MM * np.eye(3)[1], sigma_m=0.2 * MM)
        with refuses(Inconsistent, "measured", "--point-sigma"):
            calibrate_tooltip(poses, point=wrong)
        assert calibrate_tooltip(poses).tip_m == pytest.approx(TIP, abs=1.5 * MM)
        right = MeasuredPoint(xyz_m=POINT + rng.normal(0, 0.2 * MM, 3), sigma_m=0.2 * MM)
        assert calibrate_tooltip(poses, point=right).tip_m == pytest.approx(TIP, abs=1.5 * MM)
