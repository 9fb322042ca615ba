"""Path accuracy and repeatability: AT and RT (ISO 9283:1998, 8.2 and 8.3)."""

from __future__ import annotations

from math import sqrt

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from armsight.verify.iso9283.crossings import Crossings, Planes, cross, planes_of, planes_of_run
from armsight.verify.iso9283.figure import Figure, too_few, withheld
from armsight.verify.iso9283.observations import PathTest
from armsight.verify.iso9283.pose import MIN_ACCURACY, MIN_REPEATABILITY, TURNS, figure_of, turns_from
from armsight.verify.iso9283.spread import SIGMAS, Estimate, deviation_std, magnitude, radial_repeatability

Array = NDArray[np.float64]

RUNS = 10
"""Runs that the standard asks for along every path."""
LEAST_CROSSED = 0.9
"""Share of the planes that every run must cross: below it the runs are not of one path."""

ACCURACY = (("AT", "m"), *((f"AT_{turn}", "rad") for turn in TURNS))
REPEATABILITY = (("RT", "m"), *((f"RT_{turn}", "rad") for turn in TURNS))


def path_figures(test: PathTest) -> list[Figure]:
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


def _accuracy(test: PathTest, planes: Planes, crossings: Crossings, kept: NDArray[np.intp]) -> list[Figure]:
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


def _repeatability(test: PathTest, crossings: Crossings, kept: NDArray[np.intp], own: bool) -> list[Figure]:
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
