"""One board twice in one image: two views cast through the same lens from two places, and added."""

from functools import cache

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.errors import BadImage, Unseen
from armsight.measure.boards import find_two_boards
from armsight.records import BoardView, TargetKind, board_target
from armsight_sim.boards import Board, board_light, corner_rays
from armsight_sim.lens import Lens
from refusals import refuses

LENS = Lens(
    width=640, height=480, focal_px=(830.0, 830.0), centre_px=(319.5, 239.5), distortion=(-0.1, 0.05, 0.0, 0.0, 0.0)
)
RAYS = corner_rays(LENS)
BASELINE_M = 0.12
PRINT = Board(square_m=0.02, black=12.0, white=90.0, room=30.0, blur_px=0.9)
BOARD = board_target(TargetKind.CHECKERBOARD, 9, 6, 0.02)
NOISE = 1.5


@cache
def one_view(
    side: int, turn: tuple[float, float, float], middle_m: tuple[float, float, float]
) -> tuple[np.ndarray, np.ndarray]:
    """Return the light and the true corners of the left (-1) or right (+1) virtual camera."""
    R = Rotation.from_rotvec(turn)
    T = RigidTransform.from_components(np.array(middle_m) - R.apply(PRINT.corners_m().mean(0)), R)
    T = RigidTransform.from_translation([side * BASELINE_M / 2, 0.0, -BASELINE_M / 2]).inv() * T
    return board_light(RAYS, PRINT, T)[:, :, 0], LENS.project(T.apply(PRINT.corners_m()))


def picture(*lights: np.ndarray, seed: int = 1) -> np.ndarray:
    total = sum(lights) + 6.0 + np.random.default_rng(seed).normal(0.0, NOISE, lights[0].shape)
    return np.clip(np.rint(total), 0, 255).astype(np.uint8)


def both(turn: tuple[float, float, float], middle_m: tuple[float, float, float]) -> list[tuple[np.ndarray, np.ndarray]]:
    return [one_view(side, turn, middle_m) for side in (-1, 1)]


VIEWS = [
    ((0.3, -0.2, 0.1), (0.0, 0.0, 0.6)),
    ((-0.4, 0.3, 0.2), (0.02, 0.01, 0.6)),
    ((0.2, 0.1, 0.02), (0.0, 0.02, 0.58)),  # rows lie on each other
]


@pytest.mark.parametrize(("turn", "middle_m"), VIEWS)
def test_both_views_are_found_as_exactly_as_they_say(
    turn: tuple[float, float, float], middle_m: tuple[float, float, float]
) -> None:
    seen = both(turn, middle_m)
    found = find_two_boards(picture(*(light for light, _ in seen)), BOARD, source="c.png")
    for view, (_, truth) in zip(found, seen, strict=True):
        assert isinstance(view, BoardView)
        assert len(view) >= 30
        assert view.sigma_px < 0.03
        error = (view.uv_px - truth[view.index]) / view.sigma_px
        assert np.sqrt(np.mean(error**2)) == pytest.approx(1.0, abs=0.3)
        assert np.abs(error).max() < 6.0
    shared = np.intersect1d(found[0].index, found[1].index)
    u = [dict(zip(view.index.tolist(), view.uv_px[:, 0], strict=True)) for view in found]
    assert all(u[0][i] > u[1][i] for i in shared)  # left's is the larger (MATH 3.1)


def test_corners_on_the_other_boards_corners_are_left_out() -> None:
    seen = both(*VIEWS[0])
    found = find_two_boards(picture(*(light for light, _ in seen)), BOARD)
    for view, (_, own), (_, other) in zip(found, seen, seen[::-1], strict=True):
        gap = np.linalg.norm(own[:, None] - other[None], axis=2).min(axis=1)
        assert not set(view.index.tolist()) & set(np.flatnonzero(gap < 3.0).tolist())
        assert len(view) < 54  # the other board's edge runs through some


def test_one_three_none_and_half_are_refused_with_the_reason() -> None:
    (left, _), (right, _) = both(*VIEWS[0])
    third, _ = one_view(1, (0.3, -0.2, 0.1), (0.03, 0.013, 0.61))
    half = both((0.3, -0.2, 0.1), (-0.18, 0.0, 0.6))
    grey = np.full_like(left, 60.0) + np.random.default_rng(2).normal(0.0, 20.0, left.shape)
    with refuses(BadImage, "9x6", unseen=Unseen.ONLY_ONCE):
        find_two_boards(picture(left, np.full_like(left, 30.0)), BOARD)
    with refuses(BadImage, "9x6", unseen=Unseen.ONLY_ONCE):
        find_two_boards(picture(left, left), BOARD)
    with refuses(BadImage, unseen=Unseen.THRICE):
        find_two_boards(picture(left, right, third), BOARD)
    with refuses(BadImage, "checkerboard", "9x6"):
        find_two_boards(picture(grey), BOARD)
    with refuses(BadImage, "5x6", "9x6", unseen=Unseen.IN_PART):
        find_two_boards(picture(*(light for light, _ in half)), BOARD)


@pytest.mark.parametrize(("size", "unseen"), [((8, 6), Unseen.BEYOND_SIZE), ((9, 7), Unseen.OTHER)])
def test_another_size_is_refused(size: tuple[int, int], unseen: Unseen) -> None:
    image = picture(*(light for light, _ in both(*VIEWS[0])))
    with refuses(BadImage, "{}x{}".format(*size), unseen=unseen):
        find_two_boards(image, board_target(TargetKind.CHECKERBOARD, *size, 0.02))
