"""Places chosen by what they tell, and a round way through them that fits into a given time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from armsight.arrays import Array
from armsight.records import Motion
from armsight_lab.cell_plan.information import Known, inverse
from armsight_lab.cell_plan.path import Way, way_through
from armsight_lab.cell_plan.scene import Roadmap, Scene

PARTS = (3, 6, 12)
"""Pieces of the straight ways, tried until the smooth way keeps clear: the more, the sharper its corners."""
LOOKED_HZ = 50.0
STOP_S = 1.0
"""What a place costs beside the way to it: the turn there."""
SWAPS = 200
"""Turns of a stretch of the round that are made at most, each shorter than before."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Tour:
    """A round from the first place of a roadmap through chosen ones (k,) and back; way: smooth, and free all along."""

    chosen: tuple[int, ...]
    places: Array
    way: Way


def by_worth(J: Array, known: Known, long_s: Array, count: int, frames: float) -> list[int]:
    """Return count places, of J (k, r, F) in deviations of a frame, in the order of what they tell for their time.

    That is what they take off the tip's mean variance, over the time of the way to them from what is chosen already,
    long_s (k, k). frames: for how many each counts. Greedy, by rank-r updates of the covariance (Fedorov 1972).
    """
    # in units of the parameters' own deviations, which are of many sizes
    size = np.sqrt(np.diag(inverse(known.information)))
    H, V = (part * np.outer(size, size) for part in (known.information, known.goal.sum(axis=0)))
    J = J * size
    order: list[int] = []
    noise = np.eye(J.shape[1]) / frames
    away_s = long_s[0].copy()
    for _ in range(min(count, len(J) - 1)):
        JC = J @ inverse(H)
        S = noise + JC @ J.transpose(0, 2, 1)
        # trace V (C - C') of the covariance with the place
        gain = np.einsum("kii->k", np.linalg.solve(S, JC @ V @ JC.transpose(0, 2, 1)))
        # time is what is scarce: a place far away has to tell more
        gain = gain / (STOP_S + away_s)
        gain[[0, *order]] = -np.inf
        best = int(gain.argmax())
        away_s = np.minimum(away_s, long_s[best])
        order.append(best)
        H = H + frames * J[best].T @ J[best]
    return order


def round_of(long_s: Array, chosen: Sequence[int]) -> list[int]:
    """Return a short round from place 0 through the chosen ones, without the end: nearest neighbours, then 2-opt."""
    open_, order = set(chosen) - {0}, [0]
    while open_:
        order.append(min(sorted(open_), key=lambda b: float(long_s[order[-1], b])))
        open_.remove(order[-1])
    D, r = long_s, np.array(order)
    n = len(r)
    for _ in range(SWAPS):
        a, b = r, np.roll(r, -1)
        # the way from i + 1 to j turned round: a_i a_j, b_i b_j in place of a_i b_i, a_j b_j
        gain = D[a, b][:, None] + D[a, b][None] - D[np.ix_(a, a)] - D[np.ix_(b, b)]
        gain[np.tril_indices(n, 1)] = 0.0
        i, j = divmod(int(gain.argmax()), n)
        if gain[i, j] < 1e-9:
            break
        r[i + 1 : j + 1] = r[i + 1 : j + 1][::-1].copy()
    return [int(k) for k in r]


def tour(scene: Scene, road: Roadmap, chosen: Sequence[int], duration_s: float) -> Tour | None:
    """Return the round through chosen places; None where no smooth way through them keeps clear, or fits the time."""
    order = round_of(road.long_s, chosen)
    stops = [0]
    for a, b in zip(order, [*order[1:], 0], strict=True):
        stops += road.between(a, b)
    return smooth(scene, road.q[stops], chosen, duration_s)


def smooth(scene: Scene, places: Array, chosen: Sequence[int], duration_s: float) -> Tour | None:
    """Return the round through places (k, n) in their order; None where none keeps clear, or fits the time."""
    for parts in PARTS:
        way = way_through(scene.arm, places, scene.bounds, parts=parts)
        if way.least_s > duration_s:
            return None
        if clear(scene, way.motion(duration_s, LOOKED_HZ)):
            return Tour(chosen=tuple(chosen), places=places, way=way)
    return None


def clear(scene: Scene, motion: Motion) -> bool:
    """Tell whether the arm may be everywhere along a motion."""
    return bool(scene.allowed(motion.q).all())


def longest(scene: Scene, road: Roadmap, order: Sequence[int], duration_s: float) -> Tour | None:
    """Return the tour through as many of the places, from the first on, as the time allows; None: not even one."""
    best, low, high = None, 1, len(order)
    while low <= high:
        middle = (low + high) // 2
        found = tour(scene, road, order[:middle], duration_s)
        if found is not None:
            best, low = found, middle + 1
        else:
            high = middle - 1
    return best
