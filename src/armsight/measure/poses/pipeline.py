"""One moment of both cameras -> the target's pose: a pure function, with the track handed from call to call."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from armsight.arrays import Array, Index
from armsight.errors import Inconsistent, NotConverged, Unseen
from armsight.measure.poses.board_pose import measure_board_pair
from armsight.measure.poses.correspondence import AS_FOUND, BY_CHANCE
from armsight.measure.poses.from_spots import measure_among, measure_spots
from armsight.measure.poses.kernels import tracking as kernels
from armsight.measure.poses.outcome import Measured, Track, doubted, lost_moment
from armsight.measure.poses.setup import Setup
from armsight.measure.poses.shortlist import Shortlist, likeness, shortlist
from armsight.measure.poses.solving import solve_seen
from armsight.measure.poses.tracking import MAX_GAP_S, continuation, jumped, next_track
from armsight.measure.spots import FIT_S, SECOND_LOOK, Candidates, Part, find_candidates, track_spots
from armsight.measure.spots import warm_up as spots_warm_up
from armsight.optics import RIG_PARAMETERS, Camera, Rig, parallel_rig
from armsight.records import (
    Frame,
    NamedCovariance,
    NotSeen,
    PoseStatus,
    Spots,
    spot_target,
    unmeasured_target,
)

__all__ = ["Measured", "Setup", "Track", "measure_pair", "measure_spots", "warm_up"]

Pair = tuple[Frame, Frame]

NOT_OF_THE_RIG = "The calibration says nothing about such frames, so measuring stops here"
_MASK = "mask the background, lower the exposure, or give the target one more light"
NEARBY_PX = 64
"""How far beyond the places expected a live picture is searched for a target that was knocked, or whose lights are not
told by windows, before all of it is."""
COARSEST_PX = 32
"""Pixels of a picture to one of the pyramid's coarsest level at most."""
FIT_SHARE = 0.15
"""Share of a deadline that is for measuring the chosen lights of an image."""


def measure_pair(setup: Setup, left: Frame, right: Frame, track: Track | None = None) -> Measured:
    """Return the target's pose from one pair of frames, with everything it came from.

    Where setup says that one image holds both views (Pachidis 2005's complex image), it is given as left and right.

    track: of the call before; the spots are then looked for in windows around their predicted positions, and in the
    whole frame only where that fails. Raises Inconsistent where a frame has not the size of the rig's camera, or
    where left and right are swapped. What can happen to a good recording (a light hidden, a reflection, nobody
    there) raises nothing: the status and `why` of the pose say it.
    """
    check_sizes(setup.rig, (left, right))
    measured = _measure(setup, left, right, track)
    # a board is judged corner by corner: of real ones print and lens leave more than the corners' noise
    return measured if setup.target.is_board else doubted(measured)


def _measure(setup: Setup, left: Frame, right: Frame, track: Track | None) -> Measured:
    t_s = 0.5 * (left.t_s + right.t_s)
    if setup.target.is_board:
        return measure_board_pair(setup, left, right, t_s)
    if track is not None and not 0.0 < t_s - track.t_s <= MAX_GAP_S:
        track = None
    if track is not None and (tracked := _measure_tracked(setup, (left, right), t_s, track)) is not None:
        return tracked
    at_left, at_right = _candidates(setup, left, right)
    frames = left, right
    measured = _measure_candidates(setup, frames, t_s, at_left, at_right, track)
    if measured.pose.status is PoseStatus.OK or measured.alternatives or len(measured.names) == len(setup.model):
        return measured
    if measured.cause in (Unseen.HALF_HIDDEN, Unseen.DEADLINE):
        return measured  # what else is bright is not the light that was left out; or there is no time for it
    if setup.settings.colour is not None or _too_many(setup, measured):
        return measured  # all that has the colour was looked at; more lights would tell no more
    if not any(_more_to_see(at, seen) for at, seen in ((at_left, measured.left_seen), (at_right, measured.right_seen))):
        return measured
    again = _measure_candidates(setup, frames, t_s, *_closer(setup, at_left, at_right), track)
    return again if again.pose.status is PoseStatus.OK or measured.pose.status is PoseStatus.LOST else measured


def _too_many(setup: Setup, measured: Measured) -> bool:
    """Whether more lights are seen than a target of unknown geometry has, which names none of them."""
    return not setup.target.model_known and min(len(measured.left_seen), len(measured.right_seen)) > len(setup.model)


def _more_to_see(candidates: Candidates, seen: Spots) -> bool:
    """Whether a closer look may show lights: the image is not quiet, or something in it was no light that is known."""
    return candidates.room or any(why in SECOND_LOOK for _, _, why in seen.rejected)


def _candidates(
    setup: Setup, left: Frame, right: Frame, parts: Sequence[Part | None] = (None, None)
) -> tuple[Candidates, Candidates]:
    """Return what may be a light in parts of both images; one image that holds both views is searched once."""

    def search(side: int) -> Candidates:
        return find_candidates((left, right)[side].image, setup.sides[side], setup.pace, parts[side])

    return (search(0),) * 2 if setup.overlaid else setup.pace.both(search)


def _closer(setup: Setup, left: Candidates, right: Candidates) -> tuple[Candidates, Candidates]:
    """Return what a closer look at both images shows."""
    if setup.overlaid:
        found = left.closer()
        return found, found
    return setup.pace.both(lambda side: (left, right)[side].closer())


def _spots_of(setup: Setup, left: Candidates, right: Candidates, chosen: tuple[Index, Index]) -> tuple[Spots, Spots]:
    """Measure the chosen candidates of both images; of one image that holds both views those of either."""
    if setup.overlaid:
        spots = left.measure(np.union1d(*chosen))
        return spots, spots
    return setup.pace.both(lambda side: (left, right)[side].measure(chosen[side]))


def _measure_candidates(
    setup: Setup, frames: Pair, t_s: float, left: Candidates, right: Candidates, track: Track | None
) -> Measured:
    """Return the pose from candidates: all measured where they are few, else those that may be the target's."""
    if left.quiet and right.quiet:
        at_left, at_right = left.positions(), right.positions()
        expected_of_each = len(setup.model) * (2 if setup.overlaid else 1)
        if max(len(at_left), len(at_right)) > expected_of_each and len(setup.model) >= 3:
            more = Shortlist(left=at_left, right=at_right, bright=len(at_left) + len(at_right), arrangements=AS_FOUND)
            return _measure_chosen(setup, frames, t_s, left, right, (at_left, at_right), track, more)
        return measure_among(setup, t_s, *_spots_of(setup, left, right, (at_left, at_right)), track, None, frames)[0]
    among = shortlist(setup, left, right)
    if among.first is not None:
        measured = _measure_chosen(setup, frames, t_s, left, right, among.first, track, among)
        if measured.pose.status is PoseStatus.OK or measured.alternatives:
            return measured
        if measured.cause is Unseen.HALF_HIDDEN:
            return measured
    measured = _measure_chosen(setup, frames, t_s, left, right, (among.left, among.right), track, among)
    if measured.pose.status is not PoseStatus.LOST or not among.why or among.why in measured.pose.why:
        return measured
    return replace(measured, pose=replace(measured.pose, why=f"{measured.pose.why}; {among.why}"))


def _late(setup: Setup, among: Shortlist, chosen: tuple[Index, Index]) -> str:
    """Return why a live picture cannot be looked at as a whole in time; empty where it can, and of any other."""
    if not setup.pace.live:
        return ""
    n = max(map(len, chosen))
    most = max(setup.pace.most(n, FIT_S, FIT_SHARE), 4 * len(setup.model))
    why = f"{n} bright spots of one image could be the target's: not all of them are measured" if n > most else ""
    why = among.why or why
    return f"{why} in time; {_MASK}" if why else ""


def _measure_chosen(
    setup: Setup,
    frames: Pair,
    t_s: float,
    left: Candidates,
    right: Candidates,
    chosen: tuple[Index, Index],
    track: Track | None,
    among: Shortlist,
) -> Measured:
    """Measure the chosen candidates; return the pose, or that it may be one of chance."""
    if late := _late(setup, among, chosen):
        return lost_moment(t_s, (Spots.none(),) * 2, NotSeen(late, Unseen.DEADLINE), track)
    seen_left, seen_right = _spots_of(setup, left, right, chosen)
    measured, chance = measure_among(setup, t_s, seen_left, seen_right, track, among, frames)
    measured = replace(measured, busy=among.arrangements != AS_FOUND)
    if measured.pose.status is PoseStatus.LOST or chance == 0.0 or setup.settings.colour is not None:
        return measured
    alike = likeness(setup, left, right, measured.left, measured.right, measured.points.xyz_m)
    if chance * alike < BY_CHANCE:
        return measured
    why = (
        f"{among.bright} bright spots: {len(measured.names)} of them fit the target, but no better than some would by "
        f"chance; {_MASK}"
    )
    return replace(lost_moment(t_s, (seen_left, seen_right), NotSeen(why, Unseen.CROWD), track), busy=measured.busy)


def warm_up() -> None:
    """Compile (or load from the cache) all that measure_pair runs, so that no frame waits for it.

    Raises NotConverged where the code does not find a target that is plainly there.
    """
    spots_warm_up()
    uncertainty = NamedCovariance(names=RIG_PARAMETERS, matrix=1e-12 * np.eye(len(RIG_PARAMETERS)))
    rig = replace(parallel_rig(Camera.pinhole(320, 240, 250.0, 250.0, 160.0, 120.0), 0.1), covariance=uncertainty)
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
    _warm_up_doubt(rig, xyz)


def _warm_up_doubt(rig: Rig, xyz_m: Array) -> None:
    """Run what only a doubtful frame needs: a target with two ends alike, far away, a spot of it a little off."""
    even = xyz_m * [1.0, 0.0, 0.0] + [[0.0, 0.0, 0.0], [0.0, 0.05, 0.0], [-0.03, -0.05, 0.0]]
    setup = Setup(rig, spot_target(dict(zip("ABC", map(tuple, even.tolist()), strict=True))))
    uv_px = rig.project(even + np.array([0.05, 0.0, 2.0]))
    uv_px[0][0, 1] += 0.4
    uv_px[1][0, 1] -= 0.4
    left, right = (Spots.of_centres(uv, 0.01 * np.eye(2)) for uv in uv_px)
    measure_spots(setup, 0.0, left, right)


def check_sizes(rig: Rig, frames: Sequence[Frame | None], consequence: str = NOT_OF_THE_RIG) -> None:
    """Raise Inconsistent, with the consequence, where a frame of a moment is not of the size of the rig's camera."""
    for name, frame in zip(rig.names, frames, strict=True):
        if frame is not None:
            check_size(rig, name, frame, consequence)


def check_size(rig: Rig, side: str, frame: Frame, consequence: str) -> None:
    """Raise Inconsistent, with the consequence, where a frame is not of the size of the camera at a side."""
    camera = rig.camera(side)
    if (frame.width, frame.height) != (camera.width, camera.height):
        raise Inconsistent(
            f"{frame.source} is {frame.width}x{frame.height} px, the rig's {side} camera "
            f"{camera.width}x{camera.height} px",
            consequence=consequence,
            cure="Record at the resolution of the calibration, or calibrate at this one",
        )


def _measure_windows(setup: Setup, left: Frame, right: Frame, t_s: float, track: Track) -> Measured | None:
    """Return the pose from windows around the predicted spots; None where not every one of them is found and fits."""
    n, packed = len(track.names), setup.packed
    predicted, at = np.empty((n, 3)), np.empty((2, n, 2))
    dt = t_s - track.t_s
    if not kernels.predict_views(packed.arrays, track.xyz_m, track.velocity_m_s, dt, predicted, at):
        return None
    if setup.overlaid:
        both = _in_windows(setup, 0, left, at.reshape(2 * n, 2), track.half_window_px)
        left_seen, right_seen = (
            (None, None) if both is None else (both.take(list(range(n))), both.take(list(range(n, 2 * n))))
        )
    else:
        left_seen = _in_windows(setup, 0, left, at[0], track.half_window_px)
        right_seen = None if left_seen is None else _in_windows(setup, 1, right, at[1], track.half_window_px)
    if left_seen is None or right_seen is None:
        return None
    seen = solve_seen(setup, t_s, track.names, left_seen, right_seen, (left, right))
    solved, left_seen, right_seen = seen.solved, seen.left, seen.right
    if not solved.fits or solved.pose.status is PoseStatus.LOST or seen.hidden:
        return None
    step = continuation(setup, track, t_s, solved)
    if not step.likely or (track.motion is None and jumped(setup, track, t_s, solved)):
        return None
    innovation = max(map(kernels.largest_innovation, (left_seen.uv_px, right_seen.uv_px), at))
    return Measured(
        pose=solved.pose,
        points=solved.points,
        spots=(left_seen, right_seen),
        names=track.names,
        seen=(left_seen, right_seen),
        track=next_track(setup, t_s, solved, (left_seen, right_seen), track, step, innovation),
        tracked=True,
        cause=solved.cause,
    )


def _measure_tracked(setup: Setup, frames: Pair, t_s: float, track: Track) -> Measured | None:
    """Return the pose from where the track expects the lights; None where complete pictures are to be searched.

    Live, what is near the place of a target whose lights windows do not tell is searched first: what is like a light
    there is named anew and measured, as in complete pictures.
    """
    if track.complete and (measured := _measure_windows(setup, *frames, t_s, track)) is not None:
        return measured
    n, m, dt = len(track.names), len(setup.model), t_s - track.t_s
    at, places = np.empty((2, n, 2)), np.empty((n, 3))
    if not setup.pace.live or not setup.target.model_known or not n == m >= 3:
        return None
    if not kernels.predict_views(setup.packed.arrays, track.xyz_m, track.velocity_m_s, dt, places, at):
        return None
    expected = at.reshape(1, 2 * n, 2) if setup.overlaid else at
    found = _candidates(setup, *frames, [_part_about(one) for one in expected])
    measured = _measure_candidates(setup, frames, t_s, *found, track)
    whole = measured.pose.status is PoseStatus.OK and len(measured.names) == m
    return replace(measured, tracked=True) if whole or measured.cause is Unseen.HALF_HIDDEN else None


def _part_about(expected: Array) -> Part:
    """Return the rows and columns NEARBY_PX about the places expected (n, 2), begun where the whole pyramid's pixels
    begin."""
    first = np.maximum((expected.min(axis=0) - NEARBY_PX) // COARSEST_PX * COARSEST_PX, 0.0)
    last = np.maximum(expected.max(axis=0) + NEARBY_PX, 0.0)
    x, y = (slice(a, b) for a, b in zip(first.astype(int).tolist(), last.astype(int).tolist(), strict=True))
    return y, x


def _in_windows(setup: Setup, side: int, frame: Frame, expected: Array, half_window_px: int) -> Spots | None:
    """Return the spots in the order of expected (n, 2); None where not every one was found, or one twice."""
    spots, of = track_spots(frame.image, expected, half_window_px, setup.sides[side], grown=setup.pace.live)
    order, whole = of.tolist(), list(range(len(expected)))
    if order == whole:
        return spots
    return spots.take(np.argsort(of)) if sorted(order) == whole else None
