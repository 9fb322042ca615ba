"""A target of one light before any number of cameras: which spots are it, and where it is.

Two cameras have their own way, `from_spots`. Of more, any two may begin; the others are to agree, or not to show it.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations
from math import comb

import numpy as np

from armsight.arrays import Array, Index
from armsight.errors import Unseen
from armsight.measure.poses.beacon import match_beacon
from armsight.measure.poses.kernels.tracking import predict_views
from armsight.measure.poses.outcome import Measured, lost_moment
from armsight.measure.poses.pairs import PAIR_GATE, Pairs, pair_spots
from armsight.measure.poses.setup import Setup
from armsight.measure.poses.sights import Sights
from armsight.measure.poses.solving import solve_views, take_spots
from armsight.records import NotSeen, PoseStatus, Spots

MOST_PAIRS = 20
"""Pairs of spots that are looked at, for each two views; a room with more has too much in it for one light."""


def measure_light(setup: Setup, t_s: float, seen: Sequence[Spots], *, alone: bool = False) -> Measured:
    """Return the position of a target of one light from all spots of the views, in the rig's order.

    alone: nothing but lights is bright, or the caller has chosen the spots; see match_beacon. A light that two
    positions explain alike is lost: which of them it is, nothing says.
    """
    sights = Sights.of(setup, seen)
    found = lights_of(setup, sights, alone=alone)
    if isinstance(found, NotSeen):
        return lost_moment(t_s, tuple(seen), found)
    most = max(sum(row >= 0 for row in rows) for rows in found)
    best = [np.array(rows) for rows in found if sum(row >= 0 for row in rows) == most]
    if len(best) > 1:
        why = f"ambiguous: {len(best)} positions explain spots of {most} cameras each, and any could be the light"
        return lost_moment(t_s, tuple(seen), NotSeen(why, Unseen.AMBIGUOUS))
    return _measured(setup, t_s, sights, best[0])


def lights_of(setup: Setup, sights: Sights, *, alone: bool = False) -> set[tuple[int, ...]] | NotSeen:
    """Return which spot of each view (v), -1 for none, may be one light, or why there is none; see measure_light."""
    seen, whys = sights.by_view, list[NotSeen]()
    candidates: list[tuple[Array, Index]] = []
    for a, b in combinations([s for s, spots in enumerate(seen) if len(spots)], 2):
        pair = setup.pair(a, b)
        pairs = pair_spots(pair.packed, seen[a], seen[b], setup.slack_px)
        for row in _believed(pair, seen[a], seen[b], pairs, whys, alone=alone):
            own = np.full(len(seen), -1, np.intp)
            own[[a, b]] = pairs.index[row]
            candidates.append((pairs.xyz_m[row], own))
    if len(candidates) > MOST_PAIRS * comb(len(seen), 2):
        why = f"{len(candidates)} pairs of bright spots could be a light: mask what is not (--mask), or darken it"
        return NotSeen(why, Unseen.CROWD)
    none = NotSeen("no two cameras see one light: no spots of theirs agree (epipolar distance)", Unseen.UNPAIRED)
    found = {tuple(_completed(setup, sights, xyz_m, own).tolist()) for xyz_m, own in candidates}
    return found or (whys[0] if whys else none)


def _believed(pair: Setup, a: Spots, b: Spots, pairs: Pairs, whys: list[NotSeen], *, alone: bool) -> list[int]:
    """Return the pairs of two views' spots that may be a light: of a lone coloured one by its size, too."""
    if pair.settings.colour is None or len(pair.model) > 1:
        return list(range(len(pairs.index)))
    match = match_beacon(pair, a, b, pairs, None, alone=alone)
    if match.best is None:
        whys.append(match.missed)
        return []
    return [int(row) for row in match.best.pair]


def _completed(setup: Setup, sights: Sights, xyz_m: Array, own: Index) -> Index:
    """Return which spot of each view (v,) a light at xyz_m (3,) is, -1 where none is near, or more than one."""
    v = len(own)
    at, rows = np.empty((v, 1, 2)), own.copy()
    predict_views(setup.packed.arrays, xyz_m[None].copy(), np.zeros((1, 3)), 0.0, np.empty((1, 3)), at)
    for s in np.flatnonzero(own < 0).tolist():
        first, end = sights.first[s : s + 2]
        off = sights.uv_px[first:end] - at[s]
        C = sights.cov_px2[first:end] + 2.0 * setup.slack_px**2 * np.eye(2)  # its own slack, and that of the point
        near = np.flatnonzero(np.einsum("ni,nij,nj->n", off, np.linalg.inv(C), off) <= PAIR_GATE)
        rows[s] = near[0] if len(near) == 1 else -1
    return rows


def _measured(setup: Setup, t_s: float, sights: Sights, rows: Index) -> Measured:
    names, views = sights.named(setup, rows[None], np.zeros((4, 4)))
    solved = solve_views(setup, t_s, names, views)
    if solved.pose.status is PoseStatus.LOST:
        return lost_moment(t_s, sights.by_view, solved.missed)
    spots = tuple(take_spots(one, rows[s : s + 1][rows[s : s + 1] >= 0]) for s, one in enumerate(sights.by_view))
    return Measured(
        pose=solved.pose,
        points=solved.points,
        spots=spots,
        names=names,
        seen=sights.by_view,
        sights=rows[None] >= 0,
        cause=solved.cause,
    )
