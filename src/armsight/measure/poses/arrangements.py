"""All ways to take pairs of spots for a target's lights that fit it: the compiled search, and what it found."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from armsight.measure.poses.kernels import correspondence as kernels
from armsight.measure.poses.pairs import PAIR_GATE, Pairs
from armsight.measure.poses.target_model import TargetModel
from armsight.optics import PackedRig

Array = NDArray[np.float64]
Index = NDArray[np.intp]


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
    packed: PackedRig,
    model: TargetModel,
    pairs: Pairs,
    outlines: NDArray[np.bool_],
    *,
    radius_m: float,
    slack_px: float,
    scope: Scope,
) -> Arrangements:
    """Return the arrangements of the pairs that fit the target.

    outlines (2, n): which spots of each side are outlines of flat lights of radius_m.
    """
    m = len(model)
    rows, chi2 = np.empty((scope.room, m), np.intp), np.empty(scope.room)
    poses = np.empty((scope.room, 3, 4))
    found, passed, cut = kernels.search(
        packed.arrays,
        (model.xyz_m, model.distance_m, radius_m, model.normal),
        outlines,
        (pairs.index, pairs.uv_px, pairs.cov_px2, pairs.xyz_m, pairs.cov_m2),
        (slack_px**2, PAIR_GATE, model.limits, scope.margin, pairs.overlaid, scope.smaller, scope.most_nodes),
        (rows, chi2, poses),
    )
    return Arrangements(rows=rows[:found], chi2=chi2[:found], poses=poses[:found], passed=int(passed), cut=bool(cut))
