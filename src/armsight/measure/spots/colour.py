"""Beacons found by their colour (Kapucu and Baysec 2005: search by bisection, a window, the weighted centroid)."""

from __future__ import annotations

import dataclasses

import cv2
import numpy as np
from numpy.typing import NDArray

from armsight.errors import BadImage
from armsight.measure.settings import SpotSettings
from armsight.measure.spots.grey import MODEL_NAMES, Array, Image, checked_mask, not_an_image, rejections, track_grey
from armsight.measure.spots.kernels.area import AS_CENTROID, BORDER, LARGE, MANY, SMALL
from armsight.measure.spots.kernels.colour import colour_centroid, coloured_regions
from armsight.measure.spots.kernels.scan import AREA, COLUMNS, SUM_X, SUM_Y, X_MAX, X_MIN, Y_MAX, Y_MIN
from armsight.records import Colour, Spots

MOST_REGIONS = 1024
ANY = Colour(hue_deg=(0.0, 360.0))
MARGIN_PX = 16
"""Background around a region that the fit of its light sees."""
FLOOR = 32.0
"""Grey level of no colour in the signal: were it 0, half of the background's noise would be clipped."""
CENTROID_NOISE = 9.0
"""Noise variance (grey levels^2) of the signal that a centroid is claimed with: 8-bit video after demosaicing."""


def find_coloured(image: Image, settings: SpotSettings) -> Spots:
    """Return the beacons of settings.colour in a BGR image (h, w, 3); see find_spots.

    The signal that is measured is a pixel's projection on the colour's hue, zero for any grey. Where the model of a
    light fits it, centre and covariance are that fit's; else the centroid weighted with the signal.
    """
    bgr = _coloured_image(image)
    regions = _regions(bgr, checked_mask(settings, bgr), settings)
    return _measured(bgr, settings, regions)[0]


def track_coloured(
    image: Image, predicted: Array, half_window_px: float, settings: SpotSettings
) -> tuple[Spots, NDArray[np.intp]]:
    """Return the beacon nearest to each of predicted (n, 2) within half_window_px, and the prediction of each."""
    bgr = _coloured_image(image)
    mask = checked_mask(settings, bgr)
    windows = np.zeros(bgr.shape[:2], np.uint8)
    for u, v in predicted:
        low = np.maximum(np.rint([v - half_window_px, u - half_window_px]).astype(int), 0)
        high = np.maximum(np.rint([v + half_window_px, u + half_window_px]).astype(int) + 1, 0)
        windows[low[0] : high[0], low[1] : high[1]] = 1
    regions = _regions(bgr, windows & mask if mask.size else windows, settings)
    owner = _owners(_centres(regions), predicted, half_window_px)
    spots, of = _measured(bgr, settings, regions[owner >= 0])
    return spots, owner[owner >= 0][of]


def _coloured_image(image: Image) -> Image:
    if not isinstance(image, np.ndarray) or image.dtype != np.uint8 or image.size == 0 or image.ndim not in (2, 3):
        raise not_an_image(image)
    if image.ndim == 2 or image.shape[2] != 3:
        raise BadImage(
            f"an image of shape {image.shape} has no colours",
            consequence="A beacon cannot be found by its colour in it",
            cure="Record in colour, or leave the colour out of the target",
        )
    return np.ascontiguousarray(image)


def _definition(settings: SpotSettings) -> Array:
    """Return the colour as the kernels want it: hue from, to in degrees, saturation 0..1, value 0..255."""
    colour = settings.colour or ANY
    return np.array([*colour.hue_deg, colour.min_saturation, 255.0 * colour.min_value])


def _regions(bgr: Image, mask: NDArray[np.uint8], settings: SpotSettings) -> Array:
    """Return the regions (n, COLUMNS) of the colour."""
    table = np.empty((MOST_REGIONS, COLUMNS))
    n = coloured_regions(bgr, mask, _definition(settings), table)
    return table[:n]


def _centres(regions: Array) -> Array:
    """Return the regions' unweighted centres (n, 2)."""
    return regions[:, [SUM_X, SUM_Y]] / regions[:, [AREA]]


def _owners(centres: Array, predicted: Array, reach_px: float) -> NDArray[np.intp]:
    """Return for each centre (m, 2) the prediction whose nearest it is, or -1."""
    owner = np.full(len(centres), -1, dtype=np.intp)
    away = np.linalg.norm(centres[:, None] - predicted[None], axis=2)  # (m, n)
    for k in range(len(predicted) if len(centres) else 0):
        i = int(away[:, k].argmin())
        if away[i, k] <= reach_px * np.sqrt(2.0) and (owner[i] < 0 or away[i, k] < away[i, owner[i]]):
            owner[i] = k
    return owner


def _verdict(region: Array, rank: int, settings: SpotSettings, height: int, width: int) -> int:
    """Return 0, or the number of the reason why a region is refused; rank: how many regions are larger."""
    if region[AREA] < settings.min_pixels:
        return SMALL
    if region[X_MIN] < 1 or region[Y_MIN] < 1 or region[X_MAX] > width - 2 or region[Y_MAX] > height - 2:
        return BORDER
    if max(region[X_MAX] - region[X_MIN], region[Y_MAX] - region[Y_MIN]) > 2.0 * settings.max_radius_px:
        return LARGE
    return MANY if rank >= settings.max_spots else 0


def _measured(bgr: Image, settings: SpotSettings, regions: Array) -> tuple[Spots, NDArray[np.intp]]:
    """Return the regions' spots, and which region each is."""
    ranks = np.argsort(np.argsort(-regions[:, AREA], kind="stable"))
    found: list[Spots] = []
    of: list[int] = []
    refused: list[tuple[float, float, float]] = []
    for i, (region, centre, rank) in enumerate(zip(regions, _centres(regions), ranks, strict=True)):
        why = _verdict(region, int(rank), settings, *bgr.shape[:2])
        if why:
            refused.append((float(centre[0]), float(centre[1]), float(why)))
            continue
        found.append(_measure_region(bgr, settings, region, centre))
        of.append(i)
    spots = Spots(
        uv_px=np.concatenate([s.uv_px for s in found]) if found else np.empty((0, 2)),
        covariance_px2=np.concatenate([s.covariance_px2 for s in found]) if found else np.empty((0, 2, 2)),
        peak=np.concatenate([s.peak for s in found]) if found else np.empty(0),
        size_px=np.concatenate([s.size_px for s in found]) if found else np.empty(0),
        model=tuple(s.model[0] for s in found),
        rejected=rejections(np.array(refused).reshape(-1, 3)),
    )
    return spots, np.array(of, dtype=np.intp)


def _measure_region(bgr: Image, settings: SpotSettings, region: Array, centre: Array) -> Spots:
    """Return the one spot of a region: the fit of a light to its signal where that works, else its centroid."""
    x0, y0 = max(int(region[X_MIN]) - MARGIN_PX, 0), max(int(region[Y_MIN]) - MARGIN_PX, 0)
    box = np.s_[y0 : int(region[Y_MAX]) + MARGIN_PX + 1, x0 : int(region[X_MAX]) + MARGIN_PX + 1]
    crop = bgr[box]
    signal = hue_signal(crop, settings)
    mask = None if settings.mask is None else settings.mask[box]
    plain = dataclasses.replace(settings, colour=None, mask=mask, threshold=None, inverted=False, saturation=255)
    corner = np.array([x0, y0], float)
    reach = float(max(crop.shape[:2]))
    fitted, _ = track_grey(signal, np.array([centre - corner]), reach, plain)
    size = np.array([region[X_MAX] - region[X_MIN], region[Y_MAX] - region[Y_MIN]]) + 1.0
    if len(fitted) == 1 and np.all(np.abs(fitted.uv_px[0] + corner - centre) < 0.25 * size + 0.5):
        return dataclasses.replace(fitted, uv_px=fitted.uv_px + corner, rejected=())
    return _centroid(bgr, settings, signal, region, x0, y0)


def hue_signal(bgr: Image, settings: SpotSettings) -> Image:
    """Return the projection of BGR on the middle of the colour's hue range: FLOOR for grey, 255 where clipped."""
    low, high = (settings.colour or ANY).hue_deg
    middle = np.deg2rad(low + 0.5 * ((high - low) % 360.0))
    weights = np.cos(middle - np.deg2rad([240.0, 120.0, 0.0]))  # of blue, green, red
    affine = np.append(weights, FLOOR)[None, :]
    signal = np.asarray(cv2.transform(bgr, affine), dtype=np.uint8)  # rounds, and stops at 0 and 255
    clipped = (bgr >= settings.saturation).any(axis=2) & (signal > FLOOR)
    signal[clipped] = 255
    return signal


def _centroid(bgr: Image, settings: SpotSettings, signal: Image, region: Array, x0: int, y0: int) -> Spots:
    """Return the centroid of the colour's pixels, weighted with the signal, with its covariance."""
    out = np.zeros(6)
    u, v = _centres(region[None])[0]
    if not colour_centroid(bgr, settings.mask_bytes, _definition(settings), signal, FLOOR, x0, y0, CENTROID_NOISE, out):
        out[:] = u, v, 0.25, 0.0, 0.25, 0.0
    return Spots(
        uv_px=out[None, :2],
        covariance_px2=np.array([[[out[2], out[3]], [out[3], out[4]]]]),
        peak=out[5:],
        size_px=np.sqrt(region[[AREA]] / np.pi),
        model=(MODEL_NAMES[AS_CENTROID],),
    )
