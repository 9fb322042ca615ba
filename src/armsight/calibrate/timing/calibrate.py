"""The timing of two free-running cameras from lights that somebody waves before them, and what comes of it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from armsight.arrays import Array
from armsight.calibrate.timing.coarse import MIN_COMMON_S, coarse_delay
from armsight.calibrate.timing.fit import (
    DISTANCE_M,
    DRIFT_PPM,
    TIMES,
    PathModel,
    best_spacing,
    build,
    depths,
    distances_along,
    solve_model,
)
from armsight.calibrate.timing.naming import named_by_motion, only_light, usual_count
from armsight.calibrate.timing.result import TimingCalibration
from armsight.calibrate.timing.stamps import SteadyStamps, camera_clock
from armsight.calibrate.timing.views import Views, common_lights, views_of
from armsight.errors import Inconsistent, NotEnoughData
from armsight.fitting import Fit, Prior
from armsight.optics import SIDES, Rig, RigKind
from armsight.records import NamedCovariance, SpotTrack
from armsight.records.result_parts import BothCounts, BothPixels, BothSeconds

OUTLIER = 6.0
"""Whitened residuals beyond this many times the robust scale are other lights or touched spots."""
COARSE_PERIODS = 2.0
"""By how many frames the fine delay may differ from the coarse one: line times and drift shift it by half a frame."""
MAX_RESIDUAL_PX = 2.0
"""Forty times a spot's noise: another rig, or other lights."""
LIGHT = "light"
"""Name of the only light, where nobody named it."""
FIRST_SPACING = 3.0
"""Periods, while the delay is known to some hundredths of a second only."""
DISTANCE_STD_M = 1e-3
"""Of a target's distances as its file has them: they are found anew, so this only keeps them from running away."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Solved:
    """The fit of delay, drift and read-outs, its model, and the residuals of the left and the right views."""

    fit: Fit
    model: PathModel
    rms_px: tuple[float, float]


def calibrate_timing(
    rig: Rig, left: SpotTrack, right: SpotTrack, positions_m: Mapping[str, Array] | None = None
) -> TimingCalibration:
    """Return the timing of both cameras of a rig, from the spots of waved lights in frames with their own stamps.

    positions_m: of a target's lights by name, where known. Lights without names are told apart by their motion. Raises
    Inconsistent (mirror rig, stamps without a steady rate, views that never agree), NotEnoughData, Degenerate (too
    little motion), Ambiguous (periodic motion).
    """
    _require_two_cameras(rig)
    _require_two_recordings(left, right)
    clocks = (camera_clock(left.t_s, SIDES[0]), camera_clock(right.t_s, SIDES[1]))
    tracks = _named(rig, (left, right), clocks, len(positions_m) if positions_m else None)
    names = common_lights(*tracks)
    coarse = coarse_delay(rig, tracks, (clocks[0].t_s, clocks[1].t_s), names[0])
    views = _in_common(views_of(rig, tracks, clocks, names), coarse.delay_s)
    mid_s = float(np.mean(views.stamp_s[views.side == 1]))
    period_s = max(clock.period_s for clock in clocks)
    solved = _solve(views, coarse.delay_s, mid_s, period_s, positions_m or {})
    _require_fit(solved, coarse.delay_s, period_s)
    return _result(solved, mid_s, clocks, (left, right))


def _require_two_cameras(rig: Rig) -> None:
    if rig.kind is RigKind.MIRROR:
        raise Inconsistent(
            "a mirror rig has one camera: both views are of one exposure",
            consequence="There is no delay to be found",
            cure="Calibrate the timing of rigs with two cameras",
        )


def _require_two_recordings(left: SpotTrack, right: SpotTrack) -> None:
    if np.array_equal(left.uv_px, right.uv_px):
        raise Inconsistent(
            "left and right are the same spots",
            consequence="There is no delay to be found",
            cure="Give the recording of each camera once",
        )


def _named(
    rig: Rig, tracks: tuple[SpotTrack, SpotTrack], clocks: tuple[SteadyStamps, SteadyStamps], n_lights: int | None
) -> tuple[SpotTrack, SpotTrack]:
    """Return tracks whose lights have names: as given, of the only light, or found from the motion."""
    named = [any(track.names) for track in tracks]
    if all(named):
        return tracks
    if any(named):
        theirs = sorted(set(tracks[named.index(True)].names))
        if len(theirs) > 1:
            raise NotEnoughData(
                f"the {SIDES[named.index(False)]} camera's spots have no names, the other one's have",
                consequence="Nobody can say which spot is which light",
                cure="Name the lights in both tables, or in none",
            )
        tracks = (tracks[0].renamed(""), tracks[1].renamed(""))
    count = 1 if all(track.alone for track in tracks) else n_lights or usual_count(tracks)
    if count > 1:
        return named_by_motion(rig, tracks, (clocks[0].t_s, clocks[1].t_s), count)
    return only_light(tracks[0], LIGHT), only_light(tracks[1], LIGHT)


def _require_fit(solved: _Solved, coarse_s: float, period_s: float) -> None:
    """Raise Inconsistent where the fit contradicts the delay it started from, or leaves more than any spot's noise."""
    moved = abs(float(solved.fit.shared[0]) - coarse_s)
    if moved > COARSE_PERIODS * period_s or max(solved.rms_px) > MAX_RESIDUAL_PX:
        raise Inconsistent(
            f"the paths of the lights do not fit both views: {max(solved.rms_px):.2g} px remain, and the delay moved "
            f"by {1e3 * moved:.0f} ms",
            consequence="No timing is given",
            cure="Check that left and right are recordings of two cameras, not swapped or the same, and that rig.yaml "
            "is of these cameras",
        )


def _in_common(views: Views, delay_s: float) -> Views:
    """Return the views of the time that both cameras saw."""
    t = views.stamp_s + delay_s * views.side
    ends = [(t[views.side == s].min(), t[views.side == s].max()) for s in (0, 1)]
    begin, end = max(e[0] for e in ends), min(e[1] for e in ends)
    if end - begin < MIN_COMMON_S:
        raise NotEnoughData(
            f"both cameras saw the lights together for {end - begin:.1f} s",
            consequence="No timing is given",
            cure="Wave the target for 10 to 20 s where both cameras see it",
        )
    return views.take((t >= begin) & (t <= end))


def _solve(views: Views, delay_s: float, mid_s: float, period_s: float, positions_m: Mapping[str, Array]) -> _Solved:
    """Return the fit: first on a coarse grid, then on that which explains the views best, without outliers."""
    x = np.concatenate([[delay_s, 0.0, 0.0, 0.0], np.zeros(len(views.pairs))])
    spacing = FIRST_SPACING * period_s
    depth = np.ones(len(views))
    for _ in range(2):
        depth = depths(build(views, spacing, mid_s, x, depth), x[:4])
    x[4:] = distances_along(build(views, spacing, mid_s, x, depth))
    total, given = np.ones(2), [float(np.median(views.std_px[views.side == s])) for s in (0, 1)]
    for final in (False, True):
        model = build(views, spacing, mid_s, x, depth)
        scale = np.array(model.side_scales(model.fit_paths(x)))
        views, total = views.scaled(scale), total * scale
        model = build(views, spacing, mid_s, x, depth)
        fit = solve_model(model, x, _priors(views, delay_s, period_s, positions_m))
        x = fit.shared.copy()
        if not final:
            kept = _kept(model, x)
            views, depth = views.take(kept), depth[kept]
            spacing, _ = best_spacing(views, period_s, mid_s, x, depth)
            depth = depths(build(views, spacing, mid_s, x, depth), x)
    left, right = (total * fit.scale).tolist()
    return _Solved(fit=fit, model=model, rms_px=(left * given[0], right * given[1]))


def _kept(model: PathModel, x: Array) -> NDArray[np.bool_]:
    r = np.linalg.norm(model.fit_paths(x).residuals[0].reshape(-1, 2), axis=1)
    # sqrt(2 log 2) = 1.177 is the median length of two unit normals: from lengths to one component
    return np.asarray(r < OUTLIER * np.median(r) / 1.177)


def _priors(views: Views, delay_s: float, period_s: float, positions_m: Mapping[str, Array]) -> dict[str, Prior]:
    """Return what is known beforehand: a camera reads out within a frame, clocks drift little, targets have a size."""
    half = 0.5 * period_s
    priors = {
        TIMES[0]: Prior(mean=delay_s, sigma=1.0),
        TIMES[1]: Prior(mean=0.0, sigma=DRIFT_PPM),
        TIMES[2]: Prior(mean=half, sigma=half),
        TIMES[3]: Prior(mean=half, sigma=half),
    }
    for a, b in views.pairs:
        ends = [positions_m.get(views.names[i]) for i in (a, b)]
        known = [np.asarray(end, float) for end in ends if end is not None]
        mean = float(np.linalg.norm(known[1] - known[0])) if len(known) == 2 else DISTANCE_M
        sigma = DISTANCE_STD_M if len(known) == 2 else DISTANCE_M
        priors[f"distance_{a}_{b}_m"] = Prior(mean=mean, sigma=sigma)
    return priors


def _result(
    solved: _Solved, mid_s: float, clocks: tuple[SteadyStamps, ...], tracks: tuple[SpotTrack, SpotTrack]
) -> TimingCalibration:
    """Return the result at the right stamp 0, with what the stamps' jitter leaves open of both clocks."""
    x, views = solved.fit.shared, solved.model.views
    C = solved.fit.covariance.block(TIMES) if solved.fit.covariance is not None else np.zeros((4, 4))
    left, right = clocks
    C = C.copy()
    C[:2, :2] += left.clock_covariance(mid_s + x[0]) + right.clock_covariance(mid_s)
    # the delay at stamp 0 from that in the middle, where it hardly hangs on the drift: d0 = d - 1e-6 drift mid
    move = np.eye(4)
    move[0, 1] = -1e-6 * mid_s
    C = move @ C @ move.T
    names = (*TIMES, "left.jitter_s", "right.jitter_s")
    full = np.zeros((6, 6))
    full[:4, :4] = C
    full[4, 4], full[5, 5] = left.jitter_std_s**2, right.jitter_std_s**2
    common = views.stamp_s[views.side == 0]
    return TimingCalibration(
        delay_s=float(x[0] - 1e-6 * x[1] * mid_s),
        drift_ppm=float(x[1]),
        readout_s=BothSeconds(float(x[2]), float(x[3])),
        jitter_s=BothSeconds(left.jitter_s, right.jitter_s),
        period_s=BothSeconds(left.period_s, right.period_s),
        covariance=NamedCovariance(names=names, matrix=full),
        n_frames=len(tracks[0]) + len(tracks[1]),
        lost=BothCounts(left.lost, right.lost),
        middle_s=mid_s,
        common_s=float(common.max() - common.min()),
        residual_px=BothPixels(*solved.rms_px),
        lights=views.names,
    )
