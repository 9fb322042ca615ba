"""Barycentres held against each other: vAP over approach directions, E over robots (ISO 9283:1998, 7.2.3 and 7.7)."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations
from math import sqrt

import numpy as np

from armsight.verify.iso9283.figure import Figure, noted, too_few, withheld
from armsight.verify.iso9283.observations import PoseVisits
from armsight.verify.iso9283.pose import MIN_ACCURACY, TURNS, VISITS, barycentre_covariance, figure_of, turns_from
from armsight.verify.iso9283.spread import Estimate, magnitude

DIRECTIONS = 3
"""Approach directions, square to each other, that the standard asks for."""
ROBOTS = 5
"""Robots that the standard asks to be exchanged."""
CHANCE = 2.8
"""A length below so many of its standard deviations is what noise alone makes in 19 of 20 cases (chi, 3 degrees)."""

VARIATION = (("vAP", "m"), *((f"vAP_{turn}", "rad") for turn in TURNS))
EXCHANGEABILITY = (("E", "m"),)


def variation(visits: PoseVisits) -> list[Figure]:
    """Return vAP, vAP_a .. vAP_c of one robot at one pose: the largest distance of barycentres by direction.

    The measurement's systematic part is the same in all directions and cancels. n counts the visits of the direction
    that has the fewest, 0 where there are not two.
    """
    if visits.approach is None:
        return withheld(VARIATION, "the approach directions are not known", n=0, wanted=VISITS, place=visits.place)
    labels = np.array(visits.approach)
    parts = [visits.take(np.flatnonzero(labels == name)) for name in visits.directions]
    fewest = min(len(part) for part in parts) if len(parts) > 1 else 0
    if len(parts) < 2:
        why = too_few("approach directions", len(parts), 2, DIRECTIONS)
    elif fewest < MIN_ACCURACY:
        why = too_few("visits of one direction", fewest, MIN_ACCURACY, VISITS)
    else:
        figures = [_farthest("vAP", parts, wanted=VISITS, n=fewest, place=visits.place)]
        figures += _turned_farthest(parts, fewest, visits.place)
        missing = f"{len(parts)} of {DIRECTIONS} directions" if len(parts) < DIRECTIONS else ""
        return [noted(figure, missing) if figure.value is not None else figure for figure in figures]
    return withheld(VARIATION, why, n=fewest, wanted=VISITS, place=visits.place)


def exchangeability(pose: str, robots: Sequence[PoseVisits]) -> list[Figure]:
    """Return E of one commanded pose: the largest distance of the robots' barycentres; n counts robots."""
    several = [visits for visits in robots if len(visits.directions) > 1]
    few = [visits for visits in robots if len(visits) < MIN_ACCURACY]
    if len(robots) < 2:
        why = too_few("robots", len(robots), 2, ROBOTS)
    elif several:
        why = f"robot {several[0].robot} came from several directions; E is of visits from one"
    elif few:
        why = f"robot {few[0].robot}: {too_few('visits', len(few[0]), MIN_ACCURACY, VISITS)}"
    else:
        visits = min(len(part) for part in robots)
        figure = _farthest("E", robots, wanted=ROBOTS, n=len(robots), place=pose)
        return [noted(figure, f"{visits} of {VISITS} visits" if visits < VISITS else "")]
    return withheld(EXCHANGEABILITY, why, n=len(robots), wanted=ROBOTS, place=pose)


def _farthest(symbol: str, parts: Sequence[PoseVisits], *, wanted: int, n: int, place: str) -> Figure:
    """Return the largest distance between barycentres, with the standard deviation of that pair's."""
    pairs = [
        magnitude(
            one.xyz_m.mean(axis=0) - other.xyz_m.mean(axis=0),
            barycentre_covariance(one) + barycentre_covariance(other),
        )
        for one, other in combinations(parts, 2)
    ]
    largest = max(pairs, key=lambda pair: pair.value)
    # the largest of several is too large on average by more than one pair's noise: nothing is taken out
    figure = figure_of(symbol, "m", Estimate(value=largest.value, std=largest.std), n=n, wanted=wanted, place=place)
    return noted(figure, "no more than the barycentres' own scatter" if largest.value < CHANCE * largest.std else "")


def _turned_farthest(parts: Sequence[PoseVisits], n: int, place: str) -> list[Figure]:
    """Return vAP_a .. vAP_c: the largest turn, by component, between the directions' mean orientations."""
    rotations = [part.rotation for part in parts]
    known = [rotation for rotation in rotations if rotation is not None]
    if len(known) < len(parts):
        return withheld(VARIATION[1:], "no orientations were measured", n=n, wanted=VISITS, place=place)
    means = [rotation.mean() for rotation in known]
    variances = [
        turns_from(rotation, mean).var(axis=0, ddof=1) / len(rotation)
        for rotation, mean in zip(known, means, strict=True)
    ]
    pairs = list(combinations(range(len(known)), 2))
    turns = np.array([np.abs(turns_from(means[i], means[j])) for i, j in pairs])  # (pairs, 3)
    figures = []
    for axis, turn in enumerate(TURNS):
        i, j = pairs[int(turns[:, axis].argmax())]
        std = sqrt(float(variances[i][axis] + variances[j][axis]))
        estimate = Estimate(value=float(turns[:, axis].max()), std=std)
        figures.append(figure_of(f"vAP_{turn}", "rad", estimate, n=n, wanted=VISITS, place=place))
    return figures
