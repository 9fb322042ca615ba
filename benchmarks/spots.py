"""Spots: errors against their Cramer-Rao bounds, truth of the claimed covariances, and time, beside OpenCV.

The worlds are rendered here, with scipy's error function or by supersampling, not with the product's models. The
bounds come from the numerical Fisher information of the rendering with all its nuisance parameters; clipped pixels
carry none. `--quick` takes a tenth of the repeats.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter
from scipy.special import erf

from armsight.measure.spots import SpotSettings, find_spots, track_spots, warm_up
from bench import interleaved_ms, machine, table

Array = NDArray[np.float64]
BACKGROUND, NOISE = 20.0, 2.0
VARIANCE = NOISE**2 + 1.0 / 12.0
HEIGHT, WIDTH = 320, 480
MARGIN, SPACING = 48, 96


def axis(centre: float, sigma: float, n: int) -> Array:
    """Return a Gaussian of unit height integrated over pixels 0..n-1."""
    edges = (np.arange(n + 1) - 0.5 - centre) / (sigma * np.sqrt(2.0))
    return np.asarray(np.sqrt(np.pi / 2.0) * sigma * np.diff(erf(edges)))


def gaussians(p: Sequence[float], n: int) -> Array:
    """Return n x n pixels of p = sigma, then u, v, height of each light."""
    image = np.zeros((n, n))
    for u, v, a in zip(p[1::3], p[2::3], p[3::3], strict=True):
        image += a * np.outer(axis(v, p[0], n), axis(u, p[0], n))
    return image


def streak(p: Sequence[float], n: int) -> Array:
    """Return n x n pixels of a light p = u, v, height at rest, sigma, length, angle, moving during the exposure."""
    u, v, a, sigma, length, angle = p
    nodes, weights = np.polynomial.legendre.leggauss(48)
    image = np.zeros((n, n))
    for t, w in zip(0.5 * length * nodes, 0.5 * weights, strict=True):
        image += w * a * np.outer(axis(v + t * np.sin(angle), sigma, n), axis(u + t * np.cos(angle), sigma, n))
    return image


def disc(p: Sequence[float], n: int, fine: int = 8) -> Array:
    """Return n x n pixels of a flat disc p = u, v, height, radius, blur, supersampled and blurred."""
    u, v, a, radius, blur = p
    at = (np.arange(n * fine) + 0.5) / fine - 0.5
    away = np.hypot(at[None, :] - u, at[:, None] - v)
    sharp = np.clip((radius - away) * fine + 0.5, 0.0, 1.0)
    smooth = gaussian_filter(sharp, blur * fine, truncate=5.0)
    return np.asarray(a * smooth.reshape(n, fine, n, fine).mean(axis=(1, 3)))


def bound(render: Callable[[Sequence[float], int], Array], p: Sequence[float], n: int, where: Sequence[int]) -> Array:
    """Return the Cramer-Rao standard deviations of parameters `where`, all others and the background being unknown."""
    q = np.asarray(p, float)
    columns = [np.ones(n * n)]
    for i in range(len(q)):
        h = np.zeros(len(q))
        h[i] = 1e-3 * max(1.0, abs(q[i]) / 10.0) if render is not disc else 2e-2
        columns.append(((render(q + h, n) - render(q - h, n)) / (2.0 * h[i])).ravel())
    J = np.stack(columns, axis=1)
    J = J[(BACKGROUND + render(q, n) < 254.5).ravel()]
    scale = np.sqrt(np.einsum("ij,ij->j", J, J))
    covariance = np.linalg.inv((J / scale).T @ (J / scale)) / np.outer(scale, scale) * VARIANCE
    return np.sqrt(np.diag(covariance)[np.asarray(where) + 1])


def frame_of(tiles: Sequence[Array], rng: np.random.Generator) -> NDArray[np.uint8]:
    """Return a noisy, clipped, rounded frame with the tiles side by side."""
    n = tiles[0].shape[0]
    across = 4
    rows = -(-len(tiles) // across)
    image = np.full((rows * n + 2, across * n + 2), BACKGROUND)
    for k, tile in enumerate(tiles):
        y, x = divmod(k, across)
        image[1 + y * n : 1 + (y + 1) * n, 1 + x * n : 1 + (x + 1) * n] += tile
    return np.clip(np.rint(image + rng.normal(0.0, NOISE, image.shape)), 0, 255).astype(np.uint8)


class Score:
    """Gathers errors over their bounds and over the claimed covariances."""

    def __init__(self) -> None:
        self.over_bound: list[Array] = []
        self.chi2: list[float] = []
        self.missed = 0
        self.models: dict[str, int] = {}

    def add(self, error: Array, sigma: Array, covariance: Array, model: str) -> None:
        """Add one spot's error (2,)."""
        self.over_bound.append((error / sigma) ** 2)
        self.chi2.append(float(error @ np.linalg.solve(covariance, error)) / 2.0)
        self.models[model] = self.models.get(model, 0) + 1

    def row(self, name: str, target: str) -> list[object]:
        """Return the table's row."""
        ratio = np.sqrt(np.mean(self.over_bound)) if self.over_bound else np.nan
        half = ratio / np.sqrt(4.0 * max(len(self.over_bound), 1))
        models = ", ".join(f"{k} {v}" for k, v in sorted(self.models.items()))
        chi2 = np.mean(self.chi2) if self.chi2 else np.nan
        return [name, f"{ratio:.3f} ± {half:.3f}", target, f"{chi2:.3f}", len(self.over_bound), self.missed, models]


def run(
    name: str,
    target: str,
    draw: Callable[[np.random.Generator], Sequence[float]],
    render: Callable[[Sequence[float], int], Array],
    centres: Sequence[tuple[int, int]],
    size: int,
    repeats: int,
    settings: SpotSettings | None = None,
) -> list[object]:
    """Return the score of lights drawn at random in tiles of `size`; parameters u, v are relative to the tile."""
    rng = np.random.default_rng(7)
    score = Score()
    settings = settings or SpotSettings()
    for _ in range(max(repeats // 12, 1)):
        drawn = [draw(rng) for _ in range(12)]
        image = frame_of([render(p, size) for p in drawn], rng)
        spots = find_spots(image, settings)
        for k, p in enumerate(drawn):
            corner = np.array([1 + (k % 4) * size, 1 + (k // 4) * size], float)
            true = np.array([[p[a], p[b]] for a, b in centres]) + corner
            inside = np.all(np.abs(spots.uv_px - corner - size / 2.0) < size / 2.0, axis=1).nonzero()[0]
            if len(inside) != len(true):
                score.missed += len(true)
                continue
            sigma = bound(render, p, size, [i for pair in centres for i in pair]).reshape(-1, 2)
            away = np.linalg.norm(spots.uv_px[inside][None] - true[:, None], axis=2)
            order = inside[away.argmin(axis=1)]
            if len(set(order.tolist())) != len(true):
                score.missed += len(true)
                continue
            for t, s, i in zip(true, sigma, order, strict=True):
                score.add(spots.uv_px[i] - t, s, spots.covariance_px2[i], spots.model[i])
    return score.row(name, target)


def centre(rng: np.random.Generator, size: int) -> tuple[float, float]:
    """Return a centre at random within the tile's middle pixel."""
    return size / 2.0 + rng.uniform(-0.5, 0.5), size / 2.0 + rng.uniform(-0.5, 0.5)


def accuracy(repeats: int) -> None:
    """Print errors over bounds for each kind of light."""

    def still(low: float, high: float) -> Callable[[np.random.Generator], Sequence[float]]:
        def draw(rng: np.random.Generator) -> Sequence[float]:
            return [rng.uniform(1.5, 4.0), *centre(rng, 64), np.exp(rng.uniform(np.log(low), np.log(high)))]

        return draw

    def flat(rng: np.random.Generator) -> Sequence[float]:
        return [*centre(rng, 48), rng.uniform(60.0, 200.0), rng.uniform(2.0, 15.0), rng.uniform(0.6, 1.5)]

    def pair(apart: float) -> Callable[[np.random.Generator], Sequence[float]]:
        def draw(rng: np.random.Generator) -> Sequence[float]:
            sigma, angle = rng.uniform(1.5, 4.0), rng.uniform(0.0, np.pi)
            u, v = centre(rng, 64)
            du, dv = 0.5 * apart * sigma * np.cos(angle), 0.5 * apart * sigma * np.sin(angle)
            heights = rng.uniform(60.0, 200.0, 2)
            return [sigma, u - du, v - dv, heights[0], u + du, v + dv, heights[1]]

        return draw

    def moving(rng: np.random.Generator) -> Sequence[float]:
        height, sigma = rng.uniform(100.0, 200.0), rng.uniform(1.5, 3.0)
        return [*centre(rng, 64), height, sigma, rng.uniform(4.0, 16.0), rng.uniform(0.0, np.pi)]

    rows = [
        run("round, sigma 1.5-4 px, height 60-200", "1.05", still(60, 200), gaussians, [(1, 2)], 64, repeats),
        run("the same, clipped up to 8 x", "1.2", still(255, 2040), gaussians, [(1, 2)], 64, repeats),
        run("flat discs, radius 2-15 px", "1.1", flat, disc, [(0, 1)], 48, repeats // 2),
        run("touching, 1.5 sigma apart", "1.1", pair(1.5), gaussians, [(1, 2), (4, 5)], 64, repeats // 2),
        run("touching, 2 sigma apart", "1.1", pair(2.0), gaussians, [(1, 2), (4, 5)], 64, repeats // 2),
        run("touching, 3 sigma apart", "1.1", pair(3.0), gaussians, [(1, 2), (4, 5)], 64, repeats // 2),
        run("motion blur 4-16 px", "1.25", moving, streak, [(0, 1)], 64, repeats // 2),
    ]
    table(
        "RMS error over the Cramer-Rao bound, and chi-square per coordinate of the claimed covariances (0.9-1.1)",
        ["lights", "RMS / bound", "target", "chi-square", "spots", "missed or refused", "measured as"],
        rows,
    )


def scene(rng: np.random.Generator, hot: int = 50) -> tuple[NDArray[np.uint8], Array]:
    """Return a 1280 x 720 frame of six lights and `hot` hot pixels, and the true centres (6, 2)."""
    image = np.full((720, 1280), BACKGROUND)
    true = []
    for k in range(6):
        u, v = 160.0 + 190.0 * k + rng.uniform(-40, 40), rng.uniform(60.0, 660.0)
        x, y = int(u) - 32, int(v) - 32
        p = [rng.uniform(1.5, 4.0), u - x, v - y, rng.uniform(60.0, 200.0)]
        image[y : y + 64, x : x + 64] += gaussians(p, 64)
        true.append((u, v))
    frame = np.clip(np.rint(image + rng.normal(0.0, NOISE, image.shape)), 0, 255).astype(np.uint8)
    at = rng.integers([0, 0], [1280, 720], (hot, 2))
    far = np.linalg.norm(at[:, None] - np.array(true)[None], axis=2).min(axis=1) > 30.0
    frame[at[far, 1], at[far, 0]] = rng.integers(60, 256, int(far.sum()))
    return frame, np.array(true)


def speed(repeats: int) -> None:
    """Print the time of a full search, of tracking, of reading the frame once, and of OpenCV's blob detector."""
    rng = np.random.default_rng(3)
    scenes = [scene(rng) for _ in range(48)]
    frames = [frame for frame, _ in scenes]
    turn = dict.fromkeys(["read", "find", "track", "blob"], 0)

    def next_frame(name: str) -> int:
        turn[name] = (turn[name] + 1) % len(frames)  # 44 MB in turn: more than the cache holds
        return turn[name]

    parameters = cv2.SimpleBlobDetector_Params()  # its usual thresholds: 50, 60, .. 220
    parameters.blobColor = 255
    parameters.filterByArea, parameters.minArea, parameters.maxArea = True, 4.0, 2000.0
    parameters.filterByCircularity = parameters.filterByConvexity = parameters.filterByInertia = False
    blob = cv2.SimpleBlobDetector_create(parameters)
    times = interleaved_ms(
        {
            "np.max (reading the frame once)": lambda: frames[next_frame("read")].max(),
            "find_spots": lambda: find_spots(frames[next_frame("find")]),
            "track_spots, windows of 41 px": lambda: track_spots(*scenes[next_frame("track")], 20.0),
            "cv2.SimpleBlobDetector": lambda: blob.detect(frames[next_frame("blob")]),
        },
        repeats,
    )
    errors: dict[str, list[float]] = {"find_spots": [], "cv2.SimpleBlobDetector": []}
    for frame, true in scenes:
        found = {"find_spots": find_spots(frame).uv_px, "cv2.SimpleBlobDetector": points(blob.detect(frame))}
        for name, uv in found.items():
            for t in true:
                away = np.linalg.norm(uv - t, axis=1)
                if away.size and away.min() < 2.0:
                    errors[name].append(float(away.min()))
    read = float(np.median(times["np.max (reading the frame once)"]))
    rows = []
    for name, t in times.items():
        rms = np.sqrt(np.mean(np.square(errors[name])) / 2.0) if name in errors else np.nan
        found_share = f"{len(errors[name])}/{6 * len(scenes)}" if name in errors else ""
        median = float(np.median(t))
        rows.append([name, median, float(np.percentile(t, 99)), median / read, f"{rms:.4f}", found_share])
    table(
        "Six lights and 50 hot pixels in 1280 x 720, cold cache (targets: 3 x reading, OpenCV 20 x slower)",
        ["call", "median ms", "p99 ms", "x reading", "RMS px per axis", "found"],
        rows,
    )


def points(keypoints: Sequence[cv2.KeyPoint]) -> Array:
    """Return the centres (n, 2) of OpenCV's key points."""
    return np.array([k.pt for k in keypoints], float).reshape(-1, 2)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true")
    quick = parser.parse_args().quick
    warm_up()
    print(f"\n{machine()}")
    accuracy(120 if quick else 1800)
    speed(50 if quick else 500)


if __name__ == "__main__":
    main()
