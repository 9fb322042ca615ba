"""The template detector beside OpenCV's on real and on rendered checkerboards, and both views of complex images.

Real boards: ../shared/data/opencv_stereo, skipped, saying so, where it is not there; nobody knows their corners, so the
figures are each detector's scatter about the smooth grid through its own corners, leaving each corner out of the
grid that judges it. Rendered boards: against the truth. Found means with all corners: find_board leaves
out those that it cannot verify.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable

import cv2
import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.errors import BadImage
from armsight.measure.boards import find_board, find_two_boards, xcorner_corners
from armsight.measure.boards.gridmap import fit_map
from armsight.records import TargetKind, board_target
from armsight_sim.boards import Board, board_light, corner_rays
from armsight_sim.lens import Lens
from bench import DATA, machine, table

PAIRS = (1, 2, 3, 4, 5, 6, 7, 8, 9, 11, 12, 13, 14)
SIZE = (9, 6)
GRID = np.stack(np.meshgrid(np.arange(9.0), np.arange(6.0)), -1).reshape(-1, 2)
BOARD = board_target(TargetKind.CHECKERBOARD, 9, 6, 0.025)
LENS = Lens(
    width=640, height=480, focal_px=(600.0, 600.0), centre_px=(319.5, 239.5), distortion=(-0.1, 0.03, 0.0, 0.0, 0.0)
)
RAYS = corner_rays(LENS)
Detector = Callable[[np.ndarray], np.ndarray | None]


def classic(image: np.ndarray) -> np.ndarray | None:
    flags = cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE
    found, corners = cv2.findChessboardCorners(image, SIZE, flags=flags)
    return corners.reshape(-1, 2).astype(float) if found else None


def sectors(image: np.ndarray) -> np.ndarray | None:
    found, corners = cv2.findChessboardCornersSB(image, SIZE, flags=cv2.CALIB_CB_NORMALIZE_IMAGE)
    return corners.reshape(-1, 2).astype(float) if found else None


def fitted(detector: str) -> Detector:
    def find(image: np.ndarray) -> np.ndarray | None:
        try:
            view = find_board(image, BOARD, detector=detector)
        except BadImage:
            return None
        return view.uv_px if len(view) == len(GRID) else None

    return find


DETECTORS: dict[str, Detector] = {
    "xcorner, templates alone": lambda image: xcorner_corners(image, *SIZE),
    "OpenCV findChessboardCorners": classic,
    "OpenCV findChessboardCornersSB": sectors,
    "find_board, xcorner": fitted("xcorner"),
    "find_board, auto (default)": fitted("auto"),
}


def scatter(uv: np.ndarray) -> np.ndarray:
    """Return each corner's offset (n, 2) from the smooth grid through all others."""
    out = np.empty_like(uv)
    for i in range(len(uv)):
        others = np.arange(len(uv)) != i
        out[i] = uv[i] - fit_map(GRID[others], uv[others])[0](GRID[i : i + 1])[0]
    return out


def against(uv: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """Return the offsets (n, 2) in the better of the two numberings that a 9 x 6 grid leaves."""
    grid = uv.reshape(6, 9, 2)
    turned = (grid, grid[::-1, ::-1], grid[:, ::-1], grid[::-1])
    return min((g.reshape(-1, 2) - truth for g in turned), key=lambda off: float(np.abs(off).max()))


def rows_of(images: list[np.ndarray], judge: Callable[[int, np.ndarray], np.ndarray]) -> list[list[object]]:
    rows: list[list[object]] = []
    for name, detector in DETECTORS.items():
        detector(images[0])
        times, errors = [], []
        for n, image in enumerate(images):
            start = time.perf_counter()
            uv = detector(image)
            times.append(1e3 * (time.perf_counter() - start))
            if uv is not None:
                errors.append(judge(n, uv))
        rms = np.sqrt(np.mean(np.concatenate(errors) ** 2)) if errors else np.nan
        worst = max((float(np.abs(e).max()) for e in errors), default=np.nan)
        rows.append([name, f"{len(errors)} of {len(images)}", f"{rms:.3f}", f"{worst:.2f}", f"{np.median(times):.0f}"])
    return rows


def real() -> None:
    folder = DATA / "opencv_stereo"
    if not folder.exists():
        print("opencv_stereo: not here, skipped")
        return
    images = [cv2.imread(str(folder / f"{s}{n:02d}.jpg"), 0) for s in ("left", "right") for n in PAIRS]
    table(
        "Real boards, 640 x 480: left-out scatter about the smooth grid",
        ["detector", "found", "RMS px", "worst px", "median ms"],
        rows_of(images, lambda _, uv: scatter(uv)),
    )


def rendered(title: str, count: int, seed: int, **kind: float) -> None:
    """kind: tilt_deg, blur_px, noise, shade (fall of light to that share across the image), depth_m."""
    rng = np.random.default_rng(seed)
    images, truths = [], []
    board = Board(blur_px=kind.get("blur_px", 0.8))
    lamp = np.linspace(kind.get("shade", 1.0), 1.0, LENS.width)[None, :]
    while len(images) < count:
        axis = rng.normal(size=2)
        lean = np.deg2rad(rng.uniform(0.6, 1.0) * kind.get("tilt_deg", 30.0)) * axis / np.linalg.norm(axis)
        R = Rotation.from_rotvec([*lean, 0.0]) * Rotation.from_rotvec([0.0, 0.0, rng.uniform(-np.pi, np.pi)])
        middle = np.array([*rng.uniform(-0.03, 0.03, 2), kind.get("depth_m", 0.5)])
        T = RigidTransform.from_components(middle - R.apply(board.corners_m().mean(0)), R)
        truth = LENS.project(T.apply(board.corners_m()))
        if truth.min() < 25.0 or (truth > [LENS.width - 26.0, LENS.height - 26.0]).any():
            continue
        light = board_light(RAYS, board, T)[:, :, 0] * lamp + rng.normal(0.0, kind.get("noise", 2.0), (480, 640))
        images.append(np.clip(np.rint(light), 0, 255).astype(np.uint8))
        truths.append(truth)
    table(
        f"Rendered boards: {title}",
        ["detector", "found", "RMS px", "worst px", "median ms"],
        rows_of(images, lambda n, uv: against(uv, truths[n])),
    )


def complex_images(count: int) -> None:
    rng = np.random.default_rng(7)
    board = Board(square_m=0.02, black=12.0, white=90.0, room=30.0, blur_px=0.9)
    target = board_target(TargetKind.CHECKERBOARD, 9, 6, 0.02)
    lens = Lens(width=768, height=576, focal_px=(1000.0, 1000.0), centre_px=(383.5, 287.5))
    rays = corner_rays(lens)
    done, refused, kept, errors, ratios, times = 0, {}, [], [], [], []
    while done < count:
        axis = rng.normal(size=2)
        lean = np.deg2rad(rng.uniform(0.0, 30.0)) * axis / np.linalg.norm(axis)
        R = Rotation.from_rotvec([*lean, 0.0]) * Rotation.from_rotvec([0.0, 0.0, rng.uniform(-0.35, 0.35)])
        middle = np.array([*rng.uniform([-0.08, -0.06], [0.08, 0.06]), rng.uniform(0.5, 0.75)])
        T = RigidTransform.from_components(middle - R.apply(board.corners_m().mean(0)), R)
        views = [RigidTransform.from_translation([x, 0.0, -0.06]).inv() * T for x in (-0.06, 0.06)]
        truths = [lens.project(view.apply(board.corners_m())) for view in views]
        if any(uv.min() < 30.0 or (uv > [737.0, 545.0]).any() for uv in truths):
            continue
        done += 1
        light = sum(board_light(rays, board, view)[:, :, 0] for view in views) + rng.normal(6.0, 1.5, (576, 768))
        image = np.clip(np.rint(light), 0, 255).astype(np.uint8)
        start = time.perf_counter()
        try:
            found = find_two_boards(image, target)
        except BadImage as error:
            why = error.cause.split(": ", 1)[1][:40]
            refused[why] = refused.get(why, 0) + 1
            continue
        times.append(1e3 * (time.perf_counter() - start))
        for view, uv in zip(found, truths, strict=True):
            kept.append(len(view))
            errors.append(view.uv_px - uv[view.index])
            ratios.append(errors[-1] / view.sigma_px)
    off, ratio = np.concatenate(errors), np.concatenate(ratios)
    table(
        "Complex images, 768 x 576, two boards of 9 x 6 over each other: find_two_boards",
        ["found", "corners a view", "RMS px", "worst px", "RMS by sigma_px", "median ms"],
        [
            [
                f"{len(times)} of {count}",
                f"{np.median(kept):.0f} of 54",
                f"{np.sqrt(np.mean(off**2)):.4f}",
                f"{np.abs(off).max():.3f}",
                f"{np.sqrt(np.mean(ratio**2)):.2f}",
                f"{np.median(times):.0f}",
            ]
        ],
    )
    for why, n in refused.items():
        print(f"\nrefused {n}: {why} ...")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="few images of each kind")
    count = 6 if parser.parse_args().quick else 30
    print(machine(), f"OpenCV {cv2.__version__}", sep=", ")
    real()
    rendered("tilted to 30 degrees", count, 1)
    rendered("tilted to 60 degrees", count, 2, tilt_deg=60.0)
    rendered("noise of 12 grey levels", count, 3, noise=12.0)
    rendered("light falling to a quarter across the image", count, 4, shade=0.25)
    rendered("blurred by 2.5 px", count, 5, blur_px=2.5)
    rendered("small: squares of 10 px", count, 6, depth_m=1.5, tilt_deg=20.0)
    complex_images(count)


if __name__ == "__main__":
    main()
