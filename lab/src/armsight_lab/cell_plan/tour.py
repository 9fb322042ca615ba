"""Places chosen by what they tell, and a round way through them that fits into a given time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from armsight.arrays import Array
from armsight.kinematics import fk
from armsight.records import Motion
from armsight_lab.cell_plan.information import Known, inverse, rests
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
class MotionPlan:
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


def tour(scene: Scene, road: Roadmap, chosen: Sequence[int], duration_s: float) -> MotionPlan | None:
    """Return the round through chosen places; None where no smooth way through them keeps clear, or fits the time."""
    order = round_of(road.long_s, chosen)
    stops = [0]
    for a, b in zip(order, [*order[1:], 0], strict=True):
        stops += road.between(a, b)
    return smooth(scene, road.q[stops], chosen, duration_s)


def smooth(scene: Scene, places: Array, chosen: Sequence[int], duration_s: float) -> MotionPlan | None:
    """Return the round through places (k, n) in their order; None where none keeps clear, or fits the time."""
    for parts in PARTS:
        way = way_through(scene.arm, places, scene.bounds, parts=parts)
        if way.least_s > duration_s:
            return None
        if clear(scene, way.motion(duration_s, LOOKED_HZ)):
            return MotionPlan(chosen=tuple(chosen), places=places, way=way)
    return None


def clear(scene: Scene, motion: Motion) -> bool:
    """Tell whether the arm may be everywhere along a motion."""
    return bool(scene.allowed(motion.q).all())


def longest(scene: Scene, road: Roadmap, order: Sequence[int], duration_s: float) -> MotionPlan | None:
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


CANDIDATES = 10
"""Readings that are drawn about each place that is to be moved."""
FAR = 0.15
"""rad or m: how far they are drawn, standard deviation of a joint."""
SHARE, LEAST_SHARE = 0.5, 0.05
"""Of the places moved at once: at first, and at least; less where nothing came of it."""
FEWER, MORE = 0.8, 1.1
DEARER, CHEAPER = 1.5, 0.9
"""Changes of the price of time: where a round no longer fits, and where it does."""
CORNER = 8
"""Power in which the shares of the joints' and the tool's limits add up, as along the way itself."""


@dataclass(slots=True, kw_only=True)
class LocalSearch:
    """Moves some of a round's places at once, each to the best of a few drawn about it.

    The best one takes most off the mean variance, per frame and by its slope, trace(C V C J' J) for the covariance C of
    all that is known; less what the longer way to its neighbours costs, at the price of what all places tell in that
    time on average. How many are moved, and the price, follow what comes of it.
    """

    scene: Scene
    known: Known
    spot_px: float
    duration_s: float
    rng: np.random.Generator
    share: float = field(init=False, default=SHARE)
    price: float = field(init=False, default=1.0)

    def pushed(self, best: MotionPlan, information: Array) -> MotionPlan | None:
        """Return a round with some places elsewhere; None where nothing better is near, or it does not fit or clear."""
        places = best.places
        picked = 1 + np.flatnonzero(self.rng.random(len(places) - 2) < self.share)  # it begins and ends at the start
        moved = self._moved(places, picked, information)
        if moved is None:
            return None
        other = smooth(self.scene, moved, best.chosen, self.duration_s)
        if other is None:
            self.price *= DEARER
            self.share = max(self.share * FEWER, LEAST_SHARE)
        return other

    def learn(self, *, better: bool) -> None:
        """Take what came of the last one that fitted."""
        self.price = max(self.price * CHEAPER, 1.0)
        self.share = min(self.share * MORE, SHARE) if better else max(self.share * FEWER, LEAST_SHARE)

    def _moved(self, places: Array, picked: NDArray[np.intp], information: Array) -> Array | None:
        at = np.repeat(picked, CANDIDATES)
        far = FAR * self.rng.uniform(0.1, 1.0, (len(at), 1))
        q = places[at] + self.rng.normal(size=(len(at), places.shape[1])) * far
        # out of view it would tell nothing, and the way there would be gone for nothing
        good = self.scene.allowed(q)
        good[good] = self.scene.seen(q[good])
        at, q = at[good], q[good]
        if not len(q):
            return None
        C = inverse(self.known.information + information)
        slope = C @ self.known.goal.sum(axis=0) @ C
        # by the slope at all that is known: what a frame there takes off the mean variance
        now, then = self._told(places, slope), self._told(q, slope)
        longer = sum(self._apart_s(q, places[at + k]) - self._apart_s(places[at], places[at + k]) for k in (-1, 1))
        # a place has its share of the time; a longer way is paid by all others
        gain = (then - now[at]) * self.duration_s / len(places) - self.price * now.mean() * longer
        out = places.copy()
        for place in np.unique(at).tolist():
            own = np.flatnonzero(at == place)
            first = own[gain[own].argmax()]
            if gain[first] > 0.0:
                out[place] = q[first]
        return None if np.array_equal(out, places) else out

    def _told(self, q: Array, slope: Array) -> Array:
        """Return by how much a frame at readings (m, n) makes the mean variance less, by its slope; 0 out of view."""
        J = rests(self.scene, self.known, q, self.spot_px)
        return np.asarray(((J @ slope) * J).sum(axis=(1, 2)) * self.scene.seen(q))

    def _apart_s(self, a: Array, b: Array) -> Array:
        """Return about how long the way from a to b (m, n) takes at the limits of speed."""
        bounds, arm = self.scene.bounds, self.scene.arm
        T, U = fk(arm, arm.values(a)), fk(arm, arm.values(b))
        turn = (Rotation.from_matrix(T[:, :3, :3]).inv() * Rotation.from_matrix(U[:, :3, :3])).magnitude()
        moved = np.linalg.norm(T[:, :3, 3] - U[:, :3, 3], axis=1)
        shares = np.column_stack([np.abs(a - b) / bounds.speed, moved / bounds.speed_m_s, turn / bounds.turn_rad_s])
        return np.asarray((shares**CORNER).sum(axis=1) ** (1.0 / CORNER))
