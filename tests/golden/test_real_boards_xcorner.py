"""The template detector and complex images on real pictures; see the data's README for where they come from."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from armsight.measure.boards import find_board, find_two_boards, xcorner_corners
from armsight.records import TargetKind, board_target

STEREO = Path(__file__).resolve().parents[3] / "shared" / "data" / "opencv_stereo"
BOARD = board_target(TargetKind.CHECKERBOARD, 9, 6, 0.025)

pytestmark = pytest.mark.skipif(not STEREO.exists(), reason=f"{STEREO.name} is not beside the repository")


def picture(side: str, n: int) -> np.ndarray:
    return cv2.imread(str(STEREO / f"{side}{n:02d}.jpg"), cv2.IMREAD_GRAYSCALE)


def test_boards_are_found_to_a_pixel_and_fitted_like_the_default() -> None:
    for side, n in (("left", 1), ("left", 7), ("right", 3), ("right", 12)):
        image = picture(side, n)
        placed = xcorner_corners(image, 9, 6)
        assert placed is not None, n
        auto = find_board(image, BOARD)
        off = np.linalg.norm(placed[:, None] - auto.uv_px[None], axis=2).min(axis=1)
        assert np.sqrt(np.mean(off**2)) < 0.8, n
        ours = find_board(image, BOARD, detector="xcorner")
        assert len(ours) == 54
        assert np.abs(ours.uv_px - auto.uv_px).max() < 0.03


def test_two_photographs_added_give_the_corners_of_each() -> None:
    pair = picture("left", 4), picture("right", 4)
    found = find_two_boards(np.rint(pair[0] / 2.0 + pair[1] / 2.0).astype(np.uint8), BOARD)
    for view, image in zip(found, pair, strict=True):
        alone = find_board(image, BOARD)
        off = view.uv_px - alone.uv_px[view.index]
        assert len(view) >= 27
        assert np.sqrt(np.mean(off**2)) < 1.3 * view.sigma_px < 0.25
