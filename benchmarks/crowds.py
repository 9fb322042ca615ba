"""Crowded pictures, 1280x720: a target among 90 lights, and what looks like lights: time a pair, right or wrong.

Drawn here with numpy and OpenCV's projection. They are measured as live pictures are, within LIVE_S; `--batch`: as
files are. Times are of the processor, of all threads together. `--quick` takes a fifth of the pictures. OpenCV's blob
detector, which only finds blobs, runs beside ours. Wrong: a pose further off than 5 mm or 5 degrees, or any pose
without a target.
"""

from __future__ import annotations

import argparse
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from armsight.errors import ArmsightError
from armsight.measure.poses.pipeline import Setup, measure_pair, warm_up
from armsight.measure.settings import BATCH, Pace
from armsight.ops.sources.pace import live_pace
from armsight.records import Frame, PoseStatus, spot_target, unmeasured_target
from bench import machine, table
from pose import RIG, TARGETS, see
from verdicts import FAR_DEG, FAR_MM, blob_detector, pose_error, reason

Array = NDArray[np.float64]
Image = NDArray[np.uint8]
W, H = 1280, 720
BRIGHT = 90
UNMEASURED = "3 lights of unknown geometry"
SIGMA_PX, LEVEL, BLACK, NOISE = 2.0, 180.0, 12.0, 1.5


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Crowd:
    """Two pictures, the target asked for, and where it is: T (4, 4), None where it is not in them."""

    images: tuple[Image, Image]
    lights: str
    T: Array | None


def draw(uv: Array, level: Array, sigma_px: Array, rng: np.random.Generator, behind: Array | None = None) -> Image:
    """Return a picture of round lights at uv (n, 2) before a grey level or an image."""
    light = np.full((H, W), BLACK) if behind is None else behind.astype(float)
    for (u, v), a, s in zip(uv, level, sigma_px, strict=True):
        r = int(5.0 * s) + 1
        x = np.arange(max(int(u) - r, 0), min(int(u) + r + 1, W))
        y = np.arange(max(int(v) - r, 0), min(int(v) + r + 1, H))
        if len(x) and len(y):
            light[y[0] : y[-1] + 1, x[0] : x[-1] + 1] += a * np.outer(
                np.exp(-((y - v) ** 2) / (2 * s * s)), np.exp(-((x - u) ** 2) / (2 * s * s))
            )
    return np.clip(np.rint(light + rng.normal(0.0, NOISE, light.shape)), 0, 255).astype(np.uint8)


def pictures(points: Array, rng: np.random.Generator, behind: Array | None = None) -> tuple[Image, Image]:
    """Return both pictures of equal lights at points (n, 3) m."""
    level, sigma = np.full(len(points), LEVEL), np.full(len(points), SIGMA_PX)
    left, right = (draw(uv, level, sigma, rng, behind) for uv in see(points))
    return left, right


def target_pose(rng: np.random.Generator) -> Array:
    """Return T_rig_target (4, 4), 0.5-0.8 m away."""
    T = np.eye(4)
    T[:3, :3] = Rotation.from_rotvec(rng.normal(0.0, 0.2, 3)).as_matrix()
    T[:3, 3] = rng.uniform([-0.1, -0.08, 0.5], [0.1, 0.08, 0.8])
    return T


def lights_of(name: str, T: Array) -> Array:
    return np.array(list(TARGETS[name].values())) @ T[:3, :3].T + T[:3, 3]


def among(name: str, near: float, far: float, *, shown: bool = True) -> Callable[[np.random.Generator], Crowd]:
    """Return what draws a target (or only its name) among lamps from near to far, BRIGHT lights in all in each view."""

    def crowd(rng: np.random.Generator) -> Crowd:
        T = target_pose(rng)
        own = lights_of(name, T) if shown else np.empty((0, 3))
        lamps = np.empty((0, 3))
        while len(own) + len(lamps) < BRIGHT:
            depth = rng.uniform(near, far)
            at = np.array([rng.uniform(-0.5, 0.5) * W / 1130.0, rng.uniform(-0.5, 0.5) * H / 1130.0, 1.0]) * depth
            every = np.vstack([own, lamps, at])
            inside = all((uv[-1] > 15).all() and (uv[-1] < [W - 15, H - 15]).all() for uv in see(every))
            apart = all(np.linalg.norm(uv[:-1] - uv[-1], axis=1).min(initial=99.0) > 24.0 for uv in see(every))
            if inside and apart:
                lamps = every[len(own) :]
        return Crowd(images=pictures(np.vstack([own, lamps]), rng), lights=name, T=T if shown else None)

    return crowd


def stadium(rng: np.random.Generator) -> Crowd:
    """Return a target before six masts of equal lamps in rows, a few metres away."""
    T = target_pose(rng)
    name = "3 lights, scalene"
    masts = []
    for k in range(6):
        corner = np.array([-1.5 + 0.55 * k, -0.75 + 0.1 * (k % 3), 3.5])
        grid = np.stack(np.meshgrid(np.arange(5), np.arange(4)), axis=-1).reshape(-1, 2) * 0.09
        masts.append(corner + np.column_stack([grid, np.zeros(len(grid))]))
    return Crowd(images=pictures(np.vstack([lights_of(name, T), *masts]), rng), lights=name, T=T)


def keyboard(rng: np.random.Generator) -> Crowd:
    """Return a target above a keyboard whose keys glow in rows, 20 mm apart."""
    T = target_pose(rng)
    name = "3 lights, scalene"
    keys = np.stack(np.meshgrid(np.arange(18), np.arange(6)), axis=-1).reshape(-1, 2) * 0.019 + [-0.17, -0.05]
    tilt = Rotation.from_rotvec([-0.5, 0.0, 0.1]).as_matrix()
    at = np.column_stack([keys, np.zeros(len(keys))]) @ tilt.T + [0.0, 0.05, 0.8]
    return Crowd(images=pictures(np.vstack([lights_of(name, T), at]), rng), lights=name, T=T)


def text(rng: np.random.Generator) -> Crowd:
    """Return two pictures full of letters, bright on dark, and no target."""
    images = []
    lines = ["".join(chr(c) for c in rng.integers(97, 123, 60)) for _ in range(24)]
    for shift in (0, -90):
        picture = np.full((H, W), 20, np.uint8)
        for k, line in enumerate(lines):
            cv2.putText(picture, line, (60 + shift, 30 + 29 * k), cv2.FONT_HERSHEY_PLAIN, 1.6, 220, 2)
        images.append(cv2.GaussianBlur(picture, (0, 0), 0.8))
    return Crowd(images=(images[0], images[1]), lights="3 lights, scalene", T=None)


def noise(blur_px: float, lights: str = "3 lights, scalene") -> Callable[[np.random.Generator], Crowd]:
    """Return what draws two pictures of noise of their own, smoothed."""

    def crowd(rng: np.random.Generator) -> Crowd:
        images = []
        for _ in range(2):
            grey = rng.normal(0.0, 1.0, (H, W))
            grey = cv2.GaussianBlur(grey, (0, 0), blur_px) if blur_px else grey
            images.append(np.clip(110.0 + 45.0 * grey / grey.std(), 0, 255).astype(np.uint8))
        return Crowd(images=(images[0], images[1]), lights=lights, T=None)

    return crowd


KINDS: dict[str, Callable[[np.random.Generator], Crowd]] = {
    "3 lights among 87 lamps, 1.5-4 m": among("3 lights, scalene", 1.5, 4.0),
    "3 lights among 87 lamps as near": among("3 lights, scalene", 0.45, 0.9),
    "isosceles among 87 lamps, 1.5-4 m": among("3 lights, isosceles", 1.5, 4.0),
    "6 lights among 84 lamps as near": among("6 lights", 0.45, 0.9),
    "90 lamps, no target (3 lights asked)": among("3 lights, scalene", 0.45, 0.9, shown=False),
    "90 lamps, no target (6 lights asked)": among("6 lights", 0.45, 0.9, shown=False),
    "stadium at night": stadium,
    "keyboard that glows": keyboard,
    "text, no target": text,
    "noise of each pixel": noise(0.0),
    "noise, blurred by 2 px": noise(2.0),
    "noise, blurred by 5 px": noise(5.0),
    "noise, blurred by 12 px": noise(12.0),
    "noise, blurred by 30 px (3 lights, unmeasured)": noise(30.0, UNMEASURED),
}


def judged(crowd: Crowd, pace: Pace) -> tuple[float, str, str, bool]:
    """Return the processor's time in ms, status, why, and whether it misleads."""
    target = unmeasured_target() if crowd.lights == UNMEASURED else spot_target(TARGETS[crowd.lights])
    setup = Setup(RIG, target, pace=pace)
    left, right = (Frame(image=image, t_s=0.0, sequence=0, source="crowd") for image in crowd.images)
    begun = time.process_time()
    try:
        measured = measure_pair(setup, left, right)
    except ArmsightError as error:
        return (time.process_time() - begun) * 1e3, "raised", error.cause, False
    ms = (time.process_time() - begun) * 1e3
    pose = measured.pose
    if pose.status is not PoseStatus.OK or pose.T_parent_target is None:
        return ms, str(pose.status), pose.why, pose.status is not PoseStatus.LOST and crowd.T is None
    if crowd.T is None:
        return ms, str(pose.status), "", True
    d = pose_error(np.asarray(pose.T_parent_target), crowd.T)
    far = 1e3 * np.linalg.norm(d[:3]) > FAR_MM or np.rad2deg(np.linalg.norm(d[3:])) > FAR_DEG
    return ms, str(pose.status), "", bool(far)


def crowds(n: int, pace: Pace) -> None:
    """Print what becomes of n pairs of each kind."""
    blobs, rows = blob_detector(), []
    for name, draw_one in KINDS.items():
        verdicts, peer = [], []
        for seed in range(n):
            crowd = draw_one(np.random.default_rng(seed))
            verdicts.append(judged(crowd, pace))
            begun = time.process_time()
            for image in crowd.images:
                blobs(image)
            peer.append((time.process_time() - begun) * 1e3)
        ms = [v[0] for v in verdicts]
        why = Counter(reason(v[2]) for v in verdicts if v[2])
        states = Counter(v[1] for v in verdicts)
        given = [states[status] for status in ("ok", "position_only", "lost")]
        rows.append(
            [name, n, *given, sum(v[3] for v in verdicts), float(np.median(ms)), float(np.percentile(ms, 99)),
             max(ms), float(np.median(peer)), why.most_common(1)[0][0] if why else ""]
        )  # fmt: skip
    head = ["pictures", "pairs", "ok", "position only", "lost", "wrong", "ms a pair, median", "99 %", "longest"]
    table("Crowded pictures, no prior", [*head, "blobs alone: ms a pair", "commonest reason"], rows)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--batch", action="store_true")
    asked = parser.parse_args()
    print(machine())
    cv2.setNumThreads(1)
    warm_up()
    crowds(10 if asked.quick else 50, BATCH if asked.batch else live_pace())


if __name__ == "__main__":
    main()
