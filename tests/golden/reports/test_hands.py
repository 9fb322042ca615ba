"""Strangers' hand-eye calibrations: stale readings, arms that cannot tilt, a board that looks the same turned."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from armsight import calibrate_hand_eye
from armsight.errors import Degenerate, Inconsistent
from refusals import names_it, refuses
from reports import case


def test_a_reading_that_stands_still_is_named(tmp_path):
    with refuses(Inconsistent, "13 of 14", "last digit", "stale") as caught:
        calibrate_hand_eye(pairs=case("cameras-01") / "pairs.csv", out=tmp_path / "he.yaml")
    assert "tilt" not in caught.value.cure


@pytest.mark.parametrize(("name", "setup"), [("cameras-05", "eye-to-hand"), ("arms-30", "eye-in-hand")])
def test_an_arm_that_cannot_tilt_is_told_what_needs_no_tilt(name, setup, tmp_path):
    with refuses(Degenerate, "one axis", "SCARA", "armsight.calibrate_robot_world"):  # test_base_and_tool.py does so
        calibrate_hand_eye(pairs=case(name) / "pairs.csv", setup=setup, out=tmp_path / "he.yaml")


@pytest.mark.parametrize(
    ("name", "setup", "height_m", "right_mm"),
    [("cameras-05", "eye-to-hand", 0.05, (550, 300, 1200)), ("arms-30", "eye-in-hand", 0.0, (50, 20, None))],
)
def test_one_measured_height_is_enough_for_an_arm_that_cannot_tilt(name, setup, height_m, right_mm, tmp_path):
    done = calibrate_hand_eye(
        pairs=case(name) / "pairs.csv", setup=setup, target_height_m=height_m, out=tmp_path / "he.yaml"
    )
    off = [
        1e3 * found - right
        for found, right in zip(done.T_parent_camera.translation, right_mm, strict=True)
        if right is not None
    ]
    assert np.abs(off).max() < 0.6
    if name == "cameras-05":
        turn = done.T_parent_camera.rotation * Rotation.from_euler("xyz", [178, 3, 92], degrees=True).inv()
        assert np.rad2deg(turn.magnitude()) < 0.1


def test_a_board_that_looks_the_same_turned_is_read_as_the_robot_says(tmp_path):
    folder = case("cameras-12")
    done = calibrate_hand_eye(
        images=str(folder / "img"),
        camera=folder / "camera.yaml",
        board="checkerboard:8x6:0.02",
        robot=folder / "robot.csv",
        out=tmp_path / "he.yaml",
    )
    right = np.array([30.0, -80.0, 60.0])
    off = np.abs(1e3 * np.asarray(done.T_parent_camera.translation) - right)
    assert off.max() < 0.3
    assert [text for text in done.advice if names_it(text, "8x6", "turned")]


def test_the_pairs_of_camodocals_program_are_read(tmp_path):
    pairs = case("cameras-03") / "TransformPairsInput.yml"
    done = calibrate_hand_eye(pairs=pairs, setup="eye-to-hand", out=tmp_path / "he.yaml")
    off = np.asarray(done.T_parent_camera.translation) - [1.3, -0.25, 0.7]
    assert np.abs(off).max() < 2.5e-3
    part = [done.covariance.names.index(f"camera.{axis}_m") for axis in "xyz"]
    assert off @ np.linalg.inv(done.covariance.matrix[np.ix_(part, part)]) @ off < 11.3  # chi-square of three, 99 %
