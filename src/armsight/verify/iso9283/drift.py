"""Whether visits of a pose drift: a test of their order, what it costs the other figures, and dAP, dRP (ISO 9283:1998,
7.2.4) from the first visits to the last; and how the arm arrives."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import sqrt

import numpy as np

from armsight.arrays import Array
from armsight.units import MM
from armsight.verify.iso9283.figure import (
    SIGMAS,
    Estimate,
    IsoFigure,
    magnitude,
    noted,
    radial_repeatability,
    too_few,
    withheld,
)
from armsight.verify.iso9283.observations import ArrivalTest, PoseVisits, random_part, stamps_fault
from armsight.verify.iso9283.pose import barycentre_covariance, figure_of

GROUP = 10
"""Visits at the beginning, and as many at the end, between which dAP and dRP are taken."""
MIN_VISITS = 20
"""Visits below which their order tells nothing: even a straight line has no larger ratio than chance may make."""
CHANCE = 4.5
"""Deviations of the largest of three ratios above which the visits follow each other: chance makes it in 1 of 100,000
poses."""
FLAT = 1e-9
"""Share of the largest variance below which a direction counts as one in which nothing scatters."""

DRIFTS = (("dAP", "m"), ("dRP", "m"))
DRIFTING = "the visits drift by"
"""How what is told of a trend begins."""


@dataclass(frozen=True, slots=True)
class Trend:
    """What visits that follow each other do: way of their place from the first to the last, and RP between neighbours.

    moved_m: distance of the means of the first and the last tenth, of three visits at least. neighbours_m: RP of the
    differences of visits that follow each other, in which a slow drift is not.
    """

    moved_m: float
    neighbours_m: float

    def told(self) -> str:
        """Return what to know of a figure of such visits."""
        return (
            f"{DRIFTING} {self.moved_m / MM:.3g} mm from first to last, without which RP is "
            f"{self.neighbours_m / MM:.3g} mm; no deviation is given: the visits are not independent"
        )


def trend(visits: PoseVisits) -> Trend | None:
    """Return the trend of visits in the order of their numbers; None where chance explains how they follow.

    By von Neumann's ratio of the squares of successive differences to the variance, which is 2 for independent visits
    (von Neumann 1941), in each direction in which they scatter.
    """
    n = len(visits)
    if n < MIN_VISITS:
        return None
    xyz = visits.xyz_m[np.argsort(visits.visit)]
    residuals = xyz - xyz.mean(axis=0)
    size, axes = np.linalg.eigh(residuals.T @ residuals)
    z = (residuals @ axes)[:, size > FLAT * max(size[-1], np.finfo(float).tiny)]
    if not z.shape[1]:
        return None
    ratio = (np.diff(z, axis=0) ** 2).sum(axis=0) / (z**2).sum(axis=0)
    if (1.0 - 0.5 * ratio.min()) / sqrt((n - 2) / (n**2 - 1)) < CHANCE:
        return None
    few = max(n // 10, 3)
    moved = float(np.linalg.norm(xyz[-few:].mean(axis=0) - xyz[:few].mean(axis=0)))
    steps = np.diff(xyz, axis=0) / sqrt(2.0)
    return Trend(moved_m=moved, neighbours_m=radial_repeatability(steps - steps.mean(axis=0), None).value)


def told_of_trend(figures: Sequence[IsoFigure], visits: Sequence[PoseVisits]) -> list[IsoFigure]:
    """Return figures of these visits, without deviations and with the reason where the visits drift."""
    found = [one for one in map(trend, visits) if one is not None]
    if not found:
        return list(figures)
    worst = max(found, key=lambda one: one.moved_m)
    return [
        figure if figure.value is None else noted(replace(figure, std=None, corrected_std=None), worst.told())
        for figure in figures
    ]


def drift_figures(visits: PoseVisits) -> list[IsoFigure]:
    """Return dAP and dRP of one robot at one pose: how AP and RP of the last visits differ from those of the first.

    What the measurement errs alike in all visits cancels. n counts the visits.
    """
    n, place = len(visits), visits.place
    if n < 2 * GROUP:
        return withheld(DRIFTS, too_few("visits", n, 2 * GROUP, 2 * GROUP), n=n, wanted=2 * GROUP, place=place)
    if len(visits.directions) > 1:
        why = f"approached from {len(visits.directions)} directions; a drift is of visits from one"
        return withheld(DRIFTS, why, n=n, wanted=2 * GROUP, place=place)
    order = np.argsort(visits.visit)
    first, last = visits.take(order[:GROUP]), visits.take(order[-GROUP:])
    return [_accuracy(first, last, n), _repeatability(first, last, n)]


def _accuracy(first: PoseVisits, last: PoseVisits, n: int) -> IsoFigure:
    if first.commanded_xyz_m is None or not first.in_measuring_frame:
        why = "no commanded pose is known in the measuring frame"
        return withheld(DRIFTS[:1], why, n=n, wanted=2 * GROUP, place=first.place)[0]
    ends = [
        magnitude(one.xyz_m.mean(axis=0) - one.commanded_xyz_m, barycentre_covariance(one)) for one in (first, last)
    ]
    return _difference("dAP", ends, n, first.place)


def _repeatability(first: PoseVisits, last: PoseVisits, n: int) -> IsoFigure:
    ends = [radial_repeatability(one.xyz_m - one.xyz_m.mean(axis=0), None) for one in (first, last)]
    return _difference("dRP", ends, n, first.place)


def _difference(symbol: str, ends: Sequence[Estimate], n: int, place: str) -> IsoFigure:
    """Return the size of the difference of two estimates that are independent."""
    first, last = ends
    estimate = Estimate(value=abs(last.value - first.value), std=sqrt(first.std**2 + last.std**2))
    note = f"from the first {GROUP} visits to the last"
    return figure_of(symbol, "m", estimate, n=n, wanted=2 * GROUP, place=place, note=note)


# Arrival at a pose: stabilisation time t and overshoot OV (ISO 9283:1998, 7.4 and 7.5).

ARRIVALS = 3
"""Arrivals that the standard asks for."""
MIN_ARRIVALS = 2
"""Arrivals below which there is no standard deviation."""
REST = 0.2
"""Share of a trace at its end over which the arm must be at rest; the mean there is the attained position."""
MIN_SAMPLES = 10
"""Samples of a trace below which it says neither when the band was entered nor where the arm came to rest."""

FIGURES = (("t", "s"), ("OV", "m"))
NO_BAND = "the limit band is not known: neither was it told, nor is there a pose repeatability of this pose"


def arrival_figures(test: ArrivalTest) -> list[IsoFigure]:
    """Return t, the mean of the arrivals, and OV, their largest; withheld where a trace does not carry them.

    t runs from the first entry into the limit band until the arm stays in it, both interpolated between samples. Its
    standard deviation takes each of the two instants as uncertain by a sampling interval, evenly.
    """
    n = len(test.traces)
    why, band_m = _no_arrival(test), test.band_m
    if why is not None or band_m is None:
        why = why or NO_BAND
        return withheld(FIGURES, why, n=n, wanted=ARRIVALS, place=test.pose)
    found = []
    for number, trace in enumerate(test.traces, start=1):
        answer = _arrival(trace.xyz_m, np.asarray(trace.t_s), band_m)
        if isinstance(answer, str):
            why = f"arrival {number}: {answer}"
            return withheld(FIGURES, why, n=n, wanted=ARRIVALS, place=test.pose)
        found.append(answer)
    times, overshoots = np.array(found).T
    interval = max(float(np.median(np.diff(np.asarray(trace.t_s)))) for trace in test.traces)
    std = sqrt((float(times.var(ddof=1)) + interval**2 / 6.0) / n)
    noise = _noise_m(test) if overshoots.max() > 0.0 else 0.0
    over_std = sqrt(float(overshoots.var(ddof=1)) + noise**2)
    note = "" if test.covariance_m2 is not None else "the measurement's covariance was not given"
    return [
        figure_of("t", "s", Estimate(value=float(times.mean()), std=std), n=n, wanted=ARRIVALS, place=test.pose),
        figure_of(
            "OV",
            "m",
            Estimate(value=float(overshoots.max()), std=over_std),
            n=n,
            wanted=ARRIVALS,
            place=test.pose,
            note=note,
        ),
    ]


def _no_arrival(test: ArrivalTest) -> str | None:
    fault = stamps_fault(test.stamps, tuple(trace.t_s for trace in test.traces))
    if not test.traces:
        return "no arrivals were given"
    if fault is not None:
        return fault
    if len(test.traces) < MIN_ARRIVALS:
        return too_few("arrivals", len(test.traces), MIN_ARRIVALS, ARRIVALS)
    noise = _noise_m(test)
    if test.band_m is not None and SIGMAS * noise > test.band_m:
        return (
            f"the limit band of {test.band_m:.3g} m is narrower than {SIGMAS:g} standard deviations of the "
            f"measurement's noise ({noise:.2g} m): noise alone would leave it"
        )
    return None


def _noise_m(test: ArrivalTest) -> float:
    """Return the largest standard deviation in m of one sample in any direction; 0 where none is known."""
    if test.covariance_m2 is None:
        return 0.0
    return sqrt(float(np.linalg.eigvalsh(random_part(test.covariance_m2, test.systematic_m2))[-1]))


def _arrival(xyz: Array, t: Array, band_m: float) -> tuple[float, float] | str:
    """Return the time from the first entry into the band to the last in s, and the furthest out in between in m (0 for
    none), of a trace xyz (m, 3) at t (m,), or why it has none."""
    if len(xyz) < MIN_SAMPLES:
        return f"{len(xyz)} samples; at least {MIN_SAMPLES} are needed"
    end = t >= t[-1] - REST * (t[-1] - t[0])
    distance = np.linalg.norm(xyz - xyz[end].mean(axis=0), axis=1)  # (m,)
    outside = distance > band_m
    if outside[end].any():
        return (
            f"the arm does not rest: it leaves the band of {band_m:.3g} m in the last {100 * REST:.0f} % of the trace"
        )
    if not outside[0]:
        return "the trace begins inside the limit band: the first entry was not seen"
    entries = np.flatnonzero(outside[:-1] & ~outside[1:])
    share = (distance[entries] - band_m) / (distance[entries] - distance[entries + 1])
    instants = t[entries] + share * (t[entries + 1] - t[entries])
    after = slice(int(entries[0]) + 1, None)
    beyond = distance[after][outside[after]]
    return float(instants[-1] - instants[0]), float(beyond.max(initial=0.0))
