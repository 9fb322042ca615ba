"""Spots of one moment that were not exposed at one time, put where their lights were seen at the moment's own time.

How the target moves is taken from the motion so far and from the moment's own views, each at its own time: a target
that rested may start at once, and while it goes no views of different times fit one pose.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from armsight.arrays import Array, Index
from armsight.errors import Inconsistent, Unseen
from armsight.measure.motion.estimate import ANGULAR_RATIO, MotionFilter
from armsight.measure.motion.kernels.state import N, add_jerk
from armsight.measure.motion.kernels.views import observe_all
from armsight.measure.motion.states import MotionState, View
from armsight.measure.poses.correspondence import AS_FOUND, BY_CHANCE
from armsight.measure.poses.expected import FEWEST_SPOTS, MAX_SPOTS, Expected, Shutter, expect, links
from armsight.measure.poses.from_spots import measure_among
from armsight.measure.poses.outcome import Measured, Track, doubted, lost_moment
from armsight.measure.poses.pose import TWO
from armsight.measure.poses.setup import Setup
from armsight.measure.poses.shortlist import Shortlist
from armsight.measure.poses.views import measure_views
from armsight.records import AT_ONCE, Frame, NotSeen, PoseStatus, Spots

AT_ONE_TIME_S = 1e-4
"""What a spot moves in such a time is nothing: 0.1 mm at 1 m/s."""
SLACKS_PX = (0.0, 1.0, 3.0)
"""What views of different times may add to a spot's standard deviation, tried one after the other, where nothing is
known of the motion and its views are to be named: 0.1 and 0.3 m/s for 8 ms at 0.8 m."""
FEWEST = 4
"""Named sights below which they say nothing of a motion."""
NO_MOTION = "the cameras expose at different times, and what they show fits no motion of the target"


def rig_times(setup: Setup, frames: Sequence[Frame | None]) -> tuple[float, Array]:
    """Return the time of a moment, the mean of its frames', and by how much later (v,) each one was taken."""
    at = [
        None if one is None else one.t_s if clock is None else float(clock.rig_time(one.t_s))
        for one, clock in zip(frames, setup.rig.timing, strict=True)
    ]
    there = [t for t in at if t is not None]
    t_s = sum(there) / len(there)
    return t_s, np.array([0.0 if t is None else t - t_s for t in at])


def apart(setup: Setup, late_s: Array) -> bool:
    """Tell whether views are of times so far apart that a motion shows.

    Without timing in the rig's file stamps say little: those of a common trigger arrive apart, too.
    """
    rolling = any(one is not None and one.rolling for one in setup.rig.timing)
    return rolling or (setup.rig.runs_free and bool(np.abs(late_s).max() > AT_ONE_TIME_S))


def measure_apart(
    setup: Setup, t_s: float, seen: Sequence[Spots], late_s: Array, track: Track | None, *, in_windows: bool = False
) -> Measured:
    """Return the pose at t_s from spots of views that were taken late_s (v,) after it; see rig_times.

    Raises Inconsistent where left and right of a pair are swapped.
    """
    shutters = _shutters(setup, late_s)
    before = None if track is None else track.motion
    views = [] if before is None else _going_on(setup, t_s, seen, shutters, before)
    if before is None or not views:
        before, views = (None, []) if in_windows else _begun(setup, t_s, seen, shutters)
    if before is None:
        return lost_moment(t_s, tuple(seen), NotSeen(NO_MOTION, Unseen.MOTION), track)
    motion = before.add(*views)
    at_once = at_one_time(setup, seen, shutters, motion.state)
    measured = _measured(setup, t_s, at_once, track, in_windows=in_windows)
    if measured.pose.status is not PoseStatus.OK or measured.track is None:
        return measured
    if not _by_all(views, measured):
        return lost_moment(t_s, tuple(seen), NotSeen(NO_MOTION, Unseen.MOTION), track)
    return replace(measured, track=replace(measured.track, motion=motion))


def _measured(
    setup: Setup, t_s: float, seen: Sequence[Spots], track: Track | None = None, *, in_windows: bool = False
) -> Measured:
    """Return the pose from spots of one time, as rigs of so many cameras have it."""
    if len(seen) == TWO:
        left, right = seen
        n, among = len(left) + len(right), None
        if max(len(left), len(right)) > len(setup.model):
            rows = np.arange(len(left)), np.arange(len(right))
            among = Shortlist(left=rows[0], right=rows[1], bright=n, arrangements=AS_FOUND)
        measured, chance = measure_among(setup, t_s, left, right, track, among)
        if measured.pose.status is PoseStatus.LOST or chance < BY_CHANCE:
            return doubted(measured)
        why = f"{n} bright spots: {len(measured.names)} fit the target, but no better than some would by chance"
        return lost_moment(t_s, (left, right), NotSeen(why, Unseen.CROWD), track)
    return measure_views(setup, t_s, seen, track, in_windows=in_windows)


def _by_all(views: Sequence[View], measured: Measured) -> bool:
    """Tell whether a pose is of all views that its motion was taken from, but for a light of each.

    Some of them alone fit any motion along their lines of sight.
    """
    lights = [set(view.lights.tolist()) for view in views]
    if len(measured.spots) == TWO:  # by whose rule a light is seen twice
        lights = [set.intersection(*lights)] * len(lights)
    return all(len(measured.spots[v.side]) >= len(of) - 1 for v, of in zip(views, lights, strict=True))


def _shutters(setup: Setup, late_s: Array) -> list[Shutter]:
    return [
        Shutter(side=s, timing=one.timing or AT_ONCE, height=one.camera.height, late_s=late)
        for s, (one, late) in enumerate(zip(setup.rig.cameras, late_s.tolist(), strict=True))
    ]


def _going_on(
    setup: Setup, t_s: float, seen: Sequence[Spots], shutters: Sequence[Shutter], before: MotionFilter
) -> list[View]:
    """Return the views in which the target goes on as it did, or as a knock makes it go: all that show three lights or
    more; none if one of them does not fit."""
    for state in (before.at(t_s), before.after_a_knock(t_s)):
        expected = [expect(setup, state, shutter) for shutter in shutters]
        views = [
            _named(at, t_s, spots)
            for at, spots in zip(expected, seen, strict=True)
            if at is not None and FEWEST_SPOTS <= len(spots) <= MAX_SPOTS
        ]
        found = [view for view in views if view is not None]
        if len(found) == len(views) and sum(len(view.lights) for view in found) >= FEWEST:
            return found
    return []


def _named(expected: Expected, t_s: float, spots: Spots) -> View | None:
    """Return the view of the spots that are the lights' by one shift of all, the likeliest that fits; None if none."""
    for lights, rows in links(expected.uv_px, spots.uv_px):
        view = expected.named(t_s, spots.take(rows), lights)
        if view is not None and len(view.lights) >= min(len(spots), len(expected.uv_px)) - 1:
            return view  # fewer of them would fit by other names, too
    return None


def _begun(
    setup: Setup, t_s: float, seen: Sequence[Spots], shutters: Sequence[Shutter]
) -> tuple[MotionFilter | None, list[View]]:
    """Return a motion of which nothing is known where the views, as if of one time, show the target, and these; None
    where they do not."""
    swapped = None
    for slack_px in SLACKS_PX:
        try:
            found = _measured(replace(setup, slack_px=max(slack_px, setup.slack_px)), t_s, seen)
        except Inconsistent as error:  # or it goes so fast that it looks like that
            swapped = swapped or error
            continue
        T, C = found.pose.T_parent_target, found.pose.covariance
        if found.pose.status in (PoseStatus.OK, PoseStatus.DOUBTFUL) and T is not None and C is not None:
            views = [
                shutter.view(t_s, _rows(setup, found.names_in(shutter.side)), spots.uv_px, spots.covariance_px2)
                for spots, shutter in zip(found.spots, shutters, strict=True)
                if len(spots)
            ]
            if sum(len(view.lights) >= FEWEST_SPOTS for view in views) >= sum(len(one) >= FEWEST_SPOTS for one in seen):
                return MotionFilter.begin(setup.packed, setup.model.xyz_m, t_s, T, C), views
    if swapped is not None:
        raise swapped
    return None, []


def _rows(setup: Setup, names: Sequence[str]) -> Index:
    return np.array([setup.model.names.index(name) for name in names], dtype=np.intp)


def at_one_time(setup: Setup, seen: Sequence[Spots], shutters: Sequence[Shutter], state: MotionState) -> list[Spots]:
    """Return the spots as they would have been seen at the state's time.

    Each spot goes as the light does that is expected nearest to it. What is open of that way, and what jerk may do from
    the first of the views to the last, is added to its covariance, times the number of lights: those of a view share
    it, so that their mean is no surer.
    """
    out, X, C = [], setup.model.xyz_m, np.array(state.C)
    late = [shutter.late_s for shutter in shutters]
    add_jerk(C, max(late) - min(late), state.jerk, ANGULAR_RATIO * state.jerk)
    for spots, shutter in zip(seen, shutters, strict=True):
        then = expect(setup, state, shutter) if len(spots) else None
        uv, H = np.empty((len(X), 2)), np.empty((2 * len(X), N))
        if then is None or not observe_all(state.x, setup.packed.camera(shutter.side), X, np.zeros(len(X)), uv, H):
            out.append(spots)
            continue
        way, slope = uv - then.uv_px, (H - then.H).reshape(len(X), 2, N)
        doubt = len(X) * np.einsum("mia,ab,mjb->mij", slope, C, slope)
        of = np.linalg.norm(spots.uv_px[:, None] - then.uv_px, axis=2).argmin(axis=1)
        out.append(replace(spots, uv_px=spots.uv_px + way[of], covariance_px2=spots.covariance_px2 + doubt[of]))
    return out
