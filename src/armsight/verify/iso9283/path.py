"""Figures along paths (ISO 9283:1998, 8): accuracy, repeatability, velocity, corners."""

from __future__ import annotations

from math import sqrt

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from armsight.arrays import Array
from armsight.verify.iso9283.figure import (
    SIGMAS,
    Estimate,
    IsoFigure,
    deviation_std,
    magnitude,
    noted,
    radial_repeatability,
    three_sigma,
    too_few,
    withheld,
)
from armsight.verify.iso9283.observations import (
    CommandedPath,
    Crossings,
    PathRun,
    PathTest,
    Planes,
    cross,
    planes_of,
    planes_of_run,
    random_part,
    stamps_fault,
)
from armsight.verify.iso9283.pose import MIN_ACCURACY, MIN_REPEATABILITY, TURNS, figure_of, turns_from

RUNS = 10
"""Runs that the standard asks for along every path."""
LEAST_CROSSED = 0.9
"""Share of the planes that every run must cross: below it the runs are not of one path."""

ACCURACY = (("AT", "m"), *((f"AT_{turn}", "rad") for turn in TURNS))
REPEATABILITY = (("RT", "m"), *((f"RT_{turn}", "rad") for turn in TURNS))


def path_figures(test: PathTest) -> list[IsoFigure]:
    """Return AT, AT_a .. AT_c, RT, RT_a .. RT_c: each the largest over planes square to the path.

    The largest of many planes is found where chance helped as well: of few runs it is on average too large, and its
    standard deviation is that of the one plane. Nothing is taken out.
    """
    n = len(test.runs)
    given = test.commanded if test.in_measuring_frame else None
    why = _no_accuracy(test)
    if not n:
        return withheld((*ACCURACY, *REPEATABILITY), "no runs were given", n=0, wanted=RUNS, place=test.name)
    planes = planes_of(given) if given is not None else planes_of_run(test.runs[0])
    if planes is None:
        few = f"run 1 has {len(test.runs[0].xyz_m)} samples that make no path"
        return withheld((*ACCURACY, *REPEATABILITY), few, n=n, wanted=RUNS, place=test.name)
    crossings = cross(planes, test.runs)
    crossed = np.asarray(np.isfinite(crossings.xyz_m[..., 0]).all(axis=0))  # (planes,)
    if crossed.mean() < LEAST_CROSSED:
        missing = np.isnan(crossings.xyz_m[..., 0]).sum(axis=1)
        text = (
            f"run {int(missing.argmax()) + 1} does not cross {int(missing.max())} of {len(crossed)} planes of the path"
        )
        return withheld((*ACCURACY, *REPEATABILITY), text, n=n, wanted=RUNS, place=test.name)
    kept = np.flatnonzero(crossed)
    figures = (
        withheld(ACCURACY, why, n=n, wanted=RUNS, place=test.name)
        if why is not None
        else _accuracy(test, planes, crossings, kept)
    )
    if n < MIN_REPEATABILITY:
        few = too_few("runs", n, MIN_REPEATABILITY, RUNS)
        return [*figures, *withheld(REPEATABILITY, few, n=n, wanted=RUNS, place=test.name)]
    return [*figures, *_repeatability(test, crossings, kept, given is None)]


def _no_accuracy(test: PathTest) -> str | None:
    if test.commanded is None:
        return "no commanded path is known"
    if not test.in_measuring_frame:
        return "the commanded path is not known in the measuring frame"
    if len(test.runs) < MIN_ACCURACY:
        return too_few("runs", len(test.runs), MIN_ACCURACY, RUNS)
    return None


def _accuracy(test: PathTest, planes: Planes, crossings: Crossings, kept: NDArray[np.intp]) -> list[IsoFigure]:
    """Return AT: the largest distance of the mean attained path from the command, and its turns."""
    n = len(test.runs)
    systematic = np.zeros((3, 3)) if test.systematic_m2 is None else test.systematic_m2
    estimates = [
        magnitude(
            crossings.xyz_m[:, i].mean(axis=0) - planes.xyz_m[i],
            np.cov(crossings.xyz_m[:, i], rowvar=False) / n + systematic,
        )
        for i in kept
    ]
    worst = max(estimates, key=lambda estimate: estimate.value)
    estimate = Estimate(value=worst.value, std=worst.std)
    figures = [figure_of("AT", "m", estimate, n=n, wanted=RUNS, place=test.name)]
    if crossings.rotations is None or planes.rotation is None:
        why = "no orientations were measured" if crossings.rotations is None else "no commanded orientations are known"
        return [*figures, *withheld(ACCURACY[1:], why, n=n, wanted=RUNS, place=test.name)]
    turns, scatter = _turns(crossings.rotations, kept, planes.rotation)
    for axis, (symbol, unit) in enumerate(ACCURACY[1:]):
        i = int(np.abs(turns[:, axis]).argmax())
        estimate = Estimate(value=float(abs(turns[i, axis])), std=float(scatter[i, axis]) / sqrt(n))
        figures.append(figure_of(symbol, unit, estimate, n=n, wanted=RUNS, place=test.name))
    return figures


def _repeatability(test: PathTest, crossings: Crossings, kept: NDArray[np.intp], own: bool) -> list[IsoFigure]:
    """Return RT: the largest l + 3 S_l over the planes, and 3 S of the turns."""
    n = len(test.runs)
    note = "in planes square to the first run: the commanded path is not known in the measuring frame" if own else ""
    points = crossings.xyz_m[:, kept]  # (n, k, 3)
    residuals = points - points.mean(axis=0)
    estimates = [radial_repeatability(residuals[:, i], None) for i in range(len(kept))]
    worst = max(estimates, key=lambda estimate: estimate.value)
    estimate = Estimate(value=worst.value, std=worst.std)
    figures = [figure_of("RT", "m", estimate, n=n, wanted=RUNS, place=test.name, note=note)]
    if crossings.rotations is None:
        why = "no orientations were measured"
        return [*figures, *withheld(REPEATABILITY[1:], why, n=n, wanted=RUNS, place=test.name)]
    _, scatter = _turns(crossings.rotations, kept, None)
    for axis, (symbol, unit) in enumerate(REPEATABILITY[1:]):
        largest = float(scatter[:, axis].max())
        estimate = Estimate(value=SIGMAS * largest, std=SIGMAS * deviation_std(largest, n))
        figures.append(figure_of(symbol, unit, estimate, n=n, wanted=RUNS, place=test.name, note=note))
    return figures


def _turns(rotations: tuple[Rotation, ...], kept: NDArray[np.intp], commanded: Rotation | None) -> tuple[Array, Array]:
    """Return by plane the mean turn from the command (zero without one) and the runs' scatter, both (k, 3)."""
    quat = np.array([rotation.as_quat() for rotation in rotations])  # (n, planes, 4)
    mean, scatter = np.zeros((len(kept), 3)), np.zeros((len(kept), 3))
    for row, i in enumerate(kept):
        here = Rotation.from_quat(quat[:, i])
        middle = here.mean()
        scatter[row] = turns_from(here, middle).std(axis=0, ddof=1)
        if commanded is not None:
            mean[row] = turns_from(middle, commanded[int(i)])
    return mean, scatter


# Velocity along a path: accuracy AV, repeatability RV, fluctuation FV (ISO 9283:1998, 8.6).

MIDDLE = 0.5
"""Share of the path, in its middle, over which velocity is taken: the ends are for speeding up and slowing down."""
MIN_SAMPLES = 10
"""Samples on that part below which a run says nothing of fluctuation."""
CHORD = 25
"""The path's direction at a sample is taken over a chord of a 25th of the run to either side: long beside the noise."""

VELOCITY_FIGURES = (("AV", "1"), ("RV", "1"), ("FV", "m/s"))


def velocity_figures(test: PathTest) -> list[IsoFigure]:
    """Return AV and RV as shares of the commanded speed, and FV in m/s.

    A speed is the central difference of the position along the path's direction, so that noise across the path, which
    would make every chord longer, does not raise it.
    """
    n = len(test.runs)
    why = _no_velocity(test)
    if why is not None:
        return withheld(VELOCITY_FIGURES, why, n=n, wanted=RUNS, place=test.name)
    speeds = [speeds_m_s(run) for run in test.runs]
    few = [i for i, speed in enumerate(speeds, start=1) if len(speed) < MIN_SAMPLES]
    if few:
        why = f"run {few[0]} has {len(speeds[few[0] - 1])} samples on the middle of the path; {MIN_SAMPLES} are needed"
        return withheld(VELOCITY_FIGURES, why, n=n, wanted=RUNS, place=test.name)
    means = np.array([speed.mean() for speed in speeds])  # (n,)
    ranges = np.array([np.ptp(speed) for speed in speeds])
    estimate = Estimate(value=float(ranges.max()), std=float(ranges.std(ddof=1)))
    fluctuation = figure_of("FV", "m/s", estimate, n=n, wanted=RUNS, place=test.name)
    fluctuation = noted(fluctuation, _fluctuation_note(test, min(len(speed) for speed in speeds)))
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


def _against_command(test: PathTest, means: Array) -> list[IsoFigure]:
    """Return AV and RV of the runs' mean speeds (n,)."""
    n = len(means)
    commanded = None if test.commanded is None else test.commanded.speed_m_s
    if commanded is None:
        return withheld(VELOCITY_FIGURES[:2], "no commanded speed is known", n=n, wanted=RUNS, place=test.name)
    value = float(means.mean()) / commanded - 1.0
    std = float(means.std(ddof=1)) / sqrt(n) / commanded
    estimate = Estimate(value=value, std=std, corrected=value, corrected_std=std)
    accuracy = figure_of("AV", "1", estimate, n=n, wanted=RUNS, place=test.name)
    if n < MIN_REPEATABILITY:
        why = too_few("runs", n, MIN_REPEATABILITY, RUNS)
        return [accuracy, *withheld(VELOCITY_FIGURES[1:2], why, n=n, wanted=RUNS, place=test.name)]
    estimate = three_sigma(means / commanded, None)
    return [accuracy, figure_of("RV", "1", estimate, n=n, wanted=RUNS, place=test.name)]


def _fluctuation_note(test: PathTest, samples: int) -> str:
    """Return what fluctuation the measurement's noise alone makes in so many samples."""
    if test.covariance_m2 is None:
        return "the measurement's covariance was not given: its noise is in the value"
    sigma = sqrt(float(np.trace(random_part(test.covariance_m2, test.systematic_m2))) / 3.0)
    interval = min(float(np.median(np.diff(run.t_s))) for run in test.runs if run.t_s is not None)
    noise = 2.0 * sqrt(2.0 * np.log(samples)) * sigma / (sqrt(2.0) * interval)
    return f"the measurement's noise alone makes up to {noise:.2g} m/s"


# What a corner does to a path: round-off CR and overshoot CO (ISO 9283:1998, 8.5).

CORNER_RUNS = 3
"""Runs that the standard asks for at corners."""
MIN_RUNS = 2
"""Runs below which there is no standard deviation."""
REACH = 0.5
"""Share of the leg behind a corner over which overshoot is looked for."""

CUT = 1.0 / np.sqrt(8.0)
"""How much a line between two samples, one on each leg and as far from it, cuts off a square corner."""
WORTH = 0.2
"""Share of CR from which on that is said."""

CORNER_FIGURES = (("CR", "m"), ("CO", "m"))


def corner_figures(test: PathTest) -> list[IsoFigure]:
    """Return CR and CO at every corner of a commanded path: the largest of the runs.

    CR: the least distance of a run from the corner. CO: the furthest that a run lies beyond the second leg, on the
    side to which the first leg leads. std: of one run's value, from the runs, with the measurement's systematic part.
    """
    n = len(test.runs)
    why = _no_corners(test)
    if why is not None or test.commanded is None:
        return withheld(CORNER_FIGURES, why or "", n=n, wanted=CORNER_RUNS, place=test.name)
    path = test.commanded
    systematic = 0.0 if test.systematic_m2 is None else float(np.linalg.eigvalsh(test.systematic_m2)[-1])
    figures = []
    for number, vertex in enumerate(path.corners, start=1):
        place = f"{test.name} corner {number}"
        found = np.array([_corner(path, int(vertex), run.xyz_m) for run in test.runs])  # (n, 2)
        for column, (symbol, unit) in enumerate(CORNER_FIGURES):
            std = sqrt(float(found[:, column].var(ddof=1)) + systematic)
            estimate = Estimate(value=float(found[:, column].max()), std=std)
            note = _overshoot_note(test, estimate.value) if symbol == "CO" else _sampling_note(test, estimate.value)
            figures.append(figure_of(symbol, unit, estimate, n=n, wanted=CORNER_RUNS, place=place, note=note))
    return figures


def _no_corners(test: PathTest) -> str | None:
    if test.commanded is None:
        return "no commanded path is known"
    if not len(test.commanded.corners):
        return "the commanded path has no corner"
    if not test.in_measuring_frame:
        return "the commanded path is not known in the measuring frame"
    if len(test.runs) < MIN_RUNS:
        return too_few("runs", len(test.runs), MIN_RUNS, CORNER_RUNS)
    short = [i for i, run in enumerate(test.runs, start=1) if len(run.xyz_m) < 2]
    return f"run {short[0]} has fewer than 2 samples" if short else None


def _corner(path: CommandedPath, vertex: int, xyz: Array) -> tuple[float, float]:
    """Return CR and CO of one run xyz (m, 3) at a vertex of the path."""
    corner = path.xyz_m[vertex]
    before, after = path.directions[vertex - 1], path.directions[vertex]
    chord = np.diff(xyz, axis=0)
    squared = np.maximum(np.einsum("ij,ij->i", chord, chord), np.finfo(float).tiny)
    share = np.clip(np.einsum("ij,ij->i", corner - xyz[:-1], chord) / squared, 0.0, 1.0)
    distance = np.linalg.norm(xyz[:-1] + share[:, None] * chord - corner, axis=1)  # from the line, not from samples
    nearest = int(distance.argmin())
    rest = xyz[nearest + 1 :] - corner
    along = rest @ after
    gone = np.flatnonzero(along > REACH * path.lengths[vertex])
    stop = int(gone[0]) if len(gone) else len(rest)
    across = rest[:stop] - along[:stop, None] * after
    beyond = np.where(across @ before > 0.0, np.linalg.norm(across, axis=1), 0.0)
    return float(distance[nearest]), float(beyond.max(initial=0.0))


def _sampling_note(test: PathTest, value: float) -> str:
    """Return a warning where the samples are so far apart that the line between them cuts much of the corner."""
    step = max(float(np.median(np.linalg.norm(np.diff(run.xyz_m, axis=0), axis=1))) for run in test.runs)
    cut = step * CUT
    return (
        f"samples lie {step:.2g} m apart: a square corner looks cut by up to {cut:.2g} m" if cut > WORTH * value else ""
    )


def _overshoot_note(test: PathTest, value: float) -> str:
    """Return a warning where an overshoot is no more than the noise of single samples."""
    if test.covariance_m2 is None:
        return "the measurement's covariance was not given: the noise of single samples is in the value"
    noise = SIGMAS * sqrt(float(np.linalg.eigvalsh(random_part(test.covariance_m2, test.systematic_m2))[-1]))
    return "no more than the noise of single samples" if 0.0 < value < noise else ""
