"""Which spot is which light: pieces of ways laid together on the flange, then every spot by where its light must be."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import permutations

import numpy as np

from armsight.arrays import Array
from armsight.calibrate.cell.model import CellModel
from armsight.calibrate.cell.observations import Spots
from armsight.errors import Ambiguous, Degenerate, Inconsistent, NotEnoughData
from armsight.geometry import align_points

NEAR = 0.35
"""Of the smallest distance between a target's lights: pieces nearer to each other are of one light."""
MOST_PLACES = 8
"""Places on the flange that are taken for lights at most, those with the most spots first."""
LEAST_MATCH_M = 2e-3
"""Lights lie as the target's file says to within this, or MATCH of its size."""
MATCH = 0.04
RIVAL = 3.0
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
    """Return places (k, 3) at which pieces of both cameras agree, and how many spots each has (k,), most first."""
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
    if len(fits) > 1 and fits[1][0] < max(RIVAL * best, 0.25 * allowed):
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


def assign(model: CellModel, x: Array, spots: Spots, gate_px: tuple[float, float]) -> Spots:
    """Return the spots that are of a light, by where each would be seen; gate_px: of the left and right camera."""
    far = np.empty((len(spots), len(model.lights)))
    for k in range(len(model.lights)):
        seen = model.pixels(x, spots.of_lights(np.full(len(spots), k)))
        far[:, k] = np.linalg.norm(seen - spots.uv_px, axis=1)
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
