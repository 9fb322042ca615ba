"""ChArUco boards far away, drawn without armsight: OpenCV's print, warped at eight samples a pixel, blurred and noisy.

Edges lie between the sheet's pixels, and the warp interpolates: they are placed far finer than the samples.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from armsight.records import Target, TargetKind, board_target

SIZE = (1280, 720)
FOCAL_PX = 1000.0
SHEET_PX, OVER = 64, 8
"""Pixels of the sheet a square; samples of the picture a pixel, along either axis."""
PAPER = 0.4
"""White margin of the sheet, in squares."""
BOARDS = tuple(
    board_target(TargetKind.CHARUCO, columns, rows, 0.04, marker_m=0.04 * share, dictionary=words)
    for columns, rows, share, words in (
        (5, 4, 0.75, "DICT_4X4_50"),
        (7, 5, 0.75, "DICT_5X5_100"),
        (6, 4, 0.6875, "DICT_4X4_50"),
    )
)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FarBoard:
    """A picture (h, w) uint8, its board, and where the board's corners (n, 2) px are in it."""

    image: np.ndarray
    board: Target
    uv_px: np.ndarray


def sheet(board: Target) -> np.ndarray:
    """Return the print with its margin, 0 black to 1 white, SHEET_PX a square."""
    words = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, board.dictionary))
    print_ = cv2.aruco.CharucoBoard((board.columns, board.rows), board.pitch_m, board.marker_m, words)
    drawn = print_.generateImage((board.columns * SHEET_PX, board.rows * SHEET_PX), marginSize=0)
    return np.pad(drawn / np.float32(255.0), round(PAPER * SHEET_PX), constant_values=1.0)


def to_picture(board: Target, square_px: float, rng: np.random.Generator, tilt_deg: float) -> np.ndarray:
    """Return the homography (3, 3) of places on the sheet, in squares from its print's corner, to pixels."""
    lean = rng.uniform(0.0, 2.0 * np.pi)
    tilt = np.deg2rad(tilt_deg) * np.array([np.cos(lean), np.sin(lean), 0.0])
    R = cv2.Rodrigues(tilt)[0] @ cv2.Rodrigues(np.array([0.0, 0.0, rng.uniform(-np.pi, np.pi)]))[0]
    half, reach = 0.5 * np.array([board.columns, board.rows, 0.0]), FOCAL_PX / square_px
    room = 0.5 * np.array(SIZE) - square_px * (0.5 * np.hypot(board.columns, board.rows) + 1.0)
    t = np.append(rng.uniform(-1.0, 1.0, 2) * room.clip(0.0) / square_px, reach) - R @ half
    K = np.array([[FOCAL_PX, 0.0, 0.5 * SIZE[0]], [0.0, FOCAL_PX, 0.5 * SIZE[1]], [0.0, 0.0, 1.0]])
    return K @ np.column_stack([R[:, :2], t])


def ground(rng: np.random.Generator, textured: bool) -> np.ndarray:
    """Return what is behind the board, 0 to 1: even, or soft clouds with boxes and lines of all sizes."""
    if not textured:
        return np.full(SIZE[::-1], rng.uniform(0.25, 0.8), np.float32)
    out = cv2.resize(rng.uniform(0.15, 0.85, (9, 16)).astype(np.float32), SIZE, interpolation=cv2.INTER_CUBIC)
    for _ in range(150):
        at = rng.uniform(0, SIZE).astype(int)
        to = (at + rng.normal(0.0, 60.0, 2)).astype(int)
        draw = cv2.rectangle if rng.random() < 0.5 else cv2.line
        draw(out, at.tolist(), to.tolist(), rng.uniform(0.05, 0.95), int(rng.integers(1, 6)))
    return out


def far_board(
    seed: int,
    square_px: float,
    *,
    textured: bool = False,
    blur_px: float | None = None,
    noise: float | None = None,
    tilt_deg: float | None = None,
    shade: float = 0.0,
    shown: bool = True,
) -> FarBoard:
    """Return a board of so many px a square; shade: how much darker its one half is, sharply; shown: whether it is."""
    rng = np.random.default_rng([seed, int(10 * square_px), textured])
    board = BOARDS[seed % len(BOARDS)]
    blur, spread, tilt = rng.uniform(0.5, 1.1), rng.uniform(1.0, 4.0), rng.uniform(0.0, 45.0)
    blur, spread, tilt = (
        drawn if asked is None else asked for asked, drawn in ((blur_px, blur), (noise, spread), (tilt_deg, tilt))
    )
    H = to_picture(board, square_px, rng, tilt)
    light, black, white = ground(rng, textured), rng.uniform(0.04, 0.2), rng.uniform(0.6, 0.95)
    paper = sheet(board)
    if shade:
        paper[:, : paper.shape[1] // 2] *= 1.0 - shade
    if shown:
        laid_on(light, black + (white - black) * paper, H)
    taken = 255.0 * cv2.GaussianBlur(light, (0, 0), blur) + rng.normal(0.0, spread, light.shape)
    squares = np.column_stack([board.xyz_m[:, :2] / board.pitch_m + 1.0, np.ones(len(board.xyz_m))]) @ H.T
    image = np.clip(np.rint(taken), 0, 255).astype(np.uint8)
    return FarBoard(image=image, board=board, uv_px=squares[:, :2] / squares[:, 2:])


def laid_on(light: np.ndarray, paper: np.ndarray, H: np.ndarray) -> None:
    """Lay the sheet into the picture, each pixel the mean of what it covers."""
    h, w = paper.shape
    from_sheet = np.array([[1.0, 0.0, 0.5], [0.0, 1.0, 0.5], [0.0, 0.0, SHEET_PX]]) / SHEET_PX
    from_sheet[:2, 2] -= PAPER if PAPER * SHEET_PX % 1 == 0 else round(PAPER * SHEET_PX) / SHEET_PX
    corners = np.array([[-0.5, -0.5, 1], [w - 0.5, -0.5, 1], [w - 0.5, h - 0.5, 1], [-0.5, h - 0.5, 1]])
    uv = corners @ (H @ from_sheet).T
    uv = uv[:, :2] / uv[:, 2:]
    low = np.floor(uv.min(axis=0)).astype(int).clip(0)
    high = np.ceil(uv.max(axis=0)).astype(int).clip(0, np.array(SIZE) - 1) + 1
    to_fine = np.array([[OVER, 0.0, OVER * (0.5 - low[0]) - 0.5], [0.0, OVER, OVER * (0.5 - low[1]) - 0.5], [0, 0, 1]])
    size, M = (OVER * (high - low)).tolist(), to_fine @ H @ from_sheet
    there = np.ones_like(paper)
    fine = [cv2.warpPerspective(what, M, size, flags=cv2.INTER_LINEAR) for what in (paper * there, there)]
    ink, covered = (cv2.resize(one, (high - low).tolist(), interpolation=cv2.INTER_AREA) for one in fine)
    part = light[low[1] : high[1], low[0] : high[0]]
    part *= 1.0 - covered
    part += ink
