"""Boards painted by tracing every sub-pixel back to the print, and found again."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache

import cv2
import numpy as np
import pytest

from armsight.errors import BadImage, Inconsistent, Unseen
from armsight.measure.boards import find_board, same_way_up
from armsight.measure.boards.kernels.edge_models import CHUNK, REST, ROWS, V, X, Y, corner_rows, dot_rows
from armsight.measure.boards.saddle_grid import grid_at_a_glance
from armsight.records import Target, TargetKind, board_target
from armsight.records.views import symmetries
from refusals import refuses

SIZE = (480, 360)
K = np.array([[405.0, 0.0, 238.0], [0.0, 403.0, 183.0], [0.0, 0.0, 1.0]])
NO_LENS = (0.0,) * 5
LENS = (-0.28, 0.1, 0.001, -0.0005, 0.0)
PITCH_M = 0.025
OVER = 3
"""Sub-pixels along each axis; at an edge each has its covered share."""
BLUR_PX = 0.8
NOISE = 5.0

CHECKERBOARD = board_target(TargetKind.CHECKERBOARD, 9, 6, PITCH_M)
CIRCLES = board_target(TargetKind.CIRCLES, 7, 5, PITCH_M)
ACIRCLES = board_target(TargetKind.ACIRCLES, 4, 11, PITCH_M)
CHARUCO = board_target(TargetKind.CHARUCO, 7, 5, 0.03, marker_m=0.022, dictionary="DICT_4X4_50")

Print = Callable[[np.ndarray, float], np.ndarray]
"""Board coordinates (..., 2) in m and the size of a sub-pixel on the board -> reflectance 0..1."""


@cache
def checkerboard(columns: int, rows: int) -> Print:
    def ink(xy: np.ndarray, grain_m: float) -> np.ndarray:
        s = xy / PITCH_M
        line = np.rint(s)
        side = np.clip(2.0 * (s - line) * PITCH_M / grain_m, -1.0, 1.0)  # covered share of the sub-pixel
        wave = np.where(line.astype(int) % 2 == 0, side, -side).prod(-1)
        inside = (s >= -1.0).all(-1) & (s[..., 0] < columns) & (s[..., 1] < rows)
        paper = (s > -1.5).all(-1) & (s[..., 0] < columns + 0.5) & (s[..., 1] < rows + 0.5)
        # the square beyond the first corner, towards +x +y, is black
        return np.where(inside, 0.45 - 0.4 * wave, np.where(paper, 0.85, 0.35))

    return ink


@cache
def dots(board: Target, *, big: int | None = None, light: bool = False) -> Print:
    def ink(xy: np.ndarray, grain_m: float) -> np.ndarray:
        s = xy / PITCH_M
        row = np.clip(np.rint(s[..., 1]), 0, board.rows - 1)
        if board.kind is TargetKind.ACIRCLES:
            col = 2 * np.clip(np.rint((s[..., 0] - row % 2) / 2), 0, board.columns - 1) + row % 2
        else:
            col = np.clip(np.rint(s[..., 0]), 0, board.columns - 1)
        inner = 0.25 - np.hypot(s[..., 0] - col, s[..., 1] - row)
        if big is not None:
            inner = np.maximum(inner, 0.5 - np.linalg.norm(s - board.xyz_m[big, :2] / PITCH_M, axis=-1))
        covered = np.clip(0.5 + inner * PITCH_M / grain_m, 0.0, 1.0)
        return 0.85 - 0.8 * covered if not light else 0.1 + 0.75 * covered

    return ink


@cache
def charuco(board: Target) -> Print:
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, board.dictionary))
    cv_board = cv2.aruco.CharucoBoard((board.columns, board.rows), board.pitch_m, board.marker_m, dictionary)
    pixel_m = 0.0005
    size = round(board.columns * board.pitch_m / pixel_m), round(board.rows * board.pitch_m / pixel_m)
    picture = cv_board.generateImage(size, marginSize=0).astype(float) / 255.0

    def ink(xy: np.ndarray, _: float) -> np.ndarray:
        place = (xy + board.pitch_m) / pixel_m  # xyz_m begins at the first inner corner
        col, row = (np.floor(place[..., i]).astype(int) for i in range(2))
        inside = (col >= 0) & (row >= 0) & (col < size[0]) & (row < size[1])
        value = picture[np.clip(row, 0, size[1] - 1), np.clip(col, 0, size[0] - 1)]
        return np.where(inside, 0.05 + 0.8 * value, 0.85)

    return ink


@dataclass(frozen=True)
class View:
    """How the camera stands: board's middle at t_m, turned by w (rotation vector)."""

    w: tuple[float, float, float] = (0.25, -0.3, 0.1)
    t_m: tuple[float, float, float] = (0.0, 0.0, 0.42)
    lens: tuple[float, ...] = NO_LENS

    def pose(self, board: Target) -> tuple[np.ndarray, np.ndarray]:
        R = cv2.Rodrigues(np.array(self.w))[0]
        return R, np.array(self.t_m) - R @ board.xyz_m.mean(0)


def paint(
    ink: Print, board: Target, view: View, rng: np.random.Generator, blur_px: float = BLUR_PX
) -> tuple[np.ndarray, np.ndarray]:
    """Return the image and the true pixels of the board's points."""
    sharp, truth = trace(ink, board, view)
    image = cv2.GaussianBlur(sharp, (0, 0), blur_px) + rng.normal(0.0, NOISE, sharp.shape)
    return np.clip(np.rint(image), 0, 255).astype(np.uint8), truth


@cache
def trace(ink: Print, board: Target, view: View) -> tuple[np.ndarray, np.ndarray]:
    """Return the grey levels without blur and noise, and the true pixels."""
    lens = np.array(view.lens)
    R, t = view.pose(board)
    cells = np.stack(np.meshgrid(np.arange(OVER * SIZE[0]), np.arange(OVER * SIZE[1])), -1)
    grid = ((cells + 0.5) / OVER - 0.5).reshape(-1, 1, 2)
    if lens.any():
        rays = cv2.undistortPointsIter(grid, K, lens, None, None, (3, 40, 1e-10)).reshape(-1, 2)
    else:
        rays = (grid.reshape(-1, 2) - K[:2, 2]) / K[[0, 1], [0, 1]]
    d = np.column_stack([rays, np.ones(len(rays))]) @ R  # rays in board axes
    o = -R.T @ t
    xy = o[:2] - d[:, :2] * (o[2] / d[:, 2])[:, None]
    grain_m = view.t_m[2] / K[0, 0] / OVER
    fine = ink(xy, grain_m).reshape(SIZE[1], OVER, SIZE[0], OVER).mean((1, 3)) * 220.0
    truth = cv2.projectPoints(board.xyz_m, cv2.Rodrigues(R)[0], t, K, lens)[0].reshape(-1, 2)
    return fine, truth


def outline_centres(board: Target, view: View, radius_m: float) -> np.ndarray:
    """Centres of the outlines' images, by area of a finely traced outline (no lens)."""
    R, t = view.pose(board)
    a = np.linspace(0.0, 2.0 * np.pi, 400, endpoint=False)
    ring = np.stack([np.cos(a), np.sin(a), 0.0 * a], 1) * radius_m
    out = []
    for centre in board.xyz_m:
        uv = cv2.projectPoints(centre + ring, cv2.Rodrigues(R)[0], t, K, None)[0].reshape(-1, 2)
        m = cv2.moments(uv.astype(np.float32))
        out.append([m["m10"] / m["m00"], m["m01"] / m["m00"]])
    return np.array(out)


VIEWS = [
    View(),
    View(w=(0.0, 0.0, 0.0)),
    View(w=(-0.6, 0.2, -0.3), t_m=(0.02, -0.01, 0.45)),
    View(w=(0.2, 0.75, 0.4), t_m=(-0.03, 0.02, 0.5)),
    View(w=(0.1, 0.2, 2.9), t_m=(0.0, 0.0, 0.45)),
]


@pytest.mark.parametrize("view", VIEWS)
def test_checkerboard_corners_are_numbered_from_the_black_square_and_exact(view: View) -> None:
    image, truth = paint(checkerboard(9, 6), CHECKERBOARD, view, np.random.default_rng(1))
    found = find_board(image, CHECKERBOARD, source="x.png")
    assert len(found) == 54
    error = found.uv_px - truth[found.index]
    assert np.abs(error).max() < 5.0 * found.sigma_px
    # 108 coordinates: the ratio scatters by 0.07
    assert np.sqrt((error**2).mean()) / found.sigma_px == pytest.approx(1.0, abs=0.25)


def test_curved_edges_do_not_pull_corners() -> None:
    view = View(w=(0.1, -0.15, 0.05), t_m=(-0.06, -0.04, 0.33), lens=LENS)
    image, truth = paint(checkerboard(9, 6), CHECKERBOARD, view, np.random.default_rng(2))
    found = find_board(image, CHECKERBOARD)
    error = found.uv_px - truth[found.index]
    assert np.sqrt((error**2).mean()) / found.sigma_px == pytest.approx(1.0, abs=0.25)


def test_covered_corner_is_left_out_not_guessed() -> None:
    image, truth = paint(checkerboard(9, 6), CHECKERBOARD, VIEWS[0], np.random.default_rng(5))
    coarse = find_board(image, CHECKERBOARD)
    image = image.copy()
    u, v = np.rint(truth[30]).astype(int)
    # a glare that leaves just enough for the coarse search
    cv2.circle(image, (int(u) + 3, int(v) - 2), 6, 215, -1)
    found = find_board(image, CHECKERBOARD)
    assert len(coarse) == 54
    assert np.abs(found.uv_px - truth[found.index]).max() < 0.2


@pytest.mark.parametrize("size", [(9, 5)])
def test_wrong_size_is_refused_with_the_one_that_is_there(size: tuple[int, int]) -> None:
    image, _ = paint(checkerboard(9, 6), CHECKERBOARD, VIEWS[0], np.random.default_rng(6))
    with refuses(BadImage, "{}x{}".format(*size), size=(9, 6)):
        find_board(image, board_target(TargetKind.CHECKERBOARD, *size, PITCH_M), source="a.png")


@pytest.mark.parametrize(
    ("image", "why"),
    [
        (np.zeros((480, 640), np.uint8), "dark"),
        (np.full((480, 640), 128, np.uint8), "contrast"),
        (np.zeros((480, 640), np.uint16), "uint16"),
        (np.zeros((8, 8), np.uint8), "(8, 8)"),
    ],
)
def test_image_without_a_picture_is_refused_with_the_reason(image: np.ndarray, why: str) -> None:
    with refuses(BadImage, why):
        find_board(image, CHECKERBOARD, source="a.png")


@pytest.mark.parametrize("blur_px", [7.0])
def test_blurred_board_is_refused_as_blurred(blur_px: float) -> None:
    image, _ = paint(checkerboard(9, 6), CHECKERBOARD, VIEWS[0], np.random.default_rng(7), blur_px=blur_px)
    with refuses(BadImage, unseen=Unseen.BLURRED):
        find_board(image, CHECKERBOARD)


def test_the_rim_of_a_blurred_board_is_no_further_corner() -> None:
    for blur_px in (1.5, 2.5):
        image, truth = paint(checkerboard(9, 6), CHECKERBOARD, VIEWS[3], np.random.default_rng(3), blur_px=blur_px)
        found = find_board(image, CHECKERBOARD)
        assert len(found) == 54
        error = found.uv_px - truth[found.index]
        assert np.sqrt((error**2).mean()) / found.sigma_px == pytest.approx(1.0, abs=0.25)


@pytest.mark.parametrize("view", VIEWS[1::2])
def test_a_glance_sees_a_board_larger_and_smaller_and_no_other(view: View) -> None:
    image, truth = paint(checkerboard(9, 6), CHECKERBOARD, view, np.random.default_rng(9))
    for factor in (0.75, 1.0, 3.0):
        scaled = cv2.resize(image, None, fx=factor, fy=factor, interpolation=cv2.INTER_AREA)
        seen = grid_at_a_glance(scaled, 9, 6)
        assert seen is not None
        off = np.linalg.norm(seen[:, None] - ((truth + 0.5) * factor - 0.5)[None], axis=2).min(axis=0)
        assert off.max() < 1.5 * max(1.0, factor)
        for columns, rows in ((8, 6), (9, 5), (10, 6), (9, 7), (4, 3)):
            assert grid_at_a_glance(scaled, columns, rows) is None
    with refuses(BadImage, "10x6", "glance"):
        find_board(image, board_target(TargetKind.CHECKERBOARD, 10, 6, PITCH_M), detector="quick")


def test_noise_is_no_board() -> None:
    image = np.random.default_rng(8).integers(0, 255, (480, 640)).astype(np.uint8)
    for board in (CHECKERBOARD, CIRCLES, CHARUCO):
        with pytest.raises(BadImage, match="found"):
            find_board(image, board)


@pytest.mark.parametrize("view", VIEWS[1:4])
def test_circles_are_measured_at_the_centre_of_their_outline(view: View) -> None:
    board = CIRCLES
    image, _ = paint(dots(board), board, view, np.random.default_rng(10))
    found = find_board(image, board)
    error = found.uv_px - outline_centres(board, view, 0.25 * PITCH_M)
    assert len(found) == 35
    assert np.abs(error).max() < 5.0 * found.sigma_px
    assert np.sqrt((error**2).mean()) / found.sigma_px == pytest.approx(1.0, abs=0.3)


@pytest.mark.parametrize("turn", [1.6])
def test_the_big_dot_is_the_origin_whichever_way_the_sheet_lies(turn: float) -> None:
    board = board_target(TargetKind.CIRCLES, 6, 6, PITCH_M)
    view = View(w=(0.1, 0.15, turn), t_m=(0.0, 0.0, 0.4))
    image, truth = paint(dots(board, big=0), board, view, np.random.default_rng(12))
    found = find_board(image, board)
    assert np.abs(found.uv_px - truth[found.index]).max() < 0.5


def test_big_dot_at_the_wrong_corner_means_mirrored_or_turned() -> None:
    image, _ = paint(dots(CIRCLES, big=0), CIRCLES, VIEWS[0], np.random.default_rng(13))
    with refuses(BadImage, "5x7", "mirrored"):
        find_board(np.ascontiguousarray(image[:, ::-1]), CIRCLES)


def test_asymmetric_circles_are_numbered_as_opencv_does() -> None:
    view = View(w=(0.3, 0.4, 1.2), t_m=(0.0, 0.0, 0.8))
    image, truth = paint(dots(ACIRCLES), ACIRCLES, view, np.random.default_rng(15))
    found = find_board(image, ACIRCLES)
    assert len(found) == 44
    assert np.abs(found.uv_px - truth[found.index]).max() < 0.3


def test_charuco_whole_in_part_and_mirrored() -> None:
    view = View(w=(0.15, -0.2, 0.1), t_m=(0.0, 0.0, 0.3))
    image, truth = paint(charuco(CHARUCO), CHARUCO, view, np.random.default_rng(17))
    found = find_board(image, CHARUCO)
    assert len(found) == 24
    assert np.abs(found.uv_px - truth[found.index]).max() < 0.1
    part = image.copy()
    part[:, 285:] = 200
    found = find_board(part, CHARUCO)
    assert 6 <= len(found) < 24
    assert np.abs(found.uv_px - truth[found.index]).max() < 0.1
    with pytest.raises(BadImage, match="mirrored"):
        find_board(np.ascontiguousarray(image[:, ::-1]), CHARUCO)
    with pytest.raises(Inconsistent, match="DICT_4X4_50"):
        find_board(image, replace(CHARUCO, dictionary="4x4"))


def test_pair_agrees_on_a_symmetric_board() -> None:
    board = board_target(TargetKind.CHECKERBOARD, 8, 6, PITCH_M)
    assert len(symmetries(board)) == 2
    seen = []
    for turn in (1.5, 1.65):  # x axis about straight down: one camera says left, the other right
        view = View(w=(0.05, 0.1, turn), t_m=(0.0, 0.0, 0.4))
        image, truth = paint(checkerboard(8, 6), board, view, np.random.default_rng(18))
        seen.append((find_board(image, board), truth))
    (left, truth_left), (right, truth_right) = seen
    fixed = same_way_up(left, right, board)
    upright = [
        np.abs(v.uv_px - t[v.index]).max() < 1.0
        for v, t in ((left, truth_left), (right, truth_right), (fixed, truth_right))
    ]
    assert upright[0] != upright[1]  # the planted disagreement
    assert upright[2] == upright[0]


@pytest.mark.parametrize(
    ("board", "count"),
    [
        (CHECKERBOARD, 1),
        (board_target(TargetKind.CHECKERBOARD, 8, 6, 1.0), 2),
        (board_target(TargetKind.CHECKERBOARD, 6, 6, 1.0), 4),
        (CIRCLES, 2),
        (ACIRCLES, 1),
        (CHARUCO, 1),
    ],
)
def test_symmetries_of_the_print(board: Target, count: int) -> None:
    turns = symmetries(board)
    assert len(turns) == count
    assert (turns[0] == np.arange(len(board.names))).all()
    for turn in turns:  # a turn keeps all distances, so it is one
        X, Y = board.xyz_m, board.xyz_m[turn]
        assert np.allclose(np.linalg.norm(X[:, None] - X, axis=2), np.linalg.norm(Y[:, None] - Y, axis=2))


@pytest.mark.parametrize(
    ("rows", "p"),
    [
        (corner_rows, [0.3, -0.2, 0.4, 2.1, 0.9, 1.2, 100.0, 0.5, -0.3, 60.0]),
        (dot_rows, [0.3, -0.2, 0.05, 0.01, 0.08, 0.9, 100.0, 0.5, -0.3, -60.0]),
    ],
)
def test_derivatives_of_the_grey_levels(rows: Callable, p: list[float]) -> None:
    rng = np.random.default_rng(19)
    n = 30
    table = np.ones((ROWS, CHUNK), np.float32)
    table[[X, Y]] = rng.uniform(-6.0, 6.0, (2, CHUNK))
    table[V] = 0.0

    def filled(q: np.ndarray) -> np.ndarray:
        rows(n, q, table.reshape(-1))
        return table[:, :n].astype(float)

    derivatives = filled(np.array(p))[:10]
    for i in range(10):
        h = 4e-3 * max(0.1, abs(p[i]))
        up, down = (filled(np.array(p) + sense * h * np.eye(10)[i])[REST] for sense in (1.0, -1.0))
        # levels are of single precision: to 2e-4 of a grey level
        assert (up - down) / (2 * h) == pytest.approx(derivatives[i], rel=3e-3, abs=2e-4 / h)
