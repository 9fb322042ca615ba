"""Which spot is which light: pieces of ways laid together on the flange, then every spot by where its light must be.

The pieces are of single lights, followed from frame to frame before anybody knows which light it is.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import permutations

import numpy as np

from armsight.arrays import Array, Index
from armsight.calibrate.cell.model import CellModel
from armsight.calibrate.cell.observations import Spots
from armsight.errors import Ambiguous, Degenerate, Inconsistent, NotEnoughData
from armsight.geometry import align_points

GATE_PX = 15.0
"""A spot further than this from where its way leads is another one's."""
RIVAL = 1.5
"""The second nearest spot must be so many times as far off, or the way ends: two lights that pass are not mixed up."""
BRIDGED = 3
"""Frames that a light may be missing for."""
SHORTEST = 15
PIECES, ROWS = 16, 120
"""Pieces of ways used at first, those with the most motion, and spots of each."""
STILL_PX = 3.0
"""Spots that stay within so much while the arm moves are lamps."""
WINDOW, MOVING = 150, 1.0 / 3.0
"""Spots of a way that are looked at together, and the share of such windows in which a light of the arm moves."""


@dataclass(slots=True)
class _Way:
    rows: list[int]
    frame: int
    uv: Array
    step: Array


def tracklets(spots: Spots, number: Index) -> list[Index]:
    """Return the ways (rows of spots) of moving lights in one camera; number (frames,): of each frame, lost counted."""
    ways: list[_Way] = []
    open_: list[_Way] = []
    edges = np.searchsorted(spots.frame, np.arange(int(spots.frame[-1]) + 2)) if len(spots) else np.zeros(1, np.intp)
    for frame in range(len(edges) - 1):
        rows = np.arange(edges[frame], edges[frame + 1])
        now = int(number[frame])
        uv = spots.uv_px[rows]
        open_ = [way for way in open_ if now - way.frame <= BRIDGED + 1]
        taken = _joined(open_, uv, now) if len(rows) and open_ else {}
        for k, row in enumerate(rows.tolist()):
            way = taken.get(k)
            if way is None:
                way = _Way([row], now, uv[k], np.zeros(2))
                ways.append(way)
                open_.append(way)
                continue
            gap = max(now - way.frame, 1)
            way.step, way.uv, way.frame = (uv[k] - way.uv) / gap, uv[k], now
            way.rows.append(row)
    found = [np.array(way.rows, dtype=np.intp) for way in ways if len(way.rows) >= SHORTEST]
    return [rows for rows in found if moves(spots.uv_px[rows])]


def moves(uv_px: Array) -> bool:
    """Tell whether a way (k, 2) is of a light on the arm, which moves all along; a lamp jumps where a camera is hit."""
    parts = np.array_split(uv_px, max(round(len(uv_px) / WINDOW), 1))
    return bool(np.mean([extent_px(part) > STILL_PX for part in parts]) > MOVING)


def extent_px(uv_px: Array) -> float:
    """Return over how much a way (k, 2) extends, the wildest twentieth of its spots at each end left out."""
    low, high = np.percentile(uv_px, (5.0, 95.0), axis=0)
    return float((high - low).max())


def best_pieces(spots: Spots, ways: Sequence[Index]) -> list[Index]:
    """Return the pieces with the most motion, thinned."""
    spread = [extent_px(spots.uv_px[rows]) * len(rows) for rows in ways]
    best = sorted(range(len(ways)), key=lambda k: -spread[k])[:PIECES]
    return [ways[k][np.linspace(0, len(ways[k]) - 1, min(ROWS, len(ways[k]))).astype(np.intp)] for k in best]


def _joined(ways: list[_Way], uv: Array, now: int) -> dict[int, _Way]:
    """Return which way each spot (k,) goes on with: each the other's nearest, and no rival near."""
    ahead = np.array([way.uv + way.step * (now - way.frame) for way in ways])
    far = np.hypot(uv[:, :1] - ahead[:, 0], uv[:, 1:] - ahead[:, 1])  # (k, ways)
    which, mutual = far.argmin(axis=1).tolist(), far.argmin(axis=0).tolist()
    near, *rivals = np.partition(far, min(1, len(ways) - 1), axis=1).T[:2].tolist()
    # an ended way costs a piece, a mixed one the start
    rivals = rivals or [[np.inf] * len(uv)]
    return {
        k: ways[way]
        for k, (way, at, rival) in enumerate(zip(which, near, rivals[0], strict=True))
        if at < GATE_PX and mutual[way] == k and rival > RIVAL * at
    }


NEAR = 0.35
"""Of the smallest distance between a target's lights: pieces nearer to each other are of one light."""
MOST_PLACES = 8
"""Places on the flange that are taken for lights at most, those with the most spots first."""
LEAST_MATCH_M = 2e-3
"""Lights lie as the target's file says to within this, or MATCH of its size."""
MATCH = 0.04
RIVAL_NAMING = 3.0
"""Another naming must fit so many times worse, or the lights are taken for indistinguishable."""
CONFUSED = 2.5
"""A spot whose second light is not so many times further off is nobody's."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class NamedLights:
    """The lights' names and places (n, 3) m in flange axes; rms_m: how well they lie as the target's file says."""

    names: tuple[str, ...]
    xyz_m: Array
    rms_m: float


def places_on_flange(lights_m: Sequence[Array], weights: Sequence[Array], near_m: float) -> tuple[Array, Array]:
    """Return places (k, 3) at which pieces of all cameras agree, and how many spots each has (k,), most first."""
    X, w = np.concatenate(list(lights_m)), np.concatenate(list(weights))
    places: list[Array] = []
    counts: list[float] = []
    left = np.ones(len(X), bool)
    while left.any():
        within = np.linalg.norm(X[:, None] - X[None], axis=2) < near_m
        mass = (within & left[None]) @ w * left  # spots of the pieces about each that is not yet taken
        k = int(np.argmax(mass))
        members = within[k] & left
        members[k] = True
        at = np.array([_median(X[members, axis], w[members]) for axis in range(3)])
        places.append(at)
        counts.append(float(w[members].sum()))
        left &= ~members
    order = np.argsort(counts)[::-1][:MOST_PLACES]
    return np.array(places)[order], np.array(counts)[order]


def _median(values: Array, weights: Array) -> float:
    order = np.argsort(values)
    total = np.cumsum(weights[order])
    return float(values[order][np.searchsorted(total, 0.5 * total[-1])])


def name_lights(places_m: Array, positions_m: Mapping[str, Array], *, arm_fits: bool = True) -> NamedLights:
    """Return the target's lights among the places (k, 3). positions_m: by name, as the target's file has them.

    arm_fits: whether the arm's motion explains the images well; else it is the arm's model that is doubted first.

    Raises NotEnoughData, Inconsistent (another target, or seen in a mirror), Ambiguous (a symmetric one).
    """
    names = tuple(positions_m)
    shape = np.array([positions_m[name] for name in names], float)
    if len(places_m) < len(names):
        raise NotEnoughData(
            f"{len(places_m)} lights that move with the flange were found, the target has {len(names)}",
            consequence="The target cannot be recognised",
            cure="See that all its lights shine and are seen for some seconds, and that the target is the file's",
        )
    size = float(np.linalg.norm(shape - shape.mean(axis=0), axis=1).max())
    allowed = max(LEAST_MATCH_M, MATCH * size)
    chosen = [(order, places_m[list(order)]) for order in permutations(range(len(places_m)), len(names))]
    fits = sorted(((_misfit(at, shape), order) for order, at in chosen), key=lambda fit: fit[0])
    best, order = fits[0]
    if best > allowed:
        mirrored = min(_misfit(at * np.array([-1.0, 1.0, 1.0]), shape) for _, at in chosen)
        hint = (
            "Its mirror image would fit: check the target's coordinates (right-handed), or for cameras that mirror"
            if mirrored < min(allowed, 0.3 * best)
            else "Give the file of the target that is on the flange, or measure it: armsight calibrate target; see "
            "too that --model is of this arm"
            if arm_fits
            else "Check that --model is of this arm, whose motion explains the images poorly; then the target's file"
        )
        raise Inconsistent(
            f"the lights on the flange do not lie as in the target's file: {1e3 * best:.1f} mm remain",
            consequence="Nothing is calibrated",
            cure=hint,
        )
    if len(fits) > 1 and fits[1][0] < max(RIVAL_NAMING * best, 0.25 * allowed):
        raise Ambiguous(
            "two of the target's lights can be exchanged: it looks alike from two sides",
            consequence="Nobody can say how the target is turned on the flange",
            cure="Move a light so that all distances differ by some millimetres, and measure the target again",
        )
    return NamedLights(names=names, xyz_m=places_m[list(order)], rms_m=best)


def _misfit(at: Array, shape: Array) -> float:
    try:
        return align_points(at, shape).rms_m
    except Degenerate:
        return np.inf


def assign(model: CellModel, x: Array, spots: Spots, gate_px: Sequence[float]) -> Spots:
    """Return the spots that are of a light, by where each would be seen; gate_px: of each camera."""
    far = np.linalg.norm(model.pixels_of_all(x, spots) - spots.uv_px[:, None], axis=2)
    far[~np.isfinite(far)] = np.inf
    order = np.sort(far, axis=1)
    light = np.argmin(far, axis=1)
    near = order[:, 0]
    # two lights that nearly cover each other are nobody's: a wrong name costs more than a spot
    kept = near < np.asarray(gate_px)[spots.side]
    if far.shape[1] > 1:
        kept &= order[:, 1] > CONFUSED * near
    # of two spots for one light of a frame the nearer one
    rows = np.flatnonzero(kept)
    rows = rows[np.lexsort((near[rows], light[rows], spots.frame[rows], spots.side[rows]))]
    key = np.stack([spots.side[rows], spots.frame[rows], light[rows]], axis=1)
    first = np.ones(len(rows), bool)
    first[1:] = (np.diff(key, axis=0) != 0).any(axis=1)
    number = np.full(len(spots), -1)
    number[rows[first]] = light[rows[first]]
    return spots.of_lights(number)
