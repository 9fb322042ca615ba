"""Errors of spots' centres against their Cramer-Rao bounds, and the claimed covariances against the errors.

The lights are rendered here, with scipy's error function or by supersampling. A ratio of RMS error over bound, from n
coordinates, scatters by 1 / sqrt(2 n): limits are the wanted ratio plus three times that. Chi-square per coordinate
scatters by sqrt(2 / n).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter
from scipy.special import erf

from armsight.measure.spots import find_spots

Array = NDArray[np.float64]
Render = Callable[[Sequence[float]], Array]
Draw = Callable[[np.random.Generator], Sequence[float]]

SIZE, TILES, ACROSS = 64, 12, 4
NODES, WEIGHTS = np.polynomial.legendre.leggauss(40)
BACKGROUND, NOISE = 20.0, 2.0
VARIANCE = NOISE**2 + 1.0 / 12.0
"""Read noise, and the rounding to whole grey levels."""


def profile(centre: Array | float, sigma: float) -> Array:
    """Gaussians of unit height at centres (...), integrated over the tile's pixels (..., SIZE)."""
    edges = (np.arange(SIZE + 1) - 0.5 - np.asarray(centre)[..., None]) / (sigma * np.sqrt(2.0))
    return np.asarray(np.sqrt(np.pi / 2.0) * sigma * np.diff(erf(edges)))


def lights(p: Sequence[float]) -> Array:
    """p = u, v of each light, then sigma, then heights."""
    n = (len(p) - 1) // 3
    uv, sigma, heights = np.reshape(p[: 2 * n], (n, 2)), p[2 * n], p[2 * n + 1 :]
    return np.asarray(
        sum(a * np.outer(profile(v, sigma), profile(u, sigma)) for (u, v), a in zip(uv, heights, strict=True))
    )


def streak(p: Sequence[float]) -> Array:
    """p = u, v, height, sigma, length, angle of a light that moves during the exposure."""
    u, v, a, sigma, length, angle = p
    s = 0.5 * length * NODES
    across, down = profile(u + s * np.cos(angle), sigma), profile(v + s * np.sin(angle), sigma)
    return np.asarray((0.5 * a * WEIGHTS * down.T) @ across)


def disc(p: Sequence[float], fine: int = 4) -> Array:
    """p = u, v, height, radius, blur of a flat disc."""
    u, v, a, radius, blur = p
    at = (np.arange(SIZE * fine) + 0.5) / fine - 0.5
    sharp = np.clip((radius - np.hypot(at[None] - u, at[:, None] - v)) * fine + 0.5, 0.0, 1.0)
    smooth = gaussian_filter(sharp, blur * fine, truncate=5.0)
    return np.asarray(a * smooth.reshape(SIZE, fine, SIZE, fine).mean(axis=(1, 3)))


def bound(render: Render, p: Sequence[float], n_lights: int) -> Array:
    """Standard deviations (n_lights, 2) of the centres, all else and the background unknown; clipped pixels tell
    nothing."""
    q, columns = np.asarray(p, float), [np.ones(SIZE * SIZE)]
    for i in range(len(q)):
        h = np.zeros(len(q))
        h[i] = 2e-2 if render is disc else 1e-3 * max(1.0, abs(q[i]) / 10.0)
        columns.append(((render(q + h) - render(q - h)) / (2.0 * h[i])).ravel())
    J = np.stack(columns, axis=1)[(BACKGROUND + render(q) < 254.5).ravel()]
    scale = np.linalg.norm(J, axis=0)
    covariance = np.linalg.inv((J / scale).T @ (J / scale)) / np.outer(scale, scale) * VARIANCE
    return np.asarray(np.sqrt(np.diag(covariance)[1 : 1 + 2 * n_lights]).reshape(-1, 2))


def middle(rng: np.random.Generator) -> tuple[float, float]:
    u, v = SIZE / 2.0 + rng.uniform(-0.5, 0.5, 2)
    return float(u), float(v)


def plain(rng: np.random.Generator) -> Sequence[float]:
    return [*middle(rng), rng.uniform(1.5, 4.0), rng.uniform(60.0, 200.0)]


def clipped(rng: np.random.Generator) -> Sequence[float]:
    return [*middle(rng), rng.uniform(1.5, 4.0), 255.0 * 8.0 ** rng.uniform()]


def flat(rng: np.random.Generator) -> Sequence[float]:
    return [*middle(rng), rng.uniform(60.0, 200.0), rng.uniform(2.0, 15.0), rng.uniform(0.6, 1.5)]


def moving(rng: np.random.Generator) -> Sequence[float]:
    return [
        *middle(rng),
        rng.uniform(100.0, 200.0),
        rng.uniform(1.5, 3.0),
        rng.uniform(1.0, 16.0),
        np.pi * rng.uniform(),
    ]


def touching(apart: float) -> Draw:
    def draw(rng: np.random.Generator) -> Sequence[float]:
        sigma, angle, (u, v) = rng.uniform(1.5, 4.0), rng.uniform(0.0, np.pi), middle(rng)
        du, dv = 0.5 * apart * sigma * np.cos(angle), 0.5 * apart * sigma * np.sin(angle)
        return [u - du, v - dv, u + du, v + dv, sigma, *rng.uniform(60.0, 200.0, 2)]

    return draw


def frame_of(tiles: list[Array], rng: np.random.Generator, noise: float = NOISE) -> NDArray[np.uint8]:
    rows = [np.hstack(tiles[k : k + ACROSS]) for k in range(0, TILES, ACROSS)]
    image = np.pad(np.vstack(rows), 1) + BACKGROUND
    return np.clip(np.rint(image + rng.normal(0.0, noise, image.shape)), 0, 255).astype(np.uint8)


@pytest.mark.parametrize(
    ("draw", "render", "n_lights", "frames", "ratio", "refused"),
    [
        pytest.param(plain, lights, 1, 12, 1.05, 0.0, id="round"),
        pytest.param(clipped, lights, 1, 12, 1.2, 0.0, id="saturated up to 8 times"),
        pytest.param(flat, disc, 1, 2, 1.1, 0.05, id="flat discs"),
        pytest.param(touching(1.5), lights, 2, 6, 1.1, 0.1, id="touching, 1.5 sigma apart"),
        pytest.param(touching(3.0), lights, 2, 6, 1.1, 0.1, id="touching, 3 sigma apart"),
        pytest.param(moving, streak, 1, 8, 1.25, 0.05, id="moving up to 16 px"),
    ],
)
def test_errors_meet_the_bound_and_covariances_are_true(
    draw: Draw, render: Render, n_lights: int, frames: int, ratio: float, refused: float
) -> None:
    rng = np.random.default_rng(11)
    squares, chi2, missed = [], [], 0
    for _ in range(frames):
        drawn = [draw(rng) for _ in range(TILES)]
        spots = find_spots(frame_of([render(p) for p in drawn], rng))
        for k, p in enumerate(drawn):
            corner = np.array([1.0 + k % ACROSS * SIZE, 1.0 + k // ACROSS * SIZE])
            true = np.reshape(p[: 2 * n_lights], (-1, 2)) + corner
            here = np.flatnonzero(np.all(np.abs(spots.uv_px - corner - SIZE / 2) < SIZE / 2, axis=1))
            away = np.linalg.norm(spots.uv_px[here][:, None] - true[None], axis=2)
            if len(here) != n_lights or sorted(away.argmin(axis=0).tolist()) != list(range(n_lights)):
                missed += 1
                continue
            order = here[away.argmin(axis=0)]
            error = spots.uv_px[order] - true
            squares.append((error / bound(render, p, n_lights)) ** 2)
            chi2 += [float(e @ np.linalg.solve(C, e)) for e, C in zip(error, spots.covariance_px2[order], strict=True)]
    n = 2 * len(chi2)
    assert missed <= refused * frames * TILES
    assert np.sqrt(np.mean(squares)) < ratio + 3.0 * ratio / np.sqrt(2.0 * n)
    assert np.sum(chi2) / n == pytest.approx(1.0, abs=0.1 + 3.0 * np.sqrt(2.0 / n))


def chi2_of(drawn: list[Sequence[float]], image: Array) -> list[float]:
    """Squared errors over claimed variances of one light in each tile."""
    spots, out = find_spots(np.clip(np.rint(image), 0, 255).astype(np.uint8)), []
    for k, p in enumerate(drawn):
        away = spots.uv_px - p[:2] - [1.0 + k % ACROSS * SIZE, 1.0 + k // ACROSS * SIZE]
        nearest = int(np.linalg.norm(away, axis=1).argmin())
        out.append(float(away[nearest] @ np.linalg.solve(spots.covariance_px2[nearest], away[nearest])))
    return out


def smoothed(clean: Array, rng: np.random.Generator) -> Array:
    noise = gaussian_filter(rng.normal(0.0, 1.0, clean.shape), 1.0)
    return NOISE / noise.std() * noise


def shot(clean: Array, rng: np.random.Generator) -> Array:
    return rng.normal(0.0, 1.0, clean.shape) * np.sqrt(1.0 + (clean - BACKGROUND))


@pytest.mark.parametrize("noise", [smoothed, shot])
def test_covariances_are_true_in_noise_that_is_not_alike_and_free_in_all_pixels(
    noise: Callable[[Array, np.random.Generator], Array],
) -> None:
    """As of a camera that smooths its images, or of few electrons: that of equal, independent pixels would claim a
    third of the variance or less."""
    rng, chi2 = np.random.default_rng(17), []
    for _ in range(8):
        drawn = [plain(rng) for _ in range(TILES)]
        clean = frame_of([lights(p) for p in drawn], rng, noise=0.0).astype(float)
        chi2 += chi2_of(drawn, clean + noise(clean, rng))
    n = 2 * len(chi2)
    assert np.sum(chi2) / n == pytest.approx(1.0, abs=0.1 + 3.0 * np.sqrt(2.0 / n))


def test_two_touching_lights_in_the_dark_are_not_taken_for_one_that_moved() -> None:
    """Two standard deviations apart they look like a streak: the model of two must be tried before the streak is
    believed."""
    rng = np.random.default_rng(31)
    streaks = 0
    for _ in range(30):
        sigma, angle = rng.uniform(2.0, 3.0), rng.uniform(0.0, np.pi)
        du, dv = sigma * np.cos(angle), sigma * np.sin(angle)
        image = np.full((4 * SIZE, 4 * SIZE), BACKGROUND)
        pair = [32.3 - du, 31.8 - dv, 32.3 + du, 31.8 + dv, sigma, 150.0, 110.0]
        image[96 : 96 + SIZE, 96 : 96 + SIZE] += lights(pair)
        seen = find_spots(np.clip(np.rint(image + rng.normal(0.0, NOISE, image.shape)), 0, 255).astype(np.uint8))
        streaks += seen.model != ("joint", "joint")
    assert streaks <= 1
