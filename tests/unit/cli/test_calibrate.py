"""armsight calibrate, as a person calls it: figures, rejected images, and bad input."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import pytest

from refusals import names_it


def test_a_pair_is_found_and_measures_the_board(armsight: Any, boards: Any, tmp_path: Path) -> None:
    sides = ["--left", boards.folder / "left", "--right", boards.folder / "right"]
    done = armsight("calibrate", "stereo", *sides, "--board", boards.board, "-o", tmp_path / "rig.yaml")
    assert done.code == 0, done.text
    content = done.json
    assert (content["n_pairs"], content["n_used"]) == (10, 10)
    assert abs(content["baseline_m"] - boards.baseline_m) < max(5.0 * content["std"]["baseline_m"], 1e-4)
    assert content["metric"]["expected_m"] == pytest.approx(0.02)
    assert content["metric"]["rms_m"] < 1e-4
    assert content["epipolar_rms_px"] < 0.1
    (tmp_path / "board.yaml").write_text(
        "format: armsight/target\nversion: 1\nkind: checkerboard\ncolumns: 7\nrows: 5\nsquare_m: 0.02\n"
    )
    inputs = ["--rig", tmp_path / "rig.yaml", "--target", tmp_path / "board.yaml"]
    done = armsight("measure", *inputs, *sides, "-o", tmp_path / "out")
    assert done.code == 0, done.text
    assert done.json["n_ok"] == 10


def test_a_wrong_board_is_refused_with_the_size_that_is_there(armsight: Any, boards: Any, tmp_path: Path) -> None:
    some = boards.folder / "left" / "shot[0-2].png"  # each is searched for boards of many sizes
    words = ["calibrate", "camera", some, "-o", tmp_path / "c.yaml", "--board"]
    done = armsight(*words, "checkerboard:8x5:0.02")
    assert done.code == 3
    assert "8x5" in done.json["error"]["cause"]
    assert "7x5" in done.text
    for board in ("checkerboard:7x5", "checkerboard:7x5:20mm", "chess:7x5:0.02", "checkerboard:1x5:0.02"):
        done = armsight(*words, board)
        assert done.code == 2
        assert "checkerboard:COLUMNSxROWS:SQUARE_M" in done.text
    assert not (tmp_path / "c.yaml").exists()


def test_bad_images_and_counts_are_refused(armsight: Any, boards: Any, tmp_path: Path) -> None:
    for side in ("left", "right"):
        shutil.copytree(boards.folder / side, tmp_path / side)
    words = ["--left", tmp_path / "left", "--right", tmp_path / "right", "--board", boards.board]
    cut = tmp_path / "left" / "shot2.png"
    cut.write_bytes(cut.read_bytes()[:1000])
    done = armsight("calibrate", "stereo", *words, "--strict", "-o", tmp_path / "rig.yaml")
    assert done.code == 3
    assert str(cut) in done.json["error"]["cause"]
    done = armsight("calibrate", "stereo", *words, "-o", tmp_path / "lenient.yaml")
    assert done.code == 0
    assert (done.json["n_used"], done.json["n_pairs"]) == (9, 10)
    (left_out,) = done.json["rejected"]
    assert left_out["file"] == str(cut)
    assert "breaks off" in left_out["why"]
    cut.unlink()
    done = armsight("calibrate", "stereo", *words, "-o", tmp_path / "rig.yaml")
    assert done.code == 3
    assert names_it(done.json["error"]["cause"], "9 images", "10")
    assert not (tmp_path / "rig.yaml").exists()
