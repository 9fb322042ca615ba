"""Tools of taught paths against the path before noise, and picks of a scene found in the other view.

Smoothing and outliers: a circle and a trapezium in noise, with rows moved away. Picks: two planes, one before the
other, drawn by rays with cameras written out here, so that some picks are hidden in one view; a wrong answer is one
that is further from the truth than five of its own standard deviations and than 1 mm. Real pictures:
../shared/data/opencv_stereo, skipped, saying so, where it is not there; the truth are OpenCV's corners in the other
picture.
"""

from __future__ import annotations

import argparse
import itertools
import math
from collections import Counter

import cv2
import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.control.paths import outliers, resampled, smoothed
from armsight.errors import DataRefused
from armsight.measure.correspondence import PatchSettings, StereoViews, find_in_other_view
from armsight.optics import Camera, Rig, RigKind
from armsight.records import TaughtPath
from bench import DATA, machine, table

LEGS = np.array([[0, 0, 0], [0.2, 0, 0], [0.15, 0.1, 0], [0.05, 0.1, 0], [0, 0, 0]], dtype=float)
WIDTH, HEIGHT, FOCAL, BASELINE = 480, 360, 600.0, 0.1
NEAR, FAR, EDGE_M = 0.6, 0.75, 0.02
"""Depths of both planes, and the x at which the nearer one ends."""
REAL = (1, 2, 3, 4, 5, 6, 7, 8, 9, 11, 12, 13, 14)


def path_through(xyz: np.ndarray) -> TaughtPath:
    turns = Rotation.from_quat(np.tile([1.0, 0.0, 0.0, 0.0], (len(xyz), 1)))
    return TaughtPath.of_poses(RigidTransform.from_components(xyz, turns))


def shapes() -> dict[str, TaughtPath]:
    angle = np.linspace(0.0, 1.9 * math.pi, 300)
    circle = 0.1 * np.stack([np.cos(angle), np.sin(angle), 0.0 * angle], axis=1)
    return {"circle": path_through(circle), "trapezium": resampled(path_through(LEGS), 0.002, keep=(1, 2, 3))}


def off_line(path: TaughtPath, truth: TaughtPath) -> float:
    line = np.concatenate([np.linspace(a, b, 100, endpoint=False) for a, b in itertools.pairwise(truth.xyz_m)])
    return float(np.sqrt(np.mean(cKDTree(line).query(path.xyz_m)[0] ** 2)))


def noise(trials: int) -> None:
    rows = []
    for name, truth in shapes().items():
        for sigma in (5e-5, 2e-4):
            before, after, found, false = [], [], 0, 0
            for seed in range(trials):
                rng = np.random.default_rng(seed)
                taught = path_through(truth.xyz_m + rng.normal(0.0, sigma, truth.xyz_m.shape))
                before.append(off_line(taught, truth))
                after.append(off_line(smoothed(taught), truth))
                moved = np.sort(rng.choice(len(truth), 5, replace=False))
                xyz = taught.xyz_m.copy()
                xyz[moved] += 0.005 * Rotation.random(5, random_state=seed).apply([1.0, 0.0, 0.0])
                named = {one.row for one in outliers(path_through(xyz))}
                found += len(named & set(moved.tolist()))
                false += len(named - set(moved.tolist()))
            micro = [f"{1e6 * math.sqrt(np.mean(np.square(x))):.0f}" for x in (before, after)]
            rows.append([f"{name}, {1e6 * sigma:.0f} um", *micro, f"{found} of {5 * trials}", str(false)])
    table(
        "Smoothing and outliers",
        ["path, noise", "off the line, um", "smoothed, um", "rows 5 mm off found", "others named"],
        rows,
    )


def seen(side: str) -> tuple[np.ndarray, np.ndarray]:
    """Depth (n,) and the place (n, 2) in its plane of what each of four rays a pixel meets."""
    u, v = np.meshgrid(np.arange(WIDTH), np.arange(HEIGHT))
    pixels = np.stack([u.ravel(), v.ravel()], axis=1).astype(float)
    rays = np.concatenate([pixels + shift for shift in ([-0.25, -0.25], [0.25, -0.25], [-0.25, 0.25], [0.25, 0.25])])
    return ray_ends(rays, side)


def ray_ends(pixels: np.ndarray, side: str) -> tuple[np.ndarray, np.ndarray]:
    x0 = 0.0 if side == "left" else BASELINE
    way = (pixels - [(WIDTH - 1) / 2, (HEIGHT - 1) / 2]) / FOCAL
    near = np.stack([x0 + NEAR * way[:, 0], NEAR * way[:, 1]], axis=1)
    far = np.stack([x0 + FAR * way[:, 0], FAR * way[:, 1]], axis=1)
    first = near[:, 0] < EDGE_M
    return np.where(first, NEAR, FAR), np.where(first[:, None], near, far)


def grey(depth: np.ndarray, place: np.ndarray, seed: int, contrast: float) -> np.ndarray:
    out = np.empty(len(depth))
    for k, z in enumerate((NEAR, FAR)):
        rng = np.random.default_rng(100 * seed + k)
        waves, phase = rng.normal(0.0, 200.0, (40, 2)), rng.uniform(0.0, 2.0 * math.pi, 40)
        on = depth == z
        out[on] = 128.0 + contrast * np.sum(np.cos(place[on] @ waves.T + phase), axis=1)
    return out


def scene_picks(trials: int) -> None:
    camera = Camera.pinhole(width=WIDTH, height=HEIGHT, fx=FOCAL, fy=FOCAL, cx=(WIDTH - 1) / 2, cy=(HEIGHT - 1) / 2)
    rig = Rig(
        kind=RigKind.STEREO, left=camera, right=camera, T_rig_left=RigidTransform.identity(),
        T_rig_right=RigidTransform.from_translation([BASELINE, 0.0, 0.0]),
    )  # fmt: skip
    settings = PatchSettings(near_m=0.4, far_m=1.5, pick_std_px=1e-6)
    ends = {side: seen(side) for side in ("left", "right")}
    rows = []
    for contrast, sigma in ((12.0, 0.5), (12.0, 2.0), (4.0, 2.0)):
        z, wrong, refused, std, total = [], 0, Counter[str](), [], 0
        for seed in range(trials):
            rng = np.random.default_rng(seed)
            images = {}
            for side in ("left", "right"):
                levels = grey(*ends[side], seed, contrast).reshape(4, HEIGHT, WIDTH).mean(axis=0)
                noisy = levels + rng.normal(0.0, sigma, levels.shape)
                images[side] = np.clip(np.round(noisy), 0, 255).astype(np.uint8)
            views = StereoViews(rig=rig, **images)
            for px in rng.uniform([10, 10], [WIDTH - 10, HEIGHT - 10], (60, 2)):
                total += 1
                try:
                    one = find_in_other_view(views, "left", px, settings)
                except DataRefused as error:
                    refused[type(error).__name__] += 1
                    continue
                depth = ray_ends(px[None], "left")[0][0]
                off, sz = one.xyz_m[2] - depth, math.sqrt(one.covariance_m2[2, 2])
                wrong += abs(off) > max(5.0 * sz, 1e-3)
                z.append(off / sz)
                std.append(one.std_px)
        claim = math.sqrt(np.mean(np.clip(np.square(z), 0.0, 25.0)))
        why = ", ".join(f"{count} {name}" for name, count in refused.most_common(3))
        rows.append(
            [
                f"{contrast:g} and {sigma:g}",
                f"{len(z)} of {total}",
                str(wrong),
                f"{claim:.2f}",
                f"{np.median(std):.3f}",
                why,
            ]
        )
    table(
        "Picks on two planes",
        ["contrast and noise, levels", "found", "wrong", "error by its std, RMS", "std, px", "refused"],
        rows,
    )


def real() -> None:
    folder = DATA / "opencv_stereo"
    if not folder.is_dir():
        print("opencv_stereo: not here, skipped")
        return
    cameras = [
        Camera.pinhole(
            width=640, height=480, fx=533.475, fy=533.481, cx=342.505, cy=233.982,
            distortion=(-0.28862916, 0.09358271, 0.00119632, -0.00015541, 0.0),
        ),
        Camera.pinhole(
            width=640, height=480, fx=536.898, fy=536.470, cx=327.472, cy=248.832,
            distortion=(-0.29040756, 0.10651323, -0.00047909, 0.0000384, 0.0),
        ),
    ]  # fmt: skip
    T = RigidTransform.from_components(
        [0.083195, -0.000616, 0.000418], Rotation.from_quat([-0.003273, -0.002064, 0.001868, 0.999991])
    )
    rig = Rig(
        kind=RigKind.STEREO, left=cameras[0], right=cameras[1], T_rig_left=RigidTransform.identity(), T_rig_right=T
    )
    found, total, off = 0, 0, []
    why: Counter[str] = Counter()
    for number in REAL:
        images = [
            cv2.imread(str(folder / f"{side}{number:02d}.jpg"), cv2.IMREAD_GRAYSCALE) for side in ("left", "right")
        ]
        boards = [cv2.findChessboardCorners(image, (9, 6)) for image in images]
        if not all(ok for ok, _ in boards):
            continue
        stop = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 40, 1e-3)
        left, right = (
            cv2.cornerSubPix(image, corners, (5, 5), (-1, -1), stop).reshape(-1, 2).astype(float)
            for image, (_, corners) in zip(images, boards, strict=True)
        )
        views = StereoViews(rig=rig, left=images[0], right=images[1])
        for a, b in zip(left, right, strict=True):
            total += 1
            try:
                one = find_in_other_view(views, "left", a, PatchSettings(near_m=0.2, far_m=1.5, half_px=10))
            except DataRefused as error:
                why[type(error).__name__] += 1
                continue
            found += 1
            off.append(np.linalg.norm(one.other_px - b))
    wrong = sum(one > 2.0 for one in off)
    rms = math.sqrt(np.mean(np.square([one for one in off if one <= 2.0])))
    reasons = ", ".join(f"{count} {name}" for name, count in why.most_common())
    table(
        "Real pictures",
        ["corners, depths 0.2 to 1.5 m", "found", "more than 2 px off", "others, RMS px", "refused"],
        [["opencv_stereo", f"{found} of {total}", str(wrong), f"{rms:.3f}", reasons]],
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--trials", type=int, default=20)
    trials = parser.parse_args().trials
    print(machine())
    noise(trials)
    scene_picks(max(1, trials // 4))
    real()


if __name__ == "__main__":
    main()
