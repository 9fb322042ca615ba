"""Spots of a grey image: cheap coarse centres first, the precise fit only for those that are asked for."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property, partial

import cv2
import numpy as np
from numpy.typing import NDArray

from armsight.arrays import Array, Image, Index
from armsight.errors import BadImage, Inconsistent
from armsight.measure.settings import Pace, SpotSettings
from armsight.measure.spots.kernels import columns as col
from armsight.measure.spots.kernels.area import (
    ACCEPTED,
    BORDER,
    FAILED,
    HOT,
    LARGE,
    MANY,
    SATURATED,
    SMALL,
    UNLIKE,
    UNRESOLVED,
    UNUSED,
)
from armsight.measure.spots.kernels.blobs import grow_blobs
from armsight.measure.spots.kernels.colour import whiten_clipped
from armsight.measure.spots.kernels.locate import FULL, NOTHING_ABOVE, grow_near, locate, locate_near
from armsight.measure.spots.kernels.measure_areas import measure_areas
from armsight.measure.spots.kernels.peaks import add_peaks, strongest_first
from armsight.records import Spots, trusted

Rejected = tuple[tuple[float, float, str], ...]
Located = tuple[Array, NDArray[np.int64], Array, int]
"""What `locate` returns of an image: areas, their state, the survey, outcome."""
Part = tuple[slice, slice]
"""Rows and columns of an image in which lights before a room are looked for."""

MODEL_NAMES = ("gaussian", "ellipse", "joint", "streak", "centroid")
"""How a spot was measured, in the order of the kernels' numbers."""
TOUCHING = "touching spots that cannot be told apart"
REASONS = (
    "accepted",
    "hot pixel: it stands alone",
    "too small: fewer pixels above the threshold than min_pixels",
    "cut by the border of the image",
    "too large for a spot: a reflection, a window or a lamp",
    "no light's model could be fitted to it",
    "saturated beyond use: too little of it is not clipped",
    "too many spots: only the max_spots strongest are measured",
    TOUCHING,
    "not like a spot: the residuals of the best model are too large",
    "reaches beyond its search window",
    "another spot is nearer to the prediction",
    "a candidate only: not needed by any arrangement that could be the target",
)
"""Why something bright was not accepted, in the order of the kernels' numbers."""
CANDIDATE = REASONS[UNUSED]
SECOND_LOOK = frozenset(REASONS[i] for i in (BORDER, LARGE, FAILED, SATURATED, UNRESOLVED, UNLIKE))
"""Reasons behind which a light may hide: it stands before something bright, or touches it."""


def grey_candidates(image: Image, settings: SpotSettings, pace: Pace, part: Part | None = None) -> Candidates:
    """Return what may be a light in an image (h, w) or (h, w, 3), searched as grey; see find_candidates."""
    grey = searchable(image, settings)
    located = locate(grey, settings.mask_bytes, settings.options)
    return _among_located(grey, settings, pace, located, part or (slice(None), slice(None)), faint=False)


def _among_located(
    grey: Image, settings: SpotSettings, pace: Pace, located: Located, part: Part, *, faint: bool
) -> Candidates:
    """Return the candidates of an image: the areas above the threshold, or, before a room, blobs of any level."""
    areas, state, survey, outcome = located
    complete = True
    refused: Rejected = ()
    free = settings.threshold is None
    room = free and (faint or outcome != FULL or not is_dark(areas, state, settings))
    closer = partial(_among_located, grey, settings, pace, located, part, faint=True) if free and not faint else None
    quiet = outcome == FULL and not room and is_quiet(state, settings.max_spots)
    if room:
        if outcome == FULL:
            refused = too_large(areas, state)
        areas, complete = blobs(grey, settings, float(survey[-1, col.NOISE]), pace, faint, part)
        state = fresh_state(len(areas))
    if not len(areas) and outcome != FULL:
        refused = (whole_frame(grey, _too_bright(outcome, float(survey[-1, col.NUMBER]))),)

    def fit(chosen: Index, others: int) -> Spots:
        own = state.copy() if quiet else only(state, chosen, others)
        spots = record(*measured(grey, settings, areas, own, survey))
        return replace(spots, rejected=spots.rejected + refused) if refused else spots

    return Candidates(
        areas=areas,
        state=state,
        fit=fit,
        quiet=quiet,
        complete=complete,
        room=room and not faint,
        look_closer=closer,
    )


def too_large(areas: Array, state: NDArray[np.int64]) -> Rejected:
    """Return the areas above the threshold that are larger than a light, or cut by the image's border."""
    large = areas[np.isin(state[:, col.STATUS], (LARGE, BORDER))]
    why = state[np.isin(state[:, col.STATUS], (LARGE, BORDER)), col.STATUS]
    return (
        rejections(np.column_stack([large[:, [col.SUM_X, col.SUM_Y]] / large[:, [col.WEIGHT]], why]))
        if len(large)
        else ()
    )


def _too_bright(outcome: int, number: float) -> str:
    if outcome == NOTHING_ABOVE:
        return f"bright all over: a background of {number:.0f} leaves no room"
    return f"{100.0 * number:.0f} % of the image lies above the threshold"


def track_grey(
    image: Image, predicted: Array, half_window_px: float, settings: SpotSettings, *, grown: bool = False
) -> tuple[Spots, Index]:
    """Return the spots in windows around predicted (n, 2), and the prediction of each; see track_spots."""
    grey = searchable(image, settings)
    half = int(half_window_px + 0.5)
    areas, state, survey, cut = locate_near(grey, settings.mask_bytes, settings.options, predicted, half)
    uv, covariance, looks, refused = measured(grey, settings, areas, state, survey)
    if len(cut):
        refused = np.concatenate([refused, cut])
    seen = set(looks[3].tolist()) if grown and settings.threshold is None else range(len(predicted))
    missed = [k for k in range(len(predicted)) if k not in seen]
    if missed:
        areas, state = grow_near(grey, settings.mask_bytes, settings.options, predicted, np.array(missed), half)
        more = measured(grey, settings, areas, state, survey)
        uv, covariance = np.concatenate([uv, more[0]]), np.concatenate([covariance, more[1]])
        looks = np.concatenate([looks, more[2]], axis=1)
    return record(uv, covariance, looks, refused), looks[3].astype(np.intp)


def measured(
    grey: Image, settings: SpotSettings, areas: Array, state: NDArray[np.int64], survey: Array
) -> tuple[Array, Array, Array, Array]:
    """Return the spots of the located areas as record takes them."""
    spots: tuple[Array, Array, Array, Array] = measure_areas(
        grey, settings.mask_bytes, settings.options, areas, state, survey
    )
    return spots


def searchable(image: Image, settings: SpotSettings) -> Image:
    """Return the image as contiguous grey; raise where it cannot be searched, or the mask does not fit it."""
    if not isinstance(image, np.ndarray) or image.dtype != np.uint8 or image.ndim not in (2, 3) or image.size == 0:
        raise not_an_image(image)
    if image.ndim == 3:
        if image.shape[2] != 3:
            raise not_an_image(image)
        image = grey_of(image, settings.saturation)
    checked_mask(settings, image)
    flags = image.flags
    if flags.writeable or not flags.c_contiguous:  # one type of array for the kernels, whoever owns it
        image = np.ascontiguousarray(image).view()
        image.setflags(write=False)
    return image


def checked_mask(settings: SpotSettings, image: Image) -> NDArray[np.uint8]:
    """Return the mask as the kernels want it (of size 0: none); raise where it is not of the image's size."""
    if settings.mask is not None and settings.mask_bytes.shape != image.shape[:2]:
        raise Inconsistent(
            f"the mask has shape {settings.mask_bytes.shape}, the image {image.shape[:2]}",
            consequence="It is unknown which pixels are meant",
            cure="Make the mask from an image of this camera",
        )
    return settings.mask_bytes


def grey_of(image: Image, saturation: int) -> Image:
    """Return BGR as grey, white where any channel is clipped: such a pixel's grey value is not known."""
    image = np.ascontiguousarray(image)
    grey = np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), dtype=np.uint8)
    whiten_clipped(image.reshape(-1), saturation, grey.reshape(-1))
    return grey


def not_an_image(image: object) -> BadImage:
    """Return the error for something that is not an 8-bit image."""
    kind = f"type {image.dtype} and shape {image.shape}" if isinstance(image, np.ndarray) else type(image).__name__
    return BadImage(
        f"an image of {kind} is not 8-bit grey (h, w) or BGR (h, w, 3)",
        consequence="It cannot be searched for spots",
        cure="Convert it to 8-bit grey or BGR",
    )


def whole_frame(image: Image, why: str) -> tuple[float, float, str]:
    """Return a rejection that concerns the whole image."""
    return (0.5 * (image.shape[1] - 1), 0.5 * (image.shape[0] - 1), why)


def rejections(refused: NDArray[np.float64]) -> Rejected:
    """Return the kernels' refusals (n, 3: u, v, number of the reason) as a record's tuple."""
    u, v, why = refused.T.tolist()
    return tuple(zip(u, v, map(REASONS.__getitem__, map(int, why)), strict=True))


def record(uv: Array, covariance: Array, looks: Array, refused: Array) -> Spots:
    """Return the record of what the kernels measured; see pack_results."""
    peak, size, model, _ = looks
    names = tuple([MODEL_NAMES[int(one)] for one in model.tolist()])
    return trusted(
        Spots,
        uv_px=uv,
        covariance_px2=covariance,
        peak=peak,
        size_px=size,
        model=names,
        rejected=rejections(refused) if len(refused) else (),
        point=None,
    )


MOST = 1024
"""Candidates kept of one image, strongest first."""
MOST_GROWN, GROWN_S, GROWN_SHARE = 2_000_000, 2e-8, 0.08
"""Pixels that blobs are grown over in one image, seconds for each, and the share of a deadline that is for them."""
FIT_S = 1e-3
"""Seconds to measure what before a room is no light, all models tried; a light takes a tenth of it."""
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


@dataclass(frozen=True, eq=False)  # no slots: what is reckoned from the areas is kept when it is first asked for
class Candidates:
    """Bright areas of one image that may be lights.

    areas (n, COLUMNS), state (n, STATE): as the kernels know them; only the areas of status ACCEPTED are candidates.
    fit: measures those at the given positions, the others being refused for the reason of that number. quiet: little
    else than lights is bright in the image, so that all are measured. complete: False where the search stopped before
    it had looked at all of the image's peaks. room: more than lights is bright, and fainter ones may be looked for.
    others: things as bright that are no candidates, which make a pair of candidates by chance no less likely.
    look_closer: takes nothing for quiet, and looks for those that hardly stand out as well.
    """

    areas: Array
    state: NDArray[np.int64]
    fit: Callable[[Index, int], Spots]
    quiet: bool
    complete: bool = True
    room: bool = False
    others: int = 0
    look_closer: Callable[[], Candidates] | None = None

    @cached_property
    def uv_px(self) -> Array:
        """Coarse centres (n, 2)."""
        return np.asarray(self.areas[:, [col.SUM_X, col.SUM_Y]] / self.areas[:, [col.WEIGHT]])

    @cached_property
    def contrast(self) -> Array:
        """Height in grey levels above the level that parts each area from what is round it, (n,)."""
        return np.asarray(self.areas[:, col.PEAK] - self.areas[:, col.LEVEL])

    @property
    def peak(self) -> Array:
        """Highest grey level of each area, (n,)."""
        return np.asarray(self.areas[:, col.PEAK])

    @cached_property
    def radius_px(self) -> Array:
        """Radius of a disc of the same area, (n,)."""
        return np.sqrt(self.areas[:, col.AREA] / np.pi)

    @cached_property
    def sigma_px(self) -> Array:
        """Standard deviation of the coarse centres per coordinate, (n,)."""
        return np.asarray(COARSE_PX + COARSE_SHARE * self.radius_px)

    def closer(self) -> Candidates:
        """Return what a closer look shows; itself where there is none."""
        return self if self.look_closer is None else self.look_closer()

    def positions(self, most: int = MOST) -> Index:
        """Return the positions of the candidates, at most so many, of greatest contrast first."""
        at = np.flatnonzero(self.state[:, col.STATUS] == ACCEPTED)
        return np.asarray(at[np.argsort(-self.contrast[at], kind="stable")[:most]])

    def measure(self, chosen: Index) -> Spots:
        """Return the spots of the candidates at the given positions; the others are in `rejected` as candidates."""
        return self.fit(chosen, UNUSED)

    def measure_strongest(self, most: int) -> Spots:
        """Return the spots of the `most` candidates of greatest contrast; the others are in `rejected` as too many."""
        return self.fit(self.positions(most), MANY)


def blobs(grey: Image, settings: SpotSettings, noise: float, pace: Pace, faint: bool, part: Part) -> tuple[Array, bool]:
    """Return the blobs (n, COLUMNS) of a part of a grey image that stand out of what is round them, strongest first.

    noise: variance of a pixel. faint: down to what the noise allows. The flag tells whether all peaks were looked at.
    """
    contrast = max(FAINT_SIGMA * float(np.sqrt(noise)), LEAST_CONTRAST) if faint else CONTRAST
    seen, mask = _cut_out(grey, part), settings.mask_bytes
    mask = _cut_out(mask, part) if mask.size else mask
    bright = np.asarray(cv2.bitwise_not(seen), dtype=np.uint8) if settings.inverted else seen
    peaks = pyramid_peaks(bright, contrast, settings.max_radius_px)
    table = np.empty((MOST, col.COLUMNS))
    n, looked, _ = grow_blobs(
        (seen, np.uint8(255 if settings.inverted else 0), settings.saturation, mask),
        peaks,
        (contrast, float(settings.min_pixels), settings.max_radius_px),
        table,
        pace.most(MOST_GROWN, GROWN_S, GROWN_SHARE),
    )
    found, (y, x) = table[:n], (one.start or 0 for one in part)
    found[:, [col.SUM_X, col.SUM_Y]] += found[:, [col.WEIGHT]] * [x, y]
    found[:, [col.X_MIN, col.X_MAX, col.Y_MIN, col.Y_MAX]] += [x, x, y, y]
    return found, bool(looked == len(peaks))


def _cut_out(image: Image, part: Part) -> Image:
    """Return a part of an image, contiguous and read-only as all of it is: one compilation serves both."""
    cut = np.ascontiguousarray(image[part]).view()
    cut.setflags(write=False)
    return cut


def pyramid_peaks(grey: Image, contrast: float, max_radius_px: float) -> NDArray[np.int64]:
    """Return (n, 3: x, y, scale) where a pixel of a pyramid's level is brighter than the box about it, strongest first.

    scale is the size of a pixel of the level: 2, 4, 8 ... A light is found on the level on which its radius is up to
    two pixels: the half-sized image shows the smallest as well.
    """
    least = np.uint8(0.4 * contrast)
    found = np.empty((0, 4), np.int64)
    level, scale = grey, 1
    while scale == 1 or scale <= 0.25 * max_radius_px:
        if min(level.shape) < 2 * BOX_PX:
            break
        level, scale = _halved(level), 2 * scale
        step = cv2.subtract(level, cv2.blur(level, (BOX_PX, BOX_PX)))  # stops at zero: only what is brighter
        found = add_peaks(step, cv2.dilate(step, _SQUARE), least, scale, grey.shape, found)
    return np.asarray(strongest_first(found))


def _halved(grey: Image) -> Image:
    return np.asarray(cv2.resize(grey, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA), dtype=np.uint8)


def is_quiet(state: NDArray[np.int64], most: int) -> bool:
    """Tell whether the areas above the threshold are few (`most` or fewer), and none of them is too large."""
    status = state[:, col.STATUS]
    areas = int(np.count_nonzero((status != HOT) & (status != SMALL)))
    return areas <= min(QUIET, most) and not np.any(status == LARGE)


def is_dark(areas: Array, state: NDArray[np.int64], settings: SpotSettings) -> bool:
    """Tell whether what lies above the threshold is lights, be they many: nothing large, at the border neither."""
    status = state[:, col.STATUS]
    bright = (status != HOT) & (status != SMALL)
    extent = np.maximum(areas[:, col.X_MAX] - areas[:, col.X_MIN], areas[:, col.Y_MAX] - areas[:, col.Y_MIN])
    return bool(np.count_nonzero(bright) <= MANY_LIGHTS and not np.any(extent[bright] > 2.0 * settings.max_radius_px))


QUIET = 16
"""Bright areas of which each is measured as it is; of more, only those that may be the target's lights."""
MANY_LIGHTS = 128
"""Bright areas that may still all be lights before a dark background."""


def fresh_state(n: int) -> NDArray[np.int64]:
    """Return the state (n, STATE) of areas that are all candidates."""
    state = np.zeros((n, col.STATE), np.int64)
    state[:, col.STATUS] = ACCEPTED
    return state


def only(state: NDArray[np.int64], chosen: Index, others: int) -> NDArray[np.int64]:
    """Return the state in which of all candidates the chosen ones alone are to be measured; others: their status."""
    own = state.copy()
    own[own[:, col.STATUS] == ACCEPTED, col.STATUS] = others
    own[chosen, col.STATUS] = ACCEPTED
    return own
