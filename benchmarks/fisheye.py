"""Fisheye calibrations against the truth and against cv2.fisheye.calibrate, on corners from the simulated lens.

Prints for each intrinsic the RMS error of both, the RMS of error over claimed standard deviation (1 is honest) and the
share within 1.96 of them (0.95 is honest). Run: python benchmarks/fisheye.py [REPEATS]
"""

from __future__ import annotations

import sys

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from armsight.calibrate.cameras import BoardOptions, calibrate_camera
from armsight.optics import LensKind
from armsight.records import BoardView
from armsight.store import parse_board
from armsight_sim.lens import Lens

BOARD = parse_board("checkerboard:9x6:0.025")
D = (-0.012, 0.02, -0.015, 0.004)
LENS = Lens(
    width=1280, height=1024, focal_px=(420.0, 415.0), centre_px=(640.3, 511.2), distortion=(*D, 0.0), fisheye=True
)
NAMES = ("fx", "fy", "cx", "cy", "k1", "k2", "k3", "k4")
TRUTH = np.array([420.0, 415.0, 640.3, 511.2, *D])
PLACES = [0, 1, 2, 3, 5, 6, 7, 8]
SIGMA_PX, VIEWS = 0.1, 15
SIZE = np.array([1280.0, 1024.0])


def views(rng: np.random.Generator) -> list[BoardView]:
    """Return views of the board all over the image, with normal noise."""
    out: list[BoardView] = []
    X = BOARD.xyz_m - BOARD.xyz_m.mean(axis=0)
    while len(out) < VIEWS:
        x, y = LENS.rays(rng.uniform([150.0, 120.0], [1130.0, 904.0])[None])[0]
        ray = np.array([x, y, 1.0]) / np.sqrt(x * x + y * y + 1.0)
        facing = Rotation.align_vectors(ray[None], np.array([[0.0, 0.0, 1.0]]))[0]
        tilt = Rotation.from_euler("zxy", rng.uniform([-30.0, -40.0, -40.0], [30.0, 40.0, 40.0]), degrees=True)
        uv = LENS.project((facing * tilt).apply(X) + rng.uniform(0.2, 0.5) * ray)
        if np.isfinite(uv).all() and (uv > 5.0).all() and (uv < SIZE - 6.0).all():
            noisy = uv + rng.normal(0.0, SIGMA_PX, uv.shape)
            index = np.arange(len(X))
            out.append(
                BoardView(source=str(len(out)), width=1280, height=1024, index=index, uv_px=noisy, sigma_px=SIGMA_PX)
            )
    return out


def by_opencv(seen: list[BoardView]) -> np.ndarray:
    """Return OpenCV's intrinsics (8,), NaN where it gives up."""
    flags = cv2.fisheye.CALIB_RECOMPUTE_EXTRINSIC | cv2.fisheye.CALIB_FIX_SKEW
    try:
        _, K, k, *_ = cv2.fisheye.calibrate(
            [BOARD.xyz_m[None] for _ in seen], [v.uv_px[None] for v in seen], (1280, 1024), None, None, flags=flags
        )
    except cv2.error:
        return np.full(8, np.nan)
    return np.array([K[0, 0], K[1, 1], K[0, 2], K[1, 2], *k.ravel()])


def main(repeats: int) -> None:
    """Calibrate and print the table."""
    ours, theirs, claimed = [], [], []
    for seed in range(repeats):
        seen = views(np.random.default_rng(seed))
        done = calibrate_camera(seen, BOARD, BoardOptions(lens=LensKind.FISHEYE, folds=0))
        ours.append(done.camera.intrinsics[PLACES] - TRUTH)
        claimed.append([done.std.get(name, np.nan) for name in NAMES])
        theirs.append(by_opencv(seen) - TRUTH)
    error, std, other = np.array(ours), np.array(claimed), np.array(theirs)
    ratio = error / std
    failed = int(np.isnan(other[:, 0]).sum())
    print(f"{repeats} calibrations of {VIEWS} views, {SIGMA_PX} px; cv2.fisheye.calibrate gave up {failed} times")
    print(f"{'':4} {'RMS error':>10} {'OpenCV':>10} {'error/std':>10} {'within':>7} {'claimed':>8}")
    for i, name in enumerate(NAMES):
        free = np.isfinite(std[:, i])
        rms = [np.sqrt(np.nanmean(e[:, i] ** 2)) for e in (error, other, ratio)]
        within = np.mean(np.abs(ratio[free, i]) < 1.96)
        print(f"{name:4} {rms[0]:10.3g} {rms[1]:10.3g} {rms[2]:10.2f} {within:7.2f} {free.sum():8d}")


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 100)
