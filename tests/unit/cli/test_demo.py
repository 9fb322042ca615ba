"""armsight demo and doctor: what the person is told, and that the demo's frames measured from files say the same."""

import csv
from pathlib import Path
from typing import Any

import pytest


def test_the_demo_compares_with_the_truth_and_its_frames_can_be_measured_again(armsight: Any, tmp_path: Path) -> None:
    out = tmp_path / "demo"
    done = armsight("demo", "--frames", 8, "--seed", 2, "--keep-frames", "-o", out)
    assert done.code == 0, done.text
    assert done.json["n_frames"] == 8
    assert done.json["n_ok"] >= 4
    for axis, limit in (("x_m", 1e-3), ("y_m", 1e-3), ("z_m", 3e-3), ("rx_rad", 0.02), ("rz_rad", 0.02)):
        assert 0.0 < done.json["truth"][axis]["rms"] < limit
        assert done.json["truth"][axis]["claimed"] > 0.0
    assert "the truth" in done.text
    assert done.json["assumptions"]
    real = done.json["pictures"]
    assert real["n_ok"] == real["n_pairs"] == 9
    assert real["rms_px"] < 0.25
    assert real["baseline_m"] == pytest.approx(0.08319, abs=2e-4)  # OpenCV's own result of all 13 pairs
    assert real["square_error_m"] < 3e-4
    assert (out / "pictures" / "report.html").exists()
    assert (out / "report.html").stat().st_size > 10_000
    inputs = ["--rig", out / "rig.yaml", "--target", out / "target.yaml", "--times", out / "times.csv"]
    again = armsight("measure", *inputs, "--left", out / "left", "--right", out / "right", "-o", tmp_path / "again")
    assert again.code == 0, again.text
    assert (tmp_path / "again" / "poses.csv").read_text() == (out / "poses.csv").read_text()
    with (out / "truth.csv").open(newline="") as file:
        assert len(list(csv.DictReader(file))) == 8
