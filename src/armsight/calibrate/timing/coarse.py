"""Delays between cameras to some hundredths of a second: where two views agree with the epipolar lines."""

from __future__ import annotations

import numpy as np

from armsight.arrays import Array
from armsight.errors import Ambiguous, Degenerate, Inconsistent, NotEnoughData
from armsight.optics import Rig
from armsight.records import SpotTrack

MAX_DELAY_S = 30.0
STEP_S = 0.01
FEWEST_SPOTS = 30
MIN_COMMON_S = 4.0
"""Of motion seen by both cameras."""
RATE_HZ = 20.0
"""Frames of the first camera used, at most."""
MAX_GAP = 2.6
"""Periods across which a path is bridged by a straight line."""
LEAST_MOTION_PX = 3.0
"""Distance from the epipolar lines at wrong delays, median; below it, the motion tells no delay."""
AGREE = 0.3
"""Distance at the right delay over that at wrong ones, at most: rolling shutters and drift leave 0.01 to 0.1."""
RIVAL = 2.5
RIVAL_FLOOR_PX = 1.0
"""Another delay with less than RIVAL times the distance (plus a floor, for exact data) fits as well."""
APART_S = 0.15


def coarse_delay(rig: Rig, tracks: tuple[SpotTrack, SpotTrack], times_s: tuple[Array, Array], name: str) -> float:
    """Return the delay in s that turns the second camera's times into the first one's, from the light of this name.

    rig: of these two cameras.
    times_s: of the frames of each camera. Raises NotEnoughData, Inconsistent where no delay up to MAX_DELAY_S brings
    the views together, Degenerate where the light hardly moves, Ambiguous where several delays fit.
    """
    rows = [track.light(name) for track in tracks]
    t = [time[track.frame[i]] for track, time, i in zip(tracks, times_s, rows, strict=True)]
    if min(len(each) for each in t) < FEWEST_SPOTS:
        raise NotEnoughData(
            f"the light was seen in {len(t[0])} {rig.names[0]} and {len(t[1])} {rig.names[1]} frames",
            consequence="No timing is given",
            cure="Wave the target for 10 to 20 s where both cameras see it, before a dark ground (lights that stand "
            "still are left out); set --threshold where lights are not found",
        )
    d = [_directions(rig, side, track.uv_px[i]) for side, track, i in zip(rig.names, tracks, rows, strict=True)]
    thin = max(1, round(len(t[0]) / max(float(np.ptp(t[0])) * RATE_HZ, 1.0)))
    # the epipolar plane of each of its rays: at the right delay the other camera's ray of the same light lies in it
    first, second = (one.T_rig_camera.translation for one in rig.cameras)
    normal = np.cross(second - first, d[0][::thin])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    delays = np.arange(-MAX_DELAY_S, MAX_DELAY_S + STEP_S, STEP_S)
    focal = float(np.mean([camera.intrinsics[:2].mean() for camera in (one.camera for one in rig.cameras)]))
    rms = focal * _distances(t[0][::thin], normal, t[1], d[1], delays)
    return _chosen(delays, rms, rig.names, t)


def _directions(rig: Rig, side: str, uv_px: Array) -> Array:
    """Return unit rays (n, 3) in rig axes."""
    xy = rig.camera(side).rays(uv_px)
    d = np.concatenate([xy, np.ones((len(xy), 1))], axis=1)
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    return np.asarray(rig.T_rig_camera(side).rotation.apply(d))


def _distances(t: Array, normal: Array, t_other: Array, d: Array, delays: Array) -> Array:
    """Return the RMS angle (k,) of the other camera's rays to the epipolar planes at each delay; NaN where too few."""
    period = float(np.median(np.diff(t_other)))
    out = np.full(len(delays), np.nan)
    fewest = MIN_COMMON_S / max(float(np.median(np.diff(t))), 1e-9)
    for k, delay in enumerate(delays):
        at = t - delay
        i = np.clip(np.searchsorted(t_other, at) - 1, 0, len(t_other) - 2)
        gap = t_other[i + 1] - t_other[i]
        near = (at >= t_other[0]) & (at <= t_other[-1]) & (gap < MAX_GAP * period)
        if near.sum() < 0.9 * fewest:
            continue
        i, u = i[near], ((at - t_other[i]) / gap)[near, None]
        # on a straight line between two frames: wrong by less than the hundredths of a second that are asked for here
        ray = d[i] * (1.0 - u) + d[i + 1] * u
        out[k] = np.sqrt(np.mean(np.sum(ray * normal[near], axis=1) ** 2))
    return out


def _chosen(delays: Array, rms: Array, names: tuple[str, ...], t: list[Array]) -> float:
    from scipy.signal import argrelmin  # imported here: it takes longer than most commands need to begin

    tried = np.isfinite(rms)
    if not tried.any():
        raise Inconsistent(
            f"the two recordings have less than {MIN_COMMON_S:g} s in common, whatever the delay up to "
            f"{MAX_DELAY_S:g} s: the stamps of {names[1]} begin {abs(t[1][0] - t[0][0]):.1f} s "
            f"{'after' if t[1][0] > t[0][0] else 'before'} those of {names[0]}",
            consequence="Nothing ties the two clocks; no timing is given",
            cure="Record both cameras at the same time, with stamps that are at most half a minute apart",
        )
    typical = float(np.median(rms[tried]))
    if typical < LEAST_MOTION_PX:
        raise Degenerate(
            f"the target hardly moves across the line between the cameras: {typical:.1f} px",
            consequence="Every delay fits alike; no timing is given",
            cure="Wave it up and down as well as sideways, 10 cm and more, about once a second, for 10 to 20 s",
        )
    filled = np.where(tried, rms, np.inf)
    best = int(np.argmin(filled))
    least = float(filled[best])
    if least > AGREE * typical:
        raise Inconsistent(
            f"no delay up to {MAX_DELAY_S:g} s makes the two views agree: {least:.1f} px remain at best",
            consequence="No timing is given",
            cure=f"Check that both recordings are of the same time and the same light, that {names[0]} and {names[1]} "
            "are not swapped, and that rig.yaml is of these cameras",
        )
    low = argrelmin(filled, order=3, mode="clip")[0]
    rivals = low[(np.abs(delays[low] - delays[best]) > APART_S) & (filled[low] < RIVAL * least + RIVAL_FLOOR_PX)]
    if len(rivals):
        other = delays[rivals[np.argmin(filled[rivals])]]
        raise Ambiguous(
            f"the motion repeats itself: delays of {delays[best]:.2f} s and {other:.2f} s both fit",
            consequence="A delay of whole periods fits as well as the right one; no timing is given",
            cure="Wave irregularly, with changes of direction and pace; check that rig.yaml is of these cameras",
        )
    return float(delays[best])
