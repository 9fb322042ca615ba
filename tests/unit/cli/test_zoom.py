"""Zoom lenses as a person calibrates and uses them: settings added, a rig at one of them, and what does not fit."""

from pathlib import Path
from typing import Any

import pytest
import yaml

from refusals import names_it

FOCALS = {100: 400.0, 200: 460.0, 300: 540.0}


def lens_file(path: Path, focals: dict[int, float]) -> Path:
    settings = [
        {
            "zoom": float(zoom),
            "fx": focal,
            "fy": focal,
            "cx": 160.3,
            "cy": 119.6,
            "distortion": [0.0] * 5,
            "covariance": {"names": ["fx"], "matrix": [[0.01]]},
        }
        for zoom, focal in focals.items()
    ]
    path.write_text(
        yaml.safe_dump(
            {"format": "armsight/camera", "version": 1, "width": 320, "height": 240, "zoom": settings}, sort_keys=False
        )
    )
    return path


@pytest.fixture
def rig(armsight: Any, scene: Any, tmp_path: Path) -> Path:
    lens = lens_file(tmp_path / "lens.yaml", FOCALS)
    words = ["--rig", scene.folder / "rig.yaml", "--left", lens, "--right", lens, "--zoom-left", 100, "--zoom-right"]
    done = armsight("calibrate", "zoom-rig", *words, 100, "-o", tmp_path / "rig.yaml")
    assert done.code == 0, done.text
    assert done.json["pupils"] is False and done.json["advice"]
    return tmp_path / "rig.yaml"


def test_settings_are_added_and_replaced(armsight: Any, boards: Any, tmp_path: Path) -> None:
    out = tmp_path / "camera.yaml"
    words = ["calibrate", "camera", boards.folder / "left", "--board", boards.board, "-o", out, "--zoom"]
    for zoom in (100, 100):
        done = armsight(*words, zoom)
        assert done.code == 0, done.text
        assert done.json["zoom"]["settings"] == [100.0]
    before = out.read_bytes()
    small = lens_file(tmp_path / "other.yaml", FOCALS)
    done = armsight(*words[:-3], "-o", small, "--zoom", 400)
    assert done.code == 3 and "640x480" in done.text
    done = armsight("convert", "camera", out, "--zoom", 150, "-o", tmp_path / "one.yaml")
    assert done.code == 3 and "calibrated at 100" in done.json["error"]["cause"]
    assert out.read_bytes() == before
    (tmp_path / "plain.yaml").write_text("format: armsight/camera\nversion: 1\nwidth: 640\nheight: 480\n")
    done = armsight(*words[:-3], "-o", tmp_path / "plain.yaml", "--zoom", 400)
    assert done.code == 3 and "zoom settings" in done.text


def test_measure_takes_a_setting(armsight: Any, scene: Any, rig: Path, tmp_path: Path) -> None:
    words = ["measure", "--rig", rig, *scene.inputs[2:], *scene.sources(), "-o", tmp_path / "out", "--overwrite"]
    done = armsight(*words, "--zoom-left", 100, "--zoom-right", 100)
    assert done.code == 0, done.text
    assert done.json["n_ok"] == done.json["n_frames"]
    assert done.json["zoom"]["left"]["fx_px"] == 400.0
    done = armsight(*words)
    assert done.code == 2 and "--zoom-left" in done.json["error"]["cure"]
    done = armsight(*words, "--zoom-left", 301, "--zoom-right", 100)
    assert done.code == 3 and names_it(done.json["error"]["cause"], "outside", "100", "300")
    done = armsight(*words, "--zoom-left", 100, "--zoom-right", 100, "--set-zoom")
    assert done.code == 2 and names_it(done.text, "--set-zoom", "live")
    done = armsight(*words, "--set-zoom")
    assert done.code == 2 and names_it(done.json["error"]["cause"], "left", "zoom")
    assert "--zoom-left" in done.json["error"]["cure"]


def test_the_doctor_says_what_reaches_an_accuracy(armsight: Any, scene: Any, rig: Path) -> None:
    words = ["doctor", "--rig", rig, "--depth", 0.6, "--sigma", 0.05]
    plan = armsight(*words, "--accuracy", 1.0).json["rig"]["accuracy"]
    assert [one["zoom_left"] for one in plan["settings"]] == [100.0, 150.0, 200.0, 250.0, 300.0]
    spots = [one["now"]["spots_m"] for one in plan["settings"]]
    assert spots == sorted(spots, reverse=True)  # the longer the lens, the better
    plain = armsight("doctor", "--rig", scene.folder / "rig.yaml", *words[3:], "--accuracy", 0.3).json["rig"][
        "accuracy"
    ]
    (only,) = plain["settings"]
    assert only["zoom_left"] is None and not only["reached"]
    assert only["baseline_m"] > plain["baseline_m"]
    assert only["at_baseline"]["total_m"] <= 3e-4 < only["now"]["total_m"]
    # on the axis depth goes as Z^2 sqrt(2) sigma / (B f); the worst point of the view is a little worse
    assert only["now"]["spots_m"] == pytest.approx(0.36 * 2**0.5 * 0.05 / (0.1 * 400.0), rel=0.25)
    assert armsight("doctor", "--accuracy", 1.0).code == 2
    assert armsight("doctor", "--depth", 1.0).code == 2
