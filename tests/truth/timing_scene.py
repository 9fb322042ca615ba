"""Two free-running rolling-shutter cameras before a waved target: stamps, spots and truth, of own making."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.optics import Camera, Rig, RigKind
from armsight.records import SpotTrack

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
    uv = np.stack([_pixels(truth, rig, way, t, side, light) for light in LIGHTS[: truth.lights]], axis=1)
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
