"""ChArUco boards far away: found, with honest corners; what is blurred, doubled, half in shadow or not there is not."""

from __future__ import annotations

import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

from armsight.errors import BadImage
from armsight.measure.boards import find_board, find_two_boards
from armsight.records import TargetKind, board_target

sys.path.insert(0, str(Path(__file__).parent))  # the scene, which benchmarks share
from far_boards import SIZE, FarBoard, far_board

SEEDS = (0, 1, 3, 4, 6, 9, 10)
OFF = 5.0
"""Standard deviations beyond which a corner is false."""


def off(made: FarBoard) -> np.ndarray:
    """Return how far the corners found (n, 2) are from the truth, in their standard deviations."""
    seen = find_board(made.image, made.board)
    return (seen.uv_px - made.uv_px[seen.index]) / seen.sigma_px


def part(made: FarBoard, image: np.ndarray | None = None, around_px: int = 80) -> FarBoard:
    """Return the board cut out of its picture, or of the one given."""
    low = (made.uv_px.min(axis=0) - around_px).clip(0).astype(int)
    high = (made.uv_px.max(axis=0) + around_px).astype(int)
    cut = (made.image if image is None else image)[low[1] : high[1], low[0] : high[0]]
    return FarBoard(image=np.ascontiguousarray(cut), board=made.board, uv_px=made.uv_px - low)


def test_corners_of_small_leaning_squares_are_placed_as_well_as_their_deviation_says() -> None:
    errors = [
        off(part(far_board(seed, 25.0, blur_px=0.5, noise=2.0, textured=seed % 2 == 0, tilt_deg=35.0)))
        for seed in SEEDS
    ]
    assert sum(map(len, errors)) > 90
    together = np.concatenate(errors)
    assert 0.75 < np.sqrt(np.mean(together**2)) < 1.3 and np.linalg.norm(together, axis=1).max() < OFF


def test_a_board_on_a_hundredth_of_an_even_picture_is_found() -> None:
    made = far_board(6, 22.0, blur_px=0.5, noise=1.5, tilt_deg=10.0)
    shares = np.percentile(made.image, (1, 99))
    assert np.ptp(shares) < 15.0  # of the whole picture the grey levels tell nothing
    assert len(off(made)) >= 10


def test_a_small_light_thing_does_not_hide_why_a_picture_is_no_use() -> None:
    dark = np.random.default_rng(2).normal(8.0, 2.0, SIZE[::-1]).clip(0, 255).astype(np.uint8)
    dark[300:330, 500:530] = 250
    board = board_target(TargetKind.CHECKERBOARD, 9, 6, 0.025)
    with pytest.raises(BadImage, match="dark all over"):
        find_board(dark, far_board(0, 24.0, shown=False).board)
    with pytest.raises(BadImage, match="no checkerboard"):
        find_two_boards(dark, board)
    flat = np.random.default_rng(3).normal(128.0, 2.5, SIZE[::-1]).clip(0, 255).astype(np.uint8)
    with pytest.raises(BadImage, match="no contrast"):
        find_board(flat, board)


@pytest.mark.parametrize("px", [24.0, 34.0])
def test_what_is_blurred_doubled_or_not_there_is_refused(px: float) -> None:
    with pytest.raises(BadImage):
        find_board(far_board(1, px, textured=True, shown=False).image, far_board(1, px).board)
    with pytest.raises(BadImage):
        off(part(far_board(1, px, textured=True, blur_px=3.0, tilt_deg=5.0)))
    sharp = far_board(1, px, textured=True, tilt_deg=5.0)
    moved = np.roll(sharp.image, (3, 4), axis=(0, 1))
    with pytest.raises(BadImage):
        off(part(sharp, cv2.addWeighted(sharp.image, 0.5, moved, 0.5, 0.0)))


def test_corners_on_the_edge_of_a_shadow_are_left_out() -> None:
    made = part(far_board(2, 48.0, textured=True, tilt_deg=5.0, shade=0.6))
    kept = find_board(made.image, made.board).index
    column = np.rint(made.board.xyz_m[:, 0] / made.board.pitch_m)
    assert np.linalg.norm(off(made), axis=1).max() < OFF
    on_edge = np.flatnonzero(column == column.max() // 2)  # half of an even number of squares is a line of corners
    assert made.board.columns % 2 == 0 and not np.isin(on_edge, kept).any() and len(kept) >= 6
