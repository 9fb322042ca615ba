"""Which spot of the left view is which of the right one, and which light of the target both are."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations, islice

import numpy as np
from numpy.typing import NDArray

from armsight.measure.kernels import match as kernels
from armsight.measure.model import TargetModel
from armsight.optics import PackedRig
from armsight.records import Spots

Array = NDArray[np.float64]
Index = NDArray[np.intp]

SLACK_PX = 0.25
"""What calibration, the target's measures and the shutters' skew may add to a spot's own deviation, in each
coordinate, before a match is doubted. Real pairs calibrated with printed boards show 0.1-0.2 px. It decides what
belongs together, not the covariance that is handed out."""

GATE = 16.0
"""Squared deviations allowed to an epipolar distance and to a distance between two lights (4 sigma)."""

MARGIN = 16.0
"""A second assignment counts as possible while its chi-square is within this of the best (odds of 3000 to 1)."""

ROOM = 16
"""Hypotheses kept; a hexagon has 12."""

PREDICTION_RATIO = 3.0
"""A prediction decides between assignments where the next one is this many times further from it."""

LABEL_MARGIN_PX = 2.0
"""Lights closer than this in column (or row) have no order in the image that could name them."""

MOST_FREE = 12
"""Pairs among which the ways to combine them are counted."""

OUTLINE = "ellipse"
"""The spots' model whose centre is that of a flat light's outline."""

_FEWER = "mask the background or raise the threshold"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Pairs:
    """Spots of both views that agree with the epipolar constraint and meet in front of both cameras.

    index: (c, 2) position in the left and right spots; overlaid: both are those of one image with both views.
    uv_px (c, 2, 2), cov_px2 (c, 2, 2, 2): [pair, side].
    xyz_m (c, 3), cov_m2 (c, 3, 3): closed form, slack included. behind: how many met behind the cameras.
    complete: False where there were more pairs than can be searched.
    """

    index: Index
    uv_px: Array
    cov_px2: Array
    xyz_m: Array
    cov_m2: Array
    behind: int
    complete: bool
    overlaid: bool = False

    def disjoint(self, i: int, j: int) -> bool:
        """Whether two pairs use no spot twice."""
        a, b = self.index[i], self.index[j]
        return bool((a != b).all()) and not (self.overlaid and bool((a == b[::-1]).any()))

    @property
    def few(self) -> bool:
        """Whether there cannot be three lights among them."""
        if self.overlaid:
            return not _overlaid_triples(self)
        return min(len(np.unique(self.index[:, side])) for side in range(2)) <= 2


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Assignment:
    """One hypothesis: names, the pair that each is (rows of Pairs), its chi-square, and the pose behind it.

    R (3, 3), t_m (3,): T_rig_target of the fit with slack; None for lights without a measured arrangement.
    """

    names: tuple[str, ...]
    pair: Index
    chi2: float
    R: Array | None = None
    t_m: Array | None = None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Match:
    """The assignment that holds, or none and why; alternatives that fit as well."""

    best: Assignment | None
    alternatives: tuple[Assignment, ...] = ()
    why: str = ""


def pair_spots(
    packed: PackedRig, left: Spots, right: Spots, slack_px: float = SLACK_PX, *, overlaid: bool = False
) -> Pairs:
    """Return the pairs of spots that could be one light: epipolar distance, whitened by the spots' covariances.

    overlaid: left and right are the same spots, of one image that holds both views; which of two spots is the left
    view's, their order tells: the other way round they would meet behind the cameras.
    """
    index, uv, cov, P, S, behind = kernels.candidate_pairs(
        packed.k,
        packed.R,
        packed.t,
        packed.baseline,
        left.uv_px,
        left.covariance_px2,
        right.uv_px,
        right.covariance_px2,
        slack_px**2,
        GATE,
        overlaid,
    )
    complete = len(index) + behind < kernels.MAX_PAIRS
    return Pairs(
        index=index, uv_px=uv, cov_px2=cov, xyz_m=P, cov_m2=S, behind=behind, complete=complete, overlaid=overlaid
    )


def match_known(
    packed: PackedRig,
    model: TargetModel,
    left: Spots,
    right: Spots,
    pairs: Pairs,
    *,
    predicted_m: Array | None = None,
    slack_px: float = SLACK_PX,
) -> Match:
    """Return the one assignment of pairs to the names of a measured target of three spots or more.

    The assignment with the most names wins; among equals the reprojection decides where it can. Where it cannot,
    predicted_m (m, 3), the lights' places expected in rig axes, decides; then, for lights in a plane square to
    the target's z, that they are seen from the -z side. Else best is None and the alternatives hold all.
    """
    found = _search(packed, model, left, right, pairs, slack_px)
    if isinstance(found, str):
        return Match(best=None, why=found)
    return _decide(packed, model, found, predicted_m)


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
        return Match(
            best=None, why=f"a target that has not been measured needs exactly three lights in both views, not {n}"
        )
    orders = []
    for spots, seen, name in ((left, sides[0], "left"), (right, sides[1], "right")):
        order = _order_by_place(spots.uv_px[seen])
        if order is None:
            return Match(best=None, why=f"ambiguous: the lights have no clear order left to right in the {name} image")
        orders.append(seen[order])
    rows = []
    for i, j in zip(*orders, strict=True):
        at = np.flatnonzero((pairs.index[:, 0] == i) & (pairs.index[:, 1] == j))
        if not len(at):
            return Match(best=None, why="the order of the lights differs between the two images")
        rows.append(at[0])
    return Match(best=Assignment(names=("A", "B", "C"), pair=np.array(rows, dtype=np.intp), chi2=0.0))


def _overlaid_by_place(spots: Spots, pairs: Pairs) -> Match:
    triples = _overlaid_triples(pairs)
    if len(triples) != 1:
        ways = "more than one way" if triples else "no way"
        return Match(best=None, why=f"there is {ways} to make three pairs of the {len(spots)} lights of both views")
    rows = np.array(triples[0], dtype=np.intp)
    order = _order_by_place(spots.uv_px[pairs.index[rows, 0]])
    if order is None:
        return Match(best=None, why="ambiguous: the lights have no clear order left to right in the left view")
    return Match(best=Assignment(names=("A", "B", "C"), pair=rows[order], chi2=0.0))


def _overlaid_triples(pairs: Pairs) -> list[tuple[int, ...]]:
    """Return the ways to make three pairs that use no spot twice; at most two are looked for."""
    if len(pairs.index) > MOST_FREE:
        return [(), ()]
    triples = combinations(range(len(pairs.index)), 3)
    found = (rows for rows in triples if all(pairs.disjoint(i, j) for i, j in combinations(rows, 2)))
    return list(islice(found, 2))


def match_few(model: TargetModel, pairs: Pairs, *, known: bool, predicted_m: Array | None = None) -> Match:
    """Return what can be said of one or two lights: their pairs, with names where these are certain, '?' else."""
    names = model.names
    if predicted_m is not None and len(pairs.index):
        return _nearest(names, pairs, predicted_m)
    options = _disjoint(pairs)
    if known and len(options[0]) == 2 and len(names) > 1:
        gap = model.distance_m[np.triu_indices(len(names), 1)]
        fitting = [
            o
            for o in options
            if any(kernels.distance_fits(pairs.xyz_m, pairs.cov_m2, o[0], o[1], d, GATE) for d in gap)
        ]
        if not fitting:
            return Match(best=None, why="two lights are seen, but no two of the target's are that far apart")
        options = fitting
    if len(options) > 1:
        return Match(best=None, why="ambiguous: the lights can be paired in more than one way")
    chosen = options[0]
    if len(chosen) > min(2, len(names)):
        return Match(best=None, why=f"{len(chosen)} lights are seen and none of their arrangements is the target's")
    label = names if len(names) == 1 else ("?",) * len(chosen)
    return Match(best=Assignment(names=label, pair=np.array(chosen, dtype=np.intp), chi2=0.0))


def _search(
    packed: PackedRig, model: TargetModel, left: Spots, right: Spots, pairs: Pairs, slack_px: float
) -> list[Assignment] | str:
    """Return all assignments within MARGIN of the best, or why there is none."""
    m = len(model)
    if not pairs.complete:
        return f"more than {kernels.MAX_PAIRS} pairs of spots could belong together: {_FEWER}"
    rows, chi2 = np.empty((ROOM, m), np.intp), np.empty(ROOM)
    poses = np.empty((ROOM, 3, 4))
    found, _, cut = kernels.search(
        packed.k,
        packed.R,
        packed.t,
        model.xyz_m,
        model.distance_m,
        model.radius_m,
        model.normal,
        _outlines(model, left, right),
        pairs.index,
        pairs.uv_px,
        pairs.cov_px2,
        pairs.xyz_m,
        pairs.cov_m2,
        slack_px**2,
        GATE,
        model.limits,
        MARGIN,
        pairs.overlaid,
        rows,
        chi2,
        poses,
    )
    if cut:
        return f"too many arrangements of the spots are possible: {_FEWER}"
    if not found:
        return f"no arrangement of the {len(left)} and {len(right)} spots seen is the target's"
    return [_assignment(model, rows[h], float(chi2[h]), poses[h]) for h in range(found)]


def _outlines(model: TargetModel, left: Spots, right: Spots) -> NDArray[np.bool_]:
    """Return (2, n): which spots of each side are outlines of flat lights whose centre the perspective shifts."""
    flags = np.zeros((2, max(len(left), len(right))), np.bool_)
    if model.radius_m > 0.0:
        for side, spots in enumerate((left, right)):
            flags[side, : len(spots)] = [kind == OUTLINE for kind in spots.model]
    return flags


def _assignment(model: TargetModel, rows: Index, chi2: float, pose: Array) -> Assignment:
    names = model.names
    if -1 in rows.tolist():
        named = np.flatnonzero(rows >= 0)
        names, rows = tuple(names[i] for i in named), rows[named]
    return Assignment(names=names, pair=rows, chi2=chi2, R=pose[:, :3], t_m=pose[:, 3])


def _decide(packed: PackedRig, model: TargetModel, found: list[Assignment], predicted_m: Array | None) -> Match:
    """Choose among the assignments, or say that it cannot be done."""
    if len(found) == 1:
        return Match(best=found[0])
    best: Assignment | None = None
    if predicted_m is not None:
        best = _predicted(model, found, predicted_m)
    elif model.one_sided:
        back = packed.t[0] @ packed.R[0]  # from the left camera to the rig's origin
        shown = [a for a in found if _shows_front(back, a)]
        best = shown[0] if len(shown) == 1 else None
    others = tuple(a for a in found if a is not best)
    if best is None:
        return Match(
            best=None, alternatives=others, why=f"ambiguous: {len(found)} assignments of names fit equally well"
        )
    return Match(best=best, alternatives=others)


def _predicted(model: TargetModel, found: list[Assignment], predicted_m: Array) -> Assignment | None:
    """Return the assignment nearest to the prediction where the next one is much further."""
    places = [model.xyz_m @ a.R.T + a.t_m for a in found if a.R is not None and a.t_m is not None]
    far = np.sqrt(np.nanmean((np.array(places) - predicted_m) ** 2, axis=(1, 2)))
    order = np.argsort(far)
    return found[order[0]] if far[order[1]] > PREDICTION_RATIO * far[order[0]] else None


def _shows_front(back: Array, a: Assignment) -> bool:
    """Whether the target's z points away from the left camera; back (3,): from that camera to the rig's origin."""
    return a.R is not None and a.t_m is not None and bool(a.R[:, 2] @ (a.t_m + back) > 0.0)


def _order_by_place(uv: Array) -> list[int] | None:
    """Return the positions of A, B, C among three pixels (3, 2); None where the order is not clear."""
    a, second, _ = np.argsort(uv[:, 0])
    if uv[second, 0] - uv[a, 0] < LABEL_MARGIN_PX:
        return None
    rest = [i for i in range(3) if i != a]
    lower, upper = sorted(rest, key=lambda i: -uv[i, 1])
    return [int(a), lower, upper] if uv[lower, 1] - uv[upper, 1] >= LABEL_MARGIN_PX else None


def _disjoint(pairs: Pairs) -> list[tuple[int, ...]]:
    """Return the largest sets of pairs that use no spot twice; for more than a few pairs only whether all are apart."""
    c = len(pairs.index)
    if pairs.overlaid:
        apart = len(np.unique(pairs.index)) == 2 * c
    else:
        apart = all(len(np.unique(pairs.index[:, side])) == c for side in range(2))
    if apart or c > (MOST_FREE if pairs.overlaid else 4):
        return [tuple(range(c))] * (1 if apart else 2)
    two = [(i, j) for i in range(c) for j in range(i) if pairs.disjoint(i, j)]
    return list(two) or [(i,) for i in range(c)]


def _nearest(names: tuple[str, ...], pairs: Pairs, predicted_m: Array) -> Match:
    """Name each light by the nearest prediction, where pair and light are each other's nearest by far."""
    far = np.linalg.norm(pairs.xyz_m[:, None] - predicted_m[None], axis=2)  # (c, m)
    far[~np.isfinite(far)] = np.inf
    chosen = []
    for light in range(len(names)):
        at = int(np.argmin(far[:, light]))
        if not np.isfinite(far[at, light]):
            continue
        rivals = np.concatenate([np.delete(far[:, light], at), np.delete(far[at], light)])
        if not len(rivals) or rivals.min() > PREDICTION_RATIO * far[at, light]:
            chosen.append((names[light], at))
    if not chosen:
        return Match(best=None, why="ambiguous: no light is clearly the one expected")
    label = tuple(name for name, _ in chosen)
    return Match(best=Assignment(names=label, pair=np.array([at for _, at in chosen], dtype=np.intp), chi2=0.0))
