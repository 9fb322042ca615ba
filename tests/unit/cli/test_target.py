"""armsight calibrate target: from drawn frames to a target.yaml that measure reads."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from armsight.errors import BadFile
from armsight.store import read_target, write_target
from refusals import refuses

Run = Callable[..., Any]
COUNT = 10
LIGHTS = np.array([[-0.04, 0.0, 0.0], [0.03, 0.03, 0.0], [0.03, -0.03, 0.0]])


def draw(xyz_m: np.ndarray, camera_x_m: float, rng: np.random.Generator) -> np.ndarray:
    """Return the image that a camera of the scene's rig has of lights (n, 3)."""
    image = rng.normal(12.0, 1.5, (240, 320))
    rows, columns = np.mgrid[0:240, 0:320]
    for x, y, z in xyz_m:
        u, v = 400.0 * (x - camera_x_m) / z + 160.3, 400.0 * y / z + 119.6
        image += 150.0 * np.exp(-((columns - u) ** 2 + (rows - v) ** 2) / (2.0 * 1.8**2))
    return np.clip(np.rint(image), 0, 255).astype(np.uint8)


@pytest.fixture(scope="module")
def turned(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The lights turned to several sides; in frame4 a reflection stands for B."""
    folder = tmp_path_factory.mktemp("turned")
    rng = np.random.default_rng(5)
    xyz = rng.uniform([0.0, -0.03, 0.5], [0.1, 0.03, 0.55], (COUNT, 3))
    rotation = Rotation.from_rotvec(rng.uniform(-0.45, 0.45, (COUNT, 3)))
    for side in ("left", "right"):
        (folder / side).mkdir()
    for i in range(COUNT):
        own = LIGHTS.copy()
        own[1] += [0.015, 0.01, 0.0] if i == 4 else [0.0, 0.0, 0.0]
        for side, shift in (("left", 0.0), ("right", 0.1)):
            image = draw(rotation[i].apply(own) + xyz[i], shift, rng)
            cv2.imwrite(str(folder / side / f"frame{i}.png"), image)
    return folder


def test_target_is_found_and_written(armsight: Run, turned: Path, scene: Any, tmp_path: Path) -> None:
    out = tmp_path / "target.yaml"
    words = ["--rig", scene.folder / "rig.yaml", "--left", turned / "left", "--right", turned / "right"]
    done = armsight("calibrate", "target", *words, "--lights", 3, "-o", out)
    assert done.code == 0, done.text
    content = done.json
    assert set(content) == {
        "spots_m", "std", "distances_m", "n_frames", "n_used", "rejected", "residual_rms_px", "loo_rms_px", "advice",
        "verdict_",
    }  # fmt: skip
    assert content["n_frames"] == COUNT and content["n_used"] == COUNT - 1
    (left_out,) = content["rejected"]
    assert "frame4" in left_out["frame"] and "differ by" in left_out["why"]
    for pair, (i, j) in {"AB": (0, 1), "AC": (0, 2), "BC": (1, 2)}.items():
        d = content["distances_m"][pair]
        assert abs(d["value_m"] - np.linalg.norm(LIGHTS[i] - LIGHTS[j])) < 5 * d["std_m"] < 5e-4
    target = read_target(out)
    assert target.names == ("A", "B", "C") and target.model_known
    np.testing.assert_array_equal(target.xyz_m, list(content["spots_m"].values()))
    measured = armsight(
        "measure", "--rig", scene.folder / "rig.yaml", "--target", out, *scene.sources(), "-o", tmp_path
    )
    assert measured.code == 0, measured.text
    words[3], words[5] = words[5], words[3]
    exchanged = armsight("calibrate", "target", *words, "-o", tmp_path / "none.yaml")
    assert exchanged.code == 3 and "swapped" in exchanged.text


def test_deviations_in_the_file_name_the_same_lights(tmp_path: Path) -> None:
    path = tmp_path / "target.yaml"
    path.write_text("format: armsight/target\nversion: 1\nkind: spots\nspots_m: {A: [0.0, 0.0, 0.0]}\n")
    target = read_target(path)
    write_target(path, target, std_m={"A": [1e-5, 1e-5, 1e-5]})
    assert "std_m" in path.read_text() and read_target(path).names == ("A",)
    write_target(path, target, std_m={"B": [1e-5, 1e-5, 1e-5]})
    with refuses(BadFile, "std_m", "B"):
        read_target(path)
