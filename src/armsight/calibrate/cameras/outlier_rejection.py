"""Fit, leave out what does not fit, fit again; and let the data choose how long the distortion polynomial is."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from armsight.calibrate.cameras.bundle_adjustment import (
    Bundle,
    adjust,
    asks_to_be_freed,
    bundle_of,
    names_of,
    residuals_px,
    start_at,
    without,
)
from armsight.calibrate.cameras.observations import BoardOptions, Observations
from armsight.calibrate.cameras.preconditions import DOUBTFUL_TILT_DEG, LEAST_POINTS, LEAST_VIEWS, check_tilt
from armsight.errors import NotConverged, NotEnoughData, Undetermined
from armsight.fitting import Fit
from armsight.optics import WIDEST_RAD, LensKind
from armsight.records import Progress

POINT_LIMIT = 6.0
"""A point further off than this many robust standard deviations is wrong: 1.5e-8 by chance, and real lenses and boards
scatter less."""
VIEW_LIMIT = 4.0
"""A view that scatters this many times more than the median view moved during the exposure or is no pair."""
MOST_ROUNDS = 5
LAST_TERMS = {LensKind.PINHOLE: frozenset({"k3"}), LensKind.FISHEYE: frozenset({"k3", "k4"})}
"""What the distortion polynomial goes without unless the data ask for it."""
RAYLEIGH_MEDIAN = 1.1774
"""Median distance of points scattered by one standard deviation along each axis."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RobustFit:
    """The last fit with what went into it, the views that did not, and notes on images that lost single points."""

    observations: Observations
    fit: Fit
    rejected: tuple[tuple[str, str], ...]
    notes: tuple[str, ...]


def fit_without_outliers(
    observations: Observations, start: Bundle, options: BoardOptions, progress: Progress | None = None
) -> RobustFit:
    """Return the fit of what agrees; raises as the engine does, and NotEnoughData where too few views agree."""
    fixed = fixed_names(options, observations)
    given, kept = observations, np.arange(observations.n_views, dtype=np.intp)
    rejected: list[tuple[str, str]] = []
    fit = adjust(observations, start, fixed, max_iterations=options.max_iterations, progress=progress)
    for _ in range(MOST_ROUNDS):
        beyond = _beyond(observations, fit)
        if beyond.any():  # the model ends there: such points would push all others aside
            observations = without(observations, beyond)
            state = bundle_of(fit, observations.n_cameras)
            fit = adjust(observations, state, fixed, max_iterations=options.max_iterations, progress=progress)
        wider = _freed(observations, fit, fixed, options)
        judged = options.reject and (wider == fixed or LensKind.FISHEYE not in observations.lenses)
        bad_views, bad_points = _misfits(observations, fit) if judged else ({}, None)
        if wider == fixed and not bad_views and bad_points is None:
            break
        fixed = wider
        state = bundle_of(fit, observations.n_cameras)
        if bad_points is not None:
            observations = without(observations, bad_points)
        if bad_views:
            rejected += [(named(observations, g), why) for g, why in bad_views.items()]
            stay = np.array([g for g in range(observations.n_views) if g not in bad_views], dtype=np.intp)
            _require_views(len(stay), observations.n_views, rejected)
            observations, kept, state = observations.take(stay), kept[stay], start_at(state, stay)
        fit = adjust(observations, state, fixed, max_iterations=options.max_iterations, progress=progress)
    notes = _notes(given.take(kept), observations)
    return RobustFit(observations=observations, fit=fit, rejected=tuple(rejected), notes=notes)


def fit_tilted(
    observations: Observations, start: Bundle, options: BoardOptions, name: str, progress: Progress | None = None
) -> tuple[RobustFit, list[str]]:
    """Return fit_without_outliers with advice on the board's tilt; raises Degenerate where that is what is missing.

    name: of the camera, for the message. Asked before the fit, and again after it: a lens's distortion looks like
    tilt until it is known.
    """
    if LensKind.FISHEYE not in observations.lenses:
        check_tilt(start.poses, name)
    try:
        robust_fit = fit_without_outliers(observations, start, options, progress)
    except (Undetermined, NotConverged):
        check_tilt(start.poses, name, DOUBTFUL_TILT_DEG)
        raise
    return robust_fit, check_tilt(robust_fit.fit.local, name)


def named(observations: Observations, g: int) -> str:
    """Return the names of a view's images."""
    return " / ".join(filter(None, observations.sources[g]))


def fixed_names(options: BoardOptions, observations: Observations) -> frozenset[str]:
    """Return the names held in the first fit; what is known of a lens beforehand is free to move by its doubt."""
    each = [options.fixed | (LAST_TERMS[lens] if options.automatic_k3 else frozenset()) for lens in observations.lenses]
    if observations.n_cameras == 1:
        return frozenset(each[0])
    known = () if observations.known is None else observations.known.names
    asked = {f"{camera}.{name}" for camera, plain in zip(observations.cameras, each, strict=True) for name in plain}
    return frozenset(asked & set(names_of(observations)) - set(known)) | observations.held


def _freed(observations: Observations, fit: Fit, fixed: frozenset[str], options: BoardOptions) -> frozenset[str]:
    """Return the fixed names without the last terms of the distortion where the data ask for them."""
    if not options.automatic_k3:
        return fixed
    held = replace(options, automatic_k3=False)
    names = fixed & (fixed_names(options, observations) - fixed_names(held, observations))
    return fixed - names if names and asks_to_be_freed(observations, fit, fixed, names) else fixed


def _beyond(observations: Observations, fit: Fit) -> NDArray[np.bool_]:
    """Tell which points (G, C, n) a fisheye lens has beyond the angle up to which it is used; none of a pinhole."""
    seen = observations.weight > 0.0
    fisheye = np.array([lens is LensKind.FISHEYE for lens in observations.lenses])[:, None]  # (C, 1)
    if not fisheye.any():
        return np.zeros_like(seen)
    k = bundle_of(fit, observations.n_cameras).k[:, :, None]  # (C, 10, 1): fx, fy, cx, cy, skew, k1, k2, k3, k4, none
    y = (observations.uv[..., 1] - k[:, 3]) / k[:, 1]
    x = (observations.uv[..., 0] - k[:, 2] - k[:, 4] * y) / k[:, 0]
    q = WIDEST_RAD**2
    widest = WIDEST_RAD * (1.0 + q * (k[:, 5] + q * (k[:, 6] + q * (k[:, 7] + q * k[:, 8]))))
    return np.asarray(seen & fisheye & (np.hypot(x, y) > widest))


def _misfits(observations: Observations, fit: Fit) -> tuple[dict[int, str], NDArray[np.bool_] | None]:
    """Return the views to leave out, with the reason, and the points (G, C, n), None where all fit."""
    residual = np.linalg.norm(residuals_px(observations, fit), axis=3)  # (G, C, n) px
    seen = observations.weight > 0.0
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
    left = np.where(seen.any(axis=2), (seen & ~bad).sum(axis=2), LEAST_POINTS).min(axis=1)
    for g in np.flatnonzero((left < LEAST_POINTS) & bad.any(axis=(1, 2))):
        views[int(g)] = "too few of its points fit the other views"
        bad[g] = False
    if views:  # one bad view bends all others: their points are judged in the next round
        return views, None
    return views, bad if bad.any() else None


def _notes(given: Observations, left: Observations) -> tuple[str, ...]:
    """Return a line for every image of which single points were left out."""
    lost = ((given.weight > 0.0) & (left.weight == 0.0)).sum(axis=2)  # (G, C)
    why = [
        "do not fit" if lens is LensKind.PINHOLE else "lie beyond 85 degrees, or do not fit," for lens in given.lenses
    ]
    return tuple(
        f"{given.sources[g][c]}: {lost[g, c]} of its points {why[c]} and are left out"
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
