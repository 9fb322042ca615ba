"""A coloured beacon before a room: which light of its colour it is, or why no one can tell."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from armsight.errors import Unseen
from armsight.measure.poses.assignment import Match, Prediction
from armsight.measure.poses.few_lights import match_few
from armsight.measure.poses.pairs import Pairs
from armsight.measure.poses.setup import Setup
from armsight.measure.spots.colour import CUT, PAINTED
from armsight.records import Spots

GAUSSIAN_RADIUS = 1.18
"""Radius at half of its height of a Gaussian light over its standard deviation."""
SMALLER, LESS_PX, LARGER, MORE_PX = 1.25, 0.25, 1.5, 0.5
"""Ratios and px by which a beacon may look smaller (tilt) or larger (bloom, blur) than its diameter says."""
MIN_RADIUS_PX = 2.5
"""From this radius a beacon's size tells it from a lamp; smaller, blur makes all lights look alike."""


def match_beacon(
    setup: Setup, left: Spots, right: Spots, pairs: Pairs, prediction: Prediction | None, *, alone: bool
) -> Match:
    """Return the one pair that may be the beacon before a room; else none, with cause and cure.

    alone: nothing but lights is bright, or the caller has chosen the spots. There, and with a mask or a threshold of
    the caller's, of several lights of the colour the one of the beacon's size is taken. Else a light is taken where a
    track expects it, or where it is the only one of the colour and has a size that can be seen: where the beacon is
    hidden a room's lamp would be the only one, and where there is one lamp of its colour there may be one of its size.
    """
    if not len(pairs.index):
        return Match(best=None, why=_nothing(left, right), cause=Unseen.UNPAIRED)
    chosen = alone or setup.settings.mask is not None or setup.settings.threshold is not None
    sizes = np.array([_radius_px(spots, pairs.index[:, side]) for side, spots in enumerate((left, right))])
    known = setup.model.radius_m > 0.0
    kept = np.arange(len(pairs.index))
    if known:
        wanted = _wanted_px(setup, pairs)
        fits = np.all((sizes >= wanted / SMALLER - LESS_PX) & (sizes <= LARGER * wanted + MORE_PX), axis=0)
        if not fits.any():
            why = f"{_lights(pairs)} seen, not of the size that diameter_m in target.yaml says"
            return Match(best=None, why=why, cause=Unseen.WRONG_TARGET)
        pairs, wanted, kept = _only(pairs, fits), wanted[:, fits], np.flatnonzero(fits)
    match = match_few(setup.model, pairs, known=setup.target.model_known, prediction=prediction)
    if match.best is None or len(match.best.pair) > 1:
        of_size = " and of its diameter_m" if known else ""
        cure = "cover or mask the others (--mask)" + ("" if known else ", or give diameter_m in target.yaml")
        why = f"{_lights(pairs)} seen{of_size}, and any could be the beacon: {cure}"
        return Match(best=None, why=why, cause=Unseen.AMBIGUOUS)
    if not (chosen or match.predicted):
        why = _untold(max(len(left), len(right)), float(wanted.min()) if known else None)
        if why:
            return Match(best=None, why=why, cause=Unseen.AMBIGUOUS)
    return replace(match, best=replace(match.best, pair=kept[match.best.pair]))


def _untold(lights: int, radius_px: float | None) -> str:
    """Return why nothing tells the only light of its size from a room's lamp; empty where something does."""
    if lights > 1:
        return (
            f"{lights} lights of the beacon's colour are seen, and where there is one lamp of its colour there may be "
            "one of its size: cover or mask the others (--mask)"
        )
    if radius_px is None:
        return (
            "one light of the beacon's colour is seen, and a lamp of the room would look the same: give diameter_m in "
            "target.yaml, or mask what is not the beacon (--mask)"
        )
    if radius_px < MIN_RADIUS_PX:
        return (
            f"one light of the beacon's colour is seen; with a radius of {radius_px:.1f} px a lamp of the room would "
            f"look the same: bring it nearer (from {MIN_RADIUS_PX:g} px on its diameter_m tells it), or mask what is "
            "not the beacon (--mask)"
        )
    return ""


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
    if any(why == CUT for spots in (left, right) for _, _, why in spots.rejected):
        return (
            f"the light of the beacon's colour in {where} lies across the edge of something nearly white, of which no "
            "colour is left: move the beacon or the cameras, or lower the exposure"
        )
    return f"no light of the beacon's colour in {where}"


def _lights(pairs: Pairs) -> str:
    n = min(len(np.unique(pairs.index[:, side])) for side in range(2))
    return f"{n} light{'s' if n > 1 else ''} of the beacon's colour {'are' if n > 1 else 'is'}"


def _radius_px(spots: Spots, index: NDArray[np.intp]) -> NDArray[np.float64]:
    """Return the radius (n,) at half of their height of the spots of index."""
    flat = np.array([model in ("ellipse", "centroid") for model in spots.model])
    return np.asarray((spots.size_px * np.where(flat, 1.0, GAUSSIAN_RADIUS))[index])


def _wanted_px(setup: Setup, pairs: Pairs) -> NDArray[np.float64]:
    """Return the radius (2, c) in px that the beacon would have in both images where the pairs meet."""
    depth_m = [pairs.xyz_m @ setup.packed.R[side][2] + setup.packed.t[side][2] for side in range(2)]
    focal_px = [setup.packed.k[side][0] for side in range(2)]
    return np.array([f * setup.model.radius_m / depth for f, depth in zip(focal_px, depth_m, strict=True)])


def _only(pairs: Pairs, kept: NDArray[np.bool_]) -> Pairs:
    return replace(
        pairs,
        index=pairs.index[kept],
        uv_px=pairs.uv_px[kept],
        cov_px2=pairs.cov_px2[kept],
        xyz_m=pairs.xyz_m[kept],
        cov_m2=pairs.cov_m2[kept],
    )
