"""armsight calibrate mirrors and complex images measured, on images painted ray by ray."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from scipy.special import erf
from typer.testing import CliRunner

from armsight.app.measure import MeasureJob, measure
from armsight.app.simulate import simulate
from armsight.cli.commands import app
from armsight.errors import NotEnoughData
from armsight.sim.lens import Lens
from armsight.sim.mirror import MirrorLens, Mirrors, mirror_views
from armsight.store import read_poses, read_rig

Array = NDArray[np.float64]
Tilts = tuple[tuple[float, float], ...]

WIDTH, HEIGHT = 720, 540
COLUMNS, ROWS, SQUARE_M = 7, 5, 0.02
BOARD = f"checkerboard:{COLUMNS}x{ROWS}:{SQUARE_M}"
BLACK, WHITE, ROOM = 12.0, 95.0, 35.0
BLUR_PX = 0.7


def step(x: Array, at: Array | float, width: Array) -> Array:
    return np.asarray(0.5 + 0.5 * erf((x - at) / (np.sqrt(2.0) * width)))


def paint(view: MirrorLens, R: Array, t: Array) -> Array:
    """The board's light (h, w): every pixel's ray traced through the mirrors to the board's plane, edges blurred."""
    v, u = np.mgrid[0:HEIGHT, 0:WIDTH].astype(float)
    place, ray = view.mirrors.trace(view.side, view.rays(np.stack([u.ravel(), v.ravel()], axis=1)))
    along = ((t - place) @ R[:, 2]) / (ray @ R[:, 2])
    X = (place + along[:, None] * ray - t) @ R / SQUARE_M
    width = BLUR_PX * along / (view.focal_px[0] * SQUARE_M)
    value = np.ones(len(X))
    inside, paper = np.ones(len(X)), np.ones(len(X))
    for x, n in ((X[:, 0], COLUMNS), (X[:, 1], ROWS)):
        k: Array = np.clip(np.rint(x), 0, n - 1)
        value *= np.where(k % 2 == 0, 1.0, -1.0) * (2.0 * step(x, k, width) - 1.0)
        inside *= step(x, -1.0, width) - step(x, float(n), width)
        paper *= step(x, -2.0, width) - step(x, n + 1.0, width)
    squares = 0.5 * (BLACK + WHITE) + 0.5 * (WHITE - BLACK) * value
    level = ROOM * (1.0 - paper) + paper * (WHITE * (1.0 - inside) + inside * squares)
    return np.asarray(level.reshape(HEIGHT, WIDTH))


def pictures(folder: Path, seed: int, count: int, tilts: Tilts = ((0.0, 0.0),) * 4, *, complex_only: bool) -> None:
    """Write `count` complex images, or as many of the left and of the right view alone."""
    rng = np.random.default_rng(seed)
    lens = Lens(width=WIDTH, height=HEIGHT, focal_px=(600.0, 601.0), centre_px=(361.0, 266.0))
    views = mirror_views(lens, Mirrors(baseline_m=0.1, tilts_rad=tilts))
    size = SQUARE_M * np.array([COLUMNS - 1, ROWS - 1, 0.0])
    rim = SQUARE_M * np.array([[x, y, 0.0] for x in (-2.0, COLUMNS + 1.0) for y in (-2.0, ROWS + 1.0)])
    done = 0
    while done < count:
        R = Rotation.from_euler("xyz", rng.uniform(-0.45, 0.45, 3)).as_matrix()
        z = rng.uniform(0.3, 0.5)
        t = z * np.array([rng.uniform(-0.3, 0.3), rng.uniform(-0.25, 0.25), 1.0]) - R @ (size / 2)
        if any(
            ((uv < 4) | (uv > [WIDTH - 5, HEIGHT - 5])).any()
            for uv in (v.project(rim @ R.T + t) for v in views.values())
        ):
            continue
        light = {side: paint(view, R, t) for side, view in views.items()}
        out = {"image": light["left"] + light["right"]} if complex_only else {k: 20.0 + v for k, v in light.items()}
        for name, image in out.items():
            (folder / name).mkdir(parents=True, exist_ok=True)
            noisy = np.clip(np.rint(image + rng.normal(0.0, 1.0, image.shape)), 0, 255).astype(np.uint8)
            cv2.imwrite(str(folder / name / f"{done:03d}.png"), noisy)
        done += 1


def run(*arguments: str) -> tuple[int, dict[str, Any]]:
    result = CliRunner().invoke(app, ["calibrate", "mirrors", *arguments, "--json"])
    return result.exit_code, json.loads(result.stdout)


@pytest.fixture(scope="module")
def rig(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A rig calibrated from covered views and complex images together."""
    folder = tmp_path_factory.mktemp("mirrors")
    pictures(folder, 1, 9, complex_only=False)
    pictures(folder, 2, 2, complex_only=True)
    out = folder / "rig.yaml"
    code, content = run(
        "--left-only", str(folder / "left"), "--right-only", str(folder / "right"), "--image", str(folder / "image"),
        "--board", BOARD, "-o", str(out), "--plate-mm", "1",
    )  # fmt: skip
    assert code == 0, content
    assert content["n_pairs"] == 11 and content["n_used"] >= 10
    assert content["baseline_m"] == pytest.approx(0.10033, abs=1e-4)  # the plate's shift included
    assert content["alignment"]["plate"]["m_m"] == pytest.approx(0.32914e-3, abs=1e-8)
    assert abs(content["alignment"]["convergence_rad"]) < 3e-4 and abs(content["alignment"]["vertical_px"]) < 0.1
    assert content["rms_px"] < 0.05 and content["holdout_rms_px"] < 0.06
    assert content["metric"]["mean_m"] == pytest.approx(SQUARE_M, rel=2e-3)
    assert (folder / "rig.report.html").stat().st_size > 10_000
    return out


def test_the_rig_says_what_it_is(rig: Path) -> None:
    found = read_rig(rig)
    assert found.kind == "mirror" and found.left.plate is not None and found.right.plate is None
    assert found.left.intrinsics[0] == pytest.approx(600.0, abs=1.0)


def test_the_check_names_the_mirror(rig: Path, tmp_path: Path) -> None:
    pictures(tmp_path, 5, 2, ((0.0, 0.0), (0.0, 0.0), (0.0, 0.0), (3e-3, -2e-3)), complex_only=True)
    code, content = run("--check", "--rig", str(rig), "--image", str(tmp_path / "image"), "--board", BOARD)
    assert code == 0 and content["moved"]
    best = content["suspects"][0]
    assert best["mirror"] == 4
    assert (best["turn_rad"], best["tilt_rad"]) == pytest.approx((3e-3, -2e-3), abs=4e-4)
    assert "turn mirror 4" in content["advice"][0]


def test_what_cannot_be_calibrated_is_refused(rig: Path, tmp_path: Path) -> None:
    code, content = run("--board", BOARD, "-o", str(tmp_path / "x.yaml"))
    assert code == 2 and "--image" in content["error"]["cure"]
    code, content = run("--image", str(rig.parent / "image"), "--board", BOARD)
    assert code == 2
    code, content = run("--image", str(rig.parent / "left"), "--board", BOARD, "-o", str(tmp_path / "x.yaml"))
    assert code == 3 and "none of the images" in content["error"]["cause"]  # one view only: a path is dark
    pictures(tmp_path, 8, 2, complex_only=False)
    code, content = run(
        "--left-only", str(tmp_path / "left"), "--right-only", str(rig.parent / "right"), "--board", BOARD,
        "-o", str(tmp_path / "x.yaml"),
    )  # fmt: skip
    assert code == 3 and "do not pair up" in content["error"]["cause"]
    assert not (tmp_path / "x.yaml").exists()
    code, content = run("--check", "--image", str(rig.parent / "image"), "--board", BOARD)
    assert code == 2 and "--rig" in content["error"]["cure"]
    code, content = run("--check", "--rig", str(rig), "--image", str(rig.parent / "image"), "--target", "target.yaml")
    assert code == 2 and "--board" in content["error"]["cure"]


def test_complex_frames_are_measured(tmp_path: Path) -> None:
    """The paper's static target, seen through the mirrors: both ways of finding spots, against the truth."""
    simulate("pachidis2005-static", tmp_path / "s", seed=3, frames=12)
    truth = np.array(
        [pose.pose.translation for pose in read_poses(tmp_path / "s" / "truth.csv") if pose.pose is not None]
    )
    errors = {}
    for method in ("likelihood", "seed"):
        job = MeasureJob(
            rig=tmp_path / "s" / "rig.yaml", target=tmp_path / "s" / "target.yaml", out=tmp_path / method,
            image=str(tmp_path / "s" / "image"), method=method,
        )  # fmt: skip
        summary = measure(job)
        assert summary.n_ok == 12
        found = np.array(
            [pose.pose.translation for pose in read_poses(tmp_path / method / "poses.csv") if pose.pose is not None]
        )
        errors[method] = np.sqrt(np.mean((found - truth) ** 2, axis=0))
    assert errors["likelihood"][2] < 1.2e-4 and errors["likelihood"][:2].max() < 3e-5
    assert errors["likelihood"][2] < errors["seed"][2] < 1e-3


def test_a_board_is_measured_in_a_complex_image(rig: Path, tmp_path: Path) -> None:
    job = MeasureJob(rig=rig, target=Path(BOARD), out=tmp_path / "m", image=str(rig.parent / "image"))
    assert measure(job).n_ok == 2
    dark = MeasureJob(rig=rig, target=Path(BOARD), out=tmp_path / "d", image=str(rig.parent / "left"), limit=1)
    with pytest.raises(NotEnoughData, match="none of the 1 pairs"):
        measure(dark)
