"""Spots of a grey image: the calls around the compiled search, and what they return."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray

from armsight.errors import BadImage, Inconsistent
from armsight.measure.settings import SpotSettings
from armsight.measure.spots.candidates import Candidates, Index, blobs, fresh_state, is_dark, is_quiet, only
from armsight.measure.spots.kernels.area import (
    BORDER,
    FAILED,
    FIT,
    LARGE,
    MOST_LIGHTS,
    SATURATED,
    SPOT,
    STATUS,
    UNLIKE,
    UNRESOLVED,
    UNUSED,
)
from armsight.measure.spots.kernels.background import add_background_variance
from armsight.measure.spots.kernels.colour import whiten_clipped
from armsight.measure.spots.kernels.locate import FULL, NOISE, NOTHING_ABOVE, NUMBER, locate, locate_near
from armsight.measure.spots.kernels.measure_areas import measure_others, measure_round, pack_results
from armsight.measure.spots.kernels.scan import SUM_X, SUM_Y, WEIGHT
from armsight.records import Spots, trusted

Image = NDArray[np.uint8]
Array = NDArray[np.float64]
Rejected = tuple[tuple[float, float, str], ...]

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


def grey_candidates(image: Image, settings: SpotSettings, faint: bool) -> Candidates:
    """Return what may be a light in an image (h, w) or (h, w, 3), searched as grey; see find_candidates."""
    grey = searchable(image, settings)
    areas, state, survey, outcome = locate(grey, settings.mask_bytes, settings.options)
    complete = True
    refused: Rejected = ()
    room = settings.threshold is None and (faint or outcome != FULL or not is_dark(areas, state, settings))
    quiet = outcome == FULL and not room and is_quiet(state, settings.max_spots)
    if room:
        if outcome == FULL:
            refused = too_large(areas, state)
        areas, complete = blobs(grey, settings, float(survey[-1, NOISE]), faint)
        state = fresh_state(len(areas))
    if not len(areas) and outcome != FULL:
        refused = (whole_frame(grey, _too_bright(outcome, float(survey[-1, NUMBER]))),)

    def fit(chosen: Index, others: int) -> Spots:
        own = state.copy() if quiet else only(state, chosen, others)
        spots = record(*measured(grey, settings, areas, own, survey))
        return replace(spots, rejected=spots.rejected + refused) if refused else spots

    return Candidates(areas=areas, state=state, fit=fit, quiet=quiet, complete=complete, room=room and not faint)


def too_large(areas: Array, state: NDArray[np.int64]) -> Rejected:
    """Return the areas above the threshold that are larger than a light, or cut by the image's border."""
    large = areas[np.isin(state[:, STATUS], (LARGE, BORDER))]
    why = state[np.isin(state[:, STATUS], (LARGE, BORDER)), STATUS]
    return rejections(np.column_stack([large[:, [SUM_X, SUM_Y]] / large[:, [WEIGHT]], why])) if len(large) else ()


def _too_bright(outcome: int, number: float) -> str:
    if outcome == NOTHING_ABOVE:
        return f"bright all over: a background of {number:.0f} leaves no room"
    return f"{100.0 * number:.0f} % of the image lies above the threshold"


def track_grey(
    image: Image, predicted: Array, half_window_px: float, settings: SpotSettings
) -> tuple[Spots, NDArray[np.intp]]:
    """Return the spots in windows around predicted (n, 2), and the prediction of each; see track_spots."""
    grey = searchable(image, settings)
    half = int(half_window_px + 0.5)
    areas, state, survey, cut = locate_near(grey, settings.mask_bytes, settings.options, predicted, half)
    columns, refused = measured(grey, settings, areas, state, survey)
    if len(cut):
        refused = np.concatenate([refused, cut])
    return record(columns, refused), columns[5].astype(np.intp, copy=False)


def measured(
    grey: Image, settings: SpotSettings, areas: Array, state: NDArray[np.int64], survey: Array
) -> tuple[tuple[Array, ...], Array]:
    """Return the spots' columns and the refusals of the located areas."""
    n = len(areas)
    fits, rows = np.empty((n, FIT)), np.empty((n, MOST_LIGHTS, SPOT))
    if measure_round(grey, settings.mask_bytes, settings.options, areas, state, survey, fits, rows):
        measure_others(grey, settings.mask_bytes, settings.options, areas, state, survey, fits, rows)
    add_background_variance(grey, settings.options, areas, state, survey, rows)
    *columns, refused = pack_results(settings.options, areas, state, rows)
    return tuple(columns), refused


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


def record(columns: tuple[Array, ...], refused: Array) -> Spots:
    """Return the record of the kernels' columns."""
    uv, covariance, peak, size, model, _ = columns
    names = tuple(map(MODEL_NAMES.__getitem__, model.tolist()))
    return trusted(
        Spots,
        uv_px=uv,
        covariance_px2=covariance,
        peak=peak,
        size_px=size,
        model=names,
        rejected=rejections(refused) if len(refused) else (),
    )
