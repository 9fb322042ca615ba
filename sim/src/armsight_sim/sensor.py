"""From light to grey levels: shot noise, read noise, rounding, saturation; and what is there without any target."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from armsight.errors import Inconsistent
from armsight_sim.kernels import develop, develop_raw
from armsight_sim.render import LightImage, Patch

TABLE_SIZE = 4096
"""Entries of the table of normal quantiles; 16 kB stay in the first-level cache. A sum of two entries has unit
variance, kurtosis 2.9987 and reaches 5.2 sigma (compared with a true normal in the tests)."""


def _half_normal_table() -> LightImage:
    """Return the means of TABLE_SIZE equally likely slices of a Gaussian of variance 1/2, (TABLE_SIZE,) float32."""
    edges = ndtri(np.arange(1, TABLE_SIZE) / TABLE_SIZE)
    density = np.concatenate([[0.0], np.exp(-0.5 * edges**2) / math.sqrt(2.0 * math.pi), [0.0]])
    means = density[:-1] - density[1:]
    table: LightImage = (means / (means.std() * math.sqrt(2.0))).astype(np.float32)
    table.setflags(write=False)
    return table


_TABLE = _half_normal_table()

RAW_STEPS = 16
"""Steps of the raw signal to a grey level: the twelve bits of a camera's converter over eight of its picture."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Sensor:
    """What a camera makes of light.

    electrons_per_level: gain; infinite means no shot noise. read_noise_level: standard deviation in grey
    levels. saturation: the level at which pixels clip.
    """

    electrons_per_level: float = 24.0
    read_noise_level: float = 1.5
    saturation: int = 255

    def __post_init__(self) -> None:
        if not (self.electrons_per_level > 0.0 and self.read_noise_level >= 0.0 and 0 < self.saturation <= 255):
            raise Inconsistent(f"a sensor with {self} cannot be")

    def develop(self, light: LightImage, rng: np.random.Generator, patch: Patch | None = None) -> NDArray[np.uint8]:
        """Return the 8-bit image (h, w) or (h, w, 3) of light (h, w, 1 or 3) >= 0 in grey levels, patch over it.

        Every pixel's noise is drawn afresh, by compiled xoshiro256++ generators seeded from rng, one for two
        columns. Mean, variance and
        third moment are those of Poisson electrons plus Gaussian read noise; the shape is right where a
        pixel holds more than about ten electrons or the read noise is above the shot noise.
        """
        height, width, channels = light.shape
        over = patch or Patch(row=0, column=0, light=np.empty((0, 0, channels), np.float32))
        image = np.empty(light.shape, np.uint8)
        develop(
            light.reshape(height, -1),
            (over.light.reshape(over.light.shape[0], over.light.shape[1] * channels), over.row, over.column * channels),
            (1.0 / self.electrons_per_level, self.read_noise_level, self.saturation),
            _TABLE,
            rng.integers(0, 2**64, size=(4, (width * channels + 1) // 2), dtype=np.uint64),
            image.reshape(height, -1),
        )
        return image[:, :, 0] if channels == 1 else image

    def raw(
        self, light: LightImage, rng: np.random.Generator, patch: Patch | None = None, *, bayer: bool = False
    ) -> NDArray[np.uint16]:
        """Return the signal of light (h, w, c) in steps of 1 / RAW_STEPS of a grey level, with the noise of develop.

        (h, w) of a grey camera or behind a mosaic of colour filters (bayer: red, green; green, blue), else (h, w, 3).
        """
        height, width, channels = light.shape
        over = patch or Patch(row=0, column=0, light=np.empty((0, 0, channels), np.float32))
        wide = width if bayer else width * channels
        out = np.empty((height, wide), np.uint16)
        develop_raw(
            light,
            (np.ascontiguousarray(over.light), over.row, over.column),
            bayer,
            (1.0 / self.electrons_per_level, self.read_noise_level, self.saturation),
            RAW_STEPS,
            _TABLE,
            rng.integers(0, 2**64, size=(4, (wide + 1) // 2), dtype=np.uint64),
            out,
        )
        return out if bayer or channels == 1 else out.reshape(light.shape)


def ambient(
    width: int,
    height: int,
    level: float,
    *,
    across: float = 0.0,
    down: float = 0.0,
    bgr: tuple[float, ...] = (1.0,),
) -> LightImage:
    """Return ambient light (h, w, len(bgr)) float32: level at the centre, changing by across and down over the image.

    bgr: share of each channel; one entry makes a grey camera. Nowhere below 0.
    """
    x = np.linspace(-0.5, 0.5, width)
    y = np.linspace(-0.5, 0.5, height)
    plane = np.maximum(level + across * x[None, :] + down * y[:, None], 0.0)
    return np.ascontiguousarray(plane[:, :, None] * np.array(bgr), dtype=np.float32)


def with_hot_pixels(light: LightImage, count: int, level: tuple[float, float], rng: np.random.Generator) -> LightImage:
    """Return light (h, w, c) with count pixels, each in one channel, that glow by a level from the given range."""
    height, width, channels = light.shape
    hot = light.copy()
    index = rng.choice(height * width, size=count, replace=False)
    np.add.at(
        hot.reshape(-1, channels),
        (index, rng.integers(0, channels, count)),
        rng.uniform(*level, count).astype(np.float32),
    )
    return hot


def with_clutter(light: LightImage, count: int, level: tuple[float, float], rng: np.random.Generator) -> LightImage:
    """Return light (h, w, c) with count soft patches of a random place, size, level and colour: the room behind."""
    height, width, channels = light.shape
    out = light.astype(np.float64)
    y, x = np.arange(height), np.arange(width)
    for _ in range(count):
        half_width, half_height = rng.uniform(0.02, 0.12, 2) * width
        u, v = rng.uniform(0.0, width), rng.uniform(0.0, height)
        colour = rng.uniform(*level) * (rng.dirichlet(np.ones(channels)) if channels > 1 else np.ones(1))
        across = np.exp(-(((x - u) / half_width) ** 4))  # a flat top with edges softer than any beacon's
        down = np.exp(-(((y - v) / half_height) ** 4))
        out += down[:, None, None] * across[None, :, None] * colour
    return out.astype(np.float32)
