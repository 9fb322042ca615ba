"""Pairs whose points share an error that no rigid rig has: weighed, claimed, named; and no lens is accused of it."""

import cv2
import numpy as np
import pytest

from armsight.calibrate.cameras import BoardOptions, StereoCalibration, calibrate_stereo
from armsight.records import BoardView, TargetKind, board_target
from refusals import names_it

BOARD = board_target(TargetKind.CHECKERBOARD, 9, 6, 0.025)
SIZE = np.array([1280, 720])
K = np.array([[1100.0, 0.0, 640.0], [0.0, 1100.0, 360.0], [0.0, 0.0, 1.0]])
T_M = np.array([0.1, 0.0, 0.0])
SIGMA_PX = 0.05


def seen(w: np.ndarray, t: np.ndarray) -> np.ndarray:
    return cv2.projectPoints(BOARD.xyz_m, w, t, K, np.zeros(5))[0].reshape(-1, 2)


def calibrated(seed: int, shift_px: tuple[float, float] = (0.0, 0.0), turn_rad: float = 0.0) -> StereoCalibration:
    """Views of a parallel pair by OpenCV; each of the right camera shifted, or turned, by a draw of its own."""
    rng, views = np.random.default_rng(seed), ([], [])
    while len(views[0]) < 14:
        w = rng.uniform(-0.5, 0.5, 3)
        t = rng.uniform([-0.15, -0.1, 0.4], [0.25, 0.1, 0.7]) - cv2.Rodrigues(w)[0] @ BOARD.xyz_m.mean(axis=0)
        S = cv2.Rodrigues(rng.normal(0, 1, 3) * turn_rad)[0]
        sides = [seen(w, t), seen(cv2.Rodrigues(S.T @ cv2.Rodrigues(w)[0])[0], S.T @ (t - T_M))]
        if not all((uv > 5).all() and (uv < SIZE - 5).all() for uv in sides):
            continue
        sides[1] = sides[1] + rng.normal(0, 1, 2) * shift_px
        for side, uv in zip(views, sides, strict=True):
            noisy = uv + rng.normal(0, SIGMA_PX, uv.shape)
            side.append(
                BoardView(
                    uv_px=noisy,
                    index=np.arange(54),
                    sigma_px=SIGMA_PX,
                    width=1280,
                    height=720,
                    source=f"{len(side)}.png",
                )
            )
    return calibrate_stereo(*views, BOARD, BoardOptions(folds=0))


def z(found: StereoCalibration) -> np.ndarray:
    T = found.rig.T_rig_right
    off = np.r_[T.translation - T_M, T.rotation.as_rotvec()]
    return off / [found.std[f"right.{name}"] for name in ("tx_m", "ty_m", "tz_m", "rx_rad", "ry_rad", "rz_rad")]


def told(found: StereoCalibration) -> list[str]:
    return [line for line in found.advice if "one rigid rig" in line]


def test_a_camera_that_turns_from_pair_to_pair_is_named():
    found = [calibrated(seed, turn_rad=0.3e-3) for seed in range(3)]
    assert np.sqrt(np.mean([z(one) ** 2 for one in found])) < 1.5
    assert all(names_it(told(one)[0], "turns", "degrees") for one in found)


def test_pairs_of_one_rigid_rig_lose_nothing():
    found = [calibrated(seed) for seed in range(4)]
    assert sum(len(told(one)) for one in found) == 0
    tz = [one.std["right.tz_m"] for one in found]
    assert np.mean(tz) == pytest.approx(6.5e-5, rel=0.1)
