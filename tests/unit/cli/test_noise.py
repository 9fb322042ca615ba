"""armsight calibrate camera --noise: into a camera's file, into a rig's, with a board; and bad input."""

import shutil
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import yaml

from armsight import store
from refusals import names_it

CAMERA = """\
format: armsight/camera
version: 1
width: 640
height: 480
fx: 533.475
fy: 533.481
cx: 342.505
cy: 233.982
distortion: [-0.288629, 0.093583, 0.001196, -0.000155, 0.0]
rms_px: 0.195
inputs: [{path: left01.png, sha256: abc}]
"""


def write_stills(folder: Path, n: int, size: tuple[int, int] = (640, 480), *, colour: bool = False) -> Path:
    """Write n frames of a slope with bars; variance 2 + level / 10 and rounding."""
    folder.mkdir()
    rng = np.random.default_rng(n)
    x, y = np.meshgrid(np.linspace(0.0, 1.0, size[0]), np.linspace(0.0, 1.0, size[1]))
    light = 15.0 + 180.0 * x * (0.6 + 0.4 * np.sin(9.0 * y))
    for i in range(n):
        image = np.rint(light + rng.normal(size=light.shape) * np.sqrt(2.0 + light / 10.0)).astype(np.uint8)
        cv2.imwrite(str(folder / f"{i:02d}.png"), cv2.merge([image] * 3) if colour else image)
    return folder


@pytest.fixture(scope="module")
def stills(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_stills(tmp_path_factory.mktemp("noise") / "stills", 6)


def test_noise_is_added_to_a_camera_file(armsight: Any, stills: Path, tmp_path: Path) -> None:
    path = tmp_path / "camera.yaml"
    path.write_text(CAMERA)
    done = armsight("calibrate", "camera", "--noise", stills, "-o", path)
    assert done.code == 0, done.text
    content = done.json["noise"]
    assert content["linear"]["gain_levels"] == pytest.approx(0.1, rel=0.03)
    assert content["linear"]["read_noise_levels"] == pytest.approx(2.0**0.5, abs=0.1)
    assert (content["n_frames"], content["n_given"], content["n_copies"]) == (6, 6, 0)
    assert content["widening"] == pytest.approx([1.0, 1.0], abs=0.05)
    assert "Linear camera" in done.text
    file = store.read_camera_file(path)
    assert file.rms_px == 0.195
    assert file.camera.intrinsics[0] == 533.475
    assert file.noise.levels.tolist() == content["levels"]
    assert file.noise.variance_levels2.tolist() == content["variance_levels2"]
    near = file.noise.correlation
    assert (near.x.tolist(), near.y.tolist()) == (content["correlation"]["x"], content["correlation"]["y"])
    inputs = yaml.safe_load(path.read_text())["inputs"]
    assert (inputs[0]["path"], len(inputs)) == ("left01.png", 7)


def test_noise_goes_into_one_side_of_a_rig_and_is_copied(armsight: Any, scene: Any, tmp_path: Path) -> None:
    rig = tmp_path / "rig.yaml"
    shutil.copy(scene.folder / "rig.yaml", rig)
    frames = write_stills(tmp_path / "stills", 5, (320, 240))
    done = armsight("calibrate", "camera", "--noise", frames, "-o", rig)
    assert done.code == 2
    assert names_it(done.text, "--side left", "--side right")
    done = armsight("calibrate", "camera", "--noise", frames, "-o", rig, "--side", "right")
    assert done.code == 0, done.text
    before, found = store.read_rig(scene.folder / "rig.yaml"), store.read_rig(rig)
    assert found.noise[0] is None
    assert found.noise[1].variance_levels2.tolist() == done.json["noise"]["variance_levels2"]
    assert found.baseline_m == before.baseline_m
    (tmp_path / "new.yaml").write_bytes((scene.folder / "rig.yaml").read_bytes())
    done = armsight("calibrate", "camera", "--noise", rig, "-o", tmp_path / "new.yaml", "--side", "right")
    assert done.code == 0, done.text
    assert store.read_rig(tmp_path / "new.yaml").noise[1].levels.tolist() == found.noise[1].levels.tolist()
    done = armsight("calibrate", "camera", "--noise", rig, "-o", tmp_path / "new.yaml", "--side", "left")
    assert done.code == 3
    assert "holds no noise" in done.text
    (tmp_path / "camera.yaml").write_text(CAMERA)
    assert armsight("calibrate", "camera", "--noise", rig, "-o", tmp_path / "camera.yaml").code == 2
    measured = armsight("measure", "--rig", rig, *scene.inputs[2:], *scene.sources(), "-o", tmp_path / "out")
    assert measured.code == 0, measured.text


def test_what_cannot_be_is_refused(armsight: Any, stills: Path, tmp_path: Path) -> None:
    path = tmp_path / "camera.yaml"
    done = armsight("calibrate", "camera", "--noise", stills, "-o", path)
    assert (done.code, path.exists()) == (2, False)
    assert "SRC and --board" in done.text
    path.write_text(CAMERA)
    small = write_stills(tmp_path / "small", 4, (320, 240))
    done = armsight("calibrate", "camera", "--noise", small, "-o", path)
    assert done.json["error"]["kind"] == "Inconsistent"
    assert "320 x 240 px" in done.text
    (tmp_path / "target.yaml").write_text("format: armsight/target\nversion: 1\nkind: spots\nlabels: [A, B, C]\n")
    assert armsight("calibrate", "camera", "--noise", stills, "-o", tmp_path / "target.yaml").code == 3
    assert path.read_text() == CAMERA
