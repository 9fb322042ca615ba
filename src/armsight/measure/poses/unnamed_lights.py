"""Two lights, or three that nobody has measured, before any number of cameras: by where views agree on points alone.

Two cameras have their own way, `from_spots`. Of more, the points are taken that leave the fewest equations unexplained:
a wrong pairing of two views is mostly not seen by a third.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from armsight.arrays import Index
from armsight.errors import Unseen
from armsight.measure.poses.beacon import UNMEASURED, order_by_position
from armsight.measure.poses.kernels import correspondence as kernels
from armsight.measure.poses.kernels import hidden as outlines
from armsight.measure.poses.lone_light import lights_of
from armsight.measure.poses.outcome import Measured, lost_moment
from armsight.measure.poses.pairs import PAIR_GATE
from armsight.measure.poses.pose import PoseSolution, lost, no_points, solve_points
from armsight.measure.poses.setup import Setup
from armsight.measure.poses.sights import Sights
from armsight.measure.poses.solving import compare, solve_views, take_spots, why_hidden, widened_or_odd
from armsight.optics.kernels.camera import project_many
from armsight.records import Frame, NotSeen, PoseStatus, Spots
from armsight.records.checks import for_kernels

Light = tuple[int, ...]
"""Which spot of each view (v) it is, -1 for none."""

MOST_LIGHTS = 24
"""Points that two views agree on, of which sets are made; before more of them it is guesswork which are lights."""
MOST_SETS = 20_000

_NOWHERE = np.zeros((4, 4))


def measure_unnamed(
    setup: Setup, t_s: float, seen: Sequence[Spots], frames: Sequence[Frame | None] | None = None
) -> Measured:
    """Return the frame of three unmeasured lights (Pachidis 2005), or the position of two, from all spots of the views.

    Unmeasured lights are named by their order in the picture of the rig's first camera, as far as that goes: A left, B
    lower right, C upper right. frames: as measure_views takes them.
    """
    sights = Sights.of(setup, seen)
    found = lights_of(setup, sights)
    chosen = found if isinstance(found, NotSeen) else _chosen(setup, sights, sorted(found))
    if isinstance(chosen, NotSeen):
        return lost_moment(t_s, sights.by_view, chosen)
    rows, solved, hidden = _looked_at(setup, t_s, sights, chosen, frames)
    if solved.pose.status is PoseStatus.LOST:
        missed = NotSeen(why_hidden(hidden, PoseStatus.LOST), Unseen.HALF_HIDDEN) if hidden else solved.missed
        return lost_moment(t_s, sights.by_view, missed)
    names = setup.model.names if len(setup.model) > 2 else ("?",) * len(rows)
    return Measured(
        pose=replace(solved.pose, spots=names),
        points=replace(solved.points, names=names),
        spots=tuple(take_spots(one, r[r >= 0]) for one, r in zip(sights.by_view, rows.T, strict=True)),
        names=names,
        seen=sights.by_view,
        sights=rows >= 0,
        notes=tuple(f"{name} half hidden from one camera, and left out of its view" for name in hidden),
        cause=solved.cause,
    )


def _chosen(setup: Setup, sights: Sights, found: list[Light]) -> Index | NotSeen:
    """Return the lights (n, v) in the order of their names, or why it is not clear which they are."""
    if len(found) > MOST_LIGHTS:
        return NotSeen(f"{len(found)} points could be lights: {UNMEASURED}", Unseen.CROWD)
    sets = _sets(found)
    if sets is None:
        return NotSeen(f"{len(found)} points could be lights in too many ways: {UNMEASURED}", Unseen.CROWD)
    best = max(map(_surplus, sets))
    likely = [one for one in sets if _surplus(one) == best]
    m = len(setup.model)
    if m > 2:
        return _in_order(setup, sights, likely)
    pairs = [one for one in sets if len(one) == m]
    if not pairs or all(len(one) < m for one in likely):
        return _only(likely)
    fitting = [one for one in pairs if not setup.target.model_known or _fits(setup, sights, one)]
    if not fitting:
        return NotSeen("two lights are seen, but not as far apart as the target's are", Unseen.WRONG_TARGET)
    best = max(map(_surplus, fitting))
    return _only([one for one in fitting if _surplus(one) == best])


def _sets(found: list[Light]) -> list[tuple[Light, ...]] | None:
    """Return all sets of lights that use no spot twice; None where there are too many."""
    sets: list[tuple[Light, ...]] = [()]
    for light in found:
        sets += [(*one, light) for one in sets if not any(_share(light, other) for other in one)]
        if len(sets) > MOST_SETS:
            return None
    return sets[1:]


def _share(a: Light, b: Light) -> bool:
    return any(i == j >= 0 for i, j in zip(a, b, strict=True))


def _surplus(lights: tuple[Light, ...]) -> int:
    """Return how many equations speak for lights: two of each sight, less the three of each place."""
    return sum(2 * sum(i >= 0 for i in light) - 3 for light in lights)


def _only(sets: list[tuple[Light, ...]]) -> Index | NotSeen:
    if len(sets) > 1:
        why = f"ambiguous: the spots of the cameras are the same lights in {len(sets)} ways"
        return NotSeen(why, Unseen.AMBIGUOUS)
    return np.array(sets[0], np.intp)


def _fits(setup: Setup, sights: Sights, two: tuple[Light, ...]) -> bool:
    """Whether two lights are as far apart as the target's."""
    _, views = sights.named(setup, np.array(two, np.intp), _NOWHERE)
    cov = views.cov_px2 + setup.slack_px**2 * np.eye(2)
    placed = solve_points(setup.packed, setup.model.names, views.uv_px, cov)
    if isinstance(placed, NotSeen):
        return False
    P, S = (for_kernels(part) for part in (placed.points.xyz_m, placed.points.covariance_m2))
    return bool(kernels.distance_fits(P, S, 0, 1, setup.model.distance_m[0, 1], PAIR_GATE))


def _in_order(setup: Setup, sights: Sights, likely: list[tuple[Light, ...]]) -> Index | NotSeen:
    """Return three lights in the order of their names."""
    only, m = _only(likely), len(setup.model)
    if isinstance(only, NotSeen):
        return only
    if len(only) != 3 or m != 3:
        why = f"a target that has not been measured needs exactly three lights in two cameras, not {len(only)}"
        more = len(only) > 3
        return NotSeen(f"{why}: {UNMEASURED}" if more else why, Unseen.CROWD if more else Unseen.LIGHTS_MISSING)
    names, views = sights.named(setup, only, _NOWHERE)
    placed = solve_points(setup.packed, names, views.uv_px, views.cov_px2)
    if isinstance(placed, NotSeen):
        return placed
    at = np.empty((m, 2))
    project_many(*setup.packed.camera(0), for_kernels(placed.points.xyz_m), at)
    order = order_by_position(at) if np.isfinite(at).all() else None
    if order is None:
        why = f"ambiguous: the lights have no clear order left to right as {setup.rig.names[0]} has them"
        return NotSeen(why, Unseen.AMBIGUOUS)
    return only[order]


def _looked_at(
    setup: Setup, t_s: float, sights: Sights, rows: Index, frames: Sequence[Frame | None] | None
) -> tuple[Index, PoseSolution, tuple[str, ...]]:
    """Return the sights that are whole, what is solved from them, and the lights that are half hidden in a view."""
    hidden = list[str]()
    while True:
        names, views = sights.named(setup, rows, _NOWHERE)
        solved = solve_views(setup, t_s, names, views)
        if frames is None or solved.pose.status is PoseStatus.LOST:
            return rows, solved, tuple(hidden)
        verdict, out = compare(setup, solved.points.xyz_m, solved.T, sights.taken(rows), frames)
        if verdict == outlines.NO_DOUBT:
            return rows, solved, tuple(hidden)
        widened, odd = widened_or_odd(setup, t_s, names, views, solved, out)
        if widened is not None:
            return rows, widened, tuple(hidden)
        hidden += [names[i] for i in np.flatnonzero(odd.any(axis=0)).tolist()]
        rows = rows.copy()
        rows[odd.T] = -1
        if ((rows >= 0).sum(axis=1) < 2).any():
            why = "too few lights are seen as a whole"
            return rows, PoseSolution(pose=lost(t_s, why), points=no_points(), cause=Unseen.HALF_HIDDEN), tuple(hidden)
