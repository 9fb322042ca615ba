"""Delay, drift, read-outs, jitter and lost frames of two free-running cameras, against the truth they are made with.

benchmarks/timing_calibration.py makes its recordings here as well.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.calibrate.timing import TimingResult, calibrate_timing
from armsight.errors import Ambiguous, DataRefused, Degenerate, Inconsistent, NotEnoughData
from armsight.optics import Camera, Rig, RigKind
from armsight.records import SpotTrack
from refusals import refuses

Array = NDArray[np.float64]
F, WIDTH, HEIGHT = 950.0, 1280, 720
CX, CY = 639.5, 359.5
LIGHTS = np.array([[-0.04, 0.0, 0.0], [0.03, 0.032, 0.0], [0.03, -0.032, 0.0]])
NAMES = ("A", "B", "C")
Path = Callable[[Array], tuple[Array, Rotation]]


@dataclass(frozen=True, kw_only=True)
class Truth:
    """What the recording is made with. delay_s, drift_ppm: t_left = t_right + delay + 1e-6 drift t_right."""

    rates: tuple[float, float] = (30.0, 30.0)
    delay_s: float = 0.012
    drift_ppm: float = 0.0
    readout_s: tuple[float, float] = (0.02, 0.02)
    jitter_s: tuple[float, float] = (0.0, 0.0)
    lost: float = 0.02
    seconds: float = 15.0
    speed: float = 0.5
    noise_px: tuple[float, float] = (0.05, 0.05)
    lights: int = 3
    baseline_m: float = 0.12
    turned_rad: float = 0.0
    portrait: bool = False
    start_s: float = 0.0
    uneven_s: float = 0.0  # standard deviation of the right camera's exposures about their stamps


def rig_of(truth: Truth) -> Rig:
    """The cameras: parallel, or turned towards each other; the right one on its side."""
    camera = Camera.pinhole(WIDTH, HEIGHT, F, F, CX, CY)
    rotation = Rotation.from_euler("y", -truth.turned_rad)
    if truth.portrait:
        rotation = rotation * Rotation.from_euler("z", 0.5 * np.pi)
    return Rig(
        kind=RigKind.STEREO,
        left=camera,
        right=camera,
        T_rig_left=RigidTransform.identity(),
        T_rig_right=RigidTransform.from_components([truth.baseline_m, 0.0, 0.0], rotation),
    )


def waving(rng: np.random.Generator, speed: float, seconds: float) -> Path:
    """A hand's irregular motion of this RMS speed, turning three radians for each metre."""
    f, phase = rng.uniform(0.2, 1.5, (2, 6, 5)) * [[[1.0]], [[4.0]]]
    amplitude = rng.uniform(0.5, 1.0, (6, 5)) / f
    rate = np.sqrt(((2 * np.pi * f * amplitude) ** 2 / 2).sum(axis=1))
    wanted = np.repeat([speed, 3.0 * speed], 3)
    have = np.repeat([np.linalg.norm(rate[:3]), np.linalg.norm(rate[3:])], 3)
    amplitude *= (wanted / have)[:, None]
    amplitude[:3] *= min(1.0, 0.25 / np.abs(amplitude[:3]).sum(axis=1).max())
    del seconds

    def at(t: Array) -> tuple[Array, Rotation]:
        way = (amplitude * np.sin(2 * np.pi * f * np.asarray(t)[:, None, None] + phase)).sum(axis=2)
        return np.array([0.05, 0.0, 0.8]) + way[:, :3], Rotation.from_rotvec(way[:, 3:]) * Rotation.from_euler("x", 0.4)

    return at


def record(truth: Truth, rng: np.random.Generator, path: Path | None = None) -> tuple[Rig, SpotTrack, SpotTrack]:
    """The rig, and what both cameras saw."""
    rig = rig_of(truth)
    way = path or waving(rng, truth.speed, truth.seconds)
    return rig, _track(truth, rig, way, 0, rng), _track(truth, rig, way, 1, rng)


def _track(truth: Truth, rig: Rig, way: Path, side: int, rng: np.random.Generator) -> SpotTrack:
    n = int(truth.seconds * truth.rates[side])
    t = rng.uniform(0.0, 1.0 / truth.rates[side]) + np.arange(n) / truth.rates[side]  # by the left clock
    delay, rate = (truth.delay_s, 1.0 + 1e-6 * truth.drift_ppm) if side else (0.0, 1.0)
    stamp = (t + truth.start_s - delay) / rate
    kept = rng.random(n) >= truth.lost
    kept[[0, -1]] = True
    t, stamp = t[kept], stamp[kept]
    stamp = stamp + rng.normal(0.0, truth.jitter_s[side], len(t))
    seen = t + rng.normal(0.0, truth.uneven_s, len(t)) if side and truth.uneven_s else t
    uv = np.stack([_pixels(truth, rig, way, seen, side, light) for light in LIGHTS[: truth.lights]], axis=1)
    uv = uv + rng.normal(0.0, truth.noise_px[side], uv.shape)
    inside = ((uv > 5.0) & (uv < [WIDTH - 6.0, HEIGHT - 6.0])).all(axis=2)
    frame, light = np.nonzero(inside)
    return SpotTrack(
        t_s=stamp,
        frame=frame,
        names=tuple(NAMES[i] for i in light) if truth.lights > 1 else ("",) * len(light),
        uv_px=uv[inside],
        covariance_px2=np.tile(0.01 * np.eye(2), (len(light), 1, 1)),
    )


def _pixels(truth: Truth, rig: Rig, way: Path, t: Array, side: int, light: Array) -> Array:
    """Where a light is seen by a rolling shutter (n, 2)."""
    T = rig.T_rig_camera(("left", "right")[side]).inv()
    late = np.zeros(len(t))
    uv = np.zeros((len(t), 2))
    for _ in range(8):
        p, R = way(t + late)
        P = T.apply(p + R.apply(light))
        uv = F * P[:, :2] / P[:, 2:] + [CX, CY]
        late = truth.readout_s[side] * (uv[:, 1] / (HEIGHT - 1) - 0.5)
    return uv


PLACES = dict(zip(NAMES, LIGHTS, strict=True))
CASES = {
    "30 and 30": Truth(delay_s=3.217, drift_ppm=80.0, jitter_s=(1e-3, 5e-4)),
    "25 and 50": Truth(
        rates=(25.0, 50.0), delay_s=-7.3, drift_ppm=-50.0, readout_s=(0.03, 0.012), jitter_s=(5e-4, 1e-3)
    ),
    "29.97 and 60, one global shutter": Truth(rates=(29.97, 60.0), delay_s=0.4, readout_s=(0.0, 0.014), start_s=50.0),
    "one beacon, the right camera on its side": Truth(lights=1, portrait=True, baseline_m=0.3, turned_rad=0.3),
}
RUNS = 2


def off(truth: Truth, found: TimingResult) -> tuple[Array, Array]:
    """Errors and claimed standard deviations of: delay in the middle, drift, both read-outs."""
    shift = found.delay_s - truth.delay_s + 1e-6 * (found.drift_ppm - truth.drift_ppm) * found.middle_s
    read = np.subtract(found.readout_s, truth.readout_s)
    std = found.std
    claimed = [found.std_middle_s, *(std[k] for k in ("drift_ppm", "left.readout_s", "right.readout_s"))]
    return np.array([shift, found.drift_ppm - truth.drift_ppm, *read]), np.array(claimed)


@cache
def calibrated(name: str, seed: int) -> TimingResult:
    return calibrate_timing(*record(CASES[name], np.random.default_rng(seed)), PLACES)


@pytest.mark.parametrize("name", [name for name in CASES if name != "25 and 50"])  # like the third, told apart below
def test_timing_is_found_as_well_as_claimed(name: str) -> None:
    truth = CASES[name]
    errors, claims = [], []
    for seed in range(RUNS):
        e, s = off(truth, calibrated(name, seed))
        errors.append(e)
        claims.append(s)
    z = np.abs(errors) / claims
    assert np.abs(errors)[:, 0].max() < 2e-4
    assert np.median(np.abs(errors)[:, 2:]) < 0.03 * 0.02
    assert np.mean(z**2) < 2.3  # 8 figures: 1 +- 0.5
    assert z.max() < 4.0


def test_lost_frames_are_counted_and_jitter_is_measured() -> None:
    truth = Truth(jitter_s=(2e-3, 1e-3), rates=(60.0, 30.0))
    rig, left, right = record(truth, np.random.default_rng(3))
    found = calibrate_timing(rig, left, right)
    assert found.lost == (900 - len(left), 450 - len(right))
    for got, true, name in zip(found.jitter_s, truth.jitter_s, ("left.jitter_s", "right.jitter_s"), strict=True):
        assert abs(got - true) < 4.0 * found.std[name] + 0.02 * true


def test_stamps_that_come_late_now_and_then_do_no_harm() -> None:
    truth = Truth(jitter_s=(5e-4, 5e-4))
    rng = np.random.default_rng(9)
    rig, left, right = record(truth, rng)
    late = np.where(rng.random(len(left)) < 0.02, rng.uniform(0.0, 0.03, len(left)), 0.0)
    e, s = off(truth, calibrate_timing(rig, replace(left, t_s=left.t_s + late), right, PLACES))
    assert (np.abs(e) < 4.0 * s).all() and abs(e[0]) < 2e-4


def test_exposures_that_are_not_at_their_stamps_are_told() -> None:
    found = calibrate_timing(*record(Truth(uneven_s=2e-3), np.random.default_rng(8)))
    assert found.verdict.startswith("weak") and "right view" in found.verdict


def test_one_beacon_before_parallel_cameras_tells_the_difference_of_the_read_outs_only() -> None:
    truth = Truth(lights=1, readout_s=(0.02, 0.014))
    found = calibrate_timing(*record(truth, np.random.default_rng(4)))
    std = found.std
    assert min(std["left.readout_s"], std["right.readout_s"]) > 2e-3
    C = found.covariance.block(("left.readout_s", "right.readout_s"))
    apart = np.sqrt(C[0, 0] + C[1, 1] - 2.0 * C[0, 1])
    assert apart < 5e-4
    assert abs(found.readout_s[0] - found.readout_s[1] - 0.006) < 4.0 * apart
    assert found.verdict.startswith("weak") and "firm" in found.verdict


def refused(kind: type[DataRefused], name: str | tuple[str, ...], rig: Rig, left: SpotTrack, right: SpotTrack) -> None:
    with refuses(kind, name) as caught:
        calibrate_timing(rig, left, right)
    assert caught.value.consequence and caught.value.cure


def test_periodic_motion_is_refused() -> None:
    def swing(t: Array) -> tuple[Array, Rotation]:
        way = 0.1 * np.stack([np.sin(5.0 * t), np.cos(5.0 * t + 0.5), 0.3 * np.sin(5.0 * t + 1.0)], axis=1)
        return np.array([0.05, 0.0, 0.8]) + way, Rotation.from_rotvec(0.5 * way)

    refused(Ambiguous, "repeats", *record(Truth(), np.random.default_rng(0), swing))


def test_a_target_at_rest_is_refused() -> None:
    refused(Degenerate, "hardly", *record(Truth(speed=0.001), np.random.default_rng(0)))


def test_recordings_of_different_times_are_refused() -> None:
    rig, left, _ = record(Truth(delay_s=0.0), np.random.default_rng(1))
    _, _, right = record(Truth(delay_s=0.0), np.random.default_rng(2))
    refused(Inconsistent, "no delay up", rig, left, right)
    later = replace(right, t_s=right.t_s + 3600.0)
    refused(Inconsistent, "in common", rig, left, later)


def test_a_rig_of_other_cameras_is_refused() -> None:
    rig, left, right = record(Truth(), np.random.default_rng(1))
    for angle, name in ((0.008, "fit"), (0.1, "no delay up")):
        turned = RigidTransform.from_components(rig.T_rig_right.translation, Rotation.from_euler("x", angle))
        refused(Inconsistent, name, replace(rig, T_rig_right=turned), left, right)


def test_one_recording_given_twice_is_refused() -> None:
    rig, left, _ = record(Truth(), np.random.default_rng(1))
    refused(Inconsistent, "the same spots", rig, left, left)


def test_lights_without_names_are_told_apart_by_their_motion() -> None:
    truth = CASES["25 and 50"]
    rng = np.random.default_rng(8)
    rig, left, right = record(truth, rng)
    found = calibrate_timing(rig, _unnamed(left, rng), _unnamed(right, rng))
    e, s = off(truth, found)
    assert found.lights == ("1", "2", "3")
    assert (np.abs(e) < 4.0 * s).all() and abs(e[0]) < 2e-4
    with refuses(NotEnoughData, "no names"):
        calibrate_timing(rig, left, _unnamed(right, rng))


def _unnamed(track: SpotTrack, rng: np.random.Generator) -> SpotTrack:
    """The spots of each frame in any order, without names."""
    order = np.lexsort((rng.random(len(track.frame)), track.frame))
    return replace(
        track,
        frame=track.frame[order],
        names=("",) * len(order),
        uv_px=track.uv_px[order],
        covariance_px2=track.covariance_px2[order],
    )


def test_stamps_in_ms_us_or_ns_are_named_by_their_step_and_seconds_are_the_cure() -> None:
    units = (1e3, 1e6)
    rig, left, right = record(Truth(), np.random.default_rng(1))
    tracks = [replace(one, t_s=unit * one.t_s) for one, unit in zip((left, right), units, strict=True)]
    for _ in units:
        with refuses(Inconsistent, "frames a second") as error:
            calibrate_timing(rig, *tracks)
        side = "left" in error.value.cause.split()
        tracks[not side] = replace(tracks[not side], t_s=tracks[not side].t_s / float(error.value.cure.split()[-1]))
    assert calibrate_timing(rig, *tracks).delay_s == pytest.approx(0.012, abs=1e-4)


def test_too_few_frames_and_no_common_light_are_refused() -> None:
    rig, left, right = record(Truth(seconds=0.6), np.random.default_rng(1))
    refused(NotEnoughData, "frames", rig, left, right)
    rig, left, right = record(Truth(lights=1), np.random.default_rng(1))
    few = left.frame < 20
    names = ("",) * int(few.sum())
    kept = {"uv_px": left.uv_px[few], "covariance_px2": left.covariance_px2[few]}
    seen = replace(left, frame=left.frame[few], names=names, **kept)
    refused(NotEnoughData, "20 left", rig, seen, right)
    rig, left, right = record(Truth(), np.random.default_rng(1))
    refused(
        NotEnoughData, ("no light", "both cameras"), rig, left, right.renamed("X") if right.alone else _other(right)
    )


def _other(track: SpotTrack) -> SpotTrack:
    return replace(track, names=tuple(f"other {name}" for name in track.names))
