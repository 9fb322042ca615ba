"""Delays, drifts and read-outs of three and more cameras against a drawn world that shares no code with the product.

benchmarks/drone_clocks.py measures many of its recordings.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
from scipy.interpolate import BSpline
from scipy.spatial.transform import RigidTransform, Rotation
from tests.truth.camera_ring import CENTRE, FOCAL, K1, SIZE, Ring, ring

from armsight.calibrate.timing import CamerasTiming, calibrate_clocks
from armsight.errors import DataRefused, Inconsistent, NotEnoughData
from armsight.optics import Camera, MountedCamera, Rig
from armsight.records import NamedCovariance, SpotTrack
from refusals import refuses

TARGET = np.array([[-0.04, 0.0, 0.0], [0.03, 0.032, 0.01], [0.03, -0.032, 0.02]])
RATES = (30.0, 25.0, 29.97, 30.0, 50.0, 24.0, 60.0, 30.0)
READOUTS_S = (0.02, 0.012, 0.0, 0.016, 0.01, 0.025, 0.008, 0.02)
LENS, PLACE = ("fx", "fy", "cx", "cy", "k1"), ("tx", "ty", "tz", "rx", "ry", "rz")
LENS_STD, PLACE_STD = (0.5, 0.5, 0.5, 0.5, 1e-3), 5e-4  # px; m and rad
KNOTS_S = 0.16  # four periods of the slowest camera: the smoothest path that is tried


@dataclass(frozen=True, kw_only=True)
class Wave:
    """A recording: t_first = t + delays_s[c] + 1e-6 drifts_ppm[c] t; lights of the target, named where named."""

    views: int = 3
    delays_s: tuple[float, ...] = (0.0, -0.12, 0.03, -0.071, 0.014, -0.033, 0.0225, -0.1)
    drifts_ppm: tuple[float, ...] = (0.0, 60.0, -40.0, 25.0, 0.0, -80.0, 10.0, 30.0)
    jitter_s: float = 1e-3
    noise_px: float = 0.05
    lights: int = 1
    named: bool = True
    seconds: float = 15.0
    lost: float = 0.02
    hidden: tuple[int, ...] = ()  # cameras that see no light
    alone: tuple[int, ...] = ()  # cameras that see it while no other does
    still: bool = False


def waved(rng: np.random.Generator) -> tuple[np.ndarray, ...]:
    """Frequencies, phases and amplitudes (6, 5) of an irregular motion at 0.5 m/s."""
    f, phase = rng.uniform(0.2, 1.5, (6, 5)), rng.uniform(0.0, 2.0 * np.pi, (6, 5))
    a = rng.uniform(0.5, 1.0, (6, 5)) / f
    a[:3] *= 0.5 / np.sqrt((2.0 * np.pi**2 * (f * a)[:3] ** 2).sum())
    a[3:] *= 1.2 / np.sqrt((2.0 * np.pi**2 * (f * a)[3:] ** 2).sum())
    a[:3] *= min(1.0, 0.25 / a[:3].sum(axis=1).max())
    return f, phase, a


def lights_at(way: tuple[np.ndarray, ...], t: np.ndarray, light: np.ndarray) -> np.ndarray:
    """Where a light (n, 3) is at times (n,), in the rig's axes."""
    f, phase, a = way
    x = (a * np.sin(2.0 * np.pi * f * t[:, None, None] + phase)).sum(axis=2)
    return np.asarray(x[:, :3] + [0.0, 0.0, 1.3] + Rotation.from_rotvec(x[:, 3:]).apply(light))


def seen(wave: Wave, made: Ring, way: tuple[np.ndarray, ...], c: int, rng: np.random.Generator) -> SpotTrack:
    """What a rolling shutter sees."""
    n = int(wave.seconds * RATES[c])
    t = rng.uniform(0.0, 1.0 / RATES[c]) + np.arange(n) / RATES[c]  # by the first camera's clock
    stamp = (t - wave.delays_s[c]) / (1.0 + 1e-6 * wave.drifts_ppm[c])
    kept = rng.random(n) >= wave.lost
    kept[[0, -1]] = True
    t, stamp = t[kept], stamp[kept] + rng.normal(0.0, wave.jitter_s, int(kept.sum()))
    spots = []
    for light in TARGET[: wave.lights]:
        v = np.full(len(t), CENTRE[1])
        for _ in range(8):
            tau = READOUTS_S[c] * (v / (SIZE[1] - 1) - 0.5)
            uv = made.pixels(lights_at(way, t + tau, light))[:, c]
            v = np.where(np.isfinite(uv[:, 1]), uv[:, 1], v)
        spots.append(uv + rng.normal(0.0, wave.noise_px, uv.shape))
    at = np.stack(spots, axis=1)  # (n, lights, 2)
    if c in wave.hidden:
        at[:] = np.nan
    if wave.alone:
        at[(t > 0.5 * wave.seconds) != (c in wave.alone)] = np.nan
    frame, light = np.nonzero(np.isfinite(at).all(axis=2))
    if not wave.named:
        order = np.lexsort((rng.random(len(frame)), frame))
        frame, light = frame[order], light[order]
    return SpotTrack(
        t_s=stamp,
        frame=frame,
        names=tuple("ABC"[i] for i in light) if wave.named and wave.lights > 1 else ("",) * len(light),
        uv_px=at[frame, light],
        covariance_px2=np.tile(0.01 * np.eye(2), (len(light), 1, 1)),
    )


def rig_of(made: Ring) -> Rig:
    """The rig as the product has it: cameras c0, c1 ..."""
    camera = Camera.pinhole(*SIZE, FOCAL, FOCAL, *CENTRE, distortion=(K1, 0.0, 0.0, 0.0, 0.0))
    poses = [
        RigidTransform.from_components(-R.T @ t, Rotation.from_matrix(R.T)) for R, t in zip(made.R, made.t, strict=True)
    ]
    return Rig(cameras=[MountedCamera(name=f"c{k}", camera=camera, T_rig_camera=T) for k, T in enumerate(poses)])


def recorded(wave: Wave, seed: int) -> tuple[Rig, dict[str, SpotTrack]]:
    """The rig and what each camera saw."""
    rng, made = np.random.default_rng(seed), ring(wave.views)
    f, phase, a = waved(rng)
    way, rig = (f, phase, 0.0 * a if wave.still else a), rig_of(made)
    return rig, {name: seen(wave, made, way, c, rng) for c, name in enumerate(rig.names)}


def off(wave: Wave, found: CamerasTiming) -> tuple[np.ndarray, np.ndarray]:
    """Errors and claimed deviations: of the delays in the middle (v - 1), the drifts (v - 1) and the read-outs (v)."""
    names, std = list(found.clocks), found.std
    each = [found.clocks[name] for name in names]
    at = [int(name[1:]) for name in names]
    drift = np.array([one.drift_ppm - wave.drifts_ppm[c] for one, c in zip(each, at, strict=True)])[1:]
    late = np.array([one.delay_s - wave.delays_s[c] for one, c in zip(each, at, strict=True)])[1:]
    late += 1e-6 * drift * np.array([one.middle_s for one in each])[1:]
    read = [one.readout_s - READOUTS_S[c] for one, c in zip(each, at, strict=True)]
    claimed = [
        *(one.std_middle_s for one in each[1:]),
        *(std[f"{name}.drift_ppm"] for name in names[1:]),
        *(std[f"{name}.readout_s"] for name in names),
    ]
    return np.concatenate([late, drift, read]), np.array(claimed)


def doubt_of(views: int) -> NamedCovariance:
    """What a calibration says of its rig: numbers that are correlated with each other."""
    names = [f"c{c}.{name}" for c in range(views) for name in LENS]
    names += [f"c{c}.{name}" for c in range(1, views) for name in PLACE]
    std = np.array([*LENS_STD * views, *[PLACE_STD] * (6 * (views - 1))])
    A = np.random.default_rng(99).normal(size=(len(std), len(std)))
    C = A @ A.T
    C = 0.5 * C / np.sqrt(np.outer(C.diagonal(), C.diagonal())) + 0.5 * np.eye(len(std))
    return NamedCovariance(names=tuple(names), matrix=C * np.outer(std, std))


def off_by(rig: Rig, off: np.ndarray, covariance: NamedCovariance | None) -> Rig:
    """The rig with numbers that are wrong, in the order of doubt_of."""
    V, cameras = len(rig.cameras), []
    lens, place = off[: 5 * V].reshape(V, 5), np.vstack([np.zeros(6), off[5 * V :].reshape(V - 1, 6)])
    for one, k, move in zip(rig.cameras, lens, place, strict=True):
        f, c = FOCAL + k[:2], CENTRE + k[2:4]
        camera = Camera.pinhole(*SIZE, *f, *c, distortion=(K1 + k[4], 0.0, 0.0, 0.0, 0.0))
        turned = Rotation.from_rotvec(move[3:]) * one.T_rig_camera.rotation
        T = RigidTransform.from_components(one.T_rig_camera.translation + move[:3], turned)
        cameras.append(MountedCamera(name=one.name, camera=camera, T_rig_camera=T))
    return Rig(cameras=cameras, covariance=covariance)


def pixels_by(made: Ring, c: int, X: np.ndarray, off: np.ndarray) -> np.ndarray:
    """Pixels (n, 2) of points (n, 3) in a camera whose lens (5,) and place (6,) are off (11,)."""
    R = Rotation.from_rotvec(off[8:]).as_matrix() @ made.R[c].T
    p = (X + made.R[c].T @ made.t[c] - off[5:8]) @ R
    xy = p[:, :2] / p[:, 2:]
    return (FOCAL + off[:2]) * xy * (1.0 + (K1 + off[4]) * (xy**2).sum(axis=1, keepdims=True)) + CENTRE + off[2:4]


def bound(wave: Wave, made: Ring, way: tuple[np.ndarray, ...], tracks: dict[str, SpotTrack]) -> np.ndarray:
    """The Cramer-Rao bound (v - 1) of the delays in the middle, from one light's spots, stamps and the rig's doubt.

    Unknown are the path (a quintic spline), delays, drifts, read-outs, and how far the rig is off.
    """
    V, n, C = wave.views, 3 * wave.views - 2, doubt_of(wave.views).matrix
    times = []
    for c, track in enumerate(tracks.values()):
        t = track.t_s[track.frame] * (1.0 + 1e-6 * wave.drifts_ppm[c]) + wave.delays_s[c]
        line = track.uv_px[:, 1] / (SIZE[1] - 1) - 0.5
        times.append((t, line, t + READOUTS_S[c] * line))
    ends = min(at.min() for *_, at in times) - 0.05, max(at.max() for *_, at in times) + 0.05
    m = int(np.ceil((ends[1] - ends[0]) / KNOTS_S)) + 5
    knots = ends[0] + KNOTS_S * np.arange(-5, m + 1)
    N = np.zeros((3 * m + n + len(C),) * 2)
    for c, (t, line, at) in enumerate(times):
        X, none = lights_at(way, at, TARGET[0]), np.zeros(11)
        speed = (lights_at(way, at + 1e-4, TARGET[0]) - lights_at(way, at - 1e-4, TARGET[0])) / 2e-4
        by_X = np.stack(
            [pixels_by(made, c, X + h, none) - pixels_by(made, c, X - h, none) for h in 1e-6 * np.eye(3)], 2
        )
        by_t = np.einsum("nij,nj->ni", by_X / 2e-6, speed)
        J = np.zeros((len(t), 2, len(N)))
        path = BSpline.design_matrix(at, knots, 5).toarray()
        J[:, :, : 3 * m] = np.einsum("nij,nk->nikj", by_X / 2e-6, path).reshape(len(t), 2, -1)
        if c:
            J[:, :, 3 * m + 2 * c - 2] = by_t
            J[:, :, 3 * m + 2 * c - 1] = 1e-6 * by_t * (t - t.mean())[:, None]
        J[:, :, 3 * m + 2 * V - 2 + c] = by_t * line[:, None]
        places = [*(5 * c + np.arange(5)), *(5 * V + 6 * (c - 1) + np.arange(6) if c else ())]
        for i, place in enumerate(places):
            h = 1e-5 * np.eye(11)[i]
            J[:, :, 3 * m + n + place] = (pixels_by(made, c, X, h) - pixels_by(made, c, X, -h)) / 2e-5
        N += J.reshape(-1, len(N)).T @ J.reshape(-1, len(N)) / wave.noise_px**2
    known = np.full(n, (2.0 / min(RATES[:V])) ** -2 * 16.0)  # a read-out is half a period, give or take as much
    known[: 2 * V - 2 : 2], known[1 : 2 * V - 2 : 2] = 0.0, 1e-6
    N[3 * m :, 3 * m :] += np.diag([*known, *np.zeros(len(C))])
    N[3 * m + n :, 3 * m + n :] += np.linalg.inv(C)
    scale = np.sqrt(N.diagonal() + 1e-9 * N.diagonal()[: 3 * m].max())
    inverse = np.linalg.inv(N / np.outer(scale, scale) + 1e-12 * np.eye(len(N))) / np.outer(scale, scale)
    frames = np.array([len(track) for track in tracks.values()])
    clock = wave.jitter_s**2 * (1.0 / frames[1:] + 1.0 / frames[0])
    return np.asarray(np.sqrt(inverse.diagonal()[3 * m :][: 2 * V - 2 : 2] + clock))


def doubted(wave: Wave, seed: int, times: float = 1.0, *, known: bool = True) -> tuple[CamerasTiming, np.ndarray]:
    """Clocks by a rig that is off as its covariance says, or so many times as much, and the bound of the delays."""
    rng, made, C = np.random.default_rng(seed), ring(wave.views), doubt_of(wave.views)
    way, rig = waved(rng), rig_of(made)
    tracks = {name: seen(wave, made, way, c, rng) for c, name in enumerate(rig.names)}
    wrong = off_by(rig, times * rng.multivariate_normal(np.zeros(len(C.names)), C.matrix), C if known else None)
    return calibrate_clocks(wrong, tracks), bound(wave, made, way, tracks)


@pytest.mark.parametrize("views", [3, 4])
def test_a_rig_that_is_off_as_it_says_costs_what_it_must(views: int) -> None:
    wave = Wave(views=views, seconds=10.0, jitter_s=1e-4)
    found, least = doubted(wave, 101)
    e, s = off(wave, found)
    assert (np.abs(e) < 4.0 * s).all() and found.rig_off == 1.0
    assert (s[: views - 1] < 1.08 * least).all() and (s[: views - 1] > 0.92 * least).all()


def test_a_rig_that_is_off_and_does_not_say_so_widens_the_claim() -> None:
    wave = Wave(seconds=10.0, jitter_s=1e-4)
    found, least = doubted(wave, 101, known=False)
    e, s = off(wave, found)
    assert (np.abs(e) < 4.0 * s).all() and found.verdict_.level == "care"
    assert (s[:2] > 2.0 * least).all() and all(one.wider > 2.0 for one in list(found.clocks.values())[1:])


def test_a_rig_that_is_further_off_than_it_says_is_told_or_refused() -> None:
    wave = Wave(seconds=10.0, jitter_s=1e-4)
    found, _ = doubted(wave, 101, 3.0)
    e, s = off(wave, found)
    assert (np.abs(e) < 4.0 * s).all() and 1.5 < found.rig_off < 5.0
    assert found.verdict_.level == "care" and "rig" in found.verdict
    with refuses(Inconsistent, "standard deviations", "rig"):
        doubted(wave, 101, 10.0)


@pytest.mark.parametrize("wave", [Wave(), Wave(views=4, lights=3)], ids=["3", "4, a target"])
def test_clocks_of_many_cameras_are_found_as_well_as_claimed(wave: Wave) -> None:
    found = calibrate_clocks(*recorded(wave, 1))
    e, s = off(wave, found)
    assert np.abs(e[: wave.views - 1]).max() < 2e-4
    assert np.mean(np.abs(e) < 1.96 * s) > 0.7 and (np.abs(e) < 4.0 * s).all()
    assert found.verdict.startswith("good")
    left_out = [one.left_out_px for one in found.clocks.values()]
    assert all(px is not None and 0.7 * wave.noise_px < px < 2.0 * wave.noise_px for px in left_out)


def test_lights_without_names_are_told_apart_through_all_cameras() -> None:
    wave = Wave(lights=3, named=False)
    found = calibrate_clocks(*recorded(wave, 1))
    e, s = off(wave, found)
    assert found.lights == ("1", "2", "3")
    assert np.abs(e[:2]).max() < 2e-4 and (np.abs(e) < 4.0 * s).all()


@pytest.mark.parametrize(
    ("wave", "kind"), [(Wave(hidden=(1,)), NotEnoughData), (Wave(alone=(1,)), Inconsistent)], ids=["never", "alone"]
)
def test_a_camera_that_shares_no_sight_is_named_and_the_others_are_kept(wave: Wave, kind: type[DataRefused]) -> None:
    rig, tracks = recorded(wave, 2)
    with refuses(kind, ("c1", "c0")) as caught:
        calibrate_clocks(rig, tracks)
    kept = caught.value.kept
    assert isinstance(kept, CamerasTiming) and list(kept.clocks) == ["c0", "c2"]
    e, s = off(wave, kept)
    assert np.abs(e[0]) < 1e-3 and (np.abs(e) < 4.5 * s).all()
    assert [one is None for one in kept.rig.timing] == [False, True, False]


def test_clocks_that_differ_by_seconds_are_found_and_by_hours_are_told() -> None:
    wave = Wave(delays_s=(0.0, 7.5, -3.25))
    rig, tracks = recorded(wave, 4)
    e, _ = off(wave, calibrate_clocks(rig, tracks))
    assert np.abs(e[:2]).max() < 3e-4
    late = replace(tracks["c1"], t_s=tracks["c1"].t_s + 3607.5)
    with refuses(Inconsistent, ("c1", "3600.0", "after")):
        calibrate_clocks(rig, tracks | {"c1": late})


def test_a_camera_that_was_moved_or_given_twice_is_refused() -> None:
    rig, tracks = recorded(Wave(views=4), 5)
    one = rig.cameras[2]
    turned = RigidTransform.from_components(
        one.T_rig_camera.translation, one.T_rig_camera.rotation * Rotation.from_euler("x", 0.008)
    )
    cameras = (*rig.cameras[:2], replace(one, T_rig_camera=turned), rig.cameras[3])
    with refuses(Inconsistent, ("do not fit", "c2")):
        calibrate_clocks(replace(rig, cameras=cameras), tracks)
    with refuses(Inconsistent, ("c1", "c3", "same spots")):
        calibrate_clocks(rig, tracks | {"c3": tracks["c1"]})
