"""What a corner does to a path: round-off CR and overshoot CO (ISO 9283:1998, 8.5)."""

from __future__ import annotations

from math import sqrt

import numpy as np
from numpy.typing import NDArray

from armsight.verify.iso9283.figure import Figure, too_few, withheld
from armsight.verify.iso9283.observations import CommandedPath, PathTest, random_part
from armsight.verify.iso9283.pose import figure_of
from armsight.verify.iso9283.spread import SIGMAS, Estimate

Array = NDArray[np.float64]

RUNS = 3
"""Runs that the standard asks for at corners."""
MIN_RUNS = 2
"""Runs below which there is no standard deviation."""
REACH = 0.5
"""Share of the leg behind a corner over which overshoot is looked for."""

CUT = 1.0 / np.sqrt(8.0)
"""How much a line between two samples, one on each leg and as far from it, cuts off a square corner."""
WORTH = 0.2
"""Share of CR from which on that is said."""

FIGURES = (("CR", "m"), ("CO", "m"))


def corner_figures(test: PathTest) -> list[Figure]:
    """Return CR and CO at every corner of a commanded path: the largest of the runs.

    CR: the least distance of a run from the corner. CO: the furthest that a run lies beyond the second leg, on the
    side to which the first leg leads. std: of one run's value, from the runs, with the measurement's systematic part.
    """
    n = len(test.runs)
    why = _no_corners(test)
    if why is not None or test.commanded is None:
        return withheld(FIGURES, why or "", n=n, wanted=RUNS, place=test.name)
    path = test.commanded
    systematic = 0.0 if test.systematic_m2 is None else float(np.linalg.eigvalsh(test.systematic_m2)[-1])
    figures = []
    for number, vertex in enumerate(path.corners, start=1):
        place = f"{test.name} corner {number}"
        found = np.array([_corner(path, int(vertex), run.xyz_m) for run in test.runs])  # (n, 2)
        for column, (symbol, unit) in enumerate(FIGURES):
            std = sqrt(float(found[:, column].var(ddof=1)) + systematic)
            estimate = Estimate(value=float(found[:, column].max()), std=std)
            note = _noise_note(test, estimate.value) if symbol == "CO" else _sampling_note(test, estimate.value)
            figures.append(figure_of(symbol, unit, estimate, n=n, wanted=RUNS, place=place, note=note))
    return figures


def _no_corners(test: PathTest) -> str | None:
    if test.commanded is None:
        return "no commanded path is known"
    if not len(test.commanded.corners):
        return "the commanded path has no corner"
    if not test.in_measuring_frame:
        return "the commanded path is not known in the measuring frame"
    if len(test.runs) < MIN_RUNS:
        return too_few("runs", len(test.runs), MIN_RUNS, RUNS)
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


def _noise_note(test: PathTest, value: float) -> str:
    """Return a warning where an overshoot is no more than the noise of single samples."""
    if test.covariance_m2 is None:
        return "the measurement's covariance was not given: the noise of single samples is in the value"
    noise = SIGMAS * sqrt(float(np.linalg.eigvalsh(random_part(test.covariance_m2, test.systematic_m2))[-1]))
    return "no more than the noise of single samples" if 0.0 < value < noise else ""
