"""Results of an earlier run: refused, replaced by finished ones only, never mixed; inputs are never written over."""

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
from armsight.errors import UsageError
from armsight.store.atomic import FAILED, EarlierResults

NAMES = ("poses.csv", "left", "report.html")


def content(folder: Path) -> dict[str, bytes]:
    return {str(p.relative_to(folder)): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


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
