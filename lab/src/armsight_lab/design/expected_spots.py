"""How well a light's centre can be placed: the Cramer-Rao bound of its image, for a camera whose noise is known."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import gaussian_filter

from armsight.arrays import Array
from armsight.records import NoiseModel

LEVEL = 180.0
"""Grey levels of a wide light above its surroundings: bright, and not clipped."""
GROUND = 10.0
"""Grey level of what is round it."""
BLUR_PX = 0.8
"""Gaussian sigma of lens and pixel together."""
FINE = 4
"""Samples per pixel and axis of the light's image."""
ABOVE_BOUND = 1.13
"""Deviation over the bound of centres that find_spots gives: 1.08 of lights 3 px across to 1.18 of 20 px (rendered
pictures, benchmarks/design.py): their width, height and ground are fitted with them."""
SIZES_PX = np.geomspace(1.0, 64.0, 13)
"""Widths at which the bound is worked out; between them it is a power of the width."""


def centre_deviation(noise: NoiseModel, size_px: Array) -> Array:
    """Return the standard deviation in px of one coordinate of the centres of round lights so many px across.

    A light of LEVEL on GROUND is blurred by BLUR_PX; var(u) = 1 / sum over the pixels of (d level / d u)^2 / variance
    (level), widened by what neighbours share of their noise. A light of unknown size (0) is taken to be 4 px across.
    """
    known = [_bound(noise, float(size)) for size in SIZES_PX]
    size = np.where(size_px > 0.0, size_px, 4.0)
    return np.asarray(ABOVE_BOUND * np.exp(np.interp(np.log(size), np.log(SIZES_PX), np.log(known))))


def _bound(noise: NoiseModel, size_px: float) -> float:
    half = int(np.ceil(0.5 * size_px + 5.0 * BLUR_PX)) + 1
    at = (np.arange(FINE * (2 * half + 1)) + 0.5) / FINE - half - 0.5  # px from the centre
    inside = at[:, None] ** 2 + at[None] ** 2 <= (0.5 * size_px) ** 2
    share = 0.25 * np.pi * size_px**2 / max(inside.sum() / FINE**2, 1e-9)  # of the true area, over the samples'
    light = gaussian_filter(LEVEL * share * inside.astype(float), FINE * BLUR_PX)
    middle = slice(FINE // 2, None, FINE)
    slope = np.gradient(light, 1.0 / FINE, axis=1)[middle, middle]
    variance = noise.variance_at(GROUND + light[middle, middle])
    information = float((slope**2 / variance).sum())
    wide = float(noise.widening(float(np.hypot(BLUR_PX, 0.25 * size_px))).max())
    return float(np.sqrt(max(wide, 1e-6) / information))
