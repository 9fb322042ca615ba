"""Corners picked in real pictures, OpenCV's stereo pair of a chessboard of 25 mm, found in the other view."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

from armsight.cli.commands import app
from armsight.store.path_file import read_path

STEREO = Path(__file__).resolve().parents[3] / "shared" / "data" / "opencv_stereo"
RIG = """\
format: armsight/rig
version: 1
kind: stereo
cameras:
  left:
    {width: 640, height: 480, fx: 533.475, fy: 533.481, cx: 342.505, cy: 233.982,
     distortion: [-0.28862916, 0.09358271, 0.00119632, -0.00015541, 0.0],
     T_rig_camera: {xyz_m: [0.0, 0.0, 0.0], quat_xyzw: [0.0, 0.0, 0.0, 1.0]}}
  right:
    {width: 640, height: 480, fx: 536.898, fy: 536.470, cx: 327.472, cy: 248.832,
     distortion: [-0.29040756, 0.10651323, -0.00047909, 0.0000384, 0.0],
     T_rig_camera: {xyz_m: [0.083195, -0.000616, 0.000418], quat_xyzw: [-0.003273, -0.002064, 0.001868, 0.999991]}}
"""
PITCH_M = 0.025

pytestmark = pytest.mark.skipif(not STEREO.is_dir(), reason="the pictures of opencv_stereo are not here")


def board_corners(name: str) -> np.ndarray:
    """Corners (54, 2) of the board by OpenCV."""
    image = cv2.imread(str(STEREO / name), cv2.IMREAD_GRAYSCALE)
    found, corners = cv2.findChessboardCorners(image, (9, 6))
    assert found
    stop = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 40, 1e-3)
    return np.asarray(cv2.cornerSubPix(image, corners, (5, 5), (-1, -1), stop).reshape(-1, 2), float)


def run(tmp_path: Path, picks: np.ndarray, *more: str, pair: str = "01") -> tuple[int, dict]:
    (tmp_path / "rig.yaml").write_text(RIG)
    lines = [",".join(repr(float(value)) for value in px) for px in picks]
    (tmp_path / "picks.csv").write_text("u_px,v_px\n" + "\n".join(lines) + "\n")
    words = ["path", "from-picks", "--rig", tmp_path / "rig.yaml", "--picks", tmp_path / "picks.csv"]
    words += ["--left", STEREO / f"left{pair}.jpg", "--right", STEREO / f"right{pair}.jpg", "-o", tmp_path / "path.csv"]
    done = CliRunner().invoke(app, [*map(str, words), *more, "--json"])
    return done.exit_code, json.loads(done.stdout)


def test_corners_of_the_board_are_found_where_opencv_finds_them(tmp_path: Path) -> None:
    left, right = board_corners("left01.jpg"), board_corners("right01.jpg")
    row = slice(18, 36)  # two rows of nine corners
    code, told = run(tmp_path, left[row], "--near", "0.3", "--far", "0.5")
    off = np.array([point["other_px"] for point in told["points"]]) - right[row]
    assert code == 0 and told["n"] == 18 and told["frame"] == "rig"
    assert np.abs(off).max() < 0.3  # the pictures' own corners differ from the epipolar lines by 0.15 px RMS
    xyz = read_path(tmp_path / "path.csv").xyz_m.reshape(2, 9, 3)
    pitch = np.linalg.norm(np.diff(xyz, axis=1), axis=2)
    std = np.array([[point["std"][f"{k}_m"] for k in "xyz"] for point in told["points"]])
    assert abs(pitch.mean() - PITCH_M) < 2e-4 and np.sqrt(np.mean((pitch - PITCH_M) ** 2)) < 5e-4
    assert np.linalg.norm(std, axis=1).min() > 1e-4 and np.linalg.norm(std, axis=1).max() < 5e-3


def test_a_board_that_repeats_is_refused_over_wide_depths(tmp_path: Path) -> None:
    left, right = board_corners("left01.jpg")[::2], board_corners("right01.jpg")[::2]
    wide = ("--near", "0.25", "--far", "1.0", "--patch-px", "25")
    code, told = run(tmp_path, left[:4], *wide)
    assert code == 3 and "two places" in told["error"]["cause"] and not (tmp_path / "path.csv").exists()
    code, told = run(tmp_path, left, *wide, "--skip")
    off = [np.subtract(point["other_px"], right[point["pick"]]) for point in told["points"]]
    assert code == 0 and 2 <= len(off) < 14 and np.abs(off).max() < 0.3  # what is given is right


def test_pictures_of_another_moment_are_refused(tmp_path: Path) -> None:
    code, told = run(tmp_path, board_corners("left01.jpg")[18:20], "--near", "0.3", "--far", "0.5", pair="02")
    assert code == 3 and told["error"]["cause"]
