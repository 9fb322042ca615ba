"""A coloured beacon before a room: which light of its colour it is, or why no one can tell."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from armsight.measure.match import Match, Pairs, Prediction, match_few
from armsight.measure.setup import Setup
from armsight.measure.spots.colour import PAINTED
from armsight.records import Spots

GAUSSIAN_RADIUS = 1.18
"""Radius at half of its height of a Gaussian light over its deviation."""
WRONG_SIZE = 1.6
LESS_PX, MORE_PX = 1.0, 2.0
"""Ratio and px by which a beacon may look smaller or larger than its diameter says: tilt, blur and bloom."""


def match_beacon(
    setup: Setup, left: Spots, right: Spots, pairs: Pairs, prediction: Prediction | None, *, alone: bool
) -> Match:
    """Return the one pair that may be the beacon before a room; else none, with cause and cure.

    Of several lights of the colour, one is taken where a track expects it, or where it alone is of the beacon's size.
    The only light of the colour is taken where something besides its colour tells it: its size, a track, or a mask or a
    threshold of the caller's; where the beacon is hidden, a room's lamp would be the only one. alone: nothing but
    lights is bright, or the caller has chosen the spots.
    """
    if not len(pairs.index):
        return Match(best=None, why=_nothing(left, right))
    sizes = [_radius_px(spots, pairs.index[:, side]) for side, spots in enumerate((left, right))]
    known = setup.model.radius_m > 0.0
    if known:
        fits = _of_size(setup, pairs, sizes)
        if not fits.any():
            return Match(best=None, why=f"{_lights(pairs)} seen, not of the size that diameter_m in target.yaml says")
        pairs, sizes = _only(pairs, fits), [size[fits] for size in sizes]
    match = match_few(setup.model, pairs, known=setup.target.model_known, prediction=prediction)
    if match.best is None or len(match.best.pair) > 1:
        of_size = " and of its diameter_m" if known else ""
        cure = "cover or mask the others (--mask)" + ("" if known else ", or give diameter_m in target.yaml")
        return Match(best=None, why=f"{_lights(pairs)} seen{of_size}, and any could be the beacon: {cure}")
    told = alone or known or match.predicted or setup.settings.mask is not None or setup.settings.threshold is not None
    if not told:
        return Match(
            best=None,
            why="one light of the beacon's colour is seen, and a lamp of the room would look the same: give "
            "diameter_m in target.yaml, or mask what is not the beacon (--mask)",
        )
    return match


def _nothing(left: Spots, right: Spots) -> str:
    """Return why there is no pair."""
    if len(left) and len(right):
        return (
            "no light of the beacon's colour in the left image agrees with one in the right image (epipolar distance)"
        )
    where = "either image" if not len(left) and not len(right) else f"the {'right' if len(left) else 'left'} image"
    if any(why == PAINTED for spots in (left, right) for _, _, why in spots.rejected):
        return (
            f"no light of the beacon's colour in {where}: what has its colour is no brighter than things that the room "
            "lights; a beacon must glow (light it, or lower the exposure), or tell its grey level with --threshold"
        )
    return f"no light of the beacon's colour in {where}"


def _lights(pairs: Pairs) -> str:
    n = min(len(np.unique(pairs.index[:, side])) for side in range(2))
    return f"{n} light{'s' if n > 1 else ''} of the beacon's colour {'are' if n > 1 else 'is'}"


def _radius_px(spots: Spots, index: NDArray[np.intp]) -> NDArray[np.float64]:
    """Return the radius (n,) at half of their height of the spots of index."""
    flat = np.array([model in ("ellipse", "centroid") for model in spots.model])
    return np.asarray((spots.size_px * np.where(flat, 1.0, GAUSSIAN_RADIUS))[index])


def _of_size(setup: Setup, pairs: Pairs, sizes: list[NDArray[np.float64]]) -> NDArray[np.bool_]:
    """Tell of the pairs (c,) whether they are as large as the beacon would be where they meet."""
    good = np.ones(len(pairs.index), np.bool_)
    for side, size in enumerate(sizes):
        depth = pairs.xyz_m @ setup.packed.R[side][2] + setup.packed.t[side][2]
        whole = setup.packed.k[side][0] * setup.model.radius_m / depth
        good &= (size >= whole / WRONG_SIZE - LESS_PX) & (size <= WRONG_SIZE * whole + MORE_PX)
    return good


def _only(pairs: Pairs, kept: NDArray[np.bool_]) -> Pairs:
    return replace(
        pairs,
        index=pairs.index[kept],
        uv_px=pairs.uv_px[kept],
        cov_px2=pairs.cov_px2[kept],
        xyz_m=pairs.xyz_m[kept],
        cov_m2=pairs.cov_m2[kept],
    )
