"""Several pairs at one pose of the robot share its error there, believed as one; a mount that slipped is told."""

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.calibrate.handeye import HandEyeResult, PosePairs, calibrate_eye_in_hand
from armsight.errors import Inconsistent
from refusals import refuses

X = RigidTransform.from_components([0.03, 0.05, 0.1], Rotation.from_rotvec([0.1, 0.2, 0.3]))
Z = RigidTransform.from_components([0.6, 0.1, 0.0], Rotation.from_rotvec([3.0, 0.1, 0.0]))


def calibrated(seed: int, places: int, readings: int, sigma: tuple[float, float] = (2e-4, 5e-4)) -> HandEyeResult:
    """The robot errs by 0.2 mm and 0.5 mrad (sigma) a place, each image by a tenth of it."""
    return calibrate_eye_in_hand(recorded(seed, places, readings, sigma))


def recorded(
    seed: int, places: int, readings: int, sigma: tuple[float, float], size: float = 1.0, slip_m: float = 0.0
) -> PosePairs:
    """size: of the target over its given one. slip_m: of the camera in half of the places."""
    rng = np.random.default_rng(seed)
    turn = Rotation.from_rotvec(rng.uniform(-0.5, 0.5, (places, 3))) * Rotation.from_rotvec([3.1, 0.0, 0.0])
    F = RigidTransform.from_components(rng.uniform([0.4, -0.2, 0.4], [0.8, 0.3, 0.7], (places, 3)), turn)
    i = np.repeat(np.arange(places), readings)

    def errors(n: int, share: float) -> RigidTransform:
        turned = Rotation.from_rotvec(rng.normal(0, sigma[1] * share, (n, 3)))
        return RigidTransform.from_components(rng.normal(0, sigma[0] * share, (n, 3)), turned)

    shift = np.where(i[:, None] < places // 2, 0.0, [0.0, slip_m, 0.0])
    camera = X * RigidTransform.from_translation(shift)
    seen = ((F * errors(places, 1.0))[i] * camera).inv() * Z * errors(len(i), 0.1)
    seen = RigidTransform.from_components(seen.translation / size, seen.rotation)
    return PosePairs.of(list(F[i]), list(seen), [f"row {k + 1}" for k in range(len(i))])


def test_five_images_at_each_pose_are_believed_as_one() -> None:
    z = []
    for seed in range(10):
        found = calibrated(seed, 12, 5)
        X_found = found.T_parent_camera
        off = np.r_[X_found.translation - X.translation, (X_found.rotation * X.rotation.inv()).as_rotvec()]
        z.append(off / np.sqrt(np.diag(found.covariance.matrix)[:6]))
        assert found.used.sum() == 60
    assert np.sqrt(np.mean(np.square(z))) == pytest.approx(1.0, abs=0.25)  # 2.5 where each image is a pair of its own


def test_a_robot_that_errs_by_a_millimetre_does_not_make_the_target_wrong() -> None:
    """Ten images at each of six places: one in four such sets was told a target of another size."""
    for seed in range(12):
        scale = calibrated(seed, 6, 10, (1e-3, 0.0)).scale
        assert scale is None or not scale.wrong
    told = [calibrate_eye_in_hand(recorded(seed, 8, 10, (3e-4, 0.0), size=1.03)).scale for seed in range(4)]
    assert all(one is not None and one.wrong and one.factor == pytest.approx(1.03, abs=0.005) for one in told)


@pytest.mark.parametrize(("places", "readings"), [(10, 1), (20, 1), (16, 10)])
def test_a_mount_that_slipped_is_told_with_the_row(places: int, readings: int) -> None:
    for seed in range(3):
        both = recorded(seed, places, readings, (2e-4, 3e-4), slip_m=5e-3)
        half = places // 2 * readings
        with refuses(Inconsistent, f"row {half + 1}", "apart"):
            calibrate_eye_in_hand(both)
        for part, moved in ((slice(None, half), 0.0), (slice(half, None), 5e-3)):  # the cure
            found = calibrate_eye_in_hand(both.take(np.arange(len(both))[part])).T_parent_camera
            true = X.translation + X.rotation.apply([0.0, moved, 0.0])
            assert found.translation == pytest.approx(true, abs=2e-3)


def test_a_slip_of_a_few_noises_is_told_with_its_row() -> None:
    """2 mm over 0.2 mm of noise, and 0.3 mrad through the lever: they moved the camera by 1 mm, called good."""
    for seed in range(4):
        with refuses(Inconsistent, "row 11", "apart"):
            calibrate_eye_in_hand(recorded(seed, 20, 1, (2e-4, 3e-4), slip_m=2e-3))
        calibrate_eye_in_hand(recorded(seed, 20, 1, (2e-4, 3e-4)))


@pytest.mark.parametrize(("places", "readings"), [(6, 10), (8, 5)])
def test_readings_of_a_place_are_judged_as_one(places: int, readings: int) -> None:
    """Of six places of ten, three good ones were lost as outliers; a wrong place and wrong readings are found."""
    for seed in range(3):
        good = recorded(seed, places, readings, (3e-4, 9e-4))
        assert calibrate_eye_in_hand(good).used.all()
        wrong = np.arange(len(good)) // readings == seed % places
        off = RigidTransform.from_translation(np.where(wrong[:, None], [0.03, 0.0, 0.0], 0.0)) * good.T_camera_target
        exchanged = np.arange(len(good))
        exchanged[[1, readings + 2]] = exchanged[[readings + 2, 1]]
        for seen, bad in ((off, wrong), (good.T_camera_target[exchanged], exchanged != np.arange(len(good)))):
            found = calibrate_eye_in_hand(PosePairs.of(list(good.T_base_flange), list(seen), good.names))
            assert (found.used == ~bad).all() and len(found.rejected_pairs) == bad.sum() and found.concerns


def test_a_mount_that_turned_is_told_with_the_row() -> None:
    for seed in range(3):
        good = recorded(seed, 20, 1, (3e-4, 5e-4))
        turn = RigidTransform.from_rotation(
            Rotation.from_rotvec(np.where(np.arange(20)[:, None] < 10, 0, [0.01, 0, 0]))
        )
        turned = PosePairs.of(list(good.T_base_flange), list(turn * good.T_camera_target), good.names)
        with refuses(Inconsistent, "row 11"):
            calibrate_eye_in_hand(turned)


def test_errors_that_drift_are_no_slip() -> None:
    for seed in range(0, 40, 2):
        n, rng = 10 + seed % 31, np.random.default_rng(seed)
        good = recorded(seed, n, 1, (1e-4, 2e-4))
        drift = np.cumsum(rng.normal(0, 1e-3, (n, 3)), axis=0) / np.sqrt(n)
        seen = good.T_camera_target * RigidTransform.from_translation(drift)
        calibrate_eye_in_hand(PosePairs.of(list(good.T_base_flange), list(seen), good.names))
