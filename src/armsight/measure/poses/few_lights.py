"""Names for lights whose arrangement does not tell them: by their order in the image, or by where they are expected."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from armsight.errors import Unseen
from armsight.measure.poses.assignment import PREDICTION_RATIO, Assignment, Match, Prediction
from armsight.measure.poses.kernels import correspondence as kernels
from armsight.measure.poses.pairs import PAIR_GATE, Pairs, disjoint_sets, overlaid_triples
from armsight.measure.poses.target_model import TargetModel
from armsight.records import Spots

Array = NDArray[np.float64]

LABEL_MARGIN_PX = 2.0
"""Lights closer than this in column (or row) have no order in the image that could name them."""

_UNMEASURED = (
    "which of them are the target's, one pair of images does not tell, so that no pose is given; measure the target "
    "once (armsight calibrate target), black out the rest (--mask), raise --threshold, or darken the room"
)


def match_by_place(left: Spots, right: Spots, pairs: Pairs) -> Match:
    """Return names for three lights whose arrangement is not known: A left, B lower right, C upper right (MATH 3.2).

    Both images must show the same order, and the pairs it makes must agree with the epipolar constraint. Where one
    image holds both views, there must be one way only to make three pairs of its spots.
    """
    if pairs.overlaid:
        return _overlaid_by_place(left, pairs)
    sides = [np.unique(pairs.index[:, side]) for side in range(2)]
    if len(sides[0]) != 3 or len(sides[1]) != 3:
        n = f"{len(sides[0])} in the left image and {len(sides[1])} in the right one"
        cause = f"a target that has not been measured needs exactly three lights in both views, not {n}"
        more = max(len(side) for side in sides) > 3
        return Match(best=None, why=f"{cause}: {_UNMEASURED}" if more else cause, cause=_few(more))
    orders = []
    for spots, seen, name in ((left, sides[0], "left"), (right, sides[1], "right")):
        order = _order_by_place(spots.uv_px[seen])
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


def _overlaid_by_place(spots: Spots, pairs: Pairs) -> Match:
    triples = overlaid_triples(pairs)
    if len(triples) != 1:
        ways = "more than one way" if triples else "no way"
        why = f"there is {ways} to make three pairs of the {len(spots)} lights of both views"
        return Match(best=None, why=why, cause=Unseen.AMBIGUOUS if triples else Unseen.UNPAIRED)
    rows = np.array(triples[0], dtype=np.intp)
    order = _order_by_place(spots.uv_px[pairs.index[rows, 0]])
    if order is None:
        return _ambiguous("the lights have no clear order left to right in the left view")
    return Match(best=Assignment(names=("A", "B", "C"), pair=rows[order], chi2=0.0))


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


def _order_by_place(uv: Array) -> list[int] | None:
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
