"""Results of an earlier run: refused, replaced by finished ones only, never mixed; inputs are never written over."""

from __future__ import annotations

import base64
import csv
import gzip
import re
import shutil
import signal
from pathlib import Path
from typing import Any

import pytest

from armsight.cli.command_ui import CommandUI
from armsight.errors import Cancelled, UsageError
from armsight.ops.simulation.run import simulate
from armsight.records import Silent
from armsight.store.atomic import FAILED, EarlierResults
from refusals import names_it

NAMES = ("poses.csv", "left", "report.html")


def measure_words(scene: Any, out: Path) -> list[Any]:
    files = ["--rig", scene.folder / "rig.yaml", "--target", scene.folder / "target.yaml"]
    return ["measure", *files, *scene.sources(), "-o", out]


def content(folder: Path) -> dict[str, bytes]:
    return {str(p.relative_to(folder)): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


def test_measure_leaves_another_runs_results_alone_until_it_is_told_to_replace_them(
    armsight: Any, scene: Any, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    assert armsight(*measure_words(scene, out)).code == 0
    (out / "notes.txt").write_text("mine")
    before = content(out)
    again = armsight(*measure_words(scene, out))
    assert again.code == 2
    assert "poses.csv" in again.text
    assert "--overwrite" in again.text
    assert content(out) == before
    wrong = [*measure_words(scene, out), "--frames", "1", "--overwrite"]
    wrong[wrong.index("--target") + 1] = tmp_path / "nosuch.yaml"
    assert armsight(*wrong).code == 3
    assert content(out) == before, "a run that fails leaves what was there"
    failed = armsight(*measure_words(scene, out), "--inverted", "--overwrite")
    assert failed.code == 3 and names_it(failed.text, str(out / "failed"), "earlier results")
    assert {name: data for name, data in content(out).items() if not name.startswith("failed")} == before
    assert (out / "failed" / "report.html").exists()
    shutil.rmtree(out / "failed")
    fewer = armsight(*measure_words(scene, out), "--frames", "1", "--overwrite")
    assert fewer.code == 0
    assert fewer.json["n_frames"] == 1
    after = content(out)
    assert set(after) == set(before)
    assert after["notes.txt"] == b"mine"
    assert after["poses.csv"] != before["poses.csv"]


class StopsAt(Silent):
    def __init__(self, done: int) -> None:
        self.until, self.done = done, 0.0

    def update(self, done: float, total: float, note: str = "") -> None:
        self.done = done

    def cancelled(self) -> bool:
        return self.done >= self.until


def test_a_simulation_that_is_stopped_leaves_tables_that_match_its_frames(tmp_path: Path) -> None:
    with pytest.raises(Cancelled, match="2"):
        simulate("webcam-cell", tmp_path, frames=5, room="dark", progress=StopsAt(2))
    assert len(list((tmp_path / "left").iterdir())) == 2
    tables = [tmp_path / name for name in ("times.csv", "truth.csv", "truth_world.csv", "joints.csv")]
    lengths = {path.name: len(path.read_text().splitlines()) - 1 for path in tables if path.exists()}
    assert set(lengths.values()) == {2}, lengths


def test_earlier_results_come_back_or_go_as_a_whole(tmp_path: Path) -> None:
    def fill(text: str) -> None:
        (tmp_path / "left").mkdir(exist_ok=True)
        for name in ("poses.csv", "left/0.png"):
            (tmp_path / name).write_text(text)

    fill("old")
    earlier = EarlierResults(tmp_path, NAMES)
    assert not (tmp_path / "poses.csv").exists()
    (tmp_path / "report.html").write_text("half")
    assert earlier.put_back() == tmp_path / FAILED
    assert content(tmp_path) == {"poses.csv": b"old", "left/0.png": b"old", f"{FAILED}/report.html": b"half"}
    shutil.rmtree(tmp_path / FAILED)
    earlier = EarlierResults(tmp_path, NAMES)
    earlier.settle()
    assert content(tmp_path) == {"poses.csv": b"old", "left/0.png": b"old"}, "nothing new, nothing lost"
    earlier = EarlierResults(tmp_path, NAMES)
    (tmp_path / "poses.csv").write_text("new")
    earlier.settle()
    assert content(tmp_path) == {"poses.csv": b"new"}
    assert [path.name for path in tmp_path.iterdir()] == ["poses.csv"]


def test_sigterm_is_like_ctrl_c(capsys: pytest.CaptureFixture[str]) -> None:
    with CommandUI(as_json=False, until_stopped=True) as face:
        progress = face.progress("working")
        assert not progress.cancelled()
        signal.raise_signal(signal.SIGTERM)
        assert progress.cancelled()
    assert "stopping" in capsys.readouterr().err


def test_times_beside_the_frames_are_used_and_an_assumed_time_is_said(
    armsight: Any, scene: Any, tmp_path: Path
) -> None:
    folders = {side: tmp_path / side for side in ("left", "right")}
    for side, folder in folders.items():
        folder.mkdir()
        for path in sorted((scene.folder / side).iterdir())[:3]:
            (folder / path.name).symlink_to(path)  # links are followed
    files = ["--rig", scene.folder / "rig.yaml", "--target", scene.folder / "target.yaml"]
    words = ["measure", *files, "--left", folders["left"], "--right", folders["right"], "-o"]

    def measured(name: str) -> tuple[Any, list[float], str]:
        done = armsight(*words, tmp_path / name)
        assert done.code == 0, done.text
        times_s = [
            float(row["t_s"]) for row in csv.DictReader((tmp_path / name / "poses.csv").read_text().splitlines())
        ]
        page = (tmp_path / name / "report.html").read_text()
        drawn = re.search(r'id="figures">(.*?)</script>', page)
        assert drawn is not None
        return done, times_s, gzip.decompress(base64.b64decode(drawn[1])).decode()

    done, times_s, report = measured("assumed")
    assert done.json["assumed_fps"] == 30.0
    assert "30 fps" in done.text
    assert times_s == pytest.approx([0.0, 1 / 30, 2 / 30])
    assert "time, s" not in report
    (tmp_path / "times.csv").write_text("t_s\n1.0\n1.5\n2.5\n")
    done, times_s, report = measured("beside")
    assert "assumed_fps" not in done.json
    assert times_s == [1.0, 1.5, 2.5]
    assert "time, s" in report
    (tmp_path / "times.csv").write_text("t_s\n1.0\n")
    done, times_s, _ = measured("of-another-run")
    assert done.json["assumed_fps"] == 30.0


def test_two_commands_do_not_write_to_one_place_at_once(
    armsight: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    inner: list[Any] = []

    def meanwhile(*_: object, **__: object) -> None:
        monkeypatch.undo()
        inner.append(
            armsight("simulate", "hand-cell", "-o", tmp_path / "x" / ".." / "cell", "--frames", 1, "--room", "dark")
        )
        raise UsageError("enough")

    monkeypatch.setattr("armsight.ops.simulation.run.simulate", meanwhile)
    words = ["simulate", "hand-cell", "-o", tmp_path / "cell", "--frames", 1]
    assert armsight(*words).code == 2
    assert inner[0].code == 4
    assert "-o" in inner[0].text
    assert not (tmp_path / "cell").exists()
    assert armsight(*words).code == 0, "the first one's end lets go"
