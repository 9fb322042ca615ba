"""From the spots of any number of cameras to the target's pose, every sight of every light counted.

Names come from the track, from the best pair of views, or from one view alone; each such hypothesis is completed in all
views by projection, and all their sights are judged together. A rig of two cameras has its own way: `from_spots`, by
which a light must be seen twice.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import combinations
from math import comb
from typing import NamedTuple

import numpy as np

from armsight.arrays import Array, Index
from armsight.errors import Unseen
from armsight.measure.poses.board_views import pose_of_corners
from armsight.measure.poses.correspondence import AS_FOUND, BY_CHANCE, RIVAL, match_known
from armsight.measure.poses.kernels import completion
from armsight.measure.poses.kernels import hidden as outlines
from armsight.measure.poses.kernels import one_view as kernels
from armsight.measure.poses.kernels.pose_ambiguity import POSSIBLE
from armsight.measure.poses.lone_light import measure_light
from armsight.measure.poses.outcome import Assignment, Measured, Prediction, Track, doubted, lost_moment
from armsight.measure.poses.pairs import PAIR_GATE, pair_spots
from armsight.measure.poses.pose import PoseSolution, lost, no_points
from armsight.measure.poses.setup import Setup, fit_limit
from armsight.measure.poses.sights import Sights
from armsight.measure.poses.solving import (
    compare,
    named_spots,
    solve_views,
    take_spots,
    why_hidden,
    widened_or_odd,
)
from armsight.measure.poses.tracking import continuation, doubtful, expected, next_track, positions_of
from armsight.measure.poses.unnamed_lights import measure_unnamed
from armsight.records import Frame, NotSeen, PoseStatus, Spots
from armsight.records.checks import for_kernels

FEWEST = 4
"""Sights without which there is no pose: three fix it, and a fourth is the least that can speak against it."""

MOST_ALONE = 12
"""Spots of a view up to which its lights are named by it alone, as rpg_monocular_pose_estimator does."""
REACH_PX = 3.0
"""How far a light's image may be off under a pose by three spots, whose noise grows with the way to the others."""
FAR_PX = 8.0
"""The same in another view, from which the depth and the tilt by three spots are seen aside."""
MOST_COMBINATIONS = 200_000
"""Combinations of three spots and three lights looked at; 0.3 s."""
ROOM = 16
"""Namings by one view that are kept."""

CONVINCING = 0.7
"""Share of the sights that could be at most with which a hypothesis is taken before all sources are asked: two lights
and a reflection fit some arrangement, and a worse one than another pair of views has."""
CONFIRMED = 0.01
"""How often, at most, a spot lies where a pose of chance expects a light: ten spots in a hundredth of a picture."""
ALONE_BY_CHANCE = 1e-4
"""Expected number of namings of chance by one view from which none is believed."""
SOLUTIONS = 2.0
"""Poses by three spots, as there are mostly."""
LEAST_RMS_PX = 0.15
"""Residuals below which a naming by one view gains nothing more against chance."""

ELSEWHERE = 18.4
"""-2 log of the density of a spot that is of no light, anywhere in 100 by 100 px: the cost to leave one unnamed."""

_ROUNDS = 3
MOVED = "the lights are not where the target's motion puts them; the next moment tells"


class Hypothesis(NamedTuple):
    """Which spot of each view each light is, rows (m, v), -1 for none, and the pose T (4, 4), C (6, 6) that says so.

    chi2: of all sights, slack included. chance: expected number of others by chance; of one named by a view `alone` how
    many combinations were looked at. score: -2 log likelihood, less what the sights would cost as spots of no light.
    """

    rows: Index
    T: Array
    C: Array
    chi2: float
    chance: float = 0.0
    alone: int = -1
    score: float = np.inf

    @property
    def n(self) -> int:
        """How many sights it has."""
        return int(np.count_nonzero(self.rows >= 0))


def measure_views(
    setup: Setup,
    t_s: float,
    seen: Sequence[Spots],
    track: Track | None = None,
    frames: Sequence[Frame | None] | None = None,
    *,
    in_windows: bool = False,
) -> Measured:
    """Return the target's pose from all spots of the views, in the rig's order; of a board its points.

    frames: the images, to compare the lights' outlines; None where a view has none. in_windows: the spots are those
    near where the track expects them, so that the pose must go on from its motion.
    """
    if setup.target.is_board:
        return pose_of_corners(setup, t_s, seen)
    if len(setup.model) == 1:
        return measure_light(setup, t_s, seen)
    if len(setup.model) == 2 or not setup.target.model_known:
        return measure_unnamed(setup, t_s, seen, frames)
    sights = Sights.of(setup, seen)
    predicted = expected(setup, track, t_s)
    found: list[Hypothesis] = []
    most = sum(min(len(spots), len(setup.model)) for spots in seen)

    def decided() -> Measured:
        chosen = _choose(setup, found, predicted)
        if isinstance(chosen, NotSeen):
            return lost_moment(t_s, sights.by_view, chosen, track)
        return doubted(_judged(setup, t_s, sights, chosen, track, frames, in_windows=in_windows))

    for ways in _sources(setup, t_s, sights, track):
        found += [done for way in ways if (done := completed(setup, sights, way)) is not None]
        if max((way.n for way in found), default=0) >= CONVINCING * most:
            measured = decided()
            if measured.pose.status is PoseStatus.OK:
                return measured
    return decided()


def _sources(setup: Setup, t_s: float, sights: Sights, track: Track | None) -> Iterator[list[Hypothesis]]:
    """Give the hypotheses of one source after the other: the track, pairs of views, views alone."""
    m, seen = len(setup.model), sights.by_view
    start = None if track is None else by_track(setup, t_s, track)
    if start is not None:
        yield [start]
    for a, b in _pairs(setup, seen):
        yield _by_pair(setup, sights, a, b)
    for s in sorted(range(len(seen)), key=lambda s: -min(len(seen[s]), m)):
        if 3 <= len(seen[s]) <= MOST_ALONE:
            yield _by_one(setup, sights, s)


def by_track(setup: Setup, t_s: float, track: Track) -> Hypothesis | None:
    """Return the hypothesis, of no spots yet, that the target goes on from its motion; None where that is not known."""
    if track.motion is None:
        return None
    state, rows = track.motion.at(t_s), np.full((len(setup.model), len(setup.packed.k)), -1, np.intp)
    return Hypothesis(rows, state.T_rig_target, np.array(state.C[:6, :6]), np.inf)


def _pairs(setup: Setup, seen: tuple[Spots, ...]) -> list[tuple[int, int]]:
    """Return the pairs of views that may see three lights both, best first: most lights, then the widest angle."""
    m, R = len(setup.model), setup.packed.R
    possible = [p for p in combinations(range(len(seen)), 2) if min(len(seen[p[0]]), len(seen[p[1]])) >= 3]

    def rank(pair: tuple[int, int]) -> tuple[bool, int, float]:
        a, b = pair
        n = len(seen[a]), len(seen[b])
        return max(n) > m, -min(*n, m), float(abs(R[a][2] @ R[b][2]))

    return sorted(possible, key=rank)


def _by_pair(setup: Setup, seen: Sights, a: int, b: int) -> list[Hypothesis]:
    """Return the hypotheses by two views, as a rig of these two cameras has them."""
    pair, left, right = setup.pair(a, b), seen.by_view[a], seen.by_view[b]
    pairs = pair_spots(pair.packed, left, right, setup.slack_px)
    if not len(pairs.index):
        return []
    match = match_known(pair, left, right, pairs, arrangements=AS_FOUND)
    ways = []
    for one in (match.best,) if match.best is not None else match.alternatives:
        rows = np.full((len(setup.model), len(seen.by_view)), -1, np.intp)
        lights = [setup.model.names.index(name) for name in one.names]
        rows[np.ix_(lights, (a, b))] = pairs.index[one.pair]
        ways += _tilts(setup, seen, Hypothesis(rows, _matrix(one), np.eye(6), np.inf, match.chance))
    return ways


def _matrix(one: Assignment) -> Array:
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = one.R, one.t_m
    return T


def _by_one(setup: Setup, seen: Sights, s: int) -> list[Hypothesis]:
    """Return the hypotheses by one view, as far as they are not expected by chance."""
    X, packed = setup.model.xyz_m, setup.packed
    m = len(X)
    room = np.empty((ROOM, m), np.intp), np.empty(ROOM, np.intp), np.empty(ROOM), np.empty((ROOM, 3, 4))
    rules = REACH_PX, FAR_PX, FEWEST, MOST_COMBINATIONS
    found, looked, cut = kernels.name_by_three(packed.arrays, s, X, (seen.uv_px, seen.first), rules, room)
    ways: list[Hypothesis] = []
    if cut:
        return ways
    back = np.eye(4)  # rig from camera
    back[:3, :3], back[:3, 3] = packed.R[s].T, -packed.R[s].T @ packed.t[s]
    found = int(np.count_nonzero(room[1][:found] >= room[1][0] - 1)) if found else 0  # others are no rivals
    for names, pose in zip(room[0][:found], room[3][:found], strict=True):
        rows = np.full((m, len(seen.by_view)), -1, np.intp)
        rows[:, s] = names
        way = Hypothesis(rows, back @ np.vstack([pose, [0.0, 0.0, 0.0, 1.0]]), np.eye(6), np.inf, looked, s)
        ways += _tilts(setup, seen, way)
    return ways


def _by_chance(setup: Setup, seen: Sights, way: Hypothesis) -> float:
    """Return how many namings by one view would by chance explain so many sights so well, over what is believed.

    Of each combination that was looked at, any other sights may fit: each has a spot of chance as near as the residuals
    are with the share that such circles have of the target's image. None where all lights are seen and nothing else is
    bright.
    """
    m, n, c = len(setup.model), way.n, len(seen.uv_px)
    if n == c and (way.rows >= 0).sum(axis=0).max() == m:
        return 0.0
    rms = max(np.sqrt(way.chi2 / n) * setup.slack_px, LEAST_RMS_PX)
    near, slots = 0.0, way.rows.size - 3
    for s, spots in enumerate(seen.by_view):
        depth_m = float(setup.packed.R[s][2] @ way.T[:3, 3] + setup.packed.t[s][2])
        wide_px = setup.packed.k[s][0] * setup.model.distance_m.max() / max(depth_m, 1e-3)
        near = max(near, len(spots) * (4.0 * rms / wide_px) ** 2)  # circles of twice the residual in the target's one
    return float(BY_CHANCE / ALONE_BY_CHANCE * SOLUTIONS * way.chance * comb(slots, n - 3) * min(near, 1.0) ** (n - 3))


def _tilts(setup: Setup, seen: Sights, way: Hypothesis, *, mirrored: bool = True) -> list[Hypothesis]:
    """Return a hypothesis refined by its own sights, and the mirrored tilts that fit these as well."""
    names, views = seen.named(setup, way.rows, way.T)
    h = way.rows.shape[1] + 1 if mirrored else 1
    Ts, Cs, scores = np.empty((h, 4, 4)), np.empty((h, 6, 6)), np.empty((h, 3))
    spots = named_spots(setup, names, views)
    lights = for_kernels(spots.xyz_m), spots.radius_m, spots.normal
    kernels.tilts(setup.packed.arrays, lights, views[:2], setup.slack_px**2, views.start, Ts, Cs, scores)
    found: list[Hypothesis] = []
    for (chi2, wide, neg2), T, C in sorted(zip(scores.tolist(), Ts, Cs, strict=True), key=lambda one: one[0][0]):
        if not chi2 <= scores[:, 0].min() + POSSIBLE or not np.isfinite(chi2):
            break
        if not any(np.abs(T[:3, :3] - other.T[:3, :3]).max() < 1e-3 for other in found):
            found.append(way._replace(T=T, C=C, chi2=wide, score=neg2 - ELSEWHERE * way.n))
    return found


def completed(setup: Setup, seen: Sights, way: Hypothesis) -> Hypothesis | None:
    """Return the hypothesis with all sights that its pose finds, refined by them; None where they do not agree."""
    rows, packed, own = way.rows.copy(), setup.packed, way.n
    X, spots, near = setup.model.xyz_m, (seen.uv_px, seen.cov_px2, seen.first), (setup.slack_px**2, PAIR_GATE)
    for _ in range(_ROUNDS):
        if not completion.complete(packed.arrays, X, way.T, way.C, packed.covariance, spots, near, rows):
            break
        if (rows >= 0).sum() < FEWEST or (rows >= 0).any(axis=1).sum() < 3:
            return None
        refined = _tilts(setup, seen, way._replace(rows=rows.copy()), mirrored=False)
        if not refined:
            return None
        way = refined[0]
    if way.n < FEWEST or not way.chi2 <= fit_limit(way.n):
        return None
    if way.alone >= 0:
        return way._replace(chance=_by_chance(setup, seen, way))
    return way._replace(chance=way.chance * CONFIRMED ** (way.n - own))


def _choose(setup: Setup, found: list[Hypothesis], predicted: Prediction | None) -> Hypothesis | NotSeen:
    """Return the likeliest hypothesis; of some that are nearly as likely and name spots otherwise the expected one."""
    found = [way for way in found if _faces(setup, way)]
    if not found:
        return NotSeen("no arrangement of the spots is the target's", Unseen.LIGHTS_MISSING)
    best = min(found, key=lambda way: way.score)
    possible = [way for way in found if way.score < best.score + RIVAL and (way is best or contradict(best, way))]
    if len(possible) > 1:
        chosen = _as_expected(setup, possible, predicted)
        if chosen is None:
            return NotSeen("ambiguous: several assignments of names fit equally well", Unseen.AMBIGUOUS)
        best = chosen
    if best.chance >= BY_CHANCE:
        why = f"{best.n} sights fit the target, but no better than some would by chance"
        return NotSeen(why, Unseen.CROWD)
    return best


def contradict(a: Hypothesis, b: Hypothesis) -> bool:
    """Whether two hypotheses give a light two spots of a view, or a spot two lights: parts of a target may be alike."""
    same = (a.rows[:, None] == b.rows[None]) & (a.rows[:, None] >= 0)  # (m, m, v): light i of one, j of the other
    other_spot = (a.rows >= 0) & (b.rows >= 0) & (a.rows != b.rows)
    return bool(other_spot.any() or same[~np.eye(len(a.rows), dtype=np.bool_)].any())


def _as_expected(setup: Setup, ways: list[Hypothesis], predicted: Prediction | None) -> Hypothesis | None:
    """Return the hypothesis by which lights are where they are expected, and by all that contradict it far from it."""
    if predicted is None:
        return None
    no_pair = np.zeros(0, np.intp)
    poses = [Assignment(names=(), pair=no_pair, chi2=0.0, R=way.T[:3, :3], t_m=way.T[:3, 3]) for way in ways]
    every = list(zip(ways, poses, strict=True))
    for way, pose in sorted(every, key=lambda one: one[0].score):
        others = [rival for other, rival in every if contradict(way, other)]
        if all(predicted.choice(setup.model, [pose, rival]) is pose for rival in others):
            return way
    return None


def _faces(setup: Setup, way: Hypothesis) -> bool:
    """Whether the views that see lights of a one-sided target see its front."""
    if not setup.model.one_sided:
        return True
    R, t = setup.packed.R, setup.packed.t
    eyes = [-R[s].T @ t[s] for s in np.flatnonzero((way.rows >= 0).any(axis=0))]
    return all(way.T[:3, 2] @ (way.T[:3, 3] - eye) > 0.0 for eye in eyes)


def _judged(
    setup: Setup,
    t_s: float,
    seen: Sights,
    way: Hypothesis,
    track: Track | None,
    frames: Sequence[Frame | None] | None,
    *,
    in_windows: bool = False,
) -> Measured:
    """Return the pose of a hypothesis by all its sights, half-hidden lights left out of the view that shows them so."""
    rows, solved, hidden = _looked_at(setup, t_s, seen, way, frames)
    if solved.T is None or solved.pose.status is not PoseStatus.OK:
        missed = NotSeen(why_hidden(hidden, PoseStatus.LOST), Unseen.HALF_HIDDEN) if hidden else solved.missed
        return lost_moment(t_s, seen.by_view, missed, track)
    step = continuation(setup, track, t_s, solved)
    if in_windows and not step.likely:
        return lost_moment(t_s, seen.by_view, NotSeen(MOVED, Unseen.MOTION), track)
    if track is not None and doubtful(setup, track, t_s, solved, step):
        return lost_moment(t_s, seen.by_view, NotSeen(MOVED, Unseen.MOTION), replace(track, doubted=True))
    lights = np.flatnonzero((rows >= 0).any(axis=1))
    spots = tuple(take_spots(one, r[r >= 0]) for one, r in zip(seen.by_view, rows[lights].T, strict=True))
    return Measured(
        pose=solved.pose,
        points=solved.points,
        spots=spots,
        names=tuple(setup.model.names[i] for i in lights.tolist()),
        seen=seen.by_view,
        sights=rows[lights] >= 0,
        track=next_track(setup, t_s, solved, spots, track, step),
        notes=tuple(f"{name} half hidden from one camera, and left out of its view" for name in hidden),
        cause=solved.cause,
    )


def _looked_at(
    setup: Setup, t_s: float, seen: Sights, way: Hypothesis, frames: Sequence[Frame | None] | None
) -> tuple[Index, PoseSolution, tuple[str, ...]]:
    """Return the sights that are whole, what is solved from them, and the lights that are half hidden in a view."""
    rows, start, hidden = way.rows.copy(), np.array(way.T), list[str]()
    while True:
        if (rows >= 0).sum() < FEWEST or (rows >= 0).any(axis=1).sum() < 3:
            why = "too few lights are seen as a whole"
            return rows, PoseSolution(pose=lost(t_s, why), points=no_points(), cause=Unseen.HALF_HIDDEN), tuple(hidden)
        names, views = seen.named(setup, rows, start)
        solved = solve_views(setup, t_s, names, views)
        if frames is None or solved.T is None:
            return rows, solved, tuple(hidden)
        lights = np.flatnonzero((rows >= 0).any(axis=1))
        shown = seen.taken(rows[lights])
        verdict, out = compare(setup, positions_of(setup, solved.T)[lights], solved.T, shown, frames)
        if verdict == outlines.NO_DOUBT:
            return rows, solved, tuple(hidden)
        widened, odd = widened_or_odd(setup, t_s, names, views, solved, out)
        if widened is not None:
            return rows, widened, tuple(hidden)
        hidden += [names[i] for i in np.flatnonzero(odd.any(axis=0)).tolist()]
        kept = rows[lights]
        kept[odd.T] = -1
        rows[lights] = kept
