"""Which spots of the two views may be the same light, and which of such pairs fit the target together."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations, islice

import numpy as np

from armsight.arrays import Array, Index, Mask
from armsight.measure.poses.kernels import correspondence as kernels
from armsight.measure.poses.setup import SLACK_PX, Setup
from armsight.optics import PackedRig
from armsight.records import Spots

PAIR_GATE = 16.0
"""Square, in standard deviations, allowed to an epipolar distance and to a distance between two lights (4 sigma)."""

NODE_S, NODES_SHARE = 1e-8, 0.08
"""Seconds to look at a pair in a search, and the share of a deadline that is for each search."""

MOST_FREE = 12
"""Pairs among which the ways to combine them are counted."""


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
            return not overlaid_triples(self)
        return min(len(np.unique(self.index[:, side])) for side in range(2)) <= 2


def pair_spots(
    packed: PackedRig, left: Spots, right: Spots, slack_px: float = SLACK_PX, *, overlaid: bool = False
) -> Pairs:
    """Return the pairs of spots that could be one light: epipolar distance, whitened by the spots' covariances.

    overlaid: left and right are the same spots, of one image that holds both views; which of two spots is the left
    view's, their order tells: the other way round they would meet behind the cameras.
    """
    index, uv, cov, P, S, behind = kernels.candidate_pairs(
        packed.arrays,
        packed.baseline,
        (left.uv_px, left.covariance_px2),
        (right.uv_px, right.covariance_px2),
        slack_px**2,
        PAIR_GATE,
        overlaid,
        kernels.MAX_PAIRS,
    )
    complete = len(index) + behind < kernels.MAX_PAIRS
    return Pairs(
        index=index, uv_px=uv, cov_px2=cov, xyz_m=P, cov_m2=S, behind=behind, complete=complete, overlaid=overlaid
    )


def overlaid_triples(pairs: Pairs) -> list[tuple[int, ...]]:
    """Return the ways to make three pairs that use no spot twice; at most two are looked for."""
    if len(pairs.index) > MOST_FREE:
        return [(), ()]
    triples = combinations(range(len(pairs.index)), 3)
    found = (rows for rows in triples if all(pairs.disjoint(i, j) for i, j in combinations(rows, 2)))
    return list(islice(found, 2))


def disjoint_sets(pairs: Pairs) -> list[tuple[int, ...]]:
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


@dataclass(frozen=True, slots=True, kw_only=True)
class Scope:
    """How far a search goes: room, the hypotheses kept; margin, in chi-square to the best; most_nodes, when it ends.

    smaller: sets of fewer lights than the largest are kept too.
    """

    room: int
    margin: float
    most_nodes: int
    smaller: bool = False


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Arrangements:
    """The hypotheses found, h of them by rising chi2 (h,).

    rows (h, m): the pair of each light, -1 for none. poses (h, 3, 4): rotation and translation of each. passed: how
    many fit at all. cut: whether the search was cut short.
    """

    rows: Index
    chi2: Array
    poses: Array
    passed: int
    cut: bool


def search_arrangements(
    setup: Setup,
    pairs: Pairs,
    outlines: Mask,
    *,
    radius_m: float,
    slack_px: float,
    scope: Scope,
) -> Arrangements:
    """Return the arrangements of the pairs that fit the target.

    outlines (2, n): which spots of each side are outlines of flat lights of radius_m.
    """
    model = setup.model
    m, nodes = len(model), setup.pace.most(scope.most_nodes, NODE_S, NODES_SHARE)
    rows, chi2 = np.empty((scope.room, m), np.intp), np.empty(scope.room)
    poses = np.empty((scope.room, 3, 4))
    found, passed, cut = kernels.search(
        setup.packed.arrays,
        (model.xyz_m, model.distance_m, radius_m, model.normal),
        outlines,
        (pairs.index, pairs.uv_px, pairs.cov_px2, pairs.xyz_m, pairs.cov_m2),
        (slack_px**2, PAIR_GATE, model.limits, scope.margin, pairs.overlaid, scope.smaller, nodes),
        (rows, chi2, poses),
    )
    return Arrangements(rows=rows[:found], chi2=chi2[:found], poses=poses[:found], passed=int(passed), cut=bool(cut))
