"""Hand-eye calibration in simulated cells: truth, honesty of its claims, and every refusal by name.

The cells are composed poses (scipy) and pictures projected by OpenCV; nothing of the product makes the data.
"""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np
import pytest
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.calibrate.handeye import (
    HandEyeResult,
    PosePairs,
    calibrate_eye_in_hand,
    calibrate_eye_to_hand,
    pairs_of_streams,
    propose,
    time_offset,
)
from armsight.errors import Ambiguous, Degenerate, Inconsistent, NotEnoughData
from armsight.records import BoardView, TargetKind, board_target
from refusals import names_it, refuses

DEG, MM = np.pi / 180, 1e-3
X = RigidTransform.from_components([0.03, -0.06, 0.09], Rotation.from_rotvec([0.2, -0.3, 0.5]))
Z = RigidTransform.from_components([0.6, 0.1, 0.02], Rotation.from_rotvec([0.1, 0.2, -0.4]))
FACING = Rotation.from_rotvec([np.pi, 0, 0])


def shaken(rng: np.random.Generator, T: RigidTransform, sigma_m: float, sigma_rad: float) -> RigidTransform:
    n = len(T)
    return RigidTransform.from_components(
        T.translation + rng.normal(0, 1, (n, 3)) * sigma_m,
        Rotation.from_rotvec(rng.normal(0, 1, (n, 3)) * sigma_rad) * T.rotation,
    )


def seen_poses(rng: np.random.Generator, n: int, tilt: float = 0.45) -> RigidTransform:
    R = FACING * Rotation.from_rotvec(rng.uniform(-tilt, tilt, (n, 3)))
    t = np.stack([rng.uniform(-0.12, 0.12, n), rng.uniform(-0.08, 0.08, n), rng.uniform(0.45, 0.8, n)], axis=1)
    return RigidTransform.from_components(t, R)


def pairs(robot: RigidTransform, camera: RigidTransform) -> PosePairs:
    return PosePairs(
        T_base_flange=robot, T_camera_target=camera, names=tuple(f"row {i + 1}" for i in range(len(robot)))
    )


def cell(
    seed: int, n: int = 20, *, to_hand: bool = False, tilt: float = 0.45, sigma: float = 1.0, robot_rad: float = 0.0
) -> PosePairs:
    """A good recording: 0.3 mm and 0.05 degrees of camera noise times sigma, the robot exact unless told."""
    rng = np.random.default_rng(seed)
    seen = seen_poses(rng, n, tilt)
    robot = X * seen * Z.inv() if to_hand else Z * seen.inv() * X.inv()
    return pairs(shaken(rng, robot, 0.0, robot_rad), shaken(rng, seen, sigma * 0.3 * MM, sigma * 0.05 * DEG))


def off(result: HandEyeResult) -> np.ndarray:
    """Errors (12,) of both poses, translation then rotation vector, in the parent's axes."""
    out = []
    for got, true in ((result.T_parent_camera, X), (result.T_parent_target, Z)):
        out += [got.translation - true.translation, (got.rotation * true.rotation.inv()).as_rotvec()]
    return np.concatenate(out)


CALIBRATE: dict[bool, Callable[[PosePairs], HandEyeResult]] = {
    False: calibrate_eye_in_hand,
    True: calibrate_eye_to_hand,
}


@pytest.mark.parametrize("to_hand", [False, True])
def test_the_truth_is_found_within_the_claimed_deviations(to_hand: bool) -> None:
    z, noise = [], []
    for seed in range(20):
        result = CALIBRATE[to_hand](cell(seed, to_hand=to_hand))
        z.append(off(result) / np.sqrt(np.diag(result.covariance.matrix)))
        noise.append((result.noise.translation_m.size, result.noise.camera_rad.size))
        assert result.rejected_pairs == ()
        assert not (result.scale and result.scale.wrong)
    # standard deviations are widened by 2 % at 20 poses; parameters hang together: the rms scatters by 5 %
    assert np.sqrt((np.array(z) ** 2).mean()) == pytest.approx(0.98, abs=0.15)
    assert np.median(noise, axis=0) == pytest.approx([0.3 * MM, 0.05 * DEG], rel=0.08)


def test_a_noisy_robot_is_told_from_a_noisy_camera() -> None:
    robot = [calibrate_eye_in_hand(cell(s, 50, robot_rad=0.2 * DEG)).noise for s in range(3)]
    camera = [calibrate_eye_in_hand(cell(s, 50, sigma=4.0)).noise for s in range(3)]
    assert np.median([noise.robot_rad.size for noise in robot]) == pytest.approx(0.2 * DEG, rel=0.15)
    assert np.median([noise.camera_rad.size for noise in camera]) == pytest.approx(0.2 * DEG, rel=0.15)
    assert robot[0].explanation().startswith("The robot explains")
    assert camera[0].explanation().startswith("The camera explains")
    assert not robot[0].robot_m.known  # a shift of the flange and one of the target look alike


def test_too_little_turning_is_refused() -> None:
    with refuses(Degenerate, "by only"):
        calibrate_eye_in_hand(cell(4, tilt=2 * DEG))
    seen = RigidTransform.from_components(
        cell(5).T_camera_target.translation,
        FACING * Rotation.from_rotvec(np.outer(np.linspace(-0.5, 0.5, 20), [0, 0, 1])),
    )
    with refuses(Degenerate, "one axis") as caught:
        calibrate_eye_in_hand(pairs(Z * seen.inv() * X.inv(), seen))
    assert "tilt" in caught.value.cure


def test_an_answer_that_rests_on_one_pair_is_refused_by_its_name() -> None:
    turns = [[0.0, 0.0, a] for a in (-0.5, 0.0, 0.5, 0.2, -0.3)]
    turns[2] = [0.6, 0.0, 0.1]
    rng, t = np.random.default_rng(1), cell(5, 5).T_camera_target.translation
    seen = RigidTransform.from_components(t, FACING * Rotation.from_rotvec(turns))
    robot = Z * seen.inv() * X.inv()
    with refuses(Degenerate, "row 3") as caught:
        calibrate_eye_in_hand(pairs(robot, shaken(rng, seen, 0.3 * MM, 0.05 * DEG)))
    assert "two axes" in caught.value.cure


def test_units_are_recognised() -> None:
    good = cell(6)

    def scaled(robot: float, camera: float) -> PosePairs:
        return pairs(*(
            RigidTransform.from_components(f * T.translation, T.rotation)
            for f, T in ((robot, good.T_base_flange), (camera, good.T_camera_target))
        ))  # fmt: skip

    for robot, camera, said in (
        (1000.0, 1000.0, "these are millimetres"),
        (1000.0, 1.0, "these are millimetres"),
        (1.0, 1000.0, "these are millimetres"),
        (1e-3, 1.0, ("camera's distances", "millimetres for metres")),
        (1.0, 1e-3, ("robot's distances", "millimetres for metres")),
        (1.0, 0.1, ("robot's distances", "millimetres for centimetres")),
    ):
        with refuses(Inconsistent, said):
            calibrate_eye_in_hand(scaled(robot, camera))
    wrong_pitch = calibrate_eye_in_hand(scaled(1.0, 1.05), target_pitch_m=0.0315)
    assert wrong_pitch.scale.wrong
    assert wrong_pitch.scale is not None
    assert wrong_pitch.scale.factor == pytest.approx(1 / 1.05, abs=4 * wrong_pitch.scale.std)
    assert "30.0" in wrong_pitch.advice[0]
    assert "calliper" in wrong_pitch.advice[0]
    assert names_it(wrong_pitch.verdict, "target", "the size")


def test_tables_read_the_wrong_way_are_recognised() -> None:
    good = cell(7)
    A, B = good.T_base_flange, good.T_camera_target
    n = len(good)
    rolled = RigidTransform.from_components(A.translation, Rotation.from_quat(np.roll(A.rotation.as_quat(), 1, axis=1)))
    wrong = {
        "T_target_camera": pairs(A, B.inv()),
        "T_flange_base": pairs(A.inv(), B),
        ("one row", "down"): pairs(A, B[np.roll(np.arange(n), -1)]),
        ("one row", "up"): pairs(A, B[np.roll(np.arange(n), 1)]),
        ("robot's quaternions", "w, x, y, z"): pairs(rolled, B),
        "follow": pairs(A, B[np.random.default_rng(8).permutation(n)]),
    }
    for said, given in wrong.items():
        with refuses(Inconsistent, said):
            calibrate_eye_in_hand(given)
    with refuses(Inconsistent, "eye-to-hand"):
        calibrate_eye_in_hand(cell(7, to_hand=True))


def test_gross_errors_are_named_and_left_out() -> None:
    good = cell(9, 15)
    M = good.T_camera_target.as_matrix().copy()
    for i, (turn, move) in {2: (3.0, 0.02), 6: (0.0, 0.05), 11: (20.0, 0.0)}.items():
        M[i, :3, :3] = Rotation.from_rotvec([0, turn * DEG, 0]).as_matrix() @ M[i, :3, :3]
        M[i, 0, 3] += move
    result = calibrate_eye_in_hand(pairs(good.T_base_flange, RigidTransform.from_matrix(M)))
    assert [one.name for one in result.rejected_pairs] == ["row 3", "row 7", "row 12"]
    move_mm = float({one.name: one.why for one in result.rejected_pairs}["row 7"].split()[2])
    assert move_mm == pytest.approx(50, abs=2)
    assert np.abs(off(result) / np.sqrt(np.diag(result.covariance.matrix))).max() < 5
    bad = RigidTransform.from_matrix(np.where(np.arange(15)[:, None, None] % 2, M, M[::-1]))
    with pytest.raises(Inconsistent):
        calibrate_eye_in_hand(pairs(good.T_base_flange, bad))


def test_copies_add_nothing() -> None:
    good = cell(10, 12)
    copied = good.take([*range(12), 3, 3, 7])
    copied = PosePairs(
        T_base_flange=copied.T_base_flange,
        T_camera_target=copied.T_camera_target,
        names=tuple(f"row {i + 1}" for i in range(15)),
    )
    once, thrice = calibrate_eye_in_hand(good), calibrate_eye_in_hand(copied)
    assert thrice.n_used == 12
    assert {one.name: one.why for one in thrice.rejected_pairs}["row 13"] == "repeats row 4"
    assert np.allclose(once.covariance.matrix, thrice.covariance.matrix, rtol=1e-9)


def test_the_next_poses_pay() -> None:
    rng = np.random.default_rng(11)
    given = cell(11, 8, tilt=0.15)
    result = calibrate_eye_in_hand(given)
    before = max(result.std[name] for name in ("x_m", "y_m", "z_m"))
    proposals = propose(result, 4)
    assert before > proposals[0].expected_std_m > proposals[-1].expected_std_m
    robot = RigidTransform.from_matrix(np.stack([p.T_base_flange.as_matrix() for p in proposals]))
    camera = shaken(rng, X.inv() * robot.inv() * Z, 0.3 * MM, 0.05 * DEG)
    expected = np.stack([p.T_camera_target.as_matrix() for p in proposals])
    assert np.abs(camera.as_matrix() - expected).max() < 0.05  # the target is where it was said to be
    more = pairs(
        RigidTransform.concatenate([given.T_base_flange, robot]),
        RigidTransform.concatenate([given.T_camera_target, camera]),
    )
    after = calibrate_eye_in_hand(more)
    assert max(after.std[name] for name in ("x_m", "y_m", "z_m")) < 0.75 * before
    with refuses(Inconsistent, "reach"):
        propose(result, 1, reachable=lambda pose: False)


def streams(seed: int, offset_s: float) -> tuple[np.ndarray, RigidTransform, np.ndarray, RigidTransform]:
    rng = np.random.default_rng(seed)
    knots = np.arange(-2.0, 23.0)
    turn, move = CubicSpline(knots, rng.normal(0, 0.25, (25, 3))), CubicSpline(knots, rng.normal(0, 0.05, (25, 3)))

    def seen(t: np.ndarray) -> RigidTransform:
        return RigidTransform.from_components(move(t) + np.array([0, 0, 0.6]), FACING * Rotation.from_rotvec(turn(t)))

    t_robot, t_camera = np.arange(0, 20, 0.008), np.arange(0.5, 19, 1 / 30)
    robot = Z * seen(t_robot).inv() * X.inv()
    return t_robot, robot, t_camera, shaken(rng, seen(t_camera + offset_s), 0.1 * MM, 0.05 * DEG)


@pytest.mark.parametrize("offset_s", [-0.21, 0.0, 0.137, -11.3])
def test_the_clocks_offset_is_found_and_its_doubt_true(offset_s: float) -> None:
    t_robot, robot, t_camera, camera = streams(12, offset_s)
    found = time_offset(t_robot, robot.rotation, t_camera, camera.rotation)
    assert abs(found.offset_s - offset_s) < 5 * found.std_s < 1e-3
    given, _ = pairs_of_streams(t_robot, robot, t_camera, camera)
    result = calibrate_eye_in_hand(given)
    assert np.abs(off(result)[:3]).max() < 1 * MM


def test_a_motion_that_is_done_twice_leaves_the_offset_open_unless_the_clocks_are_known() -> None:
    t_robot, robot, t_camera, camera = streams(12, 0.137)
    once = np.arange(0.0, 20.0, 0.02)
    again = np.concatenate([np.interp(once, t_robot, np.arange(len(t_robot))).astype(int)] * 2)
    t_twice, twice = np.arange(0.0, 40.0, 0.02), robot.rotation[again]
    with pytest.raises(Ambiguous, match="clocks-within"):
        time_offset(t_twice, twice, t_camera, camera.rotation)
    found = time_offset(t_twice, twice, t_camera, camera.rotation, within_s=5.0)
    assert abs(found.offset_s - 0.137) < 0.02


def test_streams_that_say_nothing_of_time_are_refused() -> None:
    t_robot, robot, t_camera, camera = streams(13, 0.0)
    still = Rotation.from_quat(np.tile([0, 0, 0, 1.0], (len(t_camera), 1)))
    _, _, _, other = streams(14, 0.0)
    swing = Rotation.from_rotvec(np.outer(np.sin(2 * np.pi * t_robot), [0.3, 0, 0]))
    swing_seen = Rotation.from_rotvec(np.outer(np.sin(2 * np.pi * t_camera), [-0.3, 0, 0]))
    with refuses(Degenerate, "nothing turns"):
        time_offset(t_robot, Rotation.from_quat(np.tile([0, 0, 0, 1.0], (len(t_robot), 1))), t_camera, still)
    with refuses(Inconsistent, "correlate"):
        time_offset(t_robot, robot.rotation, t_camera, other.rotation)
    with refuses(Ambiguous, "repeats"):
        time_offset(t_robot, swing, t_camera, swing_seen)
    with pytest.raises(NotEnoughData, match="shorter"):
        time_offset(t_robot[:50], robot.rotation[:50], t_camera, camera.rotation)


def pictures(seed: int, K: np.ndarray, distortion: np.ndarray) -> tuple[list[BoardView], RigidTransform]:
    """Board views by OpenCV's projection with 0.1 px of noise; the robot has 0.05 mm and 0.01 degrees."""
    rng = np.random.default_rng(seed)
    board = board_target(TargetKind.CHECKERBOARD, 9, 6, 0.025)
    middle = RigidTransform.from_translation(-board.xyz_m.mean(axis=0))
    seen = seen_poses(rng, 18, 0.4) * middle
    views = []
    for i in range(18):
        rvec = seen[i].rotation.as_rotvec()
        uv = cv2.projectPoints(board.xyz_m, rvec, seen[i].translation, K, distortion)[0][:, 0]
        uv = uv + rng.normal(0, 0.1, uv.shape)
        views.append(BoardView(uv_px=uv, index=np.arange(54), sigma_px=0.05, width=1280, height=960, source=f"{i}.png"))
    return views, shaken(rng, Z * seen.inv() * X.inv(), 0.05 * MM, 0.01 * DEG)
