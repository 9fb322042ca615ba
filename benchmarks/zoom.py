"""Zoom lenses calibrated at five settings: what is claimed between them against what is true.

python benchmarks/zoom.py [--lenses N] [--settings N] [--seed N]

Each lens is another one (groups, zoom ratio, cam, focus, centring, distortion). Boards are seen through it at each
setting, corners known to 0.1 px; each setting is calibrated as `armsight calibrate camera` does. Four settings between
them, which nobody calibrated, are then asked for; and each inner setting of the five is left out and predicted.
"""

from __future__ import annotations

import argparse
import platform
import time
from collections.abc import Sequence
from datetime import UTC, datetime

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.calibrate.cameras import BoardOptions, calibrate_camera
from armsight.errors import DataRefused
from armsight.optics import INTRINSICS, Camera, ZoomLens, ZoomSetting
from armsight.optics.zoom import image_distance
from armsight.records import BoardView, TargetKind, board_target
from armsight_sim.lens import Lens, random_zoom_lens
from armsight_sim.lens import ZoomLens as SimZoomLens

BOARD = board_target(TargetKind.CHECKERBOARD, 9, 6, 0.025)
SIGMA_PX, VIEWS, ASKED = 0.1, 14, 4
NORMAL_95 = 1.959964
SHOWN = ("fx", "fy", "cx", "cy", "k1")


def board_views(lens: Lens, rng: np.random.Generator, count: int = VIEWS) -> list[BoardView]:
    """Views of a board that fills a third to two thirds of the picture, tilted up to 40 degrees."""
    views: list[BoardView] = []
    centre_m = BOARD.xyz_m.mean(axis=0)
    while len(views) < count:
        lean = rng.uniform(0.3, 0.7) * np.array([np.cos(a := rng.uniform(0, 2 * np.pi)), np.sin(a), 0.0])
        R = Rotation.from_rotvec(lean) * Rotation.from_rotvec([0.0, 0.0, rng.uniform(-0.4, 0.4)])
        z = 0.25 * lens.focal_px[0] / (rng.uniform(0.35, 0.65) * lens.width)
        uv = rng.uniform([0.2, 0.2], [0.8, 0.8]) * [lens.width, lens.height]
        x, y = lens.rays(uv[None])[0]
        pose = RigidTransform.from_components(np.array([x * z, y * z, z]) - R.apply(centre_m), R)
        seen = lens.project(pose.apply(BOARD.xyz_m))
        if not ((seen > 5).all() and (seen < np.array([lens.width, lens.height]) - 6).all()):
            continue
        views.append(
            BoardView(
                uv_px=seen + rng.normal(0.0, SIGMA_PX, seen.shape),
                index=np.arange(len(seen)),
                sigma_px=SIGMA_PX,
                width=lens.width,
                height=lens.height,
                source=str(len(views)),
            )
        )
    return views


def calibrated(made: SimZoomLens, zooms: Sequence[float], rng: np.random.Generator) -> ZoomLens:
    """The lens's settings, each calibrated from boards of its own."""
    settings = []
    for zoom in zooms:
        done = calibrate_camera(board_views(made.lens(zoom), rng), BOARD, BoardOptions(folds=0))
        settings.append(
            ZoomSetting(zoom=float(zoom), camera=done.camera, covariance=done.covariance, rms_px=done.rms_px)
        )
    return ZoomLens(settings=tuple(settings))


def truth(made: SimZoomLens, zoom: float) -> Camera:
    """The true camera at a setting."""
    lens = made.lens(zoom)
    return Camera(width=lens.width, height=lens.height, intrinsics=lens.vector[:10])


def trial(seed: int, lens: int, settings: int) -> tuple[list[np.ndarray], list[tuple[float, float, float]], list]:
    """Errors over claimed deviations (asked, 10) of one lens; fx error, claim, image distance; the same left out."""
    rng = np.random.default_rng([seed, lens])
    made = random_zoom_lens(rng, 1280, 720)
    zooms = np.linspace(*made.zoom, settings)
    found = calibrated(made, zooms, rng)
    ratios, sizes, left = [], [], []
    for zoom in rng.uniform(*made.zoom, ASKED):
        state, true = found.at(float(zoom)), truth(made, float(zoom))
        error = state.camera.intrinsics - true.intrinsics
        std = np.sqrt(np.diag(state.covariance.matrix))
        ratios.append(np.divide(error, std, out=np.zeros(10), where=std > 0))
        sizes.append((error[0] / true.intrinsics[0], std[0] / true.intrinsics[0], image_distance(true, state.camera)))
    for i in range(1, settings - 1):
        rest = ZoomLens(settings=(*found.settings[:i], *found.settings[i + 1 :]))
        state, true = rest.at(float(zooms[i])), truth(made, float(zooms[i]))
        std = float(state.covariance.std()["fx"])
        error = float(state.camera.intrinsics[0] - true.intrinsics[0])
        left.append((error / std, error / true.intrinsics[0], std / true.intrinsics[0]))
    return ratios, sizes, left


def share(ratios: np.ndarray) -> str:
    return f"{100 * (np.abs(ratios) < NORMAL_95).mean():.1f} %"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--lenses", type=int, default=300)
    parser.add_argument("--settings", type=int, default=5)
    parser.add_argument("--seed", type=int, default=1)
    args = parser.parse_args()
    begun = time.perf_counter()
    ratios, sizes, left, refused = [], [], [], []
    for lens in range(args.lenses):
        try:
            a, b, c = trial(args.seed, lens, args.settings)
        except DataRefused as error:
            refused.append(str(error))
            continue
        ratios += a
        sizes += b
        left += c
    r, s, k = np.array(ratios), np.array(sizes), np.array(left)
    print(f"{datetime.now(UTC):%Y-%m-%d}, {platform.machine()}, Python {platform.python_version()}")
    print(f"{args.lenses} lenses of {args.settings} settings, {len(r)} zooms between them, {len(k)} left-out settings")
    print(f"{len(refused)} lenses refused{': ' + refused[0] if refused else ''}\n")
    print("| at zooms that nobody calibrated | inside the claimed 95 % interval |\n|---|---|")
    for name in SHOWN:
        print(f"| {name} | {share(r[:, INTRINSICS.index(name)])} |")
    print(f"| fx, each inner setting left out | {share(k[:, 0])} |\n")
    print("| fx, relative | median | 90th percentile |\n|---|---|---|")
    for name, values in (
        ("error between settings", np.abs(s[:, 0])),
        ("claimed deviation between settings", s[:, 1]),
        ("error at a setting left out", np.abs(k[:, 1])),
        ("claimed deviation there", k[:, 2]),
    ):
        print(f"| {name} | {100 * np.median(values):.4f} % | {100 * np.quantile(values, 0.9):.3f} % |")
    print(f"| whole image, px RMS between settings | {np.median(s[:, 2]):.3f} | {np.quantile(s[:, 2], 0.9):.2f} |")
    print(f"\n{(time.perf_counter() - begun) / args.lenses * 1e3:.0f} ms a lens")


if __name__ == "__main__":
    main()
