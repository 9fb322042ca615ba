"""Which spot of the left view is which of the right one, and which light of the target both are."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from armsight.arrays import Array, Index, Mask
from armsight.errors import Unseen
from armsight.measure.poses.kernels import correspondence as kernels
from armsight.measure.poses.outcome import Assignment, Match, Prediction
from armsight.measure.poses.pairs import Pairs, Scope, search_arrangements
from armsight.measure.poses.setup import Setup, TargetModel
from armsight.optics import PackedRig
from armsight.records import NotSeen, Spots

MARGIN = 16.0
"""A second assignment counts as possible while its chi-square is within this of the best (odds of 3000 to 1)."""

ROOM = 16
"""Hypotheses kept; a hexagon has 12."""

SCOPE = Scope(room=ROOM, margin=MARGIN, most_nodes=kernels.MAX_NODES)

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

OUTLINE = "ellipse"
"""The spots' model whose centre is that of a flat light's outline."""

_FEWER = "mask the background or raise the threshold"


def match_known(
    setup: Setup,
    left: Spots,
    right: Spots,
    pairs: Pairs,
    *,
    prediction: Prediction | None = None,
    slack_px: float | None = None,
    arrangements: int = 0,
) -> Match:
    """Return the one assignment of pairs to the names of a measured target of three spots or more.

    The assignment with the most names wins; among equals the reprojection decides where it can. Where it cannot, for
    lights in a plane square to the target's z it decides that they are seen from the -z side; then the prediction,
    where it is near one of them. Else best is None and the alternatives hold all. slack_px: None for the setup's.
    arrangements: how many were consistent before the spots were measured (0 where there was nothing but lights); the
    more, the better the best one must fit: what is expected by chance is in the match, for the caller to judge.
    """
    packed, model = setup.packed, setup.model
    found, passed = _search(setup, left, right, pairs, setup.slack_px if slack_px is None else slack_px)
    if isinstance(found, NotSeen):
        return Match(best=None, why=found.why, cause=found.cause)
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


def _search(
    setup: Setup, left: Spots, right: Spots, pairs: Pairs, slack_px: float
) -> tuple[list[Assignment] | NotSeen, int]:
    """Return all assignments within MARGIN of the best, or why there is none; and how many fit at all."""
    if not pairs.complete:
        return NotSeen(f"more than {kernels.MAX_PAIRS} pairs of spots could belong together: {_FEWER}", Unseen.CROWD), 0
    model = setup.model
    outlines = _outlines(model, left, right)
    found = search_arrangements(setup, pairs, outlines, radius_m=model.radius_m, slack_px=slack_px, scope=SCOPE)
    if found.cut:
        return NotSeen(f"too many arrangements of the spots are possible: {_FEWER}", Unseen.CROWD), 0
    if not len(found.rows):
        why = f"no arrangement of the {len(left)} and {len(right)} spots seen is the target's"
        return NotSeen(why, Unseen.LIGHTS_MISSING), 0
    every = zip(found.rows, found.chi2.tolist(), found.poses, strict=True)
    return [_assignment(model, rows, chi2, pose) for rows, chi2, pose in every], found.passed


def _outlines(model: TargetModel, left: Spots, right: Spots) -> Mask:
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
    neg2 = [_neg2_log_likelihood(packed, model, left, right, pairs, group[0]) for group in sets.values()]
    least = min(neg2)
    first = pairs.index[list(list(sets)[int(np.argmin(neg2))])]
    possible = [
        a
        for group, one in zip(sets.values(), neg2, strict=True)
        if one < least + RIVAL
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
            cause=Unseen.AMBIGUOUS,
        )
    return Match(best=best, alternatives=tuple(a for a in found if a is not best))


def _apart(a: Index, b: Index) -> bool:
    """Whether two sets of pairs (n, 2) have no spot in common."""
    return not any(np.isin(a[:, side], b[:, side]).any() for side in range(2))


def _neg2_log_likelihood(
    packed: PackedRig, model: TargetModel, left: Spots, right: Spots, pairs: Pairs, a: Assignment
) -> float:
    """Return -2 log likelihood of an assignment, the slack chosen for it."""
    if a.R is None or a.t_m is None:
        return 0.0
    named = [model.names.index(name) for name in a.names]
    index = pairs.index[a.pair]
    outline = _outlines(model, left, right)
    radius = model.radius_m * np.column_stack([outline[0, index[:, 0]], outline[1, index[:, 1]]])
    return float(
        kernels.neg2_log_likelihood(
            packed.arrays,
            (model.xyz_m[named], radius, model.normal),
            (pairs.uv_px[a.pair], pairs.cov_px2[a.pair]),
            np.ascontiguousarray(a.R),  # parts of a larger array: kernels call it with such as are whole
            np.ascontiguousarray(a.t_m),
        )
    )


def _shown(packed: PackedRig, model: TargetModel, group: list[Assignment]) -> list[Assignment]:
    """Return of several ways to name the same spots those that show the front of a one-sided target, if one does."""
    if not model.one_sided or len(group) == 1:
        return group
    back = packed.t[0] @ packed.R[0]  # from the left camera to the rig's origin
    return [a for a in group if _shows_front(back, a)] or group


def _shows_front(back: Array, a: Assignment) -> bool:
    """Whether the target's z points away from the left camera; back (3,): from that camera to the rig's origin."""
    return a.R is not None and a.t_m is not None and bool(a.R[:, 2] @ (a.t_m + back) > 0.0)
