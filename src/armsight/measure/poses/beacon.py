"""Names for lights whose arrangement does not tell them: few of them, or a coloured beacon before a room.

They are told by their order in the image, by where they are expected, by their colour, or no one can tell: then why.
And what stands still while the target moves is not the target: lamps, screens and reflections before a standing rig.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import scipy  # loads its spatial search where it is used
from numpy.typing import NDArray

from armsight.arrays import Array, Index, Mask
from armsight.errors import Unseen
from armsight.measure.poses.kernels import correspondence as kernels
from armsight.measure.poses.outcome import PREDICTION_RATIO, Assignment, Match, Prediction
from armsight.measure.poses.pairs import PAIR_GATE, Pairs, disjoint_sets, overlaid_triples
from armsight.measure.poses.setup import Setup, TargetModel
from armsight.measure.spots.colour import CUT, PAINTED
from armsight.records import Spots

GAUSSIAN_RADIUS = 1.18
"""Radius at half of its height of a Gaussian light over its standard deviation."""
SMALLER, LESS_PX, LARGER, MORE_PX = 1.25, 0.25, 1.5, 0.5
"""Ratios and px by which a beacon may look smaller (tilt) or larger (bloom, blur) than its diameter says."""
OBLIQUE = 3.0
"""By how much a flat light looks smaller to a camera 70 degrees aside: what is smaller still is none."""

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
    known = setup.model.radius_m > 0.0
    kept = np.arange(len(pairs.index))
    if known:
        sizes, wanted = _radii_px(setup, left, right, pairs)
        fits = np.all((sizes >= wanted / SMALLER - LESS_PX) & (sizes <= LARGER * wanted + MORE_PX), axis=0)
        if not fits.any():
            why = f"{_lights(pairs)} seen, not of the size that diameter_m in target.yaml says"
            return Match(best=None, why=why, cause=Unseen.WRONG_TARGET)
        pairs, wanted, kept = _only(pairs, fits), wanted[:, fits], np.flatnonzero(fits)
    match = match_few(setup.model, pairs, known=setup.target.model_known, prediction=prediction)
    if match.best is None or len(match.best.pair) > 1:
        of_size = " and of its diameter_m" if known else ""
        by_size = chosen and not known  # of several lights that nobody chose, a size tells none
        cure = "cover or mask the others (--mask)" + (", or give diameter_m in target.yaml" if by_size else "")
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


def _radius_px(spots: Spots, index: Index) -> NDArray[np.float64]:
    """Return the radius (n,) at half of their height of the spots of index."""
    flat = np.array([model in ("ellipse", "centroid") for model in spots.model])
    return np.asarray((spots.size_px * np.where(flat, 1.0, GAUSSIAN_RADIUS))[index])


def _radii_px(setup: Setup, left: Spots, right: Spots, pairs: Pairs) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the radius (2, c) in px of each pair's spots, and that which the light would have where they meet."""
    sizes = np.array([_radius_px(spots, pairs.index[:, side]) for side, spots in enumerate((left, right))])
    depth_m = [pairs.xyz_m @ setup.packed.R[side][2] + setup.packed.t[side][2] for side in range(2)]
    focal_px = [setup.packed.k[side][0] for side in range(2)]
    return sizes, np.array([f * setup.model.radius_m / depth for f, depth in zip(focal_px, depth_m, strict=True)])


def _only(pairs: Pairs, kept: Mask) -> Pairs:
    return replace(
        pairs,
        index=pairs.index[kept],
        uv_px=pairs.uv_px[kept],
        cov_px2=pairs.cov_px2[kept],
        xyz_m=pairs.xyz_m[kept],
        cov_m2=pairs.cov_m2[kept],
    )


LABEL_MARGIN_PX = 2.0
"""Lights closer than this in column (or row) have no order in the image that could name them."""

UNMEASURED = (
    "which of them are the target's, one pair of images does not tell, so that no pose is given; measure the target "
    "once (armsight calibrate target), black out the rest (--mask), raise --threshold, or darken the room"
)


def match_by_position(left: Spots, right: Spots, pairs: Pairs) -> Match:
    """Return names for three lights whose arrangement is not known: A left, B lower right, C upper right (MATH 3.2).

    Both images must show the same order, and the pairs it makes must agree with the epipolar constraint. Where one
    image holds both views, there must be one way only to make three pairs of its spots.
    """
    if pairs.overlaid:
        return _overlaid_by_position(left, pairs)
    sides = [np.unique(pairs.index[:, side]) for side in range(2)]
    if len(sides[0]) != 3 or len(sides[1]) != 3:
        n = f"{len(sides[0])} in the left image and {len(sides[1])} in the right one"
        cause = f"a target that has not been measured needs exactly three lights in both views, not {n}"
        more = max(len(side) for side in sides) > 3
        return Match(best=None, why=f"{cause}: {UNMEASURED}" if more else cause, cause=_few(more))
    orders = []
    for spots, seen, name in ((left, sides[0], "left"), (right, sides[1], "right")):
        order = order_by_position(spots.uv_px[seen])
        if order is None:
            return _ambiguous(f"the lights have no clear order left to right in the {name} image")
        orders.append(seen[order])
    rows = []
    for i, j in zip(*orders, strict=True):
        at = np.flatnonzero((pairs.index[:, 0] == i) & (pairs.index[:, 1] == j))
        if not len(at):
            return Match(
                best=None, why="the order of the lights differs between the two images", cause=Unseen.WRONG_TARGET
            )
        rows.append(at[0])
    return Match(best=Assignment(names=("A", "B", "C"), pair=np.array(rows, dtype=np.intp), chi2=0.0))


def by_chance_in_order(pairs: float) -> float:
    """Return how many arrangements of three pairs with one order in both images are expected, of so many by chance.

    They come as a Poisson process: pairs^3 / 3! ways to choose three, of which one in 3! has both orders alike.
    """
    return pairs**3 / 36.0


def _overlaid_by_position(spots: Spots, pairs: Pairs) -> Match:
    triples = overlaid_triples(pairs)
    if len(triples) != 1:
        ways = "more than one way" if triples else "no way"
        why = f"there is {ways} to make three pairs of the {len(spots)} lights of both views"
        return Match(best=None, why=why, cause=Unseen.AMBIGUOUS if triples else Unseen.UNPAIRED)
    rows = np.array(triples[0], dtype=np.intp)
    order = order_by_position(spots.uv_px[pairs.index[rows, 0]])
    if order is None:
        return _ambiguous("the lights have no clear order left to right in the left view")
    return Match(best=Assignment(names=("A", "B", "C"), pair=rows[order], chi2=0.0))


def match_few_of_size(setup: Setup, left: Spots, right: Spots, pairs: Pairs, prediction: Prediction | None) -> Match:
    """Return match_few's answer; where it has none and the lights' diameter is known, that of the pairs of their size.

    A hot pixel on the epipolar line of a light would else leave it without a partner for as long as the light rests.
    """
    match = match_few(setup.model, pairs, known=setup.target.model_known, prediction=prediction)
    if match.best is not None or setup.model.radius_m == 0.0:
        return match
    sizes, wanted = _radii_px(setup, left, right, pairs)
    fits = np.all((OBLIQUE * sizes >= wanted) & (sizes <= LARGER * wanted + MORE_PX), axis=0)
    if fits.all() or not fits.any():
        return match
    sized = match_few(setup.model, _only(pairs, fits), known=setup.target.model_known, prediction=prediction)
    if sized.best is None:
        return match
    return replace(sized, best=replace(sized.best, pair=np.flatnonzero(fits)[sized.best.pair]))


def match_few(model: TargetModel, pairs: Pairs, *, known: bool, prediction: Prediction | None = None) -> Match:
    """Return what can be said of one or two lights: their pairs, with names where these are certain, '?' else."""
    names = model.names
    if prediction is not None and len(pairs.index):
        match = _nearest(names, pairs, prediction)
        if match.best is not None:
            return match
    options = disjoint_sets(pairs)
    if known and len(options[0]) == 2 and len(names) > 1:
        gap = model.distance_m[np.triu_indices(len(names), 1)]
        fitting = [
            o
            for o in options
            if any(kernels.distance_fits(pairs.xyz_m, pairs.cov_m2, o[0], o[1], d, PAIR_GATE) for d in gap)
        ]
        if not fitting:
            why = "two lights are seen, but no two of the target's are that far apart"
            return Match(best=None, why=why, cause=Unseen.WRONG_TARGET)
        options = fitting
    if len(options) > 1:
        return _ambiguous("the lights can be paired in more than one way")
    chosen = options[0]
    if len(chosen) > min(2, len(names)):
        why = f"{len(chosen)} lights are seen and none of their arrangements is the target's"
        return Match(best=None, why=why, cause=Unseen.WRONG_TARGET)
    label = names if len(names) == 1 else ("?",) * len(chosen)
    return Match(best=Assignment(names=label, pair=np.array(chosen, dtype=np.intp), chi2=0.0))


def _few(more: bool) -> Unseen:
    return Unseen.CROWD if more else Unseen.LIGHTS_MISSING


def _ambiguous(how: str) -> Match:
    return Match(best=None, why=f"ambiguous: {how}", cause=Unseen.AMBIGUOUS)


def order_by_position(uv: Array) -> list[int] | None:
    """Return the positions of A, B, C among three pixels (3, 2); None where the order is not clear."""
    a, second, _ = np.argsort(uv[:, 0])
    if uv[second, 0] - uv[a, 0] < LABEL_MARGIN_PX:
        return None
    rest = [i for i in range(3) if i != a]
    lower, upper = sorted(rest, key=lambda i: -uv[i, 1])
    return [int(a), lower, upper] if uv[lower, 1] - uv[upper, 1] >= LABEL_MARGIN_PX else None


def _nearest(names: tuple[str, ...], pairs: Pairs, prediction: Prediction) -> Match:
    """Name each light by the nearest prediction, where pair and light are each other's nearest by far."""
    far = np.linalg.norm(pairs.xyz_m[:, None] - prediction.xyz_m[None], axis=2)  # (c, m)
    far[~np.isfinite(far)] = np.inf
    chosen = []
    for light in range(len(names)):
        at = int(np.argmin(far[:, light]))
        if not far[at, light] <= prediction.within_m:
            continue
        rivals = np.concatenate([np.delete(far[:, light], at), np.delete(far[at], light)])
        if not len(rivals) or rivals.min() > PREDICTION_RATIO * far[at, light]:
            chosen.append((names[light], at))
    if not chosen:
        return _ambiguous("no light is clearly the one expected")
    label = tuple(name for name, _ in chosen)
    best = Assignment(names=label, pair=np.array([at for _, at in chosen], dtype=np.intp), chi2=0.0)
    return Match(best=best, predicted=True)


REACH_PX = 1.0
"""A spot within this of another frame's stands where that one stood."""
STANDING_SHARE = 0.6
FEWEST_FRAMES = 5
"""Share of the frames in which something must be seen at one place to count as standing, and frames needed to tell: a
beacon on the last joint's axis rests for one sweep of several, a target that is shown rests for a frame or two."""


def without_standing(frames: Sequence[Spots]) -> list[Spots]:
    """Return the spots of each frame of one camera that stand still, less those seen at one place in most of them.

    A frame is left as it is where it would lose all of its spots, and so are all where there are too few to tell.
    """
    n = len(frames)
    counts = [len(spots) for spots in frames]
    of = np.repeat(np.arange(n), counts)
    if n < FEWEST_FRAMES or not len(of):
        return list(frames)
    positions = np.concatenate([spots.uv_px for spots in frames])
    tree = scipy.spatial.cKDTree(positions)
    standing = tree.query_ball_point(positions, REACH_PX, return_length=True) >= STANDING_SHARE * n
    # near a place a frame counts once: where two of its spots may both be near, its frames are counted one by one
    pairs = scipy.spatial.cKDTree(np.column_stack([positions, 4.0 * REACH_PX * of])).query_pairs(
        2.0 * REACH_PX, output_type="ndarray"
    )
    if len(pairs):
        twins = scipy.spatial.cKDTree(positions[np.unique(pairs)])
        standing_twins = standing & (twins.query_ball_point(positions, REACH_PX, return_length=True) > 1)
        for k in np.flatnonzero(standing_twins):
            standing[k] = len(np.unique(of[tree.query_ball_point(positions[k], REACH_PX)])) >= STANDING_SHARE * n
    out = []
    for spots, rests in zip(frames, np.split(standing, np.cumsum(counts)[:-1]), strict=True):
        moving = np.flatnonzero(~rests)
        out.append(spots.take(moving) if len(moving) else spots)
    return out
