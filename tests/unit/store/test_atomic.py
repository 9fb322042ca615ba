"""A crash leaves the old file or the new one; a growing table holds whole rows at any moment."""

import json
import os
import stat
from pathlib import Path

import numpy as np
import pytest

from armsight.clock import ManualClock
from armsight.errors import BadFile, DeviceFailed
from armsight.store import atomic, json_text, sha256, write_bytes, write_json, write_text
from refusals import refuses


def test_a_failed_write_leaves_the_old_file_and_no_litter(tmp_path, monkeypatch):
    path = tmp_path / "rig.yaml"
    write_text(path, "old")

    def no_space(self, target):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "replace", no_space)
    with refuses(DeviceFailed, "No space"):
        write_text(path, "new")
    assert path.read_text() == "old"
    assert [item.name for item in tmp_path.iterdir()] == ["rig.yaml"]


def test_an_interrupt_leaves_the_old_file_and_no_litter(tmp_path, monkeypatch):
    path = tmp_path / "rig.yaml"
    write_text(path, "old")

    def interrupted(handle):
        raise KeyboardInterrupt

    monkeypatch.setattr(os, "fsync", interrupted)
    with pytest.raises(KeyboardInterrupt):
        write_text(path, "new")
    assert path.read_text() == "old"
    assert len(list(tmp_path.iterdir())) == 1


def test_a_new_file_has_the_usual_permissions_and_a_replaced_one_keeps_its_own(tmp_path):
    reference, path = tmp_path / "by_open", tmp_path / "deep" / "by_us"
    reference.write_text("x")
    write_bytes(path, b"x")
    assert stat.S_IMODE(path.stat().st_mode) == stat.S_IMODE(reference.stat().st_mode)
    path.chmod(0o640)
    write_bytes(path, b"y")
    assert stat.S_IMODE(path.stat().st_mode) == 0o640


def test_json_is_strict_and_no_data_is_null(tmp_path):
    value = {
        "a": np.float64(0.1),
        "n": np.int64(3),
        "none": float("nan"),
        "list": np.arange(2),
        "path": Path("x") / "y",
    }
    assert json.loads(json_text(value)) == {"a": 0.1, "n": 3, "none": None, "list": [0, 1], "path": "x/y"}
    write_json(tmp_path / "out.json", value)
    assert json.loads((tmp_path / "out.json").read_text())["a"] == 0.1


def test_sha256_of_known_content(tmp_path):
    path = tmp_path / "abc"
    path.write_bytes(b"abc")
    assert sha256(path) == "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad"
    with refuses(BadFile, "cannot be read"):
        sha256(tmp_path / "missing")


def test_a_growing_table_holds_whole_rows_only(tmp_path):
    clock, path = ManualClock(), tmp_path / "rows.csv"
    rows = atomic.RowFile(path, "a,b", clock=clock)
    assert path.read_text() == "a,b\n"  # readable before the first row
    rows.add("1,2")
    assert path.read_text() == "a,b\n"
    clock.advance(atomic.FLUSH_S)
    rows.add("3,4")
    assert path.read_text() == "a,b\n1,2\n3,4\n"
    for i in range(atomic.FLUSH_ROWS):
        rows.add(f"{i},{i}")
    assert path.read_text().count("\n") == 3 + atomic.FLUSH_ROWS
    rows.add("last,row")
    rows.close()
    rows.close()
    assert path.read_text().endswith("last,row\n")


def test_an_exception_does_not_eat_the_rows_before_it(tmp_path):
    path = tmp_path / "rows.csv"

    def fail() -> None:
        with atomic.RowFile(path, "a") as rows:
            rows.add("1")
            raise RuntimeError

    with pytest.raises(RuntimeError):
        fail()
    assert path.read_text() == "a\n1\n"


def test_a_folder_that_refuses_is_a_device_error(tmp_path):
    (tmp_path / "file").write_text("")
    with refuses(DeviceFailed, "written"):
        write_text(tmp_path / "file" / "below", "x")
    with refuses(DeviceFailed, "written"):
        atomic.RowFile(tmp_path / "file" / "below", "x")
