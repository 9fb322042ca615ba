"""A round's places moved a little to where they tell more: those of a road map are drawn, and seldom at the edges."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from armsight.arrays import Array
from armsight.kinematics import fk
from armsight_lab.cell_plan.information import Known, inverse, rests
from armsight_lab.cell_plan.scene import Scene
from armsight_lab.cell_plan.tour import Tour, smooth

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
class Pusher:
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

    def pushed(self, best: Tour, information: Array) -> Tour | None:
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
