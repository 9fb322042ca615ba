"""What in an image may be a light: cheap coarse centres first, the precise fit only for those that are asked for."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from armsight.measure.settings import SpotSettings
from armsight.measure.spots.kernels.area import ACCEPTED, HOT, LARGE, MANY, SMALL, STATE, STATUS, UNUSED
from armsight.measure.spots.kernels.blobs import grow_blobs
from armsight.measure.spots.kernels.scan import (
    AREA,
    COLUMNS,
    LEVEL,
    PEAK,
    SUM_X,
    SUM_Y,
    WEIGHT,
    X_MAX,
    X_MIN,
    Y_MAX,
    Y_MIN,
)
from armsight.records import Spots

Array = NDArray[np.float64]
Image = NDArray[np.uint8]
Index = NDArray[np.intp]

MOST = 1024
"""Candidates kept of one image, strongest first."""
MOST_GROWN = 2_000_000
"""Pixels that blobs are grown over in one image; about 40 ms."""
CONTRAST = 24.0
"""Height above its ring in grey levels that makes a peak worth a look."""
FAINT_SIGMA = 5.0
LEAST_CONTRAST = 8.0
"""The same, in standard deviations of the image's noise and in grey levels, where nothing higher was the target."""
BOX_PX = 9
"""Side of the box above whose mean a peak stands, on each level of the pyramid."""
COARSE_PX = 0.12
COARSE_SHARE = 0.02
"""Standard deviation of a coarse centre per coordinate: a part of its own and a share of the radius. On ray-traced
rooms the root mean square is 0.036 px and the largest 0.11, radii being 2-5 px."""

_SQUARE = np.ones((3, 3), np.uint8)


@dataclass(frozen=True, slots=True, eq=False)
class Candidates:
    """Bright areas of one image that may be lights.

    areas (n, COLUMNS), state (n, STATE): as the kernels know them; only the areas of status ACCEPTED are candidates.
    fit: measures those at the given positions, the others being refused for the reason of that number. quiet: little
    else than lights is bright in the image, so that all are measured. complete: False where the search stopped before
    it had looked at all of the image's peaks. room: more than lights is bright, and fainter ones may be looked for.
    others: things as bright that are no candidates, which make a pair of candidates by chance no less likely.
    """

    areas: Array
    state: NDArray[np.int64]
    fit: Callable[[Index, int], Spots]
    quiet: bool
    complete: bool = True
    room: bool = False
    others: int = 0

    def positions(self, most: int = MOST) -> Index:
        """Return the positions of the candidates, at most so many, of greatest contrast first."""
        at = np.flatnonzero(self.state[:, STATUS] == ACCEPTED)
        return at[np.argsort(-self.contrast[at], kind="stable")[:most]]

    def measure(self, chosen: Index) -> Spots:
        """Return the spots of the candidates at the given positions; the others are in `rejected` as candidates."""
        return self.fit(chosen, UNUSED)

    def measure_strongest(self, most: int) -> Spots:
        """Return the spots of the `most` candidates of greatest contrast; the others are in `rejected` as too many."""
        return self.fit(self.positions(most), MANY)

    @property
    def uv_px(self) -> Array:
        """Coarse centres (n, 2)."""
        return np.asarray(self.areas[:, [SUM_X, SUM_Y]] / self.areas[:, [WEIGHT]])

    @property
    def contrast(self) -> Array:
        """Height in grey levels above the level that parts each area from what is round it, (n,)."""
        return np.asarray(self.areas[:, PEAK] - self.areas[:, LEVEL])

    @property
    def peak(self) -> Array:
        """Highest grey level of each area, (n,)."""
        return np.asarray(self.areas[:, PEAK])

    @property
    def radius_px(self) -> Array:
        """Radius of a disc of the same area, (n,)."""
        return np.sqrt(self.areas[:, AREA] / np.pi)

    @property
    def sigma_px(self) -> Array:
        """Standard deviation of the coarse centres per coordinate, (n,)."""
        return np.asarray(COARSE_PX + COARSE_SHARE * self.radius_px)


def blobs(grey: Image, settings: SpotSettings, noise: float, faint: bool) -> tuple[Array, bool]:
    """Return the blobs (n, COLUMNS) of a grey image that stand out of their own surroundings, strongest first.

    noise: variance of a pixel. faint: down to what the noise allows. The flag tells whether all peaks were looked at.
    """
    contrast = max(FAINT_SIGMA * float(np.sqrt(noise)), LEAST_CONTRAST) if faint else CONTRAST
    seen = np.asarray(cv2.bitwise_not(grey), dtype=np.uint8) if settings.inverted else grey
    peaks = pyramid_peaks(seen, contrast, settings.max_radius_px)
    table = np.empty((MOST, COLUMNS))
    n, looked, _ = grow_blobs(
        (grey, np.uint8(255 if settings.inverted else 0), settings.saturation, settings.mask_bytes),
        peaks,
        (contrast, float(settings.min_pixels), settings.max_radius_px),
        table,
        MOST_GROWN,
    )
    return table[:n], bool(looked == len(peaks))


def pyramid_peaks(grey: Image, contrast: float, max_radius_px: float) -> NDArray[np.int64]:
    """Return (n, 3: x, y, scale) where a pixel of a pyramid's level is brighter than the box about it, strongest first.

    scale is the size of a pixel of the level: 2, 4, 8 ... A light is found on the level on which its radius is up to
    two pixels: the half-sized image shows the smallest as well.
    """
    least = int(0.4 * contrast)
    found: list[NDArray[np.int64]] = []
    if min(grey.shape) < 2 * BOX_PX:
        return np.empty((0, 3), np.int64)
    level, scale = _halved(grey), 2
    while True:
        step = cv2.subtract(level, cv2.blur(level, (BOX_PX, BOX_PX)))  # stops at zero: only what is brighter
        highest = np.asarray(cv2.dilate(step, _SQUARE), dtype=np.uint8)
        top = cv2.compare(step, np.maximum(highest, np.uint8(least), out=highest), cv2.CMP_GE)
        at = cv2.findNonZero(top)
        if at is not None:
            x, y = at[:, 0, 0], at[:, 0, 1]
            half = scale // 2
            places = np.column_stack([x * scale + half, y * scale + half, np.full(len(x), scale), step[y, x]])
            found.append(np.minimum(places, [grey.shape[1] - 1, grey.shape[0] - 1, scale, 255]))
        scale *= 2
        if scale > 0.5 * max_radius_px or min(level.shape) < 2 * BOX_PX:
            break
        level = _halved(level)
    if not found:
        return np.empty((0, 3), np.int64)
    peaks = np.concatenate(found)
    order = np.argsort(np.uint8(255) - peaks[:, 3].astype(np.uint8), kind="stable")  # bytes are sorted by counting
    return np.ascontiguousarray(peaks[order, :3], dtype=np.int64)


def _halved(grey: Image) -> Image:
    return np.asarray(cv2.resize(grey, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA), dtype=np.uint8)


def is_quiet(state: NDArray[np.int64], most: int) -> bool:
    """Tell whether the areas above the threshold are few (`most` or fewer), and none of them is too large."""
    status = state[:, STATUS]
    areas = int(np.count_nonzero((status != HOT) & (status != SMALL)))
    return areas <= min(QUIET, most) and not np.any(status == LARGE)


def is_dark(areas: Array, state: NDArray[np.int64], settings: SpotSettings) -> bool:
    """Tell whether what lies above the threshold is lights, be they many: nothing large, at the border neither."""
    status = state[:, STATUS]
    bright = (status != HOT) & (status != SMALL)
    extent = np.maximum(areas[:, X_MAX] - areas[:, X_MIN], areas[:, Y_MAX] - areas[:, Y_MIN])
    return bool(np.count_nonzero(bright) <= MANY_LIGHTS and not np.any(extent[bright] > 2.0 * settings.max_radius_px))


QUIET = 16
"""Bright areas of which each is measured as it is; of more, only those that may be the target's lights."""
MANY_LIGHTS = 128
"""Bright areas that may still all be lights before a dark background."""


def fresh_state(n: int) -> NDArray[np.int64]:
    """Return the state (n, STATE) of areas that are all candidates."""
    state = np.zeros((n, STATE), np.int64)
    state[:, STATUS] = ACCEPTED
    return state


def only(state: NDArray[np.int64], chosen: Index, others: int) -> NDArray[np.int64]:
    """Return the state in which of all candidates the chosen ones alone are to be measured; others: their status."""
    own = state.copy()
    own[own[:, STATUS] == ACCEPTED, STATUS] = others
    own[chosen, STATUS] = ACCEPTED
    return own
