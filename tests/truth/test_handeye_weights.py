"""Pairs whose camera poses are known unequally well: weighed by their covariances, which are believed as far as they
are borne out."""

from __future__ import annotations

import sys
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from armsight.calibrate.handeye import HandEyeResult, PosePairs, calibrate_eye_in_hand, calibrate_eye_to_hand
from armsight.errors import Inconsistent

sys.path.insert(0, str(Path(__file__).parent))
from handeye_far_views import MM, FarViews, far_views

N = 20
Change = Callable[[np.ndarray], np.ndarray]


def as_given(covariance: np.ndarray) -> np.ndarray:
    return covariance


def calibrated(world: FarViews, covariance: np.ndarray | None, t_s: np.ndarray | None = None) -> HandEyeResult:
    pairs = PosePairs(
        T_base_flange=world.robot,
        T_camera_target=world.camera,
        names=tuple(f"row {i + 1}" for i in range(len(world.robot))),
        t_s=t_s,
        camera_covariance=covariance,
    )
    return calibrate_eye_in_hand(pairs)


def off(result: HandEyeResult, X: RigidTransform, Z: RigidTransform) -> np.ndarray:
    out = []
    for got, true in ((result.T_parent_camera, X), (result.T_parent_target, Z)):
        out += [got.translation - true.translation, (got.rotation * true.rotation.inv()).as_rotvec()]
    return np.concatenate(out)


@cache
def errors(change: Change | None, seeds: int = 12) -> tuple[float, np.ndarray]:
    """Return the RMS error of the camera's place in mm, and all errors over their claimed deviations."""
    moved, z = [], []
    for seed in range(seeds):
        world = far_views(seed, N)
        result = calibrated(world, None if change is None else change(world.covariance.copy()))
        wrong = off(result, world.X, world.Z)
        moved.append(np.linalg.norm(wrong[:3]) / MM)
        z.append(wrong / np.sqrt(np.diag(result.covariance.matrix)))
    return float(np.sqrt(np.mean(np.square(moved)))), np.array(z)


def test_far_views_weigh_less_and_the_claims_hold() -> None:
    alike, _ = errors(None)
    weighed, z = errors(as_given)
    assert weighed < 0.3 * alike  # over 200 seeds 0.18
    assert np.mean(np.abs(z) < 1.96) > 0.92  # over 200 seeds 0.964
    assert np.sqrt(np.mean(z**2)) == pytest.approx(0.92, abs=0.15)


@pytest.mark.parametrize("share", [1 / 9, 9.0])
def test_covariances_too_small_or_large_altogether_are_found_out(share: float) -> None:
    world = far_views(3, N)
    given, scaled = calibrated(world, world.covariance), calibrated(world, share * world.covariance)
    assert given.covariance_factor is not None and scaled.covariance_factor is not None
    assert scaled.covariance_factor * share == pytest.approx(given.covariance_factor, rel=0.3)
    assert scaled.std["x_m"] == pytest.approx(given.std["x_m"], rel=0.15)


def test_a_few_pairs_that_claim_too_much_do_not_take_over() -> None:
    def boast(covariance: np.ndarray) -> np.ndarray:
        covariance[:3] *= 1e-4
        return covariance

    assert errors(boast)[0] < errors(None)[0]  # over 200 seeds 0.78 mm to 1.5


def test_a_wrong_pair_is_left_out_and_far_good_ones_are_not() -> None:
    world = far_views(1, N)
    M = world.camera.as_matrix().copy()
    M[5, :3, 3] += [0.1, 0.0, 0.05]
    spoilt = FarViews(
        X=world.X, Z=world.Z, robot=world.robot, camera=RigidTransform.from_matrix(M), covariance=world.covariance
    )
    assert [one.name for one in calibrated(spoilt, world.covariance).rejected_pairs] == ["row 6"]
    assert calibrated(world, world.covariance).rejected_pairs == ()


def test_eye_to_hand_and_recordings_are_weighed_as_well() -> None:
    world = far_views(4, N)
    # T_base_camera = Z, T_flange_target = X^-1: the inverse robot pose makes the same equation
    pairs = PosePairs(
        T_base_flange=world.robot.inv(),
        T_camera_target=world.camera,
        names=tuple(map(str, range(N))),
        camera_covariance=world.covariance,
    )
    to_hand = calibrate_eye_to_hand(pairs)
    assert np.linalg.norm(to_hand.T_parent_camera.translation - world.X.translation) < 1.0 * MM
    recorded = calibrated(world, world.covariance, t_s=np.arange(float(N)))
    assert recorded.correlation is not None
    assert np.linalg.norm(off(recorded, world.X, world.Z)[:3]) < 1.0 * MM
    assert np.linalg.norm(off(calibrated(world, None, t_s=np.arange(float(N))), world.X, world.Z)[:3]) > 1.0 * MM


def test_what_is_no_covariance_is_refused_by_its_row() -> None:
    world = far_views(0, N)
    for spoil in (np.diag([1e-8] * 5 + [0.0]), 1e-8 * (np.eye(6) + 2.0 * np.eye(6, k=1)), 1e-8 * np.eye(6) - 2e-8):
        covariance = world.covariance.copy()
        covariance[3] = spoil
        with pytest.raises(Inconsistent, match="row 4"):
            calibrated(world, covariance)
