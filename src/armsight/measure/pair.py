"""One moment of both cameras -> the target's pose: a pure function, with the track handed from call to call."""

from __future__ import annotations

from dataclasses import replace
from math import inf

import numpy as np
from numpy.typing import NDArray

from armsight.errors import Inconsistent, NotConverged
from armsight.measure.beacon import match_beacon
from armsight.measure.boardpair import measure_board_pair, swapped
from armsight.measure.kernels import pose as kernels
from armsight.measure.match import (
    AS_FOUND,
    BY_CHANCE,
    OUTLINE,
    Assignment,
    Match,
    Pairs,
    Prediction,
    match_by_place,
    match_few,
    match_known,
    pair_spots,
)
from armsight.measure.outcome import Measured, Track
from armsight.measure.plausibility import add_outline_shift, impossible
from armsight.measure.pose import Solved, lost, no_points, position_only, solve_frame, solve_points, solve_pose
from armsight.measure.settings import SpotSettings
from armsight.measure.setup import Setup
from armsight.measure.shortlist import Shortlist, likeness, shortlist
from armsight.measure.spots import SECOND_LOOK, TOUCHING, Candidates, find_candidates, track_spots
from armsight.measure.spots import warm_up as spots_warm_up
from armsight.measure.tracking import MAX_GAP_S, expected, jumped, next_track, places_of
from armsight.optics import RIG_PARAMETERS, SIDES, Camera, parallel_rig
from armsight.records import Frame, NamedCovariance, PoseStatus, Spots, TargetPose, spot_target, unmeasured_target

__all__ = ["Measured", "Setup", "Track", "measure_pair", "measure_spots", "warm_up"]

Array = NDArray[np.float64]
Index = NDArray[np.intp]

TIGHT_PX = 0.05
"""What a good calibration leaves; residuals beyond it are reason enough to try left and right exchanged."""

SWAP_RATIO = 0.1
"""Exchanged views are believed where they bring chi-square below this share of what it is."""

LOOSE = 8.0
"""Factor on the slack with which a set of spots that does not fit is tried again, only to say by how much."""


def measure_pair(setup: Setup, left: Frame, right: Frame, track: Track | None = None) -> Measured:
    """Return the target's pose from one pair of frames, with everything it came from.

    Where setup says that one image holds both views (Pachidis 2005's complex image), it is given as left and right.

    track: of the call before; the spots are then looked for in windows around their predicted places, and in the
    whole frame only where that fails. Raises Inconsistent where a frame has not the size of the rig's camera, or
    where left and right are swapped. What can happen to a good recording (a light hidden, a reflection, nobody
    there) raises nothing: the status and `why` of the pose say it.
    """
    check_sizes(setup, left, right)
    t_s = 0.5 * (left.t_s + right.t_s)
    if setup.target.is_board:
        return measure_board_pair(setup, left, right, t_s)
    if track is not None and not 0.0 < t_s - track.t_s <= MAX_GAP_S:
        track = None
    if track is not None and track.complete:
        measured = _measure_windows(setup, left, right, t_s, track)
        if measured is not None:
            return measured
    at_left, at_right = _candidates(setup, left, right)
    measured = _measure_candidates(setup, t_s, at_left, at_right, track)
    if measured.pose.status is PoseStatus.OK or measured.alternatives or len(measured.names) == len(setup.model):
        return measured
    if setup.settings.colour is not None or _too_many(setup, measured):
        return measured  # all that has the colour was looked at; more lights would tell no more
    if not any(_more_to_see(at, seen) for at, seen in ((at_left, measured.left_seen), (at_right, measured.right_seen))):
        return measured
    again = _measure_candidates(setup, t_s, *_candidates(setup, left, right, faint=True), track)
    return again if again.pose.status is PoseStatus.OK or measured.pose.status is PoseStatus.LOST else measured


def _too_many(setup: Setup, measured: Measured) -> bool:
    """Whether more lights are seen than a target of unknown geometry has, which names none of them."""
    return not setup.target.model_known and min(len(measured.left_seen), len(measured.right_seen)) > len(setup.model)


def _more_to_see(candidates: Candidates, seen: Spots) -> bool:
    """Whether a closer look may show lights: the image is not quiet, or something in it was no light that is known."""
    return candidates.room or any(why in SECOND_LOOK for _, _, why in seen.rejected)


def _candidates(setup: Setup, left: Frame, right: Frame, *, faint: bool = False) -> tuple[Candidates, Candidates]:
    """Return what may be a light in both images; one image that holds both views is searched once."""
    found = find_candidates(left.image, setup.sides[0], faint=faint)
    return found, found if setup.overlaid else find_candidates(right.image, setup.sides[1], faint=faint)


def _measure_candidates(setup: Setup, t_s: float, left: Candidates, right: Candidates, track: Track | None) -> Measured:
    """Return the pose from candidates: all measured where they are few, else those that may be the target's."""
    if left.quiet and right.quiet:
        at_left, at_right = left.positions(), right.positions()
        expected_of_each = len(setup.model) * (2 if setup.overlaid else 1)
        if max(len(at_left), len(at_right)) > expected_of_each and len(setup.model) >= 3:
            more = Shortlist(left=at_left, right=at_right, bright=len(at_left) + len(at_right), arrangements=AS_FOUND)
            return _measure_chosen(setup, t_s, left, right, (at_left, at_right), track, more)
        seen = left.measure(at_left)
        return measure_spots(setup, t_s, seen, seen if setup.overlaid else right.measure(at_right), track)
    among = shortlist(setup, left, right)
    if among.first is not None:
        measured = _measure_chosen(setup, t_s, left, right, among.first, track, among)
        if measured.pose.status is PoseStatus.OK or measured.alternatives:
            return measured
    measured = _measure_chosen(setup, t_s, left, right, (among.left, among.right), track, among)
    if measured.pose.status is not PoseStatus.LOST or not among.why or among.why in measured.pose.why:
        return measured
    return replace(measured, pose=replace(measured.pose, why=f"{measured.pose.why}; {among.why}"))


def _measure_chosen(
    setup: Setup,
    t_s: float,
    left: Candidates,
    right: Candidates,
    chosen: tuple[Index, Index],
    track: Track | None,
    among: Shortlist,
) -> Measured:
    """Measure the chosen candidates; return the pose, or that it may be one of chance."""
    if setup.overlaid:
        seen_left = seen_right = left.measure(np.union1d(*chosen))
    else:
        seen_left, seen_right = left.measure(chosen[0]), right.measure(chosen[1])
    measured, chance = _from_spots(setup, t_s, seen_left, seen_right, track, among)
    measured = replace(measured, busy=among.arrangements != AS_FOUND)
    if measured.pose.status is PoseStatus.LOST or chance == 0.0 or setup.settings.colour is not None:
        return measured
    alike = likeness(setup, left, right, measured.left, measured.right, measured.points.xyz_m)
    if chance * alike < BY_CHANCE:
        return measured
    why = (
        f"{among.bright} bright spots: {len(measured.names)} of them fit the target, but no better than some would by "
        "chance; mask the background, lower the exposure, or give the target one more light"
    )
    return replace(_nothing(t_s, seen_left, seen_right, why, track), busy=measured.busy)


def warm_up() -> None:
    """Compile (or load from the cache) all that measure_pair runs, so that no frame waits for it.

    Raises NotConverged where the code does not find a target that is plainly there.
    """
    spots_warm_up()
    doubt = NamedCovariance(names=RIG_PARAMETERS, matrix=1e-12 * np.eye(len(RIG_PARAMETERS)))
    rig = replace(parallel_rig(Camera.pinhole(320, 240, 250.0, 250.0, 160.0, 120.0), 0.1), covariance=doubt)
    xyz = np.array([[-0.05, 0.0, 0.0], [0.05, 0.04, 0.0], [0.03, -0.04, 0.0]])
    y, x = np.mgrid[0:240, 0:320]
    images = [
        sum(150.0 * np.exp(-((x - u) ** 2 + (y - v) ** 2) / 8.0) for u, v in uv).astype(np.uint8)
        for uv in rig.project(xyz + np.array([0.05, 0.0, 0.5]))
    ]
    for target in (
        spot_target(dict(zip("ABC", map(tuple, xyz.tolist()), strict=True)), covariance=1e-12 * np.eye(9)),
        unmeasured_target(),
    ):
        setup, track = Setup(rig, target), None
        for number in range(3):
            frames = [Frame(image=image, t_s=0.01 * number, sequence=number, source="warm-up") for image in images]
            measured = measure_pair(setup, frames[0], frames[1], track)
            track = measured.track
            if measured.pose.status is not PoseStatus.OK:
                raise NotConverged(f"the check at start-up failed: {measured.pose.why}", cure="Install armsight anew")


def measure_spots(setup: Setup, t_s: float, left: Spots, right: Spots, track: Track | None = None) -> Measured:
    """Return the pose from all spots found in both views at t_s; see measure_pair."""
    return _from_spots(setup, t_s, left, right, track, None)[0]


def _from_spots(
    setup: Setup, t_s: float, left: Spots, right: Spots, track: Track | None, among: Shortlist | None
) -> tuple[Measured, float]:
    """As measure_spots; among: what the spots were chosen from, where they are not all that is bright.

    The number is how many other arrangements are expected to fit as well by chance.
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
        why = match.why if chosen and match.why else _explain(setup, left, right, pairs, match.why)
        return _nothing(t_s, left, right, why, track), 1.0
    index = pairs.index[match.best.pair]
    matched = _take(left, index[:, 0]), _take(right, index[:, 1])
    solved = _solve(setup, t_s, match.best.names, *matched)
    if solved.pose.status is PoseStatus.LOST:
        return _nothing(t_s, left, right, solved.pose.why, track), 1.0
    against = impossible(setup, match.best.names, solved, *matched)
    if against:
        return _nothing(t_s, left, right, against, track), 1.0
    misfit = 0.0 if setup.overlaid or picked else _misfit(solved, *matched)
    if misfit > float(setup.model.limits[min(len(matched[0]), len(setup.model))]):
        _refuse_swapped(setup, left, right, misfit)
    measured = Measured(
        pose=solved.pose,
        points=solved.points,
        left=matched[0],
        right=matched[1],
        names=match.best.names,
        left_seen=left,
        right_seen=right,
        track=next_track(setup, t_s, solved, left, right, track),
        notes=_left_out(setup, solved, left, right),
    )
    return measured, match.chance


def check_sizes(setup: Setup, left: Frame, right: Frame) -> None:
    """Raise Inconsistent where a frame is not of the size of the rig's camera."""
    for side, frame in zip(SIDES, (left, right), strict=True):
        camera = setup.rig.camera(side)
        if (frame.width, frame.height) != (camera.width, camera.height):
            raise Inconsistent(
                f"{frame.source}: the {side} image is {frame.width}x{frame.height} px, "
                f"the rig's {side} camera {camera.width}x{camera.height} px",
                consequence="Its pixels have no rays",
                cure="Use frames of the size the rig was calibrated with, or calibrate at this size",
            )


def _measure_windows(setup: Setup, left: Frame, right: Frame, t_s: float, track: Track) -> Measured | None:
    """Return the pose from windows around the predicted spots; None where not every one of them is found and fits."""
    n, packed = len(track.names), setup.packed
    ahead, at_left, at_right = np.empty((n, 3)), np.empty((n, 2)), np.empty((n, 2))
    dt = t_s - track.t_s
    if not kernels.predict_views(
        packed.k, packed.R, packed.t, track.xyz_m, track.velocity_m_s, dt, ahead, at_left, at_right
    ):
        return None
    if setup.overlaid:
        both = _in_windows(left, np.concatenate([at_left, at_right]), track.half_window_px, setup.sides[0])
        left_seen, right_seen = (
            (None, None) if both is None else (both.take(list(range(n))), both.take(list(range(n, 2 * n))))
        )
    else:
        left_seen = _in_windows(left, at_left, track.half_window_px, setup.sides[0])
        right_seen = None if left_seen is None else _in_windows(right, at_right, track.half_window_px, setup.sides[1])
    if left_seen is None or right_seen is None:
        return None
    solved = _solve(setup, t_s, track.names, left_seen, right_seen)
    if not solved.fits or solved.pose.status is PoseStatus.LOST or jumped(setup, track, t_s, solved):
        return None
    innovation = kernels.largest_innovation(left_seen.uv_px, at_left, right_seen.uv_px, at_right)
    return Measured(
        pose=solved.pose,
        points=solved.points,
        left=left_seen,
        right=right_seen,
        names=track.names,
        left_seen=left_seen,
        right_seen=right_seen,
        track=next_track(setup, t_s, solved, left_seen, right_seen, track, innovation_px=innovation),
        tracked=True,
    )


def _in_windows(frame: Frame, expected: Array, half_window_px: int, settings: SpotSettings) -> Spots | None:
    """Return the spots in the order of expected (n, 2); None where not every one was found, or one twice."""
    spots, of = track_spots(frame.image, expected, half_window_px, settings)
    order, whole = of.tolist(), list(range(len(expected)))
    if order == whole:
        return spots
    return spots.take(np.argsort(of)) if sorted(order) == whole else None


def _match(
    setup: Setup, left: Spots, right: Spots, pairs: Pairs, prediction: Prediction | None, among: Shortlist | None
) -> Match:
    """Name the spots: by the target's geometry, by their order in the image, or as far as one or two lights go."""
    known, model = setup.target.model_known, setup.model
    if setup.settings.colour is not None and len(model) == 1:
        return match_beacon(setup, left, right, pairs, prediction, alone=among is None)
    if not len(pairs.index):
        return Match(best=None, why="" if among is None else among.nothing)
    match = Match(best=None)
    if known and len(model) >= 3:
        match = match_known(
            setup.packed, model, left, right, pairs,
            prediction=prediction, slack_px=setup.slack_px, arrangements=among.arrangements if among else 0,
        )  # fmt: skip
    elif len(model) >= 3:
        match = match_by_place(left, right, pairs)
    if match.best is None and not match.alternatives and (len(model) < 3 or pairs.few):
        few = match_few(model, pairs, known=known, prediction=prediction)
        if (
            among is None
            or among.few_are_lights
            or among.arrangements == AS_FOUND
            or few.best is None
            or (prediction and few.predicted)
        ):
            return few
        return Match(best=None, why=f"{among.bright} bright spots, and too few lights to tell which of them they are")
    return match


def _solve_assignment(setup: Setup, t_s: float, left: Spots, right: Spots, pairs: Pairs, chosen: Assignment) -> Solved:
    index = pairs.index[chosen.pair]
    return _solve(setup, t_s, chosen.names, _take(left, index[:, 0]), _take(right, index[:, 1]))


def _solve(setup: Setup, t_s: float, names: tuple[str, ...], left: Spots, right: Spots) -> Solved:
    """Return the pose of three or more named spots (the frame of an unmeasured target), or the place of fewer."""
    model, packed = setup.model, setup.packed
    uv, cov = np.empty((len(names), 2, 2)), np.empty((len(names), 2, 2, 2))  # [spot, side]
    kernels.stack_views(left.uv_px, left.covariance_px2, right.uv_px, right.covariance_px2, uv, cov)
    if model.radius_m <= 0.0:
        add_outline_shift(packed, left, right, cov)
    if len(names) < 3:
        seen = solve_points(packed, names, uv, cov)
        if isinstance(seen, str):
            return Solved(pose=lost(t_s, seen), points=no_points(), fits=False)
        why = "a target of one or two spots" if len(names) == len(model) else f"{len(names)} of {len(model)} spots seen"
        return Solved(pose=position_only(t_s, seen, f"{why}: only their position is known"), points=seen.points)
    if not setup.target.model_known:
        return solve_frame(packed, t_s, names, uv, cov)
    rows = model.xyz_m if names == model.names else model.xyz_m[[model.names.index(name) for name in names]]
    radius, limit = _radii(model.radius_m, left, right), float(model.limits[len(names)])
    return solve_pose(
        packed,
        t_s,
        names,
        rows,
        uv,
        cov,
        radius,
        model.normal,
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


def _poses(
    setup: Setup, t_s: float, left: Spots, right: Spots, pairs: Pairs, others: tuple[Assignment, ...]
) -> tuple[TargetPose, ...]:
    return tuple(_solve_assignment(setup, t_s, left, right, pairs, other).pose for other in others)


def _ambiguous(
    setup: Setup, t_s: float, left: Spots, right: Spots, pairs: Pairs, match: Match, track: Track | None
) -> Measured:
    """Return all hypotheses, and the position where they agree on the lights and differ only in the names."""
    first = match.alternatives[0]
    alternatives = _poses(setup, t_s, left, right, pairs, match.alternatives)
    same = all(set(a.pair.tolist()) == set(first.pair.tolist()) for a in match.alternatives)
    if not same:
        return replace(_nothing(t_s, left, right, match.why, track), alternatives=alternatives)
    names = ("?",) * len(first.pair)
    seen = solve_points(setup.packed, names, pairs.uv_px[first.pair], pairs.cov_px2[first.pair])
    if isinstance(seen, str):
        return replace(_nothing(t_s, left, right, match.why, track), alternatives=alternatives)
    index = pairs.index[first.pair]
    return Measured(
        pose=position_only(t_s, seen, match.why),
        points=seen.points,
        left=_take(left, index[:, 0]),
        right=_take(right, index[:, 1]),
        names=names,
        left_seen=left,
        right_seen=right,
        track=track,
        alternatives=alternatives,
    )


def _nothing(t_s: float, left: Spots, right: Spots, why: str, track: Track | None) -> Measured:
    """Return a lost moment; the track, as old as it is, may still help the next one."""
    none = Spots.none()
    return Measured(
        pose=lost(t_s, why),
        points=no_points(),
        left=none,
        right=none,
        names=(),
        left_seen=left,
        right_seen=right,
        track=track,
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
    matched = _take(right, index[:, 0]), _take(left, index[:, 1])
    solved = _solve(setup, 0.0, match.best.names, *matched)
    other = _misfit(solved, *matched)
    if solved.fits and solved.T is not None and (misfit == inf or other < SWAP_RATIO * misfit):
        raise swapped()


def _misfit(solved: Solved, left: Spots, right: Spots) -> float:
    """Return chi-square of the residuals with TIGHT_PX beside the spots' own deviations."""
    if solved.T is None:
        return 0.0
    uv, cov = np.empty((len(left), 2, 2)), np.empty((len(left), 2, 2, 2))
    kernels.stack_views(left.uv_px, left.covariance_px2, right.uv_px, right.covariance_px2, uv, cov)
    return float(kernels.slack_chi2(np.array(solved.pose.residual_px).reshape(uv.shape), cov, TIGHT_PX**2))


def _explain(setup: Setup, left: Spots, right: Spots, pairs: Pairs, why: str) -> str:
    """Return why no pose could be given, with the size of the misfit where there is one."""
    if not len(left) and not len(right):
        return "no spot in the image" if setup.overlaid else "no spot in either image"
    if setup.overlaid and len(left) <= len(setup.model) and not len(pairs.index):
        return f"{len(left)} spots, and no two of them are both views of one light: one path may be dark"
    if not len(left) or not len(right):
        return f"no spot in the {'right' if len(left) else 'left'} image"
    if not len(pairs.index) and pairs.behind:
        return "every pair of spots lies behind the cameras: left and right may be swapped"
    slack = LOOSE * setup.slack_px
    loose = pair_spots(setup.packed, left, right, slack, overlaid=setup.overlaid)
    if setup.target.model_known and len(setup.model) >= 3 and len(loose.index):
        match = match_known(setup.packed, setup.model, left, right, loose, slack_px=slack)
        if match.best is not None:
            solved = _solve_assignment(setup, 0.0, left, right, loose, match.best)
            return solved.pose.why or why
    if not len(pairs.index):
        if setup.overlaid:
            return "no two spots agree as left and right view of one light (epipolar distance)"
        return "no spot of the left image agrees with one of the right image (epipolar distance)"
    return why + (_overlapping(left, 2 * len(setup.model)) if setup.overlaid else "")


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


def _left_out(setup: Setup, solved: Solved, left: Spots, right: Spots) -> tuple[str, ...]:
    """Return a note for every light of the target that was not used, with the nearest spot to its place."""
    if solved.T is None or not setup.target.model_known or len(solved.points) == len(setup.model):
        return ()
    notes = []
    for name, place in zip(setup.model.names, places_of(setup, solved.T), strict=True):
        if name in solved.points.names:
            continue
        words = []
        for side, spots, uv in zip(SIDES, (left, right), setup.rig.project(place), strict=True):
            near = float(np.linalg.norm(spots.uv_px - uv[0], axis=1).min())
            words.append(f"{near:.1f} px in the {side} image")
        notes.append(f"{name} left out: the spot nearest to its place is off by {' and '.join(words)}")
    return tuple(notes)


def _take(spots: Spots, index: NDArray[np.intp]) -> Spots:
    """Return the spots in the order of index; itself where that changes nothing."""
    if len(index) == len(spots) and (index[:-1] < index[1:]).all():
        return spots
    return spots.take(index)
