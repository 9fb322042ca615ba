"""Arrival at a pose: stabilisation time t and overshoot OV (ISO 9283:1998, 7.4 and 7.5)."""

from __future__ import annotations

from dataclasses import dataclass
from math import sqrt

import numpy as np

from armsight.arrays import Array
from armsight.verify.iso9283.figure import SIGMAS, Estimate, Figure, too_few, withheld
from armsight.verify.iso9283.observations import ArrivalTest, random_part, stamps_fault
from armsight.verify.iso9283.pose import figure_of

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


@dataclass(frozen=True, slots=True, kw_only=True)
class _Arrival:
    """One trace: from the first entry into the band to the last, and the furthest out in between (0 for none)."""

    time_s: float
    overshoot_m: float


def arrival_figures(test: ArrivalTest) -> list[Figure]:
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
    times = np.array([arrival.time_s for arrival in found])
    overshoots = np.array([arrival.overshoot_m for arrival in found])
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


def _arrival(xyz: Array, t: Array, band_m: float) -> _Arrival | str:
    """Return time and overshoot of a trace xyz (m, 3) at t (m,), or why it has none."""
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
    return _Arrival(time_s=float(instants[-1] - instants[0]), overshoot_m=float(beyond.max(initial=0.0)))
