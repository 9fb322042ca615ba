"""Which spot of the left view is which of the right one, and which light of the target both are."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import combinations, islice

import numpy as np
from numpy.typing import NDArray

from armsight.measure.poses.kernels import correspondence as kernels
from armsight.measure.poses.target_model import TargetModel
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

RIVAL = 14.0
"""Fall of -2 log likelihood by which one set of spots must beat another (odds of 1000 to 1). What the calibration adds
to the residuals is not known beforehand but is the same for both: each is judged with the slack that fits it best."""

LEAST_SLACK = 0.0064
"""Least variance of a residual over that of the slack: 0.02 px at a slack of 0.25 px."""

BY_CHANCE = 2e-8
"""Expected number of arrangements of things that are no lights, as good as the best, from which it is not believed."""

SECOND = 1e-6
"""The same, from which spots of which none is of the best set are a second target, however well the first fits."""

HIDDEN = 0.03
"""How often a light is hidden from a camera: a set without it is by so much likelier one of chance."""

AS_FOUND = -1
"""Arrangements are as many as fit once the spots are measured."""

OWN_CHANCE = 0.2
"""Arrangements by chance that are expected where none was met."""

LABEL_MARGIN_PX = 2.0
"""Lights closer than this in column (or row) have no order in the image that could name them."""

MOST_FREE = 12
"""Pairs among which the ways to combine them are counted."""

OUTLINE = "ellipse"
"""The spots' model whose centre is that of a flat light's outline."""

_UNMEASURED = (
    "which of them are the target's, one pair of images does not tell, so that no pose is given; measure the target "
    "once (armsight calibrate target), black out the rest (--mask), raise --threshold, or darken the room"
)
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


@dataclass(frozen=True, slots=True, eq=False)
class Prediction:
    """Where the lights are expected: xyz_m (m, 3) in rig axes, NaN where nothing is known; within_m: how far off it
    may be; turned_m: how far off each light may be from the others, by the target's turning. It breaks ties, and only
    between assignments of which one is that near."""

    xyz_m: Array
    within_m: float
    turned_m: float = float("inf")

    def _far_m(self, model: TargetModel, a: Assignment) -> float:
        """Return the root mean square distance of the lights from where they are expected."""
        if a.R is None or a.t_m is None or not np.isfinite(self.xyz_m).any():
            return float("inf")
        return float(np.sqrt(np.nanmean(((model.xyz_m @ a.R.T + a.t_m) - self.xyz_m) ** 2) * 3.0))

    def _turned_far(self, model: TargetModel, a: Assignment) -> bool:
        """Whether a light is further from its place among the others than the target can have turned."""
        if a.R is None or a.t_m is None or np.isfinite(self.xyz_m[:, 0]).sum() < 2:
            return False
        off = model.xyz_m @ a.R.T + a.t_m - self.xyz_m
        return bool(np.nanmax(np.linalg.norm(off - np.nanmean(off, axis=0), axis=1)) > self.turned_m)

    def holds(self, model: TargetModel, a: Assignment) -> bool:
        """Whether an assignment is where the lights are expected."""
        return self._far_m(model, a) <= self.within_m and not self._turned_far(model, a)

    def choice(self, model: TargetModel, found: list[Assignment]) -> Assignment | None:
        """Return the assignment that is as expected where the next one is much further off."""
        far = np.array([self._far_m(model, a) for a in found])
        order = np.argsort(far)
        first = far[order[0]]
        if first <= self.within_m and far[order[1]] > PREDICTION_RATIO * first:
            return found[int(order[0])]
        return None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Match:
    """The assignment that holds, or none and why; alternatives that fit as well.

    predicted: it is where it was expected. chance: expected number of others that fit as well by chance.
    """

    best: Assignment | None
    alternatives: tuple[Assignment, ...] = ()
    why: str = ""
    predicted: bool = False
    chance: float = 0.0


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
        kernels.MAX_PAIRS,
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
    prediction: Prediction | None = None,
    slack_px: float = SLACK_PX,
    arrangements: int = 0,
) -> Match:
    """Return the one assignment of pairs to the names of a measured target of three spots or more.

    The assignment with the most names wins; among equals the reprojection decides where it can. Where it cannot, for
    lights in a plane square to the target's z it decides that they are seen from the -z side; then the prediction,
    where it is near one of them. Else best is None and the alternatives hold all. arrangements: how many were
    consistent before the spots were measured (0 where there was nothing but lights); the more, the better the best one
    must fit: what is expected by chance is in the match, for the caller to judge.
    """
    found, passed = _search(packed, model, left, right, pairs, slack_px)
    if isinstance(found, str):
        return Match(best=None, why=found)
    arrangements = passed if arrangements == AS_FOUND else arrangements
    match = _decide(packed, model, left, right, pairs, found, prediction, arrangements)
    likeliest = match.best or match.alternatives[0]
    if not arrangements or (prediction is not None and prediction.holds(model, likeliest)):
        return match
    return replace(match, chance=_chance(model, likeliest, arrangements - _namings(found, likeliest)))


def _namings(found: list[Assignment], best: Assignment) -> int:
    """Return in how many ways the spots of the best assignment can be named."""
    return sum(set(a.pair.tolist()) == set(best.pair.tolist()) for a in found)


def _chance(model: TargetModel, best: Assignment, others: int) -> float:
    """Return how many arrangements of chance are expected that fit as well as the best, of `others` that fit loosely.

    Residuals of chance fill a ball evenly whose dimension is the number of equations left over.
    """
    n = len(best.names)
    dof = 4 * n - 6
    share = max(best.chi2, LEAST_SLACK * dof) / float(model.limits[n])
    hidden = (1.0 / HIDDEN) ** (len(model) - n)
    return float(hidden * (max(others, 0) + OWN_CHANCE) * min(share, 1.0) ** (0.5 * dof))


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
        return Match(best=None, why=f"{cause}: {_UNMEASURED}" if more else cause)
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


def match_few(model: TargetModel, pairs: Pairs, *, known: bool, prediction: Prediction | None = None) -> Match:
    """Return what can be said of one or two lights: their pairs, with names where these are certain, '?' else."""
    names = model.names
    if prediction is not None and len(pairs.index):
        match = _nearest(names, pairs, prediction)
        if match.best is not None:
            return match
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
) -> tuple[list[Assignment] | str, int]:
    """Return all assignments within MARGIN of the best, or why there is none; and how many fit at all."""
    m = len(model)
    if not pairs.complete:
        return f"more than {kernels.MAX_PAIRS} pairs of spots could belong together: {_FEWER}", 0
    rows, chi2 = np.empty((ROOM, m), np.intp), np.empty(ROOM)
    poses = np.empty((ROOM, 3, 4))
    found, passed, cut = kernels.search(
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
        False,
        kernels.MAX_NODES,
        rows,
        chi2,
        poses,
    )
    if cut:
        return f"too many arrangements of the spots are possible: {_FEWER}", 0
    if not found:
        return f"no arrangement of the {len(left)} and {len(right)} spots seen is the target's", 0
    return [_assignment(model, rows[h], float(chi2[h]), poses[h]) for h in range(found)], int(passed)


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


def _decide(
    packed: PackedRig,
    model: TargetModel,
    left: Spots,
    right: Spots,
    pairs: Pairs,
    found: list[Assignment],
    prediction: Prediction | None,
    arrangements: int,
) -> Match:
    """Choose among the assignments, or say that it cannot be done."""
    if len(found) == 1:
        return Match(best=found[0])
    sets: dict[frozenset[int], list[Assignment]] = {}
    for a in found:
        sets.setdefault(frozenset(a.pair.tolist()), []).append(a)
    surprises = [_surprise(packed, model, left, right, pairs, group[0]) for group in sets.values()]
    least = min(surprises)
    first = pairs.index[list(list(sets)[int(np.argmin(surprises))])]
    possible = [
        a
        for group, surprise in zip(sets.values(), surprises, strict=True)
        if surprise < least + RIVAL
        or (_apart(pairs.index[group[0].pair], first) and _chance(model, group[0], arrangements) < SECOND)
        for a in _shown(packed, model, group)
    ]
    best = possible[0] if len(possible) == 1 else None
    if best is None and prediction is not None:
        best = prediction.choice(model, possible)
    if best is None:
        return Match(
            best=None,
            alternatives=tuple(possible),
            why=f"ambiguous: {len(possible)} assignments of names fit equally well",
        )
    return Match(best=best, alternatives=tuple(a for a in found if a is not best))


def _apart(a: Index, b: Index) -> bool:
    """Whether two sets of pairs (n, 2) have no spot in common."""
    return not any(np.isin(a[:, side], b[:, side]).any() for side in range(2))


def _surprise(packed: PackedRig, model: TargetModel, left: Spots, right: Spots, pairs: Pairs, a: Assignment) -> float:
    """Return -2 log likelihood of an assignment, the slack chosen for it."""
    if a.R is None or a.t_m is None:
        return 0.0
    named = [model.names.index(name) for name in a.names]
    index = pairs.index[a.pair]
    outline = _outlines(model, left, right)
    radius = model.radius_m * np.column_stack([outline[0, index[:, 0]], outline[1, index[:, 1]]])
    return float(
        kernels.surprise(
            packed.k, packed.R, packed.t, model.xyz_m[named], radius, model.normal,
            pairs.uv_px[a.pair], pairs.cov_px2[a.pair], a.R, a.t_m,
        )
    )  # fmt: skip


def _shown(packed: PackedRig, model: TargetModel, group: list[Assignment]) -> list[Assignment]:
    """Return of several ways to name the same spots those that show the front of a one-sided target, if one does."""
    if not model.one_sided or len(group) == 1:
        return group
    back = packed.t[0] @ packed.R[0]  # from the left camera to the rig's origin
    return [a for a in group if _shows_front(back, a)] or group


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
        return Match(best=None, why="ambiguous: no light is clearly the one expected")
    label = tuple(name for name, _ in chosen)
    best = Assignment(names=label, pair=np.array([at for _, at in chosen], dtype=np.intp), chi2=0.0)
    return Match(best=best, predicted=True)
