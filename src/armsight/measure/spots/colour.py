"""Beacons found by their colour (Kapucu and Baysec 2005), where they stand out of what is round them in that colour."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from armsight.errors import BadImage
from armsight.measure.settings import SpotSettings
from armsight.measure.spots.candidates import Candidates
from armsight.measure.spots.grey import Array, Image, checked_mask, grey_candidates, not_an_image, track_grey
from armsight.measure.spots.kernels.area import ACCEPTED, OWNER, STATUS, UNUSED
from armsight.measure.spots.kernels.colour import colour_signal, coloured_pixels
from armsight.measure.spots.kernels.scan import AREA, X_MAX, X_MIN, Y_MAX, Y_MIN
from armsight.records import Colour, Spots

ANY = Colour(hue_deg=(0.0, 360.0))
MARGIN_PX = 24
"""Background around a window that the fit of a light in it sees."""
FLOOR = 32.0
"""Grey level of no colour in the signal: were it 0, half of the background's noise would be clipped."""
COLOURED_SHARE = 0.25
"""Share of a light's pixels that are of the colour: its middle may be clipped white, its rim too weak."""
STRONG_SHARE = 0.2
"""Share of the greatest contrast in the image below which something of the colour is not taken for a light. A beacon
before a bright wall may have a third of another red lamp's: a larger share gave that lamp's place for it."""
SMOOTH = 0.8
"""Mean step to the next pixel over that to the one after it, below which colours were interpolated; 1: white noise."""
INTERPOLATED_PX = 0.07
"""Deviation per coordinate of a light's centre of which the fit does not know where a camera interpolated its colours
and stored them at half size: what simulated webcams leave (compression, sharpening and mosaic)."""


def coloured_candidates(image: Image, settings: SpotSettings) -> Candidates:
    """Return what may be a beacon of settings.colour in a BGR image (h, w, 3); see find_candidates.

    The signal that is searched and measured is a pixel's projection on the colour's hue, FLOOR for any grey. What
    stands out in it is a candidate where enough of its pixels are of the colour, and none is far stronger.
    """
    bgr = _coloured_image(image)
    checked_mask(settings, bgr)
    signal = hue_signal(bgr, settings)
    found = grey_candidates(signal, _plain(settings), faint=False)
    _leave_coloured(bgr, found, settings)
    _leave_strong(found)
    fit, floor = found.fit, _floor(signal)
    return dataclasses.replace(found, room=False, fit=lambda chosen, others: _widened(fit(chosen, others), floor))


def track_coloured(
    image: Image, predicted: Array, half_window_px: float, settings: SpotSettings
) -> tuple[Spots, NDArray[np.intp]]:
    """Return the beacon nearest to each of predicted (n, 2) within half_window_px, and the prediction of each."""
    bgr = _coloured_image(image)
    checked_mask(settings, bgr)
    signal = np.full(bgr.shape[:2], np.uint8(FLOOR))
    reach, boxes = half_window_px + MARGIN_PX, []
    for u, v in predicted:
        low = np.clip(np.rint([v - reach, u - reach]), 0, signal.shape).astype(int)
        high = np.clip(np.rint([v + reach + 1.0, u + reach + 1.0]), 0, signal.shape).astype(int)
        box = np.s_[low[0] : high[0], low[1] : high[1]]
        signal[box] = hue_signal(bgr[box], settings)
        boxes.append(box)
    spots, of = track_grey(signal, predicted, half_window_px, _plain(settings))
    spots = _widened(spots, max((_floor(signal[box]) for box in boxes), default=0.0))
    kept = [i for i in range(len(spots)) if _is_coloured(bgr, spots.uv_px[i], float(spots.size_px[i]), settings)]
    return (spots, of) if len(kept) == len(spots) else (spots.take(kept), of[kept])


def hue_signal(bgr: Image, settings: SpotSettings) -> Image:
    """Return BGR's projection on the middle of the colour's hues: FLOOR for grey, 255 for two clipped channels."""
    low, high = (settings.colour or ANY).hue_deg
    middle = np.deg2rad(low + 0.5 * ((high - low) % 360.0))
    weights = np.cos(middle - np.deg2rad([240.0, 120.0, 0.0]))  # of blue, green, red
    signal = np.empty(bgr.shape[:2], np.uint8)
    colour_signal(bgr, weights, FLOOR, settings.saturation, signal)
    return signal


def _floor(signal: Image) -> float:
    """Return the variance (px^2) that a centre has besides: none where neighbouring pixels are independent."""
    rows = signal[::4].astype(np.int16)
    if rows.shape[1] < 3:
        return 0.0
    near, far = (np.minimum(np.abs(rows[:, k:] - rows[:, :-k]), 8).mean() for k in (1, 2))
    return INTERPOLATED_PX**2 if near < SMOOTH * far else 0.0


def _widened(spots: Spots, variance: float) -> Spots:
    """Return the spots with so much variance more per coordinate."""
    if not variance or not len(spots):
        return spots
    return dataclasses.replace(spots, covariance_px2=spots.covariance_px2 + variance * np.eye(2))


def _coloured_image(image: Image) -> Image:
    if not isinstance(image, np.ndarray) or image.dtype != np.uint8 or image.size == 0 or image.ndim not in (2, 3):
        raise not_an_image(image)
    if image.ndim == 2 or image.shape[2] != 3:
        raise BadImage(
            f"an image of shape {image.shape} has no colours",
            consequence="A beacon cannot be found by its colour in it",
            cure="Record in colour, or leave the colour out of the target",
        )
    return image


def _plain(settings: SpotSettings) -> SpotSettings:
    """Return the settings with which the signal is searched."""
    return dataclasses.replace(settings, colour=None, threshold=None, inverted=False, saturation=255)


def _definition(settings: SpotSettings) -> Array:
    """Return the colour as the kernels want it: hue from, to in degrees, saturation 0..1, value 0..255."""
    colour = settings.colour or ANY
    return np.array([*colour.hue_deg, colour.min_saturation, 255.0 * colour.min_value])


def _leave_coloured(bgr: Image, found: Candidates, settings: SpotSettings) -> None:
    """Take out the candidates that are not of the colour; they are no refused lights either."""
    definition = _definition(settings)
    for i, (area, state) in enumerate(zip(found.areas, found.state, strict=True)):
        box = area[[X_MIN, X_MAX, Y_MIN, Y_MAX]].astype(np.int64)
        n = coloured_pixels(bgr, definition, box)
        if n < max(COLOURED_SHARE * area[AREA], 1.0):
            state[OWNER] = -1
            if state[STATUS] == ACCEPTED:
                found.state[i, STATUS] = UNUSED


def _leave_strong(found: Candidates) -> None:
    """Take out the candidates that are far weaker than the strongest."""
    at = found.positions()
    if len(at):
        weak = at[found.contrast[at] < STRONG_SHARE * found.contrast[at].max()]
        found.state[weak, STATUS] = UNUSED


def _is_coloured(bgr: Image, uv: Array, size: float, settings: SpotSettings) -> bool:
    """Tell whether enough pixels about uv (2,) are of the colour."""
    r, (u, v) = max(round(size), 1), np.rint(uv).astype(int)
    h, w = bgr.shape[:2]
    box = np.array([max(u - r, 0), min(u + r, w - 1), max(v - r, 0), min(v + r, h - 1)], np.int64)
    return bool(coloured_pixels(bgr, _definition(settings), box) >= max(COLOURED_SHARE * np.pi * r * r, 1.0))
