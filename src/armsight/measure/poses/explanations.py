"""Why there is no pose, or not of all lights, in words that lead to a cure."""

from __future__ import annotations

import numpy as np

from armsight.errors import Unseen
from armsight.measure.poses.correspondence import match_known
from armsight.measure.poses.pairs import Pairs, pair_spots
from armsight.measure.poses.pose import Solved
from armsight.measure.poses.setup import Setup
from armsight.measure.poses.solving import solve_assignment
from armsight.measure.poses.tracking import positions_of
from armsight.measure.spots import TOUCHING
from armsight.optics import SIDES
from armsight.records import NotSeen, Spots

LOOSE_SLACK = 8.0
"""Factor on the slack with which a set of spots that does not fit is tried again, only to say by how much."""


def explain(setup: Setup, left: Spots, right: Spots, pairs: Pairs, missed: NotSeen) -> NotSeen:
    """Return why there is no pose, with the size of the misfit where there is one; missed: what is said so far."""
    if not len(left) and not len(right):
        return NotSeen("no spot in the image" if setup.overlaid else "no spot in either image", Unseen.NO_SPOT)
    if setup.overlaid and len(left) <= len(setup.model) and not len(pairs.index):
        why = f"{len(left)} spots, and no two of them are both views of one light: one path may be dark"
        return NotSeen(why, Unseen.DARK_PATH)
    if not len(left) or not len(right):
        return NotSeen(f"no spot in the {'right' if len(left) else 'left'} image", Unseen.NO_SPOT)
    if not len(pairs.index) and pairs.behind:
        return NotSeen("every pair of spots lies behind the cameras: left and right may be swapped", Unseen.SWAPPED)
    slack = LOOSE_SLACK * setup.slack_px
    loose = pair_spots(setup.packed, left, right, slack, overlaid=setup.overlaid)
    if setup.target.model_known and len(setup.model) >= 3 and len(loose.index):
        match = match_known(setup.packed, setup.model, left, right, loose, slack_px=slack)
        if match.best is not None:
            solved = solve_assignment(setup, 0.0, left, right, loose, match.best)
            return solved.missed if solved.pose.why else missed
    if not len(pairs.index):
        if setup.overlaid:
            why = "no two spots agree as left and right view of one light (epipolar distance)"
            return NotSeen(why, Unseen.UNPAIRED)
        why = "no spot of the left image agrees with one of the right image (epipolar distance)"
        return NotSeen(why, Unseen.UNPAIRED)
    overlapping = _overlapping(left, 2 * len(setup.model)) if setup.overlaid else ""
    if not overlapping:
        return missed
    return NotSeen(missed.why + overlapping, missed.cause if missed.cause is Unseen.AMBIGUOUS else Unseen.OVERLAPPING)


def _overlapping(spots: Spots, expected: int) -> str:
    """Return what an image of both views with too few spots may mean."""
    if len(spots) >= expected:
        return ""
    at = [f"({u:.0f}, {v:.0f})" for u, v, why in spots.rejected if why == TOUCHING]
    merged = f", and those at {', '.join(at)} px touch and cannot be told apart" if at else ""
    return (
        f"; {len(spots)} of the {expected} spots of both views are seen{merged}: one view's spot may lie on another's, "
        "which a small movement of the target parts"
    )


def left_out_notes(setup: Setup, solved: Solved, left: Spots, right: Spots) -> tuple[str, ...]:
    """Return a note for every light of the target that was not used, with the nearest spot to its place."""
    if solved.T is None or not setup.target.model_known or len(solved.points) == len(setup.model):
        return ()
    notes = []
    for name, place in zip(setup.model.names, positions_of(setup, solved.T), strict=True):
        if name in solved.points.names:
            continue
        words = []
        for side, spots, uv in zip(SIDES, (left, right), setup.rig.project(place), strict=True):
            near = float(np.linalg.norm(spots.uv_px - uv[0], axis=1).min())
            words.append(f"{near:.1f} px in the {side} image")
        notes.append(f"{name} left out: the spot nearest to its place is off by {' and '.join(words)}")
    return tuple(notes)
