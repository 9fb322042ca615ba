"""armsight reproduce: every table complete, armsight's errors beside the paper's, wrong use told."""

import html
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

Armsight = Callable[..., Any]


def complete(result: Any, out: Path) -> None:
    """Check what holds of every paper: each row has both methods' figures, and the files are there."""
    assert result.code == 0, result.text
    for name, item in result.json["tables"].items():
        assert item["rows"], name
        for key in ("paper", "paper_method", "armsight", "truth", "paper_truth", "credible", "share"):
            assert list(item[key]) == item["rows"], (name, key)
        for row in item["rows"]:
            assert item["paper_method"][row] is not None and item["armsight"][row] is not None, (name, row)
    assert json.loads((out / "reproduce.json").read_text()) == result.json
    page = (out / "report.html").read_text(encoding="utf-8")
    for name in result.json["figures"]:
        assert html.escape(name) in page
    assert result.json["assumptions"] and result.json["doubts"] and result.json["missing"]


def test_korayem_pose_trajectory_and_joints(armsight: Armsight, tmp_path: Path) -> None:
    result = armsight("reproduce", "korayem2018", "--frames", "12", "-o", tmp_path)
    complete(result, tmp_path)
    assert set(result.json["tables"]) == {"pose", "trajectory", "joints"}
    numbers = [name.partition(":")[0] for name in result.json["figures"]]
    assert numbers == [f"Fig. {k}" for k in range(6, 13)]
    pose = result.json["tables"]["pose"]
    assert all(value is None for value in pose["paper"].values())  # curves only
    for row in ("x_rms_m", "y_rms_m", "z_rms_m", "rx_rms_rad", "ry_rms_rad", "rz_rms_rad"):
        assert pose["share_of_method"][row] < 0.5, row
    assert pose["armsight"]["x_rms_m"] < 1e-3


def test_pachidis_three_tables_and_what_is_not_built_yet(armsight: Armsight, tmp_path: Path) -> None:
    result = armsight("reproduce", "pachidis2005", "--frames", "12", "-o", tmp_path)
    complete(result, tmp_path)
    tables = result.json["tables"]
    assert len(tables["table1"]["rows"]) == 24 and len(tables["table2"]["rows"]) == len(tables["table3"]["rows"]) == 18
    assert tables["table1"]["paper"]["z_sd_m"] == pytest.approx(0.000117)
    assert tables["table2"]["paper"]["rx_max_rad"] == pytest.approx(0.0327, abs=1e-4)
    # the mean of errors about the own mean is zero for whoever computes it so
    assert abs(tables["table1"]["paper_method"]["z_me_m"]) < 1e-15
    assert not tables["table1"]["credible"]["z_me_m"] and not tables["table1"]["credible"]["rx_sd_rad"]
    for name in ("table2", "table3"):
        for row in ("x_mae_m", "y_mae_m", "z_mae_m"):
            assert tables[name]["share"][row] <= 1 / 3, (name, row)
    assert any("servo" in text for text in result.json["missing"])


def test_an_unknown_paper_and_too_few_frames(armsight: Armsight, tmp_path: Path) -> None:
    unknown = armsight("reproduce", "denavit1955", "-o", tmp_path)
    assert unknown.code == 2
    assert "kapucu2005" in unknown.text
    few = armsight("reproduce", "kapucu2005", "--frames", "9", "-o", tmp_path)
    assert few.code == 2
    assert "30" in few.text
    assert armsight("reproduce", "kapucu2005", "--frames", "31", "-o", tmp_path).code == 2
    assert not (tmp_path / "report.html").exists()
