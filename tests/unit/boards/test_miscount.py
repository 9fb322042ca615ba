"""Counts that are not the board's, on a board that ends in half squares all round, as some printed ones do."""

import cv2
import numpy as np
import pytest

from armsight.errors import BadImage
from armsight.measure.boards import find_board
from armsight.measure.boards.checkerboard import refine_corners
from armsight.records import Target, TargetKind, board_target
from refusals import refuses

SQUARE = 32
H = np.array([[1.0, 0.12, 30.0], [-0.08, 0.95, 60.0], [2e-4, -1e-4, 1.0]])
"""From the flat print to the image."""


def board(columns: int, rows: int) -> Target:
    return board_target(TargetKind.CHECKERBOARD, columns, rows, 0.025)


def printed() -> np.ndarray:
    """9x6 inner corners, the first at (48, 48); outer squares are half as wide."""
    y, x = np.mgrid[0 : 6 * SQUARE, 0 : 9 * SQUARE]
    cells = (x + SQUARE // 2) // SQUARE + (y + SQUARE // 2) // SQUARE
    squares = np.where(cells % 2 == 0, 25.0, 210.0)
    flat = np.pad(squares, SQUARE, constant_values=210.0)
    image = cv2.warpPerspective(flat, H, (440, 340), flags=cv2.INTER_AREA, borderValue=90.0)
    noise = np.random.default_rng(2).normal(0.0, 2.0, image.shape)
    return stilled(np.clip(np.rint(cv2.GaussianBlur(image, (0, 0), 0.8) + noise), 0, 255).astype(np.uint8))


def stilled(image: np.ndarray) -> np.ndarray:
    """Return it read-only, as frames are: another type is compiled anew."""
    image.setflags(write=False)
    return image


def at(columns: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """Return the pixels (n, 2) of inner corners."""
    flat = np.stack([columns.ravel(), rows.ravel()], axis=1) * SQUARE + 1.5 * SQUARE - 0.5
    return np.ascontiguousarray(cv2.perspectiveTransform(flat[:, None].astype(float), H)[:, 0])


def test_the_right_counts_are_found() -> None:
    i, j = np.meshgrid(np.arange(9), np.arange(6))
    found = find_board(printed(), board(9, 6))
    assert len(found) == 54
    away = np.linalg.norm(found.uv_px[:, None] - at(i, j)[None], axis=2).min(axis=1)
    assert away.max() < 0.2


@pytest.mark.parametrize(("columns", "rows"), [(8, 6), (9, 5), (7, 6)])
def test_corners_of_a_part_are_refused(columns: int, rows: int) -> None:
    i, j = np.meshgrid(np.arange(columns), np.arange(rows))
    with refuses(BadImage, "beyond", f"{columns}x{rows}", size=(9, 6)):
        refine_corners(printed(), board(columns, rows), at(i, j), "a.png")


def test_a_grid_across_the_squares_is_refused() -> None:
    i, j = np.meshgrid(np.arange(5), np.arange(3))
    with refuses(BadImage, "5x3", "squares"):
        refine_corners(printed(), board(5, 3), at(i + j, 2 * j), "a.png")


def test_a_row_of_which_nothing_is_seen_is_refused() -> None:
    covered = printed().copy()
    i, j = np.meshgrid(np.arange(9), np.arange(6))
    for u, v in at(i, j)[:9]:
        cv2.circle(covered, (round(u), round(v)), 13, 215, -1)
    with refuses(BadImage, "first row", "9x6"):
        refine_corners(stilled(covered), board(9, 6), at(i, j), "a.png")


def test_columns_and_rows_of_an_asymmetric_grid_that_were_exchanged_are_told() -> None:
    image = np.full((600, 480), 230, np.uint8)
    for i in range(11):
        for j in range(4):
            cv2.circle(image, (80 + (2 * j + i % 2) * 40, 80 + i * 40), 12, 20, -1, cv2.LINE_AA)
    image = cv2.GaussianBlur(image, (0, 0), 1.0)
    for turned in (image, np.rot90(image).copy()):
        assert len(find_board(turned, board_target(TargetKind.ACIRCLES, 4, 11, 0.02))) == 44
        with pytest.raises(BadImage) as refusal:
            find_board(turned, board_target(TargetKind.ACIRCLES, 11, 4, 0.02))
        assert refusal.value.size == (4, 11)
