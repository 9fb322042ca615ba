"""All figures of ISO 9283:1998 that a test's data carry, and for the others the reason why not."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from armsight.errors import Inconsistent
from armsight.verify.iso9283 import arrival, corner, distance, groups, path, pose, velocity
from armsight.verify.iso9283.figure import Figure, Figures, withheld
from armsight.verify.iso9283.observations import ArrivalTest, PathTest, PoseVisits

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


def _all(test: Iso9283Test) -> Iterator[Figure]:
    if not test.poses:
        outer = [(f"{kind}{tail}", unit) for kind in ("AD", "RD") for tail, unit in distance.OUTER]
        symbols = (
            *pose.ACCURACY,
            *pose.ACCURACY_ROTATION,
            *pose.REPEATABILITY,
            *pose.REPEATABILITY_ROTATION,
            *groups.VARIATION,
            *outer,
        )
        yield from withheld(symbols, "no visits of a commanded pose were given", n=0, wanted=pose.VISITS)
        yield from withheld(groups.EXCHANGEABILITY, "no visits were given", n=0, wanted=groups.ROBOTS)
    for visits in test.poses:
        yield from pose.pose_figures(visits)
    for visits in test.poses:
        yield from groups.variation(visits)
    yield from _distances(test)
    yield from _arrivals(test)
    yield from _exchanged(test)
    yield from _paths(test)


def _distances(test: Iso9283Test) -> Iterator[Figure]:
    """Yield AD and RD of each robot."""
    for robot in dict.fromkeys(visits.robot for visits in test.poses):
        own = {visits.pose: visits for visits in test.poses if visits.robot == robot}
        pair = test.distance or (DIAGONAL if set(DIAGONAL) <= set(own) else _farthest(own))
        if pair is None or not set(pair) <= set(own):
            names = [(f"{kind}{tail}", unit) for kind in ("AD", "RD") for tail, unit in distance.OUTER]
            yield from withheld(names, "two commanded poses are needed", n=0, wanted=pose.VISITS, place=robot)
        else:
            yield from distance.distance_figures(own[pair[0]], own[pair[1]])


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


def _exchanged(test: Iso9283Test) -> Iterator[Figure]:
    """Yield E of each pose that several robots visited; withheld once where there is none."""
    names = dict.fromkeys(visits.pose for visits in test.poses)
    robots = {name: [visits for visits in test.poses if visits.pose == name] for name in names}
    shared = [name for name in names if len(robots[name]) > 1] or list(names)[:1]
    for name in shared:
        yield from groups.exchangeability(name, robots[name])


def _arrivals(test: Iso9283Test) -> Iterator[Figure]:
    if not test.arrivals:
        yield from withheld(arrival.FIGURES, "no arrivals were given", n=0, wanted=arrival.ARRIVALS)
    for trace in test.arrivals:
        yield from arrival.arrival_figures(trace)


def _paths(test: Iso9283Test) -> Iterator[Figure]:
    if not test.paths:
        why = "no runs along a path were given"
        yield from withheld((*path.ACCURACY, *path.REPEATABILITY), why, n=0, wanted=path.RUNS)
        yield from withheld(corner.FIGURES, why, n=0, wanted=corner.RUNS)
        yield from withheld(velocity.FIGURES, why, n=0, wanted=velocity.RUNS)
    for runs in test.paths:
        yield from path.path_figures(runs)
        yield from corner.corner_figures(runs)
        yield from velocity.velocity_figures(runs)
