"""Checkerboards found by ordered segmentation and X templates, on boards cast through a lens by the simulator."""

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.measure.boards import xcorner_corners
from armsight_sim.boards import Board, board_light, corner_rays
from armsight_sim.lens import Lens

LENS = Lens(
    width=480, height=360, focal_px=(405.0, 403.0), centre_px=(238.0, 183.0), distortion=(-0.2, 0.06, 0.001, 0.0, 0.0)
)
RAYS = corner_rays(LENS)
SHADE = np.linspace(0.35, 1.15, LENS.width)[None, :] * np.linspace(1.0, 0.7, LENS.height)[:, None]
"""A lamp at one side: a fourfold fall of the light across the image."""
NOISE = 3.0


def view(board: Board, turn: tuple[float, float, float], depth_m: float, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Return a noisy, unevenly lit image and the true corners, row by row."""
    R = Rotation.from_rotvec(turn)
    T = RigidTransform.from_components(np.array([0.0, 0.0, depth_m]) - R.apply(board.corners_m().mean(0)), R)
    light = board_light(RAYS, board, T)[:, :, 0] * SHADE + np.random.default_rng(seed).normal(0.0, NOISE, SHADE.shape)
    return np.clip(np.rint(light), 0, 255).astype(np.uint8), LENS.project(T.apply(board.corners_m()))


def misses(found: np.ndarray, truth: np.ndarray, columns: int) -> np.ndarray:
    """Return the distances (n,) in the best of the numberings that go row by row."""
    grid = found.reshape(-1, columns, 2)
    turned = [grid, grid[::-1], grid[:, ::-1], grid[::-1, ::-1]]
    if grid.shape[0] == grid.shape[1]:
        turned += [g.transpose(1, 0, 2) for g in turned]
    return min((np.linalg.norm(g.reshape(-1, 2) - truth, axis=1) for g in turned), key=np.max)


@pytest.mark.parametrize(
    ("size", "turn", "depth_m"),
    [
        ((9, 6), (0.0, 0.0, 0.785), 0.5),  # diagonal: the template's legs must turn
        ((9, 6), (-0.8, 0.3, -0.4), 0.45),
        ((3, 3), (0.3, 0.2, 0.1), 0.25),
        ((12, 9), (0.3, 0.3, 0.0), 0.7),  # squares of 14 px: the smaller cross
    ],
)
def test_boards_of_any_size_tilted_and_unevenly_lit(
    size: tuple[int, int], turn: tuple[float, float, float], depth_m: float
) -> None:
    image, truth = view(Board(columns=size[0], rows=size[1]), turn, depth_m, 1)
    found = xcorner_corners(image, *size)
    assert found is not None
    off = misses(found, truth, size[0])
    # pixels that are black or white place a corner to 1/sqrt(12) px; up to four squares are averaged
    assert np.sqrt(np.mean(off**2)) < 0.5
    assert off.max() < 1.5
