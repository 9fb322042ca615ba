"""Circle grids among strangers: in real photographs, and where round blobs lie where the lattice would go on."""

from __future__ import annotations

import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

from armsight.errors import BadImage
from armsight.measure.boards import find_board
from armsight.measure.boards.lattice import round_dots
from armsight.records import Target, TargetKind, board_target
from armsight.records.views import symmetries

sys.path.insert(0, str(Path(__file__).parent))
from circle_composites import PITCH_M, composite, photographs

from refusals import refuses

SEEDS = (2, 17, 25, 28, 31, 39, 57)
"""17 lies over a sheet of other dots; at 25 to 57 the paper ends close to the dots, at 39 so close that they are fitted
in a narrower window, or the room is full of blobs."""

needs_photographs = pytest.mark.skipif(not photographs(), reason="the photographs are not beside the repository")
SHEET = board_target(TargetKind.CIRCLES, 7, 5, PITCH_M)
PITCH_PX = 40.0
ORIGIN_PX = (180.0, 140.0)


def largest_error_px(uv: np.ndarray, index: np.ndarray, truth: np.ndarray, board: Target) -> float:
    return min(float(np.abs(uv - truth[turn[index]]).max()) for turn in symmetries(board))


@needs_photographs
@pytest.mark.parametrize("seed", SEEDS)
def test_a_board_in_a_photograph_is_found_and_its_dots_are_where_they_are(seed: int) -> None:
    made = composite(seed)
    found = find_board(made.image, made.board)
    assert len(found) >= 0.9 * len(made.uv_px)
    assert largest_error_px(found.uv_px, found.index, made.uv_px, made.board) < 0.5


@needs_photographs
@pytest.mark.parametrize(("seed", "more"), [(0, 1), (1, 1), (38, -1)])
def test_a_board_of_another_column_is_not_there(seed: int, more: int) -> None:
    """At 38 the threshold leaves out the column by which the board goes on."""
    made = composite(seed)
    asked = board_target(made.board.kind, made.board.columns + more, made.board.rows, PITCH_M)
    with refuses(BadImage, f"{asked.columns}x{asked.rows}", "grid"):
        find_board(made.image, asked)


def sheet(strangers: list[tuple[float, float]], *, clutter: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Return a 7x5 grid with dots more at these places (in pitches) and blobs all over the rest, and its centres."""
    rng = np.random.default_rng(5)
    image = np.full((480, 640), 225, np.uint8)
    uv = SHEET.xyz_m[:, :2] / PITCH_M * PITCH_PX + ORIGIN_PX
    low, high = uv.min(axis=0) - 25.0, uv.max(axis=0) + 25.0
    for _ in range(clutter):
        at = rng.uniform(0.0, 1.0, 2) * (640.0, 480.0)
        if not ((at > low) & (at < high)).all():
            cv2.circle(image, (int(at[0]), int(at[1])), int(rng.integers(2, 4)), 80, -1)
    for x, y in [*uv, *(np.array(strangers).reshape(-1, 2) * PITCH_PX + ORIGIN_PX)]:
        cv2.circle(image, (round(16 * x), round(16 * y)), 16 * 10, 30, -1, cv2.LINE_AA, 4)
    noisy = cv2.GaussianBlur(image, (0, 0), 0.8) + rng.normal(0.0, 2.0, image.shape)
    return np.clip(noisy, 0, 255).astype(np.uint8), uv


@pytest.mark.parametrize(
    "strangers",
    [
        [(7.05, 1.0)],
        [(7.0, 0.0), (7.1, 1.05), (-1.0, 3.0), (3.0, 5.1)],
        [(7.2, 2.0), (8.3, 2.1), (9.4, 2.3), (7.2, 3.1)],
    ],
)
def test_blobs_that_join_the_lattice_are_no_dots_of_the_board(strangers: list[tuple[float, float]]) -> None:
    image, uv = sheet(strangers)
    found = find_board(image, SHEET)
    assert len(found) == 35
    assert largest_error_px(found.uv_px, found.index, uv, SHEET) < 0.5


def test_a_dark_rim_makes_no_dot_the_one_the_board_begins_at() -> None:
    image, uv = sheet([])
    cv2.circle(image, np.rint(uv[-1]).astype(int).tolist(), 12, 75, 5)
    found = find_board(image, SHEET)
    assert np.abs(found.uv_px - uv[found.index]).max() < 0.5


def test_a_grid_that_goes_on_is_another_board() -> None:
    image, _ = sheet([(7.0, float(row)) for row in range(5)])
    with refuses(BadImage, "7x5", size=(8, 5)):
        find_board(image, SHEET)
    image, _ = sheet([(7.0, float(row)) for row in range(5)] + [(8.1, 0.0)])
    with refuses(BadImage, "7x5", "beyond"):
        find_board(image, SHEET)


def test_no_count_of_blobs_hides_the_board() -> None:
    image, uv = sheet([], clutter=6000)
    found = find_board(image, SHEET)
    assert len(found) == 35
    assert largest_error_px(found.uv_px, found.index, uv, SHEET) < 0.5


def test_dots_of_one_threshold_are_opencvs_moments() -> None:
    image, _ = sheet([])
    binary = cv2.threshold(image, 0, 255, cv2.THRESH_BINARY_INV | cv2.THRESH_OTSU)[1]
    contours, _ = cv2.findContours(binary, cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)
    moments = [cv2.moments(c) for c in contours]
    centres = np.array([[m["m10"] / m["m00"], m["m01"] / m["m00"]] for m in moments])
    found = round_dots(image, 0, dark=True)
    assert len(found.uv) == 35
    assert np.abs(found.uv - centres).max() < 1e-6
