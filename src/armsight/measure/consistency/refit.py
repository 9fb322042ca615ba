"""A frame that was refused, or of which lights were left out, fitted as a whole: no pose, but what it tells."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from armsight.measure.consistency.evidence import stacked
from armsight.measure.poses.correspondence import match_known
from armsight.measure.poses.outcome import Measured
from armsight.measure.poses.pairs import pair_spots
from armsight.measure.poses.pose import NamedSpots, solve_pose
from armsight.measure.poses.setup import Setup
from armsight.measure.poses.tracking import expected
from armsight.records import PoseStatus

REFIT_SLACKS = (8.0, 32.0)
"""Factors on the slack, one after the other: residuals of 2 px, and of 8 px as of a camera knocked by half a degree."""


def refit(setup: Setup, measured: Measured) -> Measured | None:
    """Return the moment with all of its lights named and placed, however badly they fit; None where not clear.

    A frame that does not fit the target says more about what is wrong than those that just do. Three lights or more.
    """
    left, right, model = measured.left_seen, measured.right_seen, setup.model
    whole = min(len(model), len(left), len(right))
    if measured.busy or whole < 3 or setup.target.is_board or not setup.target.model_known:
        return None
    t_s = measured.pose.t_s
    for loose in REFIT_SLACKS:
        slack = loose * setup.slack_px
        pairs = pair_spots(setup.packed, left, right, slack, overlaid=setup.overlaid)
        if len(pairs.index) < whole:
            continue
        predicted = expected(setup, measured.track, t_s)
        best = match_known(setup.packed, model, left, right, pairs, prediction=predicted, slack_px=slack).best
        if best is None or len(best.names) < whole:
            continue
        index = pairs.index[best.pair]
        at_left, at_right = left.take(index[:, 0]), right.take(index[:, 1])
        uv, cov = stacked(at_left, at_right)
        X = model.xyz_m[[model.names.index(name) for name in best.names]]
        spots = NamedSpots(best.names, X, uv, cov, radius_m=np.zeros((len(X), 2)), normal=model.normal)
        solved = solve_pose(setup.packed, t_s, spots, limit=np.inf)
        if solved.pose.status is PoseStatus.OK:
            return replace(measured, pose=solved.pose, left=at_left, right=at_right, names=best.names)
    return None
