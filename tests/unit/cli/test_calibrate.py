"""armsight calibrate, as a person calls it: figures, rejected images, and bad input."""

import shutil
from pathlib import Path
from typing import Any

from refusals import names_it


def test_a_wrong_board_is_refused_with_the_size_that_is_there(armsight: Any, boards: Any, tmp_path: Path) -> None:
    some = boards.folder / "left" / "shot[0-2].png"  # each is searched for boards of many sizes
    words = ["calibrate", "camera", some, "-o", tmp_path / "c.yaml", "--board"]
    done = armsight(*words, "checkerboard:8x5:0.02")
    assert done.code == 3
    assert "8x5" in done.json["error"]["cause"]
    assert "7x5" in done.text
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
