"""Light on the sensor: sources of spread light, integrated over every pixel, painted over a backdrop."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from armsight.arrays import Array
from armsight_sim.kernels import REACH_SIGMA, add_gaussians, add_regions

LightImage = NDArray[np.float32]
"""Light (h, w, c) in grey levels; c = 1 for a grey camera, 3 (BGR) for one that sees colour."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Patch:
    """Part of an image: light (h, w, c) whose top-left pixel is [row, column] of the whole."""

    row: int
    column: int
    light: LightImage


class LightSource(Protocol):
    """Something that puts light on the sensor."""

    @property
    def sigma_px(self) -> float:
        """Spread of the light."""
        ...

    def centres_px(self) -> Array:
        """Return the places (n, 2) round which the light falls, as far as the spread function reaches."""
        ...

    def add_to(self, patch: Patch) -> None:
        """Add the light to the patch."""
        ...


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PointSource:
    """A Gaussian of sigma_px at each of uv_px (n, 2), with flux (n,) in grey levels x px^2; bgr (c,) per channel."""

    uv_px: Array
    flux: Array
    sigma_px: float
    bgr: Array

    def centres_px(self) -> Array:
        """Return the centres (n, 2)."""
        return self.uv_px

    def add_to(self, patch: Patch) -> None:
        """Add the light to the patch."""
        uv = np.ascontiguousarray(self.uv_px - (patch.column, patch.row))
        add_gaussians(patch.light, uv, self.flux, self.sigma_px, self.bgr)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RegionSource:
    """Uniformly lit regions with edges blurred by sigma_px.

    outlines_px: (m, n, 2), n nodes each of a smooth closed curve, evenly spaced in its parameter. share: (m,)
    of the exposure. bgr: (c,) plateau in grey levels per channel.
    """

    outlines_px: Array
    share: Array
    sigma_px: float
    bgr: Array

    def centres_px(self) -> Array:
        """Return the nodes (m n, 2)."""
        return self.outlines_px.reshape(-1, 2)

    def add_to(self, patch: Patch) -> None:
        """Add the light to the patch."""
        outlines = np.ascontiguousarray(self.outlines_px - (patch.column, patch.row))
        nodes = outlines.shape[1]
        slope = 1j * np.arange(nodes // 2 + 1) * np.fft.rfft(outlines[:, :, 1], axis=1)
        dv = np.fft.irfft(slope, nodes, axis=1) * (2.0 * np.pi / nodes)  # exact for a smooth closed curve
        add_regions(patch.light, outlines, dv, self.share, self.sigma_px, self.bgr)


def render_sources(backdrop: LightImage, sources: Sequence[LightSource]) -> Patch:
    """Return the part of the backdrop (h, w, c) that the sources reach, with their light added."""
    height, width = backdrop.shape[:2]
    low, high = np.full(2, np.inf), np.full(2, -np.inf)
    for source in sources:
        places = source.centres_px()
        places = places[np.isfinite(places).all(axis=1)]
        reach = REACH_SIGMA * source.sigma_px + 2.0
        low = np.minimum(low, places.min(axis=0, initial=np.inf) - reach)
        high = np.maximum(high, places.max(axis=0, initial=-np.inf) + reach)
    i0, j0 = np.floor(np.clip(low, 0, (width, height))).astype(int).tolist()
    i1, j1 = np.ceil(np.clip(high + 1.0, (i0, j0), (max(width, i0), max(height, j0)))).astype(int).tolist()
    patch = Patch(row=j0, column=i0, light=backdrop[j0:j1, i0:i1].copy())
    if patch.light.size:
        for source in sources:
            source.add_to(patch)
    return patch
