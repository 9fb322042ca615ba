"""Hand-eye of arms that cannot tilt, in a world of rotation matrices alone: what is told; what a height closes."""

import re

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from armsight import calibrate_hand_eye
from armsight.errors import Degenerate, Inconsistent, UsageError
from refusals import refuses

CAMERA = RigidTransform.from_components(
    [0.05, 0.02, 0.08], Rotation.from_euler("xyz", [178.0, 3.0, 25.0], degrees=True)
)
TARGET = RigidTransform.from_components([0.45, 0.1, 0.012], Rotation.from_euler("xyz", [1.0, -2.0, 17.0], degrees=True))
NOISE_M, NOISE_RAD = 3e-4, 1e-3


def scara(rng, n=25, to_hand=False, turns=1.2):
    """Return poses of a flange that goes in three directions and turns about the vertical, and what the camera sees."""
    t = rng.uniform([0.3, -0.2, 0.25], [0.6, 0.2, 0.4], (n, 3))
    flange = RigidTransform.from_components(
        t, Rotation.from_rotvec(np.outer(rng.uniform(-turns, turns, n), [0.0, 0.0, 1.0]))
    )
    if to_hand:
        seen = [(CAMERA.inv() * F * TARGET).as_matrix() for F in flange]
    else:
        seen = [((F * CAMERA).inv() * TARGET).as_matrix() for F in flange]
    seen = RigidTransform.from_matrix(np.array(seen))
    turn = Rotation.from_rotvec(rng.normal(0, NOISE_RAD, (n, 3)))
    return flange, RigidTransform.from_components(
        seen.translation + rng.normal(0, NOISE_M, (n, 3)), turn * seen.rotation
    )


@pytest.mark.parametrize("setup", ["eye-in-hand", "eye-to-hand"])
def test_one_height_gives_all_of_it_and_the_deviations_hold(setup):
    z = []
    sigma = 4e-4
    for seed in range(25):
        rng = np.random.default_rng([seed, len(setup)])
        height = float(TARGET.translation[2] + rng.normal(0, sigma))
        done = calibrate_hand_eye(
            *scara(rng, to_hand=setup == "eye-to-hand"), setup=setup, target_height_m=height, target_height_std_m=sigma
        )
        for found, true, std in (
            (done.T_parent_camera, CAMERA, done.std),
            (done.T_parent_target, TARGET, done.target_std),
        ):
            off = [*(found.translation - true.translation), *(found.rotation * true.rotation.inv()).as_rotvec()]
            z.append(np.array(off) / list(std.values()))
    z = np.array(z)
    inside = float(np.mean(np.abs(z) < 1.96))
    assert 0.91 < inside < 0.985  # 600 of them, twelve and twelve correlated
    assert 0.85 < np.sqrt(np.mean(z**2)) < 1.15


def test_without_a_height_what_is_known_is_told_and_what_is_open_named():
    poses = scara(np.random.default_rng(3))
    with refuses(Degenerate, "camera z", "target z", "SCARA") as caught:
        calibrate_hand_eye(*poses)
    assert "target_height" in caught.value.cure
    done = calibrate_hand_eye(*poses, target_height_m=0.012)
    assert np.abs(done.T_parent_camera.translation - CAMERA.translation).max() < 2e-3
    camera = re.search(r"of the camera in the flange (.*?); of the target", caught.value.cause)[1]
    told = {name: (float(value), float(std)) for name, value, std in re.findall(r"(\w+) (\S+) \+- (\S+)", camera)}
    assert set(told) == {"x", "y", "rx", "ry", "rz"}
    for name, true_mm in (("x", 50.0), ("y", 20.0)):
        value, std = told[name]
        assert 0.05 < std < 0.3
        assert abs(value - true_mm) < 4.0 * std


def test_a_hand_that_never_turns_tells_the_orientation_alone():
    poses = scara(np.random.default_rng(4), turns=0.0)
    for height in ({}, {"target_height_m": 0.012}):
        with refuses(Degenerate, "open are", "camera x", "camera y", "Turn the hand") as caught:
            calibrate_hand_eye(*poses, **height)
        assert "rz" in caught.value.cause


def test_gross_pairs_are_left_out_and_a_wrong_setup_is_refused():
    flange, seen = scara(np.random.default_rng(5))
    wrong = seen.as_matrix().copy()
    wrong[4, :3, 3] += [0.05, 0.0, 0.02]
    done = calibrate_hand_eye(flange, RigidTransform.from_matrix(wrong), target_height_m=0.012)
    assert [one.row for one in done.rejected_pairs] == [5]
    assert np.abs(done.T_parent_camera.translation - CAMERA.translation).max() < 2e-3
    with refuses(Inconsistent, "setup"):
        calibrate_hand_eye(flange, seen, setup="eye-to-hand", target_height_m=0.012)
    with refuses(Inconsistent, "do not agree"):
        calibrate_hand_eye(flange, seen.inv(), target_height_m=0.012)


def test_a_height_that_is_not_needed_is_refused():
    rng = np.random.default_rng(6)
    flange = RigidTransform.from_components(
        rng.uniform(-0.2, 0.2, (15, 3)), Rotation.from_rotvec(rng.uniform(-0.4, 0.4, (15, 3)))
    )
    seen = RigidTransform.from_matrix(np.array([((F * CAMERA).inv() * TARGET).as_matrix() for F in flange]))
    with refuses(Inconsistent, "two axes"):
        calibrate_hand_eye(flange, seen, target_height_m=0.012)
    with refuses(UsageError, "propose"):
        calibrate_hand_eye(flange, seen, target_height_m=0.012, propose=2)
    done = calibrate_hand_eye(flange, seen, propose=2)
    assert done.T_parent_target.translation[2] == pytest.approx(0.012, abs=1e-6)


def test_a_height_in_millimetres_taken_as_metres_is_refused():
    poses = scara(np.random.default_rng(3))
    with refuses(Inconsistent, "height", "12 m", "12mm"):
        calibrate_hand_eye(*poses, setup="eye-in-hand", target_height_m=12.0)
    assert calibrate_hand_eye(*poses, setup="eye-in-hand", target_height_m=0.012).std["z_m"] < 1e-3
