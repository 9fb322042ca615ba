"""The timing of free-running cameras from lights that somebody waves before them, and what comes of it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy  # loads its linalg where it is used
from numpy.typing import NDArray

from armsight.arrays import Array
from armsight.calibrate.timing.coarse import MIN_COMMON_S, coarse_delay
from armsight.calibrate.timing.fit import (
    DISTANCE_M,
    DRIFT_PPM,
    PPM,
    PathModel,
    best_spacing,
    build,
    depths,
    distances_along,
    solve_model,
)
from armsight.calibrate.timing.naming import Tied, lights_named, named_by_motion, tied_cameras
from armsight.calibrate.timing.result import CameraClock, CamerasTiming, TimingResult, time_names
from armsight.calibrate.timing.stamps import SteadyStamps, camera_clock
from armsight.calibrate.timing.views import RigDoubt, Views, common_lights, views_of
from armsight.calibrate.timing.widening import left_out_rms, onlookers, rig_pull, widened
from armsight.errors import DataRefused, Inconsistent, NotEnoughData
from armsight.fitting import Fit, Prior
from armsight.optics import SIDES, Rig, RigKind
from armsight.records import CameraTiming, NamedCovariance, SpotTrack
from armsight.records.camera import CLOCK
from armsight.records.result_parts import BothCounts, BothPixels, BothSeconds

OUTLIER = 6.0
"""Whitened residuals beyond this many times the robust scale are other lights or touched spots."""
COARSE_PERIODS = 2.0
"""By how many frames the fine delay may differ from the coarse one: line times and drift shift it by half a frame."""
MAX_RESIDUAL_PX = 2.0
"""Forty times a spot's noise: another rig, or other lights."""
MAX_RESIDUAL = 5.0
"""The same over what a table says of its spots, where that is more."""
FIRST_SPACING = 3.0
"""Periods, while the delay is known to some hundredths of a second only."""
MAX_RIG_OFF = 5.0
"""Over what the rig says of itself: a camera was moved, or is another one's recording."""
ROUNDS_OF_SCALES, SETTLED = 20, 0.01
"""Of variance components, where there are more than two: they hang on each other, and on how far the rig is off."""
RIG = "rig_"
"""Names of the directions in which the rig may be off begin with it."""
DISTANCE_STD_M = 1e-3
"""Of a target's distances as its file has them: they are found anew, so this only keeps them from running away."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Solved:
    """The fit of time_names, its model, and by camera the RMS residual in px and that of views left out (NaN: none).

    rig_off: deviations of the rig by which it is off; wider: by how much the times' deviations are.
    """

    fit: Fit
    model: PathModel
    rms_px: Array
    left_out_px: Array
    wider: Array
    rig_off: float = 1.0


def calibrate_timing(
    rig: Rig, left: SpotTrack, right: SpotTrack, positions_m: Mapping[str, Array] | None = None
) -> TimingResult:
    """Return the timing of both cameras of a rig, from the spots of waved lights in frames with their own stamps.

    positions_m: of a target's lights by name, where known. Lights without names are told apart by their motion. Raises
    Inconsistent (mirror rig, stamps without a steady rate, views that never agree), NotEnoughData, Degenerate (too
    little motion), Ambiguous (periodic motion).
    """
    if rig.kind is RigKind.MIRROR:
        raise Inconsistent(
            "a mirror rig has one camera: both views are of one exposure",
            consequence="There is no delay to be found",
            cure="Calibrate the timing of rigs with two cameras",
        )
    _require_recordings(SIDES, (left, right))
    clocks = (camera_clock(left.t_s, SIDES[0]), camera_clock(right.t_s, SIDES[1]))
    (one, other), count = lights_named(SIDES, (left, right), len(positions_m) if positions_m else None)
    tracks, times = (one, other), (clocks[0].t_s, clocks[1].t_s)
    if count > 1:
        tracks = named_by_motion(rig, tracks, times, count)
    delay_s = coarse_delay(rig, tracks, times, common_lights(*tracks)[0])
    solved = _fitted(rig, tracks, clocks, np.array([0.0, delay_s]), positions_m or {})
    found, covariance = _clocks(rig, solved, clocks)
    first, second = found.values()
    return TimingResult(
        given=rig,
        clocks=found,
        covariance=covariance,
        delay_s=second.delay_s,
        drift_ppm=second.drift_ppm,
        readout_s=BothSeconds(first.readout_s, second.readout_s),
        jitter_s=BothSeconds(first.jitter_s, second.jitter_s),
        period_s=BothSeconds(first.period_s, second.period_s),
        n_frames=len(left) + len(right),
        lost=BothCounts(first.lost, second.lost),
        middle_s=second.middle_s,
        common_s=first.common_s,
        residual_px=BothPixels(first.residual_px, second.residual_px),
        lights=solved.model.views.names,
    )


def calibrate_clocks(
    rig: Rig, tracks: Mapping[str, SpotTrack], positions_m: Mapping[str, Array] | None = None
) -> CamerasTiming:
    """Return the timing of a rig's cameras against the first one, from what each saw of waved lights, all in one fit.

    tracks: by camera. Raises as calibrate_timing; where the lights tie some cameras and others not, the error's `kept`
    is the timing of those with the first one.
    """
    seen = [tracks[name] for name in rig.names]
    if len(seen) < 2:
        raise Inconsistent(
            "the rig has one camera", consequence="There is no delay to be found", cure="Give a rig of two or more"
        )
    _require_recordings(rig.names, seen)
    clocks, refused = {}, {}
    for k, (name, track) in enumerate(zip(rig.names, seen, strict=True)):
        try:
            clocks[k] = camera_clock(track.t_s, name)
        except DataRefused as error:
            if k == 0:
                raise
            refused[name] = error
    steady = {k: seen[k] for k in clocks}
    times = {k: clock.t_s for k, clock in clocks.items()}
    tied = tied_cameras(rig, steady, times, len(positions_m) if positions_m else None, refused)
    if len(tied.cameras) < 2:
        raise tied.error()
    done = _clocks_of(rig, tied, clocks, positions_m or {})
    if len(tied.cameras) < len(seen):
        partly = tied.error()
        partly.kept = done
        raise partly
    return done


def _clocks_of(
    rig: Rig, tied: Tied, clocks: Mapping[int, SteadyStamps], positions_m: Mapping[str, Array]
) -> CamerasTiming:
    own = [clocks[k] for k in tied.cameras]
    some = rig.only(*(rig.names[k] for k in tied.cameras))
    solved = _fitted(some, tied.tracks, own, tied.delay_s, positions_m)
    found, covariance = _clocks(some, solved, own)
    n_frames = sum(map(len, tied.tracks))
    lights = solved.model.views.names
    return CamerasTiming(
        given=rig,
        clocks=found,
        covariance=covariance,
        n_frames=n_frames,
        lights=lights,
        rig_off=solved.rig_off,
    )


def _require_recordings(names: Sequence[str], tracks: Sequence[SpotTrack]) -> None:
    for k, track in enumerate(tracks):
        for name, other in zip(names[:k], tracks[:k], strict=True):
            if np.array_equal(other.uv_px, track.uv_px):
                raise Inconsistent(
                    f"{name} and {names[k]} are the same spots",
                    consequence="There is no delay to be found",
                    cure="Give the recording of each camera once",
                )


def _fitted(
    rig: Rig,
    tracks: Sequence[SpotTrack],
    clocks: Sequence[SteadyStamps],
    delay_s: Array,
    positions_m: Mapping[str, Array],
) -> _Solved:
    """Return the fit from coarse delays (V,). Raises Inconsistent, NotEnoughData."""
    doubt = RigDoubt.of(rig) if len(tracks) > 2 else RigDoubt.none(2)
    views = views_of(rig, tracks, clocks, common_lights(*tracks), doubt)
    views = _in_common(views, rig.names, delay_s)
    V = range(len(rig.names))
    mid_s = np.array([0.0, *(float(np.mean(views.stamp_s[views.side == s])) for s in V[1:])])
    period_s = max(clock.period_s for clock in clocks)
    solved = _solve(views, rig.names, delay_s, mid_s, period_s, positions_m)
    _require_fit(solved, rig.names, delay_s, period_s)
    return solved


def _require_fit(solved: _Solved, names: Sequence[str], coarse_s: Array, period_s: float) -> None:
    """Raise Inconsistent where the fit contradicts the delays it started from, or leaves more than any spot's noise."""
    v, n = solved.model.views, len(names)
    moved = np.abs(solved.fit.shared[: 2 * n - 2 : 2] - coarse_s[1:])
    given = np.array([np.median(v.std_px[v.side == s]) for s in range(n)])
    most = np.maximum(MAX_RESIDUAL_PX, MAX_RESIDUAL * given)
    # over minutes clocks drift apart by more than a frame, and a coarse delay is that of some part of them
    far = COARSE_PERIODS * period_s + (0.0 if n == 2 else 0.5 * PPM * DRIFT_PPM * float(np.ptp(v.stamp_s)))
    if moved.max() > far or (solved.rms_px > most).any():
        pair = tuple(names) == SIDES
        worst = names[1 + int(np.argmax(moved))], names[int(np.argmax(solved.rms_px / most))]
        of, by = ("", "") if pair else (f", most in {worst[1]}", f" of {worst[0]}")
        cameras = "left and right are recordings of two cameras" if pair else "each is the recording of its own camera"
        raise Inconsistent(
            f"the paths of the lights do not fit {'both' if pair else 'all'} views: {max(solved.rms_px):.2g} px "
            f"remain{of}, and the delay{by} moved by {1e3 * moved.max():.0f} ms",
            consequence="No timing is given",
            cure=f"Check that {cameras}, not swapped or the same, and that rig.yaml is of these cameras",
        )


def _in_common(views: Views, names: Sequence[str], delay_s: Array) -> Views:
    """Return the views of the time that another camera saw too; of three or more, where one saw the same light."""
    t = views.stamp_s + delay_s[views.side]
    if len(names) > 2:
        return views.take(onlookers(views, t, len(names)) > 0)
    ends = [(t[views.side == s].min(), t[views.side == s].max()) for s in (0, 1)]
    begin, end = max(e[0] for e in ends), min(e[1] for e in ends)
    if end - begin < MIN_COMMON_S:
        raise NotEnoughData(
            f"both cameras saw the lights together for {end - begin:.1f} s",
            consequence="No timing is given",
            cure="Wave the target for 10 to 20 s where both cameras see it",
        )
    return views.take((t >= begin) & (t <= end))


def _solve(
    views: Views,
    names: tuple[str, ...],
    coarse_s: Array,
    mid_s: Array,
    period_s: float,
    positions_m: Mapping[str, Array],
) -> _Solved:
    """Return the fit: first on a coarse grid, then on that which explains the views best, without outliers."""
    V, p = len(names), len(views.pairs)
    x = np.zeros(3 * V - 2 + p + views.doubt.size)
    x[: 2 * V - 2 : 2] = coarse_s[1:]
    spacing = FIRST_SPACING * period_s
    depth = np.ones(len(views))
    for _ in range(2):
        depth = depths(build(views, spacing, mid_s, x, depth), x, names)
    x[3 * V - 2 :][:p] = distances_along(build(views, spacing, mid_s, x, depth))
    total, given = np.ones(V), np.array([float(np.median(views.std_px[views.side == s])) for s in range(V)])
    priors = _priors(views, names, coarse_s, period_s, positions_m)
    last = 1 if V == 2 else 2
    for stage in range(last + 1):
        # what the rig is off makes single cameras look worse than they are, before it is found
        for _ in range(ROUNDS_OF_SCALES if stage else 1):
            scale = build(views, spacing, mid_s, x, depth).side_scales(x, alike=V > 2 and not stage)
            views, total = views.scaled(scale), total * scale
            if V == 2 or np.abs(scale - 1.0).max() < SETTLED:
                break
        model, fit = _solved_with_rig(build(views, spacing, mid_s, x, depth), x, priors)
        x = fit.shared.copy()
        if stage < last:
            kept = _kept(model, x)
            views, depth = views.take(kept), depth[kept]
            spacing, _ = best_spacing(views, period_s, mid_s, x, depth)
            depth = depths(build(views, spacing, mid_s, x, depth), x, names)
    rms = total * fit.scale * np.sqrt(model.together) * given
    if V == 2:
        return _Solved(fit=fit, model=model, rms_px=rms, left_out_px=np.full(V, np.nan), wider=np.ones(len(x)))
    model, fit, off = _with_rig(model, fit, priors, names)
    left_out = total * left_out_rms(model, fit, priors) * given
    return _Solved(fit=fit, model=model, rms_px=rms, left_out_px=left_out, wider=widened(model, fit), rig_off=off)


def _solved_with_rig(model: PathModel, x: Array, priors: dict[str, Prior]) -> tuple[PathModel, Fit]:
    """Return model and fit; where a rig may be off, spots tell of it as many times as they are independent."""
    rig = [name for name in priors if name.startswith(RIG)]
    fit = solve_model(model, x, priors, rig)
    if not rig:
        return model, fit
    model = replace(model, together=float(np.mean(widened(model, fit)[: model.n_times] ** 2)))
    return model, solve_model(model, fit.shared, priors)


def _with_rig(
    model: PathModel, fit: Fit, priors: dict[str, Prior], names: tuple[str, ...]
) -> tuple[PathModel, Fit, float]:
    """Return model and fit of a rig that is known as well as the lights tell, and how far it is off what it says.

    Raises Inconsistent where it is further off than any calibration is by chance.
    """
    off, pull = rig_pull(model, fit, widened(model, fit))
    if off > MAX_RIG_OFF:
        raise Inconsistent(
            f"the paths of the lights pull the rig's cameras {off:.0f} standard deviations off, most "
            f"{names[int(np.argmax(pull))]}: they do not fit all views",
            consequence="No timing is given",
            cure="Check that each is the recording of its own camera; else calibrate the rig anew as it stands now",
        )
    # the same directions, each with more room: what was found of them counts from there
    if off > 1.0:
        doubt, x = model.views.doubt, fit.shared.copy()
        model = replace(model, views=replace(model.views, doubt=doubt.times(off)))
        x[len(x) - doubt.size :] /= off
        fit = solve_model(model, x, priors)
    return model, fit, off


def _kept(model: PathModel, x: Array) -> NDArray[np.bool_]:
    r = np.linalg.norm(model.fit_paths(x).residuals[0].reshape(-1, 2), axis=1)
    # sqrt(2 log 2) = 1.177 is the median length of two unit normals: from lengths to one component
    return np.asarray(r < OUTLIER * np.median(r) / 1.177)


def _priors(
    views: Views, names: tuple[str, ...], delay_s: Array, period_s: float, positions_m: Mapping[str, Array]
) -> dict[str, Prior]:
    """Return what is known beforehand: a camera reads out within a frame, clocks drift little, targets have a size."""
    half, times = 0.5 * period_s, time_names(names)
    priors = dict.fromkeys(times, Prior(mean=half, sigma=half))
    for k, delay in enumerate(delay_s[1:].tolist()):
        priors[times[2 * k]] = Prior(mean=delay, sigma=1.0)
        priors[times[2 * k + 1]] = Prior(mean=0.0, sigma=DRIFT_PPM)
    for a, b in views.pairs:
        ends = [positions_m.get(views.names[i]) for i in (a, b)]
        known = [np.asarray(end, float) for end in ends if end is not None]
        mean = float(np.linalg.norm(known[1] - known[0])) if len(known) == 2 else DISTANCE_M
        sigma = DISTANCE_STD_M if len(known) == 2 else DISTANCE_M
        priors[f"distance_{a}_{b}_m"] = Prior(mean=mean, sigma=sigma)
    return priors | {f"{RIG}{k}": Prior(mean=0.0, sigma=1.0) for k in range(views.doubt.size)}


def _clocks(
    rig: Rig, solved: _Solved, clocks: Sequence[SteadyStamps]
) -> tuple[dict[str, CameraClock], NamedCovariance]:
    """Return the clocks at their stamps 0, and their covariance with what the stamps' jitter leaves open of all."""
    x, model, V = solved.fit.shared, solved.model, len(clocks)
    names = time_names(rig.names)
    own, move, wider = solved.fit.covariance, np.eye(len(names)), solved.wider[: len(names)]
    C = np.outer(wider, wider) * (0.0 if own is None else own.block(names))
    at = [slice(2 * s - 2, 2 * s) for s in range(1, V)]
    first = [clocks[0].moved(model.mid_s[s] + x[2 * s - 2]) for s in range(1, V)]
    for s, block in enumerate(at):
        for other, theirs in enumerate(at):
            shared = first[s] @ clocks[0].covariance @ first[other].T
            stamps_own = clocks[s + 1].clock_covariance(model.mid_s[s + 1])
            C[block, theirs] += shared + stamps_own if s == other else shared
        # the delay at stamp 0 from that in the middle, where it hardly hangs on the drift: d0 = d - 1e-6 drift mid
        move[2 * s, 2 * s + 1] = -1e-6 * model.mid_s[s + 1]
    C = move @ C @ move.T
    full = scipy.linalg.block_diag(C, np.diag([clock.jitter_std_s**2 for clock in clocks]))
    covariance = NamedCovariance(names=(*names, *(f"{name}.jitter_s" for name in rig.names)), matrix=full)
    found = {}
    for s, (name, clock) in enumerate(zip(rig.names, clocks, strict=True)):
        delay, drift = x[2 * s - 2 : 2 * s] if s else (0.0, 0.0)
        stamps = model.views.stamp_s[model.views.side == s]
        mid = float(model.mid_s[s]) if s else float(np.mean(stamps))
        doubt = CameraTiming(covariance=NamedCovariance(names=CLOCK, matrix=C[at[s - 1], at[s - 1]])) if s else None
        found[name] = CameraClock(
            delay_s=float(delay - 1e-6 * drift * mid),
            drift_ppm=float(drift),
            readout_s=float(x[2 * V - 2 + s]),
            jitter_s=clock.jitter_s,
            period_s=clock.period_s,
            lost=clock.lost,
            middle_s=mid,
            std_middle_s=float(doubt.clock_std_s([mid])[0]) if doubt else 0.0,
            common_s=float(stamps.max() - stamps.min()),
            wider=float(wider[2 * s - 2]) if s else 1.0,
            residual_px=float(solved.rms_px[s]),
            left_out_px=float(solved.left_out_px[s]) if np.isfinite(solved.left_out_px[s]) else None,
        )
    return found, covariance
