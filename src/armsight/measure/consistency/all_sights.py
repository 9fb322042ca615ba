"""What cameras whose spots were left out of a pose would have told: for the check of rigs that are no pairs.

A pose takes the sights that fit it. A camera that has moved shows the same lights beside where they are expected, all
by nearly the same way: that way is looked for, and its spots are taken at their word.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from armsight.arrays import Array, Index, Mask
from armsight.measure.poses.board_views import pose_of_corners
from armsight.measure.poses.outcome import Measured
from armsight.measure.poses.pose import solve_pose
from armsight.measure.poses.setup import Setup
from armsight.measure.poses.sights import Sights
from armsight.measure.poses.solving import named_spots
from armsight.measure.poses.tracking import positions_of
from armsight.measure.poses.views import measure_views
from armsight.optics import PackedRig
from armsight.optics.kernels.camera import project_many
from armsight.records import PoseStatus, Spots

MOST_BESIDE_PX = 60.0
"""How far beside their places a camera's lights may be to be taken at their word: beyond, its own pose says more."""
FEW_BESIDE = 3
"""Lights from which a camera that takes no part contradicts the others: fewer may be reflections."""
ALIKE_PX = 1.0
ALIKE = 0.04
"""How unlike the ways of one camera's lights may be: so many px, and this share of the way."""
REFIT_SLACKS = (8.0, 32.0)
"""Factors on the slack with which a moment that gave no pose is named."""


def with_all_sights(setup: Setup, measured: Measured) -> Measured:
    """Return the moment with what all cameras say of it, however badly it fits; itself where that is what it has."""
    T, m = measured.pose.T_parent_target, len(setup.model)
    if T is None or measured.pose.status.size < 6 or not setup.target.model_known:
        return measured
    if setup.target.is_board:
        return _with_all_corners(setup, measured) if measured.notes else measured
    P, sights = positions_of(setup, T), _shown(setup, measured)
    rows = [np.full(m, -1, np.intp) for _ in measured.seen]
    more = False
    for s, seen in enumerate(measured.seen):
        if len(seen) > sights[:, s].sum() < m:
            rows[s] = _beside(setup.packed, s, P, seen)
            more |= bool((rows[s] >= 0).sum() > sights[:, s].sum())
    if not more:
        return measured
    spots = list(measured.spots)
    for s, seen in enumerate(measured.seen):
        if (rows[s] >= 0).sum() > sights[:, s].sum():
            sights[:, s] = rows[s] >= 0
            spots[s] = seen.take(rows[s][rows[s] >= 0])
    return solved_as(setup, measured, sights, spots)


def _with_all_corners(setup: Setup, measured: Measured) -> Measured:
    """Return the moment of a board with all its points, whatever their residuals; itself where that gives no pose."""
    found = pose_of_corners(setup, measured.pose.t_s, measured.seen, judged=False)
    return found if found.pose.status in (PoseStatus.OK, PoseStatus.DOUBTFUL) else measured


def shown_beside(setup: Setup, measured: Measured) -> bool:
    """Tell whether a camera shows lights near a whole pose's places of which the pose takes less than half."""
    T = measured.pose.T_parent_target
    if T is None:
        return False
    P = positions_of(setup, T)
    at = np.empty((len(P), 2))
    for s, (seen, taken) in enumerate(zip(measured.seen, measured.spots, strict=True)):
        if len(seen) < FEW_BESIDE:
            continue
        project_many(*setup.packed.camera(s), P, at)
        near = np.linalg.norm(seen.uv_px[None] - at[:, None], axis=2).min(axis=0) <= MOST_BESIDE_PX
        if near.sum() >= FEW_BESIDE and 2 * len(taken) < near.sum():
            return True
    return False


def _shown(setup: Setup, measured: Measured) -> Mask:
    """Return (m, v): which view shows which light of the target, by the moment's pose."""
    out = np.zeros((len(setup.model), len(measured.spots)), bool)
    lights = [setup.model.names.index(name) for name in measured.names]
    out[lights] = True if measured.sights is None else measured.sights
    return out


def _beside(packed: PackedRig, s: int, P: Array, seen: Spots) -> Index:
    """Return each light's spot (m,), -1 for none, in a view that shows lights P (m, 3) all beside their places."""
    at, rows = np.empty((len(P), 2)), np.full(len(P), -1, np.intp)
    project_many(*packed.camera(s), P, at)
    way = seen.uv_px[None] - at[:, None]  # (m, k, 2)
    far = np.linalg.norm(way, axis=2)
    best = 2
    for i, j in zip(*np.nonzero(far <= MOST_BESIDE_PX), strict=True):
        off = np.linalg.norm(way - way[i, j], axis=2)
        alike = off <= ALIKE_PX + ALIKE * far[i, j]
        nearest = np.where(alike.any(axis=1), np.argmin(np.where(alike, off, np.inf), axis=1), -1)
        n = len(set(nearest[nearest >= 0].tolist()))
        if n > best and n == (nearest >= 0).sum():
            best, rows = n, nearest
    return rows


def solved_as(setup: Setup, measured: Measured, sights: Mask, spots: Sequence[Spots]) -> Measured:
    """Return the moment with its pose by these sights (m, v) of the target's lights, whatever their residuals."""
    lights = np.flatnonzero(sights.any(axis=1))
    T, of = measured.pose.T_parent_target, np.full(sights.shape, -1, np.intp)
    if T is None or len(lights) < 3:
        return measured
    for s in range(len(spots)):
        of[sights[:, s], s] = np.arange(sights[:, s].sum())
    shown, views = Sights.of(setup, spots).named(setup, of, np.array(T))
    named = named_spots(setup, shown, views)
    solved = solve_pose(
        setup.packed, measured.pose.t_s, named, limit=np.inf, covariance=setup.covariance_of(shown), start=views.start
    )
    if solved.pose.status is not PoseStatus.OK:
        return measured
    return replace(measured, pose=solved.pose, spots=tuple(spots), names=shown, sights=sights[lights])


def refit_views(setup: Setup, measured: Measured) -> Measured | None:
    """Return a moment that gave no pose with its spots named more loosely; None where that gives none either."""
    if measured.busy or not setup.target.model_known:
        return None
    if setup.target.is_board:
        found = _with_all_corners(setup, measured)
        return None if found is measured else found
    for loose in REFIT_SLACKS:
        slack = replace(setup, slack_px=loose * setup.slack_px)
        found = measure_views(slack, measured.pose.t_s, measured.seen)
        if found.pose.status in (PoseStatus.OK, PoseStatus.DOUBTFUL):
            return with_all_sights(setup, found)
    return None
