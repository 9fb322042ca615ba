"""armsight measure, as a person calls it: what comes out, and every bad input of the list."""

from __future__ import annotations

import csv
import json
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from armsight.errors import DeviceLost, Unseen
from armsight.measure.consistency import diagnosis
from armsight.measure.results import REASONS
from armsight.records import Frame

COUNT = 12
FILES = ("poses.csv", "points.csv", "spots.csv", "poses.tum", "measure.json", "report.html")


def rows(path: Path) -> list[dict[str, str]]:
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def column(table: list[dict[str, str]], *names: str) -> np.ndarray:
    return np.array([[float(row[name]) for name in names] for row in table])


def copied(scene: Any, folder: Path) -> Path:
    shutil.copytree(scene.folder, folder)
    return folder


def test_a_wrong_baseline_is_told_everywhere(armsight: Any, scene: Any, tmp_path: Path) -> None:
    folder = copied(scene, tmp_path / "scene")
    text = (folder / "rig.yaml").read_text()
    (folder / "rig.yaml").write_text(text.replace("xyz_m: [0.1,", "xyz_m: [0.102,"))
    inputs = ["--rig", folder / "rig.yaml", "--target", folder / "target.yaml"]
    done = armsight("measure", *inputs, *scene.sources(), "-o", tmp_path / "out")
    found = done.json["consistency"]
    assert done.code == 3 and found["verdict"] == "inconsistent" and found["cause"] == "scale"
    assert abs(found["estimate"] - 0.02) < 5.0 * found["std"] < 0.01
    assert 0.5 < found["effect_m"] / 0.012 < 2.0
    page = (tmp_path / "out" / "report.html").read_text()
    for place in (done.text, page):
        assert "against the baseline" in place and "calibrate target" in place
    assert "INCONSISTENT" in done.text and ">Inconsistent<" in page


def test_a_frame_far_beyond_its_claims_is_doubtful_by_itself(armsight: Any, scene: Any, tmp_path: Path) -> None:
    folder = copied(scene, tmp_path / "scene")
    text = (folder / "rig.yaml").read_text()
    (folder / "rig.yaml").write_text(text.replace("xyz_m: [0.1,", "xyz_m: [0.1002,"))
    inputs = ["--rig", folder / "rig.yaml", "--target", folder / "target.yaml"]
    done = armsight("measure", *inputs, *scene.sources(), "-o", tmp_path / "out")
    assert done.code == 0 and done.json["consistency"]["verdict"] != "inconsistent"
    n = done.json["n_doubtful"]
    assert 0 < n < COUNT and done.json["reasons"] == {"beyond_claims": n} and done.json["n_ok"] == COUNT - n
    assert [row["status"] for row in rows(tmp_path / "out" / "poses.csv")].count("doubtful") == n
    assert [row["status"] for row in rows(tmp_path / "out" / "points.csv")].count("doubtful") == 3 * n


def test_every_kind_of_reason_has_words_for_people() -> None:
    assert set(REASONS) == set(Unseen)


def test_no_row_of_an_inconsistent_run_is_to_be_acted_on(
    armsight: Any, scene: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Those written before the verdict too: it exits 3 with its files written, and replaces the results before."""
    folder, out = copied(scene, tmp_path / "scene"), tmp_path / "out"
    inputs = ["--rig", folder / "rig.yaml", "--target", folder / "target.yaml"]
    good = armsight("measure", *inputs, *scene.sources(), "-o", out)
    assert (good.code, good.json["n_ok"], good.json["n_doubtful"], good.json["reasons"]) == (0, COUNT, 0, {})
    text = (folder / "rig.yaml").read_text()
    (folder / "rig.yaml").write_text(text.replace("xyz_m: [0.1,", "xyz_m: [0.1001,"))
    monkeypatch.setattr(diagnosis, "INCONSISTENT", 2.0)  # a fault beyond 5 is refused or doubted frame by frame here
    done = armsight("measure", *inputs, *scene.sources(), "-o", out, "--overwrite")
    assert (done.code, done.json["n_ok"], done.json["n_doubtful"]) == (3, 0, COUNT)
    assert done.json["reasons"] == {"inconsistent": COUNT}
    assert {path.name for path in out.iterdir()} == set(FILES)
    assert {row["status"] for row in rows(out / "poses.csv")} == {"doubtful"}
    assert all(row["x_m"] and row["qw"] and row["srx_rad"] for row in rows(out / "poses.csv"))
    assert {row["status"] for row in rows(out / "points.csv")} == {"doubtful"}
    assert len((out / "poses.tum").read_text().splitlines()) == 1
    refused = armsight("calibrate", "tooltip", "--poses", out / "poses.csv", "-o", tmp_path / "tip.yaml")
    assert refused.code == 3 and "status ok" in refused.json["error"]["cause"]
    for file in ("poses.csv", "points.csv"):
        refused = armsight("verify", "--measured", out / file, "-o", tmp_path / "verified")
        assert refused.code == 3, refused.text


def test_a_world_moves_the_poses_and_times_come_from_their_file(armsight: Any, scene: Any, tmp_path: Path) -> None:
    (tmp_path / "world.yaml").write_text(
        "format: armsight/world\nversion: 1\nT_world_rig: {xyz_m: [1.0, 2.0, 3.0], quat_xyzw: [0.0, 0.0, 1.0, 0.0]}\n"
    )
    (tmp_path / "times.csv").write_text("t_s\n" + "".join(f"{5.0 + 0.01 * i}\n" for i in range(COUNT)))
    more = ["--world", tmp_path / "world.yaml", "--times", tmp_path / "times.csv", "--frames", 5]
    assert armsight("measure", *scene.inputs, *scene.sources(), *more, "-o", tmp_path / "out").code == 0
    table = rows(tmp_path / "out" / "poses.csv")
    np.testing.assert_allclose(column(table, "t_s")[:, 0], 5.0 + 0.01 * np.arange(5))
    want = np.array([1.0, 2.0, 3.0]) + scene.xyz_m[:5] * np.array([-1.0, -1.0, 1.0])
    np.testing.assert_allclose(column(table, "x_m", "y_m", "z_m"), want, atol=2e-3)


def test_a_truncated_image_is_a_lost_frame_and_strictly_the_end_of_the_run(
    armsight: Any, scene: Any, tmp_path: Path
) -> None:
    folder = copied(scene, tmp_path / "copy")
    path = folder / "right" / "frame9.png"
    path.write_bytes(path.read_bytes()[:-500])
    words = ["measure", *scene.inputs, *scene.sources(folder / "left", folder / "right")]
    done = armsight(*words, "-o", tmp_path / "lenient")
    assert done.code == 0
    assert (done.json["n_frames"], done.json["n_lost"]) == (12, 1)
    assert [row["status"] for row in rows(tmp_path / "lenient" / "poses.csv")].index("lost") == 9
    assert json.loads((tmp_path / "lenient" / "measure.json").read_text())["reasons"] == {"unreadable": 1}
    assert path.name in (tmp_path / "lenient" / "report.html").read_text()
    done = armsight(*words, "--strict", "-o", tmp_path / "out")
    assert done.code == 3
    assert done.json["error"]["kind"] == "BadImage"
    assert str(path) in done.json["error"]["cause"]
    assert "9 poses of 9 pairs" in done.json["error"]["consequence"]
    assert len(rows(tmp_path / "out" / "poses.csv")) == 9
    assert str(path) in json.loads((tmp_path / "out" / "measure.json").read_text())["error"]
    assert (tmp_path / "out" / "report.html").exists()


class Unplugged:
    """A live camera of a registered driver that goes after five frames."""

    total = None

    def __init__(self, folder: str, **_: object) -> None:
        self.name = f"camera:fake:{folder}"
        self.folder = Path(folder)

    def __enter__(self) -> Unplugged:
        return self

    def __exit__(self, *_: object) -> None:
        pass

    def __iter__(self) -> Iterator[Frame]:
        late_s = 0.004 if self.folder.name == "right" else 0.0
        for i in range(5):
            image = cv2.imread(str(self.folder / f"frame{i}.png"), cv2.IMREAD_GRAYSCALE)
            yield Frame(image=image, t_s=0.033 * i + late_s, sequence=i, source=self.name)
        raise DeviceLost(f"{self.name} stopped sending", consequence="No more frames", cure="Check the plug")


def test_a_camera_unplugged_midway_ends_with_4_and_keeps_what_was_measured(
    armsight: Any, scene: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("armsight.drivers.opening.load", lambda group, name: Unplugged)
    sides = [f"camera:fake:{scene.folder / side}" for side in ("left", "right")]
    done = armsight("measure", *scene.inputs, "--left", sides[0], "--right", sides[1], "-o", tmp_path / "out")
    assert done.code == 4
    assert done.json["error"]["kind"] == "DeviceLost"
    assert len(rows(tmp_path / "out" / "poses.csv")) == 5
    summary = json.loads((tmp_path / "out" / "measure.json").read_text())
    assert summary["n_ok"] == 5
    assert summary["skew"]["mean_s"] == pytest.approx(0.004)
