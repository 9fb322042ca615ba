"""A target in a hand before two cameras that run free, made with numpy and scipy alone.

The hand goes from place to place in reaches of least jerk (Flash and Hogan 1985), some of which it breaks off and turns
back from, rests between them, and trembles at 6 to 11 Hz. Each camera exposes line by line on a clock of its own; a
frame's stamp is that of its middle line, give or take the jitter.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

Array = NDArray[np.float64]
Way = Callable[[Array], tuple[Array, Rotation]]
LIGHTS = np.array([[-0.045, -0.005, 0.0], [0.032, 0.03, 0.004], [0.028, -0.036, -0.003]])
LIGHTS.setflags(write=False)  # as those of a target: kernels are compiled for it already
WIDTH, HEIGHT = 1280, 720
LEAST_JERK_PEAK = 1.875
"""Peak over mean speed of a reach."""
FEW_PX = 5.0


@dataclass(frozen=True, kw_only=True)
class Mount:
    """Where the right camera stands in the left one's axes: at (3,), turned by a rotation vector (3,); focal in px."""

    at_m: tuple[float, float, float] = (0.12, 0.0, 0.0)
    turn_rad: tuple[float, float, float] = (0.0, 0.0, 0.0)
    focal_px: float = 950.0
    centre_m: tuple[float, float, float] = (0.06, 0.0, 0.8)

    @property
    def axes(self) -> tuple[Array, Array]:
        """Where the cameras stand (2, 3) and how they are turned (2, 3, 3), as T_left_camera."""
        R = np.stack([np.eye(3), Rotation.from_rotvec(self.turn_rad).as_matrix()])
        return np.array([[0.0, 0.0, 0.0], self.at_m]), R


MOUNTS = {
    "side by side": Mount(),
    "converging": Mount(at_m=(0.5, 0.02, 0.1), turn_rad=(0.0, -0.55, 0.02), centre_m=(0.15, 0.0, 0.85)),
    "one above the other": Mount(at_m=(0.0, 0.25, 0.0), turn_rad=(0.25, 0.0, 0.0), centre_m=(0.0, 0.08, 0.9)),
}


@dataclass(frozen=True, kw_only=True)
class Clocks:
    """How the cameras run: right stamps are t - delay_s and slow by drift_ppm; read-outs; jitter of the stamps, and how
    much too late they are on average, exponentially."""

    rate_hz: tuple[float, float] = (30.0, 30.0)
    readout_s: tuple[float, float] = (0.018, 0.018)
    delay_s: float = 0.011
    drift_ppm: float = 40.0
    phase_s: float = 0.007
    jitter_s: float = 0.002
    late_s: float = 0.0
    lost: float = 0.02


@dataclass(frozen=True, kw_only=True)
class Seen:
    """Spots of one camera, in the order of frames: stamps (n,) s and uv_px, a list of (k, 2)."""

    t_s: Array
    uv_px: list[Array] = field(default_factory=list)


def hand(rng: np.random.Generator, speed: float, seconds: float, mount: Mount) -> Way:
    """Return the way of a hand whose fastest reaches come to speed (m/s, peak); 0: still but for its tremor."""
    begin, took, steps, turns = [], [], [], []
    t = rng.uniform(0.2, 0.6)
    place, turned = np.zeros(3), np.zeros(3)
    room = np.array([0.14, 0.09, 0.12])
    while t < seconds + 1.0 and speed > 0.0:
        goal, facing = rng.uniform(-1.0, 1.0, 3) * room, rng.normal(0.0, 0.22, 3)
        way = goal - place
        peak = speed * rng.uniform(0.5, 1.0)
        T = max(LEAST_JERK_PEAK * float(np.linalg.norm(way)) / peak, 0.25)
        begin.append(t)
        took.append(T)
        steps.append(way)
        turns.append(facing - turned)
        place, turned = goal, facing
        if rng.random() < 0.3:  # breaks off, and turns back: a second reach upon the first
            back = rng.uniform(0.5, 1.1)
            begin.append(t + rng.uniform(0.35, 0.6) * T)
            took.append(max(T, LEAST_JERK_PEAK * back * float(np.linalg.norm(way)) / peak))
            steps.append(-back * way)
            turns.append(-back * turns[-1])
            place, turned = place - back * way, turned + turns[-1]
        t = max(begin[-1] + took[-1], t + T) + (rng.uniform(0.2, 1.2) if rng.random() < 0.5 else -0.15 * T)
    f, phase = rng.uniform(6.0, 11.0, (6, 3)), rng.uniform(0.0, 2.0 * np.pi, (6, 3))
    size = np.repeat([5e-5, 4e-4], 3)[:, None] * rng.uniform(0.3, 1.0, (6, 3))
    rest = Rotation.from_euler("xyz", rng.uniform([0.2, -0.3, -0.3], [0.5, 0.3, 0.3]))

    def at(t_s: Array) -> tuple[Array, Rotation]:
        t_s = np.atleast_1d(t_s)
        out = (size[..., None] * np.sin(2.0 * np.pi * f[..., None] * t_s + phase[..., None])).sum(axis=1).T
        if begin:
            s = np.clip((t_s[:, None] - np.array(begin)) / np.array(took), 0.0, 1.0)
            done = s**3 * (10.0 - 15.0 * s + 6.0 * s**2)
            out = out + done @ np.hstack([np.array(steps), np.array(turns)])
        return np.array(mount.centre_m) + out[:, :3], Rotation.from_rotvec(out[:, 3:]) * rest

    return at


def waves(rng: np.random.Generator, mount: Mount) -> Way:
    """Return the way of a hand that moves by sums of slow waves: 2 to 5 cm and 4 to 8 degrees, 0.25 to 1.6 Hz."""
    n = int(rng.integers(2, 5))
    f, phase = rng.uniform(0.25, 1.6, (6, n)), rng.uniform(0.0, 2.0 * np.pi, (6, n))
    size = np.concatenate([rng.uniform(0.02, 0.05, 3), np.deg2rad(rng.uniform(4.0, 8.0, 3))])[:, None] / n
    rest = Rotation.from_euler("xyz", rng.uniform([0.2, -0.3, -0.3], [0.5, 0.3, 0.3]))

    def at(t_s: Array) -> tuple[Array, Rotation]:
        angle = 2.0 * np.pi * f[..., None] * np.atleast_1d(t_s) + phase[..., None]
        out = (size[..., None] * np.sin(angle)).sum(axis=1).T
        return np.array(mount.centre_m) + out[:, :3], Rotation.from_rotvec(out[:, 3:]) * rest

    return at


def pixels(way: Way, mount: Mount, readout_s: float, t_s: Array, side: int) -> Array:
    """Pixels (n, 3, 2) of the lights in frames whose middle line is of t_s (n,), each light at its own line's time."""
    places, axes = mount.axes
    late = np.zeros((len(t_s), len(LIGHTS)))
    uv = np.empty((*late.shape, 2))
    for _ in range(6):
        for i, light in enumerate(LIGHTS):
            p, R = way(t_s + late[:, i])
            c = (p + R.apply(np.array(light)) - places[side]) @ axes[side]
            uv[:, i] = mount.focal_px * c[:, :2] / c[:, 2:] + [(WIDTH - 1) / 2, (HEIGHT - 1) / 2]
        late = readout_s * (uv[..., 1] / (HEIGHT - 1) - 0.5)
    return uv


def record(
    rng: np.random.Generator, way: Way, mount: Mount, clocks: Clocks, seconds: float, noise_px: float
) -> tuple[Seen, Seen]:
    """Return what both cameras see; the world's time is that of the left camera's clock."""
    out = []
    for side in (0, 1):
        n = np.arange(int(seconds * clocks.rate_hz[side]))
        stamp = n / clocks.rate_hz[side] + 0.05 + side * clocks.phase_s
        t = stamp + side * (clocks.delay_s + 1e-6 * clocks.drift_ppm * stamp)
        kept = rng.random(len(n)) >= clocks.lost
        told = stamp + rng.normal(0.0, clocks.jitter_s, len(n)) if clocks.jitter_s else stamp
        if clocks.late_s:
            told = told + rng.exponential(clocks.late_s, len(n))
        uv = pixels(way, mount, clocks.readout_s[side], t, side) + rng.normal(0.0, noise_px, (len(n), len(LIGHTS), 2))
        inside = ((uv > FEW_PX) & (uv < (WIDTH - 1 - FEW_PX, HEIGHT - 1 - FEW_PX))).all(axis=2)
        rows = np.flatnonzero(kept)
        out.append(Seen(t_s=told[rows], uv_px=[uv[k][inside[k]] for k in rows]))
    return out[0], out[1]


def table(seen: Seen, noise_px: float) -> str:
    """Return a camera's spots as a table, without names."""
    rows = ["t_s,u_px,v_px,su_px,sv_px"]
    for t, spots in zip(seen.t_s.tolist(), seen.uv_px, strict=True):
        rows += [f"{t!r},{u!r},{v!r},{noise_px},{noise_px}" for u, v in spots.tolist()]
    return "\n".join(rows) + "\n"


def off(T: Array, way: Way, t_s: float) -> Array:
    """Return the error (6,) of a pose (4, 4) at t_s: place in m, rotation vector in rad, in the left camera's axes."""
    p, R = way(np.array([t_s]))
    return np.concatenate([T[:3, 3] - p[0], (Rotation.from_matrix(T[:3, :3]) * R[0].inv()).as_rotvec()])
