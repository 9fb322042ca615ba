"""Which of many candidates may be the target's lights: coarse centres are paired and named before any is measured."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from armsight.arrays import Array, Index, Mask
from armsight.measure.poses.kernels import correspondence as kernels
from armsight.measure.poses.pairs import PAIR_GATE, Pairs, Scope, search_arrangements
from armsight.measure.poses.setup import Setup
from armsight.measure.spots import Candidates
from armsight.optics import SIDES
from armsight.records import Spots

SHORTLIST_STEPS = (96, 384)
"""Candidates of each image among which arrangements are searched, strongest first; the next number where none is."""
MOST_NODES = 2_000_000
"""Pairs looked at in the search; about 20 ms."""
ROOM = 32
"""Arrangements whose lights are measured, best first."""
SCOPE = Scope(room=ROOM, margin=np.inf, most_nodes=MOST_NODES, smaller=True)
LIKELY = 1.5
"""Arrangements are measured at first whose coarse chi-square (slack included) is within this of the best one's; the
others follow where these do not settle it. On ray-traced rooms the target's is 0.1-0.2."""
ALIKE = 2.2
"""Ratio of the radii, and of the grey levels, up to which two images can be of one light."""
LOOSE_PX = 1.5
"""Radius in px by which the two may differ besides."""
PAIRED_SHARE = 0.006
"""Share of all pairs of two things anywhere in two images that agree with the epipolar constraint."""
FEW_BY_CHANCE = 0.05
"""Expected number of such pairs from which one or two lights cannot be told from what else is bright."""
SAME = 0.05
UNLIKE = 0.5
"""Logarithms of ratios of sizes: what two images of one light differ by, and what two things of chance do."""
ALL_ALIKE = 1e-3
"""Least of that product: other lights in view may be of one kind, as those of a control panel are."""
CENTROID = "centroid"
NO_LIGHT = 5.0
A_LIGHT = 0.6
"""Odds of chance against a light where no model of one fits an image, and where one does: on composites 3 % of the
lights and about half of the other things have none."""
MOST_UNNAMED = 48
"""Candidates of each image that are measured where no arrangement of the target is known to search for."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Shortlist:
    """Positions of the candidates to measure in the left and the right image, chosen from `bright` in both together.

    first: of these, those of the likeliest arrangements, None where that is all. arrangements: how many ways to
    name coarse centres fit the target. pairs_by_chance: how many pairs of things that are no lights should agree with
    the epipolar constraint. why: what stopped the search, where it was stopped.
    """

    left: Index
    right: Index
    bright: int
    first: tuple[Index, Index] | None = None
    arrangements: int = 0
    pairs_by_chance: float = 0.0
    why: str = ""

    @property
    def few_are_lights(self) -> bool:
        """Whether bright things are so few that one or two of them that agree are no chance."""
        return self.pairs_by_chance < FEW_BY_CHANCE

    @property
    def nothing(self) -> str:
        """Why nothing was chosen; empty where nothing was bright in one of the images."""
        if self.why or not self.bright:
            return self.why
        return f"{self.bright} bright spots, and no arrangement of them is the target's"


def shortlist(setup: Setup, left: Candidates, right: Candidates) -> Shortlist:
    """Return the candidates that take part in an arrangement that may be the target.

    A target without known positions, or of one or two lights, gives all that have a partner in the other image.
    """
    named = setup.target.model_known and len(setup.model) >= 3
    bright = (len(left.positions()), len(right.positions()))
    found = Shortlist(left=np.empty(0, np.intp), right=np.empty(0, np.intp), bright=sum(bright))
    stopped = _stopped(left, right)
    by_chance = (bright[0] + left.others) * (bright[1] + right.others) * PAIRED_SHARE
    for most in SHORTLIST_STEPS:
        at_left, at_right = left.positions(most), right.positions(most)
        pairs = _paired(setup, left, right, at_left, at_right)
        if not len(pairs.index):
            continue
        if not named:
            found = _partners(pairs.index, at_left, at_right)
            return replace(found, bright=sum(bright), pairs_by_chance=by_chance, why=stopped)
        found = _arranged(setup, pairs, at_left, at_right)
        found = replace(
            found, bright=sum(bright), pairs_by_chance=by_chance, why="; ".join(filter(None, (found.why, stopped)))
        )
        if len(found.left) or max(len(at_left), len(at_right)) < most:
            break
    return found if stopped in found.why else replace(found, why=stopped)


def _stopped(left: Candidates, right: Candidates) -> str:
    """Return why candidates may be missing; empty where both images were searched to the end."""
    cut = [side for side, at in zip(SIDES, (left, right), strict=True) if not at.complete]
    if not cut:
        return ""
    where = "both images" if len(cut) == 2 else f"the {cut[0]} image"
    return f"so much is bright that the search for spots stopped before it had looked at all of {where}"


def likeness(setup: Setup, left: Candidates, right: Candidates, at_left: Spots, at_right: Spots, xyz_m: Array) -> float:
    """Return how much less likely it is that things of chance are as alike, and as like lights, as these n spots.

    xyz_m (n, 3). A light has one size in both views, and those of a target are of one size: both are compared as
    shares, each with what chance makes of it (a factor of UNLIKE either way). No light's model fits most other things.
    """
    size = np.empty((len(xyz_m), 2))  # m at the light's distance
    shapes = 1.0
    for side, (candidates, spots) in enumerate(((left, at_left), (right, at_right))):
        depth = xyz_m @ setup.packed.R[side][2] + setup.packed.t[side][2]
        away = np.linalg.norm(candidates.uv_px[None] - spots.uv_px[:, None], axis=2)
        for model in spots.model:
            shapes *= NO_LIGHT if model == CENTROID else A_LIGHT
        size[:, side] = candidates.radius_px[away.argmin(axis=1)] * depth / setup.packed.k[side][0]
    share = np.log(size)
    between = np.abs(share[:, 0] - share[:, 1])
    mean = share.mean(axis=1)
    within = np.delete(np.abs(mean - np.median(mean)), int(np.argmin(np.abs(mean - np.median(mean)))))
    alike = float(np.prod(np.minimum((np.concatenate([between, within]) + SAME) / UNLIKE, 1.0)))
    return shapes * max(alike, ALL_ALIKE)


def _paired(setup: Setup, left: Candidates, right: Candidates, at_left: Index, at_right: Index) -> Pairs:
    """Return the pairs of coarse centres that meet in space and are alike in size and height."""
    packed, slack2 = setup.packed, setup.slack_px**2
    uv = [c.uv_px[at] for c, at in ((left, at_left), (right, at_right))]
    cov = [c.sigma_px[at, None, None] ** 2 * np.eye(2) for c, at in ((left, at_left), (right, at_right))]
    for array in (*uv, *cov):
        array.setflags(write=False)  # as those of Spots: one compilation serves both
    index, uv_px, cov_px2, P, S, behind = kernels.candidate_pairs(
        packed.arrays,
        packed.baseline,
        (uv[0], cov[0]),
        (uv[1], cov[1]),
        slack2,
        PAIR_GATE,
        setup.overlaid,
        kernels.MANY_PAIRS,
    )
    alike = _alike(left, right, at_left[index[:, 0]], at_right[index[:, 1]])
    alike &= _sized(setup, left, right, at_left[index[:, 0]], at_right[index[:, 1]], P)
    return Pairs(
        index=index[alike],
        uv_px=uv_px[alike],
        cov_px2=cov_px2[alike],
        xyz_m=P[alike],
        cov_m2=S[alike],
        behind=behind,
        complete=True,
        overlaid=setup.overlaid,
    )


def _alike(left: Candidates, right: Candidates, i: Index, j: Index) -> Mask:
    """Tell of pairs (n,) whether both images can be of one light, in size and in brightness."""
    a, b = left.radius_px[i], right.radius_px[j]
    size = np.maximum(a, b) <= ALIKE * np.minimum(a, b) + LOOSE_PX
    a, b = left.peak[i], right.peak[j]
    return np.asarray(size & (np.maximum(a, b) <= ALIKE * np.minimum(a, b)))


def _sized(setup: Setup, left: Candidates, right: Candidates, i: Index, j: Index, P: Array) -> Mask:
    """Tell of pairs (n,) whether they are as large as a flat light of the target's diameter would be at P (n, 3)."""
    if not setup.model.radius_m > 0.0:
        return np.ones(len(i), np.bool_)
    good = np.ones(len(i), np.bool_)
    for side, (candidates, at) in enumerate(((left, i), (right, j))):
        depth = P @ setup.packed.R[side][2] + setup.packed.t[side][2]
        whole = setup.packed.k[side][0] * setup.model.radius_m / depth
        radius = candidates.radius_px[at]
        good &= (radius >= whole / ALIKE - LOOSE_PX) & (radius <= ALIKE * whole + 2.0 * LOOSE_PX)
    return good


def _partners(index: Index, at_left: Index, at_right: Index) -> Shortlist:
    """Return the strongest candidates that have a partner."""
    return Shortlist(
        bright=0,
        left=np.sort(at_left[np.unique(index[:, 0])[:MOST_UNNAMED]]),
        right=np.sort(at_right[np.unique(index[:, 1])[:MOST_UNNAMED]]),
    )


def _arranged(setup: Setup, pairs: Pairs, at_left: Index, at_right: Index) -> Shortlist:
    """Return the candidates of all arrangements of three names and more that fit the target coarsely."""
    nothing_flat = np.zeros((2, max(len(at_left), len(at_right))), np.bool_)
    found = search_arrangements(setup, pairs, nothing_flat, radius_m=0.0, slack_px=setup.slack_px, scope=SCOPE)
    at = (at_left, at_right)
    every = _used(pairs, found.rows, at)
    likely = int(np.count_nonzero(found.chi2 <= found.chi2[0] + LIKELY)) if len(found.chi2) else 0
    best = _used(pairs, found.rows[:likely], at)
    cut = "too many bright spots could be the target's: not all of their arrangements were looked at"
    return Shortlist(
        bright=0,
        left=every[0],
        right=every[1],
        first=best if len(found.rows) > likely else None,
        arrangements=found.passed,
        why=cut if found.cut else "",
    )


def _used(pairs: Pairs, rows: Index, at: tuple[Index, Index]) -> tuple[Index, Index]:
    """Return the candidates of both images that the arrangements rows (n, m) make use of."""
    index = pairs.index[np.unique(rows[rows >= 0])]
    return np.unique(at[0][index[:, 0]]), np.unique(at[1][index[:, 1]])
