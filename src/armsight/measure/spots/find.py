"""Spots of an image: the public calls."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from armsight.errors import Inconsistent
from armsight.measure.settings import DEFAULTS, SpotSettings
from armsight.measure.spots.candidates import Candidates
from armsight.measure.spots.colour import coloured_candidates, track_coloured
from armsight.measure.spots.grey import Image, grey_candidates, track_grey
from armsight.measure.spots.seed import seeded_candidates, track_seeded
from armsight.records import Spots
from armsight.records.target import RED


def find_spots(image: Image, settings: SpotSettings = DEFAULTS) -> Spots:
    """Return all spots of an image (h, w) grey or (h, w, 3) BGR, searched without prior.

    Centres are in px with the centre of the top-left pixel at (0, 0), each with its 2x2 covariance. What was seen
    and not accepted is in `rejected`, with the reason; an image without spots gives an empty record.
    With settings.method 'seed' they are found as Pachidis 2005 did (section 4, figure 6).
    With settings.colour the spots are areas of that colour in a BGR image (Kapucu and Baysec 2005).
    Raises BadImage where the image is not 8-bit grey or BGR (BGR, where a colour is searched), Inconsistent where
    the mask has another size.
    """
    found = find_candidates(image, settings)
    if found.room:
        found = find_candidates(image, settings, faint=True)
    return found.measure_strongest(settings.max_spots)


def find_candidates(image: Image, settings: SpotSettings = DEFAULTS, *, faint: bool = False) -> Candidates:
    """Return what may be a light in an image, each with a coarse centre, to be measured on demand; see find_spots.

    faint: take nothing for quiet, and look for those that hardly stand out as well.
    """
    if settings.colour is not None:
        return coloured_candidates(image, settings)
    if settings.method == "seed":
        return seeded_candidates(image, settings)
    return grey_candidates(image, settings, faint)


def track_spots(
    image: Image, predicted_uv_px: ArrayLike, half_window_px: float, settings: SpotSettings = DEFAULTS
) -> tuple[Spots, NDArray[np.intp]]:
    """Return the spots in windows around predicted_uv_px (n, 2), and the prediction that each belongs to.

    In each window of half_window_px to either side, the bright area nearest to the prediction is measured as in
    find_spots; two predictions never share one. A prediction whose window is dark, or whose spot was rejected, has
    no entry. Touching spots give two spots of the same prediction. Raises as find_spots, and Inconsistent where
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
    return track_grey(image, predicted, half_window_px, settings)


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
        track_spots(image, [[60.0, 50.0]], 16.0, settings)
