"""What the arm's own motion makes of the target in the pictures, held against what the cameras see of it.

The servo believes a hand-eye calibration, a rig, a target, the pictures' times and the arm's model. Each of them, where
it is wrong, lets the target seem to move as the arm does. A hand may lead the target meanwhile, so that no motion of it
is impossible: what is asked is under which premise it moves most as a hand does. A premise other than the one believed
that explains the newest second so much better that chance does not is found to be what is so.

A hand: an integrated Wiener process of third order (Wahba 1978), its level free; from reach to reach its jerk cannot be
foretold, place and velocity at the beginning are unknown. What follows from a motion of the arm that the target itself
led to is foretold by nobody better than by the premise that holds, so that the ratio of likelihoods stays small in
honest runs, closed loop or not (Ville 1939).
"""

from __future__ import annotations

from collections import deque
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from armsight.arrays import Array
from armsight.control.servo.premise_bank import TERMS, UNMOVED, Premise, bank, late_by
from armsight.units import DEG

FRAMES, FEWEST = 40, 7
"""Frames that are looked at: 1.3 s of a webcam; of fewer than FEWEST nothing is told."""
STEP_S = 0.02
"""Frames nearer to the last one than this are left out: a faster camera would fill the window in no time."""
BACK = (1, 2, 3, 4, 6, 8, 11, 15, 20, 30)
"""Frames by which pictures may be older than their stamps: up to a second of a webcam."""
MODES = 20
"""The slowest shapes of a hand's way in the window; what is faster than three frames is noise under any premise."""
LEVELS = np.concatenate([[0.0], np.logspace(-5.0, 3.0, 9)])
"""Power density of the hand's jerk in m^2/s^5: a target that stands, up to reaches at 0.5 m/s."""
BEGIN_S = 1.0
"""The hand's acceleration at the beginning is what its jerk makes in so long."""
FLOOR_M = 1e-4
"""Standard deviation added to a position: tremor of a hand (0.07 mm), shaking and steps of an arm."""
HONEST_S = 0.006
"""Standard deviation of the pictures' times where they are honest."""
JITTER_S = 0.002
"""Standard deviation of a picture's time beside the others', and of what joints do between two readings."""
LATE_S = 0.025
"""Pictures that are older than their times by no more than this are not called late."""
CALM = 1.0
"""How much less likely a hand is held to be for each tenfold of its jerk's power."""
LIKELY, MOVING = 12.0, 4.0
"""Logarithm of the ratio of likelihoods, less a premise's handicap, from which on it is held to be so: where the target
stands under it, and how much more for each tenfold of its jerk's power. Of hands that move less is known: honest ones
came to 12.6 at the second level and to 15 at the fourth; wrong premises before a target that stands are at none."""
UNFIT = 15
"""So many poses in a row that cannot be, before any that can, are no reflection and no hand before a light."""
ENOUGH, MISSING = 20, 0.5
"""Each frame that a window has less than ENOUGH asks for so much more: a hand's reach is even for a third of a second,
and an arm that starts after it goes as it does. An honest one came to 14.4 in ten frames."""
STILL_M, STILL_RAD = 5e-4, 0.1 * DEG
"""A camera that moved less in the window tells nothing."""
LEVER_M = 0.01 / (2.0 * DEG)
"""A turn counts as the way at this lever: 2 degrees as 10 mm."""
TICK_S = 1e-4
"""Step in which the times of a window are told where a hand's shapes are made from them: even frames share theirs."""


class PremiseWatch:
    """Watches one track of a target. One thread sees; any may look at wrong and way_m."""

    def __init__(self, others: tuple[Premise, ...] = (), late_s: float = LATE_S) -> None:
        """others: premises under which the cameras are elsewhere; where, is told with each frame. late_s: by how much
        pictures may be older than their times."""
        self._others, self._late_s = others, late_s
        self._t_s: deque[float] = deque(maxlen=FRAMES)
        self._T: deque[Array] = deque(maxlen=BACK[-1] + 1)
        self._rows: deque[Array] = deque(maxlen=FRAMES)
        self._turns: deque[Array] = deque(maxlen=FRAMES)
        handicaps = [one.handicap for one in (*bank()[0], UNMOVED, *map(late_by, BACK), *others)]
        self._handicaps = np.array(handicaps)
        self._anew = False
        self._unfit = 0
        self.way_m = 0.0
        self.wrong: Premise | None = None

    def see(self, t_s: float, T_frame_rig: Array, xyz_m: Array, sigma_m: Array, others: Array | None = None) -> None:
        """Take where the rig was, (4, 4), in the axes in which a hand leads the target (those of the arm's base) or in
        which it stands, as the target was seen at xyz_m (3,) in rig axes, at t_s.

        sigma_m (3,): standard deviations in rig axes. others (k, 4, 4): where the rig was under each other premise.
        """
        if self._anew:
            self.begin()
        self._unfit = 0
        if self._t_s and t_s - self._t_s[-1] < STEP_S:
            return
        if self._T:
            before = self._T[-1]
            turn = np.arccos(np.clip(0.5 * (np.trace(before[:3, :3].T @ T_frame_rig[:3, :3]) - 1.0), -1.0, 1.0))
            way_m = np.linalg.norm(T_frame_rig[:3, 3] - before[:3, 3])
            self.way_m += float(max(way_m, LEVER_M * turn))
        self._t_s.append(t_s)
        self._T.append(T_frame_rig)
        newest = len(self._T) - 1
        T = np.array([self._T[max(newest - k, 0)] for k in BACK])  # where it was before the first frame, it stood
        T = T if others is None else np.concatenate([T, others])
        point = np.append(xyz_m, 1.0)
        products = T_frame_rig[:3, :, None] * point
        self._rows.append(np.concatenate([products.ravel(), xyz_m, (T[:, :3] @ point).ravel(), sigma_m]))
        self._turns.append(np.concatenate([np.eye(3)[None], T[:, :3, :3]]))
        if len(self._rows) >= FEWEST:
            self.wrong = self._judged()

    def refuse(self, premise: Premise) -> None:
        """Take a pose that cannot be, and what it looks like; where none was seen that can, that is what is so."""
        self._unfit += 1
        if self._unfit >= UNFIT and not self._t_s:
            self.wrong = premise

    def begin(self) -> None:
        """Begin anew: another track of the target. For the thread that sees."""
        for kept in (self._t_s, self._T, self._rows, self._turns):
            kept.clear()
        self.way_m, self.wrong, self._anew = 0.0, None, False

    def forget(self) -> None:
        """Forget what was found: the operator has looked. What the target did before the arm moved still counts."""
        self._anew = self._anew or self.wrong is not None
        self.way_m, self.wrong = 0.0, None

    def _judged(self) -> Premise | None:
        """Return the likeliest premise where one is far likelier than the one believed; once it was, with each frame
        anew: the first that is likely is not always the likeliest in the end."""
        n, t_s, rows = len(self._rows), np.array(self._t_s), np.array(self._rows)
        products, ways, sigma_m = rows[:, :TERMS], rows[:, TERMS:-3], rows[:, -3:]
        T = products.reshape(n, 3, 4, 4)[..., 3]
        moved = T.max(axis=0) - T.min(axis=0)
        if max(moved[:, 3].max() / STILL_M, moved[:, :3].max() / STILL_RAD) < 1.0:
            return self.wrong
        variances, modes = hand_modes(tuple(np.rint((t_s - t_s[0]) / TICK_S).tolist()))
        believed, weights, honest = bank()
        R = T[n // 2, :, :3]  # all is told in the axes of the middle frame, each premise's own
        terms = (R.T @ (modes.T @ products).reshape(-1, 3, 16)).reshape(-1, TERMS)
        told = np.einsum("khl,hli->ikh", (modes.T @ ways).reshape(len(variances), -1, 3), self._turns[n // 2])
        paths = np.concatenate([terms @ weights, told], axis=2)  # (3, k, h)
        speeds = swept(t_s, T, rows[:, TERMS : TERMS + 3]) @ R
        doubt = np.concatenate([terms @ honest, HONEST_S * (modes.T @ speeds).T[:, :, None]], axis=2)
        variance_m2 = np.square(sigma_m).mean(axis=0) + FLOOR_M**2 + np.square(JITTER_S * speeds).mean(axis=0)
        likely, level = likelihoods(paths, doubt, variances, variance_m2)
        late_s = np.array(BACK) * float(t_s[-1] - t_s[0]) / (n - 1)
        borne = len(believed) + 1 + np.flatnonzero(late_s <= self._late_s)
        likely[0] = max(likely[0], *likely[borne], -np.inf)
        likely[borne] = -np.inf
        over = likely - likely[0] - self._handicaps - MOVING * level
        if self.wrong is None and over.max() < LIKELY + MISSING * max(ENOUGH - n, 0):
            return None
        return (*believed, UNMOVED, *map(late_by, late_s.tolist()), *self._others)[1 + int(np.argmax(likely[1:]))]


@lru_cache(maxsize=64)
def hand_modes(ticks: tuple[float, ...]) -> tuple[Array, Array]:
    """Return variances (k,) of a hand's ways (n, k) at times (n,), beside place and velocity, for a unit of power."""
    t = TICK_S * np.array(ticks)
    s, u = np.minimum.outer(t, t), np.maximum.outer(t, t)
    K = s**3 * (10.0 * u**2 - 5.0 * u * s + s**2) / 120.0 + BEGIN_S * np.square(s * u) / 4.0
    free = np.linalg.qr(np.stack([np.ones_like(t), t], axis=1), mode="complete")[0][:, 2:]
    variances, shapes = np.linalg.eigh(free.T @ K @ free)
    return np.maximum(variances[::-1][:MODES], 0.0), np.asarray(free @ shapes[:, ::-1][:, :MODES])


def swept(t_s: Array, T: Array, xyz_m: Array) -> Array:
    """Return the velocity (n, 3) of a point fixed to the rigs T (n, 3, 4) at xyz_m (n, 3): what an error of time does,
    in the axes of T."""
    k = np.arange(len(t_s))
    after, before = np.minimum(k + 1, len(k) - 1), np.maximum(k - 1, 0)
    change = T[after] - T[before]
    way = (change[:, :, :3] * xyz_m[:, None, :]).sum(axis=2) + change[:, :, 3]
    return np.asarray(way / (t_s[after] - t_s[before])[:, None])


def likelihoods(paths: Array, doubt: Array, variances: Array, variance_m2: Array) -> tuple[Array, NDArray[np.intp]]:
    """Return (h,) logarithms of the likelihood of ways (3, k, h), each at its best one of LEVELS, and which (h,).

    doubt (3, k, r): what the honest errors do to a way, each of unit deviation; they are eliminated, as is usual in
    generalised least squares. variances (k,): of the hand's shapes. variance_m2 (3,): of a position.
    """
    x, g = paths.reshape(-1, paths.shape[2]), doubt.reshape(-1, doubt.shape[2]).T
    V = (LEVELS[:, None, None] * variances + variance_m2[:, None]).reshape(len(LEVELS), -1)
    weighed = g / V[:, None]  # (level, r, 3 k)
    root = np.linalg.cholesky(np.eye(len(g)) + weighed @ g.T)
    projector = (np.linalg.inv(root) @ weighed).reshape(-1, len(x))
    explained = np.square(projector @ x).reshape(len(LEVELS), len(g), -1).sum(axis=1)
    spread_log = np.log(V).sum(axis=1) + 2.0 * np.log(np.diagonal(root, axis1=1, axis2=2)).sum(axis=1)
    likely = (
        -0.5 * ((1.0 / V) @ np.square(x) - explained + spread_log[:, None]) - CALM * np.arange(len(LEVELS))[:, None]
    )
    return likely.max(axis=0), likely.argmax(axis=0)
