"""What a camera does besides counting light: its lens before the sensor, its processing behind it.

In the order of the light: glare and vignetting in the lens, then shot and read noise on the raw linear signal
(sim.sensor), the mosaic of colour filters and its interpolation, the transfer curve, sharpening, JPEG.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Literal

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from armsight.arrays import Array
from armsight.errors import Inconsistent
from armsight_sim.kernels import apply_curve
from armsight_sim.render import LightImage, Patch
from armsight_sim.sensor import RAW_STEPS, Sensor

Picture = NDArray[np.uint8]
Curve = Literal["linear", "srgb", "gamma"]

TOP = 255
"""Grey levels of a white picture."""

GLARE_BLOCK = 8
"""Glare is so wide that it is worked out on blocks of this many pixels."""

GLARE_WIDTHS = ((0.008, 0.5), (0.05, 0.5))
"""Parts of the halo: sigma over the image's width, and share of the scattered light. Chosen: a tight one round every
light, as dust and lens edges give, and a wide veil."""

LEAST_VEIL_LEVEL = 0.05
"""Halo below this is not drawn round a light: a thirtieth of the read noise."""

SHARPENING_SIGMA_PX = 1.0
"""Of the blurred copy that unsharp masking takes away."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Pipeline:
    """A camera's lens and processing.

    vignetting: share of the light lost in the corners, growing with the square of the distance from the middle. glare:
    share of the light that is scattered into a halo. bayer: one colour filter a pixel, interpolated; a grey picture
    of such a camera is the luminance of its colours. curve: from linear light to grey levels; gamma: exponent of the
    curve 'gamma'. sharpening: share of the unsharp mask added. jpeg_quality: 1 to 100, None for no compression.
    """

    vignetting: float = 0.0
    glare: float = 0.0
    bayer: bool = False
    curve: Curve = "linear"
    gamma: float = 2.2
    sharpening: float = 0.0
    jpeg_quality: int | None = None

    def __post_init__(self) -> None:
        if not (0.0 <= self.vignetting < 1.0 and 0.0 <= self.glare < 1.0):
            raise Inconsistent(f"vignetting {self.vignetting} and glare {self.glare} are shares of the light, below 1")
        if self.curve not in ("linear", "srgb", "gamma") or not 0.2 <= self.gamma <= 5.0:
            raise Inconsistent(f"a curve {self.curve!r} with gamma {self.gamma} cannot be")
        if not 0.0 <= self.sharpening <= 5.0:
            raise Inconsistent(f"sharpening by {self.sharpening} cannot be")
        if self.jpeg_quality is not None and not 1 <= self.jpeg_quality <= 100:
            raise Inconsistent(f"a JPEG quality of {self.jpeg_quality} is not within 1 to 100")

    @property
    def plain(self) -> bool:
        """Whether the raw signal, rounded, is the picture."""
        return not self.bayer and self.curve == "linear" and self.sharpening == 0.0 and self.jpeg_quality is None

    def encode(self, level: ArrayLike) -> Array:
        """Return the picture's levels (0 to 255) of linear light in grey levels (0 to 255)."""
        x = np.clip(np.asarray(level, dtype=np.float64) / TOP, 0.0, 1.0)
        if self.curve == "srgb":  # IEC 61966-2-1
            x = np.where(x <= 0.0031308, 12.92 * x, 1.055 * np.maximum(x, 1e-9) ** (1.0 / 2.4) - 0.055)
        elif self.curve == "gamma":
            x = x ** (1.0 / self.gamma)
        return np.asarray(TOP * x)

    def decode(self, level: ArrayLike) -> Array:
        """Return the linear light in grey levels behind a picture's levels (0 to 255)."""
        x = np.clip(np.asarray(level, dtype=np.float64) / TOP, 0.0, 1.0)
        if self.curve == "srgb":
            x = np.where(x <= 0.04045, x / 12.92, ((x + 0.055) / 1.055) ** 2.4)
        elif self.curve == "gamma":
            x = x**self.gamma
        return np.asarray(TOP * x)

    def develop(
        self,
        light: LightImage,
        sensor: Sensor,
        rng: np.random.Generator,
        patch: Patch | None = None,
        *,
        grey: bool = False,
    ) -> Picture:
        """Return the picture (h, w) or (h, w, 3) of light (h, w, c) on the sensor, patch over it.

        grey: of a colour camera the luminance is handed out.
        """
        if self.plain:
            picture = sensor.develop(light, rng, patch)
        else:
            raw = sensor.raw(light, rng, patch, bayer=self.bayer and light.shape[2] == 3)
            if raw.ndim == 2 and light.shape[2] == 3:
                raw = np.asarray(cv2.demosaicing(raw, cv2.COLOR_BayerRGGB2BGR), dtype=np.uint16)
            picture = np.empty(raw.shape, np.uint8)
            apply_curve(raw.reshape(-1), _curve_table(self), picture.reshape(-1))
        if grey and picture.ndim == 3:
            picture = np.asarray(cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY), dtype=np.uint8)
        return self._processed(picture)

    def _processed(self, picture: Picture) -> Picture:
        """Return a picture sharpened and compressed."""
        if self.sharpening > 0.0:
            soft = cv2.GaussianBlur(picture, (5, 5), SHARPENING_SIGMA_PX)
            sharp = cv2.addWeighted(picture, 1.0 + self.sharpening, soft, -self.sharpening, 0.0)
            picture = np.asarray(sharp, dtype=np.uint8)
        if self.jpeg_quality is not None:
            done, data = cv2.imencode(".jpg", picture, (cv2.IMWRITE_JPEG_QUALITY, self.jpeg_quality))
            if not done:
                raise Inconsistent(f"a picture of shape {picture.shape} was not compressed")
            picture = np.asarray(cv2.imdecode(data, cv2.IMREAD_UNCHANGED), dtype=np.uint8)
        return picture


IDEAL = Pipeline()

PIPELINES: Mapping[str, Pipeline] = {
    "ideal": IDEAL,
    "machine": Pipeline(vignetting=0.12, glare=0.01),
    "webcam": Pipeline(vignetting=0.3, glare=0.03, bayer=True, curve="srgb", sharpening=0.6, jpeg_quality=88),
}
"""By name. ideal: nothing but noise. machine: an industrial camera, linear. webcam: what comes over USB.
Chosen: lens makers give a tenth to a third less light in corners and one to three hundredths of scattered light."""


@lru_cache(maxsize=16)
def _curve_table(pipeline: Pipeline) -> Picture:
    """Return the picture's level (n,) of every step of the raw signal."""
    steps = np.arange(RAW_STEPS * TOP + 1) / RAW_STEPS
    table: Picture = np.round(pipeline.encode(steps)).astype(np.uint8)
    table.setflags(write=False)
    return table


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LensLosses:
    """Glare and vignetting of a pipeline over an image of height x width px; both linear in the light."""

    pipeline: Pipeline
    height: int
    width: int
    shade: LightImage = field(init=False, repr=False)

    def __post_init__(self) -> None:
        y = (np.arange(self.height) - 0.5 * (self.height - 1))[:, None]
        x = (np.arange(self.width) - 0.5 * (self.width - 1))[None, :]
        rr = (x**2 + y**2) / (0.25 * (self.height**2 + self.width**2))
        shade = (1.0 - self.pipeline.vignetting * rr).astype(np.float32)[:, :, None]
        shade.setflags(write=False)
        object.__setattr__(self, "shade", shade)

    @property
    def none(self) -> bool:
        """Whether the light passes as it is."""
        return self.pipeline.vignetting == 0.0 and self.pipeline.glare == 0.0

    def through(self, light: LightImage) -> LightImage:
        """Return the light (h, w, c) on the sensor of light (h, w, c) before the lens."""
        if self.none:
            return light
        glare = self.pipeline.glare
        if glare == 0.0:
            return light * self.shade
        veil = self._enlarged(self._scattered(light, 0, 0), 0, self.height, 0, self.width)
        return ((1.0 - glare) * light + veil) * self.shade

    def patched(self, before: LightImage, through: LightImage, patch: Patch) -> Patch:
        """Return the patch on the sensor that a patch over the light `before` the lens makes of the light `through`."""
        if self.none or not patch.light.size:
            return patch
        j0, i0 = patch.row, patch.column
        j1, i1 = j0 + patch.light.shape[0], i0 + patch.light.shape[1]
        change = patch.light - before[j0:j1, i0:i1]
        glare = self.pipeline.glare
        if glare == 0.0:
            light = through[j0:j1, i0:i1] + change * self.shade[j0:j1, i0:i1]
            return Patch(row=j0, column=i0, light=np.maximum(light, 0.0))
        veil = self._scattered(change, j0, i0)
        J0, J1, I0, I1 = self._reach(veil, (j0, j1, i0, i1))
        added = self._enlarged(veil, J0, J1, I0, I1)
        added[j0 - J0 : j1 - J0, i0 - I0 : i1 - I0] += (1.0 - glare) * change
        light = through[J0:J1, I0:I1] + added * self.shade[J0:J1, I0:I1]
        return Patch(row=J0, column=I0, light=np.maximum(light, 0.0))

    def _scattered(self, light: LightImage, row: int, column: int) -> LightImage:
        """Return the halo, on blocks of the whole image, of light (h, w, c) whose corner is [row, column]."""
        block, channels = GLARE_BLOCK, light.shape[2]
        j0, i0 = row // block, column // block
        j1, i1 = -(-(row + light.shape[0]) // block), -(-(column + light.shape[1]) // block)
        padded = np.zeros(((j1 - j0) * block, (i1 - i0) * block, channels), np.float32)
        j, i = row - j0 * block, column - i0 * block
        padded[j : j + light.shape[0], i : i + light.shape[1]] = light
        small = cv2.resize(padded, (i1 - i0, j1 - j0), interpolation=cv2.INTER_AREA).reshape(j1 - j0, i1 - i0, channels)
        blocks = np.zeros((-(-self.height // block), -(-self.width // block), channels), np.float32)
        blocks[j0:j1, i0:i1] = small
        veil = np.zeros_like(blocks)
        for width, share in GLARE_WIDTHS:
            sigma = max(width * self.width / block, 0.5)
            soft = cv2.GaussianBlur(blocks, (0, 0), sigma, borderType=cv2.BORDER_CONSTANT)
            veil += self.pipeline.glare * share * soft.reshape(blocks.shape)
        return veil

    def _reach(self, veil: LightImage, region: tuple[int, int, int, int]) -> tuple[int, int, int, int]:
        """Return rows and columns (first, past the last, of each) that hold the region and the halo worth drawing."""
        bright = np.abs(veil).max(axis=2) > LEAST_VEIL_LEVEL
        j0, j1, i0, i1 = region
        if not bright.any():
            return region
        rows, columns = np.nonzero(bright.any(axis=1))[0], np.nonzero(bright.any(axis=0))[0]
        return (
            max(min(j0, (int(rows[0]) - 1) * GLARE_BLOCK), 0),
            min(max(j1, (int(rows[-1]) + 2) * GLARE_BLOCK), self.height),
            max(min(i0, (int(columns[0]) - 1) * GLARE_BLOCK), 0),
            min(max(i1, (int(columns[-1]) + 2) * GLARE_BLOCK), self.width),
        )

    def _enlarged(self, veil: LightImage, j0: int, j1: int, i0: int, i1: int) -> LightImage:
        """Return the halo (j1 - j0, i1 - i0, c) of the pixels from its blocks, interpolated."""
        block, channels = GLARE_BLOCK, veil.shape[2]
        J0, I0 = max(j0 // block - 1, 0), max(i0 // block - 1, 0)
        J1, I1 = -(-j1 // block) + 1, -(-i1 // block) + 1
        part = veil[J0:J1, I0:I1]
        size = (part.shape[1] * block, part.shape[0] * block)
        large = cv2.resize(part, size, interpolation=cv2.INTER_LINEAR).reshape(size[1], size[0], channels)
        return np.ascontiguousarray(large[j0 - J0 * block : j1 - J0 * block, i0 - I0 * block : i1 - I0 * block])
