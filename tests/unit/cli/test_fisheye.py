"""Fisheye pictures, rendered by OpenCV's own fisheye model, as a person takes them through the commands."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from armsight.store import read_rig

SIZE, SQUARE_M, PAIRS = (480, 360), 0.03, 7
BOARD = f"checkerboard:9x6:{SQUARE_M}"
K = np.array([[150.0, 0.0, 241.0], [0.0, 149.5, 178.0], [0.0, 0.0, 1.0]])
D = np.array([-0.012, 0.02, -0.015, 0.004])
BASELINE_M = 0.1
OVER = 2
"""Sub-pixels along each axis."""


def render(rays: np.ndarray, R: np.ndarray, t: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Return the picture of the board at p_camera = R p + t by tracing every sub-pixel back to the print."""
    d, o = rays @ R, -R.T @ t
    s = (o[:2] - d[:, :2] * (o[2] / d[:, 2])[:, None]) / SQUARE_M
    ahead = o[2] / d[:, 2] < 0.0
    board = ahead & (s > -1.0).all(axis=1) & (s[:, 0] < 9.0) & (s[:, 1] < 6.0)
    paper = ahead & (s > -1.5).all(axis=1) & (s[:, 0] < 9.5) & (s[:, 1] < 6.5)
    squares = np.where(np.floor(s).sum(axis=1) % 2 == 0, 25.0, 205.0)
    fine = np.where(board, squares, np.where(paper, 205.0, 90.0)).reshape(SIZE[1], OVER, SIZE[0], OVER)
    image = cv2.GaussianBlur(fine.mean(axis=(1, 3)), (0, 0), 0.6) + rng.normal(0.0, 1.0, SIZE[::-1])
    return np.clip(np.rint(image), 0, 255).astype(np.uint8)


@pytest.fixture(scope="module")
def pictures(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Pairs of pictures in left/ and right/, the right camera BASELINE_M to the right, both looking the same way."""
    folder, rng = tmp_path_factory.mktemp("fisheye"), np.random.default_rng(3)
    cells = np.stack(np.meshgrid(np.arange(OVER * SIZE[0]), np.arange(OVER * SIZE[1])), axis=-1)
    uv = ((cells + 0.5) / OVER - 0.5).reshape(-1, 1, 2)
    rays = np.column_stack([cv2.fisheye.undistortPoints(uv, K, D).reshape(-1, 2), np.ones(len(uv))])
    middle = SQUARE_M * np.array([4.0, 2.5, 0.0])
    corners = SQUARE_M * np.array([[x, y, 0.0] for x in (-1.5, 9.5) for y in (-1.5, 6.5)])
    for side in ("left", "right"):
        (folder / side).mkdir()
    made = 0
    while made < PAIRS:
        turn, off = rng.uniform(0.0, 2.0 * np.pi), rng.uniform(0.2, 0.9)
        facing = cv2.Rodrigues(off * np.array([-np.sin(turn), np.cos(turn), 0.0]))[0]
        R = facing @ cv2.Rodrigues(rng.uniform([-0.6, -0.6, -0.3], [0.6, 0.6, 0.3]))[0]
        places = [facing[:, 2] * rng.uniform(0.25, 0.4) - R @ middle]
        places.append(places[0] - [BASELINE_M, 0.0, 0.0])
        seen = [
            cv2.fisheye.projectPoints((corners @ R.T + t)[:, None], np.zeros(3), np.zeros(3), K, D)[0] for t in places
        ]
        if any((uv < 3.0).any() or (uv > np.array(SIZE) - 4.0).any() for uv in seen):
            continue
        for side, t in zip(("left", "right"), places, strict=True):
            cv2.imwrite(str(folder / side / f"{made}.png"), render(rays, R, t, rng))
        made += 1
    return folder


def test_from_pictures_to_poses_and_other_programs_files(armsight: Any, pictures: Path, tmp_path: Path) -> None:
    sides, rig = ["--left", pictures / "left", "--right", pictures / "right"], tmp_path / "rig.yaml"
    calibrate = ["calibrate", "stereo", *sides, "--board", BOARD]
    done = armsight(*calibrate, "--lens", "fisheye", "-o", rig)
    assert done.code == 0, done.text
    assert done.json["n_used"] == PAIRS
    assert abs(done.json["baseline_m"] - BASELINE_M) < max(5.0 * done.json["std"]["baseline_m"], 1e-4)
    assert done.json["epipolar_rms_px"] < 0.1
    found = read_rig(rig)
    for kind, outs in (("opencv", ["a.yaml"]), ("kalibr", ["b.yaml"]), ("ros", ["c.yaml", "d.yaml"])):
        paths = [tmp_path / name for name in outs]
        assert (
            armsight("convert", "rig", rig, "--to", kind, *(word for path in paths for word in ("-o", path))).code == 0
        )
        assert armsight("convert", "rig", *paths, "-o", tmp_path / f"{kind}.yaml").code == 0
        back = read_rig(tmp_path / f"{kind}.yaml")
        assert back.left.is_close(found.left, tol=1e-9)
        assert back.right.is_close(found.right, tol=1e-9)
        assert abs(back.baseline_m - found.baseline_m) < 1e-9
    target = tmp_path / "board.yaml"
    target.write_text(
        f"format: armsight/target\nversion: 1\nkind: checkerboard\ncolumns: 9\nrows: 6\nsquare_m: {SQUARE_M}\n"
    )
    done = armsight("measure", "--rig", rig, "--target", target, *sides, "-o", tmp_path / "out")
    assert done.code == 0, done.text
    assert done.json["n_ok"] == PAIRS
