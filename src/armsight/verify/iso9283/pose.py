"""Accuracy and repeatability at one commanded pose: AP and RP (ISO 9283:1998, 7.2.1 and 7.2.2)."""

from __future__ import annotations

from math import sqrt

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from armsight.verify.iso9283.figure import Figure, too_few, withheld
from armsight.verify.iso9283.observations import PoseVisits
from armsight.verify.iso9283.spread import Estimate, magnitude, radial_repeatability, three_sigma

Array = NDArray[np.float64]

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


def pose_figures(visits: PoseVisits) -> list[Figure]:
    """Return AP, AP_x .. AP_c, RP, RP_a .. RP_c of one robot at one pose, each given or withheld with the reason.

    a, b, c are turns about x, y, z of the measuring frame: components of the rotation vector from the commanded, or
    from the mean, orientation. For small turns they are the differences of the standard's angles, without the places
    at which those have no value.
    """
    return [*_accuracy(visits), *_repeatability(visits)]


def barycentre_covariance(visits: PoseVisits) -> Array:
    """Return the covariance (3, 3) of the mean position of n >= 2 visits, without the systematic part."""
    return np.cov(visits.xyz_m, rowvar=False) / len(visits)


def turns_from(rotation: Rotation, reference: Rotation) -> Array:
    """Return the rotation vectors (..., 3), in the measuring frame's axes, that carry the reference there."""
    return np.asarray((rotation * reference.inv()).as_rotvec())


def figure_of(symbol: str, unit: str, estimate: Estimate, *, n: int, wanted: int, place: str, note: str = "") -> Figure:
    """Return a given figure."""
    return Figure(
        symbol=symbol,
        unit=unit,
        n=n,
        wanted=wanted,
        place=place,
        value=estimate.value,
        std=estimate.std,
        corrected=estimate.corrected,
        corrected_std=estimate.corrected_std,
        note=note,
    )


def _accuracy(visits: PoseVisits) -> list[Figure]:
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


def _signed(symbol: str, unit: str, value: float, variance: float, visits: PoseVisits, note: str) -> Figure:
    """Return a component, of which noise makes no more on average: corrected is the value itself."""
    std = sqrt(max(variance, 0.0))
    estimate = Estimate(value=value, std=std, corrected=value, corrected_std=std)
    return figure_of(symbol, unit, estimate, n=len(visits), wanted=VISITS, place=visits.place, note=note)


def _repeatability(visits: PoseVisits) -> list[Figure]:
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
