"""Kalibr's AprilGrid, drawn here by its own description (codes of the family, two cells of border, squares at the
corners, tag 0 at the lower left, y up) and traced through a lens; nothing of OpenCV's markers or of armsight draws."""

from functools import cache

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter
from scipy.spatial.transform import Rotation

from armsight.errors import BadImage
from armsight.measure.boards import find_board
from armsight.records import Target
from armsight.store.targets import read_target
from kalibr_grid import COLUMNS, ROWS, SPACING, TAG_M, ink

KALIBR = f"target_type: 'aprilgrid'\ntagCols: {COLUMNS}\ntagRows: {ROWS}\ntagSize: {TAG_M}\ntagSpacing: {SPACING}\n"
WIDTH, HEIGHT, FOCAL, OVER = 640, 480, 560.0, 4


@cache
def picture(turn: tuple[float, float, float], t_m: tuple[float, float, float], border: int, k1: float = -0.2):
    """Return a picture of the board and where its corners are in it, in the order of Kalibr's grid (n, 2)."""
    y_up = Rotation.from_euler("x", 180, degrees=True)  # the board's z points to the camera
    R = (Rotation.from_rotvec(turn) * y_up).as_matrix()
    at = [k // 2 * TAG_M * (1.0 + SPACING) + k % 2 * TAG_M for k in range(2 * max(COLUMNS, ROWS))]
    board = np.array([(at[c], at[r], 0.0) for r in range(2 * ROWS) for c in range(2 * COLUMNS)])
    t = np.array(t_m) - R @ board.mean(axis=0)
    seen = board @ R.T + t
    flat = seen[:, :2] / seen[:, 2:]
    truth = flat * (1.0 + k1 * (flat**2).sum(axis=1))[:, None] * FOCAL + [WIDTH / 2, HEIGHT / 2]
    v, u = ((np.arange(OVER * n) + 0.5) / OVER - 0.5 for n in (HEIGHT, WIDTH))
    bent = np.stack(np.meshgrid((u - WIDTH / 2) / FOCAL, (v - HEIGHT / 2) / FOCAL), axis=-1)
    radius = np.linspace(0.0, 1.2, 20_001)
    straight = 1.0 / (1.0 + k1 * radius**2)
    ray = bent * np.interp(np.hypot(bent[..., 0], bent[..., 1]), radius / straight, straight)[..., None]
    d = np.concatenate([ray, np.ones((*ray.shape[:2], 1))], axis=-1) @ R
    o = -R.T @ t
    xy = o[:2] - d[..., :2] * (o[2] / d[..., 2])[..., None]
    fine = ink(xy[..., 0] / TAG_M, xy[..., 1] / TAG_M, border).reshape(HEIGHT, OVER, WIDTH, OVER).mean(axis=(1, 3))
    smear = np.exp(-0.5 * (np.arange(-3, 4) / 0.7) ** 2)
    for axis in (0, 1):
        fine = np.apply_along_axis(
            lambda row: np.convolve(np.pad(row, 3, "edge"), smear / smear.sum(), "valid"), axis, fine
        )
    noisy = 220.0 * fine + np.random.default_rng(3).normal(0.0, 2.0, fine.shape)
    return np.clip(np.rint(noisy), 0, 255).astype(np.uint8), truth


@pytest.fixture(scope="module")
def board(tmp_path_factory: pytest.TempPathFactory) -> Target:
    path = tmp_path_factory.mktemp("kalibr") / "aprilgrid.yaml"
    path.write_text(KALIBR)
    return read_target(path)


@pytest.mark.parametrize(
    ("turn", "t_m", "border"), [((0.2, -0.3, 0.1), (0.0, 0.0, 0.30), 2), ((-0.4, 0.1, 2.0), (0.01, 0.0, 0.35), 1)]
)
def test_its_corners_are_where_they_were_drawn(board: Target, turn, t_m, border: int) -> None:
    image, truth = picture(turn, t_m, border)
    seen = find_board(image, board)
    assert len(seen) == 4 * COLUMNS * ROWS
    error = seen.uv_px - truth[seen.index]
    # edges along the rows are drawn to 1/8 px: four samples a pixel
    assert np.sqrt(np.mean(error**2)) < 0.02 and np.abs(error).max() < 0.12
    assert seen.sigma_px < 0.05


def test_tags_stand_apart_from_the_squares_at_their_corners_in_a_soft_picture(board: Target) -> None:
    image, _ = picture((0.2, -0.3, 0.1), (0.0, 0.0, 0.30), 2)
    noise = np.random.default_rng(1).normal(0.0, 2.0, image.shape)
    soft = np.clip(np.rint(gaussian_filter(image.astype(float), 1.0) + noise), 0, 255).astype(np.uint8)
    assert len(find_board(soft, board)) >= 24


def test_it_may_be_seen_in_part_but_not_mirrored_and_other_tags_are_none(board: Target) -> None:
    image, truth = picture((0.2, -0.3, 0.1), (0.0, 0.0, 0.30), 2)
    part = image.copy()
    part[:, 330:] = 190
    seen = find_board(part, board)
    assert 8 <= len(seen) <= 30
    assert np.abs(seen.uv_px - truth[seen.index]).max() < 0.15
    with pytest.raises(BadImage, match="mirrored"):
        find_board(np.ascontiguousarray(image[:, ::-1]), board)
    with pytest.raises(BadImage, match="0 tags"):
        find_board(np.full_like(image, 90) + (np.arange(WIDTH) % 64).astype(np.uint8), board)
