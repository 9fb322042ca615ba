"""The honest error: of views that took no part in the fit."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from armsight.arrays import Array
from armsight.calibrate.cameras.bundle_adjustment import Bundle, adjust, bundle_of, names_of, residuals_px, start_at
from armsight.calibrate.cameras.observations import BoardOptions, Observations
from armsight.calibrate.cameras.outlier_rejection import LAST_TERMS, RobustFit, fit_without_outliers
from armsight.calibrate.cameras.pairing import rig_of
from armsight.calibrate.cameras.preconditions import LEAST_VIEWS
from armsight.errors import DataRefused
from armsight.geometry import align_points
from armsight.optics import Rig
from armsight.optics.camera import INTRINSICS_OF
from armsight.optics.triangulate import epipolar_distance, triangulate

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
    for part, rig, g, both in _each(pairs):
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


def _each(pairs: list[tuple[Observations, Rig]]) -> Iterator[tuple[Observations, Rig, int, NDArray[np.intp]]]:
    """Yield every view with the points (positions) that both cameras saw."""
    for part, rig in pairs:
        for g in range(part.n_views):
            yield part, rig, g, np.flatnonzero((part.weight[g] > 0.0).all(axis=0))
