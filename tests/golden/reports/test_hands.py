"""Strangers' hand-eye calibrations: stale readings, arms that cannot tilt, a board that looks the same turned."""

import numpy as np
import pytest

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
