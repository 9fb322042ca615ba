"""Accuracy and repeatability at one commanded pose, AP and RP, and of the distance between two, AD and RD (ISO
9283:1998, 7.2.1, 7.2.2 and 7.3)."""

from __future__ import annotations

from dataclasses import dataclass
from math import sqrt

import numpy as np
from scipy.spatial.transform import Rotation

from armsight.arrays import Array
from armsight.verify.iso9283.figure import (
    Estimate,
    IsoFigure,
    magnitude,
    noted,
    radial_repeatability,
    three_sigma,
    too_few,
    withheld,
)
from armsight.verify.iso9283.observations import PoseVisits

VISITS = 30
"""Visits that the standard asks for at every pose."""
MIN_ACCURACY = 3
"""Visits below which the mean's own standard deviation, of fewer than 2 degrees of freedom, says nothing."""
MIN_REPEATABILITY = 5
"""Visits below which RP is uncertain by more than a quarter of itself (and of 2 visits S_l is zero by construction)."""

AXES = ("x", "y", "z")
TURNS = ("a", "b", "c")
ACCURACY = (("AP", "m"), *((f"AP_{axis}", "m") for axis in AXES))
ACCURACY_ROTATION = tuple((f"AP_{turn}", "rad") for turn in TURNS)
REPEATABILITY = (("RP", "m"),)
REPEATABILITY_ROTATION = tuple((f"RP_{turn}", "rad") for turn in TURNS)

NOISE_UNKNOWN = (
    "the measurement's covariance was not given: its own scatter is in the value, and std knows the visits only"
)
BELOW_NOISE = "the scatter is no larger than the measurement's own: the robot's part cannot be seen"


def pose_figures(visits: PoseVisits) -> list[IsoFigure]:
    """Return AP, AP_x .. AP_c, RP, RP_a .. RP_c of one robot at one pose, each given or withheld with the reason.

    a, b, c are turns about x, y, z of the measuring frame: components of the rotation vector from the commanded, or
    from the mean, orientation. For small turns they are the differences of the standard's angles, without the positions
    at which those have no value.
    """
    return [*_accuracy(visits), *_repeatability(visits)]


def barycentre_covariance(visits: PoseVisits) -> Array:
    """Return the covariance (3, 3) of the mean position of n >= 2 visits, without the systematic part."""
    return np.cov(visits.xyz_m, rowvar=False) / len(visits)


def turns_from(rotation: Rotation, reference: Rotation) -> Array:
    """Return the rotation vectors (..., 3), in the measuring frame's axes, that carry the reference there."""
    return np.asarray((rotation * reference.inv()).as_rotvec())


def figure_of(
    symbol: str, unit: str, estimate: Estimate, *, n: int, wanted: int, place: str, note: str = ""
) -> IsoFigure:
    """Return a given figure."""
    return IsoFigure(
        symbol=symbol,
        unit=unit,
        n=n,
        wanted=wanted,
        place=place,
        value=estimate.value,
        std=estimate.std,
        corrected=estimate.corrected,
        corrected_std=estimate.corrected_std,
        withheld=None,
        note=note,
    )


def _accuracy(visits: PoseVisits) -> list[IsoFigure]:
    """Return AP: the barycentre against the command."""
    n, place = len(visits), visits.place
    why = _no_accuracy(visits)
    if why is not None:
        return withheld((*ACCURACY, *ACCURACY_ROTATION), why, n=n, wanted=VISITS, place=place)
    note = NOISE_UNKNOWN if visits.covariance is None else ""
    if len(visits.directions) > 1:
        note = "; ".join(part for part in (note, f"mean over {len(visits.directions)} approach directions") if part)
    deviation = visits.xyz_m.mean(axis=0) - visits.commanded_xyz_m  # (3,)
    covariance = barycentre_covariance(visits)
    if visits.systematic is not None:
        covariance = covariance + visits.systematic[:3, :3]
    figures = [
        figure_of("AP", "m", magnitude(deviation, covariance), n=n, wanted=VISITS, place=place, note=note),
        *(
            _signed(f"AP_{axis}", "m", float(deviation[i]), float(covariance[i, i]), visits, note)
            for i, axis in enumerate(AXES)
        ),
    ]
    rotation = visits.rotation
    if rotation is None or visits.commanded_quat_xyzw is None:
        what = "no orientations were measured" if rotation is None else "the commanded orientation is not known"
        return [*figures, *withheld(ACCURACY_ROTATION, what, n=n, wanted=VISITS, place=place)]
    mean = rotation.mean()
    turn = turns_from(mean, Rotation.from_quat(visits.commanded_quat_xyzw))  # (3,)
    variance = turns_from(rotation, mean).var(axis=0, ddof=1) / n
    if visits.systematic is not None:
        variance = variance + np.diag(visits.systematic)[3:]
    return [
        *figures,
        *(
            _signed(f"AP_{axis}", "rad", float(turn[i]), float(variance[i]), visits, note)
            for i, axis in enumerate(TURNS)
        ),
    ]


def _no_accuracy(visits: PoseVisits) -> str | None:
    if visits.commanded_xyz_m is None:
        return "no commanded pose is known"
    if not visits.in_measuring_frame:
        return "the commanded pose is not known in the measuring frame; an alignment fitted to these data would hide AP"
    if len(visits) < MIN_ACCURACY:
        return too_few("visits", len(visits), MIN_ACCURACY, VISITS)
    return None


def _signed(symbol: str, unit: str, value: float, variance: float, visits: PoseVisits, note: str) -> IsoFigure:
    """Return a component, of which noise makes no more on average: corrected is the value itself."""
    std = sqrt(max(variance, 0.0))
    estimate = Estimate(value=value, std=std, corrected=value, corrected_std=std)
    return figure_of(symbol, unit, estimate, n=len(visits), wanted=VISITS, place=visits.place, note=note)


def _repeatability(visits: PoseVisits) -> list[IsoFigure]:
    """Return RP: the scatter about the barycentre, of visits from one direction."""
    n, place = len(visits), visits.place
    why = _no_repeatability(visits)
    if why is not None:
        return withheld((*REPEATABILITY, *REPEATABILITY_ROTATION), why, n=n, wanted=VISITS, place=place)
    notes = [NOISE_UNKNOWN] if visits.covariance is None else []
    if visits.approach is None:
        notes.append("the approach directions are not known: RP is of visits from one")
    noise = visits.random
    residuals = visits.xyz_m - visits.xyz_m.mean(axis=0)  # (n, 3)
    estimate = radial_repeatability(residuals, None if noise is None else noise[:3, :3])
    below = [BELOW_NOISE] if estimate.corrected == 0.0 and estimate.value > 0.0 else []
    figures = [figure_of("RP", "m", estimate, n=n, wanted=VISITS, place=place, note="; ".join([*notes, *below]))]
    rotation = visits.rotation
    if rotation is None:
        why = "no orientations were measured"
        return [*figures, *withheld(REPEATABILITY_ROTATION, why, n=n, wanted=VISITS, place=place)]
    turns = turns_from(rotation, rotation.mean())  # (n, 3)
    for i, axis in enumerate(TURNS):
        estimate = three_sigma(turns[:, i], None if noise is None else float(noise[3 + i, 3 + i]))
        below = [BELOW_NOISE] if estimate.corrected == 0.0 and estimate.value > 0.0 else []
        note = "; ".join([*notes, *below])
        figures.append(figure_of(f"RP_{axis}", "rad", estimate, n=n, wanted=VISITS, place=place, note=note))
    return figures


def _no_repeatability(visits: PoseVisits) -> str | None:
    if len(visits.directions) > 1:
        return (
            f"approached from {len(visits.directions)} directions ({', '.join(visits.directions)}); RP is of visits "
            "from one, what directions make is vAP"
        )
    if len(visits) < MIN_REPEATABILITY:
        return too_few("visits", len(visits), MIN_REPEATABILITY, VISITS)
    if (visits.xyz_m == visits.xyz_m[0]).all():
        return "all visits are equal to the last digit: one measurement repeated"
    return None


# Accuracy and repeatability of the distance between two commanded poses: AD and RD (ISO 9283:1998, 7.3).

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


def distance_figures(one: PoseVisits, other: PoseVisits) -> list[IsoFigure]:
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


def _position(a: PoseVisits, b: PoseVisits, place: str, mixed: str | None) -> list[tuple[IsoFigure, IsoFigure]]:
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


def _rotation(a: PoseVisits, b: PoseVisits, place: str, mixed: str | None) -> list[tuple[IsoFigure, IsoFigure]]:
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
) -> tuple[IsoFigure, IsoFigure]:
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
