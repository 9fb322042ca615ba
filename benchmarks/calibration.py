"""Stereo calibration after detection: accuracy against the Cramer-Rao bound, time, and truth of the claimed standard
deviations.

Synthetic: 2 cameras 1280x720, 20 boards of 9x6 corners, 0.1 px noise. The world is projected by NumPy here, apart
from the product's code. Peer: cv2.calibrateCamera for each camera, then cv2.stereoCalibrate with free intrinsics.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import dataclass

import cv2
import numpy as np

from armsight.calibrate.cameras import BoardOptions, calibrate_camera, calibrate_stereo
from armsight.records import BoardView, Target, TargetKind, board_target
from bench import machine, table

SIZE = (1280, 720)
SIGMA_PX = 0.1
N_VIEWS = 20
NAMES = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2")
LEFT = np.array([1105.0, 1102.0, 651.0, 352.0, -0.12, 0.06, 4e-4, -3e-4])
RIGHT = np.array([1093.0, 1096.0, 630.0, 371.0, -0.11, 0.05, -2e-4, 5e-4])
RIGHT_POSE = np.array([0.30, -0.004, 0.03, -0.01, -0.25, -0.015])  # T_left_right: m, rad
SHARED = [*(f"left.{n}" for n in NAMES), *(f"right.{n}" for n in NAMES)] + [
    f"right.{n}" for n in ("tx", "ty", "tz", "rx", "ry", "rz")
]


def project(k: np.ndarray, P: np.ndarray) -> np.ndarray:
    """Pixels (..., 2) of points (..., 3) in camera axes, Brown-Conrady with two radial and two tangential terms."""
    x, y = P[..., 0] / P[..., 2], P[..., 1] / P[..., 2]
    r2 = x * x + y * y
    radial = 1 + k[4] * r2 + k[5] * r2 * r2
    xd = x * radial + 2 * k[6] * x * y + k[7] * (r2 + 2 * x * x)
    yd = y * radial + k[6] * (r2 + 2 * y * y) + 2 * k[7] * x * y
    return np.stack([k[0] * xd + k[2], k[1] * yd + k[3]], axis=-1)


def rotation(w: np.ndarray) -> np.ndarray:
    return cv2.Rodrigues(np.asarray(w, float))[0]


def world(p: np.ndarray, X: np.ndarray) -> np.ndarray:
    """Pixels (2, G, n, 2) from p = left (8), right (8), T_left_right (6), board poses (6 each: t, rotation vector)."""
    R, t = rotation(p[19:22]), p[16:19]
    views = []
    for pose in p[22:].reshape(-1, 6):
        P = X @ rotation(pose[3:]).T + pose[:3]
        views.append([project(p[:8], P), project(p[8:16], (P - t) @ R)])
    return np.array(views).swapaxes(0, 1)


@dataclass
class Set:
    p: np.ndarray
    uv: np.ndarray
    bound: np.ndarray


def make(rng: np.random.Generator, X: np.ndarray) -> Set:
    """A random set in which both cameras see every board whole, with the bound of the 22 shared parameters."""
    poses: list[np.ndarray] = []
    while len(poses) < N_VIEWS:
        pose = np.concatenate(
            [[rng.uniform(-0.25, 0.4), rng.uniform(-0.25, 0.25), rng.uniform(0.6, 1.1)], rng.uniform(-0.6, 0.6, 3)]
        )
        uv = world(np.concatenate([LEFT, RIGHT, RIGHT_POSE, pose]), X)
        if (uv > 8).all() and (uv[..., 0] < SIZE[0] - 8).all() and (uv[..., 1] < SIZE[1] - 8).all():
            poses.append(pose)
    p = np.concatenate([LEFT, RIGHT, RIGHT_POSE, *poses])
    J = np.empty((2 * 2 * N_VIEWS * len(X), len(p)))
    for i in range(len(p)):
        h = np.zeros_like(p)
        h[i] = 1e-5 * max(1.0, abs(p[i]))
        J[:, i] = ((world(p + h, X) - world(p - h, X)) / (2 * h[i])).ravel()
    scale = 1.0 / np.linalg.norm(J, axis=0)
    information = (J * scale).T @ (J * scale)
    cov = np.linalg.inv(information) * np.outer(scale, scale) * SIGMA_PX**2
    return Set(p=p, uv=world(p, X), bound=np.sqrt(np.diag(cov)[:22]))


def views(uv: np.ndarray, prefix: str) -> list[BoardView]:
    return [
        BoardView(
            uv_px=u, index=np.arange(len(u)), sigma_px=SIGMA_PX, width=SIZE[0], height=SIZE[1], source=f"{prefix}{g}"
        )
        for g, u in enumerate(uv)
    ]


def error(values: np.ndarray, p: np.ndarray) -> np.ndarray:
    """Errors of the 22 shared parameters; the rotation's as Exp(dw) R."""
    e = values - p[:22]
    e[19:22] = cv2.Rodrigues(rotation(values[19:22]) @ rotation(p[19:22]).T)[0].ravel()
    return e


def ours(left: list[BoardView], right: list[BoardView], board: Target) -> tuple[np.ndarray, dict[str, float]]:
    done = calibrate_stereo(left, right, board, BoardOptions(folds=0))
    pick = [0, 1, 2, 3, 5, 6, 7, 8]
    T = done.rig.T_rig_right
    values = np.concatenate(
        [done.rig.left.intrinsics[pick], done.rig.right.intrinsics[pick], T.translation, T.rotation.as_rotvec()]
    )
    return values, done.std


def opencv(uv: np.ndarray, X: np.ndarray, iterations: int, epsilon: float) -> np.ndarray:
    objects = [X.astype(np.float32)] * N_VIEWS
    images = [[u.astype(np.float32) for u in side] for side in uv]
    mono = [cv2.calibrateCamera(objects, side, SIZE, None, None, flags=cv2.CALIB_FIX_K3) for side in images]
    criteria = (cv2.TERM_CRITERIA_MAX_ITER + cv2.TERM_CRITERIA_EPS, iterations, epsilon)
    flags = cv2.CALIB_USE_INTRINSIC_GUESS | cv2.CALIB_FIX_K3
    _, K0, d0, K1, d1, R, T, *_ = cv2.stereoCalibrate(
        objects, *images, mono[0][1], mono[0][2], mono[1][1], mono[1][2], SIZE, flags=flags, criteria=criteria
    )
    intrinsics = [np.r_[K[0, 0], K[1, 1], K[0, 2], K[1, 2], d.ravel()[:4]] for K, d in ((K0, d0), (K1, d1))]
    return np.concatenate([*intrinsics, (-R.T @ T).ravel(), cv2.Rodrigues(R.T)[0].ravel()])


def peers(n_sets: int, board: Target, X: np.ndarray) -> None:
    errors: dict[str, list[np.ndarray]] = {}
    times: dict[str, list[float]] = {}
    for seed in range(n_sets):
        rng = np.random.default_rng(100 + seed)
        data = make(rng, X)
        uv = data.uv + rng.normal(0.0, SIGMA_PX, data.uv.shape)
        sides = views(uv[0], "left"), views(uv[1], "right")
        runs = {
            "armsight.calibrate_stereo": lambda sides=sides: ours(*sides, board)[0],
            "cv2 4.14, its defaults (30 it, 1e-6)": lambda uv=uv: opencv(uv, X, 30, 1e-6),
            "cv2 4.14, 200 it, 1e-12": lambda uv=uv: opencv(uv, X, 200, 1e-12),
        }
        for name, run in runs.items():
            if seed == 0:
                run()
            start = time.perf_counter()
            values = run()
            times.setdefault(name, []).append((time.perf_counter() - start) * 1e3)
            errors.setdefault(name, []).append(error(values, data.p) / data.bound)
    rows = [
        [name, float(np.median(times[name])), float(np.min(times[name])), float(np.sqrt(np.mean(np.square(e))))]
        for name, e in errors.items()
    ]
    table(
        f"Stereo calibration after detection, initial guess included: {n_sets} random sets",
        ["method", "median ms", "least ms", "RMS error / Cramer-Rao bound (22 parameters)"],
        rows,
    )


def claims(n: int, board: Target, X: np.ndarray) -> None:
    """One set, n noises: spread of the answers against the standard deviations claimed."""
    rng = np.random.default_rng(7)
    data = make(rng, X)
    stereo, claimed, mono, claimed_mono = [], [], [], []
    baseline = np.linalg.norm(RIGHT_POSE[:3])
    lengths = []
    for _ in range(n):
        uv = data.uv + rng.normal(0.0, SIGMA_PX, data.uv.shape)
        values, std = ours(views(uv[0], "left"), views(uv[1], "right"), board)
        stereo.append(error(values, data.p))
        claimed.append([std[name] for name in SHARED])
        lengths.append((np.linalg.norm(values[16:19]) - baseline, std["baseline_m"]))
        one = calibrate_camera(views(uv[0], "left"), board, BoardOptions(folds=0))
        mono.append(one.camera.intrinsics[[0, 1, 2, 3, 5, 6, 7, 8]] - LEFT)
        claimed_mono.append([one.covariance.std()[name] for name in NAMES])
    rows = []
    for names, errors, claim in ((SHARED, stereo, claimed), ([f"one camera: {n}" for n in NAMES], mono, claimed_mono)):
        spread = np.sqrt(np.mean(np.square(errors), axis=0))
        typical = np.sqrt(np.mean(np.square(claim), axis=0))
        rows += [[name, float(s), float(c), float(c / s)] for name, s, c in zip(names, spread, typical, strict=True)]
    e, c = np.array(lengths).T
    rows.append(
        [
            "baseline_m",
            float(np.sqrt(np.mean(e**2))),
            float(np.sqrt(np.mean(c**2))),
            float(np.sqrt(np.mean(c**2) / np.mean(e**2))),
        ]
    )
    table(
        f"Claimed deviations against the errors of {n} repeats (chance alone: +-{100 / np.sqrt(2 * n):.0f} % for each)",
        ["parameter", "RMS error", "claimed", "claimed / error"],
        rows,
    )
    ratios = np.array([row[3] for row in rows])
    print(f"\nclaimed / error: {ratios.min():.3f} to {ratios.max():.3f}, mean {ratios.mean():.3f}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="fewer sets and repeats")
    quick = parser.parse_args().quick
    board = board_target(TargetKind.CHECKERBOARD, 9, 6, 0.03)
    X = board.xyz_m
    print(machine(), f"OpenCV {cv2.__version__}", sep=", ")
    peers(4 if quick else 40, board, X)
    claims(20 if quick else 200, board, X)


if __name__ == "__main__":
    main()
