"""Spots of an image: the public calls. Also as Pachidis 2005 finds them.

That is: threshold, mask, inversion, a seed by the cross, propagation, the mean.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from armsight.arrays import Array, Image, Index
from armsight.errors import Inconsistent
from armsight.measure.settings import BATCH, DEFAULTS, Pace, SpotSettings
from armsight.measure.spots.colour import coloured_candidates, track_coloured
from armsight.measure.spots.grey import (
    FIT_S,
    Candidates,
    Part,
    fresh_state,
    grey_candidates,
    searchable,
    track_grey,
    whole_frame,
)
from armsight.measure.spots.kernels import columns as col
from armsight.measure.spots.kernels.peaks import shapes
from armsight.records import Spots
from armsight.records.target import RED

FOUND_SHARE = 0.3
"""Share of a deadline that is for measuring all that is found in an image."""


def find_spots(image: Image, settings: SpotSettings = DEFAULTS, pace: Pace = BATCH) -> Spots:
    """Return all spots of an image (h, w) grey or (h, w, 3) BGR, searched without prior.

    Centres are in px with the centre of the top-left pixel at (0, 0), each with its 2x2 covariance. What was seen
    and not accepted is in `rejected`, with the reason; an image without spots gives an empty record.
    With settings.method 'seed' they are found as Pachidis 2005 did (section 4, figure 6).
    With settings.colour the spots are areas of that colour in a BGR image (Kapucu and Baysec 2005).
    pace: fewer of the strongest are measured where there is no time for settings.max_spots.
    Raises BadImage where the image is not 8-bit grey or BGR (BGR, where a colour is searched), Inconsistent where
    the mask has another size.
    """
    found = find_candidates(image, settings, pace)
    if found.room:
        found = found.closer()
    return found.measure_strongest(pace.most(settings.max_spots, FIT_S, FOUND_SHARE))


def find_candidates(
    image: Image, settings: SpotSettings = DEFAULTS, pace: Pace = BATCH, part: Part | None = None
) -> Candidates:
    """Return what may be a light in an image, each with a coarse centre, to be measured on demand; see find_spots.

    part: to which the search is confined where grey lights are before a room.
    """
    if settings.colour is not None:
        return coloured_candidates(image, settings, pace)
    if settings.method == "seed":
        return seeded_candidates(image, settings)
    return grey_candidates(image, settings, pace, part)


def track_spots(
    image: Image,
    predicted_uv_px: ArrayLike,
    half_window_px: float,
    settings: SpotSettings = DEFAULTS,
    *,
    grown: bool = False,
) -> tuple[Spots, Index]:
    """Return the spots in windows around predicted_uv_px (n, 2), and the prediction that each belongs to.

    In each window of half_window_px to either side, the bright area nearest to the prediction is measured as in
    find_spots; two predictions never share one. A prediction whose window is dark, or whose spot was rejected, has
    no entry. Touching spots give two spots of the same prediction. grown: a grey light that hangs together with what
    it stands before is then grown from its peak. Raises as find_spots, and Inconsistent where
    the predictions are not an (n, 2) array of finite numbers or the window is empty.
    """
    predicted = np.ascontiguousarray(predicted_uv_px, dtype=np.float64)
    if predicted.ndim != 2 or predicted.shape[1] != 2 or not np.isfinite(predicted).all():
        raise Inconsistent("predicted spots are not rows of two finite pixel coordinates")
    if not 1.0 <= half_window_px < 1e6:
        raise Inconsistent(f"a window of {half_window_px:g} px to either side is not 1 px or more")
    if settings.colour is not None:
        return track_coloured(image, predicted, half_window_px, settings)
    if settings.method == "seed":
        return track_seeded(image, predicted, half_window_px, settings)
    return track_grey(image, predicted, half_window_px, settings, grown=grown)


def warm_up() -> None:
    """Compile (or load from the cache) all that find_spots and track_spots run, so that no later call waits for it."""
    y, x = np.mgrid[0:96, 0:128]
    spot = 150.0 * np.exp(-((x - 60.3) ** 2 + (y - 50.2) ** 2) / 8.0)
    disc = np.where((x - 20.0) ** 2 + (y - 20.0) ** 2 < 25.0, 99.0, 0.0)
    grey = (10.0 + spot + disc).astype(np.uint8)
    red = np.stack([0 * grey, 0 * grey, grey], axis=2)
    room = np.minimum(red.astype(np.int64) + 80, 255).astype(np.uint8)
    room[80:84, 10:14] = 255
    for settings, image in ((DEFAULTS, grey), (SpotSettings(colour=RED), red), (SpotSettings(colour=RED), room)):
        find_spots(image, settings)
        track_spots(image, [[60.0, 50.0], [9.0, 86.0]], 16.0, settings, grown=True)


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
    areas = np.zeros((len(spots), col.COLUMNS))
    areas[:, col.WEIGHT] = 1.0
    areas[:, [col.SUM_X, col.SUM_Y]] = spots.uv_px
    areas[:, col.PEAK] = spots.peak
    areas[:, col.AREA] = np.pi * spots.size_px**2
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


def track_seeded(image: Image, predicted: Array, half_window_px: float, settings: SpotSettings) -> tuple[Spots, Index]:
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
