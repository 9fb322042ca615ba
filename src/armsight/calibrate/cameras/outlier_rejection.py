"""Fit, leave out what does not fit, fit again; and let the data choose how long the distortion polynomial is."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from armsight.calibrate.cameras.bundle_adjustment import (
    Bundle,
    adjust,
    asks_to_be_freed,
    bundle_of,
    residuals_px,
    start_at,
    without,
)
from armsight.calibrate.cameras.observations import Sightings
from armsight.calibrate.cameras.options import BoardOptions
from armsight.calibrate.cameras.preconditions import DOUBTFUL_TILT_DEG, LEAST_POINTS, LEAST_VIEWS, check_tilt
from armsight.errors import NotConverged, NotEnoughData, Undetermined
from armsight.fitting import Fit
from armsight.optics import SIDES
from armsight.records import Progress

Array = NDArray[np.float64]

POINT_LIMIT = 6.0
"""A point further off than this many robust deviations is wrong: 1.5e-8 by chance, and real lenses and boards
scatter less."""
VIEW_LIMIT = 4.0
"""A view that scatters this many times more than the median view moved during the exposure or is no pair."""
MOST_ROUNDS = 5
RAYLEIGH_MEDIAN = 1.1774
"""Median distance of points scattered by one deviation along each axis."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Cleaned:
    """The last fit with what went into it, the views that did not, and notes on images that lost single points."""

    sightings: Sightings
    fit: Fit
    rejected: tuple[tuple[str, str], ...]
    notes: tuple[str, ...]


def fit_cleaned(
    sightings: Sightings, start: Bundle, options: BoardOptions, progress: Progress | None = None
) -> Cleaned:
    """Return the fit of what agrees; raises as the engine does, and NotEnoughData where too few views agree."""
    fixed = fixed_names(options, sightings.n_cameras)
    given, kept = sightings, np.arange(sightings.n_views, dtype=np.intp)
    rejected: list[tuple[str, str]] = []
    fit = adjust(sightings, start, fixed, max_iterations=options.max_iterations, progress=progress)
    for _ in range(MOST_ROUNDS):
        wider = _freed(sightings, fit, fixed, options)
        bad_views, bad_points = _misfits(sightings, fit) if options.reject else ({}, None)
        if wider == fixed and not bad_views and bad_points is None:
            break
        fixed = wider
        state = bundle_of(fit, sightings.n_cameras)
        if bad_points is not None:
            sightings = without(sightings, bad_points)
        if bad_views:
            rejected += [(" / ".join(sightings.sources[g]), why) for g, why in bad_views.items()]
            stay = np.array([g for g in range(sightings.n_views) if g not in bad_views], dtype=np.intp)
            _require_views(len(stay), sightings.n_views, rejected)
            sightings, kept, state = sightings.take(stay), kept[stay], start_at(state, stay)
        fit = adjust(sightings, state, fixed, max_iterations=options.max_iterations, progress=progress)
    notes = _notes(given.take(kept), sightings)
    return Cleaned(sightings=sightings, fit=fit, rejected=tuple(rejected), notes=notes)


def fit_tilted(
    sightings: Sightings, start: Bundle, options: BoardOptions, name: str, progress: Progress | None = None
) -> tuple[Cleaned, list[str]]:
    """Return fit_cleaned with advice on the board's tilt; raises Degenerate where that is what is missing.

    name: of the camera, for the message. Asked before the fit, and again after it: a lens's distortion looks like
    tilt until it is known.
    """
    check_tilt(start.poses, name)
    try:
        cleaned = fit_cleaned(sightings, start, options, progress)
    except (Undetermined, NotConverged):
        check_tilt(start.poses, name, DOUBTFUL_TILT_DEG)
        raise
    return cleaned, check_tilt(cleaned.fit.local, name)


def fixed_names(options: BoardOptions, n_cameras: int) -> frozenset[str]:
    """Return the names held in the first fit."""
    plain = options.fixed | ({"k3"} if options.automatic_k3 else frozenset())
    return frozenset(plain) if n_cameras == 1 else frozenset(f"{side}.{name}" for side in SIDES for name in plain)


def _freed(sightings: Sightings, fit: Fit, fixed: frozenset[str], options: BoardOptions) -> frozenset[str]:
    """Return the fixed names without k3 where the data ask for it."""
    if not options.automatic_k3 or "k3" in options.fixed:
        return fixed
    names = frozenset(name for name in fixed if name.split(".")[-1] == "k3")
    return fixed - names if names and asks_to_be_freed(sightings, fit, fixed, names) else fixed


def _misfits(sightings: Sightings, fit: Fit) -> tuple[dict[int, str], NDArray[np.bool_] | None]:
    """Return the views to leave out, with the reason, and the points (G, C, n), None where all fit."""
    residual = np.linalg.norm(residuals_px(sightings, fit), axis=3)  # (G, C, n) px
    seen = sightings.weight > 0.0
    scale = float(np.median(residual[seen])) / RAYLEIGH_MEDIAN
    count = np.maximum(seen.sum(axis=(1, 2)), 1)
    rms = np.sqrt((residual**2).sum(axis=(1, 2)) / count)  # (G,)
    usual = float(np.median(rms))
    views = {
        int(g): f"does not fit the other views: {rms[g]:.2f} px against {usual:.2f} px"
        for g in np.flatnonzero(rms > VIEW_LIMIT * usual)
    }
    bad = (residual > POINT_LIMIT * scale) & seen
    bad[list(views)] = False
    left = (seen & ~bad).sum(axis=2).min(axis=1)
    for g in np.flatnonzero((left < LEAST_POINTS) & bad.any(axis=(1, 2))):
        views[int(g)] = "too few of its points fit the other views"
        bad[g] = False
    if views:  # one bad view bends all others: their points are judged in the next round
        return views, None
    return views, bad if bad.any() else None


def _notes(given: Sightings, left: Sightings) -> tuple[str, ...]:
    """Return a line for every image of which single points were left out."""
    lost = ((given.weight > 0.0) & (left.weight == 0.0)).sum(axis=2)  # (G, C)
    return tuple(
        f"{given.sources[g][c]}: {lost[g, c]} of its points do not fit and are left out"
        for g, c in zip(*np.nonzero(lost), strict=True)
    )


def _require_views(left: int, total: int, rejected: list[tuple[str, str]]) -> None:
    """Raise NotEnoughData where too few views agree with each other."""
    if left < LEAST_VIEWS or left < total / 2:
        reasons = "; ".join(f"{name}: {why}" for name, why in rejected[-3:])
        raise NotEnoughData(
            f"only {left} of {total} views agree with each other ({reasons})",
            consequence="Nothing was calibrated",
            cure="Check the board's size, hold it still, and that left and right images belong together",
        )
