"""From one moment to the next: where the lights are expected, and what is handed on."""

from __future__ import annotations

from collections.abc import Sequence
from math import ceil
from typing import NamedTuple

import numpy as np

from armsight.arrays import Array
from armsight.errors import Unseen
from armsight.measure.motion.estimate import MotionFilter
from armsight.measure.poses.kernels import tracking as kernels
from armsight.measure.poses.outcome import Prediction, Track
from armsight.measure.poses.pose import TWO, PoseSolution
from armsight.measure.poses.setup import Setup
from armsight.records import Spots, trusted

MAX_GAP_S = 0.5
"""A track older than this predicts nothing: hand-held targets turn round in less than a second."""

MOST_SPEED = 2.0
MOST_ACCELERATION = 25.0
"""m/s and m/s^2 beyond which no target is expected to be led: twice what a hand reaches between two places."""

MOST_ANGULAR_ACCELERATION = 300.0
"""rad/s^2, likewise: a wrist that turns by 60 degrees and back in a quarter of a second reaches a third of it."""

JUMP_SIGMA = 3.0
"""Standard deviations of a pose that may come on top of how far off its prediction may be."""

STILL_M = 0.005
"""How far off a prediction may be where nothing moves."""

FIRST_WINDOW_PX = 32
"""Half the window before a velocity is known: 0.5 m/s at 0.6 m, 30 frames a second and f = 1130 px."""

LEAST_WINDOW_PX = 8
"""Half the smallest window, beside the spot itself."""

MOST_MAHALANOBIS2 = 38.25833637720969
"""Squared Mahalanobis distance of a pose from where the target's motion puts it, beyond which it is something else's:
chi2_isf(1e-6, 6)."""

SPOT_REACH = 4.0
"""A spot's light reaches about this many of its sigmas (or radii)."""


def expected(setup: Setup, track: Track | None, t_s: float) -> Prediction | None:
    """Return the predicted positions in the order of the target's names, and how far off they may be."""
    if track is None:
        return None
    predicted, dt = track.predict(t_s), t_s - track.t_s
    moved = MOST_ACCELERATION * dt * dt if track.velocity_m_s.any() else MOST_SPEED * dt
    if track.names != setup.model.names:
        out = np.full((len(setup.model), 3), np.nan)
        for name, place in zip(track.names, predicted, strict=True):
            out[setup.model.names.index(name)] = place
        predicted = out
    turned = STILL_M + MOST_ANGULAR_ACCELERATION * dt * dt * setup.model.reach_m
    return Prediction(predicted, STILL_M + moved, turned if track.velocity_m_s.any() else np.inf)


def jumped(setup: Setup, track: Track, t_s: float, solved: PoseSolution) -> bool:
    """Tell whether a pose in windows puts a light where no target comes from the moment before, its doubt allowed."""
    predicted = expected(setup, track, t_s)
    if predicted is None or not setup.target.model_known or len(setup.model) < 3:
        return False
    C = solved.pose.covariance
    if solved.T is None or C is None:  # the points by themselves, in the order of the track
        positions, at = solved.points.xyz_m, track.predict(t_s)
        uncertainty = np.sqrt(np.trace(solved.points.covariance_m2, axis1=1, axis2=2))
    else:
        positions, at = positions_of(setup, solved.T), predicted.xyz_m
        arm = np.linalg.norm(setup.model.xyz_m, axis=1)
        uncertainty = np.sqrt(np.trace(C[:3, :3])) + arm * np.sqrt(np.trace(C[3:, 3:]))
    off = positions - at
    if np.any(np.linalg.norm(off, axis=1) > predicted.within_m + JUMP_SIGMA * uncertainty):
        return True
    if solved.T is None or C is None:
        return False
    turn_doubt = JUMP_SIGMA * setup.model.reach_m * np.sqrt(np.trace(C[3:, 3:]))
    apart = np.linalg.norm(off - off.mean(axis=0), axis=1)
    return bool(np.any(apart > predicted.turned_m + turn_doubt))


class Continuation(NamedTuple):
    """A complete pose brought into the motion before it.

    motion: the filter with it. mahalanobis2, knocked2: squares of how far it was from where that motion, and a knock
    just now, would put the target, over their uncertainty; 0 where no motion was known.
    """

    motion: MotionFilter | None
    mahalanobis2: float = 0.0
    knocked2: float = 0.0

    @property
    def likely(self) -> bool:
        """Whether the target moved on as it did."""
        return self.mahalanobis2 <= MOST_MAHALANOBIS2

    @property
    def possible(self) -> bool:
        """Whether a knock at the most brought it there."""
        return self.knocked2 <= MOST_MAHALANOBIS2


def continuation(setup: Setup, track: Track | None, t_s: float, solved: PoseSolution) -> Continuation:
    """Return how a pose goes on from the motion before it; one that cannot begins a motion anew."""
    motion, pose = track.motion if track is not None else None, solved.pose
    if motion is not None and not 0.0 < t_s - motion.seen_s <= MAX_GAP_S:
        motion = None
    if solved.T is None or pose.covariance is None or not setup.target.model_known:
        return Continuation(motion)
    # an array of its own also without a systematic part: one compilation serves both
    random = pose.covariance - (0.0 if pose.systematic_covariance is None else pose.systematic_covariance)
    if motion is not None:
        step = Continuation(*motion.add_pose(t_s, solved.T, random))
        if step.possible:
            return step
    fresh = MotionFilter.begin(setup.packed, setup.model.xyz_m, t_s, solved.T, random)
    return Continuation(fresh) if motion is None else step._replace(motion=fresh)


def doubtful(setup: Setup, track: Track | None, t_s: float, solved: PoseSolution, step: Continuation) -> bool:
    """Tell whether a pose found in whole frames is near the one before, but not where even a knock would bring it.

    One light of three taken for another is told by nothing else. Far from the one before it is a target that was put
    elsewhere; and the moment after a refusal is believed. Neither holds of a pose beyond its claims: four lights
    under wrong names would begin a motion, by which the right names of three are then refused.
    """
    if track is None or t_s - track.t_s > MAX_GAP_S:
        return False
    if solved.cause is Unseen.BEYOND_CLAIMS:
        return not step.likely
    return not (track.doubted or step.possible or jumped(setup, track, t_s, solved))


def positions_of(setup: Setup, T: Array) -> Array:
    """Return where the lights of the target are (m, 3) in rig axes under its pose T (4, 4)."""
    positions = np.empty((len(setup.model), 3))
    kernels.transform_lights(T, setup.model.xyz_m, positions)
    return positions


def next_track(
    setup: Setup,
    t_s: float,
    solved: PoseSolution,
    views: Sequence[Spots],
    track: Track | None,
    step: Continuation,
    innovation_px: float | None = None,
) -> Track | None:
    """Return where the lights are and how fast they go; lights not seen go on as they went."""
    if "?" in solved.points.names:
        return None
    whole = len(solved.points) == len(setup.model) if len(views) == TWO else solved.T is not None
    if solved.T is not None and setup.target.model_known:
        names, positions = setup.model.names, positions_of(setup, solved.T)
    else:
        names, positions = solved.points.names, solved.points.xyz_m
    velocity = np.zeros_like(positions)
    if track is not None and names == track.names:
        velocity = (positions - track.xyz_m) / (t_s - track.t_s)
    elif track is not None:
        names, positions, velocity = _carry_on(track, t_s, names, positions)
    return trusted(
        Track,
        t_s=t_s,
        whole_t_s=t_s if whole or track is None else track.whole_t_s,
        names=names,
        xyz_m=positions,
        velocity_m_s=velocity,
        half_window_px=half_window_px(views, innovation_px),
        complete=whole,
        motion=step.motion,
        doubted=False,
    )


def half_window_px(views: Sequence[Spots], innovation_px: float | None) -> int:
    """Return the half window for such spots, which were that far from where they were expected (None: nowhere)."""
    reach = SPOT_REACH * max(max(spots.size_px.tolist(), default=0.0) for spots in views)
    if innovation_px is None:
        innovation_px = FIRST_WINDOW_PX
    return ceil(reach + min(LEAST_WINDOW_PX + 2.0 * innovation_px, FIRST_WINDOW_PX))


def _carry_on(
    track: Track, t_s: float, names: tuple[str, ...], positions: Array
) -> tuple[tuple[str, ...], Array, Array]:
    """Return names, positions and velocities of the lights seen, followed by those of the track not seen now."""
    dt = t_s - track.t_s
    before = dict(zip(track.names, zip(track.xyz_m, track.velocity_m_s, strict=True), strict=True))
    velocity = np.zeros_like(positions)
    for i, name in enumerate(names):
        if name in before:
            velocity[i] = (positions[i] - before[name][0]) / dt
    if t_s - track.whole_t_s > MAX_GAP_S:
        return names, positions, velocity
    missing = [name for name in track.names if name not in names]
    gone = [before[name][0] + dt * before[name][1] for name in missing]
    return (
        (*names, *missing),
        np.vstack([positions, *gone]),
        np.vstack([velocity, *(before[name][1] for name in missing)]),
    )
