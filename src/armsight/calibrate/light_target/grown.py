"""A target that no two cameras see whole at any moment: some of its lights first, the others by the rays to them.

Where a part of the lights is known, it tells where the target is in every moment that shows the part. In the target's
own axes all rays to one more light cross at it, whichever camera had them and whenever.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from armsight.arrays import Array, Index
from armsight.calibrate.light_target.checks import MIN_FRAMES
from armsight.optics import Rig
from armsight.records import NotSeen, Spots


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LitMoment:
    """All spots of one moment by camera, in the rig's order; name: how the moment is called to people."""

    name: str
    views: tuple[Spots, ...]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class NamedSights:
    """A known target in one moment: T_rig_target (4, 4), and by view its spots and which lights they are."""

    T_rig_target: Array
    spots: tuple[Spots, ...]
    names: tuple[tuple[str, ...], ...]


Look = Callable[[Sequence[Spots]], NamedSights | NotSeen]
"""What finds a known target in the views of a moment."""

REACH_PX = 3.0
"""How far a ray may pass a light: a pose by some of the lights is off by more where the others are than at these."""
LEAST_SINE = 0.05
"""Sine between two rays from which they tell where they cross."""
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


def more_lights(rig: Rig, moments: Sequence[LitMoment], X: Array, n: int, naming: Callable[[Array], Look]) -> Array:
    """Return the lights X (m, 3) of a target with as many of its others, up to n in all, as the moments tell."""
    while len(X) < n:
        crossing = _crossing(_rays(rig, moments, naming(X)), X)
        if crossing is None:
            break
        X = np.vstack([X, crossing])
    return X


def _rays(rig: Rig, moments: Sequence[LitMoment], look: Look) -> Rays:
    """Return the rays to all spots that are of no light so far, in moments that show where the target is."""
    centre, along, focal, of, view = [], [], [], [], []
    for number, moment in enumerate(moments):
        found = look(moment.views)
        if isinstance(found, NotSeen):
            continue
        R, t = found.T_rig_target[:3, :3], found.T_rig_target[:3, 3]
        for side, (one, spots, named) in enumerate(zip(rig.cameras, moment.views, found.spots, strict=True)):
            taken = (spots.uv_px[:, None] == named.uv_px[None]).all(axis=2).any(axis=1)
            if taken.all():
                continue
            directions = np.column_stack([one.camera.rays(spots.uv_px[~taken]), np.ones((~taken).sum())])
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
