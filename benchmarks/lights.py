"""Flat lights seen by a lens: pixels, outlines and what falls on the sensor, with optics of their own.

Pinhole and Brown-Conrady written here, ray by ray, from the definitions: truth that shares no code with what it judges.
The centre of the top-left pixel is (0, 0).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

FINE = 8
"""Samples per pixel and axis."""

REACH = 5.0
"""Sigmas of the lens's core that are drawn."""

ROUNDS = 14
"""Steps of the inverse distortion; each shrinks its error tenfold at the distortions drawn here."""


@dataclass(frozen=True, eq=False)
class Lens:
    """A camera: size, fx, fy, cx, cy in px, k = k1, k2, p1, p2, k3, and p_camera = R p_rig + t."""

    width: int
    height: int
    f: tuple[float, float]
    c: tuple[float, float]
    k: tuple[float, float, float, float, float]
    R: Array
    t: Array

    def project(self, points: Array) -> Array:
        """Return the pixels (n, 2) of points (n, 3) in rig axes."""
        p = points @ self.R.T + self.t
        return self._bent(p[:, :2] / p[:, 2:]) * self.f + self.c

    def depth(self, points: Array) -> Array:
        """Return the distance (n,) of points (n, 3) along the optical axis."""
        return np.asarray((points @ self.R.T + self.t)[:, 2])

    def rays(self, uv: Array) -> Array:
        """Return the directions (n, 3) in rig axes in which pixels (n, 2) look."""
        bent = (uv - self.c) / self.f
        x = bent.copy()
        for _ in range(ROUNDS):
            x += bent - self._bent(x)
        return np.asarray(np.column_stack([x, np.ones(len(x))]) @ self.R)

    @property
    def eye(self) -> Array:
        """The centre of projection in rig axes."""
        return np.asarray(-self.R.T @ self.t)

    def _bent(self, x: Array) -> Array:
        k1, k2, p1, p2, k3 = self.k
        a, b = x[:, 0], x[:, 1]
        rr = a * a + b * b
        radial = 1.0 + rr * (k1 + rr * (k2 + rr * k3))
        return np.column_stack(
            [
                a * radial + 2.0 * p1 * a * b + p2 * (rr + 2.0 * a * a),
                b * radial + p1 * (rr + 2.0 * b * b) + 2.0 * p2 * a * b,
            ]
        )


@dataclass(frozen=True, eq=False)
class Disc:
    """A flat round light in rig axes: centre, unit normal, radius (0: a point)."""

    centre: Array
    normal: Array
    radius_m: float

    def outline(self, n: int = 720) -> Array:
        """Return n points (n, 3) of its rim."""
        e1 = np.cross(self.normal, [1.0, 0.3, 0.2])
        e1 /= np.linalg.norm(e1)
        e2, a = np.cross(self.normal, e1), np.linspace(0.0, 2.0 * np.pi, n, endpoint=False)
        return self.centre + self.radius_m * (np.outer(np.cos(a), e1) + np.outer(np.sin(a), e2))


@dataclass(frozen=True, eq=False)
class Patch:
    """A light's image in a crop that starts at (x0, y0): covered, the share of each pixel that the blurred disc
    hides; shine, what falls on each pixel where the light's peak is 1, halo included."""

    x0: int
    y0: int
    covered: Array
    shine: Array


def image_of(lens: Lens, disc: Disc) -> tuple[Array, Array, float]:
    """Return the pixel of the disc's centre, that of its image's centre of area, and the image's mean radius."""
    centre = lens.project(disc.centre[None])[0]
    if disc.radius_m == 0.0:
        return centre, centre, 0.0
    uv = lens.project(disc.outline()) - centre
    x, y, x1, y1 = *uv.T, *np.roll(uv, -1, axis=0).T
    cross = x * y1 - x1 * y
    area = 0.5 * cross.sum()
    middle = np.array([((x + x1) * cross).sum(), ((y + y1) * cross).sum()]) / (6.0 * area)
    return centre, centre + middle, float(np.sqrt(abs(area) / np.pi))


def shine(lens: Lens, disc: Disc, psf: Mapping[str, float], motion_px: Array) -> Patch:
    """Return what the disc adds to the picture through a lens that blurs and a shutter during which it moves.

    psf: sigma_px of the core, halo (share of the light) and halo_sigma_px. motion_px (2,): way during the exposure,
    the disc's own place in its middle.
    """
    _, middle, radius = image_of(lens, disc)
    sigma, halo = psf["sigma_px"], psf["halo"]
    reach = int(np.ceil(radius * 1.2 + REACH * sigma + np.abs(motion_px).max() / 2.0)) + 2
    if halo > 0.0:
        reach = max(reach, int(3.5 * psf["halo_sigma_px"]) + 2)
    x0, y0 = (np.rint(middle) - reach).astype(int)
    n = 2 * reach + 1
    core = _core(lens, disc, middle - (x0, y0), (x0, y0), n, radius, sigma, motion_px)
    spread = sigma**2 + 1.0 / 12.0
    peak = 1.0 - np.exp(-(radius**2) / (2.0 * spread)) if radius else 1.0 / (2.0 * np.pi * spread)
    glow = halo * core.sum() * _round(middle - (x0, y0), n, np.hypot(psf["halo_sigma_px"], 0.5 * radius))
    covered = core if radius else np.zeros_like(core)
    return Patch(x0=int(x0), y0=int(y0), covered=np.clip(covered, 0.0, 1.0), shine=((1.0 - halo) * core + glow) / peak)


def _core(
    lens: Lens, disc: Disc, at: Array, corner: tuple[int, int], n: int, radius: float, sigma: float, motion: Array
) -> Array:
    """Return the disc's blurred cover, or a point's blur of unit sum, on n x n pixels; `at` is its place in them."""
    half = int(np.ceil(radius * 1.2 + REACH * sigma + np.abs(motion).max() / 2.0)) + 2
    first = np.rint(at).astype(int) - half
    m = 2 * half + 1
    fine = np.zeros((m * FINE, m * FINE), np.float32)
    if radius:
        inner = int(np.ceil(radius * 1.2)) + 1
        k = 2 * inner + 1
        start = (half - inner) * FINE
        block = cover(lens, disc, np.array(corner) + first + half - inner, k)
        fine[start : start + k * FINE, start : start + k * FINE] = block
        fine = cv2.GaussianBlur(fine, (2 * int(REACH * sigma * FINE) + 1,) * 2, sigma * FINE)
    else:
        fine = (_samples(at - first, m, sigma) * FINE**2).astype(np.float32)
    if motion.any():
        fine = cv2.filter2D(fine, -1, _way(motion * FINE), borderType=cv2.BORDER_CONSTANT)
    out = np.zeros((n, n))
    binned = fine.reshape(m, FINE, m, FINE).mean(axis=(1, 3), dtype=float)
    out[first[1] : first[1] + m, first[0] : first[0] + m] = binned
    return out


def cover(lens: Lens, disc: Disc, corner: NDArray[np.int_], n: int) -> NDArray[np.float32]:
    """Return which of FINE x FINE samples in n x n pixels look at the disc; a sample on the rim counts in part."""
    at = (np.arange(n * FINE) + 0.5) / FINE - 0.5
    u, v = np.meshgrid(at + corner[0], at + corner[1])
    rays = lens.rays(np.column_stack([u.ravel(), v.ravel()]))
    s = ((disc.centre - lens.eye) @ disc.normal) / (rays @ disc.normal)
    away = lens.eye + s[:, None] * rays - disc.centre
    inside = (disc.radius_m - np.sqrt((away**2).sum(axis=1))).reshape(u.shape)
    dy, dx = np.gradient(inside)
    return np.clip(0.5 + inside / np.maximum(np.hypot(dx, dy), 1e-12), 0.0, 1.0).astype(np.float32)


def _samples(at: Array, n: int, sigma: float) -> Array:
    """Return a Gaussian of unit sum on the FINE samples of n x n pixels."""
    x = (np.arange(n * FINE) + 0.5) / FINE - 0.5
    g = [np.exp(-0.5 * ((x - centre) / sigma) ** 2) / (sigma * np.sqrt(2.0 * np.pi) * FINE) for centre in at]
    return np.outer(g[1], g[0])


def _round(at: Array, n: int, sigma: float) -> Array:
    """Return a wide Gaussian of unit sum on n x n pixels."""
    x = np.arange(n)
    g = [np.exp(-0.5 * ((x - centre) / sigma) ** 2) / (sigma * np.sqrt(2.0 * np.pi)) for centre in at]
    return np.outer(g[1], g[0])


def _way(motion: Array) -> Array:
    """Return the kernel (odd, odd) of a straight way of that many samples, its middle in the kernel's."""
    half = int(np.ceil(np.abs(motion).max() / 2.0)) + 1
    kernel = np.zeros((2 * half + 1, 2 * half + 1))
    for s in np.linspace(-0.5, 0.5, 65):
        x, y = s * motion + half
        i, j = int(x), int(y)
        a, b = x - i, y - j
        kernel[j : j + 2, i : i + 2] += np.outer([1.0 - b, b], [1.0 - a, a])
    return kernel / kernel.sum()
