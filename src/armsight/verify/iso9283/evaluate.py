"""All figures of ISO 9283:1998 that a test's data carry, and for the others the reason why not."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations
from math import sqrt

import numpy as np

from armsight.errors import Inconsistent
from armsight.verify.iso9283 import drift, path, pose
from armsight.verify.iso9283.figure import Estimate, Figures, IsoFigure, magnitude, noted, too_few, withheld
from armsight.verify.iso9283.observations import ArrivalTest, PathTest, PoseVisits
from armsight.verify.iso9283.pose import MIN_ACCURACY, TURNS, VISITS, barycentre_covariance, figure_of, turns_from

DIAGONAL = ("P2", "P4")
"""The standard's two poses for the distance: the ends of a diagonal of the test plane."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Iso9283Test:
    """What was measured; any of the three may be empty. distance: the two poses of AD and RD.

    Without distance they are P2 and P4 where there are such, else the two poses that lie furthest apart. Raises
    Inconsistent where one robot's pose comes twice, or where distance names a pose that was not visited.
    """

    poses: tuple[PoseVisits, ...] = ()
    paths: tuple[PathTest, ...] = ()
    arrivals: tuple[ArrivalTest, ...] = ()
    distance: tuple[str, str] | None = None

    def __post_init__(self) -> None:
        for name in ("poses", "paths", "arrivals"):
            object.__setattr__(self, name, tuple(getattr(self, name)))
        places = [(visits.robot, visits.pose) for visits in self.poses]
        twice = [visits.place for visits in self.poses if places.count((visits.robot, visits.pose)) > 1]
        if twice:
            raise Inconsistent(
                f"pose {twice[0]} is given twice",
                consequence="Its visits would be judged apart",
                cure="Give all visits of one robot at one pose as one PoseVisits",
            )
        unknown = [name for name in self.distance or () if name not in {pose for _, pose in places}]
        if unknown:
            raise Inconsistent(
                f"the distance is to pose {unknown[0]}, which was not visited",
                consequence="AD and RD cannot be given",
                cure=f"Name two of: {', '.join(sorted({pose for _, pose in places}))}",
            )


def evaluate(test: Iso9283Test) -> Figures:
    """Return all figures of a test, in the standard's order: those of poses, of distances, of arrivals, of paths.

    Every symbol of the standard that is computed here is there at least once, withheld where nothing was measured for
    it. Pure; raises nothing for data that do not carry a figure.
    """
    return Figures(figures=tuple(_all(test)))


def _all(test: Iso9283Test) -> Iterator[IsoFigure]:
    if not test.poses:
        outer = [(f"{kind}{tail}", unit) for kind in ("AD", "RD") for tail, unit in pose.OUTER]
        symbols = (
            *pose.ACCURACY,
            *pose.ACCURACY_ROTATION,
            *pose.REPEATABILITY,
            *pose.REPEATABILITY_ROTATION,
            *VARIATION,
            *drift.DRIFTS,
            *outer,
        )
        yield from withheld(symbols, "no visits of a commanded pose were given", n=0, wanted=pose.VISITS)
        yield from withheld(EXCHANGEABILITY, "no visits were given", n=0, wanted=ROBOTS)
    for visits in test.poses:
        yield from drift.told_of_trend(pose.pose_figures(visits), [visits])
    for visits in test.poses:
        yield from variation(visits)
    for visits in test.poses:
        yield from drift.drift_figures(visits)
    yield from _distances(test)
    yield from _arrivals(test)
    yield from _exchanged(test)
    yield from _paths(test)


def _distances(test: Iso9283Test) -> Iterator[IsoFigure]:
    """Yield AD and RD of each robot."""
    for robot in dict.fromkeys(visits.robot for visits in test.poses):
        own = {visits.pose: visits for visits in test.poses if visits.robot == robot}
        pair = test.distance or (DIAGONAL if set(DIAGONAL) <= set(own) else _farthest(own))
        if pair is None or not set(pair) <= set(own):
            names = [(f"{kind}{tail}", unit) for kind in ("AD", "RD") for tail, unit in pose.OUTER]
            yield from withheld(names, "two commanded poses are needed", n=0, wanted=pose.VISITS, place=robot)
        else:
            ends = [own[name] for name in pair]
            yield from drift.told_of_trend(pose.distance_figures(*ends), ends)


def _farthest(own: dict[str, PoseVisits]) -> tuple[str, str] | None:
    """Return the two poses furthest apart among those with the most cycles in common; None below two poses."""
    mean = {name: visits.xyz_m.mean(axis=0) for name, visits in own.items() if len(visits)}
    cycles = {name: set(own[name].visit.tolist()) for name in mean}
    pairs = list(combinations(mean, 2))
    if not pairs:
        return None
    return max(
        pairs,
        key=lambda pair: (
            min(len(cycles[pair[0]] & cycles[pair[1]]), pose.VISITS),
            float(np.linalg.norm(mean[pair[0]] - mean[pair[1]])),
        ),
    )


def _exchanged(test: Iso9283Test) -> Iterator[IsoFigure]:
    """Yield E of each pose that several robots visited; withheld once where there is none."""
    names = dict.fromkeys(visits.pose for visits in test.poses)
    robots = {name: [visits for visits in test.poses if visits.pose == name] for name in names}
    shared = [name for name in names if len(robots[name]) > 1] or list(names)[:1]
    for name in shared:
        yield from exchangeability(name, robots[name])


def _arrivals(test: Iso9283Test) -> Iterator[IsoFigure]:
    if not test.arrivals:
        yield from withheld(drift.FIGURES, "no arrivals were given", n=0, wanted=drift.ARRIVALS)
    for trace in test.arrivals:
        yield from drift.arrival_figures(trace)


def _paths(test: Iso9283Test) -> Iterator[IsoFigure]:
    if not test.paths:
        why = "no runs along a path were given"
        yield from withheld((*path.ACCURACY, *path.REPEATABILITY), why, n=0, wanted=path.RUNS)
        yield from withheld(path.CORNER_FIGURES, why, n=0, wanted=path.CORNER_RUNS)
        yield from withheld(path.VELOCITY_FIGURES, why, n=0, wanted=path.RUNS)
    for runs in test.paths:
        yield from path.path_figures(runs)
        yield from path.corner_figures(runs)
        yield from path.velocity_figures(runs)


# Barycentres held against each other: vAP over approach directions, E over robots (ISO 9283:1998, 7.2.3 and 7.7).

DIRECTIONS = 3
"""Approach directions, square to each other, that the standard asks for."""
ROBOTS = 5
"""Robots that the standard asks to be exchanged."""
CHANCE = 2.8
"""A length below so many of its standard deviations is what noise alone makes in 19 of 20 cases (chi, 3 degrees)."""

VARIATION = (("vAP", "m"), *((f"vAP_{turn}", "rad") for turn in TURNS))
EXCHANGEABILITY = (("E", "m"),)


def variation(visits: PoseVisits) -> list[IsoFigure]:
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
        figures = [_largest_distance("vAP", parts, wanted=VISITS, n=fewest, place=visits.place)]
        figures += _turned_farthest(parts, fewest, visits.place)
        missing = f"{len(parts)} of {DIRECTIONS} directions" if len(parts) < DIRECTIONS else ""
        return [noted(figure, missing) if figure.value is not None else figure for figure in figures]
    return withheld(VARIATION, why, n=fewest, wanted=VISITS, place=visits.place)


def exchangeability(pose: str, robots: Sequence[PoseVisits]) -> list[IsoFigure]:
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
        figure = _largest_distance("E", robots, wanted=ROBOTS, n=len(robots), place=pose)
        return [noted(figure, f"{visits} of {VISITS} visits" if visits < VISITS else "")]
    return withheld(EXCHANGEABILITY, why, n=len(robots), wanted=ROBOTS, place=pose)


def _largest_distance(symbol: str, parts: Sequence[PoseVisits], *, wanted: int, n: int, place: str) -> IsoFigure:
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


def _turned_farthest(parts: Sequence[PoseVisits], n: int, place: str) -> list[IsoFigure]:
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
