"""Beacons found by their colour (Kapucu and Baysec 2005), where they stand out of what is round them in that colour."""

from __future__ import annotations

import dataclasses

import cv2
import numpy as np
from numpy.typing import NDArray

from armsight.arrays import Array, Image, Index
from armsight.errors import BadImage
from armsight.measure.settings import Pace, SpotSettings
from armsight.measure.spots.grey import (
    CONTRAST,
    GROWN_S,
    GROWN_SHARE,
    MOST,
    MOST_GROWN,
    Candidates,
    checked_mask,
    fresh_state,
    is_dark,
    is_quiet,
    measured,
    not_an_image,
    only,
    pyramid_peaks,
    record,
    searchable,
    track_grey,
)
from armsight.measure.spots.kernels import columns as col
from armsight.measure.spots.kernels.area import ACCEPTED, UNUSED
from armsight.measure.spots.kernels.blobs import grow_blobs
from armsight.measure.spots.kernels.colour import (
    BRIGHT,
    CLIPPED_FROM,
    LEAST_SATURATION,
    LEAST_VALUE,
    LOCAL,
    LOOK,
    ONE,
    OWN,
    SPARSE,
    background_unevenness,
    colour_signal,
    coloured_pixels,
    fill_white,
    histogram_quantile,
    matches,
    measure_colour,
    white_pixels,
)
from armsight.measure.spots.kernels.locate import FULL, locate
from armsight.records import Colour, Spots

ANY = Colour(hue_deg=(0.0, 360.0))
MARGIN_PX = 24
"""Background around a window that the fit of a light in it sees."""
FLOOR = 32.0
"""Grey level of no colour in the signal: were it 0, half of the background's noise would be clipped."""
LEAST_SIGNAL = FLOOR + 20.0
"""Signal that something of a colour has at its brightest."""
LEAST_RISE = 10.0
REPLACED = 0.5
"""Grey levels that a light adds in its brightest channel; what takes away more than this share of it in another one
replaces its background, and adds no light to it."""
PURE = 0.65
"""Least saturation of what a light adds: in simulated rooms beacons have 0.7 and more, red squares on screens less."""
COLOURED_SHARE = 0.25
"""Share of its pixels that are of the colour, where a threshold says what is bright enough to be the beacon."""
GLOWS = (1.4, 1.12)
"""How much brighter a light is than what the room lights: than nine tenths of the image, and than three quarters of
what is within 90 px of it, clipped pixels left out. First for grey levels in proportion to the light, then for a camera
that processes its pictures and squeezes what is bright. In simulated rooms beacons have 1.52 and 1.14 at the least,
painted things and screens seldom so much."""
ROOM_SHARE = 0.9
DARK = 50.0
"""Grey level of nine tenths of an image that shows little else than lights."""
PAINTED = "of the beacon's colour, but no brighter than things that the room lights"
CUT = "of the beacon's colour, but cut by the edge of something nearly white"
HEADROOM_SHARE = 0.25
"""What a clipped light can still add on the brighter side of an edge, as a share of what it can on the darker one,
below which one half of it is taken for the whole."""
RIM_PX = 3.0
RING = 0.125 * np.pi * np.arange(16)
SMOOTH = 0.8
"""Mean step to the next pixel over that to the one after it, below which colours were interpolated; 1: white noise."""
INTERPOLATED_PX = 0.06
"""Standard deviation per coordinate of a light's centre of which the fit does not know where a camera interpolated its
colours and stored them at half size: what simulated webcams leave (compression, sharpening and mosaic)."""
UNEVEN = (0.3, 0.85)
"""Standard deviation in radii for a background as uneven as half of the light's height: where the colours are measured
in each pixel, and where they were interpolated. With these the 95 % ellipsoids of positions before simulated rooms hold
96 % of 121 with machine cameras and 93 % of 120 with webcams."""
TONE = 0.3
"""The same for a background uneven in brightness, through the tone curve of sRGB: 0.6 px of 3.5."""
HALF_HEIGHT = 1.18
"""Radius at half of its height of a Gaussian light over its standard deviation."""


def coloured_candidates(image: Image, settings: SpotSettings, pace: Pace) -> Candidates:
    """Return what may be a beacon of settings.colour in a BGR image (h, w, 3); see find_candidates.

    The signal that is searched and measured is a pixel's projection on the colour's hue, FLOOR for any grey. What
    stands out in it is a candidate where what it adds to its background is of the colour, and where it is a light.
    """
    bgr = _coloured_image(image)
    checked_mask(settings, bgr)
    raised, room_level = hue_signal(bgr, settings)
    plain = _plain(settings)
    signal = searchable(raised, plain)
    areas, state, survey, outcome = locate(signal, plain.mask_bytes, plain.options)
    quiet = bool(
        room_level <= DARK and outcome == FULL and is_dark(areas, state, plain) and is_quiet(state, plain.max_spots)
    )
    complete = True
    if not quiet:
        areas, complete = _coloured_blobs(signal, plain, pace)
        state = fresh_state(len(areas))
    interpolated = _interpolated(signal)
    refused = _leave_lights(bgr, signal, areas, state, settings, room_level, interpolated)

    def fit(chosen: Index, others: int) -> Spots:
        own = state.copy() if quiet else only(state, chosen, others)
        spots = _widened(record(*measured(signal, plain, areas, own, survey)), bgr, signal, interpolated)
        return dataclasses.replace(spots, rejected=spots.rejected + refused) if refused else spots

    return Candidates(areas=areas, state=state, fit=fit, quiet=quiet, complete=complete)


def track_coloured(
    image: Image, predicted: Array, half_window_px: float, settings: SpotSettings
) -> tuple[Spots, Index]:
    """Return the beacon nearest to each of predicted (n, 2) within half_window_px, and the prediction of each."""
    bgr = _coloured_image(image)
    checked_mask(settings, bgr)
    signal = np.full(bgr.shape[:2], np.uint8(FLOOR))
    reach, boxes = half_window_px + MARGIN_PX, []
    for u, v in predicted:
        low = np.clip(np.rint([v - reach, u - reach]), 0, signal.shape).astype(int)
        high = np.clip(np.rint([v + reach + 1.0, u + reach + 1.0]), 0, signal.shape).astype(int)
        box = np.s_[low[0] : high[0], low[1] : high[1]]
        if min(high - low) > 0:
            signal[box] = hue_signal(np.ascontiguousarray(bgr[box]), settings)[0]
            boxes.append(box)
    signal.setflags(write=False)  # as in coloured_candidates: one compilation serves both
    spots, of = track_grey(signal, predicted, half_window_px, _plain(settings))
    interpolated = any(_interpolated(signal[box]) for box in boxes)
    spots = _widened(spots, bgr, signal, interpolated)
    room_level = float(np.quantile(brightest(bgr[::SPARSE, ::SPARSE]), ROOM_SHARE)) if len(spots) else 0.0
    about = [_box_of(spots, i, signal) for i in range(len(spots))]
    kept = [i for i, box in enumerate(about) if _is_light(bgr, signal, box, settings, room_level, interpolated)]
    return (spots, of) if len(kept) == len(spots) else (spots.take(kept), of[kept])


def hue_signal(bgr: Image, settings: SpotSettings) -> tuple[Image, float]:
    """Return BGR's projection on the middle of the colour's hues: FLOOR for grey, 255 for two clipped channels.

    The number is the level that most of the image's pixels stay below in their brightest channel, no clipped ones.
    """
    low, high = (settings.colour or ANY).hue_deg
    middle = np.deg2rad(low + 0.5 * ((high - low) % 360.0))
    weights = np.rint(ONE * np.cos(middle - np.deg2rad([240.0, 120.0, 0.0])))  # of blue, green, red
    signal = np.empty(bgr.shape[:2], np.uint8)
    levels = np.zeros(256, np.int64)
    if colour_signal(bgr, weights.astype(np.int32), int(FLOOR), settings.saturation, signal, levels):
        _fill_cores(bgr, signal, settings)
    return signal, histogram_quantile(levels, CLIPPED_FROM, ROOM_SHARE)


def brightest(bgr: Image) -> Image:
    """Return the brightest channel of the pixels that are not clipped, (n,); one that is dark where all are."""
    top = bgr.max(axis=2)
    top = top[top < CLIPPED_FROM]
    return top if len(top) else np.zeros(1, np.uint8)


def _fill_cores(bgr: Image, signal: Image, settings: SpotSettings) -> None:
    """Raise the signal where a light is so bright that its middle is white."""
    white = np.empty(((signal.shape[0] + 1) // 2, (signal.shape[1] + 1) // 2), np.uint8)
    white_pixels(bgr, settings.saturation, white)
    _, _, found, _ = cv2.connectedComponentsWithStats(white, connectivity=8)
    widest = 2.0 * settings.max_radius_px
    for x, y, w, h, _ in found[1:].tolist():
        if 2 * max(w, h) <= widest:
            fill_white(bgr, settings.saturation, 2 * np.array([x, x + w - 1, y, y + h - 1]), signal)


def _coloured_blobs(signal: Image, plain: SpotSettings, pace: Pace) -> tuple[Array, bool]:
    """Return the blobs (n, COLUMNS) of the signal, grown only from peaks that are coloured."""
    peaks = pyramid_peaks(signal, CONTRAST, plain.max_radius_px)
    x, y = peaks[:, 0], peaks[:, 1]
    half = np.maximum(peaks[:, 2] // 4, 1)
    near = [signal[y, x]]
    near += [signal[np.maximum(y - half, 0), x], signal[y, np.maximum(x - half, 0)]]
    near += [signal[np.maximum(y - half, 0), np.maximum(x - half, 0)]]
    peaks = np.ascontiguousarray(peaks[np.max(near, axis=0) >= LEAST_SIGNAL])
    table = np.empty((MOST, col.COLUMNS))
    n, looked, _ = grow_blobs(
        (signal, np.uint8(0), plain.saturation, plain.mask_bytes),
        peaks,
        (CONTRAST, float(plain.min_pixels), plain.max_radius_px),
        table,
        pace.most(MOST_GROWN, GROWN_S, GROWN_SHARE),
    )
    return table[:n], bool(looked == len(peaks))


def _interpolated(signal: Image) -> bool:
    """Tell whether colours were interpolated: neighbouring pixels differ less than those further apart."""
    rows = signal[::4].astype(np.int16)
    if rows.shape[1] < 3:
        return False
    near, far = (np.minimum(np.abs(rows[:, k:] - rows[:, :-k]), 8).mean() for k in (1, 2))
    return bool(near < SMOOTH * far)


def _widened(spots: Spots, bgr: Image, signal: Image, interpolated: bool) -> Spots:
    """Return the spots with what no residual shows in their covariances: colours made up, and an uneven background.

    Uneven in the colour, or in brightness alone: an edge between two greys is none in the signal, but a camera's tone
    curve makes the same light less over the brighter of them.
    """
    if not len(spots):
        return spots
    own = INTERPOLATED_PX if interpolated else 0.0
    covariance = np.array(spots.covariance_px2)
    for i, ((u, v), size, model) in enumerate(zip(spots.uv_px, spots.size_px, spots.model, strict=True)):
        radius = float(size) * (1.0 if model in ("ellipse", "centroid") else HALF_HEIGHT)
        shift = UNEVEN[interpolated] * radius * background_unevenness(signal, float(u), float(v), radius)
        reach = int(2.0 * radius) + MARGIN_PX
        x, y = max(int(u) - reach, 0), max(int(v) - reach, 0)
        value = bgr[y : int(v) + reach + 1, x : int(u) + reach + 1].max(axis=2)
        value.setflags(write=False)  # as the signal is: one compilation serves both
        tone = TONE * radius * background_unevenness(value, float(u) - x, float(v) - y, radius)
        covariance[i] += (own**2 + shift**2 + tone**2) * np.eye(2)
    return dataclasses.replace(spots, covariance_px2=covariance)


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


def _leave_lights(
    bgr: Image,
    signal: Image,
    areas: Array,
    state: NDArray[np.int64],
    settings: SpotSettings,
    room_level: float,
    interpolated: bool,
) -> tuple[tuple[float, float, str], ...]:
    """Take out the areas that are no lights of the colour; return those of them that are of the colour, as refused."""
    refused = []
    for i, area in enumerate(areas):
        box = area[[col.X_MIN, col.X_MAX, col.Y_MIN, col.Y_MAX]].astype(np.int64)
        seen = _look(bgr, signal, box, float(area[col.LEVEL]), settings) if area[col.PEAK] >= LEAST_SIGNAL else None
        why = ""
        if seen is not None and _is_coloured(bgr, box, seen, settings):
            if not _glows(seen, settings, room_level, interpolated):
                why = PAINTED
            elif _cut(bgr, box, seen):
                why = CUT
            else:
                continue
        state[i, col.OWNER] = -1
        if state[i, col.STATUS] == ACCEPTED:
            state[i, col.STATUS] = UNUSED
            if why:
                refused.append(
                    (float(area[col.SUM_X] / area[col.WEIGHT]), float(area[col.SUM_Y] / area[col.WEIGHT]), why)
                )
    return tuple(refused)


def _is_light(
    bgr: Image,
    signal: Image,
    box: NDArray[np.int64],
    settings: SpotSettings,
    room_level: float,
    interpolated: bool,
) -> bool:
    """Tell whether what is in box is a light of the colour."""
    part = signal[box[2] : box[3] + 1, box[0] : box[1] + 1]
    seen = _look(bgr, signal, box, 0.5 * (FLOOR + float(part.max())), settings)
    light = _is_coloured(bgr, box, seen, settings) and _glows(seen, settings, room_level, interpolated)
    return light and not _cut(bgr, box, seen)


def _cut(bgr: Image, box: NDArray[np.int64], seen: Array) -> bool:
    """Tell whether a clipped light lies across the edge of what is nearly as bright: one side of it hardly shows."""
    if seen[BRIGHT] < CLIPPED_FROM:
        return False
    centre, reach = 0.5 * np.array([box[0] + box[1], box[2] + box[3]]), 0.5 * np.hypot(*(box[[1, 3]] - box[[0, 2]]))
    x, y = centre[:, None] + (reach + RIM_PX) * np.array([np.cos(RING), np.sin(RING)])
    columns, rows = np.clip(np.rint(x), 0, bgr.shape[1] - 1), np.clip(np.rint(y), 0, bgr.shape[0] - 1)
    headroom = 255.0 - bgr[rows.astype(int), columns.astype(int)].max(axis=1)
    low, high = np.quantile(headroom, (0.25, 0.75))
    return bool(low < HEADROOM_SHARE * high)


def _box_of(spots: Spots, i: int, signal: Image) -> NDArray[np.int64]:
    """Return the pixels about a spot: x first, x last, y first, y last."""
    r, (u, v) = max(round(float(spots.size_px[i])), 1), np.rint(spots.uv_px[i]).astype(int)
    h, w = signal.shape
    x, y = np.clip([u - r, u + r], 0, w - 1), np.clip([v - r, v + r], 0, h - 1)
    return np.array([*x, *y], np.int64)


def _look(bgr: Image, signal: Image, box: NDArray[np.int64], level: float, settings: SpotSettings) -> Array:
    seen = np.empty(LOOK)
    measure_colour(bgr, signal, box, level, FLOOR, settings.saturation, seen)
    return seen


def _is_coloured(bgr: Image, box: NDArray[np.int64], seen: Array, settings: SpotSettings) -> bool:
    """Tell whether something is of the colour: in what it adds to its background, or as it is."""
    definition = _definition(settings)
    if settings.threshold is not None:
        pixels = float((box[1] - box[0] + 1) * (box[3] - box[2] + 1))
        return bool(coloured_pixels(bgr, definition, box) >= max(COLOURED_SHARE * pixels, 1.0))
    if seen[BRIGHT] < definition[LEAST_VALUE]:
        return False
    definition[LEAST_VALUE], definition[LEAST_SATURATION] = 0.0, max(definition[LEAST_SATURATION], PURE)
    rise = float(seen[:3].max())
    added = rise >= LEAST_RISE and seen[:3].min() >= -REPLACED * rise
    return bool((added and _matches(seen[:3], definition)) or _matches(seen[OWN : OWN + 3], definition))


def _matches(bgr: Array, definition: Array) -> bool:
    b, g, r = (int(v) for v in np.rint(16.0 * np.maximum(bgr, 0.0)))
    return bool(matches(b, g, r, definition))


def _glows(seen: Array, settings: SpotSettings, room_level: float, interpolated: bool) -> bool:
    """Tell whether something is brighter than what the room lights, or than the threshold that is given."""
    if settings.threshold is not None:
        return bool(seen[BRIGHT] > settings.threshold)
    room = max(room_level, float(seen[LOCAL]))
    return bool(seen[BRIGHT] >= CLIPPED_FROM or seen[BRIGHT] > GLOWS[interpolated] * room)
