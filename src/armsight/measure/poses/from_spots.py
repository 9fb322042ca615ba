"""From all spots found in both views to the target's pose: name them, solve, and check the answer.

And why there is no pose, or not of all lights, in words that lead to a cure.
"""

from __future__ import annotations

from dataclasses import replace
from math import inf

import numpy as np

from armsight.errors import Unseen
from armsight.measure.poses.beacon import by_chance_in_order, match_beacon, match_by_position, match_few_of_size
from armsight.measure.poses.board_pose import swapped
from armsight.measure.poses.correspondence import AS_FOUND, match_known
from armsight.measure.poses.outcome import Assignment, Match, Measured, Prediction, Track, lost_moment
from armsight.measure.poses.pairs import Pairs, pair_spots
from armsight.measure.poses.pose import PoseSolution, position_only, solve_points
from armsight.measure.poses.setup import Setup
from armsight.measure.poses.shortlist import Shortlist
from armsight.measure.poses.solving import (
    Observation,
    impossible,
    misfit_chi2,
    solve_assignment,
    solve_seen,
    solve_spots,
    take_spots,
    why_hidden,
)
from armsight.measure.poses.tracking import continuation, doubtful, expected, next_track, positions_of
from armsight.measure.spots import TOUCHING
from armsight.optics import SIDES
from armsight.records import Frame, NotSeen, PoseStatus, Spots, TargetPose

Pair = tuple[Frame, Frame] | None

SWAP_RATIO = 0.1
"""Exchanged views are believed where they bring chi-square below this share of what it is."""

_DOUBTFUL = (
    "the lights are not where the target's motion puts them: something beside a light may have been taken for it, or "
    "the target was knocked; the next moment tells"
)


def measure_spots(setup: Setup, t_s: float, left: Spots, right: Spots, track: Track | None = None) -> Measured:
    """Return the pose from all spots found in both views at t_s; see measure_pair."""
    return measure_among(setup, t_s, left, right, track, None)[0]


def measure_among(
    setup: Setup, t_s: float, left: Spots, right: Spots, track: Track | None, among: Shortlist | None, seen: Pair = None
) -> tuple[Measured, float]:
    """As measure_spots; among: what the spots were chosen from, where they are not all that is bright.

    seen: the images, to compare the lights' outlines. The number: how many other arrangements should fit by chance.
    """
    pairs = pair_spots(setup.packed, left, right, setup.slack_px, overlaid=setup.overlaid)
    match = _match(setup, left, right, pairs, expected(setup, track, t_s), among)
    if match.best is None and match.alternatives:
        return _ambiguous(setup, t_s, left, right, pairs, match, track), match.chance
    picked = among is not None and among.arrangements != AS_FOUND  # for this order of the views
    if match.best is None:
        if track is None and not picked:
            _refuse_swapped(setup, left, right)
        chosen = picked or setup.settings.colour is not None
        missed = match.missed if chosen and match.why else explain(setup, left, right, pairs, match.missed)
        return lost_moment(t_s, (left, right), missed, track), 1.0
    i, j = pairs.index[match.best.pair].T
    look = _look(setup, t_s, match.best.names, (take_spots(left, i), take_spots(right, j)), seen)
    if isinstance(look, NotSeen):
        return lost_moment(t_s, (left, right), look, track), 1.0
    names, solved, matched = look.names, look.solved, (look.left, look.right)
    if against := impossible(setup, names, solved, *matched):
        return lost_moment(t_s, (left, right), against, track), 1.0
    step = continuation(setup, track, t_s, solved)
    if track is not None and doubtful(setup, track, t_s, solved, step):
        return lost_moment(t_s, (left, right), NotSeen(_DOUBTFUL, Unseen.MOTION), replace(track, doubted=True)), 1.0
    misfit = 0.0 if setup.overlaid or picked else misfit_chi2(solved, *matched)
    if misfit > float(setup.model.limits[min(len(matched[0]), len(setup.model))]):
        _refuse_swapped(setup, left, right, misfit)
    measured = Measured(
        pose=solved.pose,
        points=solved.points,
        spots=matched,
        names=names,
        seen=(left, right),
        track=next_track(setup, t_s, solved, matched, track, step),
        notes=left_out_notes(setup, solved, left, right),
        cause=solved.cause,
    )
    return measured, match.chance


def _look(
    setup: Setup, t_s: float, names: tuple[str, ...], matched: tuple[Spots, Spots], frames: Pair
) -> Observation | NotSeen:
    """Return the lights that are there as a whole with what is solved from them, or why nothing is."""
    seen = solve_seen(setup, t_s, names, *matched, frames)
    if not seen.names:
        return NotSeen(why_hidden(seen.hidden, PoseStatus.LOST), Unseen.HALF_HIDDEN)
    status = seen.solved.pose.status
    if status is PoseStatus.LOST:
        return seen.solved.missed
    if not seen.hidden or status is PoseStatus.OK:
        return seen
    pose = replace(seen.solved.pose, why=why_hidden(seen.hidden, status))
    return seen._replace(solved=replace(seen.solved, pose=pose, cause=Unseen.HALF_HIDDEN))


def _match(
    setup: Setup, left: Spots, right: Spots, pairs: Pairs, prediction: Prediction | None, among: Shortlist | None
) -> Match:
    """Name the spots: by the target's geometry, by their order in the image, or as far as one or two lights go."""
    known, model = setup.target.model_known, setup.model
    if setup.settings.colour is not None and len(model) == 1:
        return match_beacon(setup, left, right, pairs, prediction, alone=among is None)
    if not len(pairs.index):
        return Match(best=None, why="" if among is None else among.nothing, cause=Unseen.UNPAIRED)
    match = Match(best=None)
    if known and len(model) >= 3:
        arrangements = among.arrangements if among else 0
        match = match_known(setup, left, right, pairs, prediction=prediction, arrangements=arrangements)
    elif len(model) >= 3:
        chance = 0.0 if among is None or among.arrangements == AS_FOUND else by_chance_in_order(among.pairs_by_chance)
        match = replace(match_by_position(left, right, pairs), chance=chance)
    if match.best is None and not match.alternatives and (len(model) < 3 or pairs.few):
        few = match_few_of_size(setup, left, right, pairs, prediction)
        if (
            among is None
            or among.few_are_lights
            or among.arrangements == AS_FOUND
            or few.best is None
            or (prediction and few.predicted)
        ):
            return few
        why = f"{among.bright} bright spots, and too few lights to tell which of them they are"
        return Match(best=None, why=why, cause=Unseen.CROWD)
    return match


def _poses(
    setup: Setup, t_s: float, left: Spots, right: Spots, pairs: Pairs, others: tuple[Assignment, ...]
) -> tuple[TargetPose, ...]:
    return tuple(solve_assignment(setup, t_s, left, right, pairs, other).pose for other in others)


def _ambiguous(
    setup: Setup, t_s: float, left: Spots, right: Spots, pairs: Pairs, match: Match, track: Track | None
) -> Measured:
    """Return all hypotheses, and the position where they agree on the lights and differ only in the names."""
    first = match.alternatives[0]
    alternatives = _poses(setup, t_s, left, right, pairs, match.alternatives)
    same = all(set(a.pair.tolist()) == set(first.pair.tolist()) for a in match.alternatives)
    if not same:
        return replace(lost_moment(t_s, (left, right), match.missed, track), alternatives=alternatives)
    names = ("?",) * len(first.pair)
    seen = solve_points(setup.packed, names, pairs.uv_px[first.pair], pairs.cov_px2[first.pair])
    if isinstance(seen, NotSeen):
        return replace(lost_moment(t_s, (left, right), match.missed, track), alternatives=alternatives)
    index = pairs.index[first.pair]
    return Measured(
        pose=position_only(t_s, seen, match.why),
        points=seen.points,
        spots=(take_spots(left, index[:, 0]), take_spots(right, index[:, 1])),
        names=names,
        seen=(left, right),
        track=track,
        alternatives=alternatives,
        cause=match.cause,
    )


def _refuse_swapped(setup: Setup, left: Spots, right: Spots, misfit: float = inf) -> None:
    """Raise Inconsistent where the target is found with left and right exchanged, and fits better than as it is.

    With parallel cameras the exchange puts all behind them. With cameras that look at one point it turns the depths
    about that point, which a triangle survives: only the residuals tell, hence misfit.
    """
    if setup.overlaid or len(setup.model) < 3 or min(len(left), len(right)) < 3:
        return  # within one image the order of the two spots says which view each is of
    pairs = pair_spots(setup.packed, right, left, setup.slack_px)
    match = _match(setup, right, left, pairs, None, None)
    if match.alternatives and match.best is None and misfit == inf:
        raise swapped()
    if match.best is None or len(match.best.names) < 3:
        return
    index = pairs.index[match.best.pair]
    matched = take_spots(right, index[:, 0]), take_spots(left, index[:, 1])
    solved = solve_spots(setup, 0.0, match.best.names, *matched)
    other = misfit_chi2(solved, *matched)
    if solved.fits and solved.T is not None and (misfit == inf or other < SWAP_RATIO * misfit):
        raise swapped()


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
        match = match_known(setup, left, right, loose, slack_px=slack)
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


def left_out_notes(setup: Setup, solved: PoseSolution, left: Spots, right: Spots) -> tuple[str, ...]:
    """Return a note for every light of the target that was not used, with the nearest spot to its place."""
    if solved.T is None or not setup.target.model_known or len(solved.points) == len(setup.model):
        return ()
    notes = []
    for name, position in zip(setup.model.names, positions_of(setup, solved.T), strict=True):
        if name in solved.points.names:
            continue
        words = []
        for side, spots, uv in zip(SIDES, (left, right), setup.rig.project(position), strict=True):
            near = float(np.linalg.norm(spots.uv_px - uv[0], axis=1).min())
            words.append(f"{near:.1f} px in the {side} image")
        notes.append(f"{name} left out: the spot nearest to its place is off by {' and '.join(words)}")
    return tuple(notes)
