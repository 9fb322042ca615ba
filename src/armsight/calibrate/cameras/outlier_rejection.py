"""Fit, leave out what does not fit, fit again; and let the data choose how long the distortion polynomial is."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from armsight.arrays import Array
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
from armsight.calibrate.cameras.pairing import rig_of
from armsight.calibrate.cameras.preconditions import DOUBTFUL_TILT_DEG, LEAST_POINTS, LEAST_VIEWS, check_tilt
from armsight.errors import DataRefused, NotConverged, NotEnoughData, Undetermined
from armsight.fitting import Fit
from armsight.geometry import align_points
from armsight.optics import WIDEST_RAD, LensKind, Rig
from armsight.optics.camera import INTRINSICS_OF
from armsight.optics.triangulate import epipolar_distance, triangulate
from armsight.records import Progress

POINT_LIMIT = 6.0
"""A point further off than this many robust standard deviations is wrong: 1.5e-8 by chance, and real lenses and boards
scatter less."""
VIEW_LIMIT = 4.0
"""A view that scatters this many times more than the median view moved during the exposure or is no pair."""
MOST_ROUNDS = 5
LAST_TERMS = {
    LensKind.PINHOLE: frozenset({"k3"}),
    LensKind.FISHEYE: frozenset({"k3", "k4"}),
    LensKind.RATIONAL: frozenset(),
}
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
            stay = np.flatnonzero((observations.weight > 0.0).sum(axis=2).max(axis=1) >= LEAST_POINTS)
            gone = sorted(set(range(observations.n_views)) - set(stay.tolist()))
            if gone:
                rejected += [
                    (named(observations, g), "too few of its points are within the lens's angle") for g in gone
                ]
                _require_views(len(stay), observations.n_views, rejected)
                observations, kept, state = observations.take(stay), kept[stay], start_at(state, stay)
            fit = adjust(observations, state, fixed, max_iterations=options.max_iterations, progress=progress)
        wider = _freed(observations, fit, fixed, options)
        judged = options.reject and (wider == fixed or not observations.has_wide)
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
        "lie beyond 85 degrees, or do not fit," if lens is LensKind.FISHEYE else "do not fit" for lens in given.lenses
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


# The honest error: of views that took no part in the fit.

MetricKey = Literal["expected_m", "mean_m", "rms_m", "board_rms_m"]

NEIGHBOUR = 1.01
"""Points up to this many times the shortest distance apart are neighbours."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LeftOut:
    """Errors on left-out views: reprojection, and for a pair of cameras epipolar distance and metric."""

    rms_px: float
    epipolar_rms_px: float | None
    metric: dict[MetricKey, float | None]


def left_out(robust_fit: RobustFit, options: BoardOptions) -> LeftOut | None:
    """Return the k-fold errors, None where there are too few views for it or no folds are asked for.

    Every fold repeats the whole procedure (rejection, choice of k3) without its views. In a left-out view
    only the board's pose is fitted, by both cameras together.
    """
    observations = robust_fit.observations
    folds = min(options.folds, observations.n_views)
    if folds < 2 or observations.n_views - -(-observations.n_views // folds) < LEAST_VIEWS:
        return None
    squares, n_points = 0.0, 0
    rows: list[tuple[Observations, Rig | None]] = []
    for out, state in _folds(robust_fit, options, folds):
        part = observations.take(out)
        everything = frozenset(names_of(observations))
        fit = adjust(part, start_at(state, out), everything, max_iterations=options.max_iterations)
        squares += float((residuals_px(part, fit) ** 2).sum())
        n_points += part.n_points
        rows.append(
            (
                part,
                rig_of(bundle_of(fit, 2), observations.sizes, lenses=observations.lenses)
                if observations.n_cameras == 2 and observations.n_front is None
                else None,
            )
        )
    pairs = [(part, rig) for part, rig in rows if rig is not None]
    return LeftOut(
        rms_px=float(np.sqrt(squares / n_points)),
        epipolar_rms_px=epipolar_rms(pairs) if pairs else None,
        metric=metric_of(pairs) if pairs else {},
    )


def _folds(robust_fit: RobustFit, options: BoardOptions, folds: int) -> Iterator[tuple[NDArray[np.intp], Bundle]]:
    """Yield the left-out views of each fold with the state fitted without them (their own poses still the old ones)."""
    all_views = bundle_of(robust_fit.fit, robust_fit.observations.n_cameras)
    start_k = all_views.k.copy()
    if options.automatic_k3:
        for c, lens in enumerate(robust_fit.observations.lenses):
            if not robust_fit.observations.is_given(c):
                start_k[c, [INTRINSICS_OF[lens].index(name) for name in LAST_TERMS[lens]]] = 0.0
    views = np.arange(robust_fit.observations.n_views)
    # of a motion blocks of time are left out: a moment between two others is known from these
    of = views % folds if robust_fit.observations.t_s is None else views * folds // len(views)
    for fold in range(folds):
        stay, out = views[of != fold], views[of == fold]
        start = replace(start_at(all_views, stay), k=start_k)
        try:
            fit = fit_without_outliers(robust_fit.observations.take(stay), start, options).fit
        except DataRefused:
            continue  # a fold of too few or too equal views says nothing about the whole
        state = bundle_of(fit, robust_fit.observations.n_cameras)
        yield out, replace(state, poses=all_views.poses)


def epipolar_rms(pairs: list[tuple[Observations, Rig]]) -> float:
    """Return the RMS distance in px of a point from its partner's epipolar line, over both images."""
    squares = []
    for part, rig in pairs:
        both = (part.weight > 0.0).all(axis=1)  # (G, n)
        squares.append(epipolar_distance(rig, part.uv[:, 0][both], part.uv[:, 1][both]).ravel() ** 2)
    return float(np.sqrt(np.concatenate(squares).mean()))


def metric_of(pairs: list[tuple[Observations, Rig]]) -> dict[MetricKey, float | None]:
    """Return distances of neighbouring points after triangulation, over all pairs, in m; none where no two are seen.

    expected_m: as printed. mean_m: as measured. rms_m: of the error of one distance. board_rms_m: of the points'
    3-D distances after the printed board is laid onto them (rigid fit).
    """
    lengths: list[Array] = []
    squares: list[float] = []
    counts: list[int] = []
    X = pairs[0][0].X
    distance = np.linalg.norm(X[:, None] - X[None], axis=2) + np.where(np.eye(len(X)) > 0.0, np.inf, 0.0)
    expected = float(distance.min())
    first, second = np.nonzero(np.triu(distance < NEIGHBOUR * expected))
    for part, rig, g in ((one, rig, g) for one, rig in pairs for g in range(one.n_views)):
        both = np.flatnonzero((part.weight[g] > 0.0).all(axis=0))
        cov = np.eye(2) / part.weight[g][:, both, None, None] ** 2  # (2, n, 2, 2)
        points = triangulate(rig, part.uv[g, 0, both], part.uv[g, 1, both], cov[0], cov[1])
        xyz = np.full((len(X), 3), np.nan)
        xyz[both] = points.xyz_m
        known = np.isfinite(xyz[:, 0])
        if np.count_nonzero(known) < 4:
            continue
        side = np.linalg.norm(xyz[first] - xyz[second], axis=1)
        lengths.append(side[np.isfinite(side)])
        squares.append(align_points(xyz[known], X[known]).rms_m ** 2 * np.count_nonzero(known))
        counts.append(int(np.count_nonzero(known)))
    if not sum(len(side) for side in lengths):
        return {}
    every = np.concatenate(lengths)
    return {
        "expected_m": expected,
        "mean_m": float(every.mean()),
        "rms_m": float(np.sqrt(((every - expected) ** 2).mean())),
        "board_rms_m": float(np.sqrt(sum(squares) / sum(counts))),
    }
