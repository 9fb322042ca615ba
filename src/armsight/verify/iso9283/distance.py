"""Accuracy and repeatability of the distance between two commanded poses: AD and RD (ISO 9283:1998, 7.3)."""

from __future__ import annotations

from dataclasses import dataclass
from math import sqrt

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from armsight.verify.iso9283.figure import Figure, noted, too_few, withheld
from armsight.verify.iso9283.observations import PoseVisits
from armsight.verify.iso9283.pose import (
    AXES,
    MIN_ACCURACY,
    MIN_REPEATABILITY,
    NOISE_UNKNOWN,
    TURNS,
    VISITS,
    figure_of,
    turns_from,
)
from armsight.verify.iso9283.spread import Estimate, three_sigma

Array = NDArray[np.float64]

OUTER = (("", "m"), *((f"_{axis}", "m") for axis in AXES), *((f"_{turn}", "rad") for turn in TURNS))
"""What follows AD and RD, with the unit."""

NO_TURNS = "no orientations were measured"


@dataclass(frozen=True, slots=True, kw_only=True)
class _Axis:
    """One direction in which a distance is taken: what follows AD, the unit, the measurement's variances in it."""

    tail: str
    unit: str
    systematic: float | None
    random: float | None


def distance_figures(one: PoseVisits, other: PoseVisits) -> list[Figure]:
    """Return AD, AD_x .. AD_c, RD, RD_x .. RD_c of the distance between two poses, cycle by cycle.

    AD needs no common frame with the command, since a distance is the same in every frame; its components do. The
    standard deviation takes the two poses' systematic parts as independent: where they share a cause it is too large.
    """
    place = f"{one.place}-{other.pose}"
    cycles = np.intersect1d(one.visit, other.visit)
    n = len(cycles)
    if n < MIN_ACCURACY:
        why = too_few(f"cycles with both {one.pose} and {other.pose}", n, MIN_ACCURACY, VISITS)
        names = [(f"{kind}{tail}", unit) for kind in ("AD", "RD") for tail, unit in OUTER]
        return withheld(names, why, n=n, wanted=VISITS, place=place)
    a, b = (
        visits.take(np.array([int(np.flatnonzero(visits.visit == cycle)[0]) for cycle in cycles]))
        for visits in (one, other)
    )
    directions = max(len(a.directions), len(b.directions))
    mixed = f"visited from {directions} directions; RD is of visits from one" if directions > 1 else None
    pairs = [*_position(a, b, place, mixed), *_rotation(a, b, place, mixed)]
    note = "" if a.covariance is not None and b.covariance is not None else NOISE_UNKNOWN
    figures = [pair[0] for pair in pairs] + [pair[1] for pair in pairs]
    return [noted(figure, note) if figure.value is not None else figure for figure in figures]


def _position(a: PoseVisits, b: PoseVisits, place: str, mixed: str | None) -> list[tuple[Figure, Figure]]:
    """Return AD and RD of the distance and of its components."""
    step = a.xyz_m - b.xyz_m  # (n, 3)
    mean = step.mean(axis=0)
    along = mean / max(float(np.linalg.norm(mean)), np.finfo(float).tiny)
    command = None
    if a.commanded_xyz_m is not None and b.commanded_xyz_m is not None:
        command = a.commanded_xyz_m - b.commanded_xyz_m
    length = None if command is None else float(np.linalg.norm(command))
    found = np.linalg.norm(step, axis=1)
    axis = _axis(a, b, "", "m", np.append(along, np.zeros(3)))
    pairs = [_pair(axis, found, length, "no commanded poses are known", place, mixed)]
    why = _no_component(a, b, command is not None, "poses")
    for i, name in enumerate(AXES):
        axis = _axis(a, b, f"_{name}", "m", np.eye(6)[i])
        wanted = None if why or command is None else float(abs(command[i]))
        pairs.append(_pair(axis, np.abs(step[:, i]), wanted, why, place, mixed))
    return pairs


def _rotation(a: PoseVisits, b: PoseVisits, place: str, mixed: str | None) -> list[tuple[Figure, Figure]]:
    """Return AD and RD of the turn between the two poses, by component."""
    one, other = a.rotation, b.rotation
    if one is None or other is None:
        lists = [
            withheld([(f"{kind}_{turn}", "rad") for turn in TURNS], NO_TURNS, n=len(a), wanted=VISITS, place=place)
            for kind in ("AD", "RD")
        ]
        return list(zip(*lists, strict=True))
    turn = np.abs(turns_from(one, other))  # (n, 3)
    command = None
    if a.commanded_quat_xyzw is not None and b.commanded_quat_xyzw is not None:
        first, second = Rotation.from_quat(a.commanded_quat_xyzw), Rotation.from_quat(b.commanded_quat_xyzw)
        command = np.abs(turns_from(first, second))
    why = _no_component(a, b, command is not None, "orientations")
    pairs = []
    for i, name in enumerate(TURNS):
        axis = _axis(a, b, f"_{name}", "rad", np.eye(6)[3 + i])
        wanted = None if why or command is None else float(command[i])
        pairs.append(_pair(axis, turn[:, i], wanted, why, place, mixed))
    return pairs


def _pair(
    axis: _Axis, found: Array, wanted: float | None, why: str, place: str, mixed: str | None
) -> tuple[Figure, Figure]:
    """Return AD and RD of distances found (n,); why: the reason where wanted, the commanded one, is not known."""
    n = len(found)
    if wanted is None:
        accuracy = withheld([(f"AD{axis.tail}", axis.unit)], why, n=n, wanted=VISITS, place=place)[0]
    else:
        value = float(found.mean()) - wanted
        std = sqrt(float(found.var(ddof=1)) / n + (axis.systematic or 0.0))
        estimate = Estimate(value=value, std=std, corrected=value, corrected_std=std)
        accuracy = figure_of(f"AD{axis.tail}", axis.unit, estimate, n=n, wanted=VISITS, place=place)
    symbol = f"RD{axis.tail}"
    few = too_few("cycles", n, MIN_REPEATABILITY, VISITS) if n < MIN_REPEATABILITY else None
    if mixed or few:
        return accuracy, withheld([(symbol, axis.unit)], mixed or few or "", n=n, wanted=VISITS, place=place)[0]
    estimate = three_sigma(found, axis.random)
    return accuracy, figure_of(symbol, axis.unit, estimate, n=n, wanted=VISITS, place=place)


def _no_component(a: PoseVisits, b: PoseVisits, known: bool, what: str) -> str:
    """Return why a component has no commanded value; empty where it has one."""
    if not known:
        return f"no commanded {what} are known"
    if not (a.in_measuring_frame and b.in_measuring_frame):
        return "the commanded poses are not known in the measuring frame"
    return ""


def _axis(a: PoseVisits, b: PoseVisits, tail: str, unit: str, u: Array) -> _Axis:
    """Return the axis along u (6,) with the variances of a difference of two measurements in it."""
    systematic, random = (_variance(u, (getattr(a, name), getattr(b, name))) for name in ("systematic", "random"))
    return _Axis(tail=tail, unit=unit, systematic=systematic, random=random)


def _variance(u: Array, covariances: tuple[Array | None, Array | None]) -> float | None:
    one, other = covariances
    if one is None or other is None:
        return None
    return float(u[: len(one)] @ one @ u[: len(one)] + u[: len(other)] @ other @ u[: len(other)])
