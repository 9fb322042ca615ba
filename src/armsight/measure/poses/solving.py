"""From spots that have names to a solved pose, and how well it fits."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from armsight.errors import Unseen
from armsight.measure.poses.assignment import Assignment
from armsight.measure.poses.correspondence import OUTLINE
from armsight.measure.poses.kernels import pose as kernels
from armsight.measure.poses.pairs import Pairs
from armsight.measure.poses.plausibility import add_outline_shift
from armsight.measure.poses.pose import (
    NamedSpots,
    Solved,
    lost,
    no_points,
    position_only,
    solve_frame,
    solve_points,
    solve_pose,
)
from armsight.measure.poses.setup import Setup
from armsight.records import NotSeen, Spots

Array = NDArray[np.float64]

TIGHT_PX = 0.05
"""What a good calibration leaves; residuals beyond it are reason enough to try left and right exchanged."""


def solve_assignment(setup: Setup, t_s: float, left: Spots, right: Spots, pairs: Pairs, chosen: Assignment) -> Solved:
    """Return the pose of the pairs that a hypothesis chose, under its names."""
    index = pairs.index[chosen.pair]
    return solve_spots(setup, t_s, chosen.names, take_spots(left, index[:, 0]), take_spots(right, index[:, 1]))


def solve_spots(setup: Setup, t_s: float, names: tuple[str, ...], left: Spots, right: Spots) -> Solved:
    """Return the pose of three or more named spots (the frame of an unmeasured target), or the place of fewer."""
    model, packed = setup.model, setup.packed
    uv, cov = np.empty((len(names), 2, 2)), np.empty((len(names), 2, 2, 2))  # [spot, side]
    kernels.stack_views(left.uv_px, left.covariance_px2, right.uv_px, right.covariance_px2, uv, cov)
    if model.radius_m <= 0.0:
        add_outline_shift(packed, left, right, cov)
    if len(names) < 3:
        seen = solve_points(packed, names, uv, cov)
        if isinstance(seen, NotSeen):
            return Solved(pose=lost(t_s, seen.why), points=no_points(), fits=False, cause=seen.cause)
        whole = len(names) == len(model)
        why = "a target of one or two spots" if whole else f"{len(names)} of {len(model)} spots seen"
        return Solved(
            pose=position_only(t_s, seen, f"{why}: only their position is known"),
            points=seen.points,
            cause=Unseen.SMALL_TARGET if whole else Unseen.LIGHTS_MISSING,
        )
    if not setup.target.model_known:
        return solve_frame(packed, t_s, names, uv, cov)
    rows = model.xyz_m if names == model.names else model.xyz_m[[model.names.index(name) for name in names]]
    radius, limit = _radii(model.radius_m, left, right), float(model.limits[len(names)])
    return solve_pose(
        packed,
        t_s,
        NamedSpots(names, rows, uv, cov, radius, model.normal),
        limit=limit,
        slack_px=setup.slack_px,
        covariance=setup.covariance_of(names),
    )


def _radii(radius_m: float, left: Spots, right: Spots) -> Array:
    """Return (n, 2): the radius of the flat light where the spot is its outline, else 0."""
    radius = np.zeros((len(left), 2))
    if radius_m > 0.0:
        for side, spots in enumerate((left, right)):
            radius[[kind == OUTLINE for kind in spots.model], side] = radius_m
    return radius


def misfit_chi2(solved: Solved, left: Spots, right: Spots) -> float:
    """Return chi-square of the residuals with TIGHT_PX beside the spots' own standard deviations."""
    if solved.T is None:
        return 0.0
    uv, cov = np.empty((len(left), 2, 2)), np.empty((len(left), 2, 2, 2))
    kernels.stack_views(left.uv_px, left.covariance_px2, right.uv_px, right.covariance_px2, uv, cov)
    return float(kernels.slack_chi2(np.array(solved.pose.residual_px).reshape(uv.shape), cov, TIGHT_PX**2))


def take_spots(spots: Spots, index: NDArray[np.intp]) -> Spots:
    """Return the spots in the order of index; itself where that changes nothing."""
    if len(index) == len(spots) and (index[:-1] < index[1:]).all():
        return spots
    return spots.take(index)
