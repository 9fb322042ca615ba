"""Velocity along a path: accuracy AV, repeatability RV, fluctuation FV (ISO 9283:1998, 8.6)."""

from __future__ import annotations

from math import sqrt

import numpy as np
from numpy.typing import NDArray

from armsight.verify.iso9283.figure import Figure, noted, too_few, withheld
from armsight.verify.iso9283.observations import PathRun, PathTest, random_part, stamps_fault
from armsight.verify.iso9283.pose import MIN_ACCURACY, MIN_REPEATABILITY, figure_of
from armsight.verify.iso9283.spread import Estimate, three_sigma

Array = NDArray[np.float64]

RUNS = 10
"""Runs that the standard asks for."""
MIDDLE = 0.5
"""Share of the path, in its middle, over which velocity is taken: the ends are for speeding up and slowing down."""
MIN_SAMPLES = 10
"""Samples on that part below which a run says nothing of fluctuation."""
CHORD = 25
"""The path's direction at a sample is taken over a chord of a 25th of the run to either side: long beside the noise."""

FIGURES = (("AV", "1"), ("RV", "1"), ("FV", "m/s"))


def velocity_figures(test: PathTest) -> list[Figure]:
    """Return AV and RV as shares of the commanded speed, and FV in m/s.

    A speed is the central difference of the position along the path's direction, so that noise across the path, which
    would make every chord longer, does not raise it.
    """
    n = len(test.runs)
    why = _no_velocity(test)
    if why is not None:
        return withheld(FIGURES, why, n=n, wanted=RUNS, place=test.name)
    speeds = [speeds_m_s(run) for run in test.runs]
    few = [i for i, speed in enumerate(speeds, start=1) if len(speed) < MIN_SAMPLES]
    if few:
        why = f"run {few[0]} has {len(speeds[few[0] - 1])} samples on the middle of the path; {MIN_SAMPLES} are needed"
        return withheld(FIGURES, why, n=n, wanted=RUNS, place=test.name)
    means = np.array([speed.mean() for speed in speeds])  # (n,)
    ranges = np.array([np.ptp(speed) for speed in speeds])
    estimate = Estimate(value=float(ranges.max()), std=float(ranges.std(ddof=1)))
    fluctuation = figure_of("FV", "m/s", estimate, n=n, wanted=RUNS, place=test.name)
    fluctuation = noted(fluctuation, _noise_note(test, min(len(speed) for speed in speeds)))
    return [*_against_command(test, means), fluctuation]


def speeds_m_s(run: PathRun) -> Array:
    """Return the speeds (k,) in m/s at the samples on the middle of a run that has times; empty for too few samples."""
    xyz, t = run.xyz_m, run.t_s
    if t is None or len(xyz) < MIN_SAMPLES:
        return np.empty(0)
    width = max(len(xyz) // CHORD, 1)
    rows = np.arange(len(xyz))
    chord = xyz[np.minimum(rows + width, len(xyz) - 1)] - xyz[np.maximum(rows - width, 0)]
    length = np.linalg.norm(chord, axis=1)
    unit = chord / np.maximum(length, np.finfo(float).tiny)[:, None]  # (m, 3)
    step = np.einsum("ij,ij->i", np.diff(xyz, axis=0), 0.5 * (unit[1:] + unit[:-1]))
    at = np.concatenate([[0.0], np.cumsum(step)])  # (m,) distance gone along the path
    edge = 0.5 * (1.0 - MIDDLE) * at[-1]
    inner = rows[1:-1]
    inner = inner[(at[inner] >= edge) & (at[inner] <= at[-1] - edge)]
    forward = np.einsum("ij,ij->i", xyz[inner + 1] - xyz[inner - 1], unit[inner])
    turn = np.linalg.norm(unit[inner + 1] - unit[inner - 1], axis=1)  # rad, over the two steps
    arc = forward * (1.0 + turn**2 / 24.0)  # a chord's arc, to second order: 0.3 % on a circle of 12 mm at 0.1 m/s
    return np.asarray(arc / (t[inner + 1] - t[inner - 1]))


def _no_velocity(test: PathTest) -> str | None:
    if not test.runs:
        return "no runs were given"
    fault = stamps_fault(test.stamps, tuple(run.t_s for run in test.runs))
    if fault is not None:
        return fault
    if test.commanded is not None and len(test.commanded.corners):
        return "the path has corners, before which arms slow down: velocity is judged on a path without"
    if len(test.runs) < MIN_ACCURACY:
        return too_few("runs", len(test.runs), MIN_ACCURACY, RUNS)
    return None


def _against_command(test: PathTest, means: Array) -> list[Figure]:
    """Return AV and RV of the runs' mean speeds (n,)."""
    n = len(means)
    commanded = None if test.commanded is None else test.commanded.speed_m_s
    if commanded is None:
        return withheld(FIGURES[:2], "no commanded speed is known", n=n, wanted=RUNS, place=test.name)
    value = float(means.mean()) / commanded - 1.0
    std = float(means.std(ddof=1)) / sqrt(n) / commanded
    estimate = Estimate(value=value, std=std, corrected=value, corrected_std=std)
    accuracy = figure_of("AV", "1", estimate, n=n, wanted=RUNS, place=test.name)
    if n < MIN_REPEATABILITY:
        why = too_few("runs", n, MIN_REPEATABILITY, RUNS)
        return [accuracy, *withheld(FIGURES[1:2], why, n=n, wanted=RUNS, place=test.name)]
    estimate = three_sigma(means / commanded, None)
    return [accuracy, figure_of("RV", "1", estimate, n=n, wanted=RUNS, place=test.name)]


def _noise_note(test: PathTest, samples: int) -> str:
    """Return what fluctuation the measurement's noise alone makes in so many samples."""
    if test.covariance_m2 is None:
        return "the measurement's covariance was not given: its noise is in the value"
    sigma = sqrt(float(np.trace(random_part(test.covariance_m2, test.systematic_m2))) / 3.0)
    interval = min(float(np.median(np.diff(run.t_s))) for run in test.runs if run.t_s is not None)
    noise = 2.0 * sqrt(2.0 * np.log(samples)) * sigma / (sqrt(2.0) * interval)
    return f"the measurement's noise alone makes up to {noise:.2g} m/s"
