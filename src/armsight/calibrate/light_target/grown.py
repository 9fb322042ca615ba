"""A target that no two cameras see whole at any moment: some of its lights first, the others by the rays to them.

Where a part of the lights is known, it tells where the target is in every moment that shows the part. In the target's
own axes all rays to one more light cross at it, whichever camera had them and whenever.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations, permutations
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from armsight.arrays import Array, Index
from armsight.calibrate.light_target.adjustment import Sight
from armsight.calibrate.light_target.checks import MIN_FRAMES
from armsight.calibrate.light_target.naming import align, distances, facing, near
from armsight.fitting.quantiles import chi2_isf
from armsight.optics import Rig
from armsight.records import Spots


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LitMoment:
    """All spots of one moment by camera, in the rig's order; name: how the moment is called to people."""

    name: str
    views: tuple[Spots, ...]


REACH_PX = 3.0
"""How far a ray may pass a light: a pose by some of the lights is off by more where the others are than at these."""
LEAST_SINE = 0.05
"""Sine between two rays from which they tell where they cross."""
BY_CHANCE = 1e-4
"""Chance that three lights are not taken for themselves."""
ANOTHER_M = 5e-3
"""Poses that put a light further apart than this are two."""
ORDERS = np.array(list(permutations(range(3))), dtype=np.intp)
MOST_RAYS = 300
"""Rays of which every two are tried; all are held against what they give."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Rays:
    """Rays to unnamed spots in the target's axes: centre, along (r, 3), of length 1; focal_px (r,); of (r,): which
    moment; view (r,): which picture of all."""

    centre: Array
    along: Array
    focal_px: Array
    of: Index
    view: Index

    def near(self, X: Array) -> NDArray[np.bool_]:
        """Tell which rays (k, r) pass the points X (k, 3) within REACH_PX."""
        away = X[:, None] - self.centre
        depth = (away * self.along).sum(axis=2)
        aside = np.linalg.norm(away - depth[:, :, None] * self.along, axis=2)
        return np.asarray((depth > 0.0) & (aside * self.focal_px < REACH_PX * depth))


class Placed(NamedTuple):
    """The target in a moment: R (3, 3), t (3,) of it in rig axes, and by view which spots are of known lights."""

    number: int
    R: Array
    t: Array
    taken: tuple[NDArray[np.bool_], ...]

    @property
    def n_sights(self) -> int:
        """How many sights it explains."""
        return int(sum(view.sum() for view in self.taken))


def more_lights(rig: Rig, moments: Sequence[LitMoment], X: Array, n: int, sights: Sequence[Sight]) -> Array:
    """Return the lights X (m, 3) of a target with as many of its others, up to n in all, as the moments tell.

    The first three are seen from the side that z points away from. sights: every three that two cameras place.
    """
    while len(X) < n:
        crossing = _crossing(_rays(rig, moments, _placed(rig, moments, X, sights)), X)
        if crossing is None:
            break
        X = np.vstack([X, crossing])
    return X


def _placed(rig: Rig, moments: Sequence[LitMoment], X: Array, sights: Sequence[Sight]) -> list[Placed]:
    """Return the target in the moments that show three of its lights X (m, 3) together, and in one attitude alone."""
    found: dict[int, list[Placed]] = {}
    for three in combinations(range(len(X)), 3):
        Y = X[list(three)]
        tried, _ = near(sights, distances(Y), np.zeros(3), ORDERS)
        if not tried:
            continue
        P, C = (np.array([getattr(sights[s], of)[c][ORDERS[p]] for s, c, p in tried]) for of in ("xyz_m", "cov_m2"))
        R, t, chi2 = align(Y, P, np.linalg.inv(C))
        fits = chi2 < float(chi2_isf(BY_CHANCE, 3))
        if three == (0, 1, 2):
            fits &= facing(R, t, Y, np.array([0.0, 0.0, 1.0])) > 0.0
        for k in np.flatnonzero(fits):
            number = sights[tried[k][0]].frame
            found.setdefault(number, []).append(_explained(rig, number, moments[number], X, R[k], t[k]))
    return [best for each in found.values() if (best := _alone(each, X)) is not None]


def _explained(rig: Rig, number: int, moment: LitMoment, X: Array, R: Array, t: Array) -> Placed:
    images = rig.project(X @ R.T + t)
    off = [np.linalg.norm(spots.uv_px[:, None] - uv, axis=2) for spots, uv in zip(moment.views, images, strict=True)]
    return Placed(number, R, t, tuple(np.asarray((far < REACH_PX).any(axis=1)) for far in off))


def _alone(each: list[Placed], X: Array) -> Placed | None:
    """Return the pose that explains most sights; None where another one explains as many."""
    best = max(each, key=lambda one: one.n_sights)
    for one in each:
        elsewhere = np.linalg.norm(X @ (one.R - best.R).T + one.t - best.t, axis=1).max() > ANOTHER_M
        if elsewhere and one.n_sights == best.n_sights:
            return None
    return best


def _rays(rig: Rig, moments: Sequence[LitMoment], placed: Sequence[Placed]) -> Rays:
    """Return the rays to all spots that are of no light so far, in moments that show where the target is."""
    centre, along, focal, of, view = [], [], [], [], []
    for number, R, t, taken in placed:
        for side, (one, spots) in enumerate(zip(rig.cameras, moments[number].views, strict=True)):
            rest = spots.uv_px[~taken[side]]
            if not len(rest):
                continue
            directions = np.column_stack([one.camera.rays(rest), np.ones(len(rest))])
            directions = directions[np.isfinite(directions).all(axis=1)]
            rows = one.T_rig_camera.rotation.apply(directions).reshape(-1, 3) @ R
            along.append(rows / np.linalg.norm(rows, axis=1, keepdims=True))
            centre.append(np.tile((np.asarray(one.T_rig_camera.translation) - t) @ R, (len(rows), 1)))
            focal += [one.camera.intrinsics[0]] * len(rows)
            of += [number] * len(rows)
            view += [number * len(rig.cameras) + side] * len(rows)
    return Rays(
        centre=np.concatenate([np.empty((0, 3)), *centre]),
        along=np.concatenate([np.empty((0, 3)), *along]),
        focal_px=np.array(focal),
        of=np.array(of, dtype=np.intp),
        view=np.array(view, dtype=np.intp),
    )


def _crossing(rays: Rays, X: Array) -> Array | None:
    """Return the point (3,) at which rays of most pictures cross, away from the lights X (m, 3); None without any."""
    tried = np.linspace(0, len(rays.of) - 1, min(len(rays.of), MOST_RAYS)).astype(int)
    a, b = (tried[k] for k in np.triu_indices(len(tried), 1))
    other = rays.view[a] != rays.view[b]
    a, b = a[other], b[other]
    c = (rays.along[a] * rays.along[b]).sum(axis=1)
    across = 1.0 - c**2 > LEAST_SINE**2
    a, b, c = a[across], b[across], c[across]
    apart = rays.centre[b] - rays.centre[a]
    # the nearest points of two rays: along a by s, along b by u
    to_a, to_b = (apart * rays.along[a]).sum(axis=1), (apart * rays.along[b]).sum(axis=1)
    s, u = (to_a - c * to_b) / (1.0 - c**2), (c * to_a - to_b) / (1.0 - c**2)
    on_a, on_b = rays.centre[a] + s[:, None] * rays.along[a], rays.centre[b] + u[:, None] * rays.along[b]
    miss = np.linalg.norm(on_a - on_b, axis=1)
    meet = (s > 0.0) & (u > 0.0) & (miss * rays.focal_px[a] < REACH_PX * s) & (miss * rays.focal_px[b] < REACH_PX * u)
    best, most = None, 0
    for k in np.flatnonzero(meet):
        point = 0.5 * (on_a[k] + on_b[k])
        near = rays.near(point[None])[0]
        views = len(np.unique(rays.view[near]))
        if views > most and len(np.unique(rays.of[near])) >= MIN_FRAMES and not _is_one(point, X, s[k], rays, a[k]):
            best, most = _least_squares(rays, near), views
    return best


def _is_one(point: Array, X: Array, depth_m: float, rays: Rays, ray: int) -> bool:
    """Tell whether a point is one of the lights X (m, 3) that a picture did not show by its name."""
    return bool((np.linalg.norm(X - point, axis=1) * rays.focal_px[ray] < 2.0 * REACH_PX * depth_m).any())


def _least_squares(rays: Rays, near: NDArray[np.bool_]) -> Array:
    """Return the point (3,) nearest to the rays."""
    d = rays.along[near]
    P = np.eye(3) - d[:, :, None] * d[:, None, :]
    return np.asarray(np.linalg.solve(P.sum(axis=0), (P @ rays.centre[near][:, :, None]).sum(axis=0)[:, 0]))
