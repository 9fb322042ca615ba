"""Rows that are not independent without saying so: readings of one joint position, samples of one motion."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from armsight.calibrate.arm.points import ArmPoints
from armsight.fitting.groups import means, repeats

SAME_PLACE = 1e-3
"""Readings of one place differ by no more (rad, m): what a controller holds a joint to is a tenth of it."""
APART = 1e3
"""Between the tool's points in the space that places are looked for in: never one place."""
FEWEST_SAMPLES = 60
"""Rows from which an order is looked for: of fewer, steps are small by chance."""
SMOOTH = 0.05
"""Squared steps from row to row over those of rows in random order, of every joint that moves, below which rows follow
one motion; a scan by one joint after the other has one that jumps."""
MOVES = 0.01
"""A joint that moved less (rad, m) says nothing of the order."""


def of_places(points: ArmPoints) -> ArmPoints:
    """Return one row for all readings of a point at a joint position, their mean; as they are where nothing repeats.

    What the arm has wrong there (gears, give, play) all of them have.
    """
    label = np.array([points.labels.index(name) for name in points.point], float)
    of = repeats(np.column_stack([points.q, APART * label]), SAME_PLACE)
    if of.max() + 1 == len(points):
        return points
    first = np.unique(of, return_index=True)[1]
    count = np.bincount(of)[:, None, None]
    rotation, covariance = points.rotation, points.covariance
    return replace(
        points.take(first),
        q=means(points.q, of),
        xyz_m=means(points.xyz_m, of),
        rotation=None if rotation is None else Rotation.from_matrix(means(rotation, of)).as_matrix(),
        t_s=None if points.t_s is None else means(points.t_s, of),
        # what readings say of their own noise averages out; what is the place's the fit finds beside it
        covariance=None if covariance is None else means(covariance, of) / count,
    )


def in_order(points: ArmPoints) -> ArmPoints:
    """Return rows without times that follow one motion with their order for a time; others as they are."""
    if points.t_s is not None or len(points) < FEWEST_SAMPLES:
        return points
    moves = np.ptp(points.q, axis=0) > MOVES
    steps = np.diff(points.q[:, moves], axis=0)
    share = (steps**2).mean(axis=0) / (2.0 * points.q[:, moves].var(axis=0))
    if not moves.any() or share.max() > SMOOTH:
        return points
    order = np.concatenate([[0], np.cumsum((np.diff(points.q, axis=0) != 0.0).any(axis=1))])
    return replace(points, t_s=order.astype(float), counted=True)
