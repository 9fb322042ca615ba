"""Spots as Pachidis 2005 finds them: threshold, mask, inversion, a seed by the cross, propagation, the mean."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from armsight.measure.settings import SpotSettings
from armsight.measure.spots.candidates import Candidates, fresh_state
from armsight.measure.spots.grey import Array, Image, searchable, whole_frame
from armsight.measure.spots.kernels.scan import AREA, COLUMNS, PEAK, SUM_X, SUM_Y, WEIGHT
from armsight.measure.spots.kernels.seed import shapes
from armsight.records import Spots

ARMS = (4, 2)
"""Pixels of the cross to either side of its middle: 9x9, of which 17 are looked at, or 5x5 where that fits nowhere."""
SHARE = 0.3
"""Share of the way from the background to the brightest pixel at which the threshold lies where none is given."""
LEAST_CONTRAST = 24.0
"""Grey levels above the image's median without which there is no light to set a threshold by."""
CUT, TOO_LARGE = "cut by the border of the image", "too large for a spot"


def seeded_candidates(image: Image, settings: SpotSettings) -> Candidates:
    """Return the shapes of find_seeded; they are measured as they are found.

    Shapes that are too large or cut by the border are of a room: one or two spots beside them are no sure lights.
    """
    spots = find_seeded(image, settings)
    areas = np.zeros((len(spots), COLUMNS))
    areas[:, WEIGHT] = 1.0
    areas[:, [SUM_X, SUM_Y]] = spots.uv_px
    areas[:, PEAK] = spots.peak
    areas[:, AREA] = np.pi * spots.size_px**2
    shapes_refused = sum(why in (CUT, TOO_LARGE) for _, _, why in spots.rejected)
    return Candidates(
        areas=areas,
        state=fresh_state(len(areas)),
        fit=lambda chosen, others: spots.take(np.sort(chosen)),
        quiet=shapes_refused == 0,
        others=shapes_refused,
    )


def find_seeded(image: Image, settings: SpotSettings) -> Spots:
    """Return the shapes in which a cross of 9x9 pixels fits, each with the mean of its pixels (Pachidis 2005).

    A cross of 5x5 is tried where that fits nowhere (its appendix).
    """
    return _seeded(searchable(image, settings), settings)


def track_seeded(
    image: Image, predicted: Array, half_window_px: float, settings: SpotSettings
) -> tuple[Spots, NDArray[np.intp]]:
    """Return the shape nearest to each prediction (n, 2) within half_window_px, and the prediction of each."""
    spots = find_seeded(image, settings)
    if not len(spots):
        return spots, np.empty(0, np.intp)
    far = np.abs(spots.uv_px[:, None] - predicted[None]).max(axis=2)
    owner = far.argmin(axis=1)
    kept = [i for i, k in enumerate(owner) if far[i, k] <= half_window_px and far[:, k][owner == k].min() >= far[i, k]]
    return spots.take(kept), owner[kept]


def _seeded(grey: Image, settings: SpotSettings) -> Spots:
    threshold = settings.threshold
    if threshold is None:
        light = 255.0 - float(grey.min()) if settings.inverted else float(grey.max())
        dark = float(np.median(grey[::4, ::4]))
        dark = 255.0 - dark if settings.inverted else dark
        if light - dark < LEAST_CONTRAST:
            return Spots.none()
        threshold = dark + SHARE * (light - dark)
    most = np.pi * settings.max_radius_px**2
    table = np.empty((0, 7))
    for arm in ARMS:
        table = shapes(grey, settings.mask_bytes, threshold, settings.inverted, arm, most, 4 * settings.max_spots)
        if len(table):
            break
    if not len(table):
        return Spots.none((whole_frame(grey, "no cross of 5x5 pixels fits into what is brighter than the threshold"),))
    good = (table[:, 5] == 0.0) & (table[:, 6] == 0.0)
    size, uv = table[:, 0], table[:, 1:3] / table[:, :1]
    refused = tuple(
        (float(u), float(v), CUT if cut else TOO_LARGE) for (u, v), cut in zip(uv[~good], table[~good, 5], strict=True)
    )
    radius = np.sqrt(size[good] / np.pi)
    # each pixel of the edge is in or out by chance, 1/12 px^2 across it: 1 / (12 pi r) of the mean
    variance = 1.0 / (12.0 * np.pi * radius)
    return Spots(
        uv_px=uv[good],
        covariance_px2=variance[:, None, None] * np.eye(2),
        peak=table[good, 4],
        size_px=radius,
        model=("centroid",) * int(good.sum()),
        rejected=refused,
    )
